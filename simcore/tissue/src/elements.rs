//! Continuum elements and the integrators that move them: what a scene asks for beyond explicit
//! springs.
//!
//! ```text
//! Elastic   forces, tangent and energy of something elastic:
//!             anchors::Anchors      outer forces that grow with the way, such as adhesion
//!             springs::Springs      Hooke springs with dampers
//!             triangle::Triangles   constant-strain membrane triangles (plane stress)
//!             solid::Solid          tetrahedra of 4 or 10 nodes
//!             load::Pressure        pressure on a triangulated surface
//! Nodes     positions, velocities, masses, outer forces
//! Integrator::step(nodes, elastic, dt)   explicit, semi-implicit, implicit, midpoint, quasi-static
//! ```
//!
//! Matrices are never assembled: an integrator only asks for products with the tangent, and
//! [`conjugate`] solves with them. Everything is f64, in a fixed order of sums, on one thread;
//! nothing allocates after the first step. Units are mm, g, s, hence µN, Pa, and nJ (µN·mm) for
//! energy.

pub mod anchors;
pub mod conjugate;
pub mod integrator;
pub mod law;
pub mod load;
pub mod solid;
pub mod springs;
pub mod triangle;

use nalgebra::Vector3;

/// A position (mm), velocity (mm/s) or force (µN) in the frame of the tissue.
pub type Point = Vector3<f64>;

/// Something elastic that acts on nodes.
pub trait Elastic {
    /// Adds its forces on nodes at `x_mm` that move with `v_mm_s`, µN.
    fn add_forces(&self, x_mm: &[Point], v_mm_s: &[Point], force_un: &mut [Point]);

    /// Takes the tangent at `x_mm`: K = −∂f/∂x, made positive semi-definite where the exact one is
    /// not, and C = −∂f/∂v.
    fn linearise(&mut self, x_mm: &[Point]);

    /// Adds (`stiffness`·K + `damping`·C) p for the tangent taken last.
    fn add_product(&self, stiffness: f64, damping: f64, p: &[Point], out: &mut [Point]);

    /// Energy stored at `x_mm`, nJ; forces without velocities are its negative gradient.
    fn energy_nj(&self, x_mm: &[Point]) -> f64;
}

/// Two elastic things that share their nodes.
#[derive(Debug, Clone)]
pub struct Both<A, B>(pub A, pub B);

impl<A: Elastic, B: Elastic> Elastic for Both<A, B> {
    fn add_forces(&self, x_mm: &[Point], v_mm_s: &[Point], force_un: &mut [Point]) {
        self.0.add_forces(x_mm, v_mm_s, force_un);
        self.1.add_forces(x_mm, v_mm_s, force_un);
    }
    fn linearise(&mut self, x_mm: &[Point]) {
        self.0.linearise(x_mm);
        self.1.linearise(x_mm);
    }
    fn add_product(&self, stiffness: f64, damping: f64, p: &[Point], out: &mut [Point]) {
        self.0.add_product(stiffness, damping, p, out);
        self.1.add_product(stiffness, damping, p, out);
    }
    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        self.0.energy_nj(x_mm) + self.1.energy_nj(x_mm)
    }
}

/// Nodes in motion.
#[derive(Debug, Clone, Default)]
pub struct Nodes {
    /// Positions, mm.
    pub x_mm: Vec<Point>,
    /// Velocities, mm/s. A held node keeps its own, which its dampers feel, and does not move by
    /// it.
    pub v_mm_s: Vec<Point>,
    /// Masses, g; positive.
    pub mass_g: Vec<f64>,
    /// Held nodes: whoever holds them moves them.
    pub held: Vec<bool>,
    /// Outer forces that do not depend on the positions, µN.
    pub outer_un: Vec<Point>,
}

impl Nodes {
    /// Free nodes at rest at `x_mm`, each of mass `mass_g`.
    pub fn at_rest(x_mm: Vec<Point>, mass_g: f64) -> Self {
        let n = x_mm.len();
        Nodes {
            x_mm,
            v_mm_s: vec![Point::zeros(); n],
            mass_g: vec![mass_g; n],
            held: vec![false; n],
            outer_un: vec![Point::zeros(); n],
        }
    }
}

#[cfg(test)]
mod tests {
    //! What every elastic thing must obey, for the tests of each.

    use super::*;

    /// Positions moved about by up to `by_mm`, from a fixed sequence.
    pub fn jitter(x_mm: &[Point], by_mm: f64, seed: u64) -> Vec<Point> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        };
        x_mm.iter().map(|x| x + Point::new(next(), next(), next()) * by_mm).collect()
    }

    /// Forces are the energy's negative gradient (central differences), sum to nothing and turn
    /// nothing.
    pub fn forces_follow_from_energy(elastic: &impl Elastic, x_mm: &[Point], scale_un: f64) {
        let still = vec![Point::zeros(); x_mm.len()];
        let mut force = still.clone();
        elastic.add_forces(x_mm, &still, &mut force);
        let step = 1e-5;
        for node in 0..x_mm.len() {
            for axis in 0..3 {
                let mut moved = x_mm.to_vec();
                moved[node][axis] += step;
                let up = elastic.energy_nj(&moved);
                moved[node][axis] -= 2.0 * step;
                let slope = (up - elastic.energy_nj(&moved)) / (2.0 * step);
                let (found, expected) = (force[node][axis], -slope);
                assert!((found - expected).abs() < 1e-5 * scale_un, "node {node}: {found} {expected}");
            }
        }
        let total: Point = force.iter().sum();
        let turn: Point = x_mm.iter().zip(&force).map(|(x, f)| x.cross(f)).sum();
        assert!(total.norm() < 1e-10 * scale_un, "{total}");
        assert!(turn.norm() < 1e-9 * scale_un, "{turn}");
    }

    /// The tangent is symmetric and, within `share`, the change of the forces.
    pub fn tangent_follows_from_forces(elastic: &mut impl Elastic, x_mm: &[Point], share: f64) {
        let zero = vec![Point::zeros(); x_mm.len()];
        let p = jitter(&zero, 1.0, 7);
        let q = jitter(&zero, 1.0, 8);
        elastic.linearise(x_mm);
        let (mut kp, mut kq, mut change) = (zero.clone(), zero.clone(), zero.clone());
        elastic.add_product(1.0, 0.0, &p, &mut kp);
        elastic.add_product(1.0, 0.0, &q, &mut kq);
        let dot = |a: &[Point], b: &[Point]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
        let (left, right) = (dot(&q, &kp), dot(&p, &kq));
        assert!((left - right).abs() < 1e-9 * (left.abs() + dot(&p, &kp)), "{left} {right}");
        let step = 1e-6;
        let moved: Vec<Point> = x_mm.iter().zip(&p).map(|(x, p)| x - p * step).collect();
        elastic.add_forces(&moved, &zero, &mut change);
        let moved: Vec<Point> = x_mm.iter().zip(&p).map(|(x, p)| x + p * step).collect();
        let mut after = zero.clone();
        elastic.add_forces(&moved, &zero, &mut after);
        let (mut error, mut size) = (0.0, 0.0);
        for ((before, after), product) in change.iter().zip(&after).zip(&kp) {
            let expected = (before - after) / (2.0 * step);
            error += (expected - product).norm_squared();
            size += expected.norm_squared();
        }
        assert!(error <= share * share * size, "off by {}", (error / size).sqrt());
    }
}
