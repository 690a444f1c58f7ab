//! The sheet under the integrators of [`crate::elements`]: for tissue of published stiffness and
//! real mass, where an explicit substep would have to be a hundred times shorter.
//!
//! It takes the place of [`Solver::integrate`]: forces, tensions and alarms still come from
//! [`Solver::accelerate`], so tearing by tension, the rim's and the jaws' forces work as with
//! explicit springs. Of the limits, v_max holds; a_max and with it the rule of p_tear do not: the
//! acceleration of a stiff node at the begin of a substep says nothing about where it comes to
//! rest.
//!
//! A scene may ask for a continuum in place of the springs (`membrane.elements`): then structural
//! springs only damp, triangles of [`crate::elements::triangle`] carry the sheet, and
//! [`Implicit::bear`] adds their forces to those that pins and jaws must bear. Such a sheet tears
//! where a triangle's larger tension passes the limit.
//!
//! Inside, numbers are f64; the state keeps f32. Nothing allocates after the first substep at full
//! size.

use super::mesh::SheetMesh;
use super::solver::{Material, Solver};
use crate::elements::anchors::Anchors;
use crate::elements::conjugate::Limits;
use crate::elements::integrator::{Effort, Integrator, Rule, Settings};
use crate::elements::law::PlaneLaw;
use crate::elements::springs::{Spring, Springs};
use crate::elements::triangle::Triangles;
use crate::elements::{Both, Elastic, Nodes, Point};
use crate::sheet::state::SheetState;
use protocol::scene::NODE_FREE;
use scene::MembraneIntegrator;

/// A substep of a scene: one linearised step, solved to a thousandth.
const STEP: Settings =
    Settings { newton: 1, share: 1e-6, conjugate: Limits { iterations: 200, share: 1e-3 } };
/// A quasi-static substep: towards the balance of forces, with a bounded number of corrections.
const BALANCE: Settings =
    Settings { newton: 8, share: 1e-4, conjugate: Limits { iterations: 200, share: 1e-2 } };

/// The sheet's springs and nodes in double precision, with the arrays of a substep.
#[derive(Debug, Clone)]
pub struct Implicit {
    rule: Rule,
    settings: Settings,
    nodes: Nodes,
    /// Springs, triangles where the tissue asks for them, and what outer forces gain on the way.
    elastic: Both<Springs, Both<Triangles, Anchors>>,
    /// Stiffness of all elements, as a norm, µN/mm.
    stiffness_un_per_mm: f64,
    /// Forces of the elements, µN.
    borne_un: Vec<Point>,
    /// Triangles beyond the limit of tearing.
    torn: Vec<usize>,
    integrator: Integrator,
    /// Forces that are but rounding are no reason to move.
    leaves_rounding: bool,
}

impl Implicit {
    /// The integrator a scene asks for; `None` where the explicit core does it.
    pub fn of(choice: MembraneIntegrator, mesh: &SheetMesh, material: &Material) -> Option<Self> {
        match choice {
            MembraneIntegrator::SemiImplicit | MembraneIntegrator::Explicit => None,
            MembraneIntegrator::Implicit => Some(Self::new(mesh, material, Rule::Implicit, STEP)),
            MembraneIntegrator::QuasiStatic => {
                let new = Self::new(mesh, material, Rule::QuasiStatic, BALANCE);
                Some(Implicit { leaves_rounding: true, ..new })
            }
        }
    }

    /// Any rule with any effort.
    pub fn new(mesh: &SheetMesh, material: &Material, rule: Rule, settings: Settings) -> Self {
        let triangles = match material.elements {
            Some(law) => elements(mesh, law),
            None => Triangles::none(),
        };
        // With room for every spring of the sheet.
        let springs = Springs::new(vec![Spring::default(); mesh.springs.len()]);
        Implicit {
            rule,
            settings,
            nodes: Nodes::at_rest(vec![Point::zeros(); mesh.nodes()], 1.0),
            elastic: Both(springs, Both(triangles, Anchors::none(mesh.nodes()))),
            stiffness_un_per_mm: 0.0,
            borne_un: vec![Point::zeros(); if material.elements.is_some() { mesh.nodes() } else { 0 }],
            torn: Vec::with_capacity(if material.elements.is_some() { mesh.triangles.len() } else { 0 }),
            integrator: Integrator::default(),
            leaves_rounding: false,
        }
    }

    /// Rebuilds the living springs and the flags after they have changed.
    pub fn refresh(&mut self, mesh: &SheetMesh, state: &SheetState, material: &Material) {
        let spring = |s: usize| {
            let (stiffness, damping) = material.spring(mesh, state, s);
            Spring {
                ends: mesh.springs[s],
                stiffness_un_per_mm: f64::from(stiffness),
                damping_un_s_per_mm: f64::from(damping),
                rest_mm: f64::from(mesh.rest_mm[s]),
            }
        };
        let all = (0..mesh.springs.len()).map(spring);
        self.elastic.0.replace(all.filter(|s| s.stiffness_un_per_mm > 0.0 || s.damping_un_s_per_mm > 0.0));
        for (held, &flag) in self.nodes.held.iter_mut().zip(&state.flag) {
            *held = flag != NODE_FREE;
        }
        if !self.borne_un.is_empty() {
            let alive = state.triangle_alive.iter().enumerate();
            alive.for_each(|(t, &alive)| self.elastic.1.0.set_alive(t, alive != 0));
        }
        self.nodes.mass_g.fill(1.0 / f64::from(material.inverse_mass));
        self.stiffness_un_per_mm = self.stiffness_un_per_mm(mesh, material);
    }

    /// What a change of 1 mm of the length of each element does, as a norm of the forces on the
    /// nodes, µN/mm.
    fn stiffness_un_per_mm(&self, mesh: &SheetMesh, material: &Material) -> f64 {
        let springs = self.elastic.0.springs().iter().map(|s| s.stiffness_un_per_mm.powi(2));
        // A triangle resists along each of its edges as its plate does, roughly.
        let edges = 3.0 * mesh.triangles.len() as f64;
        let plates = material.elements.map_or(0.0, |law| edges * law.stiffness_un_per_mm().powi(2));
        (2.0 * (springs.sum::<f64>() + plates)).sqrt()
    }

    /// Moves the free nodes by a substep, within v_max and inside the retina.
    pub fn integrate(&mut self, state: &mut SheetState, material: &Material, solver: &Solver) -> Effort {
        self.read(state, solver);
        self.anchor(solver);
        let figures = [f64::from(material.dt_s), f64::from(material.fluid_per_s)];
        let (nodes, elastic) = (&mut self.nodes, &mut self.elastic);
        let effort = self.integrator.step(nodes, elastic, self.rule, &self.settings, figures);
        self.write(state, material);
        solver.stay_inside(state, material.radius_mm);
        effort
    }

    /// Adds the elements' forces on every node to those of the solver, and looks for [triangles to
    /// tear](Self::torn).
    pub fn bear(&mut self, state: &SheetState, solver: &mut Solver, material: &Material) {
        if self.borne_un.is_empty() {
            return;
        }
        self.read(state, solver);
        self.borne_un.fill(Point::zeros());
        let (x, triangles) = (&self.nodes.x_mm, &self.elastic.1.0);
        triangles.add_forces(x, &self.nodes.v_mm_s, &mut self.borne_un);
        for (axis, force) in solver.force_un.iter_mut().enumerate() {
            force.iter_mut().zip(&self.borne_un).for_each(|(f, more)| *f += more[axis] as f32);
        }
        let limit = f64::from(material.tear_un_per_mm);
        let beyond = |t: &usize| triangles.tensions_un_per_mm(*t, x)[0] > limit;
        self.torn.clear();
        if limit.is_finite() {
            let alive = state.triangle_alive.iter().enumerate().filter(|(_, alive)| **alive != 0);
            self.torn.extend(alive.map(|(t, _)| t).filter(beyond));
        }
    }

    /// Triangles whose larger tension passed the limit of tearing at the last [`Self::bear`].
    pub fn torn(&self) -> &[usize] {
        &self.torn
    }

    fn read(&mut self, state: &SheetState, solver: &Solver) {
        let Nodes { x_mm, v_mm_s, outer_un, .. } = &mut self.nodes;
        for axis in 0..3 {
            let from = [&state.position_mm[axis], &state.velocity_mm_s[axis], &solver.outer_un[axis]];
            for (to, from) in [&mut *x_mm, &mut *v_mm_s, &mut *outer_un].into_iter().zip(from) {
                to.iter_mut().zip(from).for_each(|(to, &from)| to[axis] = f64::from(from));
            }
        }
    }

    /// Lets the outer forces grow from where the nodes are now, and says which forces are but
    /// rounding of that: the state holds places in f32.
    fn anchor(&mut self, solver: &Solver) {
        let anchors = &mut self.elastic.1.1;
        anchors.place_mm.copy_from_slice(&self.nodes.x_mm);
        let mut squares = 0.0;
        for (to, from) in anchors.stiffness_un_per_mm.iter_mut().zip(&solver.outer_un_per_mm) {
            *to = f64::from(*from);
            squares += *to * *to;
        }
        if !self.leaves_rounding {
            return;
        }
        let farthest_mm = self.nodes.x_mm.iter().fold(0.0, |far: f64, x| far.max(x.amax()));
        let last_place_mm = f64::from(f32::EPSILON) * farthest_mm;
        self.integrator.floor_un = last_place_mm * self.stiffness_un_per_mm.hypot(squares.sqrt());
    }

    fn write(&self, state: &mut SheetState, material: &Material) {
        let (v_max, dt) = (f64::from(material.v_max), f64::from(material.dt_s));
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

/// The sheet's triangles, at rest as they are at the start.
fn elements(mesh: &SheetMesh, law: PlaneLaw) -> Triangles {
    let rest: Vec<Point> = (0..mesh.nodes() as u32).map(|n| mesh.at(n).map(f64::from)).collect();
    Triangles::new(&rest, &mesh.triangles, law).expect("a mesh's triangles have corners and area")
}

#[cfg(test)]
mod tests {
    use super::super::tearing;
    use super::*;
    use crate::sheet::guard::all_finite;
    use nalgebra::Vector3;
    use scene::SceneFile;

    /// The shipped sheet with published stiffness (2 N/m) and the mass of real tissue: 10 µm of
    /// water under 29 mm², shared by 546 nodes.
    fn stiff(choice: MembraneIntegrator) -> (SheetMesh, SheetState, Solver, Material, Implicit) {
        let mut scene = SceneFile::load("peel").unwrap();
        let membrane = scene.membrane.as_mut().unwrap();
        membrane.stiffness_un_per_mm = 2000.0;
        membrane.bending_un_per_mm = 20.0;
        membrane.node_mass_g = 29e-5 / 546.0;
        let mesh = SheetMesh::new(&scene).unwrap();
        let state = mesh.start();
        let material = Material::new(&scene);
        let mut solver = Solver::new(&mesh);
        solver.refresh(&mesh, &state, &material);
        let mut implicit = Implicit::of(choice, &mesh, &material).unwrap();
        implicit.refresh(&mesh, &state, &material);
        (mesh, state, solver, material, implicit)
    }

    fn rest_energy(mesh: &SheetMesh, state: &SheetState) -> f64 {
        let length = |[a, b]: [u32; 2]| (state.position(a as usize) - state.position(b as usize)).norm();
        let strain = |s: usize| f64::from(length(mesh.springs[s]) - mesh.rest_mm[s]);
        (0..mesh.structural).map(|s| 1000.0 * strain(s) * strain(s)).sum()
    }

    #[test]
    fn real_tissue_is_stable_at_a_millisecond_where_explicit_springs_are_not() {
        for choice in [MembraneIntegrator::Implicit, MembraneIntegrator::QuasiStatic] {
            let (mesh, mut state, mut solver, material, mut implicit) = stiff(choice);
            let node = mesh.nodes() / 2;
            state.position_mm[2][node] += 0.1;
            let before = rest_energy(&mesh, &state);
            for _ in 0..100 {
                solver.accelerate(&mesh, &state, &material);
                implicit.integrate(&mut state, &material, &solver);
            }
            assert!(all_finite(&state));
            assert!(rest_energy(&mesh, &state) < 1e-3 * before, "{choice:?}");
        }
        let (mesh, mut state, mut solver, material, _) = stiff(MembraneIntegrator::Implicit);
        state.position_mm[2][mesh.nodes() / 2] += 0.1;
        let before = rest_energy(&mesh, &state);
        for _ in 0..100 {
            solver.accelerate(&mesh, &state, &material);
            solver.integrate(&mut state, &material);
        }
        assert!(rest_energy(&mesh, &state) > 10.0 * before, "the explicit core cannot do this");
    }

    /// A node is pulled by an outer force until all balances: the rim then carries that force.
    #[test]
    fn the_rim_carries_what_pulls_at_the_sheet() {
        let (mesh, mut state, mut solver, material, mut implicit) = stiff(MembraneIntegrator::QuasiStatic);
        let node = mesh.nodes() / 2;
        solver.outer_un[2][node] = 300.0;
        for _ in 0..60 {
            implicit.integrate(&mut state, &material, &solver);
        }
        solver.accelerate(&mesh, &state, &material);
        let mut rim = Vector3::<f32>::zeros();
        for &n in &mesh.rim {
            rim += Vector3::from(solver.force_un.each_ref().map(|f| f[n as usize]));
        }
        assert!((rim - Vector3::new(0.0, 0.0, 300.0)).norm() < 3.0, "{rim}");
    }

    #[test]
    fn held_nodes_stay_and_torn_springs_pull_no_more() {
        let (mesh, mut state, mut solver, material, mut implicit) = stiff(MembraneIntegrator::Implicit);
        let node = mesh.nodes() / 2;
        for &t in mesh.triangles_of(node) {
            tearing::remove_triangle(&mesh, &mut state, t as usize);
        }
        solver.refresh(&mesh, &state, &material);
        implicit.refresh(&mesh, &state, &material);
        let before = state.clone();
        solver.outer_un[0].fill(1.0);
        for _ in 0..20 {
            implicit.integrate(&mut state, &material, &solver);
        }
        for &n in &mesh.rim {
            assert_eq!(state.position(n as usize), before.position(n as usize));
        }
        assert_eq!(state.position(node), before.position(node), "a dead node goes nowhere");
        assert_eq!(tearing::check_mesh(&mesh, &state), Ok(()));
    }

    #[test]
    fn speed_is_limited_and_nodes_stay_in_the_eye() {
        let (mesh, mut state, mut solver, mut material, mut implicit) = stiff(MembraneIntegrator::Implicit);
        material.v_max = 5.0;
        solver.outer_un[2].fill(-50.0);
        for _ in 0..20 {
            let before = state.clone();
            implicit.integrate(&mut state, &material, &solver);
            for n in 0..mesh.nodes() {
                assert!(state.velocity(n).norm() < 5.001 && state.position(n).norm() < 11.5 + 1e-5);
                assert!((state.position(n) - before.position(n)).norm() < 5.01e-3);
            }
        }
    }

    /// A sheet of 4 × 4 mm drawn out by e while its breadth is held bears E t e/(1 − ν²) per
    /// breadth, and ν of that across (textbook, plane stress); its pins bear the same, and nothing
    /// is left inside.
    #[test]
    fn a_continuum_bears_hookes_tension_and_its_pins_tell() {
        let (n, e, young, poisson) = (8usize, 1e-3f32, 2000.0, 0.3);
        let at = |i: usize| [(i % (n + 1)) as f32 * 0.5, (i / (n + 1)) as f32 * 0.5, 0.0];
        let points: Vec<[f32; 3]> = (0..(n + 1) * (n + 1)).map(at).collect();
        let corner = |r: usize, c: usize| (r * (n + 1) + c) as u32;
        let square = |r, c| {
            let [a, b, d, f] = [corner(r, c), corner(r, c + 1), corner(r + 1, c + 1), corner(r + 1, c)];
            [[a, b, d], [a, d, f]]
        };
        let triangles: Vec<[u32; 3]> = (0..n * n).flat_map(|s| square(s / n, s % n)).collect();
        let mesh = SheetMesh::from_triangles(&points, &triangles, &[]).unwrap();
        let law = PlaneLaw::StVenantKirchhoff { young_un_per_mm: young, poisson };
        let scene = SceneFile::load("peel").unwrap();
        let material =
            Material { elements: Some(law), bending: 0.0, radius_mm: 1e3, ..Material::new(&scene) };
        let mut state = mesh.start();
        state.position_mm[0].iter_mut().for_each(|x| *x *= 1.0 + e);
        let (mut solver, mut implicit) =
            (Solver::new(&mesh), Implicit::of(MembraneIntegrator::Implicit, &mesh, &material).unwrap());
        solver.refresh(&mesh, &state, &material);
        implicit.refresh(&mesh, &state, &material);
        solver.accelerate(&mesh, &state, &material);
        implicit.bear(&state, &mut solver, &material);
        let (mut along, mut across, mut inside) = (0.0, 0.0, 0.0f32);
        for (old, p) in points.iter().enumerate() {
            let force = solver.force_un.each_ref().map(|f| f[mesh.order[old] as usize]);
            along += if p[0] == 4.0 { -f64::from(force[0]) } else { 0.0 };
            across += if p[1] == 4.0 { -f64::from(force[1]) } else { 0.0 };
            let inner = p[..2].iter().all(|c| *c > 0.0 && *c < 4.0);
            inside = if inner { inside.max(force[0].hypot(force[1])) } else { inside };
        }
        let hooke = young * f64::from(e) / (1.0 - poisson * poisson) * 4.0;
        assert!((along / hooke - 1.0).abs() < 0.003, "{along} {hooke}");
        assert!((across / (poisson * hooke) - 1.0).abs() < 0.003, "{across} {}", poisson * hooke);
        assert!(inside < 0.02, "{inside}");
        assert!(implicit.torn().is_empty());
        let weak = Material { tear_un_per_mm: (0.9 * hooke / 4.0) as f32, ..material };
        implicit.bear(&state, &mut solver, &weak);
        assert_eq!(implicit.torn().len(), triangles.len(), "all are as taut as each other");
    }
}
