//! Adhesion of the membrane to the retina: a bond under every node, with an energy per area.
//!
//! A bond joins a node to the place of the retina where it lay. With δ the distance between the
//! two, the traction follows the bilinear cohesive law (Hillerborg 1976; Camanho and Dávila,
//! NASA/TM-2002-211737):
//!
//! ```text
//! T │    σc·A          rises to σc·A at δ₀ = range/4, falls to 0 at δf = range; the area under it is Γ·A:
//!   │   ╱╲                σc = 2 Γ / δf
//!   │  ╱   ╲             A: the node's share of the sheet's area
//!   │ ╱      ╲
//!   └────────────▶ δ      damage: T(δmax)/δmax·δ below the largest δ so far; past δf it is broken for ever
//!     δ₀     δf
//! ```
//!
//! The force lies along the line between node and place, whatever its direction, so that the work
//! to part a unit of area is Γ for a pull of any angle, on any mesh and at any step. A front is
//! smooth where `range` spans a few nodes; on a mesh much coarser than that the rows snap one by
//! one, and a peel costs more.
//!
//! The retina holds by a limit of its own. Where the traction is above `retina_lift_pa` the place
//! gives way towards the eye's centre (a viscous slider, the choroid lets go), and sinks back when
//! the pull ceases; lifted to `retina_tear_mm` it tears, and its bond with it.

use super::mesh::SheetMesh;
use super::solver::Solver;
use super::state::SheetState;
use nalgebra::Vector3;
use protocol::scene::NODE_DEAD;
use scene::AdhesionScene;
use serde::{Deserialize, Serialize};

/// δ₀ as a share of δf. Smaller makes bonds stiffer, which costs stability and gives nothing: the
/// energy is the same.
const ONSET: f32 = 0.25;
/// Speed at which retina pulled twice as hard as it holds comes up, mm/s: fast against a hand (0.1
/// to 0.5 mm/s while peeling), slow against a substep.
const LIFT_MM_S: f32 = 10.0;
/// Speed at which lifted retina that is not pulled sinks back, mm/s. Descriptive.
const SINK_MM_S: f32 = 0.2;
/// Elevation that counts as lifted, mm: a fifth of the retina's thickness.
pub const LIFTED_MM: f64 = 0.02;

/// Bonds of a sheet: what never changes.
#[derive(Debug, Clone)]
pub struct Adhesion {
    place_mm: [Vec<f32>; 3],
    /// Area of each node, mm².
    area_mm2: Vec<f32>,
    /// Greatest force of each bond, σc·A, µN; 0 where there is none.
    strength_un: Vec<f32>,
    /// Of each bond before δ₀, µN/mm.
    stiffness_un_per_mm: Vec<f32>,
    range_mm: f32,
    lift_pa: f32,
    tear_mm: f32,
}

/// Bonds of a sheet: what changes. One entry a node.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AdhesionState {
    /// Largest separation so far, mm; from the range on the bond is broken.
    #[serde(with = "crate::pod_serde::list")]
    pub parted_mm: Vec<f32>,
    /// Height of the retina under the node over its place at the start, mm.
    #[serde(with = "crate::pod_serde::list")]
    pub lifted_mm: Vec<f32>,
    /// Area parted since the start, mm².
    pub freed_mm2: f64,
    /// Area of torn retina, mm².
    pub torn_mm2: f64,
    /// The warning about the pull on the retina is out.
    pub warned: bool,
    /// The retina is lifted somewhere.
    pub lifted: bool,
}

/// What a substep did to the bonds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Parting {
    /// Bonds that broke.
    pub broken: u32,
    /// Largest traction, Pa, and its node.
    pub highest_pa: (f32, usize),
    /// Largest elevation of the retina, mm, and its node.
    pub highest_mm: (f32, usize),
    /// Places where the retina tore, and the last of them.
    pub torn: (u32, usize),
}

impl Parting {
    /// Adds what a later substep did: the largest of everything, the last of what tore.
    pub fn add(&mut self, now: &Parting) {
        self.broken += now.broken;
        note(&mut self.highest_pa, now.highest_pa.0, now.highest_pa.1);
        note(&mut self.highest_mm, now.highest_mm.0, now.highest_mm.1);
        if now.torn.0 > 0 {
            self.torn = (self.torn.0 + now.torn.0, now.torn.1);
        }
    }
}

impl Adhesion {
    /// Bonds of `sheet` in an eye of radius `radius_mm`.
    pub fn new(mesh: &SheetMesh, scene: &AdhesionScene, radius_mm: f64) -> Self {
        let start = mesh.start();
        let area_mm2 = areas_mm2(mesh, &start);
        let range = scene.range_mm as f32;
        let energy = |node: usize| energy_un_per_mm(mesh, &start, scene, radius_mm, node) as f32;
        let strength_un: Vec<f32> =
            (0..start.nodes()).map(|n| 2.0 * energy(n) * area_mm2[n] / range).collect();
        let stiffness_un_per_mm = strength_un.iter().map(|strength| strength / (ONSET * range)).collect();
        Adhesion {
            place_mm: start.position_mm,
            area_mm2,
            strength_un,
            stiffness_un_per_mm,
            range_mm: range,
            lift_pa: scene.retina_lift_pa as f32,
            tear_mm: scene.retina_tear_mm as f32,
        }
    }

    /// Bonds that were never pulled; where there is no energy they are broken.
    pub fn start(&self) -> AdhesionState {
        let parted = |&strength: &f32| if strength > 0.0 { 0.0 } else { self.range_mm };
        AdhesionState {
            parted_mm: self.strength_un.iter().map(parted).collect(),
            lifted_mm: vec![0.0; self.strength_un.len()],
            ..AdhesionState::default()
        }
    }

    /// True if the state has this sheet's size and numbers in range.
    pub fn accepts(&self, state: &AdhesionState) -> bool {
        let nodes = self.area_mm2.len();
        let good = |v: &Vec<f32>| v.len() == nodes && v.iter().all(|x| (0.0..=f32::MAX).contains(x));
        let account = |x: f64| x.is_finite() && x >= 0.0;
        let bonds = good(&state.parted_mm) && good(&state.lifted_mm);
        bonds && account(state.freed_mm2) && account(state.torn_mm2)
    }

    /// True while the node's bond holds.
    pub fn holds(&self, state: &AdhesionState, node: usize) -> bool {
        state.parted_mm[node] < self.range_mm
    }

    /// Marks the nodes whose bonds hold with 1, the others with 0.
    pub fn mark_held(&self, state: &AdhesionState, held: &mut [u8]) {
        for (held, &parted) in held.iter_mut().zip(&state.parted_mm) {
            *held = u8::from(parted < self.range_mm);
        }
    }

    /// Area that adhered at the start, mm².
    pub fn bonded_mm2(&self) -> f64 {
        let bonded = self.area_mm2.iter().zip(&self.strength_un).filter(|(_, s)| **s > 0.0);
        bonded.map(|(a, _)| f64::from(*a)).sum()
    }

    /// Area of the bonds that are broken and were not so from the start, mm².
    pub fn broken_mm2(&self, state: &AdhesionState) -> f64 {
        let broken = |n: &usize| self.strength_un[*n] > 0.0 && !self.holds(state, *n);
        (0..self.area_mm2.len()).filter(broken).map(|n| f64::from(self.area_mm2[n])).sum()
    }

    /// Where the retina under a node is now, eye frame, mm.
    #[inline]
    pub fn place(&self, state: &AdhesionState, node: usize) -> Vector3<f32> {
        let [x, y, z] = &self.place_mm;
        let place = Vector3::new(x[node], y[node], z[node]);
        let lifted = state.lifted_mm[node];
        if lifted > 0.0 { place * (1.0 - lifted / place.norm()) } else { place }
    }

    /// Greatest stiffness of a bond, µN/mm: for the bound of a stable step.
    pub fn stiffest_un_per_mm(&self) -> f32 {
        self.stiffness_un_per_mm.iter().fold(0.0, |a: f32, &s| a.max(s))
    }

    /// Adds the bonds' forces on the nodes to the solver's outer forces, with what they gain on the
    /// way, and lets bonds and retina give way for a time of `dt_s`.
    pub fn pull(
        &self,
        position_mm: &[Vec<f32>; 3],
        flag: &[u32],
        state: &mut AdhesionState,
        solver: &mut Solver,
        dt_s: f32,
    ) -> Parting {
        let mut parting = Parting::default();
        let [x, y, z] = position_mm;
        for node in 0..flag.len() {
            if flag[node] == NODE_DEAD || !self.holds(state, node) {
                self.sink(state, node, dt_s, &mut parting);
                continue;
            }
            let way = self.place(state, node) - Vector3::new(x[node], y[node], z[node]);
            let distance = way.norm();
            state.parted_mm[node] = state.parted_mm[node].max(distance);
            let stiffness = self.secant(node, state.parted_mm[node]);
            if stiffness == 0.0 {
                state.freed_mm2 += f64::from(self.area_mm2[node]);
                parting.broken += 1;
                continue;
            }
            if let Some(growth) = solver.outer_un_per_mm.get_mut(node) {
                *growth += stiffness;
            }
            for (outer, way) in solver.outer_un.iter_mut().zip(way.iter()) {
                outer[node] += stiffness * way;
            }
            let traction = stiffness * distance / self.area_mm2[node];
            note(&mut parting.highest_pa, traction, node);
            if traction > self.lift_pa {
                self.lift(state, node, traction, dt_s, &mut parting);
            } else {
                self.sink(state, node, dt_s, &mut parting);
            }
        }
        parting
    }

    /// Force over separation of a bond that was parted as far as `parted` mm, µN/mm.
    fn secant(&self, node: usize, parted: f32) -> f32 {
        let onset = ONSET * self.range_mm;
        if parted <= onset {
            self.stiffness_un_per_mm[node]
        } else if parted < self.range_mm {
            self.strength_un[node] * (self.range_mm - parted) / ((self.range_mm - onset) * parted)
        } else {
            0.0
        }
    }

    /// The retina under `node` is pulled harder than it holds.
    fn lift(&self, state: &mut AdhesionState, node: usize, traction: f32, dt_s: f32, parting: &mut Parting) {
        let excess = (traction / self.lift_pa - 1.0).min(1.0);
        let lifted = state.lifted_mm[node] + excess * LIFT_MM_S * dt_s;
        state.lifted_mm[node] = lifted.min(self.tear_mm);
        if lifted >= self.tear_mm {
            state.parted_mm[node] = self.range_mm;
            state.freed_mm2 += f64::from(self.area_mm2[node]);
            state.torn_mm2 += f64::from(self.area_mm2[node]);
            parting.torn = (parting.torn.0 + 1, node);
        }
        note(&mut parting.highest_mm, state.lifted_mm[node], node);
    }

    fn sink(&self, state: &mut AdhesionState, node: usize, dt_s: f32, parting: &mut Parting) {
        let lifted = state.lifted_mm[node];
        if lifted > 0.0 {
            state.lifted_mm[node] = (lifted - SINK_MM_S * dt_s).max(0.0);
            note(&mut parting.highest_mm, lifted, node);
        }
    }
}

fn note(highest: &mut (f32, usize), value: f32, node: usize) {
    if value > highest.0 {
        *highest = (value, node);
    }
}

/// A third of every triangle belongs to each of its nodes.
fn areas_mm2(mesh: &SheetMesh, start: &SheetState) -> Vec<f32> {
    let mut areas = vec![0.0; start.nodes()];
    for nodes in &mesh.triangles {
        let [a, b, c] = nodes.map(|n| start.position(n as usize));
        let third = (b - a).cross(&(c - a)).norm() / 6.0;
        nodes.iter().for_each(|&n| areas[n as usize] += third);
    }
    areas
}

/// Γ at a node: the base, the rim over it, the patches over both.
fn energy_un_per_mm(
    mesh: &SheetMesh,
    start: &SheetState,
    scene: &AdhesionScene,
    radius_mm: f64,
    node: usize,
) -> f64 {
    let p = start.position(node);
    let rim = |&r: &u32| f64::from((start.position(r as usize) - p).norm()) < scene.rim_width_mm;
    let at_rim = scene.rim_width_mm > 0.0 && mesh.rim.iter().any(rim);
    let base = if at_rim { scene.rim_energy_un_per_mm } else { scene.energy_un_per_mm };
    let up = p.map(f64::from).normalize();
    let covers = |towards: [f64; 3], reach_mm: f64| {
        let towards = Vector3::from(towards).normalize();
        // The chord instead of the arc: exact, and without an inverse cosine.
        (up - towards).norm() < 2.0 * libm::sin(0.5 * reach_mm / radius_mm)
    };
    let patch = scene.patches.iter().rev().find(|p| covers(p.towards_in_eye, p.radius_mm));
    patch.map_or(base, |p| p.energy_un_per_mm)
}
