//! Comparing a replay with what was recorded. Two proofs, each with its own counts: this tracker makes the
//! recorded poses of the recorded blobs, and this simulation makes the recorded states of the recorded
//! poses, whichever tracker computed them.

use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, BodyState, EYE, TrackerFrame};
use protocol::steps::StepRecord;
use recording::{Provenance, TRACKER_VERSION, states_incomparable};
use serde::Serialize;
use std::collections::BTreeMap;

/// Both proofs so far.
#[derive(Debug, Default, Serialize)]
pub struct Verdict {
    /// Recorded blobs to poses, by this tracker.
    pub poses: PoseProof,
    /// Recorded poses to states, by this simulation.
    pub states: StateProof,
    /// The first difference between equal versions, in words; it names the field.
    pub difference: Option<String>,
    /// Why not everything was verified; empty where it was.
    pub reasons: Vec<String>,
}

/// Poses.
#[derive(Debug, Default, Serialize)]
pub struct PoseProof {
    /// Tracker frames in the recording.
    pub recorded: u64,
    /// Frames that were compared. Behind a gap they are not, because the tracker remembers what it saw.
    pub compared: u64,
    /// Of them, frames identical to the bit.
    pub identical: u64,
    /// They are a desk's: no tracker made them.
    #[serde(skip)]
    desk: bool,
    /// Version of the recording's tracker where it is not this build's; 0 where it names none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_version: Option<u32>,
    /// By how much poses of another version's tracker differ, by body.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub differences: BTreeMap<&'static str, PoseDifference>,
}

/// Differences of the poses that both trackers measured.
#[derive(Debug, Default, Clone, Serialize)]
#[allow(missing_docs)]
pub struct PoseDifference {
    pub frames: u64,
    /// Frames in which only one of them measured the body.
    pub measured_by_one: u64,
    pub rms_um: f64,
    pub max_um: f64,
    pub rms_mrad: f64,
    pub max_mrad: f64,
}

/// States.
#[derive(Debug, Default, Serialize)]
pub struct StateProof {
    /// Steps in the recording.
    pub recorded: u64,
    /// Steps whose states were compared.
    pub compared: u64,
    /// Of them, states identical to the bit.
    pub identical: u64,
    /// Runs of steps in which those lie: one more than gaps that a checkpoint bridged.
    pub stretches: u64,
    /// Recorded steps whose state the recording does not determine, behind a gap and before the next
    /// checkpoint.
    pub undetermined: u64,
    /// Steps that were made and whose poses or records are missing, by their numbers.
    pub missing: u64,
    /// The last step belongs to a stretch.
    #[serde(skip)]
    in_stretch: bool,
    /// Version of the recording's state hashes where it is not this build's: states are not compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_version: Option<u32>,
}

impl Verdict {
    /// Of a recording, which was made at a desk or with cameras.
    pub fn new(provenance: &Provenance, desk: bool) -> Self {
        let mut verdict = Verdict::default();
        verdict.poses.desk = desk;
        verdict.poses.other_version = provenance.other_tracker_version().filter(|_| !desk);
        verdict.states.other_version = provenance.other_state_hash_version();
        verdict
    }

    fn differs(&mut self, what: String) {
        self.difference = self.difference.take().or(Some(what));
    }

    /// Compares a tracker frame.
    pub fn pose(&mut self, recorded: &TrackerFrame, replayed: &TrackerFrame) {
        self.poses.recorded += 1;
        self.poses.compared += 1;
        let difference = difference_of(recorded, replayed);
        self.poses.identical += u64::from(difference.is_none());
        if self.poses.other_version.is_some() {
            self.poses.measure(recorded, replayed);
        } else if let Some(difference) = difference {
            self.differs(difference);
        }
    }

    /// A recorded frame that the recording does not determine.
    pub fn pass_over_pose(&mut self) {
        self.poses.recorded += 1;
    }

    /// Compares a step, where both hashes are of one version.
    pub fn step(&mut self, recorded: &StepRecord, replayed: &StepRecord) {
        self.states.recorded += 1;
        if self.states.other_version.is_some() {
            return;
        }
        self.states.compared += 1;
        self.states.stretches += u64::from(!std::mem::replace(&mut self.states.in_stretch, true));
        let of = |s: &StepRecord| (s.step, s.field, s.advanced_ns, s.state_hash);
        if of(recorded) == of(replayed) {
            self.states.identical += 1;
            return;
        }
        let say =
            |s: &StepRecord| format!("step {}, state {:016x}, {} ns on", s.step, s.state_hash, s.advanced_ns);
        let (a, b) = (say(recorded), say(replayed));
        self.differs(format!("field {}: recorded {a}; replayed {b}", recorded.field));
    }

    /// Recorded steps whose states are not determined.
    pub fn pass_over_steps(&mut self, count: u64) {
        self.states.recorded += count;
        self.states.undetermined += count;
        self.states.in_stretch &= count == 0;
    }

    /// True where neither proof compared anything.
    pub fn is_empty(&self) -> bool {
        self.poses.compared + self.states.compared == 0
    }

    /// What was compared, and of what.
    pub fn text(&self) -> String {
        if let Some(difference) = &self.difference {
            return format!("verification differs at {difference}\n{}", self.counts());
        }
        let differ = self.poses.identical < self.poses.compared;
        let head = match (self.is_empty(), differ) {
            (true, _) => "nothing verified",
            (false, true) => "compared",
            (false, false) => "verified",
        };
        format!("{head}: {}", self.counts())
    }

    fn counts(&self) -> String {
        format!("{}; {}", self.poses.text(), self.states.text())
    }

    /// Why the proofs do not cover everything that was recorded.
    pub fn left_out(&self) -> Vec<String> {
        let (poses, states) = (&self.poses, &self.states);
        let behind_gaps = poses.recorded - poses.compared;
        let reasons = [
            poses.other_version.map(tracker_differs),
            (poses.recorded == 0).then(|| "no poses were recorded".into()),
            (behind_gaps > 0 && !poses.desk)
                .then(|| format!("{behind_gaps} poses could not be compared: blobs before them are missing")),
            states.other_version.map(states_incomparable),
            (states.recorded == 0).then(|| "no steps were recorded".into()),
            (states.undetermined > 0)
                .then(|| format!("{} steps could not be compared: inputs are missing", states.undetermined)),
            (states.missing > 0).then(|| format!("{} steps are missing, or their poses", states.missing)),
        ];
        reasons.into_iter().flatten().collect()
    }
}

impl PoseProof {
    fn measure(&mut self, recorded: &TrackerFrame, replayed: &TrackerFrame) {
        for ((a, b), name) in recorded.bodies.iter().zip(&replayed.bodies).zip(BODY_NAMES) {
            let difference = self.differences.entry(name).or_default();
            match [a, b].map(|body| body.validity() == Validity::Measured) {
                [true, true] => difference.note(a, b),
                [false, false] => {}
                _ => difference.measured_by_one += 1,
            }
        }
    }

    fn text(&self) -> String {
        let PoseProof { recorded, compared, identical, .. } = self;
        if self.desk {
            return format!("{recorded} poses of a desk or of another tracker, without cameras");
        }
        let Some(version) = self.other_version else {
            return format!(
                "{} from recorded blobs identical",
                counted(*identical, *compared, *recorded, "poses")
            );
        };
        let made_by = tracker_differs(version);
        if identical == compared {
            let counted = counted(*identical, *compared, *recorded, "poses");
            return format!("{made_by}: {counted} from recorded blobs identical");
        }
        let bodies: Vec<String> = self.differences.iter().map(|(name, d)| d.text(name)).collect();
        let differ = bodies.join("; ");
        format!(
            "{made_by}: {compared} of {recorded} poses from recorded blobs compared, they differ by {differ}"
        )
    }
}

impl PoseDifference {
    fn note(&mut self, a: &BodyState, b: &BodyState) {
        let [p, q] = [a, b].map(|body| body.world_from_body.isometry());
        let um = (p.translation.vector - q.translation.vector).norm() * 1e3;
        let mrad = p.rotation.angle_to(&q.rotation) * 1e3;
        let rms = |mean: f64, new: f64, frames: u64| {
            ((mean * mean * frames as f64 + new * new) / (frames + 1) as f64).sqrt()
        };
        (self.rms_um, self.max_um) = (rms(self.rms_um, um, self.frames), self.max_um.max(um));
        (self.rms_mrad, self.max_mrad) = (rms(self.rms_mrad, mrad, self.frames), self.max_mrad.max(mrad));
        self.frames += 1;
    }

    fn text(&self, name: &str) -> String {
        let PoseDifference { frames, measured_by_one, rms_um, max_um, rms_mrad, max_mrad } = self;
        let one = if *measured_by_one == 0 {
            String::new()
        } else {
            format!(" (measured by both in {frames} frames, by one alone in {measured_by_one})")
        };
        // The eye's centre is the origin.
        let place = if name == BODY_NAMES[EYE] {
            String::new()
        } else {
            format!("RMS {rms_um:.2} max {max_um:.2} µm, ")
        };
        format!("{name} {place}RMS {rms_mrad:.3} max {max_mrad:.3} mrad{one}")
    }
}

impl StateProof {
    fn text(&self) -> String {
        let StateProof { recorded, compared, identical, stretches, .. } = self;
        let parts = if *stretches > 1 { format!(", in {stretches} stretches") } else { String::new() };
        if self.other_version.is_some() {
            return format!("0 of {recorded} states compared");
        }
        let counted = counted(*identical, *compared, *recorded, "states");
        format!("{counted} from recorded poses identical{parts}")
    }
}

/// Of how many that were compared how many were identical; where not all could be compared, of how many recorded ones too.
fn counted(identical: u64, compared: u64, recorded: u64, what: &str) -> String {
    match compared == recorded {
        true => format!("{identical} of {recorded} {what}"),
        false => format!("{identical} of {compared} compared {what} ({recorded} recorded)"),
    }
}

/// Says that the recording's tracker is of another version.
fn tracker_differs(version: u32) -> String {
    match version {
        0 => format!("computed by a tracker without a version, this is {TRACKER_VERSION}"),
        version => format!("made by tracker {version}, this is {TRACKER_VERSION}"),
    }
}

/// The first difference of two frames.
fn difference_of(recorded: &TrackerFrame, replayed: &TrackerFrame) -> Option<String> {
    let place = format!("field {} (tracker frame {})", recorded.field, recorded.frame);
    let head = |f: &TrackerFrame| (f.field, f.frame, f.instants.exposed, f.camera);
    if head(recorded) != head(replayed) {
        let (a, b) = (head(recorded), head(replayed));
        return Some(format!("{place}: field, frame, exposure, camera recorded {a:?}, replayed {b:?}"));
    }
    let mut bodies = recorded.bodies.iter().zip(&replayed.bodies).zip(BODY_NAMES);
    let differing = bodies.find(|((a, b), _)| bytemuck::bytes_of(*a) != bytemuck::bytes_of(*b));
    differing.map(|((a, b), name)| format!("{place}: {name}: {}", first_difference(a, b)))
}

/// Names the first part of a body that differs.
pub(crate) fn first_difference(a: &BodyState, b: &BodyState) -> String {
    fn same<T: bytemuck::NoUninit>(a: &T, b: &T) -> bool {
        bytemuck::bytes_of(a) == bytemuck::bytes_of(b)
    }
    let parts = [
        ("pose", same(&a.world_from_body, &b.world_from_body)),
        ("covariance", same(&a.covariance, &b.covariance)),
        ("predictor", same(&a.predictor, &b.predictor)),
        ("residual", same(&a.residual_px, &b.residual_px)),
        ("instant of measurement", a.measured_ns == b.measured_ns),
    ];
    let part = parts.into_iter().find(|(_, same)| !same).map(|(name, _)| name);
    match part {
        Some("pose") => {
            let (p, q) = (a.world_from_body, b.world_from_body);
            format!("pose recorded {p:?}, replayed {q:?}")
        }
        Some(part) => format!("{part} differs"),
        None => {
            let codes = |s: &BodyState| [s.validity, s.status, s.blobs_used, s.cameras_used];
            let (p, q) = (codes(a), codes(b));
            format!("validity, status, blobs, cameras recorded {p:?}, replayed {q:?}")
        }
    }
}

#[cfg(test)]
mod tests;
