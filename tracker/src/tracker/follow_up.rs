//! What follows once the poses of a frame were sent, because no pose of the frame depends on it: what became of every
//! blob, the drift of the rig, the covariances of the long predictors. Its results are the same whether somebody waits
//! for the poses or not; where a part of it does decide about the frame, that part is done before.

use super::update::{Estimate, Fits};
use super::{Group, Tracker};
use crate::associate::{Association, PredictedBody};
use crate::match_log::UpdateResult;
use nalgebra::Vector3;
use protocol::blobs::BlobField;
use protocol::limits::{BODIES, MAX_FIELDS_USED};
use std::ops::Range;

/// What a frame left to be done.
#[derive(Clone, Default)]
pub(super) struct Owed {
    /// The newest update.
    update: Option<OwedUpdate>,
    /// Fields of the frame that were tracked so far.
    fields: usize,
    drift: Option<OwedDrift>,
    predictors: bool,
}

/// What is kept of an update.
#[derive(Clone)]
struct OwedUpdate {
    /// Its fields, among those of the frame.
    fields: Range<usize>,
    /// The cameras that are not left out, and those that were tracked.
    groups: [Group; 2],
    prior: [Option<PredictedBody>; BODIES],
    association: Association,
    fits: Fits,
    /// Fits that the filters accepted.
    accepted: Fits,
    /// What became of its blobs is in the record.
    noted: bool,
}

/// A body's turn in the drift estimation.
#[derive(Clone, Copy)]
struct OwedDrift {
    body: usize,
    /// Its motion after the newest update; `None` while it is lost.
    motion: Option<[Vector3<f64>; 2]>,
}

impl Owed {
    pub(super) fn is_nothing(&self) -> bool {
        self.update.is_none() && self.drift.is_none() && !self.predictors
    }
}

impl Tracker {
    /// Does what [`Tracker::track_into`] left to be done; `used` are the fields of that frame.
    pub fn follow_up(&mut self, used: &[BlobField]) {
        let used = &used[..used.len().min(MAX_FIELDS_USED)];
        self.note_owed_matches(used);
        self.estimate_owed_drift();
        self.end_owed_update();
        self.owed.fields = 0;
        if std::mem::take(&mut self.owed.predictors) {
            self.tracks.iter_mut().for_each(|track| track.follow_up());
        }
    }

    /// Keeps what an update of the next `fields` found for the record of what became of their blobs: of the cameras
    /// of the first group, which are not left out, those of the second were tracked.
    pub(super) fn owe_matches(
        &mut self,
        fields: usize,
        groups: [Group; 2],
        prior: [Option<PredictedBody>; BODIES],
        estimate: Estimate,
        accepted: Fits,
    ) {
        self.end_owed_update();
        let Estimate { association, fits } = estimate;
        let fields = self.owed.fields - fields..self.owed.fields;
        self.owed.update =
            Some(OwedUpdate { fields, groups, prior, association, fits, accepted, noted: false });
    }

    /// Counts the fields of the next update.
    pub(super) fn take_fields(&mut self, fields: usize) {
        self.owed.fields += fields;
    }

    /// Records what became of the blobs of the newest update, where that is not yet done: before cameras or markers
    /// move, before a body is found among blobs that no marker took, and at last.
    pub(super) fn note_owed_matches(&mut self, used: &[BlobField]) {
        let Some(update) = self.owed.update.as_mut().filter(|update| !update.noted) else { return };
        update.noted = true;
        let [admitted, tracked] = update.groups;
        let result = UpdateResult {
            input: tracked.input(&self.rig, &self.fields, &self.area_scales),
            admitted: admitted.cameras,
            prior: &update.prior,
            association: &update.association,
            fits: &update.fits,
            accepted: update.accepted.each_ref().map(Option::is_some),
        };
        self.matches.note(used.get(update.fields.clone()).unwrap_or_default(), &result);
    }

    /// The drift estimation owes a look at the frame's newest update. Where that moves the rig, by which the status of
    /// a body is judged, it is done at once.
    pub(super) fn owe_drift(&mut self, used: &[BlobField], exposed_ns: u64) {
        self.owed.predictors = true;
        let looks = self.looks_at_rig(exposed_ns);
        let Some(drift) = self.drift.as_mut().filter(|_| looks) else { return };
        let body = drift.next_body();
        let motion = self.tracks[body].filter.as_ref().map(|filter| filter.motion());
        self.owed.drift = Some(OwedDrift { body, motion });
        if drift.moves_next() {
            self.note_owed_matches(used);
            self.estimate_owed_drift();
        }
    }

    /// Adds one body's residuals in the frame's newest update to the drift estimation, and computes
    /// a part of its solution.
    fn estimate_owed_drift(&mut self) {
        let (Some(owed), Some(drift)) = (self.owed.drift.take(), &mut self.drift) else { return };
        let OwedDrift { body, motion } = owed;
        let update = self.owed.update.as_ref();
        let accepted = update.and_then(|update| Some((update, update.accepted[body].as_ref()?)));
        if let (Some((update, fit)), Some(motion)) = (accepted, motion) {
            drift.add_residuals(&self.rig, body, &fit.pose, &motion, &update.association.matches[body]);
        }
        drift.step(&mut self.rig);
    }

    fn end_owed_update(&mut self) {
        if let Some(update) = self.owed.update.take() {
            self.associator.recycle(update.association);
        }
    }
}
