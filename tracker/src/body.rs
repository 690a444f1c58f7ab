//! One tracked body: its filter, what it saw in this frame, and whether it may be trusted.

use crate::associate::Expected;
use crate::constants as k;
use crate::estimate::Estimate;
use crate::filter::Matrix6;
use crate::fit::{Fit, Match};
use crate::forecast::Forecast;
use crate::hand::Pivot;
use crate::model::{BodyModel, Marker, RigModel};
use crate::sight::{Placed, seen_by_two, tells_place};
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::MAX_CAMERAS;
use protocol::poses::{BodyState, BodyStatus, Predictor};

/// A body over time.
#[derive(Debug, Clone)]
pub struct Track {
    /// `None` while lost.
    pub filter: Option<Estimate>,
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
    frame: InFrame,
    forecast: Forecast,
}

/// What the present frame brought.
#[derive(Debug, Clone, Copy, Default)]
struct InFrame {
    blobs: u32,
    thrown_out: u32,
    strays: u32,
    cameras: u32,
    /// Set of the markers that took part.
    markers: u32,
    squares_px2: f64,
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
            frame: InFrame::default(),
            forecast: Forecast::default(),
        }
    }
}

impl Track {
    /// A new frame begins.
    pub fn begin_frame(&mut self) {
        self.frame = InFrame::default();
    }

    /// Carries the body to `base_ns`, or gives it up where the gap is too long or two cameras have
    /// not seen it for too long.
    pub fn advance(&mut self, base_ns: u64, pivot: Option<Pivot>) {
        let stale = base_ns.saturating_sub(self.good_ns) > k::LOST_AFTER_NS;
        if let Some(filter) = &mut self.filter {
            if let Estimate::Hand(hand) = filter
                && base_ns.saturating_sub(self.roll_ns) > k::ROLL_COASTS_NS
            {
                hand.calm_roll(base_ns.saturating_sub(hand.time_ns) as f64 * 1e-9);
            }
            filter.advance(base_ns, pivot);
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
        self.forecast.interrupt();
    }

    /// Where the body should be at its filter's instant.
    pub fn expected(&self) -> Option<Expected> {
        self.filter.as_ref().map(|f| Expected {
            pose: f.pose(),
            covariance: f.pose_covariance(),
            motion: f.motion(),
            variance_scale: self.variance_scale,
        })
    }

    /// True if two cameras have not seen it for so long that it should also be searched.
    pub fn wants_search(&self, base_ns: u64) -> bool {
        self.filter.is_none() || base_ns.saturating_sub(self.good_ns) > k::SEARCH_AFTER_NS
    }

    /// So many blobs near its markers belong to nobody.
    pub fn disturbed(&mut self, strays: u32) {
        self.frame.strays += strays;
    }

    /// A fit of tracked blobs comes in. False if it was refused.
    pub fn take_fit(
        &mut self,
        fit: &Fit,
        prior_information: &Matrix6,
        matches: &[Match],
        base_ns: u64,
    ) -> bool {
        let reduced = fit.reduced_chi2();
        let limit = k::BAD_FIT * self.variance_scale;
        let crowded = fit.thrown_out > fit.blobs;
        self.frame.thrown_out += fit.thrown_out as u32;
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
        self.note(fit, matches, base_ns, u32::MAX);
        true
    }

    /// A search found the body.
    pub fn take_seed(
        &mut self,
        fit: &Fit,
        model: &BodyModel,
        matches: &[Match],
        base_ns: u64,
        in_frame: u32,
        pivot: Option<Pivot>,
    ) {
        self.lose();
        self.filter = Some(Estimate::new(model, &fit.pose, &fit.covariance, pivot, base_ns));
        // A rig that has drifted shows at once; its evidence is forgotten slowly.
        let (low, high) = k::CHI2_RANGE;
        self.variance_scale = fit.reduced_chi2().unwrap_or(1.0).clamp(low, high);
        self.good_ns = base_ns;
        self.roll_ns = base_ns;
        self.note(fit, matches, base_ns, in_frame);
    }

    /// Books the blobs of cameras in the set `in_frame`.
    fn note(&mut self, fit: &Fit, matches: &[Match], base_ns: u64, in_frame: u32) {
        for m in matches.iter().filter(|m| !m.out) {
            self.seen_ns[m.camera] = base_ns;
            if in_frame & (1 << m.camera) != 0 {
                self.frame.blobs += 1;
                self.frame.cameras |= 1 << m.camera;
                self.frame.markers |= 1 << m.marker;
            }
        }
        self.frame.squares_px2 += fit.squares_px2;
        self.measured_ns = base_ns;
        let eyes = self.seen_ns.iter().filter(|&&t| t > 0 && base_ns.saturating_sub(t) <= k::SEEN_NS).count();
        if eyes >= 2 {
            self.good_ns = base_ns;
        }
    }

    /// Books when a marker beside the shaft told the roll.
    pub fn note_roll(&mut self, model: &BodyModel, matches: &[Match], base_ns: u64) {
        if matches.iter().any(|m| !m.out && model.tells_roll(m.marker) && tells_place(&m.covariance)) {
            self.roll_ns = base_ns;
        }
    }

    /// What is published for the instant `exposed_ns`, after the fields of `cameras` (a set).
    pub fn state(&mut self, rig: &RigModel, body: usize, exposed_ns: u64, cameras: u32) -> BodyState {
        let model = &rig.bodies[body];
        let mut state = BodyState::zeroed();
        let covariance = self.filter.as_ref().map_or(self.last_covariance, Estimate::pose_covariance);
        let mut pose = self.last_pose;
        if let Some(filter) = &self.filter {
            let dt = exposed_ns.wrapping_sub(filter.time_ns()) as i64 as f64 * 1e-9;
            pose = filter.pose_after(dt.clamp(-0.2, 0.2));
            state.predictor = predictor(filter, model);
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
            self.forecast.take(exposed_ns, validity == Validity::Measured, tip_after);
            self.forecast.publish(exposed_ns, tip_after, &mut state.predictor);
        }
        state.validity = validity as u32;
        state.status = self.status(rig, body, validity, &pose, cameras) as u32;
        state.measured_ns = self.measured_ns;
        state.blobs_used = self.frame.blobs;
        state.cameras_used = self.frame.cameras.count_ones();
        if self.frame.blobs > 0 {
            state.residual_px = libm::sqrt(self.frame.squares_px2 / f64::from(self.frame.blobs));
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
        let placed = Placed::from(pose);
        let disturbing = frame.thrown_out + frame.strays;
        let leaves = |m: &Marker| !seen_by_two(rig, m, &placed, cameras);
        let model = &rig.bodies[body];
        let in_a_line = !model.is_eye
            && (0..model.markers.len()).all(|m| frame.markers & (1 << m) == 0 || !model.tells_roll(m));
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

fn predictor(filter: &Estimate, model: &BodyModel) -> Predictor {
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
