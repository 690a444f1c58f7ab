//! Springs without length from nodes to places of their own: the tangent of outer forces that grow
//! with the way, such as adhesion.
//!
//! ```text
//! f = −s (x − x₀)     K = s     U = ½ s (x − x₀)²
//! ```
//!
//! Where x₀ is the node's position at the begin of a step, f is 0 there: what pulls already is an
//! outer force, and the anchor only says by how much it grows on the way.

use super::{Elastic, Point};

/// Anchors, one a node.
#[derive(Debug, Clone)]
pub struct Anchors {
    /// x₀, mm.
    pub place_mm: Vec<Point>,
    /// s, µN/mm; 0 where there is none.
    pub stiffness_un_per_mm: Vec<f64>,
}

impl Anchors {
    /// None yet, for `nodes`.
    pub fn none(nodes: usize) -> Self {
        Anchors { place_mm: vec![Point::zeros(); nodes], stiffness_un_per_mm: vec![0.0; nodes] }
    }
}

impl Elastic for Anchors {
    fn add_forces(&self, x_mm: &[Point], _v_mm_s: &[Point], force_un: &mut [Point]) {
        for (i, s) in self.stiffness_un_per_mm.iter().enumerate() {
            force_un[i] -= (x_mm[i] - self.place_mm[i]) * *s;
        }
    }

    fn linearise(&mut self, _x_mm: &[Point]) {}

    fn add_product(&self, stiffness: f64, _damping: f64, p: &[Point], out: &mut [Point]) {
        for (i, s) in self.stiffness_un_per_mm.iter().enumerate() {
            out[i] += p[i] * (stiffness * s);
        }
    }

    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        let ways = x_mm.iter().zip(&self.place_mm).map(|(x, place)| (x - place).norm_squared());
        ways.zip(&self.stiffness_un_per_mm).map(|(way2, s)| 0.5 * s * way2).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::*;
    use super::*;

    #[test]
    fn forces_energy_and_tangent_are_consistent() {
        let place_mm = jitter(&[Point::zeros(); 5], 3.0, 1);
        let x = jitter(&place_mm, 0.5, 2);
        let mut anchors = Anchors { place_mm, stiffness_un_per_mm: vec![40.0, 0.0, 7.0, 300.0, 1.0] };
        tangent_follows_from_forces(&mut anchors, &x, 1e-6);
        let mut force = vec![Point::zeros(); 5];
        anchors.add_forces(&x, &[Point::zeros(); 5], &mut force);
        for (i, force) in force.iter().enumerate() {
            let mut moved = x.clone();
            moved[i].z += 1e-5;
            let up = anchors.energy_nj(&moved);
            moved[i].z -= 2e-5;
            let slope = (up - anchors.energy_nj(&moved)) / 2e-5;
            assert!((force.z + slope).abs() < 1e-5, "{} {slope}", force.z);
        }
    }
}
