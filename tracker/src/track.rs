//! The track of one body: its filter, the blobs of the present frame, and the body's validity and
//! status.

use crate::associate::PredictedBody;
use crate::body_filter::BodyFilter;
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::fit::{BlobMatch, PoseFit};
use crate::instrument_filter::{Hand, Pivot};
use crate::observation::is_localised;
use crate::pose_math::Matrix6;
use crate::predictor::TipPredictor;
use crate::projection::{PoseMatrix, in_view_of_two};
use crate::rate_constants::RateConstants;
use crate::rig_model::{BodyModel, Marker, RigModel};
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::MAX_CAMERAS;
use protocol::poses::{BodyState, BodyStatus, Predictor};

/// The track of a body.
#[derive(Debug, Clone)]
pub struct Track {
    /// `None` while lost.
    pub filter: Option<BodyFilter>,
    /// Running reduced χ², the factor on the variances of blobs: above 1 where the rig is less
    /// exact than the blobs.
    pub variance_scale: f64,
    /// Instant of the last blob in each camera, ns.
    seen_ns: [u64; MAX_CAMERAS],
    /// Last instant at which two cameras saw the body, ns.
    pub good_ns: u64,
    measured_ns: u64,
    /// Last instant at which a marker beside the shaft gave the roll, ns.
    pub roll_ns: u64,
    last_pose: Isometry3<f64>,
    last_covariance: Matrix6,
    frame: FrameStats,
    predictor: TipPredictor,
    /// What was learnt of the hand before the body was lost.
    hand: Option<Hand>,
    /// How often the filter or the predictor was not finite and was reset.
    restarts: u64,
}

/// What the present frame has brought.
#[derive(Debug, Clone, Copy, Default)]
struct FrameStats {
    blobs: u32,
    outliers: u32,
    near_misses: u32,
    cameras: u32,
    /// Set of the markers used.
    markers: u32,
    sum_squares_px2: f64,
    /// Blobs of this sum.
    whole: u32,
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
            hand: None,
            restarts: 0,
        }
    }
}

impl Track {
    /// Clears the figures of the frame before.
    pub fn begin_frame(&mut self) {
        self.frame = FrameStats::default();
    }

    /// Predicts the body at `time_ns`; ends the track where two cameras have not seen the body for
    /// too long.
    pub fn predict(&mut self, time_ns: u64, pivot: Option<Pivot>) {
        let lost_after_ns = match &self.filter {
            Some(BodyFilter::Instrument(instrument)) if instrument.turns_freely() => k::FREE_LOST_AFTER_NS,
            _ => k::LOST_AFTER_NS,
        };
        let stale = time_ns.saturating_sub(self.good_ns) > lost_after_ns;
        if let Some(filter) = &mut self.filter {
            if let BodyFilter::Instrument(instrument) = filter
                && time_ns.saturating_sub(self.roll_ns) > k::ROLL_COAST_NS
            {
                instrument.damp_roll(time_ns.saturating_sub(instrument.time_ns) as f64 * 1e-9);
            }
            filter.predict(time_ns, pivot);
        }
        if self.filter.as_ref().is_some_and(|f| !f.is_finite()) {
            // Its pose is lost with it; the body is acquired again.
            self.filter = None;
            self.restarts += 1;
        }
        if stale || self.filter.is_none() {
            self.lose();
        }
    }

    /// How often the body's filter or predictor was not finite and was reset.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Ends the track; its last pose stays in the published state.
    #[cold]
    pub fn lose(&mut self) {
        // Where it lies: a filter is large.
        if let Some(filter) = &self.filter {
            self.last_pose = filter.pose();
            self.last_covariance = filter.pose_covariance();
            self.hand = filter.hand();
            self.filter = None;
        }
        self.seen_ns = [0; MAX_CAMERAS];
        self.predictor.interrupt();
    }

    /// As [`Track::predicted`], for blobs that were exposed at different instants.
    pub fn predicted_for_lines(&self) -> Option<PredictedBody> {
        let (predicted, filter) = (self.predicted()?, self.filter.as_ref()?);
        let information = predicted.covariance.cholesky().map(|c| c.inverse());
        let given = information.map(|information| filter.motion_given_pose(&information));
        Some(PredictedBody { given, ..predicted })
    }

    /// The predicted body at its filter's instant.
    pub fn predicted(&self) -> Option<PredictedBody> {
        self.filter.as_ref().map(|f| PredictedBody {
            pose: f.pose(),
            covariance: f.pose_covariance(),
            motion: f.motion(),
            given: None,
            variance_scale: self.variance_scale,
        })
    }

    /// True if the body is lost, or two cameras have not seen it for some time.
    pub fn needs_acquisition(&self, time_ns: u64, at_rate: &RateConstants) -> bool {
        self.filter.is_none() || time_ns.saturating_sub(self.good_ns) > at_rate.acquire_after_ns
    }

    /// Counts unassigned blobs near the body's markers.
    pub fn count_near_misses(&mut self, near_misses: u32) {
        self.frame.near_misses += near_misses;
    }

    /// Updates the filter with a fit. False if the fit was refused: its reduced χ² is too high, or it explains fewer
    /// blobs than are `unexplained`.
    pub fn update(
        &mut self,
        fit: &PoseFit,
        unexplained: usize,
        prior_information: &Matrix6,
        matches: &[BlobMatch],
        time_ns: u64,
        rig: &RigModel,
    ) -> bool {
        let reduced = fit.reduced_chi2();
        let limit = rig.tuning.bad_fit * self.variance_scale;
        let mostly_unexplained = unexplained > fit.blobs;
        self.frame.outliers += fit.outliers as u32;
        if mostly_unexplained || reduced.is_some_and(|c| c > limit) {
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
                (self.variance_scale + rig.at_rate.chi2_gain * (c - self.variance_scale)).clamp(low, high);
        }
        self.record(fit, matches, time_ns, u32::MAX, &rig.at_rate);
        true
    }

    /// Starts a new track at an acquired pose.
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
        self.filter = Some(BodyFilter::new(model, &fit.pose, &fit.covariance, pivot, time_ns, self.hand));
        // The χ² of a drifted rig is high from the start and decays slowly.
        let (low, high) = k::CHI2_RANGE;
        self.variance_scale = fit.reduced_chi2().unwrap_or(1.0).clamp(low, high);
        self.good_ns = time_ns;
        self.roll_ns = time_ns;
        self.record(fit, matches, time_ns, in_frame, &model.at_rate);
    }

    /// Counts the blobs of the cameras in the set `in_frame`.
    fn record(
        &mut self,
        fit: &PoseFit,
        matches: &[BlobMatch],
        time_ns: u64,
        in_frame: u32,
        at_rate: &RateConstants,
    ) {
        for m in matches.iter().filter(|m| !m.outlier) {
            self.seen_ns[m.camera] = time_ns;
            if in_frame & (1 << m.camera) != 0 {
                self.frame.blobs += 1;
                self.frame.cameras |= 1 << m.camera;
                self.frame.markers |= 1 << m.marker;
            }
        }
        self.frame.sum_squares_px2 += fit.sum_squares_px2;
        self.frame.whole += fit.whole;
        self.measured_ns = time_ns;
        if self.seeing(u32::MAX, time_ns, at_rate) >= 2 {
            self.good_ns = time_ns;
        }
    }

    /// How many of the cameras in a set see the body.
    pub fn seeing(&self, cameras: u32, time_ns: u64, at_rate: &RateConstants) -> usize {
        let sees = |(c, t): &(usize, &u64)| {
            cameras & (1 << c) != 0 && **t > 0 && time_ns.saturating_sub(**t) <= at_rate.seen_ns
        };
        self.seen_ns.iter().enumerate().filter(sees).count()
    }

    /// Notes the instant if a marker beside the shaft gave the roll.
    pub fn observe_roll(&mut self, model: &BodyModel, matches: &[BlobMatch], time_ns: u64) {
        if matches.iter().any(|m| !m.outlier && model.observes_roll(m.marker) && is_localised(&m.covariance))
        {
            self.roll_ns = time_ns;
        }
    }

    /// Does what the newest state left to be done.
    pub fn follow_up(&mut self) {
        self.restarts += u64::from(self.predictor.follow_up());
    }

    /// The published state at `exposed_ns`, after the fields of `cameras` (a set).
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
            let measured = validity == Validity::Measured;
            if self.predictor.observe(exposed_ns, rig.at_rate.period_ns, measured, tip_after) {
                self.restarts += u64::from(self.predictor.recover());
            }
            self.predictor.write_to(exposed_ns, tip_after, &mut state.predictor);
        }
        state.validity = validity as u32;
        state.status = self.status(rig, body, validity, &pose, cameras) as u32;
        state.measured_ns = self.measured_ns;
        state.blobs_used = self.frame.blobs;
        state.cameras_used = self.frame.cameras.count_ones();
        if self.frame.whole > 0 {
            state.residual_px = libm::sqrt(self.frame.sum_squares_px2 / f64::from(self.frame.whole));
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
        let precise =
            (model.is_eye || position < model.tuning.measured_mm) && rotation < model.tuning.measured_rad;
        let recent = self.measured_ns.saturating_sub(self.good_ns) <= model.at_rate.one_camera_ns;
        // One marker alone may be a false blob.
        if self.frame.markers.count_ones() >= 2 && recent && precise {
            Validity::Measured
        } else {
            Validity::Predicted
        }
    }

    /// Status of the body; of several reasons the one nearest to the cause.
    fn status(
        &self,
        rig: &RigModel,
        body: usize,
        validity: Validity,
        pose: &Isometry3<f64>,
        cameras: u32,
    ) -> BodyStatus {
        let frame = &self.frame;
        let matrix = PoseMatrix::from(pose);
        let interfering = frame.outliers + frame.near_misses;
        let outside = |m: &Marker| !in_view_of_two(rig, m, &matrix, cameras);
        let model = &rig.bodies[body];
        let roll_unobserved = !model.is_eye
            && (0..model.markers.len()).all(|m| frame.markers & (1 << m) == 0 || !model.observes_roll(m));
        if validity == Validity::Lost {
            BodyStatus::Lost
        } else if frame.bad_fit {
            BodyStatus::BadFit
        } else if interfering > 0 && interfering * k::INTERFERENCE_SHARE >= frame.blobs {
            BodyStatus::Interference
        } else if frame.blobs == 0 {
            BodyStatus::Predicted
        } else if cameras.count_ones() >= 2 && rig.bodies[body].markers.iter().any(outside) {
            BodyStatus::PartlyOutOfVolume
        } else if roll_unobserved || frame.markers.count_ones() < 3 || frame.cameras.count_ones() < 2 {
            BodyStatus::TooFewMarkers
        } else if validity == Validity::Measured {
            BodyStatus::Tracked
        } else {
            BodyStatus::Predicted
        }
    }
}

impl Track {
    /// Writes all but the figures of the present frame. Nothing predicts the eye beyond its filter.
    pub(crate) fn save(&self, model: &BodyModel, out: &mut Saver<'_>) -> Done {
        let Track { filter, variance_scale, seen_ns, good_ns, measured_ns, roll_ns, .. } = self;
        let Track { last_pose, last_covariance, frame: _, predictor, hand, restarts, .. } = self;
        out.put(&filter.is_some())?;
        filter.as_ref().map_or(Ok(()), |filter| filter.save(out))?;
        out.numbers([variance_scale])?;
        for count in seen_ns.iter().chain([good_ns, measured_ns, roll_ns, restarts]) {
            out.put(count)?;
        }
        out.pose(last_pose)?;
        out.square(6, |r, c| last_covariance[(r, c)])?;
        if model.is_eye {
            return Ok(());
        }
        out.put(&hand.is_some())?;
        hand.as_ref().map_or(Ok(()), |hand| hand.save(out))?;
        predictor.save(out)
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, model: &BodyModel, from: &mut Loader<'_>) -> Done {
        let tracked = from.take()?;
        self.filter = if tracked { Some(BodyFilter::load(model, from)?) } else { None };
        self.variance_scale = from.within(k::CHI2_RANGE.0, k::CHI2_RANGE.1)?;
        let rest = [&mut self.good_ns, &mut self.measured_ns, &mut self.roll_ns, &mut self.restarts];
        for slot in self.seen_ns.iter_mut().chain(rest) {
            *slot = from.count()?;
        }
        self.last_pose = from.pose()?;
        from.square(6, |r, c, number| self.last_covariance[(r, c)] = number)?;
        if model.is_eye {
            return Ok(());
        }
        self.hand = from.take::<bool>()?.then(Hand::default);
        self.hand.as_mut().map_or(Ok(()), |hand| hand.load(from))?;
        self.predictor.load(from)
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
