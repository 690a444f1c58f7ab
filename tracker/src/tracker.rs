//! From camera-fields to poses. Pure: the state depends on the consumed fields in their order only.

mod follow_up;
mod manoeuvre;
mod saved;
mod update;

pub use saved::TrackerSnapshot;
pub(crate) use saved::{load_place, save_place};

use crate::acquisition::Acquisition;
use crate::associate::Associator;
use crate::camera_watch::{CameraWatch, Notice};
use crate::drift::{DriftEstimator, DriftReport};
use crate::instrument_filter::Pivot;
use crate::match_log::MatchLog;
use crate::observation::FieldObservation;
use crate::rig_model::RigModel;
use crate::track::Track;
use crate::tuning::Tuning;
use bytemuck::Zeroable;
use follow_up::Owed;
use protocol::blobs::BlobField;
use protocol::limits::{BODIES, MAX_CAMERAS, MAX_FIELDS_USED};
use protocol::matches::MatchFrame;
use protocol::phases::{Phase, Phases, Unmarked};
use protocol::poses::{BodyState, BodyStatus, ClosedBy, EYE, FieldUsed, TrackerFrame};
use protocol::time::Nanos;
use rig::Rig;

/// The exposure that a frame is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reference {
    /// Camera id.
    pub camera: u32,
    /// Field number of that camera.
    pub field: u64,
    /// Middle of the exposure, ns.
    pub exposed_ns: u64,
}

/// Order of the bodies: the eye first, because it carries the trocars.
const ORDER: [usize; BODIES] = [EYE, 0, 1];

/// Tracks two instruments and the eye.
#[derive(Clone)]
pub struct Tracker {
    /// As it is estimated to be now.
    rig: RigModel,
    /// Of the rig as calibrated, and of what is estimated of it.
    fingerprint: u64,
    drift: Option<DriftEstimator>,
    watch: Option<CameraWatch>,
    /// Updates since the eye was tracked last.
    without_eye: u32,
    tracks: Box<[Track; BODIES]>,
    /// Newest field of each camera, by camera id.
    fields: Box<[FieldObservation; MAX_CAMERAS]>,
    /// Running ratio of seen to expected blob areas, by camera id.
    area_scales: [f64; MAX_CAMERAS],
    associator: Associator,
    acquisition: Acquisition,
    matches: MatchLog,
    /// What the newest frame left to be done.
    owed: Owed,
    last_ns: u64,
    frame: u64,
    /// Set of the cameras whose fields are in the present frame.
    cameras_in_frame: u32,
    blobs_refused: u64,
}

/// Camera-fields of one instant, already among the tracker's observations.
#[derive(Debug, Clone, Copy)]
struct Group {
    /// Set of the cameras whose fields are tracked.
    cameras: u32,
    /// Set of all cameras whose fields came.
    seen: u32,
    /// Instant of the update, ns.
    time_ns: u64,
}

impl Tracker {
    /// A fresh tracker for a checked rig, which estimates how far the rig has drifted.
    pub fn new(rig: &Rig) -> Self {
        Tracker::with(rig, true)
    }

    /// A fresh tracker for a checked rig; without `estimate_drift` the rig file is trusted.
    pub fn with(rig: &Rig, estimate_drift: bool) -> Self {
        Tracker::tuned(rig, estimate_drift, &Tuning::default())
    }

    /// As [`Tracker::with`], with other constants.
    pub fn tuned(rig: &Rig, estimate_drift: bool, tuning: &Tuning) -> Self {
        let fingerprint = saved::fingerprint(rig, estimate_drift, tuning);
        let rig = RigModel::tuned(rig, tuning);
        Tracker {
            fingerprint,
            drift: estimate_drift.then(|| DriftEstimator::new(&rig)),
            watch: estimate_drift.then(|| CameraWatch::new(&rig)),
            without_eye: 0,
            rig,
            tracks: Default::default(),
            fields: Box::new(std::array::from_fn(FieldObservation::empty)),
            area_scales: [1.0; MAX_CAMERAS],
            associator: Associator::default(),
            acquisition: Acquisition::default(),
            matches: MatchLog::default(),
            owed: Owed::default(),
            last_ns: 0,
            frame: 0,
            cameras_in_frame: 0,
            blobs_refused: 0,
        }
    }

    /// What became of the blobs of the newest frame that was followed up.
    pub fn matches(&self) -> &MatchFrame {
        self.matches.frame()
    }

    /// Blobs ignored since the start: not finite, without size or far outside of the frame.
    pub fn blobs_refused(&self) -> u64 {
        self.blobs_refused
    }

    /// How often a filter or predictor of a body was not finite and was reset.
    pub fn restarts(&self) -> u64 {
        self.tracks.iter().map(Track::restarts).sum()
    }

    /// How far the rig has drifted; `None` where that is not estimated.
    pub fn drift(&self) -> Option<&DriftReport> {
        self.drift.as_ref().map(DriftEstimator::report)
    }

    /// The oldest notice about a moved camera that was not taken yet.
    pub fn take_notice(&mut self) -> Option<Notice> {
        self.watch.as_mut().and_then(CameraWatch::take_notice)
    }

    /// Forgets everything; the next frame has this number, as within a recording that is run again.
    pub fn begin_at(&mut self, frame: u64) {
        self.reset();
        self.frame = frame;
    }

    /// Ends all tracks, and forgets what they have learnt. Tracks are large: whoever has room for new ones on its stack
    /// touches every page of it, whether it makes them or not.
    #[cold]
    #[inline(never)]
    fn forget_tracks(&mut self) {
        for track in self.tracks.iter_mut() {
            *track = Track::default();
        }
    }

    /// Forgets everything; the next frame has number 0.
    pub fn reset(&mut self) {
        self.forget_tracks();
        self.area_scales = [1.0; MAX_CAMERAS];
        self.last_ns = 0;
        for field in self.fields.iter_mut() {
            field.exposed_ns = 0;
        }
        if let Some(drift) = &mut self.drift {
            drift.reset(&mut self.rig);
        }
        if let Some(watch) = &mut self.watch {
            *watch = CameraWatch::new(&self.rig);
        }
        self.without_eye = 0;
        self.frame = 0;
    }

    /// Consumes `used` in this order and returns the poses at the exposure `reference`. The process
    /// fills in the instants but `exposed`, the wait, and how the frame was closed.
    pub fn track(&mut self, used: &[BlobField], reference: &Reference) -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        self.track_into(&mut frame, used, reference, &mut Unmarked);
        self.follow_up(used);
        frame
    }

    /// As [`Tracker::track`], into `frame`, whatever it held, and without what no pose of this frame depends on:
    /// [`Tracker::follow_up`] does that once the frame was sent. The end of each phase is marked on `phases`, which
    /// changes no result.
    pub fn track_into(
        &mut self,
        frame: &mut TrackerFrame,
        used: &[BlobField],
        reference: &Reference,
        phases: &mut impl Phases,
    ) {
        let used = &used[..used.len().min(MAX_FIELDS_USED)];
        // Where the frame before was not followed up, nothing but its matches is missing.
        self.follow_up(&[]);
        self.begin_frame(frame, reference);
        for group in groups(used, self.rig.at_rate.group_ns) {
            self.note_owed_matches(used);
            self.take_fields(group.len());
            if self.update(group, reference, phases, used).is_none() {
                self.matches.note_unknown(group);
            }
            self.list_fields(group, frame);
        }
        self.owe_drift(used, reference.exposed_ns);
        phases.ended(Phase::Drift);
        self.predict(reference.exposed_ns);
        phases.ended(Phase::Predict);
        self.write_poses(frame);
        phases.ended(Phase::WritePoses);
    }

    /// One update with the fields of one instant; `None` where none of them is of a camera of the
    /// rig.
    fn update(
        &mut self,
        fields: &[BlobField],
        reference: &Reference,
        phases: &mut impl Phases,
        used: &[BlobField],
    ) -> Option<()> {
        let group = self.observe(fields, reference)?;
        phases.ended(Phase::Observe);
        self.predict(group.time_ns);
        let prior = self.predictions();
        phases.ended(Phase::Predict);
        let admitted = self.admit(group);
        let (group, association) = self.associate(admitted);
        phases.ended(Phase::Associate);
        let estimate = self.estimate(group, association);
        phases.ended(Phase::Fit);
        let accepted = self.filter(group, &estimate);
        phases.ended(Phase::Filter);
        self.owe_matches(fields.len(), [admitted, group], prior, estimate, accepted);
        self.watch_cameras(group, used);
        phases.ended(Phase::WatchCameras);
        self.acquire(group, used);
        phases.ended(Phase::Acquire);
        Some(())
    }

    fn begin_frame(&mut self, frame: &mut TrackerFrame, reference: &Reference) {
        *frame = TrackerFrame::zeroed();
        frame.field = reference.field;
        frame.camera = reference.camera;
        frame.frame = self.frame;
        frame.instants.exposed = reference.exposed_ns;
        self.frame += 1;
        self.matches.begin(frame);
        self.cameras_in_frame = 0;
        for track in self.tracks.iter_mut() {
            track.begin_frame();
        }
    }

    /// Predicts all bodies at an instant.
    fn predict(&mut self, time_ns: u64) {
        for body in ORDER {
            let pivot = self.pivot(body, time_ns);
            self.tracks[body].predict(time_ns, pivot);
        }
    }

    /// The trocar that an instrument's shaft passes at `time_ns`, if the eye is tracked.
    fn pivot(&self, body: usize, time_ns: u64) -> Option<Pivot> {
        let trocar = self.rig.bodies[body].trocar?;
        let eye = self.tracks[EYE].filter.as_ref()?;
        let dt = time_ns.wrapping_sub(eye.time_ns()) as i64 as f64 * 1e-9;
        let position = eye.pose_after(dt).rotation * trocar.position_in_eye.coords;
        Some(Pivot { position, sigma: trocar.sigma, tracked: true })
    }

    /// True for a frame from which drift is estimated: one in 20 ms, and where cameras have different rates one with a
    /// field of the slowest, unless that is silent.
    fn looks_at_rig(&self, exposed_ns: u64) -> bool {
        let at_rate = &self.rig.at_rate;
        let Some(slowest) = at_rate.slowest else { return at_rate.looks_at_rig(exposed_ns) };
        let since_ns = exposed_ns.saturating_sub(self.fields[slowest].exposed_ns);
        if since_ns > at_rate.silent_ns {
            return at_rate.looks_at_rig(exposed_ns);
        }
        since_ns < at_rate.period_ns / 2 && at_rate.looks_at_camera(slowest, self.fields[slowest].exposed_ns)
    }

    /// Lists the fields of a group in the frame.
    fn list_fields(&self, group: &[BlobField], frame: &mut TrackerFrame) {
        for field in group {
            let observed = self.fields.get(field.camera as usize);
            frame.used[frame.used_count as usize] = FieldUsed {
                field: field.field,
                exposed_ns: field.exposed_ns,
                camera: field.camera,
                blobs_used: observed.map_or(0, |f| f.assigned.count_ones()),
            };
            frame.used_count += 1;
        }
    }

    fn write_poses(&mut self, frame: &mut TrackerFrame) {
        for (body, track) in self.tracks.iter_mut().enumerate() {
            frame.bodies[body] = track.state(&self.rig, body, frame.instants.exposed, self.cameras_in_frame);
        }
        if let Some(watch) = &self.watch {
            (frame.cameras_left_out, frame.cameras_estimated) = (watch.left_out(), watch.estimated());
            if watch.disagrees(frame.instants.exposed) {
                frame.bodies.iter_mut().filter(|body| body.blobs_used > 0).for_each(doubt);
            }
        }
    }
}

/// What cameras that disagree make of a body: its pose fits none of them well, and no better status is right.
fn doubt(body: &mut BodyState) {
    if ![BodyStatus::Lost as u32, BodyStatus::BadFit as u32].contains(&body.status) {
        body.status = BodyStatus::CamerasDisagree as u32;
    }
}

/// The fields in groups of one instant: close together, each camera once.
fn groups(fields: &[BlobField], group_ns: u64) -> impl Iterator<Item = &[BlobField]> {
    let mut rest = fields;
    std::iter::from_fn(move || {
        let (group, after) = rest.split_at(group_len(rest, group_ns));
        rest = after;
        (!group.is_empty()).then_some(group)
    })
}

fn group_len(fields: &[BlobField], group_ns: u64) -> usize {
    let mut cameras = 0u32;
    for (i, field) in fields.iter().enumerate() {
        let bit = 1u32.checked_shl(field.camera).unwrap_or(0);
        let close = field.exposed_ns.abs_diff(fields[0].exposed_ns) <= group_ns;
        if i > 0 && (!close || cameras & bit != 0) {
            return i;
        }
        cameras |= bit;
    }
    fields.len()
}

/// Copies the instants of the fields into the frame, and that at which they were taken.
pub fn stamp(frame: &mut TrackerFrame, used: &[BlobField], taken: Nanos) {
    frame.instants.read_out = used.iter().map(|f| f.read_out_ns).max().unwrap_or(0);
    frame.instants.blobs_out = used.iter().map(|f| f.blobs_out_ns).max().unwrap_or(0);
    frame.instants.taken = taken;
}

/// Notes how a frame was closed. Where the next field of the reference camera came first, the
/// tracker fell behind, and no body has a better status than that.
pub fn close(frame: &mut TrackerFrame, closed_by: ClosedBy) {
    frame.closed_by = closed_by as u32;
    if closed_by == ClosedBy::NextField {
        for body in frame.bodies.iter_mut().filter(|b| b.status != BodyStatus::Lost as u32) {
            body.status = BodyStatus::FellBehind as u32;
        }
    }
}
