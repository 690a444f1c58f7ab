//! Points about which something pivots: the trocar about which a shaft turns, and the eye's centre.

use crate::{CalibrationError, degenerate, median};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, Vector3};

/// Fewest poses; fewer leave no residual to judge by.
const FEWEST: usize = 10;
/// Smallest spread (standard deviation) of a shaft's directions that fixes its trocar, rad: with
/// less, 0.05 mm of play become 2 mm along the shaft.
const TILT_RAD: f64 = 0.02;
/// Smallest spread of the turns about the second axis that fixes an eye's centre, rad: with less, 1
/// µm of noise becomes 0.2 mm.
const TURN_RAD: f64 = 0.005;
/// Residuals beyond so many standard deviations lose their weight (Cauchy).
const SUSPECT: f64 = 3.0;
/// Rounds of weighting.
const ROUNDS: usize = 20;
/// Stretches of poses that count as independent: play changes slowly, its instants are not.
const STRETCHES: usize = 20;

/// Blocks of a jackknife: a shaft that leans on one side of its trocar for seconds gives a few independent places, however
/// many poses there are.
const BLOCKS: usize = 5;

/// Covariance of an estimate from the sums of its gradient over stretches: H⁻¹ (Σ g gᵀ) H⁻¹, which
/// needs no independence within a stretch (Liang & Zeger 1986).
fn clustered(inverse: &DMatrix<f64>, gradients: &[DVector<f64>]) -> DMatrix<f64> {
    let length = gradients.len().div_ceil(STRETCHES).max(1);
    let sums = gradients.chunks(length).map(|c| c.iter().sum::<DVector<f64>>());
    let middle = sums.map(|g| &g * g.transpose()).sum::<DMatrix<f64>>();
    inverse * middle * inverse
}

/// A pivot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pivot {
    /// The point, mm.
    pub point: Point3<f64>,
    /// Standard deviation of each coordinate, mm.
    pub sigma_mm: Vector3<f64>,
    /// How far the shafts (or the point carried by the poses) miss it, per axis, root mean square,
    /// mm.
    pub play_mm: f64,
    /// Poses that took part.
    pub poses: usize,
}

/// Cauchy weights of residuals by their lengths; their spread is that of the median length.
fn weights_of(lengths: &[f64]) -> Vec<f64> {
    // The median of a normal 2-vector's length is 1.18 standard deviations; a floor keeps exact
    // data finite.
    let spread = (median(lengths.iter().copied()).unwrap_or(0.0) / 1.177).max(1e-9);
    lengths.iter().map(|length| 1.0 / (1.0 + (length / (SUSPECT * spread)).powi(2))).collect()
}

/// Projection across a direction.
fn across(d: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - d * d.transpose()
}

fn tilted_enough(shafts: &[Shaft]) -> Result<(), CalibrationError> {
    let information = shafts.iter().map(|s| across(&s.direction)).sum::<Matrix3<f64>>() / shafts.len() as f64;
    // Lines along one direction leave the point free along it; the smallest eigenvalue is the
    // spread squared.
    let spread = information.symmetric_eigenvalues().min().max(0.0).sqrt();
    if spread >= TILT_RAD {
        return Ok(());
    }
    Err(degenerate(format!(
        "the shaft was tilted by {:.1} mrad only; at least {:.0} mrad of spread are needed to find its pivot",
        spread * 1e3,
        TILT_RAD * 1e3
    )))
}

/// A shaft in the frame of what its trocar sits in (the eye).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// A point on it, mm.
    pub origin: Point3<f64>,
    /// Unit vector along it.
    pub direction: Vector3<f64>,
}

impl Shaft {
    /// How far the shaft passes from a point, mm.
    pub fn miss(&self, point: &Vector3<f64>) -> Vector3<f64> {
        across(&self.direction) * (point - self.origin.coords)
    }
}

/// The point nearest to all shafts.
///
/// # Errors
/// Too few shafts, or too little tilt.
pub fn of_shafts(shafts: &[Shaft]) -> Result<Pivot, CalibrationError> {
    let mut found = nearest_to(shafts)?;
    if let Some(sigma_mm) = jackknifed(shafts) {
        found.sigma_mm = found.sigma_mm.sup(&sigma_mm);
    }
    Ok(found)
}

/// Standard deviation of the point by leaving out one block of shafts after the other (Tukey 1958); `None` where a rest does
/// not determine it.
fn jackknifed(shafts: &[Shaft]) -> Option<Vector3<f64>> {
    let length = shafts.len().div_ceil(BLOCKS);
    let without = |block: usize| {
        let rest = shafts.iter().enumerate().filter(|(i, _)| i / length != block);
        let rest: Vec<Shaft> = rest.map(|(_, shaft)| *shaft).collect();
        nearest_to(&rest).ok().map(|found| found.point.coords)
    };
    let points: Vec<Vector3<f64>> = (0..BLOCKS).map(without).collect::<Option<_>>()?;
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let squares = points.iter().map(|p| (p - mean).component_mul(&(p - mean))).sum::<Vector3<f64>>();
    Some((squares * ((n - 1.0) / n)).map(f64::sqrt))
}

/// The point nearest to all shafts, with the standard deviation by their scatter.
fn nearest_to(shafts: &[Shaft]) -> Result<Pivot, CalibrationError> {
    if shafts.len() < FEWEST {
        return Err(degenerate(format!("{} poses with a shaft; at least {FEWEST} are needed", shafts.len())));
    }
    tilted_enough(shafts)?;
    let mut weights = vec![1.0; shafts.len()];
    let mut point = Vector3::zeros();
    let mut covariance = Matrix3::zeros();
    for _ in 0..ROUNDS {
        let (mut m, mut r) = (Matrix3::zeros(), Vector3::zeros());
        for (Shaft { origin, direction }, w) in shafts.iter().zip(&weights) {
            m += across(direction) * *w;
            r += across(direction) * origin.coords * *w;
        }
        covariance = m.try_inverse().ok_or_else(|| degenerate("the shafts do not determine a point"))?;
        point = covariance * r;
        weights = weights_of(&shafts.iter().map(|s| s.miss(&point).norm()).collect::<Vec<_>>());
    }
    // Two equations a shaft.
    let squares: f64 = shafts.iter().zip(&weights).map(|(s, w)| w * s.miss(&point).norm_squared()).sum();
    let play = (squares / (2.0 * weights.iter().sum::<f64>() - 3.0).max(1.0)).sqrt();
    let pulls = shafts.iter().zip(&weights).map(|(s, w)| s.miss(&point) * *w);
    let pulls = pulls.map(|g| DVector::from_column_slice(g.as_slice()));
    let inverse = DMatrix::from_column_slice(3, 3, covariance.as_slice());
    let covariance = clustered(&inverse, &pulls.collect::<Vec<_>>());
    Ok(Pivot {
        point: point.into(),
        sigma_mm: Vector3::from_fn(|i, _| covariance[(i, i)].max(0.0).sqrt()),
        play_mm: play,
        poses: shafts.len(),
    })
}

/// The point of a body that stays in place while it turns: where it is in the world, and in the
/// body, from `world_from_body` poses. Solves R·q + t = c for q and c by least squares.
///
/// # Errors
/// Too few poses, or turns about one axis only.
pub fn of_turns(poses: &[Isometry3<f64>]) -> Result<(Pivot, Point3<f64>), CalibrationError> {
    if poses.len() < FEWEST {
        return Err(degenerate(format!("{} poses; at least {FEWEST} are needed", poses.len())));
    }
    let mut weights = vec![1.0; poses.len()];
    let (mut answer, mut inverse) = (DVector::zeros(6), DMatrix::zeros(6, 6));
    for _ in 0..ROUNDS {
        let (mut m, mut r) = (DMatrix::<f64>::zeros(6, 6), DVector::<f64>::zeros(6));
        for (pose, w) in poses.iter().zip(&weights) {
            let mut row = DMatrix::zeros(3, 6);
            row.fixed_view_mut::<3, 3>(0, 0).copy_from(pose.rotation.to_rotation_matrix().matrix());
            row.fixed_view_mut::<3, 3>(0, 3).copy_from(&-Matrix3::<f64>::identity());
            m += row.transpose() * &row * *w;
            r -= row.transpose() * DVector::from_column_slice(pose.translation.vector.as_slice()) * *w;
        }
        let total: f64 = weights.iter().sum();
        let eigen = (&m / total).symmetric_eigenvalues();
        // Turning by small angles a, the smallest eigenvalue is about the variance of a over 2.
        let spread = (2.0 * eigen.min().max(0.0)).sqrt();
        if spread < TURN_RAD {
            return Err(degenerate(format!(
                "the body turned by {:.1} mrad only, or about one axis; at least {:.0} mrad about two axes are needed",
                spread * 1e3,
                TURN_RAD * 1e3
            )));
        }
        inverse = m.try_inverse().ok_or_else(|| degenerate("the poses do not determine a pivot"))?;
        answer = &inverse * r;
        weights = weights_of(&poses.iter().map(|p| miss(p, &answer).norm()).collect::<Vec<_>>());
    }
    let squares: f64 = poses.iter().zip(&weights).map(|(p, w)| w * miss(p, &answer).norm_squared()).sum();
    let play = (squares / (3.0 * weights.iter().sum::<f64>() - 6.0).max(1.0)).sqrt();
    let pull = |(p, w): (&Isometry3<f64>, &f64)| {
        let miss = miss(p, &answer) * *w;
        let by_body = p.rotation.inverse() * miss;
        DVector::from_iterator(6, by_body.iter().copied().chain((-miss).iter().copied()))
    };
    let covariance = clustered(&inverse, &poses.iter().zip(&weights).map(pull).collect::<Vec<_>>());
    let sigma = Vector3::from_fn(|i, _| covariance[(3 + i, 3 + i)].max(0.0).sqrt());
    let point = Point3::new(answer[3], answer[4], answer[5]);
    let in_body = Point3::new(answer[0], answer[1], answer[2]);
    Ok((Pivot { point, sigma_mm: sigma, play_mm: play, poses: poses.len() }, in_body))
}

/// How far the pivot of the body is from that of the world at a pose.
fn miss(pose: &Isometry3<f64>, answer: &DVector<f64>) -> Vector3<f64> {
    let carried = pose * Point3::new(answer[0], answer[1], answer[2]);
    carried.coords - Vector3::new(answer[3], answer[4], answer[5])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn turn(i: usize, size: f64) -> UnitQuaternion<f64> {
        let t = i as f64;
        UnitQuaternion::from_scaled_axis(
            Vector3::new((1.3 * t).sin(), (2.1 * t).cos(), (0.7 * t).sin()) * size,
        )
    }

    proptest! {
        #[test]
        fn shafts_meet_in_their_trocar(p in prop::array::uniform3(-12.0..12.0f64), tilt in 0.05..0.6f64) {
            let p = Point3::from(p);
            let shafts: Vec<_> = (0..30).map(|i| {
                let direction = turn(i, tilt) * Vector3::z();
                Shaft { origin: p - direction * (5.0 + i as f64 / 3.0), direction }
            }).collect();
            let found = of_shafts(&shafts).unwrap();
            prop_assert!((found.point - p).norm() < 1e-9 && found.play_mm < 1e-9);
        }

        #[test]
        fn a_turning_body_shows_its_centre(
            c in prop::array::uniform3(-3.0..3.0f64), q in prop::array::uniform3(-3.0..3.0f64), size in 0.1..0.5f64,
        ) {
            let (c, q) = (Vector3::from(c), Vector3::from(q));
            let pose = |i| {
                let r = turn(i, size);
                Isometry3::from_parts(Translation3::from(c - r * q), r)
            };
            let (found, in_body) = of_turns(&(0..40).map(pose).collect::<Vec<_>>()).unwrap();
            prop_assert!((found.point.coords - c).norm() < 1e-7 && (in_body.coords - q).norm() < 1e-7);
        }
    }

    #[test]
    fn play_is_measured_and_one_in_ten_outliers_do_not_matter() {
        let p = Point3::new(7.8, 4.5, 7.9);
        let shafts: Vec<_> = (0..200)
            .map(|i| {
                let along = turn(i, 0.3) * Vector3::z();
                let aside =
                    along.cross(&Vector3::x()).normalize() * 0.05 * (i as f64 * 0.77).sin() * 2f64.sqrt();
                let aside = if i % 10 == 0 { aside * 60.0 } else { aside };
                Shaft { origin: p + aside - along * 12.0, direction: along }
            })
            .collect();
        let found = of_shafts(&shafts).unwrap();
        assert!((found.point - p).norm() < 0.02, "{found:?}");
        assert!((0.02..0.06).contains(&found.play_mm), "{found:?}");
    }

    #[test]
    fn what_does_not_pivot_is_refused() {
        let still = |i| Shaft { origin: Point3::new(0.0, 0.0, f64::from(i)), direction: Vector3::z() };
        let still: Vec<_> = (0..20).map(still).collect();
        assert!(of_shafts(&still).unwrap_err().to_string().contains("tilted by 0.0 mrad only"));
        assert!(of_shafts(&still[..3]).unwrap_err().to_string().contains("3 poses"));
        let about_one_axis = |i| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * f64::from(i) * 0.05);
            Isometry3::from_parts(Translation3::identity(), turn)
        };
        let error = of_turns(&(0..20).map(about_one_axis).collect::<Vec<_>>()).unwrap_err().to_string();
        assert!(error.contains("about one axis"), "{error}");
    }
}
