//! One tracked body: its filter, what it saw in this frame, and whether it may be trusted.

use crate::associate::PredictedBody;
use crate::body_filter::BodyFilter;
use crate::constants as k;
use crate::fit::{BlobMatch, PoseFit};
use crate::instrument_filter::Pivot;
use crate::observation::is_localised;
use crate::pose_math::Matrix6;
use crate::predictor::TipPredictor;
use crate::projection::{PoseMatrix, in_view_of_two};
use crate::rig_model::{BodyModel, Marker, RigModel};
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::MAX_CAMERAS;
use protocol::poses::{BodyState, BodyStatus, Predictor};

/// A body over time.
#[derive(Debug, Clone)]
pub struct Track {
    /// `None` while lost.
    pub filter: Option<BodyFilter>,
    /// Running reduced χ²: above 1 where the calibration is worse than the blobs.
    pub variance_scale: f64,
    /// Instant of the last blob of each camera.
    seen_ns: [u64; MAX_CAMERAS],
    /// Last instant at which two cameras saw it.
    pub good_ns: u64,
    measured_ns: u64,
    /// Last instant at which a marker beside the shaft told the roll.
    pub roll_ns: u64,
    last_pose: Isometry3<f64>,
    last_covariance: Matrix6,
    frame: FrameStats,
    predictor: TipPredictor,
}

/// What the present frame brought.
#[derive(Debug, Clone, Copy, Default)]
struct FrameStats {
    blobs: u32,
    outliers: u32,
    near_misses: u32,
    cameras: u32,
    /// Set of the markers that took part.
    markers: u32,
    sum_squares_px2: f64,
    bad_fit: bool,
}

impl Default for Track {
    fn default() -> Self {
        Track {
            filter: None,
            variance_scale: 1.0,
            seen_ns: [0; MAX_CAMERAS],
            good_ns: 0,
            measured_ns: 0,
            roll_ns: 0,
            last_pose: Isometry3::identity(),
            last_covariance: Matrix6::identity(),
            frame: FrameStats::default(),
            predictor: TipPredictor::default(),
        }
    }
}

impl Track {
    /// A new frame begins.
    pub fn begin_frame(&mut self) {
        self.frame = FrameStats::default();
    }

    /// Carries the body to `time_ns`, or gives it up where the gap is too long or two cameras have
    /// not seen it for too long.
    pub fn advance(&mut self, time_ns: u64, pivot: Option<Pivot>) {
        let stale = time_ns.saturating_sub(self.good_ns) > k::LOST_AFTER_NS;
        if let Some(filter) = &mut self.filter {
            if let BodyFilter::Instrument(instrument) = filter
                && time_ns.saturating_sub(self.roll_ns) > k::ROLL_COAST_NS
            {
                instrument.damp_roll(time_ns.saturating_sub(instrument.time_ns) as f64 * 1e-9);
            }
            filter.advance(time_ns, pivot);
        }
        if stale {
            self.lose();
        }
    }

    /// Nothing is known any more; the last pose is kept for those who show it.
    pub fn lose(&mut self) {
        if let Some(filter) = self.filter.take() {
            self.last_pose = filter.pose();
            self.last_covariance = filter.pose_covariance();
        }
        self.seen_ns = [0; MAX_CAMERAS];
        self.predictor.interrupt();
    }

    /// Where the body should be at its filter's instant.
    pub fn predicted(&self) -> Option<PredictedBody> {
        self.filter.as_ref().map(|f| PredictedBody {
            pose: f.pose(),
            covariance: f.pose_covariance(),
            motion: f.motion(),
            variance_scale: self.variance_scale,
        })
    }

    /// True if two cameras have not seen it for so long that it should also be searched.
    pub fn needs_acquisition(&self, time_ns: u64) -> bool {
        self.filter.is_none() || time_ns.saturating_sub(self.good_ns) > k::ACQUIRE_AFTER_NS
    }

    /// So many blobs near its markers belong to nobody.
    pub fn count_near_misses(&mut self, near_misses: u32) {
        self.frame.near_misses += near_misses;
    }

    /// A fit of tracked blobs comes in. False if it was refused.
    pub fn update(
        &mut self,
        fit: &PoseFit,
        prior_information: &Matrix6,
        matches: &[BlobMatch],
        time_ns: u64,
    ) -> bool {
        let reduced = fit.reduced_chi2();
        let limit = k::BAD_FIT * self.variance_scale;
        let crowded = fit.outliers > fit.blobs;
        self.frame.outliers += fit.outliers as u32;
        if crowded || reduced.is_some_and(|c| c > limit) {
            self.frame.bad_fit = true;
            return false;
        }
        let Some(filter) = &mut self.filter else { return false };
        if !filter.update(&fit.pose, &fit.covariance, prior_information) {
            self.frame.bad_fit = true;
            return false;
        }
        if let Some(c) = reduced {
            let (low, high) = k::CHI2_RANGE;
            self.variance_scale =
                (self.variance_scale + k::CHI2_STEP * (c - self.variance_scale)).clamp(low, high);
        }
        self.record(fit, matches, time_ns, u32::MAX);
        true
    }

    /// A search found the body.
    pub fn initiate(
        &mut self,
        fit: &PoseFit,
        model: &BodyModel,
        matches: &[BlobMatch],
        time_ns: u64,
        in_frame: u32,
        pivot: Option<Pivot>,
    ) {
        self.lose();
        self.filter = Some(BodyFilter::new(model, &fit.pose, &fit.covariance, pivot, time_ns));
        // A rig that has drifted shows at once; its evidence is forgotten slowly.
        let (low, high) = k::CHI2_RANGE;
        self.variance_scale = fit.reduced_chi2().unwrap_or(1.0).clamp(low, high);
        self.good_ns = time_ns;
        self.roll_ns = time_ns;
        self.record(fit, matches, time_ns, in_frame);
    }

    /// Books the blobs of cameras in the set `in_frame`.
    fn record(&mut self, fit: &PoseFit, matches: &[BlobMatch], time_ns: u64, in_frame: u32) {
        for m in matches.iter().filter(|m| !m.outlier) {
            self.seen_ns[m.camera] = time_ns;
            if in_frame & (1 << m.camera) != 0 {
                self.frame.blobs += 1;
                self.frame.cameras |= 1 << m.camera;
                self.frame.markers |= 1 << m.marker;
            }
        }
        self.frame.sum_squares_px2 += fit.sum_squares_px2;
        self.measured_ns = time_ns;
        let eyes = self.seen_ns.iter().filter(|&&t| t > 0 && time_ns.saturating_sub(t) <= k::SEEN_NS).count();
        if eyes >= 2 {
            self.good_ns = time_ns;
        }
    }

    /// Books when a marker beside the shaft told the roll.
    pub fn observe_roll(&mut self, model: &BodyModel, matches: &[BlobMatch], time_ns: u64) {
        if matches.iter().any(|m| !m.outlier && model.observes_roll(m.marker) && is_localised(&m.covariance))
        {
            self.roll_ns = time_ns;
        }
    }

    /// What is published for the instant `exposed_ns`, after the fields of `cameras` (a set).
    pub fn state(&mut self, rig: &RigModel, body: usize, exposed_ns: u64, cameras: u32) -> BodyState {
        let model = &rig.bodies[body];
        let mut state = BodyState::zeroed();
        let covariance = self.filter.as_ref().map_or(self.last_covariance, BodyFilter::pose_covariance);
        let mut pose = self.last_pose;
        if let Some(filter) = &self.filter {
            let dt = exposed_ns.wrapping_sub(filter.time_ns()) as i64 as f64 * 1e-9;
            pose = filter.pose_after(dt.clamp(-0.2, 0.2));
            state.predictor = predictor_of(filter, model);
        }
        if model.is_eye {
            pose.translation.vector.fill(0.0);
        }
        state.world_from_body = Pose::from_isometry(&pose);
        upper_triangle(&covariance, &mut state.covariance);
        let validity = self.validity(model, &covariance);
        if let Some(filter) = self.filter.as_ref().filter(|_| !model.is_eye) {
            let since = exposed_ns.wrapping_sub(filter.time_ns()) as i64 as f64 * 1e-9;
            let tip_after = |dt: f64| filter.pose_after(since + dt).translation.vector;
            self.predictor.take(exposed_ns, validity == Validity::Measured, tip_after);
            self.predictor.publish(exposed_ns, tip_after, &mut state.predictor);
        }
        state.validity = validity as u32;
        state.status = self.status(rig, body, validity, &pose, cameras) as u32;
        state.measured_ns = self.measured_ns;
        state.blobs_used = self.frame.blobs;
        state.cameras_used = self.frame.cameras.count_ones();
        if self.frame.blobs > 0 {
            state.residual_px = libm::sqrt(self.frame.sum_squares_px2 / f64::from(self.frame.blobs));
        }
        state
    }

    fn validity(&self, model: &BodyModel, covariance: &Matrix6) -> Validity {
        if self.filter.is_none() {
            return Validity::Lost;
        }
        let trace = |m: Matrix3<f64>| libm::sqrt(m.trace().max(0.0));
        let position = trace(covariance.fixed_view::<3, 3>(0, 0).into());
        let rotation = trace(covariance.fixed_view::<3, 3>(3, 3).into());
        let sure = (model.is_eye || position < k::MEASURED_MM) && rotation < k::MEASURED_RAD;
        let recent = self.measured_ns.saturating_sub(self.good_ns) <= k::ONE_CAMERA_NS;
        // One marker alone may be anything.
        if self.frame.markers.count_ones() >= 2 && recent && sure {
            Validity::Measured
        } else {
            Validity::Predicted
        }
    }

    /// Why the body is as valid as it is; of several reasons the one nearest to the cause.
    fn status(
        &self,
        rig: &RigModel,
        body: usize,
        validity: Validity,
        pose: &Isometry3<f64>,
        cameras: u32,
    ) -> BodyStatus {
        let frame = &self.frame;
        let placed = PoseMatrix::from(pose);
        let disturbing = frame.outliers + frame.near_misses;
        let leaves = |m: &Marker| !in_view_of_two(rig, m, &placed, cameras);
        let model = &rig.bodies[body];
        let in_a_line = !model.is_eye
            && (0..model.markers.len()).all(|m| frame.markers & (1 << m) == 0 || !model.observes_roll(m));
        if validity == Validity::Lost {
            BodyStatus::Lost
        } else if frame.bad_fit {
            BodyStatus::BadFit
        } else if disturbing > 0 && disturbing * k::INTERFERENCE_SHARE >= frame.blobs {
            BodyStatus::Interference
        } else if frame.blobs == 0 {
            BodyStatus::Predicted
        } else if cameras.count_ones() >= 2 && rig.bodies[body].markers.iter().any(leaves) {
            BodyStatus::PartlyOutOfVolume
        } else if in_a_line || frame.markers.count_ones() < 3 || frame.cameras.count_ones() < 2 {
            BodyStatus::TooFewMarkers
        } else if validity == Validity::Measured {
            BodyStatus::Tracked
        } else {
            BodyStatus::Predicted
        }
    }
}

fn predictor_of(filter: &BodyFilter, model: &BodyModel) -> Predictor {
    let mut predictor = Predictor::zeroed();
    let [velocity, turning] = filter.motion();
    predictor.angular_velocity_rad_s = turning.into();
    if !model.is_eye {
        predictor.velocity_mm_s = velocity.into();
    }
    predictor
}

fn upper_triangle(matrix: &Matrix6, out: &mut [f64]) {
    let cells = (0..6).flat_map(|r| (r..6).map(move |c| (r, c)));
    for (slot, (r, c)) in out.iter_mut().zip(cells) {
        *slot = matrix[(r, c)];
    }
}
