//! The fluid: what flows in and out, and the volumes that the mesh is kept at.
//!
//! A bleb's volume is a constraint. After the springs have moved the nodes, each loose node is
//! moved along the push p_i of the fluid (the force of 1 Pa on it, [`super::volume`]) until the
//! measured volume V is the account's V₀; the same impulse goes into the velocity, and the pressure
//! is what makes that impulse:
//!
//! ```text
//! λ = (V₀ − V) / Σ p_i²        x_i += λ p_i,   v_i += λ p_i / dt,   P = λ m / dt²
//! ```
//!
//! over the free nodes (a held one does not yield, nor does one that lies on the choroid while the
//! volume must shrink). One such step leaves an error of second order; at the end of a field's step
//! it is repeated until the rounding of the positions is reached.
//!
//! A bleb that gapes ([`Blebs::open`](super::blebs::Pieces::open)), such as a retina that was cut
//! all round, holds no pressure: its account follows its mesh, and what passes the gap is leaked.
//! Only a fluid–air exchange drives it to the choroid, at the flow of the air pump. At a gap the
//! triangles do not surround their nodes, so that the parts of the feet do not cancel and p_i is
//! not ∂V/∂x_i. A velocity α p_i of all nodes takes α dt Σ p_i·∂V/∂x_i from the volume, and the
//! correction makes of it
//!
//! ```text
//! α ← (1 − c) α        c = Σ p_i·∂V/∂x_i / Σ p_i²
//! ```
//!
//! which grows unless 0 < c < 2: a retina that stands far off the choroid would fly apart. There,
//! and where more is missing than the pump drives in [`OPEN_LAG_S`], air gets under it through the
//! gap, and the pump lays it on along the radius, where the feet stay and p_i is the derivative of
//! V; it moves places alone, no more than its flow, and gives no velocity.

use super::figures::{
    EXCHANGE_MM3_S, Figures, LARGEST_LOSS, OPEN_LAG_S, PRESSURE_S, VOLUME_ERROR_MM3, VOLUME_TRIES,
};
use super::state::{Bleb, RetinaState};
use super::volume::{Block, at, slope, under_triangle};
use super::{Retina, front};
use crate::constants::SUBSTEP_S;
use nalgebra::Vector3;
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;

impl Retina {
    /// Lets fluid in through needles at `pressure_pa` (`None`: not through this one) and out
    /// through holes and tears, for one substep.
    pub fn flow(&mut self, state: &mut RetinaState, pressure_pa: [Option<f64>; INSTRUMENTS]) {
        for (i, pressure) in pressure_pa.into_iter().enumerate() {
            let bleb = self.blebs.label[state.needles[i].node as usize];
            let (Some(pressure), 1..) = (pressure, bleb) else { continue };
            let bleb = &mut state.blebs[usize::from(bleb) - 1];
            let flow = self.figures.flow_mm3_s(pressure, bleb.pressure_pa);
            bleb.volume_mm3 += flow * SUBSTEP_S;
            state.account.injected_mm3 += flow * SUBSTEP_S;
            state.needles[i].injected_mm3 += flow * SUBSTEP_S;
            self.counts.flow_mm3_s[i] = self.counts.flow_mm3_s[i].max(flow);
        }
        self.leak(state);
    }

    /// Holes close on their own to a rest, unless air holds them open; a needle in its hole plugs
    /// it.
    fn leak(&mut self, state: &mut RetinaState) {
        let (full, scene) = (self.figures.hole_mm2, &self.figures.scene);
        let rest = full * scene.hole_open_share;
        let closing = (SUBSTEP_S / scene.hole_close_s).min(1.0);
        for hole in &mut state.holes {
            let plugged = state.needles.iter().any(|n| n.inside && n.entry_mm == hole.at_mm);
            hole.open_mm2 += (rest - hole.open_mm2) * if plugged { 0.0 } else { closing };
            let bleb = self.blebs.label[hole.node as usize];
            if !plugged && bleb > 0 {
                let bleb = &mut state.blebs[usize::from(bleb) - 1];
                let area = if state.air { full } else { hole.open_mm2 };
                state.account.leaked_mm3 += bleb.lose(self.figures.leaks_mm3(bleb, area, state.air));
            }
        }
        for (number, (bleb, area_mm2)) in state.blebs.iter_mut().zip(&self.blebs.area_mm2).enumerate() {
            if self.blebs.open[number] {
                let driven = if state.air { EXCHANGE_MM3_S * SUBSTEP_S } else { 0.0 };
                state.account.leaked_mm3 += bleb.lose(driven);
            } else if bleb.torn_mm2 > 0.0 {
                let leaks = self.figures.leaks_mm3(bleb, bleb.torn_mm2, state.air);
                state.account.leaked_mm3 += bleb.lose(leaks);
            }
            if state.air && bleb.pressure_pa + scene.air_pa > 0.0 {
                let seeps = area_mm2 * scene.seep_um_per_s * 1e-3 * SUBSTEP_S;
                state.account.leaked_mm3 += bleb.lose(seeps);
            }
        }
    }

    /// Volume under a bleb as the mesh has it, mm³.
    pub fn measured_mm3(&self, state: &RetinaState, bleb: usize) -> f64 {
        let triangles = self.blebs.triangles_of(bleb).iter().filter(|&&t| self.spans(state, bleb, t));
        triangles.map(|&t| under_triangle(&self.corners(state, t), self.figures.radius_mm)).sum()
    }

    /// True if a triangle of a bleb has fluid under it: a dead one is a film over the gap, unless
    /// the bleb is open.
    fn spans(&self, state: &RetinaState, bleb: usize, triangle: u32) -> bool {
        !self.blebs.open[bleb] || state.sheet.triangle_alive[triangle as usize] != 0
    }

    /// Lets an open bleb's account follow its mesh; with air in the eye fluid only leaves.
    fn level(&self, state: &mut RetinaState, bleb: usize) {
        let passed = state.blebs[bleb].volume_mm3 - self.measured_mm3(state, bleb);
        if !state.air || passed > 0.0 {
            state.leak(bleb, passed);
        }
    }

    /// Volume under the whole retina as the mesh has it, mm³.
    pub fn measured_all_mm3(&self, state: &RetinaState) -> f64 {
        (0..self.blebs.count()).map(|b| self.measured_mm3(state, b)).sum()
    }

    pub(super) fn corners(&self, state: &RetinaState, triangle: u32) -> [Vector3<f64>; 3] {
        self.body.mesh.triangles[triangle as usize].map(|n| at(&state.sheet, n))
    }

    /// Brings every bleb to its account's volume, once, and takes the pressure from what that
    /// takes.
    pub(super) fn hold_volumes(&mut self, state: &mut RetinaState) {
        self.clear_push();
        for bleb in 0..self.blebs.count() {
            if self.blebs.open[bleb] {
                self.level(state, bleb);
                if !state.air {
                    state.blebs[bleb].pressure_pa = 0.0;
                    continue;
                }
            }
            let missing = self.gather(state, bleb);
            let lambda = self.correct(state, bleb, missing, Some(SUBSTEP_S));
            let pressure_pa = lambda * self.figures.scene.node_mass_g / (SUBSTEP_S * SUBSTEP_S);
            let kept = &mut state.blebs[bleb].pressure_pa;
            *kept += (pressure_pa - *kept) * (SUBSTEP_S / PRESSURE_S);
        }
    }

    /// Brings every bleb to its account's volume as nearly as f32 positions can.
    pub(super) fn settle_volumes(&mut self, state: &mut RetinaState) {
        for bleb in 0..self.blebs.count() {
            if self.blebs.open[bleb] {
                self.level(state, bleb);
            }
            for _ in 0..VOLUME_TRIES {
                self.clear_push();
                let missing = self.gather(state, bleb);
                if missing.abs() <= VOLUME_ERROR_MM3 || self.correct(state, bleb, missing, None) == 0.0 {
                    break;
                }
            }
            // Jaws that hold every node of a bleb decide its volume: they press out what does not
            // fit, or draw in what is lacking.
            let free = |n: &u32| state.sheet.flag[*n as usize] == NODE_FREE;
            if !self.blebs.nodes_of(bleb).iter().any(free) {
                let pressed = state.blebs[bleb].volume_mm3 - self.measured_mm3(state, bleb);
                state.leak(bleb, pressed);
            }
        }
    }

    fn clear_push(&mut self) {
        for &t in (0..self.blebs.count()).flat_map(|b| self.blebs.triangles_of(b)) {
            for n in self.body.mesh.triangles[t as usize] {
                self.push[n as usize] = Vector3::zeros();
            }
        }
    }

    /// Moves the free nodes of a bleb along the gathered push until the missing volume is there to
    /// first order; with `dt_s` their velocities too, but of an open bleb only where that is
    /// stable. Returns λ, 1/mm; 0 where nothing can yield, or no pressure holds it.
    fn correct(
        &mut self,
        state: &mut RetinaState,
        bleb: usize,
        mut missing_mm3: f64,
        dt_s: Option<f64>,
    ) -> f64 {
        let radius = self.figures.radius_mm;
        let steady = !self.blebs.open[bleb] || self.is_steady(state, bleb, missing_mm3);
        if !steady {
            missing_mm3 = self.let_air_under(state, bleb, missing_mm3);
        }
        let (mut yields, mut longest2) = (0.0, 0.0);
        for &n in self.blebs.nodes_of(bleb) {
            if self.yields(state, n, missing_mm3) {
                let square = self.push[n as usize].norm_squared();
                yields += square;
                longest2 = if square > longest2 { square } else { longest2 };
            }
        }
        let lambda = missing_mm3 / yields;
        if !lambda.is_finite() {
            return 0.0;
        }
        let most = self.figures.scene.v_max_mm_s * SUBSTEP_S / libm::sqrt(longest2);
        let lambda = lambda.clamp(-most, most);
        for &n in self.blebs.nodes_of(bleb) {
            if state.sheet.flag[n as usize] == NODE_FREE {
                let way = self.push[n as usize] * lambda;
                front::shift(&mut state.sheet, n, &way, dt_s.filter(|_| steady), radius);
            }
        }
        if steady || dt_s.is_none() { lambda } else { 0.0 }
    }

    /// Adds up the push on the nodes of a bleb; returns what is missing of its volume, mm³.
    fn gather(&mut self, state: &RetinaState, bleb: usize) -> f64 {
        let mut push = std::mem::take(&mut self.push);
        let triangles = self.blebs.triangles_of(bleb).iter().filter(|&&t| self.spans(state, bleb, t));
        let triangles = triangles.map(|&t| &self.body.mesh.triangles[t as usize]);
        let measured = Block::gather(self.simd, &state.sheet, triangles, self.figures.radius_mm, &mut push);
        self.push = push;
        state.blebs[bleb].volume_mm3 - measured
    }

    /// True if a node gives way to what is missing: one on the choroid cannot downwards. One
    /// nanometre separates lying from hovering.
    fn yields(&self, state: &RetinaState, node: u32, missing_mm3: f64) -> bool {
        let lies = missing_mm3 < 0.0 && at(&state.sheet, node).norm() >= self.figures.radius_mm - 1e-6;
        state.sheet.flag[node as usize] == NODE_FREE && !lies
    }

    /// True if corrections along the gathered push make an open bleb's velocities no larger (0 < c
    /// < 2), and the pump keeps up.
    fn is_steady(&self, state: &RetinaState, bleb: usize, missing_mm3: f64) -> bool {
        let (mut made, mut wanted) = (0.0, 0.0);
        for &t in self.blebs.triangles_of(bleb) {
            if !self.spans(state, bleb, t) {
                continue;
            }
            let nodes = self.body.mesh.triangles[t as usize];
            let [a, b, c] = nodes.map(|n| at(&state.sheet, n));
            for (n, corners) in nodes.into_iter().zip([[a, b, c], [b, c, a], [c, a, b]]) {
                if self.yields(state, n, missing_mm3) {
                    made += self.push[n as usize].dot(&slope(&corners, self.figures.radius_mm));
                }
            }
        }
        for &n in self.blebs.nodes_of(bleb) {
            if self.yields(state, n, missing_mm3) {
                wanted += self.push[n as usize].norm_squared();
            }
        }
        missing_mm3.abs() <= EXCHANGE_MM3_S * OPEN_LAG_S && made > 0.0 && made < 2.0 * wanted
    }

    /// Leaves of an open bleb's push the part along the radius, and of what is missing what the
    /// pump drives in a substep: for the rest air gets under it. Returns what is missing then, mm³.
    fn let_air_under(&mut self, state: &mut RetinaState, bleb: usize, missing_mm3: f64) -> f64 {
        for &n in self.blebs.nodes_of(bleb) {
            let (push, foot) = (&mut self.push[n as usize], at(&state.sheet, n));
            let length2 = foot.norm_squared();
            *push = if length2 > 0.0 { foot * (push.dot(&foot) / length2) } else { Vector3::zeros() };
        }
        let driven = EXCHANGE_MM3_S * SUBSTEP_S;
        let passed = missing_mm3 - missing_mm3.clamp(-driven, driven);
        state.leak(bleb, passed);
        missing_mm3 - passed
    }
}

impl Figures {
    /// What would leak out of a bleb through `area_mm2` in a substep, mm³ (below 0 for what it
    /// sucks in).
    fn leaks_mm3(&self, bleb: &Bleb, area_mm2: f64, air: bool) -> f64 {
        let pressure = bleb.pressure_pa + if air { self.scene.air_pa } else { 0.0 };
        Figures::leak_mm3_s(area_mm2, pressure) * SUBSTEP_S
    }
}

impl Bleb {
    /// Takes `wanted_mm3` out, at most [`LARGEST_LOSS`]; returns what went, mm³.
    fn lose(&mut self, wanted_mm3: f64) -> f64 {
        let lost = wanted_mm3.min(LARGEST_LOSS * self.volume_mm3.max(0.0));
        self.volume_mm3 -= lost;
        lost
    }
}
