//! Constant-strain membrane triangles under plane stress, any [`PlaneLaw`].
//!
//! In a reference plane of its own a triangle has the corners X_i and the constant gradients
//! g_i = ∇N_i (1/mm); with area A and F = Σ x_i g_iᵀ (3×2), C = FᵀF:
//!
//! ```text
//! energy A w(C),   f_i = −A F S(C) g_i,   df_i = −A (dF S⁺ + F dS) g_i
//! ```
//!
//! S⁺ is S without its pressing part: a pressed membrane wrinkles, and its exact tangent is
//! indefinite.

use super::law::PlaneLaw;
use super::{Elastic, Point};
use nalgebra::{Matrix2, Matrix3x2, Vector2};

/// Least ratio of a triangle's double area to its longest edge squared: below it is taken for a
/// line.
const LEAST_SHAPE: f64 = 1e-6;

/// Why triangles were refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TriangleError {
    /// A corner that does not exist.
    #[error("triangle {triangle}: corner {corner} is not one of the {nodes} nodes")]
    Corner {
        /// Which triangle.
        triangle: usize,
        /// Its corner.
        corner: u32,
        /// Nodes there are.
        nodes: usize,
    },
    /// Corners on a line, or not finite.
    #[error("triangle {triangle}: expected an area, found {area_mm2} mm²")]
    Flat {
        /// Which triangle.
        triangle: usize,
        /// Its area, mm².
        area_mm2: f64,
    },
}

/// A triangle's reference shape.
#[derive(Debug, Clone, Copy)]
struct Shape {
    corners: [u32; 3],
    gradient: [Vector2<f64>; 3],
    area_mm2: f64,
}

#[derive(Debug, Clone, Copy)]
struct Tangent {
    f: Matrix3x2<f64>,
    c: Matrix2<f64>,
    /// S⁺, µN/mm.
    taut: Matrix2<f64>,
}

/// Triangles of one law.
#[derive(Debug, Clone)]
pub struct Triangles {
    law: PlaneLaw,
    shapes: Vec<Shape>,
    alive: Vec<bool>,
    tangent: Vec<Tangent>,
}

impl Triangles {
    /// Triangles that are at rest at `rest_mm`.
    ///
    /// # Errors
    /// If a triangle names a node that is not there, or has no area.
    pub fn new(rest_mm: &[Point], triangles: &[[u32; 3]], law: PlaneLaw) -> Result<Self, TriangleError> {
        let shape = |(t, corners): (usize, &[u32; 3])| shape(rest_mm, t, *corners);
        let shapes: Vec<Shape> = triangles.iter().enumerate().map(shape).collect::<Result<_, _>>()?;
        let none = Tangent { f: Matrix3x2::zeros(), c: Matrix2::identity(), taut: Matrix2::zeros() };
        Ok(Triangles { law, alive: vec![true; shapes.len()], tangent: vec![none; shapes.len()], shapes })
    }

    /// No triangles, and no law that would matter.
    pub fn none() -> Self {
        let law = PlaneLaw::Taut { tension_un_per_mm: 0.0 };
        Triangles { law, shapes: Vec::new(), alive: Vec::new(), tangent: Vec::new() }
    }

    /// Removes a triangle or brings it back.
    pub fn set_alive(&mut self, triangle: usize, alive: bool) {
        self.alive[triangle] = alive;
    }

    /// Adds each living triangle's mass, of `density_g_per_mm2` per reference area, to its corners.
    pub fn add_mass(&self, density_g_per_mm2: f64, mass_g: &mut [f64]) {
        for shape in self.living().map(|(_, shape)| shape) {
            for n in shape.corners {
                mass_g[n as usize] += density_g_per_mm2 * shape.area_mm2 / 3.0;
            }
        }
    }

    /// True tensions (Cauchy stress × thickness) of a triangle, the larger first, µN/mm.
    pub fn tensions_un_per_mm(&self, triangle: usize, x_mm: &[Point]) -> [f64; 2] {
        let f = gradient(&self.shapes[triangle], x_mm);
        let c = f.transpose() * f;
        // F S Fᵀ / J has the eigenvalues of S C / J.
        let m = self.law.stress(&c) * c / c.determinant().max(f64::MIN_POSITIVE).sqrt();
        let (mean, product) = (0.5 * m.trace(), m.determinant());
        let spread = (mean * mean - product).max(0.0).sqrt();
        [mean + spread, mean - spread]
    }

    fn living(&self) -> impl Iterator<Item = (usize, &Shape)> {
        self.shapes.iter().enumerate().filter(|(t, _)| self.alive[*t])
    }
}

fn shape(x: &[Point], triangle: usize, corners: [u32; 3]) -> Result<Shape, TriangleError> {
    if let Some(&corner) = corners.iter().find(|&&n| n as usize >= x.len()) {
        return Err(TriangleError::Corner { triangle, corner, nodes: x.len() });
    }
    let [a, b, c] = corners.map(|n| x[n as usize]);
    let (ab, ac) = (b - a, c - a);
    let twice = ab.cross(&ac).norm();
    let longest = ab.norm_squared().max(ac.norm_squared()).max((c - b).norm_squared());
    // Written so that a number that is not finite is refused as well.
    if !(twice > LEAST_SHAPE * longest && twice.is_finite()) {
        return Err(TriangleError::Flat { triangle, area_mm2: 0.5 * twice });
    }
    let along = ab / ab.norm();
    let (x1, x2) = (ab.norm(), ac.dot(&along));
    let y2 = twice / x1;
    // Edge matrix [[x1, x2], [0, y2]]; the rows of its inverse are the gradients of N_1 and N_2.
    let g1 = Vector2::new(1.0 / x1, -x2 / (x1 * y2));
    let g2 = Vector2::new(0.0, 1.0 / y2);
    Ok(Shape { corners, gradient: [-(g1 + g2), g1, g2], area_mm2: 0.5 * twice })
}

/// Σ p_i g_iᵀ.
fn gradient(shape: &Shape, p: &[Point]) -> Matrix3x2<f64> {
    let [a, b, c] = shape.corners.map(|n| p[n as usize]);
    let [_, g1, g2] = &shape.gradient;
    (b - a) * g1.transpose() + (c - a) * g2.transpose()
}

/// `m` without its negative principal part.
fn positive(m: &Matrix2<f64>) -> Matrix2<f64> {
    let (mean, half) = (0.5 * m.trace(), 0.5 * (m.m11 - m.m22));
    let spread = (half * half + m.m12 * m.m12).sqrt();
    if mean >= spread {
        return *m;
    }
    if mean <= -spread {
        return Matrix2::zeros();
    }
    // One principal value is positive: m⁺ = λ₁ (m − λ₂)/(λ₁ − λ₂).
    let (first, second) = (mean + spread, mean - spread);
    (m - Matrix2::identity() * second) * (first / (first - second))
}

impl Elastic for Triangles {
    fn add_forces(&self, x_mm: &[Point], _: &[Point], force_un: &mut [Point]) {
        for (_, shape) in self.living() {
            let f = gradient(shape, x_mm);
            let p = f * self.law.stress(&(f.transpose() * f)) * shape.area_mm2;
            for (n, g) in shape.corners.iter().zip(&shape.gradient) {
                force_un[*n as usize] -= p * g;
            }
        }
    }

    fn linearise(&mut self, x_mm: &[Point]) {
        for (shape, tangent) in self.shapes.iter().zip(&mut self.tangent) {
            let f = gradient(shape, x_mm);
            let c = f.transpose() * f;
            *tangent = Tangent { f, c, taut: positive(&self.law.stress(&c)) };
        }
    }

    fn add_product(&self, stiffness: f64, _: f64, p: &[Point], out: &mut [Point]) {
        for (t, shape) in self.living() {
            let tangent = &self.tangent[t];
            let df = gradient(shape, p);
            let dc = tangent.f.transpose() * df;
            let ds = self.law.stress_change(&tangent.c, &(dc + dc.transpose()));
            let change = (df * tangent.taut + tangent.f * ds) * (stiffness * shape.area_mm2);
            for (n, g) in shape.corners.iter().zip(&shape.gradient) {
                out[*n as usize] += change * g;
            }
        }
    }

    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        let energy = |(_, shape): (usize, &Shape)| {
            let f = gradient(shape, x_mm);
            shape.area_mm2 * self.law.energy(&(f.transpose() * f))
        };
        self.living().map(energy).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::*;
    use super::*;

    const LAWS: [PlaneLaw; 3] = [
        PlaneLaw::StVenantKirchhoff { young_un_per_mm: 100.0, poisson: 0.3 },
        PlaneLaw::NeoHookean { shear_un_per_mm: 40.0 },
        PlaneLaw::Taut { tension_un_per_mm: 30.0 },
    ];

    fn patch(law: PlaneLaw) -> (Triangles, Vec<Point>) {
        let rest = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [0.9, 1.1, 0.0], [0.1, 0.8, -0.1], [0.5, 0.4, 0.3]];
        let rest = rest.map(Point::from);
        let triangles = Triangles::new(&rest, &[[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], law).unwrap();
        (triangles, rest.to_vec())
    }

    #[test]
    fn forces_and_tangent_are_consistent_for_every_law() {
        for law in LAWS {
            let (mut triangles, rest) = patch(law);
            // Stretched throughout, so that nothing presses and the tangent is exact.
            let x: Vec<Point> = jitter(&rest, 0.05, 5).iter().map(|x| x * 1.4).collect();
            forces_follow_from_energy(&triangles, &x, 100.0);
            tangent_follows_from_forces(&mut triangles, &x, 1e-6);
        }
    }

    #[test]
    fn a_pressed_membrane_keeps_the_tangent_positive() {
        for law in [LAWS[0], LAWS[2]] {
            let (mut triangles, rest) = patch(law);
            triangles.linearise(&jitter(&rest, 0.3, 2).iter().map(|x| x * 0.6).collect::<Vec<_>>());
            for seed in 0..20 {
                let p = jitter(&[Point::zeros(); 5], 1.0, seed);
                let mut out = vec![Point::zeros(); 5];
                triangles.add_product(1.0, 0.0, &p, &mut out);
                assert!(super::super::conjugate::dot(&p, &out) >= -1e-9, "{law:?}");
            }
        }
    }

    /// Textbook: uniaxial strain e of a sheet gives the tensions E t e/(1−ν²) and ν times that.
    #[test]
    fn tensions_of_a_stretched_sheet_are_hookes() {
        let (triangles, rest) = patch(LAWS[0]);
        let flat: Vec<Point> = rest.iter().map(|x| Point::new(x.x, x.y, 0.0)).collect();
        let sheet = Triangles::new(&flat, &[[0, 1, 4]], triangles.law).unwrap();
        let e = 1e-5;
        let x: Vec<Point> = flat.iter().map(|x| Point::new(x.x * (1.0 + e), x.y, 0.0)).collect();
        let [first, second] = sheet.tensions_un_per_mm(0, &x);
        let plate = 100.0 * e / (1.0 - 0.09);
        assert!((first / plate - 1.0).abs() < 1e-4 && (second / (0.3 * plate) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn bad_triangles_are_named() {
        let x = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]].map(Point::from);
        let new = |t: [u32; 3]| Triangles::new(&x, &[t], LAWS[0]).unwrap_err();
        assert_eq!(new([0, 1, 7]), TriangleError::Corner { triangle: 0, corner: 7, nodes: 3 });
        assert_eq!(new([0, 1, 2]), TriangleError::Flat { triangle: 0, area_mm2: 0.0 });
        let bad = [Point::new(f64::NAN, 0.0, 0.0), x[1], x[2]];
        assert!(Triangles::new(&bad, &[[0, 1, 2]], LAWS[0]).is_err());
    }

    #[test]
    fn a_removed_triangle_carries_nothing() {
        let (mut triangles, rest) = patch(LAWS[0]);
        let x: Vec<Point> = rest.iter().map(|x| x * 1.2).collect();
        (0..4).for_each(|t| triangles.set_alive(t, false));
        let mut force = vec![Point::zeros(); 5];
        triangles.add_forces(&x, &x, &mut force);
        assert_eq!(force, vec![Point::zeros(); 5]);
        assert_eq!(triangles.energy_nj(&x), 0.0);
    }
}
