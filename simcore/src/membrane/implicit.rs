//! The sheet under the integrators of [`crate::elements`]: for tissue of published stiffness and real mass,
//! where an explicit substep would have to be a hundred times shorter.
//!
//! It takes the place of [`Solver::integrate`]: forces, tensions and alarms still come from
//! [`Solver::accelerate`], so tearing by tension, the rim's and the jaws' forces work as with explicit
//! springs. Of the limits, v_max holds; a_max and with it the rule of p_tear do not: the acceleration
//! of a stiff node at the begin of a substep says nothing about where it comes to rest.
//!
//! Inside, numbers are f64; the state keeps f32. Nothing allocates after the first substep at full size.

use super::sheet::Sheet;
use super::solver::{Solver, Tissue};
use crate::elements::conjugate::Limits;
use crate::elements::integrator::{Effort, Integrator, Rule, Settings};
use crate::elements::springs::{Spring, Springs};
use crate::elements::{Nodes, Point};
use crate::state::MembraneState;
use protocol::scene::NODE_FREE;
use protocol::scene_file::MembraneIntegrator;

/// A substep of a scene: one linearised step, solved to a thousandth.
const STEP: Settings =
    Settings { newton: 1, share: 1e-6, conjugate: Limits { iterations: 200, share: 1e-3 } };
/// A quasi-static substep: towards the balance of forces, as far as so many corrections lead.
const BALANCE: Settings =
    Settings { newton: 8, share: 1e-4, conjugate: Limits { iterations: 200, share: 1e-2 } };

/// The sheet's springs and nodes in double precision, with the arrays of a substep.
#[derive(Debug, Clone)]
pub struct Implicit {
    rule: Rule,
    settings: Settings,
    nodes: Nodes,
    springs: Springs,
    integrator: Integrator,
}

impl Implicit {
    /// The integrator a scene asks for; `None` where the explicit core does it.
    pub fn of(choice: MembraneIntegrator, sheet: &Sheet) -> Option<Self> {
        match choice {
            MembraneIntegrator::SemiImplicit | MembraneIntegrator::Explicit => None,
            MembraneIntegrator::Implicit => Some(Self::new(sheet, Rule::Implicit, STEP)),
            MembraneIntegrator::QuasiStatic => Some(Self::new(sheet, Rule::QuasiStatic, BALANCE)),
        }
    }

    /// Any rule with any effort.
    pub fn new(sheet: &Sheet, rule: Rule, settings: Settings) -> Self {
        Implicit {
            rule,
            settings,
            nodes: Nodes::at_rest(vec![Point::zeros(); sheet.nodes()], 1.0),
            springs: Springs::new(vec![NO_SPRING; sheet.springs.len()]),
            integrator: Integrator::default(),
        }
    }

    /// Takes the living springs and the flags anew, after they have changed.
    pub fn refresh(&mut self, sheet: &Sheet, state: &MembraneState, tissue: &Tissue) {
        let spring = |s: usize| {
            let (stiffness, damping) = tissue.spring(sheet, state, s);
            Spring {
                ends: sheet.springs[s],
                stiffness_un_per_mm: f64::from(stiffness),
                damping_un_s_per_mm: f64::from(damping),
                rest_mm: f64::from(sheet.rest_mm[s]),
            }
        };
        let all = (0..sheet.springs.len()).map(spring);
        self.springs.replace(all.filter(|s| s.stiffness_un_per_mm > 0.0 || s.damping_un_s_per_mm > 0.0));
        for (held, &flag) in self.nodes.held.iter_mut().zip(&state.flag) {
            *held = flag != NODE_FREE;
        }
        self.nodes.mass_g.fill(1.0 / f64::from(tissue.inverse_mass));
    }

    /// Moves the free nodes by a substep, within v_max and inside the retina.
    pub fn integrate(&mut self, state: &mut MembraneState, tissue: &Tissue, solver: &Solver) -> Effort {
        self.read(state, solver);
        let figures = [f64::from(tissue.dt_s), f64::from(tissue.fluid_per_s)];
        let (nodes, springs) = (&mut self.nodes, &mut self.springs);
        let effort = self.integrator.step(nodes, springs, self.rule, &self.settings, figures);
        self.write(state, tissue);
        solver.stay_inside(state, tissue.radius_mm);
        effort
    }

    fn read(&mut self, state: &MembraneState, solver: &Solver) {
        let Nodes { x_mm, v_mm_s, outer_un, .. } = &mut self.nodes;
        for axis in 0..3 {
            let from = [&state.position_mm[axis], &state.velocity_mm_s[axis], &solver.outer_un[axis]];
            for (to, from) in [&mut *x_mm, &mut *v_mm_s, &mut *outer_un].into_iter().zip(from) {
                to.iter_mut().zip(from).for_each(|(to, &from)| to[axis] = f64::from(from));
            }
        }
    }

    fn write(&self, state: &mut MembraneState, tissue: &Tissue) {
        let (v_max, dt) = (f64::from(tissue.v_max), f64::from(tissue.dt_s));
        for (i, held) in self.nodes.held.iter().enumerate() {
            if *held {
                continue;
            }
            let (mut x, mut v) = (self.nodes.x_mm[i], self.nodes.v_mm_s[i]);
            let speed = v.norm();
            if speed > v_max {
                // Where v_max is 0 the node goes where it would and keeps no velocity.
                let kept = v * (v_max / speed);
                x -= if v_max > 0.0 { (v - kept) * dt } else { Point::zeros() };
                v = kept;
            }
            state.set_position(i, x.map(|c| c as f32));
            state.set_velocity(i, v.map(|c| c as f32));
        }
    }
}

/// Keeps room for every spring of the sheet.
const NO_SPRING: Spring =
    Spring { ends: [0, 0], stiffness_un_per_mm: 0.0, damping_un_s_per_mm: 0.0, rest_mm: 0.0 };

#[cfg(test)]
mod tests {
    use super::super::tear;
    use super::*;
    use crate::guard::all_finite;
    use nalgebra::Vector3;
    use protocol::scene_file::SceneFile;

    /// The shipped sheet with published stiffness (2 N/m) and the mass of real tissue: 10 µm of water
    /// under 29 mm², shared by 546 nodes.
    fn stiff(choice: MembraneIntegrator) -> (Sheet, MembraneState, Solver, Tissue, Implicit) {
        let mut scene = SceneFile::load("peel").unwrap();
        let membrane = scene.membrane.as_mut().unwrap();
        membrane.stiffness_un_per_mm = 2000.0;
        membrane.bending_un_per_mm = 20.0;
        membrane.node_mass_g = 29e-5 / 546.0;
        let sheet = Sheet::new(&scene);
        let state = sheet.start();
        let tissue = Tissue::new(&scene);
        let mut solver = Solver::new(&sheet);
        solver.refresh(&sheet, &state, &tissue);
        let mut implicit = Implicit::of(choice, &sheet).unwrap();
        implicit.refresh(&sheet, &state, &tissue);
        (sheet, state, solver, tissue, implicit)
    }

    fn rest_energy(sheet: &Sheet, state: &MembraneState) -> f64 {
        let length = |[a, b]: [u32; 2]| (state.position(a as usize) - state.position(b as usize)).norm();
        let strain = |s: usize| f64::from(length(sheet.springs[s]) - sheet.rest_mm[s]);
        (0..sheet.structural).map(|s| 1000.0 * strain(s) * strain(s)).sum()
    }

    #[test]
    fn real_tissue_is_stable_at_a_millisecond_where_explicit_springs_are_not() {
        for choice in [MembraneIntegrator::Implicit, MembraneIntegrator::QuasiStatic] {
            let (sheet, mut state, mut solver, tissue, mut implicit) = stiff(choice);
            let node = sheet.nodes() / 2;
            state.position_mm[2][node] += 0.1;
            let before = rest_energy(&sheet, &state);
            for _ in 0..100 {
                solver.accelerate(&sheet, &state, &tissue);
                implicit.integrate(&mut state, &tissue, &solver);
            }
            assert!(all_finite(&state));
            assert!(rest_energy(&sheet, &state) < 1e-3 * before, "{choice:?}");
        }
        let (sheet, mut state, mut solver, tissue, _) = stiff(MembraneIntegrator::Implicit);
        state.position_mm[2][sheet.nodes() / 2] += 0.1;
        let before = rest_energy(&sheet, &state);
        for _ in 0..100 {
            solver.accelerate(&sheet, &state, &tissue);
            solver.integrate(&mut state, &tissue);
        }
        assert!(rest_energy(&sheet, &state) > 10.0 * before, "the explicit core cannot do this");
    }

    /// A node is pulled by an outer force until all balances: the rim then carries that force.
    #[test]
    fn the_rim_carries_what_pulls_at_the_sheet() {
        let (sheet, mut state, mut solver, tissue, mut implicit) = stiff(MembraneIntegrator::QuasiStatic);
        let node = sheet.nodes() / 2;
        solver.outer_un[2][node] = 300.0;
        for _ in 0..60 {
            implicit.integrate(&mut state, &tissue, &solver);
        }
        solver.accelerate(&sheet, &state, &tissue);
        let mut rim = Vector3::<f32>::zeros();
        for &n in &sheet.rim {
            rim += Vector3::from(solver.force_un.each_ref().map(|f| f[n as usize]));
        }
        assert!((rim - Vector3::new(0.0, 0.0, 300.0)).norm() < 3.0, "{rim}");
    }

    #[test]
    fn held_nodes_stay_and_torn_springs_pull_no_more() {
        let (sheet, mut state, mut solver, tissue, mut implicit) = stiff(MembraneIntegrator::Implicit);
        let node = sheet.nodes() / 2;
        for &t in sheet.triangles_of(node) {
            tear::remove_triangle(&sheet, &mut state, t as usize);
        }
        solver.refresh(&sheet, &state, &tissue);
        implicit.refresh(&sheet, &state, &tissue);
        let before = state.clone();
        solver.outer_un[0].fill(1.0);
        for _ in 0..20 {
            implicit.integrate(&mut state, &tissue, &solver);
        }
        for &n in &sheet.rim {
            assert_eq!(state.position(n as usize), before.position(n as usize));
        }
        assert_eq!(state.position(node), before.position(node), "a dead node goes nowhere");
        assert_eq!(tear::check_mesh(&sheet, &state), Ok(()));
    }

    #[test]
    fn speed_is_limited_and_nodes_stay_in_the_eye() {
        let (sheet, mut state, mut solver, mut tissue, mut implicit) = stiff(MembraneIntegrator::Implicit);
        tissue.v_max = 5.0;
        solver.outer_un[2].fill(-50.0);
        for _ in 0..20 {
            let before = state.clone();
            implicit.integrate(&mut state, &tissue, &solver);
            for n in 0..sheet.nodes() {
                assert!(state.velocity(n).norm() < 5.001 && state.position(n).norm() < 11.5 + 1e-5);
                assert!((state.position(n) - before.position(n)).norm() < 5.01e-3);
            }
        }
    }
}
