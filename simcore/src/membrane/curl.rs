//! Bending with a natural curvature: what is free of the retina rolls up.
//!
//! Every inner edge is a hinge between two triangles. With θ the angle by which the sheet turns there
//! (positive where the hollow faces the side of the triangles' normals) and ψ = 2 tan(θ/2),
//!
//! ```text
//! moment  M = w (ψ − ψ̄)          w = 2 D |e|²/(A₁ + A₂)       D: bending stiffness, µN·mm
//! θ̄ = ¾ κ d                        d = 2 (A₁ + A₂)/(3 |e|)      κ: curvature of the roll, 1/mm
//! f = −M ∇θ                        ∇θ after Bridson, Marino and Fedkiw (2003), Wardetzky et al. (2007)
//! ```
//!
//! d is the distance of the triangles' centroids across the edge. On a roll of curvature κ a hinge whose normal
//! makes the angle φ with the direction of rolling turns by κ d cos²φ. Edges in all directions, as those of an equilateral
//! lattice, average cos⁴φ to ⅜ and cos²φ to ½: that gives w from the energy ½ D κ² per area, and the ¾ from the
//! sheet rolling to κ when every hinge wants the same turn. A lattice of right triangles rolls tighter or wider
//! by up to 11 % along its sides. A wide sheet cannot curve both ways without stretching, so it rolls; hence the
//! definition by the roll.
//!
//! ψ grows without bound as a hinge folds, which keeps it from folding through. Neither angle nor arctangent is
//! needed: ψ = 2 sin θ/(1 + cos θ).

use super::adhesion::{Adhesion, AdhesionState};
use super::sheet::{NONE, Sheet};
use crate::state::MembraneState;
use nalgebra::Vector3;
use protocol::scene_file::CurlScene;

/// Largest ψ: a hinge folded to 168°. Protects the moment of a hinge that other forces folded flat.
const MAX_PSI: f32 = 20.0;
/// Twice the area of a triangle below which a hinge has no direction, mm².
const TINY_MM2: f32 = 1e-7;

/// Hinges of a sheet.
#[derive(Debug, Clone)]
pub struct Curl {
    hinges: Vec<Hinge>,
}

#[derive(Debug, Clone, Copy)]
struct Hinge {
    /// The edge's ends, then the corners of the two triangles off it.
    nodes: [u32; 4],
    triangles: [u32; 2],
    /// w, µN·mm.
    stiffness: f32,
    /// ψ̄.
    rest: f32,
}

impl Curl {
    /// Hinges of `sheet` as it lies at the start.
    pub fn new(sheet: &Sheet, scene: &CurlScene) -> Self {
        let start = sheet.start();
        let inner = |(s, sides): (usize, &[u32; 2])| {
            let [ends, sides] = [sheet.springs[s], *sides];
            (sides[1] != NONE).then(|| Hinge::new(sheet, &start, ends, sides, scene))
        };
        Curl { hinges: sheet.spring_triangles.iter().enumerate().filter_map(inner).collect() }
    }

    /// Adds the hinges' forces to `outer_un`. A hinge whose four nodes are all glued has none: there the adhesion,
    /// thousands of times stiffer, says where the sheet is.
    pub fn bend(
        &self,
        membrane: &MembraneState,
        glue: Option<(&Adhesion, &AdhesionState)>,
        outer_un: &mut [Vec<f32>; 3],
    ) {
        for hinge in &self.hinges {
            let alive = hinge.triangles.iter().all(|&t| membrane.triangle_alive[t as usize] != 0);
            let glued = glue.is_some_and(|(a, s)| hinge.nodes.iter().all(|&n| a.holds(s, n as usize)));
            if alive && !glued {
                hinge.bend(membrane, outer_un);
            }
        }
    }
}

impl Hinge {
    fn new(sheet: &Sheet, start: &MembraneState, ends: [u32; 2], sides: [u32; 2], scene: &CurlScene) -> Self {
        let mut across = sides.map(|t| {
            let other = |n: &&u32| !ends.contains(n);
            *sheet.triangles[t as usize].iter().find(other).expect("a triangle has a corner off each edge")
        });
        // The first triangle is the one that runs along the edge from its first end to its second.
        let [a, b, c] = sheet.triangles[sides[0] as usize];
        let along = [[a, b], [b, c], [c, a]].contains(&ends);
        if !along {
            across.swap(0, 1);
        }
        let at = |n: u32| start.position(n as usize).map(f64::from);
        let edge = (at(ends[1]) - at(ends[0])).norm();
        let areas: f64 = across.map(|c| 0.5 * (at(ends[1]) - at(ends[0])).cross(&(at(c) - at(ends[0]))).norm()).iter().sum();
        let turn = 0.75 / scene.radius_mm * 2.0 * areas / (3.0 * edge);
        Hinge {
            nodes: [ends[0], ends[1], across[0], across[1]],
            triangles: sides,
            stiffness: (2.0 * scene.stiffness_un_mm * edge * edge / areas) as f32,
            rest: (2.0 * libm::tan(0.5 * turn.min(3.0))) as f32,
        }
    }

    fn bend(&self, membrane: &MembraneState, outer_un: &mut [Vec<f32>; 3]) {
        let [p, q, a, b] = self.nodes.map(|n| membrane.position(n as usize));
        let Some((psi, gradient)) = turn(p, q, a, b) else { return };
        let moment = -self.stiffness * (psi - self.rest);
        for (&node, gradient) in self.nodes.iter().zip(gradient) {
            for (outer, g) in outer_un.iter_mut().zip(gradient.iter()) {
                outer[node as usize] += moment * g;
            }
        }
    }
}

/// ψ of the hinge `p`–`q` with the corners `a` (counter-clockwise p, q, a) and `b`, and the gradient of θ at p, q, a and b,
/// rad/mm; `None` where a triangle has no area.
fn turn(
    p: Vector3<f32>,
    q: Vector3<f32>,
    a: Vector3<f32>,
    b: Vector3<f32>,
) -> Option<(f32, [Vector3<f32>; 4])> {
    let edge = q - p;
    let (n1, n2) = (edge.cross(&(a - p)), (b - p).cross(&edge));
    let (l1, l2, length) = (n1.norm_squared(), n2.norm_squared(), edge.norm());
    if !(l1 > TINY_MM2 * TINY_MM2 && l2 > TINY_MM2 * TINY_MM2) {
        return None;
    }
    let scale = 1.0 / (l1.sqrt() * l2.sqrt());
    let cos = n1.dot(&n2) * scale;
    let sin = n2.cross(&n1).dot(&edge) * scale / length;
    let psi = if 1.0 + cos > 1e-6 { 2.0 * sin / (1.0 + cos) } else { MAX_PSI.copysign(sin) };
    // Moving a corner off the edge turns its triangle about it; the ends balance force and moment.
    let (up_a, up_b) = (n1 * (length / l1), n2 * (length / l2));
    let share = |c: Vector3<f32>| (c - p).dot(&edge) / (length * length);
    let (sa, sb) = (share(a), share(b));
    let at_q = -(up_a * sa + up_b * sb);
    let at_p = -(up_a * (1.0 - sa) + up_b * (1.0 - sb));
    Some((psi.clamp(-MAX_PSI, MAX_PSI), [at_p, at_q, up_a, up_b]))
}
