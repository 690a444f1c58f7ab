//! A needle in the retina: it goes in, takes the retina off while it injects, tears when it moves
//! too fast, and leaves a hole.

use super::Retina;
use super::figures::{LEFT_MM, MAX_HOLES, REARM, SHAFT_MM, SPEED_S};
use super::line::Line;
use super::state::{Hole, NeedleState, RetinaState};
use super::volume::at;
use crate::constants::SUBSTEP_S;
use crate::needle::{Needle, Penetration};
use nalgebra::Vector3;

/// What a needle did in a substep that somebody should hear of.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NeedleEvents {
    /// It went in, so deep, mm.
    pub pierced_mm: Option<f64>,
    /// It left, and had injected so much, mm³.
    pub left_mm3: Option<f64>,
    /// It moves along the retina faster than the warning, mm/s.
    pub fast_mm_s: Option<f64>,
}

impl Retina {
    /// Where a needle is in the retina: through a loose part, or through one that lies on.
    pub fn penetration(&mut self, state: &RetinaState, needle: &Needle) -> Option<Penetration> {
        self.penetration_of_loose(state, needle).or_else(|| {
            let found = needle.in_sphere(self.figures.radius_mm)?;
            // Where the retina is off, the sphere is the choroid alone.
            let place = self.nearest_node(state, &found.at_in_eye_mm);
            (self.blebs.label[place as usize] == 0).then_some(found)
        })
    }

    fn penetration_of_loose(&mut self, state: &RetinaState, needle: &Needle) -> Option<Penetration> {
        if self.blebs.count() == 0 {
            return None;
        }
        let (from_mm, along) = (needle.tip_in_eye_mm, needle.axis_in_eye.into_inner());
        let line = Line { from_mm, along, reach_mm: SHAFT_MM };
        self.sides.compare(&line, &state.sheet.position_mm, self.body.span());
        let surface = self.body.surface(&state.sheet);
        let triangles = surface.triangles;
        let loose = (0..self.blebs.count()).flat_map(|b| self.blebs.triangles_of(b));
        let met = loose.copied().filter(|&t| self.sides.may_meet(&triangles[t as usize]));
        needle.in_triangles(&surface, met, SHAFT_MM)
    }

    /// Follows instrument `i` as a needle for one substep; `None` for an instrument that is none,
    /// or is not tracked.
    pub fn follow_needle(
        &mut self,
        state: &mut RetinaState,
        i: usize,
        needle: Option<&Needle>,
    ) -> NeedleEvents {
        let mut events = NeedleEvents::default();
        let Some(needle) = needle else {
            events.left_mm3 = state.needles[i].inside.then_some(state.needles[i].injected_mm3);
            state.needles[i] = NeedleState::default();
            return events;
        };
        let found = self.penetration(state, needle);
        let was_inside = state.needles[i].inside;
        match found {
            Some(found) if !was_inside => {
                self.pierce(state, i, &found);
                events.pierced_mm = Some(found.depth_mm);
            }
            None if was_inside && self.clearance(state, &needle.tip_in_eye_mm).mm > LEFT_MM => {
                events.left_mm3 = Some(state.needles[i].injected_mm3);
                state.needles[i] = NeedleState::default();
            }
            _ => {}
        }
        if let Some(found) = found {
            events.fast_mm_s = self.drag(state, i, needle, &found);
            self.inject(state, i, needle.pressure_pa);
        }
        events
    }

    fn pierce(&mut self, state: &mut RetinaState, i: usize, found: &Penetration) {
        let node = self.nearest_node(state, &found.at_in_eye_mm);
        let entry_mm = found.at_in_eye_mm.into();
        state.needles[i] = NeedleState { inside: true, node, entry_mm, ..NeedleState::default() };
        if state.holes.len() == MAX_HOLES {
            state.holes.remove(0);
        }
        state.holes.push(Hole { node, open_mm2: self.figures.hole_mm2, at_mm: entry_mm });
    }

    /// The injection takes the retina off within d(p) of where the needle went in.
    fn inject(&mut self, state: &mut RetinaState, i: usize, pressure_pa: f64) {
        let d_mm = self.figures.detach_mm(pressure_pa);
        let needle = &mut state.needles[i];
        if d_mm > needle.detached_mm {
            needle.detached_mm = d_mm;
            let (from, nearest) = (Vector3::from(needle.entry_mm), needle.node);
            self.take_off_around(state, &from, d_mm, nearest);
        }
    }

    /// Watches the speed along the retina (paper, section 4.5): over one limit it warns, over a
    /// higher one a spring tears for each mean edge of way. Returns the speed where the warning is
    /// new.
    fn drag(
        &mut self,
        state: &mut RetinaState,
        i: usize,
        needle: &Needle,
        found: &Penetration,
    ) -> Option<f64> {
        let scene = &self.figures.scene;
        let (warn, tears) = (scene.needle_warn_mm_s, scene.needle_tear_mm_s);
        let mine = &mut state.needles[i];
        mine.speed_mm_s += (found.tangential_mm_s - mine.speed_mm_s) * (SUBSTEP_S / SPEED_S);
        let fast = mine.speed_mm_s > warn;
        let events = (fast && !mine.warned).then_some(mine.speed_mm_s);
        mine.warned = fast || (mine.warned && mine.speed_mm_s > REARM * warn);
        if mine.speed_mm_s > tears {
            mine.dragged_mm += found.tangential_mm_s * SUBSTEP_S;
            if mine.dragged_mm > f64::from(self.body.mesh.rest_mm[0]) {
                mine.dragged_mm = 0.0;
                self.rip(state, &found.at_in_eye_mm, &needle.velocity_mm_s);
            }
        }
        events
    }

    /// Tears the spring that lies most across the way of the needle at the nearest living node.
    fn rip(&mut self, state: &mut RetinaState, at_mm: &Vector3<f64>, velocity_mm_s: &Vector3<f64>) {
        let node = self.nearest_node(state, at_mm) as usize;
        let mesh = &self.body.mesh;
        let mut best: Option<(f64, u32)> = None;
        for s in mesh.triangles_of(node).iter().flat_map(|&t| mesh.triangle_springs[t as usize]) {
            let [a, b] = mesh.springs[s as usize].map(|n| at(&state.sheet, n));
            let along = ((b - a).normalize().dot(velocity_mm_s)).abs();
            let alive = state.sheet.spring_alive[s as usize] != 0;
            if alive && best.is_none_or(|(least, _)| along < least) {
                best = Some((along, s));
            }
        }
        let Some((_, spring)) = best else { return };
        if self.body.tear_spring(&mut state.sheet, spring as usize, node) {
            self.after_loss(state);
        }
    }

    /// The node nearest to a point.
    pub(super) fn nearest_node(&self, state: &RetinaState, point_mm: &Vector3<f64>) -> u32 {
        let p = point_mm.map(|c| c as f32);
        let [x, y, z] = &state.sheet.position_mm;
        let mut best = (f32::INFINITY, 0);
        for n in 0..x.len() {
            let (dx, dy, dz) = (x[n] - p.x, y[n] - p.y, z[n] - p.z);
            let distance2 = dx * dx + dy * dy + dz * dz;
            best = if distance2 < best.0 { (distance2, n as u32) } else { best };
        }
        best.1
    }
}
