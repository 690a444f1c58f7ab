//! Moves the sheet by one substep: Hooke springs with damping, Euler, limits.
//!
//! A spring of stiffness k (µN/mm), rest length l₀ and damping c (µN·s/mm) between nodes a and b
//! with u = (x_b − x_a)/l pulls a towards b with
//!
//! ```text
//! f = k (l − l₀) + c u·(v_b − v_a)
//! a = f/m − g v,  |a| ≤ a_max            g: damping by the fluid, 1/s
//! v ← v + a dt,   |v| ≤ v_max
//! x ← x + v dt,   |x| ≤ R                the retina; semi-implicit: the new velocity, explicit: the old one
//! ```
//!
//! v_max = 0 is the paper's quasi-static system: all kinetic energy is gone within a step, x moves
//! by a dt² and the velocity is 0. How small dt must be: [`super::material`].
//!
//! Forces come from the packed springs of [`super::spring_packing`], sixteen at a time
//! ([`super::simd`]); sums have a fixed order, so that every instruction set gives the same bits.
//! Dead springs have k = c = 0, immobile nodes mobility 0.

pub use super::material::Material;
use super::mesh::SheetMesh;
use super::simd::aligned::Aligned;
pub use super::simd::kernel::Alarms;
use super::simd::kernel::Forces;
use super::simd::motion::Motion;
use super::simd::{Isa, WIDE};
use super::spring_packing::SpringPacking;
use crate::constants::TINY_LENGTH2_MM2;
use crate::sheet::state::{SheetState, is_bound};
use protocol::scene::NODE_FREE;

/// Arrays that live for a substep, and figures derived from the living springs and nodes.
#[derive(Debug)]
pub struct Solver {
    isa: Isa,
    packing: SpringPacking,
    mobile: Aligned,
    /// Forces on each node from outside the sheet, µN: set by others before [`Self::accelerate`],
    /// which adds them to the springs' forces. They stay until they are changed or
    /// [cleared](Self::clear_outer).
    pub outer_un: [Vec<f32>; 3],
    /// What those grow by against the way of each node in a substep, µN/mm: for integrators that
    /// look ahead, and empty without one.
    pub outer_un_per_mm: Vec<f32>,
    /// Sum of the springs' and the outer forces on each node, µN: what a pin or a jaw that holds it
    /// must bear.
    pub force_un: [Aligned; 3],
    acceleration: [Aligned; 3],
    /// Square of each node's acceleration, mm²/s⁴.
    pub acceleration2: Aligned,
    /// Forces on pinned and dead nodes are left out.
    without_pinned: bool,
}

impl Solver {
    /// Arrays for a sheet. Nothing pulls until [`Self::refresh`].
    pub fn new(mesh: &SheetMesh) -> Self {
        let nodes = mesh.nodes();
        let list = || Aligned::new(nodes, 0.0);
        let three = || std::array::from_fn(|_| list());
        Solver {
            isa: Isa::best(),
            packing: SpringPacking::new(nodes, &mesh.springs[..mesh.structural]),
            mobile: list(),
            outer_un_per_mm: Vec::new(),
            outer_un: std::array::from_fn(|_| vec![0.0; nodes]),
            force_un: three(),
            acceleration: three(),
            acceleration2: list(),
            without_pinned: false,
        }
    }

    /// For a sheet that is mostly pinned and whose pin forces are not needed: leaves out blocks
    /// of nodes that are all pinned or dead from the next [`Self::refresh`] on. Springs that only
    /// they have neither pull nor tear.
    pub fn without_pinned(mut self) -> Self {
        self.without_pinned = true;
        self
    }

    /// Derives stiffness, rest lengths and mobility again after springs or flags have changed. The
    /// first call of a tissue that bends packs the bending springs too; no other allocates.
    pub fn refresh(&mut self, mesh: &SheetMesh, state: &SheetState, material: &Material) {
        if material.bending > 0.0 && self.packing.slot_of.len() < mesh.springs.len() {
            self.packing = SpringPacking::new(mesh.nodes(), &mesh.springs);
        }
        let tables = &mut self.packing.tables;
        for (s, &slot) in self.packing.slot_of.iter().enumerate() {
            let slot = slot as usize;
            (tables.stiffness[slot], tables.damping[slot]) = material.spring(mesh, state, s);
            tables.rest[slot] = state.rest_mm.get(s).copied().unwrap_or(mesh.rest_mm[s]);
            let tears = s < mesh.structural && state.spring_alive[s] != 0;
            tables.limit[slot] =
                if tears { material.tear_un_per_mm * mesh.rest_mm[s] } else { f32::INFINITY };
        }
        for (mobile, &flag) in self.mobile.iter_mut().zip(&state.flag) {
            *mobile = if flag == NODE_FREE { 1.0 } else { 0.0 };
        }
        if self.without_pinned {
            let wanted = |node: usize| state.flag[node] == NODE_FREE || is_bound(state.flag[node]);
            self.packing.tables.work_for(wanted);
            for node in (0..state.nodes()).filter(|&node| !wanted(node)) {
                self.hold_still(node);
            }
        }
    }

    /// Makes room for what outer forces grow by.
    pub fn look_ahead(&mut self) {
        self.outer_un_per_mm.resize(self.outer_un[0].len(), 0.0);
    }

    /// Takes all outer forces away.
    pub fn clear_outer(&mut self) {
        self.outer_un.iter_mut().for_each(|f| f.fill(0.0));
        self.outer_un_per_mm.fill(0.0);
    }

    /// Forces and accelerations of every node.
    pub fn accelerate(&mut self, mesh: &SheetMesh, state: &SheetState, material: &Material) -> Alarms {
        debug_assert_eq!(mesh.nodes(), self.mobile.len());
        self.packing.tables.accelerate(
            self.isa,
            &mut Forces {
                position: state.position_mm.each_ref().map(Vec::as_slice),
                velocity: state.velocity_mm_s.each_ref().map(Vec::as_slice),
                outer: self.outer_un.each_ref().map(Vec::as_slice),
                mobile: &self.mobile,
                force: self.force_un.each_mut().map(|v| &mut **v),
                acceleration: self.acceleration.each_mut().map(|v| &mut **v),
                acceleration2: &mut self.acceleration2,
                inverse_mass: material.inverse_mass,
                fluid_per_s: material.fluid_per_s,
                tear2: material.a_tear * material.a_tear,
                tiny2: TINY_LENGTH2_MM2,
            },
        )
    }

    /// Elastic pull of a spring at the last [`Self::accelerate`], µN; 0 for bending springs of a
    /// tissue that does not bend.
    pub fn tension_un(&self, spring: usize) -> f32 {
        self.packing.slot_of.get(spring).map_or(0.0, |&slot| self.packing.tables.pull[slot as usize])
    }

    /// True where a spring's tension passes its limit.
    pub fn over_tension(&self, spring: usize) -> bool {
        let tables = &self.packing.tables;
        self.packing.slot_of.get(spring).is_some_and(|&s| tables.pull[s as usize] > tables.limit[s as usize])
    }

    /// Takes a node out of this substep.
    pub fn hold_still(&mut self, node: usize) {
        self.acceleration.iter_mut().for_each(|a| a[node] = 0.0);
        self.acceleration2[node] = 0.0;
    }

    /// Lets the rest lengths of overstretched springs follow by the creep of a time step; in
    /// `state` too.
    pub fn creep(&mut self, mesh: &SheetMesh, state: &mut SheetState, material: &Material) {
        let tables = &mut self.packing.tables;
        let share = (material.creep_per_s * material.dt_s).min(1.0);
        for (s, rest) in state.rest_mm.iter_mut().enumerate().take(mesh.structural) {
            let slot = self.packing.slot_of[s] as usize;
            let (pull, stiffness) = (tables.pull[slot], tables.stiffness[slot]);
            let stretch = if stiffness > 0.0 { pull / stiffness } else { 0.0 };
            let beyond = stretch.abs() - material.yield_strain * *rest;
            if beyond > 0.0 && beyond.is_finite() {
                let crept = *rest + beyond.copysign(stretch) * share;
                // A spring never forgets more than nine tenths of its length, nor grows beyond ten
                // times.
                let first = mesh.rest_mm[s];
                *rest = crept.clamp(0.1 * first, 10.0 * first);
                tables.rest[slot] = *rest;
            }
        }
    }

    /// Moves the free nodes, within the limits and inside the retina.
    pub fn integrate(&mut self, state: &mut SheetState, material: &Material) {
        let mut motion = Motion {
            acceleration: self.acceleration.each_ref().map(|v| &**v),
            acceleration2: &self.acceleration2,
            mobile: &self.mobile,
            position: state.position_mm.each_mut().map(Vec::as_mut_slice),
            velocity: state.velocity_mm_s.each_mut().map(Vec::as_mut_slice),
        };
        if motion.advance(self.isa, material) {
            self.stay_inside(state, material.radius_mm);
        }
    }

    /// Puts free nodes that passed the retina back on it and takes their outward velocity.
    pub fn stay_inside(&self, state: &mut SheetState, radius: f32) {
        let nodes = state.nodes();
        for from in (0..nodes).step_by(WIDE) {
            let block = from..nodes.min(from + WIDE);
            // Most blocks are passed over, all of their nodes at a time.
            let [x, y, z] = state.position_mm.each_ref().map(|axis| &axis[block.clone()]);
            let squares = x.iter().zip(y).zip(z).map(|((x, y), z)| x * x + y * y + z * z);
            if squares.fold(false, |any, r2| any | (r2 > radius * radius)) {
                block.for_each(|node| self.put_back(state, node, radius));
            }
        }
    }

    fn put_back(&self, state: &mut SheetState, node: usize, radius: f32) {
        let p = state.position(node);
        let r2 = p.dot(&p);
        if r2 > radius * radius && self.mobile[node] > 0.0 {
            let out = p / r2.sqrt();
            state.set_position(node, out * radius);
            let v = state.velocity(node);
            let outward = v.dot(&out);
            if outward > 0.0 {
                state.set_velocity(node, v - out * outward);
            }
        }
    }
}

#[cfg(test)]
mod tests;
