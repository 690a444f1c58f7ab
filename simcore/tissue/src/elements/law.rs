//! Material laws: energy, stress and tangent at a point, without any mesh.
//!
//! Plane laws take the right Cauchy–Green tensor C = FᵀF (2×2) of a membrane and give, per area of
//! the reference sheet, the energy w (µN/mm), the second Piola–Kirchhoff stress S = 2 ∂w/∂C (µN/mm)
//! and its change. Solid laws take the deformation gradient F (3×3) and give the first
//! Piola–Kirchhoff stress P = ∂Ψ/∂F (Pa) and its change.

use nalgebra::{Matrix2, Matrix3};

/// Smallest area ratio of a triangle that the neo-Hookean law distinguishes: keeps 1/det C finite.
const LEAST_DET: f64 = 1e-4;

/// A membrane under plane stress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlaneLaw {
    /// St. Venant–Kirchhoff: S = E t/(1−ν²) ((1−ν) E + ν tr(E) 1) with the Green strain E = (C −
    /// 1)/2.
    StVenantKirchhoff {
        /// Young's modulus × thickness, µN/mm.
        young_un_per_mm: f64,
        /// Poisson's ratio, −1 to 1.
        poisson: f64,
    },
    /// Incompressible neo-Hookean: w = µt/2 (tr C + 1/det C − 3), the thickness following.
    NeoHookean {
        /// Shear modulus × thickness, µN/mm.
        shear_un_per_mm: f64,
    },
    /// Taut without elasticity of its own: S = T 1, as of springs without rest length. Where the
    /// map is conformal it is a soap film of tension T.
    Taut {
        /// T, µN/mm.
        tension_un_per_mm: f64,
    },
}

impl PlaneLaw {
    /// Energy per reference area, µN/mm.
    pub fn energy(&self, c: &Matrix2<f64>) -> f64 {
        match *self {
            PlaneLaw::StVenantKirchhoff { .. } => {
                let strain = (c - Matrix2::identity()) * 0.5;
                0.5 * self.stress(c).dot(&strain)
            }
            PlaneLaw::NeoHookean { shear_un_per_mm } => {
                0.5 * shear_un_per_mm * (c.trace() + 1.0 / least(c.determinant()) - 3.0)
            }
            PlaneLaw::Taut { tension_un_per_mm } => 0.5 * tension_un_per_mm * c.trace(),
        }
    }

    /// Second Piola–Kirchhoff stress × thickness, µN/mm.
    pub fn stress(&self, c: &Matrix2<f64>) -> Matrix2<f64> {
        match *self {
            PlaneLaw::StVenantKirchhoff { .. } => self.stress_change(c, &(c - Matrix2::identity())),
            PlaneLaw::NeoHookean { shear_un_per_mm } => {
                let det = least(c.determinant());
                (Matrix2::identity() - adjugate(c) / (det * det)) * shear_un_per_mm
            }
            PlaneLaw::Taut { tension_un_per_mm } => Matrix2::identity() * tension_un_per_mm,
        }
    }

    /// Stiffness at rest against a stretch whose breadth is held, µN/mm.
    pub fn stiffness_un_per_mm(&self) -> f64 {
        match *self {
            PlaneLaw::StVenantKirchhoff { young_un_per_mm, poisson } => {
                young_un_per_mm / (1.0 - poisson * poisson)
            }
            PlaneLaw::NeoHookean { shear_un_per_mm } => 4.0 * shear_un_per_mm,
            PlaneLaw::Taut { tension_un_per_mm } => tension_un_per_mm,
        }
    }

    /// Change of the stress with a change `dc` of C, µN/mm.
    pub fn stress_change(&self, c: &Matrix2<f64>, dc: &Matrix2<f64>) -> Matrix2<f64> {
        match *self {
            PlaneLaw::StVenantKirchhoff { young_un_per_mm, poisson } => {
                let strain = dc * 0.5;
                let plate = young_un_per_mm / (1.0 - poisson * poisson);
                (strain * (1.0 - poisson) + Matrix2::identity() * (poisson * strain.trace())) * plate
            }
            PlaneLaw::NeoHookean { shear_un_per_mm } => {
                // S = µt (1 − adj(C)/det²); d det = adj(C):dC.
                let det = least(c.determinant());
                let adj = adjugate(c);
                let d_det = adj.dot(dc);
                (adj * (2.0 * d_det / det) - adjugate(dc)) * (shear_un_per_mm / (det * det))
            }
            PlaneLaw::Taut { .. } => Matrix2::zeros(),
        }
    }
}

/// adj(C) = det(C) C⁻¹ of a symmetric C.
fn adjugate(c: &Matrix2<f64>) -> Matrix2<f64> {
    Matrix2::new(c.m22, -c.m12, -c.m21, c.m11)
}

fn least(det: f64) -> f64 {
    if det > LEAST_DET { det } else { LEAST_DET }
}

/// A solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SolidLaw {
    /// Co-rotational linear elasticity: Ψ = µ |F − R|² + λ/2 tr²(RᵀF − 1), R the rotation in F.
    Corotational(Lame),
    /// Neo-Hookean, at rest in the undeformed state and finite for inverted elements: Ψ = µ/2 (tr
    /// FᵀF − 3) + (λ+µ)/2 (J − 1 − µ/(λ+µ))² (Smith, de Goes and Kim 2018, without the barrier).
    NeoHookean(Lame),
}

/// Lamé's constants, Pa.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lame {
    /// λ, Pa.
    pub lambda_pa: f64,
    /// µ, Pa.
    pub mu_pa: f64,
}

impl Lame {
    /// From Young's modulus (Pa) and Poisson's ratio (below ½).
    pub fn from_young(young_pa: f64, poisson: f64) -> Self {
        Lame {
            lambda_pa: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
            mu_pa: young_pa / (2.0 * (1.0 + poisson)),
        }
    }
}

impl SolidLaw {
    /// Energy density, Pa.
    pub fn energy(&self, f: &Matrix3<f64>) -> f64 {
        match *self {
            SolidLaw::Corotational(Lame { lambda_pa, mu_pa }) => {
                let r = rotation(f);
                let spread = r.dot(f) - 3.0;
                mu_pa * (f - r).norm_squared() + 0.5 * lambda_pa * spread * spread
            }
            SolidLaw::NeoHookean(Lame { lambda_pa, mu_pa }) => {
                let bulk = lambda_pa + mu_pa;
                let j = f.determinant() - 1.0 - mu_pa / bulk;
                let at_rest = 0.5 * mu_pa * mu_pa / bulk;
                0.5 * mu_pa * (f.norm_squared() - 3.0) + 0.5 * bulk * j * j - at_rest
            }
        }
    }

    /// First Piola–Kirchhoff stress, Pa.
    pub fn stress(&self, f: &Matrix3<f64>) -> Matrix3<f64> {
        match *self {
            SolidLaw::Corotational(Lame { lambda_pa, mu_pa }) => {
                let r = rotation(f);
                (f - r) * (2.0 * mu_pa) + r * (lambda_pa * (r.dot(f) - 3.0))
            }
            SolidLaw::NeoHookean(Lame { lambda_pa, mu_pa }) => {
                let bulk = lambda_pa + mu_pa;
                f * mu_pa + cofactor(f) * (bulk * (f.determinant() - 1.0) - mu_pa)
            }
        }
    }

    /// The linearisation at F.
    pub fn tangent(&self, f: &Matrix3<f64>) -> SolidTangent {
        match *self {
            SolidLaw::Corotational(lame) => SolidTangent::Corotational(lame, rotation(f)),
            SolidLaw::NeoHookean(lame) => SolidTangent::NeoHookean(lame, *f, cofactor(f)),
        }
    }
}

/// A solid law linearised at a deformation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SolidTangent {
    /// With the rotation, whose own change is taken as that of an unstrained body.
    Corotational(Lame, Matrix3<f64>),
    /// With F and its cofactor matrix.
    NeoHookean(Lame, Matrix3<f64>, Matrix3<f64>),
}

impl SolidTangent {
    /// Change of the stress with a change `df` of F, Pa.
    pub fn stress_change(&self, df: &Matrix3<f64>) -> Matrix3<f64> {
        match self {
            SolidTangent::Corotational(Lame { lambda_pa, mu_pa }, r) => {
                let local = r.transpose() * df;
                let strain = local + local.transpose();
                r * (strain * *mu_pa + Matrix3::identity() * (lambda_pa * local.trace()))
            }
            SolidTangent::NeoHookean(Lame { lambda_pa, mu_pa }, f, cof) => {
                let bulk = lambda_pa + mu_pa;
                let pressure = bulk * (f.determinant() - 1.0) - mu_pa;
                df * *mu_pa + cof * (bulk * cof.dot(df)) + cofactor_change(f, df) * pressure
            }
        }
    }
}

/// ∂det F/∂F, columns by cross products.
fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (f.column(0), f.column(1), f.column(2));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// Derivative of [`cofactor`] along `d`.
fn cofactor_change(f: &Matrix3<f64>, d: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (f.column(0), f.column(1), f.column(2));
    let (p, q, r) = (d.column(0), d.column(1), d.column(2));
    Matrix3::from_columns(&[q.cross(&c) + b.cross(&r), r.cross(&a) + c.cross(&p), p.cross(&b) + a.cross(&q)])
}

/// The rotation nearest to F: R of the polar decomposition F = R S. Newton's iteration (Higham
/// 1986) where F is far from singular; else by singular values, with the smallest one's sign turned
/// if F inverts.
pub fn rotation(f: &Matrix3<f64>) -> Matrix3<f64> {
    let size = f.norm_squared() / 3.0;
    if f.determinant() > 1e-3 * size * size.sqrt() {
        let mut r = *f;
        for _ in 0..24 {
            let next = (r + cofactor(&r) / r.determinant()) * 0.5;
            let moved = (next - r).norm_squared();
            r = next;
            if moved < 1e-30 {
                break;
            }
        }
        return r;
    }
    if !f.iter().all(|x| x.is_finite()) {
        return Matrix3::identity();
    }
    let svd = f.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Matrix3::identity() };
    let mut u = u;
    if (u * v_t).determinant() < 0.0 {
        let least = svd.singular_values.imin();
        u.column_mut(least).neg_mut();
    }
    u * v_t
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    const SOLIDS: [SolidLaw; 2] = {
        let lame = Lame { lambda_pa: 900.0, mu_pa: 400.0 };
        [SolidLaw::Corotational(lame), SolidLaw::NeoHookean(lame)]
    };

    fn matrix() -> impl Strategy<Value = Matrix3<f64>> {
        prop::array::uniform9(-0.35f64..0.35).prop_map(|a| Matrix3::identity() + Matrix3::from_row_slice(&a))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn solid_stress_is_the_gradient_of_energy(f in matrix(), d in matrix()) {
            for law in SOLIDS {
                let h = 1e-5;
                let slope = (law.energy(&(f + d * h)) - law.energy(&(f - d * h))) / (2.0 * h);
                prop_assert!((slope - law.stress(&f).dot(&d)).abs() < 1e-3, "{law:?}");
            }
        }

        #[test]
        fn plane_stress_and_its_change_are_derivatives(f in matrix(), d in matrix()) {
            let plane = |m: &Matrix3<f64>| m.fixed_view::<3, 2>(0, 0).into_owned();
            let c = plane(&f).transpose() * plane(&f);
            let dc = plane(&f).transpose() * plane(&d);
            let dc = dc + dc.transpose();
            prop_assume!(c.determinant() > 0.05);
            for law in [
                PlaneLaw::StVenantKirchhoff { young_un_per_mm: 100.0, poisson: 0.4 },
                PlaneLaw::NeoHookean { shear_un_per_mm: 30.0 },
                PlaneLaw::Taut { tension_un_per_mm: 20.0 },
            ] {
                let h = 1e-6;
                let (up, down) = (c + dc * h, c - dc * h);
                let slope = (law.energy(&up) - law.energy(&down)) / (2.0 * h);
                let scale = 1.0 + law.stress_change(&c, &dc).norm();
                prop_assert!((slope - 0.5 * law.stress(&c).dot(&dc)).abs() < 1e-4 * scale, "{law:?}");
                let change = (law.stress(&up) - law.stress(&down)) / (2.0 * h);
                prop_assert!((change - law.stress_change(&c, &dc)).norm() < 1e-4 * scale, "{law:?}");
            }
        }

        #[test]
        fn the_rotation_of_a_rotated_stretch_is_found(axis in prop::array::uniform3(-3.0f64..3.0), s in matrix()) {
            let r = Rotation3::new(Vector3::from(axis)).into_inner();
            let stretch = s.transpose() * s + Matrix3::identity() * 0.1;
            prop_assert!((rotation(&(r * stretch)) - r).norm() < 1e-9);
        }
    }

    #[test]
    fn a_rotated_body_carries_no_stress_and_both_laws_have_hookes_modulus() {
        let r = Rotation3::new(Vector3::new(0.4, -1.1, 0.7)).into_inner();
        let strain = Matrix3::new(1.0, 0.4, 0.2, 0.4, -0.5, 0.3, 0.2, 0.3, 0.8);
        let hooke = strain * 800.0 + Matrix3::identity() * (900.0 * strain.trace());
        for law in SOLIDS {
            assert!(law.stress(&r).norm() < 1e-10, "{law:?}");
            let found = law.tangent(&Matrix3::identity()).stress_change(&strain);
            assert!((found - hooke).norm() < 1e-9 * hooke.norm(), "{law:?}");
        }
    }

    #[test]
    fn the_neo_hookean_tangent_is_exact_and_inverted_bodies_have_a_rotation() {
        let f = Matrix3::new(1.2, 0.1, -0.3, 0.2, 0.7, 0.1, 0.0, 0.3, 1.1);
        let d = Matrix3::new(0.3, -1.0, 0.2, 0.5, 0.4, -0.7, 0.1, 0.9, -0.2);
        let h = 1e-6;
        let change = (SOLIDS[1].stress(&(f + d * h)) - SOLIDS[1].stress(&(f - d * h))) / (2.0 * h);
        assert!((change - SOLIDS[1].tangent(&f).stress_change(&d)).norm() < 1e-5);
        for bad in [Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, -0.5)), Matrix3::zeros()] {
            let r = rotation(&bad);
            assert!(
                (r.determinant() - 1.0).abs() < 1e-9
                    && (r * r.transpose() - Matrix3::identity()).norm() < 1e-9
            );
        }
        assert_eq!(rotation(&Matrix3::from_element(f64::NAN)), Matrix3::identity());
    }
}
