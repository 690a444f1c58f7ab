//! Comparing a replay with what was recorded, to the bit.

use protocol::poses::{BODY_NAMES, BodyState, TrackerFrame};
use protocol::steps::StepRecord;
use serde::Serialize;

/// The comparison so far.
#[derive(Debug, Default, Serialize)]
pub struct Verdict {
    /// Tracker frames compared.
    pub poses: u64,
    /// Steps whose states were compared.
    pub steps: u64,
    /// Runs of steps in which they lie: one more than gaps that a checkpoint bridged.
    pub stretches: u64,
    /// Recorded steps whose state the recording does not determine, behind a gap and before the next
    /// checkpoint.
    pub undetermined: u64,
    /// Steps that were made and whose poses or records are missing, by their numbers.
    pub missing: u64,
    /// Tracker frames behind the first gap: the tracker remembers what it saw.
    pub poses_undetermined: u64,
    /// The last step belongs to a stretch.
    #[serde(skip)]
    pub(super) in_stretch: bool,
    /// Version of the recording's state hashes where it is not this build's: states are not
    /// compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_state_hash_version: Option<u32>,
    /// The first difference, in words; it names the field.
    pub difference: Option<String>,
}

impl Verdict {
    fn differs(&mut self, what: String) {
        self.difference = self.difference.take().or(Some(what));
    }

    /// Compares a tracker frame.
    pub fn pose(&mut self, recorded: &TrackerFrame, replayed: &TrackerFrame) {
        self.poses += 1;
        let place = format!("field {} (tracker frame {})", recorded.field, recorded.frame);
        let head = |f: &TrackerFrame| (f.field, f.frame, f.instants.exposed, f.camera);
        if head(recorded) != head(replayed) {
            let (a, b) = (head(recorded), head(replayed));
            self.differs(format!("{place}: field, frame, exposure, camera recorded {a:?}, replayed {b:?}"));
        }
        for ((a, b), name) in recorded.bodies.iter().zip(&replayed.bodies).zip(BODY_NAMES) {
            if bytemuck::bytes_of(a) != bytemuck::bytes_of(b) {
                self.differs(format!("{place}: {name}: {}", first_difference(a, b)));
            }
        }
    }

    /// Compares a step; its state only where both hashes are of one version.
    pub fn step(&mut self, recorded: &StepRecord, replayed: &StepRecord) {
        let comparable = self.other_state_hash_version.is_none();
        self.steps += u64::from(comparable);
        self.stretches += u64::from(!std::mem::replace(&mut self.in_stretch, true));
        let of = |s: &StepRecord| (s.step, s.field, s.advanced_ns, if comparable { s.state_hash } else { 0 });
        if of(recorded) != of(replayed) {
            let say = |s: &StepRecord| {
                format!("step {}, state {:016x}, {} ns on", s.step, s.state_hash, s.advanced_ns)
            };
            let (a, b) = (say(recorded), say(replayed));
            self.differs(format!("field {}: recorded {a}; replayed {b}", recorded.field));
        }
    }

    /// A recorded step whose state is not determined.
    pub fn pass_over(&mut self) {
        self.undetermined += 1;
        self.in_stretch = false;
    }

    /// What could not be compared; empty where everything was.
    pub fn left_out(&self) -> String {
        let Verdict { stretches, undetermined, missing, poses_undetermined, .. } = self;
        if undetermined + missing + poses_undetermined == 0 {
            return String::new();
        }
        format!(
            "; in {stretches} stretches: {undetermined} steps and {poses_undetermined} poses behind gaps \
             could not be verified, {missing} steps lack their poses or their record"
        )
    }
}

/// Names the first part of a body that differs.
fn first_difference(a: &BodyState, b: &BodyState) -> String {
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
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn the_first_difference_names_its_field() {
        let mut verdict = Verdict::default();
        let mut recorded = TrackerFrame::zeroed();
        recorded.field = 41;
        verdict.pose(&recorded, &recorded.clone());
        assert_eq!((verdict.poses, &verdict.difference), (1, &None));
        let mut other = recorded;
        other.bodies[1].predictor.velocity_mm_s[2] = -0.0;
        verdict.pose(&recorded, &other);
        let text = verdict.difference.clone().unwrap();
        assert!(text.contains("field 41") && text.contains("inst1") && text.contains("predictor"), "{text}");
        let step = StepRecord { field: 42, ..StepRecord::zeroed() };
        verdict.step(&step, &StepRecord { state_hash: 1, ..step });
        assert_eq!(verdict.difference.as_ref(), Some(&text), "the first one stays");
    }

    #[test]
    fn stretches_are_runs_of_steps_that_could_be_compared() {
        let mut verdict = Verdict::default();
        let step = StepRecord { field: 42, ..StepRecord::zeroed() };
        assert_eq!(verdict.left_out(), "");
        verdict.step(&step, &step);
        verdict.step(&step, &step);
        verdict.pass_over();
        verdict.pass_over();
        verdict.step(&step, &step);
        assert_eq!((verdict.steps, verdict.stretches, verdict.undetermined), (3, 2, 2));
        assert!(verdict.left_out().contains("in 2 stretches: 2 steps"));
    }

    #[test]
    fn hashes_are_compared_and_timing_is_not() {
        let mut verdict = Verdict::default();
        let step = StepRecord { field: 42, step: 3, ..StepRecord::zeroed() };
        let mut slower = step;
        (slower.instants.stepped, slower.profile.tissue_ns) = (99, 7);
        verdict.step(&step, &slower);
        assert_eq!(verdict.difference, None);
        let other = StepRecord { state_hash: 1, ..step };
        let mut incomparable = Verdict { other_state_hash_version: Some(7), ..Verdict::default() };
        incomparable.step(&step, &other);
        assert_eq!((incomparable.steps, &incomparable.difference), (0, &None));
        incomparable.step(&step, &StepRecord { advanced_ns: 1, ..other });
        assert!(incomparable.difference.is_some(), "the time is compared all the same");
        verdict.step(&step, &other);
        assert!(verdict.difference.unwrap().contains("field 42"));
    }
}
