//! How well a run or a replay is tracked: shares, residuals, cameras; and what is wrong with it, with
//! its likely cause and what helps. Pure.

use crate::agreement::{Agreement, Dissenter};
use crate::due::Due;
use crate::finding::{
    CHECK_CABLE, CHECK_LENS, CHECK_MARKERS, DARK, FASTEN, FIELDS_OF, Finding, HIDDEN, MOVED, NEVER,
    OTHER_RIG, PICTURE_OF, PLACE_OF, RECALIBRATE, SILENT,
};
use crate::residuals::{Long, Residuals};
use crate::summary::{BodySummary, Summary};
use protocol::blobs::BlobField;
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::matches::MatchFrame;
use protocol::poses::{BODY_NAMES, BodyStatus, TrackerFrame};
use protocol::time::Nanos;
use rig::Rig;
use serde::Serialize;
use std::collections::BTreeMap;

/// Period of the judgement, ns.
pub(crate) const PERIOD_NS: u64 = 1_000_000_000;
/// Frames of a period that are enough to judge it.
const ENOUGH_FRAMES: u64 = 10;
/// Frames after which a body that was not tracked once never was: 3 s.
const NEVER_FRAMES: u64 = 150;
/// Share of a period's frames below which a body is badly tracked.
const POOR_SHARE: f64 = 0.5;
/// Median residual above which the rig does not hold, px. Blobs vary by 0.05 px, and a rig that
/// holds leaves residuals of up to 0.15 px.
const RESIDUAL_PX: f64 = 0.4;
/// Share of blobs in use below which a camera is not believed while others are.
const UNUSED_SHARE: f64 = 0.2;

/// Counts of a body.
#[derive(Debug, Clone, Default)]
struct BodyCounts {
    valid: u64,
    statuses: BTreeMap<&'static str, u64>,
    residuals: Residuals,
}

/// Counts of a camera.
#[derive(Debug, Clone, Copy, Default)]
struct CameraCounts {
    fields: u64,
    blobs: u64,
    used: u64,
}

/// Counts of a period, or of all.
#[derive(Debug, Clone, Default)]
struct Counts {
    frames: u64,
    bodies: [BodyCounts; BODIES],
    cameras: BTreeMap<u32, CameraCounts>,
}

/// Watches the tracking.
#[derive(Debug)]
pub struct Tracking {
    agreement: Agreement,
    cameras: Vec<u32>,
    due: Due,
    summary: Summary,
    total: Counts,
    period: Counts,
    period_ns: Nanos,
    long: Long,
    dissenter: Option<Dissenter>,
    /// Cameras that the tracker leaves out, and that it uses where it found them.
    left_out: u32,
    estimated: u32,
    findings: Vec<Finding>,
}

/// Figures of the tracking, for reports.
#[derive(Debug, Default, Serialize)]
pub struct TrackingFigures {
    /// Tracker frames.
    pub frames: u64,
    /// Frames that should have been: one in every field period in which the cameras exposed.
    pub frames_due: u64,
    /// By body.
    pub bodies: BTreeMap<&'static str, BodyFigures>,
    /// By camera.
    pub cameras: BTreeMap<u32, CameraFigures>,
    /// A line a body, for people.
    #[serde(skip)]
    pub lines: Vec<String>,
}

/// How a body was tracked.
#[derive(Debug, Default, Serialize)]
pub struct BodyFigures {
    /// Share of [`TrackingFigures::frames_due`] with a measured pose.
    pub tracked_share: f64,
    /// Median of the residuals in the pictures, px.
    pub residual_px: f64,
    /// Frames by status.
    pub frames_by_status: BTreeMap<&'static str, u64>,
    /// Shares, residuals by camera, the longest gap.
    #[serde(flatten)]
    pub summary: BodySummary,
}

/// What a camera contributed.
#[derive(Debug, Default, Serialize)]
pub struct CameraFigures {
    /// Fields that went into a frame.
    pub fields: u64,
    /// Blobs of a field, mean.
    pub blobs_per_field: f64,
    /// Share of them that a pose used.
    pub used_share: f64,
}

impl Tracking {
    /// With the cameras of a rig.
    pub fn new(rig: &Rig) -> Self {
        Tracking {
            agreement: Agreement::new(rig),
            cameras: rig.cameras.iter().map(|c| c.id).collect(),
            due: Due::new(rig.field_period_ns()),
            summary: Summary::new(rig.field_period_ns()),
            total: Counts::default(),
            period: Counts::default(),
            period_ns: 0,
            long: Long::default(),
            dissenter: None,
            left_out: 0,
            estimated: 0,
            findings: Vec::new(),
        }
    }

    /// Takes a camera's field.
    pub fn note_field(&mut self, field: &BlobField) {
        self.due.note_field(field);
        for counts in [&mut self.total, &mut self.period] {
            let camera = counts.cameras.entry(field.camera).or_default();
            camera.fields += 1;
            camera.blobs += field.blobs().len() as u64;
        }
        self.agreement.note(field);
    }

    /// Takes a frame of the tracker; true where a period is over and [`Tracking::findings`] are new.
    pub fn note_frame(&mut self, frame: &TrackerFrame) -> bool {
        self.due.note_frame(frame);
        self.summary.note_frame(frame);
        self.total.note(frame);
        self.period.note(frame);
        // One that was back before the period was over is reported too.
        self.left_out |= frame.cameras_left_out;
        self.estimated = frame.cameras_estimated;
        let exposed = frame.instants.exposed;
        if self.period_ns == 0 {
            self.period_ns = exposed;
        }
        if exposed.saturating_sub(self.period_ns) < PERIOD_NS {
            return false;
        }
        self.dissenter = self.agreement.judge();
        self.long.note(self.period.bodies.each_ref().map(|b| &b.residuals));
        if self.period.frames >= ENOUGH_FRAMES {
            self.findings = self.judge();
        }
        (self.period, self.period_ns, self.left_out) = (Counts::default(), exposed, 0);
        true
    }

    /// Takes what became of the blobs of a frame.
    pub fn note_matches(&mut self, matches: &MatchFrame) {
        self.summary.note_matches(matches);
    }

    /// A line a body; none where there were no cameras.
    fn lines(&self, frames_due: u64) -> Vec<String> {
        if self.total.cameras.is_empty() { Vec::new() } else { self.summary.lines(frames_due) }
    }

    /// What was wrong in the newest period.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// What should have been.
    pub fn due(&self) -> &Due {
        &self.due
    }

    /// Takes the count of what should have been from somebody who saw fields that went into no frame.
    pub fn count_by(&mut self, due: Due) {
        self.due = due;
    }

    fn frames_due(&self) -> u64 {
        self.total.frames + self.due.frames_missing()
    }

    /// Least share of the frames that should have been in which a body was tracked; 0 without any.
    pub fn least_share(&self) -> (&'static str, f64) {
        let due = self.frames_due();
        let shares =
            BODY_NAMES.into_iter().zip(&self.total.bodies).map(|(name, b)| (name, ratio(b.valid, due)));
        shares.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or(("nothing", 0.0))
    }

    /// Sums up.
    pub fn figures(&self) -> TrackingFigures {
        let frames_due = self.frames_due();
        let summaries = self.summary.bodies(frames_due);
        let bodies = BODY_NAMES.into_iter().zip(&self.total.bodies).zip(summaries);
        let bodies = bodies.map(|((name, body), summary)| {
            let (residual_px, tracked_share) = (body.residuals.median_px(), ratio(body.valid, frames_due));
            let frames_by_status = body.statuses.clone();
            (name, BodyFigures { tracked_share, residual_px, frames_by_status, summary })
        });
        let cameras = self.total.cameras.iter().map(|(id, c)| {
            let (blobs_per_field, used_share) = (ratio(c.blobs, c.fields), ratio(c.used, c.blobs));
            (*id, CameraFigures { fields: c.fields, blobs_per_field, used_share })
        });
        let frames = self.total.frames;
        TrackingFigures {
            frames,
            frames_due,
            bodies: bodies.collect(),
            cameras: cameras.collect(),
            lines: self.lines(frames_due),
        }
    }

    fn judge(&self) -> Vec<Finding> {
        let mut found = Vec::new();
        self.judge_cameras(&mut found);
        // Where a camera is at fault, it is the cause of what is wrong with bodies too.
        let cause = found.first().cloned();
        for (body, name) in BODY_NAMES.into_iter().enumerate() {
            self.judge_body(body, name, cause.as_ref(), &mut found);
        }
        found
    }

    fn judge_cameras(&self, found: &mut Vec<Finding>) {
        let finding = |id: u32, what: String, cause: &str, remedy: &str| Finding {
            what,
            cause: cause.into(),
            remedy: remedy.into(),
            subject: format!("camera {id}"),
        };
        let best =
            self.cameras.iter().filter_map(|id| self.period.cameras.get(id)).map(|c| ratio(c.used, c.blobs));
        let best = best.fold(0.0, f64::max);
        for &id in &self.cameras {
            let seen = self.period.cameras.get(&id).copied().unwrap_or_default();
            let own = ratio(seen.used, seen.blobs);
            let is_in = |set: u32| set.checked_shr(id).unwrap_or(0) & 1 == 1;
            if is_in(self.left_out) {
                let what = format!("camera {id} is excluded because the others place the markers elsewhere");
                found.push(finding(id, what, MOVED, FASTEN));
            } else if is_in(self.estimated) {
                let what = format!(
                    "camera {id} is used with a pose estimated from the others, not that of the rig file"
                );
                let subject = format!("{PLACE_OF}camera {id}");
                found.push(Finding { subject, ..finding(id, what, MOVED, RECALIBRATE) });
            } else if let Some(d) = self.dissenter.filter(|d| d.camera == id) {
                let px = d.off_px;
                let what = format!("camera {id} is off from every other camera, by {px:.1} px or more");
                found.push(finding(id, what, MOVED, RECALIBRATE));
            } else if seen.fields == 0 {
                let subject = format!("{FIELDS_OF}camera {id}");
                let silent = finding(id, format!("no fields come from camera {id}"), SILENT, CHECK_CABLE);
                found.push(Finding { subject, ..silent });
            } else if seen.blobs == 0 {
                let subject = format!("{PICTURE_OF}camera {id}");
                let dark = finding(id, format!("camera {id} sees no markers"), DARK, CHECK_LENS);
                found.push(Finding { subject, ..dark });
            } else if own < UNUSED_SHARE && best > 2.0 * UNUSED_SHARE {
                let what = format!("only {:.0} % of the blobs of camera {id} fit", 100.0 * own);
                found.push(finding(id, what, MOVED, RECALIBRATE));
            }
        }
    }

    fn judge_body(&self, body: usize, name: &'static str, cause: Option<&Finding>, found: &mut Vec<Finding>) {
        let own = &self.period.bodies[body];
        let never = self.total.frames >= NEVER_FRAMES && self.total.bodies[body].valid == 0;
        let share = self.period.share(own);
        let residual_px =
            if self.period.is_rig_off() { own.residuals.median_px() } else { self.long.residual_px[body] };
        let what = if never {
            format!("{name} {NEVER}")
        } else if share < POOR_SHARE && self.total.frames >= NEVER_FRAMES {
            format!("{name} was tracked in {:.0} % of the last second", 100.0 * share)
        } else if residual_px > RESIDUAL_PX {
            format!("the residuals of {name} are {residual_px:.2} px, above the noise")
        } else {
            return;
        };
        let status = own.statuses.iter().max_by_key(|(_, n)| **n).map_or("", |(text, _)| *text);
        let (why, remedy) = match cause {
            Some(of_camera) => (of_camera.what.clone(), of_camera.remedy.clone()),
            None if status == BodyStatus::TooFewMarkers.text() || status == BodyStatus::Lost.text() => {
                (HIDDEN.into(), CHECK_MARKERS.into())
            }
            None => (OTHER_RIG.into(), RECALIBRATE.into()),
        };
        found.push(Finding { what, cause: why, remedy, subject: name.into() });
    }
}

/// Says that a body was tracked less than was asserted.
pub fn untracked(body: &str, share: f64, asserted: f64) -> String {
    format!(
        "{body} was tracked in {:.2} % of the frames that should have been, less than {:.2} %",
        100.0 * share,
        100.0 * asserted
    )
}

impl Counts {
    fn note(&mut self, frame: &TrackerFrame) {
        self.frames += 1;
        for used in frame.used() {
            self.cameras.entry(used.camera).or_default().used += u64::from(used.blobs_used);
        }
        for (counts, body) in self.bodies.iter_mut().zip(&frame.bodies) {
            let status = BodyStatus::from_wire(body.status).map_or("unknown", BodyStatus::text);
            *counts.statuses.entry(status).or_default() += 1;
            if body.validity() == Validity::Measured {
                counts.valid += 1;
                counts.residuals.note(body.residual_px);
            }
        }
    }

    /// True if all bodies that are tracked, two or more, leave more than a rig that holds.
    fn is_rig_off(&self) -> bool {
        let tracked = || self.bodies.iter().filter(|b| b.valid > 0);
        tracked().count() >= 2 && tracked().all(|b| b.residuals.median_px() > RESIDUAL_PX)
    }

    fn share(&self, body: &BodyCounts) -> f64 {
        ratio(body.valid, self.frames)
    }
}

pub(crate) fn ratio(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::poses::FieldUsed;

    fn frame(n: u64, statuses: [BodyStatus; BODIES], residual_px: f64) -> TrackerFrame {
        let mut frame = TrackerFrame { frame: n, used_count: 3, ..TrackerFrame::zeroed() };
        frame.instants.exposed = 1_000_000_000 + n * 20_000_000;
        for (camera, used) in (0..).zip(&mut frame.used[..3]) {
            *used = FieldUsed { camera, blobs_used: 9, ..FieldUsed::zeroed() };
        }
        for (body, status) in frame.bodies.iter_mut().zip(statuses) {
            let tracked = status == BodyStatus::Tracked;
            body.validity = if tracked { Validity::Measured } else { Validity::Lost } as u32;
            (body.status, body.residual_px) = (status as u32, residual_px);
        }
        frame
    }

    /// Four seconds; fields of the cameras in `silent` do not come.
    fn watched(silent: &[u32], statuses: [BodyStatus; BODIES], residual_px: f64) -> Tracking {
        let mut tracking = Tracking::new(&Rig::load_or_shipped(None).unwrap());
        for n in 0..=200 {
            for camera in (0..3).filter(|c| !silent.contains(c)) {
                let exposed_ns = 1_000_000_000 + n * 20_000_000 + u64::from(camera) * 6_000_000;
                let mut field = BlobField { camera, exposed_ns, ..BlobField::zeroed() };
                (0..10).for_each(|_| field.push(Zeroable::zeroed()));
                tracking.note_field(&field);
            }
            tracking.note_frame(&frame(n, statuses, residual_px));
        }
        tracking
    }

    const ALL_TRACKED: [BodyStatus; BODIES] = [BodyStatus::Tracked; BODIES];

    #[test]
    fn a_good_run_gives_no_finding_and_true_figures() {
        let tracking = watched(&[], ALL_TRACKED, 0.08);
        assert_eq!(tracking.findings(), []);
        assert_eq!(tracking.least_share().1, 1.0);
        let figures = tracking.figures();
        assert!((figures.bodies["eye"].residual_px - 0.085).abs() < 1e-9);
        assert_eq!(
            (figures.frames, figures.cameras[&1].fields, figures.cameras[&1].used_share),
            (201, 201, 0.9)
        );
    }

    #[test]
    fn a_body_whose_marker_is_half_hidden_for_a_while_is_no_finding_but_one_that_stays_so_is() {
        let told = |s: u64| {
            let mut tracking = Tracking::new(&Rig::load_or_shipped(None).unwrap());
            for n in 0..=50 * s {
                let mut frame = frame(n, ALL_TRACKED, 0.08);
                frame.bodies[1].residual_px = 0.9;
                tracking.note_frame(&frame);
            }
            let found = tracking.findings().iter().map(Finding::text);
            found.filter(|text| text.contains("above the noise")).collect::<Vec<String>>()
        };
        assert_eq!(told(10), Vec::<String>::new());
        let long = told(40);
        assert!(long.len() == 1 && long[0].contains("residuals of inst1 are 0.9"), "{long:?}");
    }

    #[test]
    fn a_camera_that_the_tracker_excludes_or_has_resected_is_reported() {
        let told = |left_out, estimated| {
            let mut tracking = Tracking::new(&Rig::load_or_shipped(None).unwrap());
            for n in 0..=100 {
                let (cameras_left_out, cameras_estimated) = (left_out, estimated);
                let frame = frame(n, ALL_TRACKED, 0.08);
                tracking.note_frame(&TrackerFrame { cameras_left_out, cameras_estimated, ..frame });
            }
            tracking.findings().iter().map(Finding::text).collect::<Vec<String>>()[1].clone()
        };
        assert!(told(0b010, 0).contains("camera 1 is excluded"), "{}", told(0b010, 0));
        let estimated = told(0, 0b010);
        assert!(estimated.contains("camera 1 is used with a pose estimated from the others"), "{estimated}");
    }

    #[test]
    fn untracked_bodies_high_residuals_and_silent_cameras_are_told_with_a_remedy() {
        let statuses = [BodyStatus::Tracked, BodyStatus::TooFewMarkers, BodyStatus::Tracked];
        let hidden = watched(&[], statuses, 0.1);
        assert_eq!(hidden.least_share(), ("inst1", 0.0));
        let told: Vec<String> = hidden.findings().iter().map(Finding::text).collect();
        assert!(
            told.len() == 1 && told[0].contains("inst1 was never tracked: its markers are hidden"),
            "{told:?}"
        );
        let loose = watched(&[], ALL_TRACKED, 1.2);
        assert!(
            loose.findings().iter().all(|f| f.text().contains("calibrate waved")),
            "{:?}",
            loose.findings()
        );
        assert_eq!(loose.findings().len(), BODIES);
        let silent = watched(&[1], statuses, 0.1);
        let told: Vec<String> = silent.findings().iter().map(Finding::text).collect();
        assert!(told[0].contains("no fields come from camera 1") && told[1].contains("camera 1"), "{told:?}");
    }
}
