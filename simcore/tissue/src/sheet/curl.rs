//! Bending with a natural curvature: what is free of the retina rolls up.
//!
//! Every inner edge is a hinge between two triangles. With θ the angle by which the sheet turns
//! there (positive where the hollow faces the side of the triangles' normals) and ψ = 2 tan(θ/2),
//!
//! ```text
//! moment  M = w (ψ − ψ̄)          w = D |e|²/(A₁ + A₂)      D: bending stiffness, µN·mm
//! θ̄ = κ (A₁ + A₂)/|e|                                       κ: curvature of the roll, 1/mm
//! f = −M ∇θ                        ∇θ after Bridson, Marino and Fedkiw (2003), Wardetzky et al. (2007)
//! ```
//!
//! Both factors follow from a sheet z = ½ (κ₁ x² + κ₂ y²) on an equilateral lattice: a hinge whose
//! edge has the direction t and the normal n turns by θ = (3 κₙₙ − κₜₜ)/2 · d with d = 2 (A₁ +
//! A₂)/(3 |e|), the distance of the centroids. Summed over the three directions, with H = κ₁ + κ₂
//! and K = κ₁ κ₂, the energy per area is ½ D (H² − 8/3 K) − D κ H: Seung and Nelson (1988). A wide
//! sheet cannot curve both ways without stretching, so K = 0 and it rolls to H = κ. On a lattice of
//! right triangles the same factors give the same roll along its sides. Narrow strips (against √R
//! (D/Y)^¼, some tenths of a millimetre) and free edges curve both ways, and more.
//!
//! ψ grows without bound as a hinge folds, which keeps it from folding through. Neither angle nor
//! arctangent is needed: ψ = 2 sin θ/(1 + cos θ).
//!
//! ∇θ grows as one over a triangle's height, so in crumpled tissue, whose triangles have nearly
//! none, a hinge would be stiffer than any explicit step bears, and feed energy to it for ever. Its
//! stiffness w (1 + ψ²/4) Σ|∇θ|² is held below a share of m/Δt²: there the hinge turns slower than
//! its material would, and stable.

use super::adhesion::{Adhesion, AdhesionState};
use super::mesh::{NONE, SheetMesh};
use super::simd::hinges::Hinges;
use super::simd::{Isa, WIDE};
use crate::sheet::state::SheetState;
use nalgebra::Vector3;
use scene::CurlScene;

/// Largest ψ: a hinge folded to 168°. Protects the moment of a hinge that other forces folded flat.
pub(super) const MAX_PSI: f32 = 20.0;
/// Twice the area of a triangle below which a hinge has no direction, mm².
pub(super) const TINY_MM2: f32 = 1e-7;

/// 1 + cos θ at and below which a hinge counts as folded flat.
pub(super) const FOLDED: f32 = 1e-6;

/// Stiffness of a hinge that is let through, as a share of node mass over the square of a substep.
/// A node belongs to a dozen hinges.
const MAX_STIFFNESS: f64 = 0.1;

/// Blocks that are filled before the first of them is computed: what was just written in small
/// pieces is slow to read in one.
const GROUP: usize = 4;

/// Hinges of a sheet.
#[derive(Debug, Clone)]
pub struct Curl {
    hinges: Vec<Hinge>,
    isa: Isa,
    /// Largest stiffness of a hinge, µN/mm.
    most_un_per_mm: f32,
    acting: Acting,
    /// Of each node x, y, z and 0: where it is, mm, and what acts on it, µN.
    place: Vec<[f32; 4]>,
    pull: Vec<[f32; 4]>,
}

/// The hinges that act: those of living triangles that are not bonded down.
#[derive(Debug, Clone, Default)]
struct Acting {
    /// What it was chosen by: 1 for every living triangle and for every node that is bonded.
    alive: Vec<u8>,
    bonded: Vec<u8>,
    /// Glued nodes now.
    bonded_now: Vec<u8>,
    hinges: Vec<Hinge>,
    /// The same, sixteen at a time.
    blocks: Vec<Block>,
}

/// Hinges that are computed together; where the last block is not full, its rest repeats node 0 and
/// is not read.
#[derive(Debug, Clone, Default)]
struct Block {
    nodes: [[u32; WIDE]; 4],
    side_by_side: Hinges,
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

/// The stiffness of a hinge that explicit steps of `dt_s` bear on nodes of `node_mass_g`, µN/mm.
pub fn stiffest_un_per_mm(node_mass_g: f64, dt_s: f64) -> f32 {
    (MAX_STIFFNESS * node_mass_g / (dt_s * dt_s)) as f32
}

impl Curl {
    /// Hinges of `sheet` as it lies at the start; none becomes stiffer than `most_un_per_mm`, see
    /// [`stiffest_un_per_mm`].
    pub fn new(mesh: &SheetMesh, scene: &CurlScene, most_un_per_mm: f32) -> Self {
        let start = mesh.start();
        let inner = |(s, sides): (usize, &[u32; 2])| {
            let [ends, sides] = [mesh.springs[s], *sides];
            (sides[1] != NONE).then(|| Hinge::new(mesh, &start, ends, sides, scene))
        };
        let hinges = mesh.spring_triangles.iter().enumerate().filter_map(inner).collect::<Vec<_>>();
        let (place, pull) = (vec![[0.0; 4]; mesh.nodes()], vec![[0.0; 4]; mesh.nodes()]);
        let acting = Acting::for_up_to(&hinges);
        Curl { hinges, isa: Isa::best(), most_un_per_mm, acting, place, pull }
    }

    /// Adds the hinges' forces to `outer_un`. A hinge whose four nodes are all bonded has none:
    /// there the adhesion, thousands of times stiffer, says where the sheet is.
    pub fn bend(
        &mut self,
        membrane: &SheetState,
        bonds: Option<(&Adhesion, &AdhesionState)>,
        outer_un: &mut [Vec<f32>; 3],
    ) {
        self.acting.choose(&self.hinges, membrane, bonds);
        if self.acting.hinges.is_empty() {
            return;
        }
        together(&membrane.position_mm, &mut self.place);
        together(outer_un, &mut self.pull);
        let groups = self.acting.hinges.chunks(GROUP * WIDE).zip(self.acting.blocks.chunks_mut(GROUP));
        for (hinges, blocks) in groups {
            blocks.iter_mut().for_each(|block| block.gather(&self.place));
            let mut open = [0; GROUP];
            for (open, block) in open.iter_mut().zip(&mut *blocks) {
                *open = block.side_by_side.bend(self.isa, self.most_un_per_mm);
            }
            // In the order of the hinges, so that sums do not depend on how many are computed at a
            // time.
            for (i, hinge) in hinges.iter().enumerate() {
                if open[i / WIDE] >> (i % WIDE) & 1 == 1 {
                    hinge.take(&blocks[i / WIDE].side_by_side, i % WIDE, &mut self.pull);
                } else if let Some(force) = hinge.bend(membrane, self.most_un_per_mm) {
                    add(&mut self.pull, &hinge.nodes, force);
                }
            }
        }
        for (axis, outer) in outer_un.iter_mut().enumerate() {
            outer.iter_mut().zip(&self.pull).for_each(|(to, from)| *to = from[axis]);
        }
    }

    /// Adds a bound of what those forces lose on the way of each node to `un_per_mm`: for
    /// integrators that look ahead.
    pub fn stiffen(
        &mut self,
        membrane: &SheetState,
        bonds: Option<(&Adhesion, &AdhesionState)>,
        un_per_mm: &mut [f32],
    ) {
        self.acting.choose(&self.hinges, membrane, bonds);
        for hinge in &self.acting.hinges {
            hinge.stiffen(membrane, self.most_un_per_mm, un_per_mm);
        }
    }
}

/// The three numbers of every node side by side.
fn together(apart: &[Vec<f32>; 3], to: &mut [[f32; 4]]) {
    let [x, y, z] = apart;
    for (((to, x), y), z) in to.iter_mut().zip(x).zip(y).zip(z) {
        *to = [*x, *y, *z, 0.0];
    }
}

fn add(pull: &mut [[f32; 4]], nodes: &[u32; 4], force: [Vector3<f32>; 4]) {
    for (&node, force) in nodes.iter().zip(force) {
        pull[node as usize].iter_mut().zip(force.iter()).for_each(|(to, f)| *to += f);
    }
}

impl Acting {
    /// None yet, and room for all.
    fn for_up_to(hinges: &[Hinge]) -> Self {
        let (list, blocks) = (hinges.len(), hinges.len().div_ceil(WIDE));
        Acting { hinges: Vec::with_capacity(list), blocks: Vec::with_capacity(blocks), ..Acting::default() }
    }

    /// Chooses again if triangles or bonds have changed.
    fn choose(
        &mut self,
        hinges: &[Hinge],
        membrane: &SheetState,
        bonds: Option<(&Adhesion, &AdhesionState)>,
    ) {
        self.bonded_now.resize(membrane.nodes(), 0);
        match bonds {
            Some((adhesion, state)) => adhesion.mark_held(state, &mut self.bonded_now),
            None => self.bonded_now.fill(0),
        }
        if self.alive == membrane.triangle_alive && self.bonded == self.bonded_now {
            return;
        }
        self.alive.clone_from(&membrane.triangle_alive);
        self.bonded.clone_from(&self.bonded_now);
        let acts = |hinge: &&Hinge| {
            let alive = hinge.triangles.iter().all(|&t| self.alive[t as usize] != 0);
            alive && !hinge.nodes.iter().all(|&n| self.bonded[n as usize] != 0)
        };
        self.hinges.clear();
        self.hinges.extend(hinges.iter().filter(acts));
        self.blocks.clear();
        self.blocks.extend(self.hinges.chunks(WIDE).map(Block::of));
    }
}

impl Block {
    fn of(hinges: &[Hinge]) -> Self {
        let mut block = Block::default();
        for (i, hinge) in hinges.iter().enumerate() {
            block.nodes.iter_mut().zip(hinge.nodes).for_each(|(to, node)| to[i] = node);
            (block.side_by_side.stiffness[i], block.side_by_side.rest[i]) = (hinge.stiffness, hinge.rest);
        }
        block
    }

    /// Lays the places of the nodes side by side, four hinges at a time, which the compiler turns
    /// in registers.
    fn gather(&mut self, place: &[[f32; 4]]) {
        for (to, nodes) in self.side_by_side.position.iter_mut().zip(&self.nodes) {
            for i in (0..WIDE).step_by(4) {
                let four: [[f32; 4]; 4] = std::array::from_fn(|k| place[nodes[i + k] as usize]);
                for (axis, to) in to.iter_mut().enumerate() {
                    to[i..i + 4].copy_from_slice(&four.map(|p| p[axis]));
                }
            }
        }
    }
}

impl Hinge {
    fn new(mesh: &SheetMesh, start: &SheetState, ends: [u32; 2], sides: [u32; 2], scene: &CurlScene) -> Self {
        let mut across = sides.map(|t| {
            let other = |n: &&u32| !ends.contains(n);
            *mesh.triangles[t as usize].iter().find(other).expect("a triangle has a corner off each edge")
        });
        // The first triangle is the one that runs along the edge from its first end to its second.
        let [a, b, c] = mesh.triangles[sides[0] as usize];
        let along = [[a, b], [b, c], [c, a]].contains(&ends);
        if !along {
            across.swap(0, 1);
        }
        let at = |n: u32| start.position(n as usize).map(f64::from);
        let edge = (at(ends[1]) - at(ends[0])).norm();
        let areas: f64 = across
            .map(|c| 0.5 * (at(ends[1]) - at(ends[0])).cross(&(at(c) - at(ends[0]))).norm())
            .iter()
            .sum();
        let turn = areas / (edge * scene.radius_mm);
        Hinge {
            nodes: [ends[0], ends[1], across[0], across[1]],
            triangles: sides,
            stiffness: (scene.stiffness_un_mm * edge * edge / areas) as f32,
            rest: (2.0 * libm::tan(0.5 * turn.min(3.0))) as f32,
        }
    }

    /// Adds the forces that a block has for it.
    fn take(&self, block: &Hinges, at: usize, pull: &mut [[f32; 4]]) {
        for ([x, y, z], &node) in block.force.iter().zip(&self.nodes) {
            let pull = &mut pull[node as usize];
            *pull = [pull[0] + x[at], pull[1] + y[at], pull[2] + z[at], pull[3] + 0.0];
        }
    }

    /// Forces of any hinge, folded or not, by itself; `None` where a triangle has no area.
    fn bend(&self, membrane: &SheetState, most_un_per_mm: f32) -> Option<[Vector3<f32>; 4]> {
        let [p, q, a, b] = self.nodes.map(|n| membrane.position(n as usize));
        let (psi, gradient) = turn(p, q, a, b)?;
        let moment = -self.stiffness * (psi - self.rest) * self.held(psi, &gradient, most_un_per_mm);
        Some(gradient.map(|g| g * moment))
    }

    /// Each node's share of the tangent, four times its diagonal: (Σ aᵢ)² ≤ 4 Σ aᵢ², so all four
    /// together are never below the hinge.
    fn stiffen(&self, membrane: &SheetState, most_un_per_mm: f32, un_per_mm: &mut [f32]) {
        let [p, q, a, b] = self.nodes.map(|n| membrane.position(n as usize));
        let Some((psi, gradient)) = turn(p, q, a, b) else { return };
        let stiffness = self.tangent(psi) * self.held(psi, &gradient, most_un_per_mm);
        for (&node, gradient) in self.nodes.iter().zip(gradient) {
            un_per_mm[node as usize] += 4.0 * stiffness * gradient.norm_squared();
        }
    }

    /// dM/dθ, µN·mm: of ψ = 2 tan(θ/2) it is w (1 + ψ²/4).
    fn tangent(&self, psi: f32) -> f32 {
        self.stiffness * (1.0 + 0.25 * psi * psi)
    }

    /// Share of the moment that is let through, so that the hinge is not stiffer than
    /// `most_un_per_mm`.
    fn held(&self, psi: f32, gradient: &[Vector3<f32>; 4], most_un_per_mm: f32) -> f32 {
        let slopes: f32 = gradient.iter().map(Vector3::norm_squared).sum();
        let stiffness = self.tangent(psi) * slopes;
        (most_un_per_mm / stiffness).min(1.0)
    }
}

/// ψ of the hinge `p`–`q` with the corners `a` (counter-clockwise p, q, a) and `b`, and the
/// gradient of θ at p, q, a and b, rad/mm; `None` where a triangle has no area.
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
    let psi = if 1.0 + cos > FOLDED { 2.0 * sin / (1.0 + cos) } else { MAX_PSI.copysign(sin) };
    // Moving a corner off the edge turns its triangle about it; the ends balance force and moment.
    let (up_a, up_b) = (n1 * (length / l1), n2 * (length / l2));
    let share = |c: Vector3<f32>| (c - p).dot(&edge) / (length * length);
    let (sa, sb) = (share(a), share(b));
    let at_q = -(up_a * sa + up_b * sb);
    let at_p = -(up_a * (1.0 - sa) + up_b * (1.0 - sb));
    Some((psi.clamp(-MAX_PSI, MAX_PSI), [at_p, at_q, up_a, up_b]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::SceneFile;

    fn point() -> impl Strategy<Value = Vector3<f32>> {
        prop::array::uniform3(-0.3f32..0.3).prop_map(Vector3::from)
    }

    /// θ from its definition, in double precision.
    fn angle(at: [Vector3<f64>; 4]) -> f64 {
        let [p, q, a, b] = at;
        let (n1, n2) = ((q - p).cross(&(a - p)).normalize(), (b - p).cross(&(q - p)).normalize());
        n2.cross(&n1).dot(&(q - p).normalize()).atan2(n1.dot(&n2))
    }

    proptest! {
        #[test]
        fn angle_and_gradient_are_those_of_the_definition(jitter in prop::array::uniform4(point())) {
            let flat = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.9, 0.0], [0.5, -0.9, 0.0]];
            let at: [Vector3<f32>; 4] = std::array::from_fn(|i| Vector3::from(flat[i]) + jitter[i]);
            let wide = at.map(|p| p.map(f64::from));
            let (psi, gradient) = turn(at[0], at[1], at[2], at[3]).unwrap();
            let theta = angle(wide);
            prop_assert!((f64::from(psi) - 2.0 * (0.5 * theta).tan()).abs() < 1e-4);
            for (node, axis) in (0..4).flat_map(|n| (0..3).map(move |a| (n, a))) {
                let moved = |by: f64| {
                    let mut at = wide;
                    at[node][axis] += by;
                    angle(at)
                };
                let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                prop_assert!((slope - f64::from(gradient[node][axis])).abs() < 2e-3 * (1.0 + slope.abs()));
            }
        }
    }

    /// Forces on the nodes of the peeling scene's sheet, crumpled; without an instruction set one
    /// hinge after the other, by the definition.
    fn forces(isa: Option<Isa>, seed: u64) -> [Vec<f32>; 3] {
        let scene = SceneFile::load("erm").unwrap();
        let mesh = SheetMesh::new(&scene).unwrap();
        let mut curl = Curl::new(&mesh, scene.membrane.as_ref().unwrap().curl.as_ref().unwrap(), 50.0);
        let mut membrane = mesh.start();
        let mut seed = seed;
        for x in membrane.position_mm.iter_mut().flatten() {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            *x += ((seed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 0.3;
        }
        // Some nodes lie on others: triangles without area, and hinges folded flat.
        for n in (0..membrane.nodes() - 1).step_by(7) {
            membrane.set_position(n, membrane.position(n + 1));
        }
        for n in (3..membrane.nodes()).step_by(11) {
            let flat = membrane.position(n);
            membrane.set_position(n, Vector3::new(flat.x, flat.y, -11.0));
        }
        membrane.triangle_alive[5] = 0;
        let mut outer: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; membrane.nodes()]);
        match isa {
            Some(isa) => {
                curl.isa = isa;
                curl.bend(&membrane, None, &mut outer);
            }
            None => {
                curl.acting.choose(&curl.hinges, &membrane, None);
                for hinge in &curl.acting.hinges {
                    let Some(force) = hinge.bend(&membrane, 50.0) else { continue };
                    for (&node, force) in hinge.nodes.iter().zip(force) {
                        outer.iter_mut().zip(force.iter()).for_each(|(to, f)| to[node as usize] += f);
                    }
                }
            }
        }
        outer
    }

    #[test]
    fn hinges_together_give_the_bits_of_each_alone() {
        for seed in 1..20 {
            let bits =
                |of: [Vec<f32>; 3]| of.map(|axis| axis.iter().map(|f| f.to_bits()).collect::<Vec<_>>());
            let alone = bits(forces(None, seed));
            assert!(alone[0].iter().filter(|&&f| f != 0).count() > 100);
            for isa in Isa::available() {
                assert!(bits(forces(Some(isa), seed)) == alone, "{isa:?}, seed {seed}");
            }
        }
    }

    #[test]
    fn a_raised_corner_is_a_hollow_towards_the_normals() {
        let at = |x, y, z| Vector3::new(x, y, z);
        let (psi, _) =
            turn(at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(0.5, 1.0, 0.3), at(0.5, -1.0, 0.0)).unwrap();
        assert!(psi > 0.25);
        let flat = turn(at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(0.5, 0.0, 0.0), at(0.5, -1.0, 0.0));
        assert!(flat.is_none(), "a triangle without area has no direction");
    }
}
