//! The front: where the retina comes off the choroid, where it comes to lie on it again, and what
//! that does to the blebs.
//!
//! A node of the front carries the pull of the springs to its loose neighbours and its share of the
//! fluid's push. Divided by the length of rim that it holds, that is a force per length with a part
//! away from the choroid and one along it. A lattice loads its corners unevenly, so that force and
//! rim are added up over a few neighbours along the front first. A node comes off when what that
//! releases ([`Figures::release_un_per_mm`](super::figures::Figures::release_un_per_mm)) reaches
//! the adhesion. Over the whole rim of a round bleb the carried force is that of Laplace's law,
//! because the push of the fluid on bleb and choroid is the same.

use super::Retina;
use super::blebs::FrontNode;
use super::figures::{FILM_MM, FRONT_SMOOTHING, MAX_BLEBS};
use super::state::{Bleb, RetinaState};
use super::volume::at;
use crate::sheet::state::{NODE_PINNED, SheetState};
use nalgebra::Vector3;
use protocol::scene::NODE_FREE;

/// Lays a node on the choroid, at rest, where it is over it.
pub(super) fn lay(tissue: &mut SheetState, node: u32, radius_mm: f64) {
    let p = at(tissue, node);
    let length = p.norm();
    if length > 0.0 {
        tissue.set_position(node as usize, (p * (radius_mm / length)).map(|c| c as f32));
    }
    tissue.set_velocity(node as usize, Vector3::zeros());
}

/// Moves a node by `way`, at most onto the choroid; with `dt_s` its velocity follows.
pub(super) fn shift(
    tissue: &mut SheetState,
    node: u32,
    way: &Vector3<f64>,
    dt_s: Option<f64>,
    radius_mm: f64,
) {
    let n = node as usize;
    let p = at(tissue, node) + way;
    let length = p.norm();
    let outside = length > radius_mm;
    let to = if outside { p * (radius_mm / length) } else { p };
    tissue.set_position(n, to.map(|c| c as f32));
    let Some(dt_s) = dt_s else { return };
    let mut v = tissue.velocity(n).map(f64::from) + way / dt_s;
    if outside {
        let out = p / length;
        v -= out * v.dot(&out).max(0.0);
    }
    tissue.set_velocity(n, v.map(|c| c as f32));
}

impl Retina {
    /// The worst node of each bleb's front comes off if it releases as much as the adhesion.
    pub(super) fn advance_front(&mut self, state: &mut RetinaState) {
        self.load_front(state);
        let mut worst = [(self.figures.adhesion_un_per_mm, u32::MAX); MAX_BLEBS];
        for slot in 0..self.blebs.front.len() {
            let front = self.blebs.front[slot];
            let release = self.release_of(slot);
            let most = &mut worst[usize::from(front.bleb)];
            if release >= most.0 && !self.fixed[front.node as usize] {
                *most = (release, front.node);
            }
        }
        let mut off = false;
        for (_, node) in worst.into_iter().filter(|w| w.1 != u32::MAX) {
            off |= self.take_off(state, node);
        }
        if off {
            self.reconnect(state);
        }
    }

    /// Adds up what the front carries: away from the choroid, along it towards the bleb, and the
    /// rim that carries it.
    fn load_front(&mut self, state: &RetinaState) {
        let (blebs, tissue) = (&self.blebs, &state.sheet);
        let push = |f: &FrontNode| {
            let pressure = state.blebs[usize::from(f.bleb)].pressure_pa;
            [self.push[f.node as usize] * pressure, Vector3::zeros()]
        };
        self.front_force.clear();
        self.front_force.extend(blebs.front.iter().map(push));
        for pull in &blebs.pulls {
            let way = at(tissue, pull.loose) - at(tissue, blebs.front[pull.front as usize].node);
            let length = way.norm();
            if length > 0.0 {
                let [force, inward] = &mut self.front_force[pull.front as usize];
                *force += way * (f64::from(self.body.solver.tension_un(pull.spring as usize)) / length);
                *inward += way / length;
            }
        }
        let carried = |(front, [force, inward]): (&FrontNode, &[Vector3<f64>; 2])| {
            let foot = at(tissue, front.node);
            let up = -foot / foot.norm();
            let along = inward - up * inward.dot(&up);
            let length = along.norm();
            let towards = if length > 0.0 { force.dot(&along) / length } else { 0.0 };
            Vector3::new(force.dot(&up), towards, front.rim_mm)
        };
        self.front_load.clear();
        self.front_load.extend(blebs.front.iter().zip(&self.front_force).map(carried));
        for _ in 0..FRONT_SMOOTHING {
            self.front_sum.clear();
            self.front_sum.extend_from_slice(&self.front_load);
            for &[a, b] in &blebs.rims {
                self.front_sum[a as usize] += self.front_load[b as usize];
                self.front_sum[b as usize] += self.front_load[a as usize];
            }
            std::mem::swap(&mut self.front_sum, &mut self.front_load);
        }
    }

    /// What a front node would release if it came off, µN/mm. One that loose nodes surround holds
    /// no rim, and lets go.
    fn release_of(&self, slot: usize) -> f64 {
        let load = &self.front_load[slot];
        if load.z > 0.0 {
            self.figures.release_un_per_mm(load.x / load.z, load.y / load.z)
        } else if load.x > 0.0 {
            f64::MAX
        } else {
            0.0
        }
    }

    /// Largest release of the front against the adhesion; 1 is about to come off. For judging a
    /// state, not part of a step.
    pub fn front_load(&mut self, state: &RetinaState) -> f64 {
        self.load_front(state);
        let all = (0..self.blebs.front.len()).map(|slot| self.release_of(slot));
        all.fold(0.0, f64::max) / self.figures.adhesion_un_per_mm
    }

    /// Takes every node within `d_mm` of `from` off the choroid, and `nearest` in any case.
    pub(super) fn take_off_around(
        &mut self,
        state: &mut RetinaState,
        from: &Vector3<f64>,
        d_mm: f64,
        nearest: u32,
    ) {
        let mut off = false;
        for n in 0..self.body.mesh.nodes() as u32 {
            let near = n == nearest || (at(&state.sheet, n) - from).norm_squared() <= d_mm * d_mm;
            off |= near && self.take_off(state, n);
        }
        if off {
            self.reconnect(state);
        }
    }

    /// Takes a node off the choroid; `true` if it held, and is not one that always does.
    fn take_off(&mut self, state: &mut RetinaState, node: u32) -> bool {
        let n = node as usize;
        let held = state.sheet.flag[n] == NODE_PINNED && !self.fixed[n];
        if held {
            state.sheet.flag[n] = NODE_FREE;
            self.body.counts.detached.add(1, n);
        }
        held
    }

    /// Under air, what has come near the choroid beside retina that lies on it lies on too; and all
    /// of a bleb of which only a film is left.
    pub(super) fn attach_under_air(&mut self, state: &mut RetinaState) {
        let mut laid = false;
        for bleb in 0..self.blebs.count() {
            let film = state.blebs[bleb].volume_mm3 < FILM_MM * self.blebs.area_mm2[bleb];
            for i in 0..self.blebs.nodes_of(bleb).len() {
                let n = self.blebs.nodes_of(bleb)[i];
                laid |= (film || self.beside_lying(state, n)) && self.attach(state, n);
            }
        }
        if laid {
            self.reconnect(state);
        }
    }

    fn beside_lying(&self, state: &RetinaState, node: u32) -> bool {
        let mesh = &self.body.mesh;
        let mut around = mesh.triangles_of(node as usize).iter().flat_map(|&t| mesh.triangles[t as usize]);
        around.any(|n| state.sheet.flag[n as usize] == NODE_PINNED)
    }

    /// Attaches a free node that is near enough to the choroid; `true` if it was.
    pub(super) fn attach(&mut self, state: &mut RetinaState, node: u32) -> bool {
        let near = at(&state.sheet, node).norm() >= self.figures.radius_mm - self.figures.scene.lie_on_mm;
        if state.sheet.flag[node as usize] != NODE_FREE || !near {
            return false;
        }
        lay(&mut state.sheet, node, self.figures.radius_mm);
        state.sheet.flag[node as usize] = NODE_PINNED;
        self.counts.attached.add(1, node as usize);
        true
    }

    /// Finds the blebs again after flags or triangles changed, and hands the fluid on: each new bleb
    /// has what is under it, and what an old bleb's account differs from its mesh goes with its
    /// first loose node. What no bleb can take has leaked.
    pub(super) fn reconnect(&mut self, state: &mut RetinaState) {
        let old_count = state.blebs.len();
        let mut old = [(Bleb::default(), 0.0, 0u8); MAX_BLEBS];
        for (bleb, entry) in old.iter_mut().enumerate().take(old_count) {
            // Account, account less mesh, new bleb.
            let rest = state.blebs[bleb].volume_mm3 - self.measured_mm3(state, bleb);
            *entry = (state.blebs[bleb], rest, 0);
        }
        self.blebs.find(&self.body.mesh, state, &self.home_mm2);
        let mut parent = [0u8; MAX_BLEBS];
        for n in 0..self.body.mesh.nodes() {
            let (new, was) = (self.blebs.label[n], state.bleb_of[n]);
            if new > 0 && was > 0 {
                let (home, parent) = (&mut old[usize::from(was) - 1].2, &mut parent[usize::from(new) - 1]);
                *home = if *home == 0 { new } else { *home };
                *parent = if *parent == 0 { was } else { *parent };
            }
        }
        state.sheet.topology += 1;
        state.bleb_of.copy_from_slice(&self.blebs.label);
        self.hand_on(state, &old[..old_count], &parent);
        self.body.refresh(&state.sheet);
    }

    fn hand_on(&mut self, state: &mut RetinaState, old: &[(Bleb, f64, u8)], parent: &[u8; MAX_BLEBS]) {
        let all: f64 = old.iter().map(|(bleb, ..)| bleb.volume_mm3).sum();
        state.blebs.clear();
        for (new, was) in parent.iter().enumerate().take(self.blebs.count()) {
            let mine = || old.iter().filter(|o| usize::from(o.2) == new + 1);
            let rest: f64 = mine().map(|o| o.1).sum();
            // Pressures mix by volume; a piece that broke off has that of the whole.
            let weight = |o: &(Bleb, f64, u8)| o.0.volume_mm3.max(f64::MIN_POSITIVE);
            let weights: f64 = mine().map(weight).sum();
            let mixed: f64 = mine().map(|o| o.0.pressure_pa * (weight(o) / weights)).sum();
            let inherited = was.checked_sub(1).map_or(0.0, |was| old[usize::from(was)].0.pressure_pa);
            let volume_mm3 = self.measured_mm3(state, new) + rest;
            let pressure_pa = if mine().next().is_some() { mixed } else { inherited };
            state.blebs.push(Bleb { volume_mm3, pressure_pa, torn_mm2: self.blebs.torn_mm2[new] });
            let merged = mine().count().saturating_sub(1) as u32;
            if merged > 0 {
                self.counts.merged = (self.counts.merged.0 + merged, volume_mm3);
            }
        }
        // What is left over: films under retina that lies on now, and the last bits of the sums.
        let mut left = all - state.under_mm3();
        let films: f64 = old.iter().filter(|o| o.2 == 0).map(|o| o.0.volume_mm3).sum();
        let largest = (0..state.blebs.len())
            .reduce(|a, b| if state.blebs[b].volume_mm3 > state.blebs[a].volume_mm3 { b } else { a });
        if let Some(largest) = largest {
            state.blebs[largest].volume_mm3 += left - films;
            left = films;
        }
        state.account.leaked_mm3 += left;
    }
}
