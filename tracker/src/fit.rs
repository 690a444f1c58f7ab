//! Pose estimation: the pose of maximum posterior by Gauss–Newton on the image residuals of all
//! blobs of a body, weighted by their covariances, each camera-field at its own instant, with a
//! prior and the trocar.
//!
//! Minimised over the pose x at the group's instant: Σ rᵀ·C⁻¹·r + (x ⊖ x₀)ᵀ·P₀⁻¹·(x ⊖ x₀) +
//! |t|²/σ², where r is blob minus image, C the blob's covariance, x₀ and P₀ the prediction, and t
//! the distance of the shaft from its trocar. Where a blob is beyond the limit, the iteration is
//! repeated with weights 1/(1 + d²/9) (Cauchy); then the worst blobs beyond the limit are rejected
//! one by one, and the rest is fitted without weights.

use crate::body_filter::BodyFilter;
use crate::lines::MotionGivenPose;
use crate::observation::FieldObservation;
use crate::pose_math::{Matrix6, Vector6, box_minus, box_plus, propagated};
use crate::projection::{MarkerImage, PoseMatrix, pose_jacobian, project_marker};
use crate::rig_model::{BodyModel, RigModel};
use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, SMatrix, Vector2, Vector3};
use protocol::limits::{MAX_CAMERAS, MAX_MARKERS};

/// Most blobs in a fit.
pub const MAX_MATCHES: usize = MAX_CAMERAS * MAX_MARKERS;

/// Step (mm, rad) at which the iteration ends: the next would be below a nanometre, because images
/// are nearly linear over a micrometre.
const CONVERGED: f64 = 1e-3;

/// A blob assigned to a marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlobMatch {
    /// Camera id.
    pub camera: usize,
    /// Index of the blob in its field.
    pub blob: usize,
    /// Index of the marker.
    pub marker: usize,
    /// Centre, px of the frame.
    pub pixel: Vector2<f64>,
    /// Covariance of the centre, px².
    pub covariance: Matrix2<f64>,
    /// Instant of the exposure of the blob's line less that of the group, s.
    pub dt_s: f64,
    /// Area over the predicted one.
    pub area_ratio: f64,
    /// True if its size shows neither occlusion nor merging.
    pub clean: bool,
    /// True if the fit rejected it.
    pub outlier: bool,
}

impl BlobMatch {
    /// The match of blob `blob` of a field with a marker seen in `image`; `covariance` is as that
    /// of [`marker_covariance`](crate::observation::marker_covariance).
    pub fn new(
        field: &FieldObservation,
        blob: usize,
        marker: usize,
        image: &MarkerImage,
        covariance: Matrix2<f64>,
        dt_s: f64,
    ) -> Self {
        let seen = &field.blobs[blob];
        let (camera, pixel, area_ratio) = (field.camera, seen.pixel, seen.area_px / image.area_px);
        let clean = covariance == seen.covariance;
        BlobMatch { camera, blob, marker, pixel, covariance, dt_s, area_ratio, clean, outlier: false }
    }
}

/// Where a trocar is in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrocarInWorld {
    /// mm.
    pub position: Point3<f64>,
    /// Standard deviation of the shaft's distance from it, mm.
    pub sigma: f64,
}

/// The estimation of one pose: everything but the blobs.
pub struct PoseProblem<'a> {
    /// The rig.
    pub rig: &'a RigModel,
    /// The body.
    pub body: &'a BodyModel,
    /// Predicted pose.
    pub prior: Isometry3<f64>,
    /// Inverse of its covariance.
    pub prior_information: Matrix6,
    /// Velocity (mm/s) and angular velocity (rad/s) in the world, for fields of other instants.
    pub motion: [Vector3<f64>; 2],
    /// What the pose says of it, where blobs of one field are of different instants.
    pub given: Option<MotionGivenPose>,
    /// The trocar, if the eye is tracked.
    pub trocar: Option<TrocarInWorld>,
    /// Factor on the variances of all blobs.
    pub variance_scale: f64,
}

/// A fitted pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseFit {
    /// Pose of maximum posterior.
    pub pose: Isometry3<f64>,
    /// Its covariance, prior included.
    pub covariance: Matrix6,
    /// χ² of the blobs kept, with unscaled variances.
    pub chi2: f64,
    /// Sum of the squared residuals of markers that are seen whole, px²: the blob of one that is hidden in part lies beside it.
    pub sum_squares_px2: f64,
    /// Blobs of this sum.
    pub whole: u32,
    /// Degrees of freedom of χ²: two per blob, less those of the pose that the blobs (not the
    /// prior) determine.
    pub degrees_of_freedom: f64,
    /// Blobs kept.
    pub blobs: usize,
    /// Blobs rejected.
    pub outliers: usize,
}

impl PoseFit {
    /// χ² per degree of freedom; `None` for fewer than two degrees.
    pub fn reduced_chi2(&self) -> Option<f64> {
        (self.degrees_of_freedom >= 2.0).then(|| self.chi2 / self.degrees_of_freedom)
    }

    /// Root mean square of the residuals of markers that are seen whole, px; 0 where there is none.
    pub fn rms_px(&self) -> f64 {
        libm::sqrt(self.sum_squares_px2 / f64::from(self.whole.max(1)))
    }
}

/// Offset of the trocar from the shaft (the body's z axis), in the body frame, mm.
pub fn trocar_miss(pose: &Isometry3<f64>, trocar: &Point3<f64>) -> Vector2<f64> {
    pose.inverse_transform_point(trocar).coords.xy()
}

impl PoseProblem<'_> {
    /// The estimation of a tracked body.
    pub fn of_filter<'a>(
        rig: &'a RigModel,
        body: &'a BodyModel,
        filter: &BodyFilter,
        variance_scale: f64,
    ) -> Option<PoseProblem<'a>> {
        let prior_information = filter.pose_covariance().cholesky()?.inverse();
        let motion = filter.motion();
        let prior = filter.pose();
        let given = rig.rolls().then(|| filter.motion_given_pose(&prior_information));
        Some(PoseProblem { rig, body, prior, prior_information, motion, given, trocar: None, variance_scale })
    }

    /// Estimates the pose from `start` on, and marks outliers in `matches`. `None` where the
    /// iteration diverges or no blob is left.
    pub fn solve(&self, start: &Isometry3<f64>, matches: &mut [BlobMatch]) -> Option<PoseFit> {
        let (mut pose, mut information) = self.converge(*start, matches, false)?;
        let mut residuals = self.residuals(&pose, matches);
        let mut outliers = 0;
        if residuals.worst.is_some() {
            pose = self.converge(*start, matches, true)?.0;
            residuals = self.residuals(&pose, matches);
            if residuals.worst.is_none() {
                (pose, information) = self.converge(pose, matches, false)?;
                residuals = self.residuals(&pose, matches);
            }
        }
        while let Some(worst) = residuals.worst {
            matches[worst].outlier = true;
            outliers += 1;
            (pose, information) = self.converge(pose, matches, false)?;
            residuals = self.residuals(&pose, matches);
        }
        let Residuals { chi2, sum_squares_px2, whole, blobs, .. } = residuals;
        if blobs == 0 {
            return None;
        }
        let covariance = information.cholesky()?.inverse();
        let determined = 6.0 - (self.prior_information * covariance).trace();
        let degrees_of_freedom = 2.0 * blobs as f64 - determined;
        Some(PoseFit { pose, covariance, chi2, sum_squares_px2, whole, degrees_of_freedom, blobs, outliers })
    }

    /// Gauss–Newton; also the information matrix at the last step, too small a step to change it.
    fn converge(
        &self,
        start: Isometry3<f64>,
        matches: &[BlobMatch],
        robust: bool,
    ) -> Option<(Isometry3<f64>, Matrix6)> {
        let mut pose = start;
        let mut information = Matrix6::zeros();
        for _ in 0..8 {
            let gradient;
            (information, gradient) = self.normal_equations(&pose, matches, robust);
            let step = information.cholesky()?.solve(&gradient);
            if !step.iter().all(|v| v.is_finite()) || step.norm() > 50.0 {
                return None;
            }
            pose = box_plus(&pose, &step);
            if step.amax() < CONVERGED {
                break;
            }
        }
        Some((pose, information))
    }

    /// The motion of a body at `pose`.
    fn motion_at(&self, pose: &Isometry3<f64>) -> [Vector3<f64>; 2] {
        let given = |given: MotionGivenPose| given.motion(&self.motion, &box_minus(pose, &self.prior));
        self.given.map_or(self.motion, given)
    }

    fn image(&self, placed: &PoseMatrix, m: &BlobMatch) -> Option<MarkerImage> {
        let camera = self.rig.cameras[m.camera].as_ref()?;
        project_marker(&self.body.markers[m.marker], placed, camera)
    }

    /// The residuals at `pose`.
    fn residuals(&self, pose: &Isometry3<f64>, matches: &[BlobMatch]) -> Residuals {
        let mut residuals = Residuals::default();
        let mut limit = self.rig.tuning.outlier * self.variance_scale;
        let motion = self.motion_at(pose);
        let mut placed = AtExposures::of(pose, &motion);
        for (i, m) in matches.iter().enumerate().filter(|(_, m)| !m.outlier) {
            let image = self.image(placed.at(m), m);
            let inverse = m.covariance.try_inverse();
            let r = image.map_or(Vector2::repeat(f64::INFINITY), |image| m.pixel - image.pixel);
            let d2 = inverse.map_or(f64::INFINITY, |inverse| r.dot(&(inverse * r)));
            residuals.blobs += 1;
            residuals.chi2 += d2;
            if m.clean {
                residuals.sum_squares_px2 += r.norm_squared();
                residuals.whole += 1;
            }
            if d2 > limit || d2.is_nan() {
                (residuals.worst, limit) = (Some(i), d2);
            }
        }
        residuals
    }

    fn normal_equations(
        &self,
        pose: &Isometry3<f64>,
        matches: &[BlobMatch],
        robust: bool,
    ) -> (Matrix6, Vector6) {
        let mut information = self.prior_information;
        let mut gradient = self.prior_information * box_minus(&self.prior, pose);
        let motion = self.motion_at(pose);
        let mut exposures = AtExposures::of(pose, &motion);
        for m in matches.iter().filter(|m| !m.outlier) {
            let placed = exposures.at(m);
            let Some(image) = self.image(placed, m) else { continue };
            let Some(inverse) = (m.covariance * self.variance_scale).try_inverse() else { continue };
            let r = m.pixel - image.pixel;
            let weight =
                if robust { 1.0 / (1.0 + r.dot(&(inverse * r)) / self.rig.tuning.robust_scale) } else { 1.0 };
            let then = pose_jacobian(&image, placed);
            let jacobian = self.given.map_or(then, |given| given.jacobian(&then, m.dt_s));
            let weighted = jacobian.transpose() * (inverse * weight);
            information += weighted * jacobian;
            gradient += weighted * r;
        }
        if let Some(trocar) = &self.trocar {
            let (jacobian, miss) = trocar_equations(pose, &trocar.position);
            let weight = 1.0 / (trocar.sigma * trocar.sigma);
            information += jacobian.transpose() * jacobian * weight;
            gradient -= jacobian.transpose() * miss * weight;
        }
        (information, gradient)
    }
}

/// The pose at the exposures of blobs, computed once for all of a camera that were exposed together.
struct AtExposures<'a> {
    pose: &'a Isometry3<f64>,
    motion: &'a [Vector3<f64>; 2],
    newest: [Option<(f64, PoseMatrix)>; MAX_CAMERAS],
}

impl<'a> AtExposures<'a> {
    fn of(pose: &'a Isometry3<f64>, motion: &'a [Vector3<f64>; 2]) -> Self {
        AtExposures { pose, motion, newest: [None; MAX_CAMERAS] }
    }

    fn at(&mut self, m: &BlobMatch) -> &PoseMatrix {
        let newest = &mut self.newest[m.camera];
        if newest.is_some_and(|(dt_s, _)| dt_s != m.dt_s) {
            *newest = None;
        }
        let place = || (m.dt_s, PoseMatrix::from(&propagated(self.pose, self.motion, m.dt_s)));
        &newest.get_or_insert_with(place).1
    }
}

/// Residuals of a pose, and the worst blob beyond the limit.
#[derive(Debug, Default)]
struct Residuals {
    chi2: f64,
    sum_squares_px2: f64,
    whole: u32,
    blobs: usize,
    worst: Option<usize>,
}

/// The offset of [`trocar_miss`] and its Jacobian: with q = Rᵀ·(T − p), δq = −Rᵀ·δp + Rᵀ·[T −
/// p]×·δθ.
fn trocar_equations(pose: &Isometry3<f64>, trocar: &Point3<f64>) -> (SMatrix<f64, 2, 6>, Vector2<f64>) {
    let body_from_world: Matrix3<f64> = *pose.rotation.inverse().to_rotation_matrix().matrix();
    let lever = trocar.coords - pose.translation.vector;
    let by_rotation = body_from_world * lever.cross_matrix();
    let jacobian =
        SMatrix::<f64, 2, 6>::from_fn(
            |r, c| if c < 3 { -body_from_world[(r, c)] } else { by_rotation[(r, c - 3)] },
        );
    (jacobian, trocar_miss(pose, trocar))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rig::Rig;

    fn exact_matches(rig: &RigModel, body: usize, truth: &Isometry3<f64>) -> Vec<BlobMatch> {
        let mut matches = Vec::new();
        for (camera, model) in rig.cameras.iter().enumerate() {
            let Some(model) = model else { continue };
            for (marker, m) in rig.bodies[body].markers.iter().enumerate() {
                let image = project_marker(m, &PoseMatrix::from(truth), model).unwrap();
                let covariance = Matrix2::identity() * 0.0025;
                let pixel = image.pixel;
                let area_ratio = 1.0;
                let (clean, outlier) = (true, false);
                matches.push(BlobMatch {
                    camera,
                    blob: 0,
                    marker,
                    pixel,
                    covariance,
                    dt_s: 0.0,
                    area_ratio,
                    clean,
                    outlier,
                });
            }
        }
        matches
    }

    fn problem(rig: &RigModel, prior: Isometry3<f64>) -> PoseProblem<'_> {
        PoseProblem {
            rig,
            body: &rig.bodies[0],
            prior,
            prior_information: Matrix6::identity() * 1e-2,
            motion: [Vector3::zeros(); 2],
            given: None,
            trocar: None,
            variance_scale: 1.0,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn exact_blobs_give_the_exact_pose(
            p in prop::array::uniform3(-6.0..6.0f64), r in prop::array::uniform3(-1.0..1.0f64),
            e in prop::array::uniform6(-0.1..0.1f64), wrong in 0usize..12,
        ) {
            let rig = RigModel::new(&Rig::load_or_shipped(None).unwrap());
            let truth = Isometry3::new(Vector3::from(p), Vector3::from(r));
            let mut matches = exact_matches(&rig, 0, &truth);
            matches[wrong].pixel.x += 30.0;
            let start = box_plus(&truth, &Vector6::from(e));
            let fit = problem(&rig, start).solve(&start, &mut matches).unwrap();
            prop_assert_eq!((fit.blobs, fit.outliers), (11, 1));
            prop_assert!(matches[wrong].outlier);
            prop_assert!(box_minus(&fit.pose, &truth).norm() < 1e-4, "{}", box_minus(&fit.pose, &truth));
        }

        #[test]
        fn trocar_jacobian_agrees_with_differences(
            p in prop::array::uniform3(-6.0..6.0f64), r in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let pose = Isometry3::new(Vector3::from(p), Vector3::from(r));
            let trocar = Point3::new(7.8, 4.5, 7.9);
            let (jacobian, _) = trocar_equations(&pose, &trocar);
            for axis in 0..6 {
                let mut step = Vector6::zeros();
                step[axis] = 1e-6;
                let ahead = trocar_miss(&box_plus(&pose, &step), &trocar);
                let back = trocar_miss(&box_plus(&pose, &-step), &trocar);
                let slope = (ahead - back) / 2e-6;
                prop_assert!((slope - jacobian.column(axis)).norm() < 1e-6);
            }
        }
    }
}
