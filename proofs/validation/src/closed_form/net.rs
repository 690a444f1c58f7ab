//! Any net of springs under the product's own sheet, solver and integrators.
//!
//! A [`SheetMesh`] is made of triangles. A spring that is no edge of the triangles given gets a
//! triangle of its own with a pinned corner off the plane, whose two other edges have no stiffness.

use std::collections::{BTreeMap, BTreeSet};
use tissue::elements::integrator::{Rule, Settings};
use tissue::sheet::implicit::Implicit;
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::solver::{Material, Solver};
use tissue::sheet::state::SheetState;

use scene::SceneFile;

/// A spring between nodes of the net.
#[derive(Clone, Copy)]
pub struct Link {
    /// Nodes.
    pub ends: [u32; 2],
    /// µN/mm.
    pub stiffness: f64,
    /// mm.
    pub rest: f64,
}

/// Nodes, springs and material of a net.
#[derive(Default)]
pub struct NetSpec {
    /// Positions, mm.
    pub nodes: Vec<[f64; 3]>,
    /// Triangles, counter-clockwise.
    pub triangles: Vec<[u32; 3]>,
    /// Springs; other edges of the triangles have no stiffness.
    pub links: Vec<Link>,
    /// Held nodes.
    pub pinned: Vec<u32>,
    /// Mass of every node, g.
    pub mass_g: f64,
    /// Damping by the fluid, 1/s.
    pub fluid_per_s: f64,
    /// Damping of every spring, µN·s/mm.
    pub damping: f64,
}

/// The net as the product simulates it.
pub struct Net {
    sheet: SheetMesh,
    /// The state.
    pub state: SheetState,
    /// The figures; the substep may be changed at will.
    pub tissue: Material,
    /// The explicit core.
    pub solver: Solver,
}

impl Net {
    /// Makes it.
    pub fn new(spec: &NetSpec) -> Self {
        let (mut nodes, mut triangles, mut pinned) =
            (spec.nodes.clone(), spec.triangles.clone(), spec.pinned.clone());
        let sorted = |[a, b]: [u32; 2]| [a.min(b), a.max(b)];
        let edges: BTreeSet<[u32; 2]> =
            triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(sorted).collect();
        for link in spec.links.iter().filter(|l| !edges.contains(&sorted(l.ends))) {
            let [a, b] = link.ends.map(|n| nodes[n as usize]);
            let corner = nodes.len() as u32;
            nodes.push([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]) + 0.01, 0.5 * (a[2] + b[2]) + 1.0]);
            pinned.push(corner);
            triangles.push([link.ends[0], link.ends[1], corner]);
        }
        let single: Vec<[f32; 3]> = nodes.iter().map(|p| p.map(|c| c as f32)).collect();
        let sheet = SheetMesh::from_triangles(&single, &triangles, &pinned).expect("a manifold net");
        let links: BTreeMap<[u32; 2], Link> =
            spec.links.iter().map(|l| (sorted(l.ends.map(|n| sheet.order[n as usize])), *l)).collect();
        let link_of = |ends: &[u32; 2]| links.get(&sorted(*ends)).copied();
        let factors = |of: fn(Link, &NetSpec) -> f64| -> Vec<f32> {
            sheet.springs.iter().map(|s| link_of(s).map_or(0.0, |l| of(l, spec)) as f32).collect()
        };
        let (stiffness, damping) = (factors(|l, _| l.stiffness), factors(|_, spec| spec.damping));
        let rest: Vec<f32> = (0..sheet.springs.len())
            .map(|s| link_of(&sheet.springs[s]).map_or(sheet.rest_mm[s], |l| l.rest as f32))
            .collect();
        let mut sheet = sheet.with_factors(&stiffness, &damping).expect("stiffness and damping are numbers");
        sheet.rest_mm = rest;
        let state = sheet.start();
        let tissue = tissue(spec);
        let mut solver = Solver::new(&sheet);
        solver.refresh(&sheet, &state, &tissue);
        Net { sheet, state, tissue, solver }
    }

    /// The sheet's number of a node of the spec.
    pub fn node(&self, node: usize) -> usize {
        self.sheet.order[node] as usize
    }

    /// Where a node of the spec is, mm.
    pub fn at(&self, node: usize) -> [f64; 3] {
        self.state.position(self.node(node)).map(f64::from).into()
    }

    /// Puts a node of the spec at `p`, mm.
    pub fn put(&mut self, node: usize, p: [f64; 3]) {
        let node = self.node(node);
        self.state.set_position(node, nalgebra::Vector3::from(p).map(|c| c as f32));
    }

    /// Pulls a node of the spec with `force`, µN.
    pub fn pull(&mut self, node: usize, force: [f64; 3]) {
        let node = self.node(node);
        (0..3).for_each(|axis| self.solver.outer_un[axis][node] = force[axis] as f32);
    }

    /// A substep of the explicit core, semi-implicit or explicit as the tissue says.
    pub fn march(&mut self) {
        self.solver.accelerate(&self.sheet, &self.state, &self.tissue);
        self.solver.integrate(&mut self.state, &self.tissue);
    }

    /// Brings the net to where all forces balance; returns what is left of the imbalance as a
    /// share.
    pub fn balance(&mut self, settings: &Settings) -> f64 {
        let mut implicit = Implicit::new(&self.sheet, &self.tissue, Rule::QuasiStatic, *settings);
        implicit.refresh(&self.sheet, &self.state, &self.tissue);
        implicit.integrate(&mut self.state, &self.tissue, &self.solver).residual
    }
}

/// A tissue without bending, limits or retina, whose springs take their figures from the factors
/// alone.
fn tissue(spec: &NetSpec) -> Material {
    let mut scene = SceneFile::load("peel").expect("a shipped scene");
    let membrane = scene.membrane.as_mut().expect("it has a membrane");
    membrane.stiffness_un_per_mm = 1.0;
    membrane.spring_damping_un_s_per_mm = 1.0;
    membrane.bending_un_per_mm = 0.0;
    membrane.fluid_damping_per_s = spec.fluid_per_s;
    membrane.node_mass_g = spec.mass_g;
    (membrane.a_max_mm_s2, membrane.v_max_mm_s) = (1e12, 1e6);
    membrane.tear_tension_n_per_m = 0.0;
    let mut tissue = Material::new(&scene);
    tissue.radius_mm = f32::INFINITY;
    tissue
}
