//! Hooke springs with dampers, for the integrators of this folder.
//!
//! Between nodes a and b with d = x_b − x_a, l = |d|, u = d/l, tension T = k (l − l₀):
//!
//! ```text
//! f_a = −f_b = (T + c u·(v_b − v_a)) u
//! K   = k u uᵀ + (T/l)⁺ (1 − u uᵀ)      C = c u uᵀ
//! ```
//!
//! Only the positive part of T/l enters the tangent: a pressed spring wants to buckle, and its
//! exact tangent would make the system indefinite. Forces are exact, so a converged step is not
//! affected.

use super::{Elastic, Point};

/// Shortest length that still has a direction, mm: protects a division, 1 nm.
const TINY_MM: f64 = 1e-6;

/// A spring.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spring {
    /// Nodes.
    pub ends: [u32; 2],
    /// k, µN/mm.
    pub stiffness_un_per_mm: f64,
    /// c, µN·s/mm.
    pub damping_un_s_per_mm: f64,
    /// l₀, mm.
    pub rest_mm: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Tangent {
    along: Point,
    /// k − (T/l)⁺, µN/mm.
    axial: f64,
    /// (T/l)⁺, µN/mm.
    across: f64,
}

/// Springs.
#[derive(Debug, Clone, Default)]
pub struct Springs {
    springs: Vec<Spring>,
    tangent: Vec<Tangent>,
}

impl Springs {
    /// These springs.
    pub fn new(springs: Vec<Spring>) -> Self {
        let mut all = Springs::default();
        all.replace(springs);
        all
    }

    /// Other springs, in the memory of the old ones as far as it goes.
    pub fn replace(&mut self, springs: impl IntoIterator<Item = Spring>) {
        self.springs.clear();
        self.springs.extend(springs);
        self.tangent.clear();
        self.tangent.resize(self.springs.len(), Tangent::default());
    }

    /// The springs.
    pub fn springs(&self) -> &[Spring] {
        &self.springs
    }
}

/// Length (mm) and direction of a spring.
fn stretch(spring: &Spring, x_mm: &[Point]) -> (f64, Point) {
    let [a, b] = spring.ends.map(|n| n as usize);
    let d = x_mm[b] - x_mm[a];
    let length = (d.norm_squared() + TINY_MM * TINY_MM).sqrt();
    (length, d / length)
}

impl Elastic for Springs {
    fn add_forces(&self, x_mm: &[Point], v_mm_s: &[Point], force_un: &mut [Point]) {
        for spring in &self.springs {
            let [a, b] = spring.ends.map(|n| n as usize);
            let (length, along) = stretch(spring, x_mm);
            let rate = (v_mm_s[b] - v_mm_s[a]).dot(&along);
            let pull = spring.stiffness_un_per_mm * (length - spring.rest_mm);
            let force = along * (pull + spring.damping_un_s_per_mm * rate);
            force_un[a] += force;
            force_un[b] -= force;
        }
    }

    fn linearise(&mut self, x_mm: &[Point]) {
        for (spring, tangent) in self.springs.iter().zip(&mut self.tangent) {
            let (length, along) = stretch(spring, x_mm);
            let stiffness = spring.stiffness_un_per_mm;
            let taut = stiffness * (length - spring.rest_mm) / length;
            let across = if taut > 0.0 { taut } else { 0.0 };
            *tangent = Tangent { along, axial: stiffness - across, across };
        }
    }

    fn add_product(&self, stiffness: f64, damping: f64, p: &[Point], out: &mut [Point]) {
        for (spring, t) in self.springs.iter().zip(&self.tangent) {
            let [a, b] = spring.ends.map(|n| n as usize);
            let d = p[b] - p[a];
            let axial = stiffness * t.axial + damping * spring.damping_un_s_per_mm;
            let force = d * (stiffness * t.across) + t.along * (axial * d.dot(&t.along));
            out[a] -= force;
            out[b] += force;
        }
    }

    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        let energy = |spring: &Spring| {
            let longer = stretch(spring, x_mm).0 - spring.rest_mm;
            0.5 * spring.stiffness_un_per_mm * longer * longer
        };
        self.springs.iter().map(energy).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::*;
    use super::*;

    fn taut() -> (Springs, Vec<Point>) {
        let spring = |a, b, rest_mm| Spring {
            ends: [a, b],
            stiffness_un_per_mm: 300.0,
            damping_un_s_per_mm: 0.4,
            rest_mm,
        };
        let springs = vec![spring(0, 1, 0.7), spring(1, 2, 0.5), spring(2, 0, 0.9), spring(2, 3, 0.4)];
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, 0.9, 0.0], [0.5, 0.4, 1.0]];
        (Springs::new(springs), jitter(&corners.map(Point::from), 0.05, 3))
    }

    #[test]
    fn forces_and_tangent_are_consistent() {
        let (mut springs, x) = taut();
        forces_follow_from_energy(&springs, &x, 300.0);
        tangent_follows_from_forces(&mut springs, &x, 1e-6);
    }

    #[test]
    fn dampers_resist_the_rate_of_length_alone() {
        let (springs, x) = taut();
        let still = vec![Point::zeros(); 4];
        let mut moving = still.clone();
        moving[3] = Point::new(1.0, -2.0, 0.5);
        let (mut with, mut without) = (still.clone(), still.clone());
        springs.add_forces(&x, &moving, &mut with);
        springs.add_forces(&x, &still, &mut without);
        let along = (x[3] - x[2]).normalize();
        let expected = -along * (0.4 * along.dot(&moving[3]));
        assert!((with[3] - without[3] - expected).norm() < 1e-9);
    }

    #[test]
    fn a_pressed_spring_keeps_the_tangent_positive() {
        let (mut springs, x) = taut();
        springs.linearise(&x.iter().map(|x| x * 0.3).collect::<Vec<_>>());
        for seed in 0..20 {
            let p = jitter(&[Point::zeros(); 4], 1.0, seed);
            let mut out = vec![Point::zeros(); 4];
            springs.add_product(1.0, 0.0, &p, &mut out);
            assert!(super::super::conjugate::dot(&p, &out) >= 0.0);
        }
    }
}
