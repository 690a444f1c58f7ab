//! Conjugate gradients without a matrix, preconditioned with the masses.
//!
//! Preconditioned with M, each iterate d of (M + …K) d = r keeps Σ m d = Σ r, because the elastic
//! part adds no net force. So an implicit step conserves momentum to rounding however early the
//! iteration ends. Sums run in the order of the nodes.

use super::Point;

/// Arrays of a solve.
#[derive(Debug, Clone, Default)]
pub struct Conjugate {
    residual: Vec<Point>,
    direction: Vec<Point>,
    product: Vec<Point>,
    /// The solution, per node.
    pub solution: Vec<Point>,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Iterations at most.
    pub iterations: u32,
    /// Share to which the residual must fall (in the norm of M⁻¹).
    pub share: f64,
}

impl Conjugate {
    /// Solves A d = `right` into `solution`, from 0. `add_product` adds A p to its second argument;
    /// held nodes stay 0. Returns the iterations used. Stops where A shows no positive curvature:
    /// with the best so far.
    pub fn solve(
        &mut self,
        right: &[Point],
        mass_g: &[f64],
        held: &[bool],
        limits: Limits,
        mut add_product: impl FnMut(&[Point], &mut [Point]),
    ) -> u32 {
        self.begin(right, mass_g, held);
        let mut rho = self.weighted_square(mass_g);
        let goal = rho * limits.share * limits.share;
        for iteration in 0..limits.iterations {
            // A residual that is not finite ends the iteration too.
            if rho.is_nan() || rho <= goal || rho == 0.0 {
                return iteration;
            }
            self.product.fill(Point::zeros());
            add_product(&self.direction, &mut self.product);
            let curvature = dot(&self.direction, &self.product);
            if curvature.is_nan() || curvature <= 0.0 {
                return iteration;
            }
            let step = rho / curvature;
            for (i, held) in held.iter().enumerate() {
                self.solution[i] += self.direction[i] * step;
                if !held {
                    self.residual[i] -= self.product[i] * step;
                }
            }
            let next = self.weighted_square(mass_g);
            let keep = next / rho;
            for (i, mass) in mass_g.iter().enumerate() {
                self.direction[i] = self.residual[i] / *mass + self.direction[i] * keep;
            }
            rho = next;
        }
        limits.iterations
    }

    fn begin(&mut self, right: &[Point], mass_g: &[f64], held: &[bool]) {
        let n = right.len();
        for array in [&mut self.residual, &mut self.direction, &mut self.product, &mut self.solution] {
            array.resize(n, Point::zeros());
        }
        for i in 0..n {
            self.residual[i] = if held[i] { Point::zeros() } else { right[i] };
            self.direction[i] = self.residual[i] / mass_g[i];
            self.solution[i] = Point::zeros();
        }
    }

    fn weighted_square(&self, mass_g: &[f64]) -> f64 {
        self.residual.iter().zip(mass_g).map(|(r, m)| r.norm_squared() / m).sum()
    }
}

/// Σ a·b over the nodes.
pub fn dot(a: &[Point], b: &[Point]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};

    /// Against nalgebra's Cholesky on a random positive definite system of 5 nodes, one of them
    /// held.
    #[test]
    fn solves_what_a_direct_method_solves() {
        let b = SMatrix::<f64, 15, 15>::from_fn(|r, c| libm::sin((r * 15 + c) as f64 * 1.7));
        let a = b.transpose() * b + SMatrix::<f64, 15, 15>::identity();
        let right: Vec<Point> = (0..5).map(|i| Point::new(i as f64, 1.0, -0.5 * i as f64)).collect();
        let mut held = [false; 5];
        held[2] = true;
        let free: Vec<usize> = (0..15).filter(|i| !held[i / 3]).collect();
        let small = SMatrix::<f64, 12, 12>::from_fn(|r, c| a[(free[r], free[c])]);
        let rhs = SVector::<f64, 12>::from_fn(|r, _| right[free[r] / 3][free[r] % 3]);
        let expected = small.cholesky().unwrap().solve(&rhs);
        let mut solver = Conjugate::default();
        let mass = [0.5, 1.0, 2.0, 1.0, 3.0];
        let limits = Limits { iterations: 200, share: 1e-13 };
        solver.solve(&right, &mass, &held, limits, |p, out| {
            for r in 0..15 {
                out[r / 3][r % 3] += (0..15).map(|c| a[(r, c)] * p[c / 3][c % 3]).sum::<f64>();
            }
        });
        assert_eq!(solver.solution[2], Point::zeros());
        for (r, &i) in free.iter().enumerate() {
            assert!((solver.solution[i / 3][i % 3] - expected[r]).abs() < 1e-9);
        }
    }

    #[test]
    fn bad_numbers_end_it_at_once() {
        let mut solver = Conjugate::default();
        let right = [Point::new(f64::NAN, 0.0, 0.0)];
        let limits = Limits { iterations: 50, share: 1e-6 };
        let used = solver.solve(&right, &[1.0], &[false], limits, |p, out| out[0] += p[0]);
        assert_eq!((used, solver.solution[0]), (0, Point::zeros()));
    }
}
