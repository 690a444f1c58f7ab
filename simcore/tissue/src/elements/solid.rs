//! Tetrahedra of 4 nodes (constant strain) or 10 (linear strain), any [`SolidLaw`].
//!
//! At each quadrature point with shape gradients g_i = ∇N_i (1/mm) and weight w (mm³), F = Σ x_i
//! g_iᵀ:
//!
//! ```text
//! energy w Ψ(F),   f_i = −w P(F) g_i,   df_i = −w dP g_i
//! ```
//!
//! The linear tetrahedron has one point, its volume; the quadratic one four (exact for straight
//! edges). **Linear tetrahedra are too stiff in bending** (a beam one element thick by a factor);
//! quadratic ones are not, and are meant for everything that bends. Nodes of a quadratic
//! tetrahedron: its corners 0–3, then the middles of 01, 12, 02, 03, 13, 23.

use super::law::{SolidLaw, SolidTangent};
use super::{Elastic, Point};
use nalgebra::Matrix3;

/// Ends of the edges whose middles are nodes 4 to 9 of a quadratic tetrahedron.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]];

/// Least ratio of six volumes to the cube of the longest edge: below it a tetrahedron is taken for
/// flat.
const LEAST_SHAPE: f64 = 1e-6;

/// Why tetrahedra were refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SolidError {
    /// A node that does not exist.
    #[error("tetrahedron {element}: node {node} is not one of the {nodes} nodes")]
    Node {
        /// Which tetrahedron.
        element: usize,
        /// Its node.
        node: u32,
        /// Nodes there are.
        nodes: usize,
    },
    /// Flat, inverted or not finite.
    #[error("tetrahedron {element}: expected a positive volume, found {volume_mm3} mm³")]
    Volume {
        /// Which tetrahedron.
        element: usize,
        /// Its volume, mm³.
        volume_mm3: f64,
    },
    /// A shape with another number of nodes.
    #[error("tetrahedra have 4 or 10 nodes, found {nodes}")]
    Shape {
        /// Nodes of a tetrahedron.
        nodes: usize,
    },
}

/// A quadrature point.
#[derive(Debug, Clone, Copy)]
struct Sample<const N: usize> {
    gradient: [Point; N],
    weight_mm3: f64,
    tangent: SolidTangent,
}

/// Tetrahedra of `N` nodes and one law.
#[derive(Debug, Clone)]
pub struct Solid<const N: usize> {
    law: SolidLaw,
    elements: Vec<[u32; N]>,
    /// As many for each element, in order.
    samples: Vec<Sample<N>>,
}

impl<const N: usize> Solid<N> {
    /// Tetrahedra that are at rest at `rest_mm`. The middle nodes of quadratic ones are taken to
    /// lie halfway.
    ///
    /// # Errors
    /// If an element names a node that is not there, or has no volume.
    pub fn new(rest_mm: &[Point], elements: Vec<[u32; N]>, law: SolidLaw) -> Result<Self, SolidError> {
        if N != 4 && N != 10 {
            return Err(SolidError::Shape { nodes: N });
        }
        let mut samples = Vec::with_capacity(elements.len() * points(N).len());
        for (e, nodes) in elements.iter().enumerate() {
            if let Some(&node) = nodes.iter().find(|&&n| n as usize >= rest_mm.len()) {
                return Err(SolidError::Node { element: e, node, nodes: rest_mm.len() });
            }
            let (corner, volume_mm3) = corner_gradients(rest_mm, nodes, e)?;
            let at_rest = law.tangent(&Matrix3::identity());
            samples.extend(points(N).iter().map(|at| Sample {
                gradient: shape_gradients(&corner, at),
                weight_mm3: volume_mm3 / points(N).len() as f64,
                tangent: at_rest,
            }));
        }
        Ok(Solid { law, elements, samples })
    }

    /// Adds each element's mass, of `density_g_per_mm3`, to its nodes: a quarter to each corner of
    /// a linear one; in a quadratic one 1/36 to each corner and 4/27 to each middle (Hinton, Rock
    /// and Zienkiewicz 1976).
    pub fn add_mass(&self, density_g_per_mm3: f64, mass_g: &mut [f64]) {
        for (nodes, samples) in self.elements.iter().zip(self.samples.chunks_exact(points(N).len())) {
            let mass: f64 = samples.iter().map(|s| s.weight_mm3 * density_g_per_mm3).sum();
            for (i, &n) in nodes.iter().enumerate() {
                let share = match (N, i) {
                    (4, _) => 0.25,
                    (_, 0..4) => 1.0 / 36.0,
                    _ => 4.0 / 27.0,
                };
                mass_g[n as usize] += mass * share;
            }
        }
    }

    /// First Piola–Kirchhoff stress at each quadrature point of an element, Pa.
    pub fn stress_pa(&self, element: usize, x_mm: &[Point]) -> impl Iterator<Item = Matrix3<f64>> {
        let each = points(N).len();
        let samples = &self.samples[element * each..(element + 1) * each];
        samples.iter().map(move |s| self.law.stress(&gradient(&self.elements[element], s, x_mm)))
    }

    /// Every sample with its element's nodes.
    fn all(&self) -> impl Iterator<Item = (&[u32; N], &Sample<N>)> {
        let each = points(N).len();
        self.samples.iter().enumerate().map(move |(s, sample)| (&self.elements[s / each], sample))
    }
}

/// Quadrature points in barycentric coordinates; all have the same weight.
fn points(nodes: usize) -> &'static [[f64; 4]] {
    /// (5 − √5)/20 and (5 + 3√5)/20: degree 2.
    const A: f64 = 0.138_196_601_125_010_5;
    const B: f64 = 0.585_410_196_624_968_5;
    if nodes == 4 { &[[0.25; 4]] } else { &[[B, A, A, A], [A, B, A, A], [A, A, B, A], [A, A, A, B]] }
}

/// Gradients of the barycentric coordinates, 1/mm, and the volume, mm³.
fn corner_gradients(x: &[Point], nodes: &[u32], element: usize) -> Result<([Point; 4], f64), SolidError> {
    let corner = |i: usize| x[nodes[i] as usize];
    let [a, b, c] = [1, 2, 3].map(|i| corner(i) - corner(0));
    let six = a.dot(&b.cross(&c));
    let longest = [a, b, c, b - a, c - a, c - b].iter().fold(0.0, |l, e| e.norm().max(l));
    // Written so that a number that is not finite is refused as well.
    if !(six > LEAST_SHAPE * longest * longest * longest && six.is_finite()) {
        return Err(SolidError::Volume { element, volume_mm3: six / 6.0 });
    }
    let (g1, g2, g3) = (b.cross(&c) / six, c.cross(&a) / six, a.cross(&b) / six);
    Ok(([-(g1 + g2 + g3), g1, g2, g3], six / 6.0))
}

/// Gradients of the shape functions at barycentric coordinates `at`: L_i, or L_i (2 L_i − 1) and 4
/// L_i L_j.
fn shape_gradients<const N: usize>(corner: &[Point; 4], at: &[f64; 4]) -> [Point; N] {
    std::array::from_fn(|i| match (N, i) {
        (4, _) => corner[i],
        (_, 0..4) => corner[i] * (4.0 * at[i] - 1.0),
        _ => {
            let [p, q] = EDGES[i - 4];
            corner[p] * (4.0 * at[q]) + corner[q] * (4.0 * at[p])
        }
    })
}

fn gradient<const N: usize>(nodes: &[u32; N], sample: &Sample<N>, p: &[Point]) -> Matrix3<f64> {
    let mut f = Matrix3::zeros();
    for (n, g) in nodes.iter().zip(&sample.gradient) {
        let x = &p[*n as usize];
        for column in 0..3 {
            let mut to = f.column_mut(column);
            to += x * g[column];
        }
    }
    f
}

fn spread<const N: usize>(nodes: &[u32; N], sample: &Sample<N>, p: &Matrix3<f64>, out: &mut [Point]) {
    for (n, g) in nodes.iter().zip(&sample.gradient) {
        out[*n as usize] += p * g;
    }
}

impl<const N: usize> Elastic for Solid<N> {
    fn add_forces(&self, x_mm: &[Point], _: &[Point], force_un: &mut [Point]) {
        for (nodes, sample) in self.all() {
            let p = self.law.stress(&gradient(nodes, sample, x_mm)) * -sample.weight_mm3;
            spread(nodes, sample, &p, force_un);
        }
    }

    fn linearise(&mut self, x_mm: &[Point]) {
        let each = points(N).len();
        for (s, sample) in self.samples.iter_mut().enumerate() {
            let f = gradient(&self.elements[s / each], sample, x_mm);
            sample.tangent = self.law.tangent(&f);
        }
    }

    fn add_product(&self, stiffness: f64, _: f64, p: &[Point], out: &mut [Point]) {
        for (nodes, sample) in self.all() {
            let df = gradient(nodes, sample, p);
            let dp = sample.tangent.stress_change(&df) * (stiffness * sample.weight_mm3);
            spread(nodes, sample, &dp, out);
        }
    }

    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        let energy = |(nodes, sample): (&[u32; N], &Sample<N>)| {
            sample.weight_mm3 * self.law.energy(&gradient(nodes, sample, x_mm))
        };
        self.all().map(energy).sum()
    }
}

/// Makes quadratic tetrahedra of linear ones: nodes in the middles of the edges are appended.
pub fn with_middles(x_mm: &mut Vec<Point>, elements: &[[u32; 4]]) -> Vec<[u32; 10]> {
    let mut middles = std::collections::BTreeMap::new();
    let mut quadratic = |corners: &[u32; 4]| {
        std::array::from_fn(|i| {
            let Some([p, q]) = i.checked_sub(4).map(|e| EDGES[e].map(|c| corners[c])) else {
                return corners[i];
            };
            *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                x_mm.push((x_mm[p as usize] + x_mm[q as usize]) * 0.5);
                x_mm.len() as u32 - 1
            })
        })
    };
    elements.iter().map(&mut quadratic).collect()
}

/// A block of `cells` boxes along x, y and z, each cut into six tetrahedra around one diagonal
/// (Kuhn), from the origin to `size_mm`. Nodes run along z fastest, then y, then x.
pub fn block(size_mm: [f64; 3], cells: [u32; 3]) -> (Vec<Point>, Vec<[u32; 4]>) {
    let [nx, ny, nz] = cells;
    let node = |i: u32, j: u32, k: u32| (i * (ny + 1) + j) * (nz + 1) + k;
    let mut x = Vec::new();
    let mut tetrahedra = Vec::new();
    for (i, j, k) in grid([nx + 1, ny + 1, nz + 1]) {
        let at = |n: u32, cells: u32, size: f64| size * f64::from(n) / f64::from(cells);
        x.push(Point::new(at(i, nx, size_mm[0]), at(j, ny, size_mm[1]), at(k, nz, size_mm[2])));
    }
    for (i, j, k) in grid(cells) {
        for [p, q, r] in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let mut at = [i, j, k];
            let mut corner = |axis: usize| {
                at[axis] += 1;
                node(at[0], at[1], at[2])
            };
            let (a, [b, c, d]) = (node(i, j, k), [corner(p), corner(q), corner(r)]);
            // Every second permutation is odd, and its tetrahedron would be inverted.
            let even = matches!([p, q, r], [0, 1, 2] | [1, 2, 0] | [2, 0, 1]);
            tetrahedra.push(if even { [a, b, c, d] } else { [a, c, b, d] });
        }
    }
    (x, tetrahedra)
}

fn grid([nx, ny, nz]: [u32; 3]) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..nx).flat_map(move |i| (0..ny).flat_map(move |j| (0..nz).map(move |k| (i, j, k))))
}

#[cfg(test)]
mod tests {
    use super::super::law::Lame;
    use super::super::tests::*;
    use super::*;

    fn laws() -> [SolidLaw; 2] {
        let lame = Lame::from_young(100.0, 0.3);
        [SolidLaw::Corotational(lame), SolidLaw::NeoHookean(lame)]
    }

    #[test]
    fn forces_and_tangents_are_consistent() {
        for law in laws() {
            let (mut x, linear) = block([1.0, 1.0, 1.0], [1, 1, 1]);
            let mut solid = Solid::new(&x, linear.clone(), law).unwrap();
            let moved = jitter(&x, 0.1, 9);
            forces_follow_from_energy(&solid, &moved, 100.0);
            // The co-rotational tangent leaves out how the rotation follows the strain: exact at
            // rest only.
            tangent_follows_from_forces(&mut solid, &x, 1e-6);
            let share = if matches!(law, SolidLaw::NeoHookean(_)) { 1e-6 } else { 0.2 };
            tangent_follows_from_forces(&mut solid, &moved, share);
            let quadratic = with_middles(&mut x, &linear);
            let mut solid = Solid::new(&x, quadratic, law).unwrap();
            forces_follow_from_energy(&solid, &jitter(&x, 0.03, 9), 100.0);
            tangent_follows_from_forces(&mut solid, &x, 1e-6);
        }
    }

    #[test]
    fn a_block_has_its_mass_and_volume() {
        let (mut x, linear) = block([2.0, 0.5, 3.0], [3, 2, 4]);
        let quadratic = with_middles(&mut x, &linear);
        let mut mass = [vec![0.0; x.len()], vec![0.0; x.len()]];
        Solid::new(&x, linear, laws()[0]).unwrap().add_mass(0.1, &mut mass[0]);
        Solid::new(&x, quadratic, laws()[0]).unwrap().add_mass(0.1, &mut mass[1]);
        for all in &mass {
            assert!((all.iter().sum::<f64>() - 0.3).abs() < 1e-12);
        }
        assert!(mass[1].iter().all(|&m| m > 0.0));
    }

    #[test]
    fn bad_tetrahedra_are_named() {
        let x = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point::from);
        let new = |e: [u32; 4]| Solid::new(&x, vec![[0, 1, 2, 3], e], laws()[0]).unwrap_err();
        assert_eq!(new([0, 1, 2, 9]), SolidError::Node { element: 1, node: 9, nodes: 4 });
        assert_eq!(new([0, 2, 1, 3]), SolidError::Volume { element: 1, volume_mm3: -1.0 / 6.0 });
        assert!(matches!(new([0, 1, 1, 3]), SolidError::Volume { element: 1, .. }));
        let five = Solid::new(&x, vec![[0, 1, 2, 3, 0]], laws()[0]).unwrap_err();
        assert_eq!(five, SolidError::Shape { nodes: 5 });
    }
}
