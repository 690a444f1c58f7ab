//! Moves the sheet by one substep: Hooke springs with damping, semi-implicit Euler, limits.
//!
//! A spring of stiffness k (µN/mm), rest length l₀ and damping c (µN·s/mm) between nodes a and b
//! with u = (x_b − x_a)/l pulls a towards b with
//!
//! ```text
//! f = k (l − l₀) + c u·(v_b − v_a)
//! a = f/m − g v,  |a| ≤ a_max            g: damping by the fluid, 1/s
//! v ← v + a dt,   |v| ≤ v_max            semi-implicit: the new velocity moves the node
//! x ← x + v dt,   |x| ≤ R                the retina
//! ```
//!
//! Explicit Euler moves x by the old velocity instead. v_max = 0 is the paper's quasi-static system: all kinetic energy is gone within a step, x moves by
//! a dt² and the velocity is 0. Stable while dt²·λ + 2·dt·δ < 4 with λ ≤ 2Σk/m and δ ≤ 2Σc/m + g
//! (Σ over the springs of a node; Gershgorin), quasi-static while dt²·λ < 2.
//!
//! Layout: x, y and z in arrays of their own, springs in runs (see [`super::sheet`]), so that
//! the inner loops are element-wise over consecutive f32 and compilers vectorise them without
//! changing a bit; sums have a fixed order. Dead springs have k = c = 0, immobile nodes mobility 0.

use super::sheet::{Run, Sheet};
use crate::constants::{SUBSTEP_S, TINY_LENGTH2_MM2};
use crate::state::MembraneState;
use protocol::scene::NODE_FREE;
use protocol::scene_file::{MembraneIntegrator, MembraneScene, SceneFile};

/// Figures of the tissue as the solver needs them.
#[derive(Debug, Clone, Copy)]
pub struct Tissue {
    /// Substep, s.
    pub dt_s: f32,
    /// 1/g.
    pub inverse_mass: f32,
    /// 1/s.
    pub fluid_per_s: f32,
    /// mm/s².
    pub a_max: f32,
    /// mm/s; 0 is quasi-static.
    pub v_max: f32,
    /// Acceleration at which a node's hardest pulling spring tears, mm/s².
    pub a_tear: f32,
    /// Radius of the retina, mm.
    pub radius_mm: f32,
    stiffness: f32,
    bending: f32,
    damping: f32,
    /// Tension per length at which a spring tears, µN/mm; infinite when the rule is off.
    tear_un_per_mm: f32,
    /// The old velocity moves the nodes.
    pub explicit: bool,
    /// Strain over which springs are drawn together again; 0 for no limit.
    pub strain_limit: f32,
}

impl Tissue {
    const INERT: Tissue = Tissue {
        dt_s: SUBSTEP_S as f32,
        inverse_mass: 0.0,
        fluid_per_s: 0.0,
        a_max: 0.0,
        v_max: 0.0,
        a_tear: f32::INFINITY,
        radius_mm: f32::INFINITY,
        stiffness: 0.0,
        bending: 0.0,
        damping: 0.0,
        tear_un_per_mm: f32::INFINITY,
        explicit: false,
        strain_limit: 0.0,
    };

    /// The tissue of a scene; of one without a membrane, figures that move nothing.
    pub fn new(scene: &SceneFile) -> Self {
        let radius_mm = scene.eye.retina_radius_mm as f32;
        scene.membrane.as_ref().map_or(Self { radius_mm, ..Self::INERT }, |m| Self::of(m, radius_mm))
    }

    fn of(m: &MembraneScene, radius_mm: f32) -> Self {
        let tear = if m.tear_tension_n_per_m > 0.0 { m.tear_tension_n_per_m * 1e3 } else { f64::INFINITY };
        Tissue {
            dt_s: SUBSTEP_S as f32,
            inverse_mass: (1.0 / m.node_mass_g) as f32,
            fluid_per_s: m.fluid_damping_per_s as f32,
            a_max: m.a_max_mm_s2 as f32,
            v_max: m.v_max_mm_s as f32,
            a_tear: (m.a_max_mm_s2 * (1.0 + m.p_tear)) as f32,
            radius_mm,
            stiffness: m.stiffness_un_per_mm as f32,
            bending: m.bending_un_per_mm as f32,
            damping: m.spring_damping_un_s_per_mm as f32,
            tear_un_per_mm: tear as f32,
            explicit: m.integrator == MembraneIntegrator::Explicit,
            strain_limit: m.strain_limit as f32,
        }
    }

    /// Stiffness (µN/mm) and damping (µN·s/mm) of a spring of the sheet; 0 where it is not alive.
    pub fn spring(&self, sheet: &Sheet, state: &MembraneState, s: usize) -> (f32, f32) {
        let (alive, stiffness) = match s.checked_sub(sheet.structural) {
            None => (state.spring_alive[s] != 0, self.stiffness),
            Some(bend) => (sheet.bends[bend].is_whole(state) && self.bending > 0.0, self.bending),
        };
        if !alive {
            return (0.0, 0.0);
        }
        let share = if self.stiffness > 0.0 { stiffness / self.stiffness } else { 1.0 };
        let factor = |list: &[f32]| list.get(s).copied().unwrap_or(1.0);
        (stiffness * factor(&sheet.stiffness_factor), self.damping * share * factor(&sheet.damping_factor))
    }
}

/// What the forces of a substep demand besides moving.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Alarms {
    /// A node's acceleration is not a number, or infinite.
    pub not_finite: bool,
    /// A node's acceleration passes the limit of tearing.
    pub over_acceleration: bool,
    /// A spring's tension passes its limit.
    pub over_tension: bool,
}

/// Arrays that live for a substep, and figures derived from the living springs and nodes.
#[derive(Debug)]
pub struct Solver {
    stiffness: Vec<f32>,
    damping: Vec<f32>,
    tension_limit: Vec<f32>,
    mobile: Vec<f32>,
    row: [Vec<f32>; 3],
    /// Elastic pull of each spring, µN.
    pub tension_un: Vec<f32>,
    /// Forces on each node from outside the sheet, µN: set by others before [`Self::accelerate`], which adds them to the
    /// springs' forces. They stay until they are changed or [cleared](Self::clear_outer).
    pub outer_un: [Vec<f32>; 3],
    /// Sum of the springs' and the outer forces on each node, µN.
    pub force_un: [Vec<f32>; 3],
    acceleration: [Vec<f32>; 3],
    /// Square of each node's acceleration, mm²/s⁴.
    pub acceleration2: Vec<f32>,
}

impl Solver {
    /// Arrays for a sheet.
    pub fn new(sheet: &Sheet) -> Self {
        let (springs, nodes) = (sheet.springs.len(), sheet.nodes());
        let longest = sheet.runs.iter().map(|r| r.len).max().unwrap_or(0) as usize;
        let three = |n: usize| std::array::from_fn(|_| vec![0.0; n]);
        Solver {
            stiffness: vec![0.0; springs],
            damping: vec![0.0; springs],
            tension_limit: vec![f32::INFINITY; springs],
            mobile: vec![0.0; nodes],
            row: three(longest),
            tension_un: vec![0.0; springs],
            outer_un: three(nodes),
            force_un: three(nodes),
            acceleration: three(nodes),
            acceleration2: vec![0.0; nodes],
        }
    }

    /// Derives stiffness and mobility anew, after springs or flags have changed.
    pub fn refresh(&mut self, sheet: &Sheet, state: &MembraneState, tissue: &Tissue) {
        for s in 0..sheet.springs.len() {
            (self.stiffness[s], self.damping[s]) = tissue.spring(sheet, state, s);
            if s < sheet.structural && state.spring_alive[s] != 0 {
                self.tension_limit[s] = tissue.tear_un_per_mm * sheet.rest_mm[s];
            } else {
                self.tension_limit[s] = f32::INFINITY;
            }
        }
        for (mobile, &flag) in self.mobile.iter_mut().zip(&state.flag) {
            *mobile = if flag == NODE_FREE { 1.0 } else { 0.0 };
        }
    }

    /// Takes all outer forces away.
    pub fn clear_outer(&mut self) {
        self.outer_un.iter_mut().for_each(|f| f.fill(0.0));
    }

    /// Forces and accelerations of every node.
    pub fn accelerate(&mut self, sheet: &Sheet, state: &MembraneState, tissue: &Tissue) -> Alarms {
        for (force, outer) in self.force_un.iter_mut().zip(&self.outer_un) {
            force.copy_from_slice(outer);
        }
        let runs = if tissue.bending > 0.0 { sheet.runs.len() } else { sheet.structural_runs() };
        for run in &sheet.runs[..runs] {
            self.pull_run(run, &sheet.rest_mm, state);
        }
        self.divide_by_mass(state, tissue);
        let squares = &self.acceleration2;
        let tear2 = tissue.a_tear * tissue.a_tear;
        // Counting instead of `any` keeps the loop free of branches.
        let infinite = squares.iter().filter(|a2| !a2.is_finite()).count();
        let over = squares.iter().filter(|&&a2| a2 > tear2).count();
        let torn = self.tension_un.iter().zip(&self.tension_limit).filter(|(t, limit)| t > limit).count();
        Alarms { not_finite: infinite > 0, over_acceleration: over > 0, over_tension: torn > 0 }
    }

    /// True where a spring's tension passes its limit.
    pub fn over_tension(&self, spring: usize) -> bool {
        self.tension_un[spring] > self.tension_limit[spring]
    }

    /// Takes a node out of this substep.
    pub fn hold_still(&mut self, node: usize) {
        self.acceleration.iter_mut().for_each(|a| a[node] = 0.0);
        self.acceleration2[node] = 0.0;
    }

    /// Adds the forces of one run of springs.
    fn pull_run(&mut self, run: &Run, rest_mm: &[f32], state: &MembraneState) {
        let (s, a, b, n) = (run.first as usize, run.a as usize, run.b as usize, run.len as usize);
        let [xa, ya, za] = state.position_mm.each_ref().map(|v| &v[a..a + n]);
        let [xb, yb, zb] = state.position_mm.each_ref().map(|v| &v[b..b + n]);
        let [ua, va, wa] = state.velocity_mm_s.each_ref().map(|v| &v[a..a + n]);
        let [ub, vb, wb] = state.velocity_mm_s.each_ref().map(|v| &v[b..b + n]);
        let (rest, k, c) = (&rest_mm[s..s + n], &self.stiffness[s..s + n], &self.damping[s..s + n]);
        let tension = &mut self.tension_un[s..s + n];
        let [fx, fy, fz] = self.row.each_mut().map(|v| &mut v[..n]);
        for j in 0..n {
            let (dx, dy, dz) = (xb[j] - xa[j], yb[j] - ya[j], zb[j] - za[j]);
            let length = (dx * dx + dy * dy + dz * dz + TINY_LENGTH2_MM2).sqrt();
            let inverse = 1.0 / length;
            let rate = ((ub[j] - ua[j]) * dx + (vb[j] - va[j]) * dy + (wb[j] - wa[j]) * dz) * inverse;
            let pull = k[j] * (length - rest[j]);
            let f = (pull + c[j] * rate) * inverse;
            tension[j] = pull;
            fx[j] = f * dx;
            fy[j] = f * dy;
            fz[j] = f * dz;
        }
        for (total, row) in self.force_un.iter_mut().zip(&self.row) {
            total[a..a + n].iter_mut().zip(row).for_each(|(t, f)| *t += f);
            total[b..b + n].iter_mut().zip(row).for_each(|(t, f)| *t -= f);
        }
    }

    fn divide_by_mass(&mut self, state: &MembraneState, tissue: &Tissue) {
        for axis in 0..3 {
            let (force, velocity) = (&self.force_un[axis], &state.velocity_mm_s[axis]);
            let acceleration = &mut self.acceleration[axis];
            let n = acceleration.len();
            let (force, velocity, mobile) = (&force[..n], &velocity[..n], &self.mobile[..n]);
            for i in 0..n {
                let a = force[i] * tissue.inverse_mass - tissue.fluid_per_s * velocity[i];
                acceleration[i] = a * mobile[i];
            }
        }
        let n = self.acceleration2.len();
        let [ax, ay, az] = self.acceleration.each_ref().map(|v| &v[..n]);
        for (i, a2) in self.acceleration2.iter_mut().enumerate() {
            *a2 = ax[i] * ax[i] + ay[i] * ay[i] + az[i] * az[i];
        }
    }

    /// Moves the free nodes, within the limits and inside the retina.
    pub fn integrate(&mut self, state: &mut MembraneState, tissue: &Tissue) {
        let n = self.acceleration2.len();
        let [ax, ay, az] = self.acceleration.each_ref().map(|v| &v[..n]);
        let (a2, mobile) = (&self.acceleration2[..n], &self.mobile[..n]);
        let [x, y, z] = state.position_mm.each_mut().map(|v| &mut v[..n]);
        let [vx, vy, vz] = state.velocity_mm_s.each_mut().map(|v| &mut v[..n]);
        let (dt, a_max, a_max2) = (tissue.dt_s, tissue.a_max, tissue.a_max * tissue.a_max);
        let (v_max, v_max2) = (tissue.v_max, tissue.v_max * tissue.v_max);
        let quasi_static = v_max == 0.0;
        let explicit = tissue.explicit && !quasi_static;
        for i in 0..n {
            let limit = if a2[i] > a_max2 { a_max / a2[i].sqrt() } else { 1.0 } * dt;
            let (px, py, pz) = (vx[i] + ax[i] * limit, vy[i] + ay[i] * limit, vz[i] + az[i] * limit);
            let v2 = px * px + py * py + pz * pz;
            let slow = if v2 > v_max2 && !quasi_static { v_max / v2.sqrt() } else { 1.0 };
            let way = if explicit { 1.0 } else { slow } * dt * mobile[i];
            let (ux, uy, uz) = if explicit { (vx[i], vy[i], vz[i]) } else { (px, py, pz) };
            (x[i], y[i], z[i]) = (x[i] + ux * way, y[i] + uy * way, z[i] + uz * way);
            let kept = if quasi_static { 0.0 } else { slow };
            (vx[i], vy[i], vz[i]) = (px * kept, py * kept, pz * kept);
        }
        self.stay_inside(state, tissue.radius_mm);
    }

    /// Puts free nodes that passed the retina back on it and takes their outward velocity.
    pub fn stay_inside(&self, state: &mut MembraneState, radius: f32) {
        for i in 0..self.mobile.len() {
            let p = state.position(i);
            let r2 = p.dot(&p);
            if r2 > radius * radius && self.mobile[i] > 0.0 {
                let out = p / r2.sqrt();
                state.set_position(i, out * radius);
                let v = state.velocity(i);
                let outward = v.dot(&out);
                if outward > 0.0 {
                    state.set_velocity(i, v - out * outward);
                }
            }
        }
    }
}

impl Sheet {
    /// Runs of structural springs; they come before those of the bending springs.
    fn structural_runs(&self) -> usize {
        self.runs.iter().take_while(|r| (r.first as usize) < self.structural).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peel(change: impl FnOnce(&mut MembraneScene)) -> (Sheet, MembraneState, Solver, Tissue) {
        let mut scene = SceneFile::load("peel").unwrap();
        change(scene.membrane.as_mut().unwrap());
        let sheet = Sheet::new(&scene);
        let state = sheet.start();
        let tissue = Tissue::new(&scene);
        let mut solver = Solver::new(&sheet);
        solver.refresh(&sheet, &state, &tissue);
        (sheet, state, solver, tissue)
    }

    fn centre(sheet: &Sheet) -> usize {
        sheet.nodes() / 2
    }

    #[test]
    fn at_rest_nothing_moves() {
        let (sheet, mut state, mut solver, tissue) = peel(|_| {});
        let before = state.clone();
        for _ in 0..100 {
            assert_eq!(solver.accelerate(&sheet, &state, &tissue), Alarms::default());
            solver.integrate(&mut state, &tissue);
        }
        for i in 0..sheet.nodes() {
            assert!((state.position(i) - before.position(i)).norm() < 1e-4);
        }
    }

    #[test]
    fn springs_obey_hooke_and_newtons_third_law() {
        let (sheet, mut state, mut solver, tissue) = peel(|m| m.bending_un_per_mm = 0.0);
        let node = centre(&sheet);
        state.position_mm[2][node] += 0.05;
        solver.accelerate(&sheet, &state, &tissue);
        let mut expected = nalgebra::Vector3::<f32>::zeros();
        for (s, ends) in sheet.springs[..sheet.structural].iter().enumerate() {
            if let Some(end) = ends.iter().position(|&n| n as usize == node) {
                let d = state.position(ends[1 - end] as usize) - state.position(node);
                expected += d.normalize() * 400.0 * (d.norm() - sheet.rest_mm[s]);
            }
        }
        let found = nalgebra::Vector3::from(solver.force_un.each_ref().map(|f| f[node]));
        assert!((found - expected).norm() < 2e-2, "{found} {expected}");
        for f in &solver.force_un {
            assert!(f.iter().sum::<f32>().abs() < 1e-2, "inner forces cancel");
        }
    }

    #[test]
    fn a_pulled_sheet_comes_to_rest_in_both_modes() {
        for v_max in [300.0, 0.0] {
            let (sheet, mut state, mut solver, tissue) = peel(|m| m.v_max_mm_s = v_max);
            let node = centre(&sheet);
            state.position_mm[2][node] += 0.1;
            let mut energy = Vec::new();
            for _ in 0..3000 {
                solver.accelerate(&sheet, &state, &tissue);
                solver.integrate(&mut state, &tissue);
                energy.push(solver.tension_un.iter().map(|t| f64::from(t * t)).sum::<f64>());
            }
            assert!(energy[2999] < energy[0] * 1e-3, "{v_max}: {} {}", energy[0], energy[2999]);
        }
    }

    #[test]
    fn limits_hold() {
        let (sheet, mut state, mut solver, tissue) = peel(|m| {
            m.a_max_mm_s2 = 1000.0;
            m.v_max_mm_s = 5.0;
        });
        let node = centre(&sheet);
        state.position_mm[2][node] += 0.2;
        let alarms = solver.accelerate(&sheet, &state, &tissue);
        assert!(alarms.over_acceleration && !alarms.not_finite);
        solver.integrate(&mut state, &tissue);
        assert!(state.velocity(node).norm() <= 1000.0 * 1e-3 * 1.001);
        state.set_velocity(node, nalgebra::Vector3::new(0.0, 0.0, 50.0));
        solver.accelerate(&sheet, &state, &tissue);
        solver.integrate(&mut state, &tissue);
        assert!(state.velocity(node).norm() <= 5.0 * 1.001);
    }

    #[test]
    fn nodes_do_not_leave_the_eye() {
        let (sheet, mut state, mut solver, tissue) = peel(|_| {});
        let node = centre(&sheet);
        state.set_velocity(node, nalgebra::Vector3::new(0.0, 0.0, -300.0));
        for _ in 0..10 {
            solver.accelerate(&sheet, &state, &tissue);
            solver.integrate(&mut state, &tissue);
            assert!(state.position(node).norm() <= 11.5 + 1e-5);
        }
    }

    #[test]
    fn a_shipped_scene_is_within_the_stability_bound() {
        let m = SceneFile::load("peel").unwrap().membrane.unwrap();
        let springs = 6.0 * m.stiffness_un_per_mm + 4.0 * m.bending_un_per_mm;
        let share = springs / m.stiffness_un_per_mm;
        let lambda = 2.0 * springs / m.node_mass_g;
        let delta = 2.0 * share * m.spring_damping_un_s_per_mm / m.node_mass_g + m.fluid_damping_per_s;
        assert!(SUBSTEP_S * SUBSTEP_S * lambda + 2.0 * SUBSTEP_S * delta < 4.0);
        assert!(SUBSTEP_S * SUBSTEP_S * lambda < 2.0);
    }
}
