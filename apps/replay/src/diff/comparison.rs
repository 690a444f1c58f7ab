//! All that a comparison finds: the stages in causal order, where each first differs, and why.

use super::causes::{Cause, Confidence, Finding, seconds};
use super::events::EventFigures;
use super::inputs::{FieldPairs, FirstInput, InputFigures};
use super::outcome::{LatencyFigures, ScoreFigures};
use super::poses::{FramePair, PoseFigures};
use super::provenance::{KeyDifference, Part};
use super::side::{Side, StepSeen};
use super::{events, from_inputs, from_provenance, inputs, outcome, poses, provenance};
use crate::verify::first_difference;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use recording::{Item, Recording, STATE_HASH, TRACKER};
use serde::Serialize;
use std::path::Path;

/// A stage of the path from the inputs to what comes of them, in causal order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum StageName {
    Inputs,
    Rig,
    Scene,
    Settings,
    Poses,
    States,
    Events,
}

/// Where a stage first differs.
#[derive(Debug, Clone, Serialize)]
pub struct StageDifference {
    /// The stage.
    pub stage: StageName,
    /// When, s from the start of the first recording; none for what holds from the start.
    pub at_s: Option<f64>,
    /// Field there.
    pub field: Option<u64>,
    /// The entry that differs, and how.
    pub entry: String,
}

impl StageDifference {
    /// Name of the stage.
    pub fn name(&self) -> String {
        format!("{:?}", self.stage).to_lowercase()
    }
}

/// Steps.
#[derive(Debug, Default, Serialize)]
pub struct StateFigures {
    /// Steps of one field in both recordings.
    pub compared: u64,
    /// Of them, states of the same hash.
    pub identical: u64,
    /// Why they are not compared.
    pub incomparable: Option<String>,
}

/// Two recordings, compared.
#[derive(Debug, Serialize)]
pub struct Comparison {
    /// The first file.
    pub a: String,
    /// The second file.
    pub b: String,
    /// Tolerance, µm.
    pub tolerance_um: f64,
    /// Nothing differs by more than that.
    pub same: bool,
    /// Every stage that differs, in causal order: the first of them is where it begins.
    pub stages: Vec<StageDifference>,
    /// Why.
    pub causes: Vec<Finding>,
    /// Keys of the provenance whose values differ.
    pub provenance: Vec<KeyDifference>,
    /// What each of the recordings lacks by its own account.
    pub losses: [Vec<String>; 2],
    /// Inputs.
    pub inputs: InputFigures,
    /// Poses.
    pub poses: PoseFigures,
    /// States.
    pub states: StateFigures,
    /// Events.
    pub events: EventFigures,
    /// Scores, where both have a task.
    pub score: Option<ScoreFigures>,
    /// Latencies.
    pub latencies: Vec<LatencyFigures>,
    /// Frames of both, for plots.
    #[serde(skip)]
    pub frames: Vec<FramePair>,
    /// First exposure of the first recording, ns.
    #[serde(skip)]
    pub start_ns: u64,
    /// Camera-fields, paired.
    #[serde(skip)]
    pub fields: FieldPairs,
}

/// Where each stage differs first.
struct Firsts<'a> {
    input: Option<FirstInput>,
    keys: &'a [KeyDifference],
    frames: &'a [FramePair],
    /// Frames that are in one recording only.
    alone: u64,
    state: Option<StepSeen>,
    events: &'a EventFigures,
}

impl Firsts<'_> {
    /// The stages that differ, in the order of the data path.
    fn stages(self, a: &Side, b: &Side) -> Vec<StageDifference> {
        let at = |ns: u64| Some(seconds(a.start_ns(), ns));
        let differs = |stage, at_s, field, entry| StageDifference { stage, at_s, field, entry };
        let input = self.input.map(|f| differs(StageName::Inputs, at(f.at_ns), Some(f.field), f.what));
        let parts = [
            (StageName::Rig, Part::Rig),
            (StageName::Scene, Part::Scene),
            (StageName::Settings, Part::Config),
        ];
        let keys = parts.into_iter().filter_map(|(name, part)| {
            let key = self.keys.iter().find(|key| key.part == part && is_result(key))?;
            Some(differs(name, None, None, key.key.clone()))
        });
        let alone = (self.alone > 0).then(|| {
            let entry = format!("presence: {} frames are in one recording only", self.alone);
            differs(StageName::Poses, None, None, entry)
        });
        let pair = self.frames.iter().find(|pair| pair.a.digest != pair.b.digest);
        let pose = pair.map(|pair| {
            let (at_s, field) = (at(pair.a.exposed_ns), Some(pair.a.field));
            differs(StageName::Poses, at_s, field, name_entry(a, b, pair))
        });
        let state = self.state.map(|step| {
            let exposed = a.frames.iter().find(|f| f.field == step.field).map(|f| f.exposed_ns);
            let entry = format!("state_hash of step {}", step.step);
            differs(StageName::States, exposed.and_then(at), Some(step.field), entry)
        });
        let event = self.events.first.as_ref();
        let event =
            event.map(|f| differs(StageName::Events, at(f.exposed_ns), Some(f.field), f.what.clone()));
        let of_results = [pose.or(alone), state, event].into_iter().flatten();
        input.into_iter().chain(keys).chain(of_results).collect()
    }
}

impl Comparison {
    /// Compares two recordings, and finds the causes of what differs.
    pub fn of(a: &Side, b: &Side, tolerance_um: f64) -> Self {
        let mut comparison = Self::recorded(a, b, tolerance_um);
        comparison.find_causes(a, b, &|| ());
        comparison
    }

    /// Compares what was recorded; no cause is named yet.
    pub fn recorded(a: &Side, b: &Side, tolerance_um: f64) -> Self {
        let fields = inputs::pair_fields(a, b);
        let (input_figures, first_input) = inputs::compare(a, b, &fields);
        let keys = provenance::compare(a, b);
        let (frames, alone) = poses::pair_frames(a, b, &fields);
        let pose_figures = poses::compare(&frames, alone, a.start_ns(), a.period_ns());
        let (state_figures, first_state) = compare_states(a, b, &fields);
        let event_figures = events::compare(a, b, fields.number_offset);
        let firsts = Firsts {
            input: first_input,
            keys: &keys,
            frames: &frames,
            alone,
            state: first_state,
            events: &event_figures,
        };
        let stages = firsts.stages(a, b);
        let mut comparison = Comparison {
            a: a.file.display().to_string(),
            b: b.file.display().to_string(),
            tolerance_um,
            same: true,
            stages,
            causes: Vec::new(),
            provenance: keys,
            losses: [a.losses.clone(), b.losses.clone()],
            inputs: input_figures,
            poses: pose_figures,
            states: state_figures,
            events: event_figures,
            score: outcome::scores(a, b),
            latencies: outcome::latencies(a, b),
            frames,
            start_ns: a.start_ns(),
            fields,
        };
        comparison.same = comparison.is_same();
        comparison
    }

    /// With a tolerance, by poses and events alone: small differences of the inputs and of the states are
    /// what it forgives.
    fn is_same(&self) -> bool {
        if self.tolerance_um == 0.0 {
            return self.stages.is_empty();
        }
        let close = |body: &poses::BodyFigures| body.max_um <= self.tolerance_um && body.measured_by_one == 0;
        self.poses.bodies.iter().all(close) && self.poses.frames_missing == 0 && self.events.unpaired == 0
    }

    /// Finds every cause, in causal order; what is left without one is said to be unexplained. `step` is called for
    /// each step of the search.
    pub fn find_causes(&mut self, a: &Side, b: &Side, step: &dyn Fn()) {
        let (differ, fields) = (self.inputs.blobs_differ + self.inputs.stamps_differ > 0, &self.fields);
        let of_blobs = if differ { from_inputs::of_blobs(a, b, fields, step) } else { Vec::new() };
        let exchanged = of_blobs.iter().find_map(|finding| match finding.cause {
            Cause::CamerasSwapped { cameras } => Some(cameras),
            _ => None,
        });
        let mut found = from_inputs::missing(a, b, fields, exchanged);
        found.extend(of_blobs);
        found.extend(from_provenance::findings(a, b, &self.provenance));
        found.extend(self.without_cause(a, &found));
        self.causes = found;
    }

    fn stage(&self, name: StageName) -> Option<&StageDifference> {
        self.stages.iter().find(|stage| stage.stage == name)
    }

    /// What nothing upstream explains: poses that differ before any input does, with the same rig and
    /// settings, and states that differ though all before them is the same.
    fn without_cause(&self, a: &Side, found: &[Finding]) -> Vec<Finding> {
        let mut left = Vec::new();
        let upstream = [StageName::Rig, StageName::Settings].iter().any(|stage| self.stage(*stage).is_some());
        let input_s = self.stage(StageName::Inputs).map(|stage| stage.at_s.unwrap_or(0.0));
        let differing = self.poses.identical < self.poses.frames_compared;
        if let Some(poses) = self.stage(StageName::Poses).filter(|_| differing) {
            // A frame is for the exposure of one camera; those of the others lie up to a period beside it.
            let slack_s = 2.0 * a.period_ns() as f64 * 1e-9;
            let before_inputs = input_s.is_none_or(|at| poses.at_s.unwrap_or(0.0) < at - slack_s);
            if a.is_desk() && a.fields.is_empty() {
                let cause = Cause::OtherMotion { rms_px: 0.0 };
                left.push(Finding::new(
                    cause,
                    Confidence::Possible,
                    "poses of a desk, which come from a person's hands",
                ));
            } else if before_inputs && !upstream {
                left.push(self.by_version(
                    TRACKER,
                    "poses differ, and their blobs and rig do not",
                    &poses.entry,
                ));
            }
        }
        let no_cause = found.is_empty() && left.is_empty();
        if let (Some(states), None, true) =
            (self.stage(StageName::States), self.stage(StageName::Poses), no_cause)
        {
            left.push(self.by_version(
                STATE_HASH,
                "states differ, and poses, handles, pedal and scene do not",
                &states.entry,
            ));
        } else if let (Some(events), true, true) = (self.stage(StageName::Events), no_cause, left.is_empty())
        {
            left.push(self.by_version(
                "vitreo",
                "events differ, and what they come of does not",
                &events.entry,
            ));
        }
        left
    }

    /// The version that may be the cause, or that there is none.
    fn by_version(&self, program: &str, evidence: &str, entry: &str) -> Finding {
        let of = |program| from_provenance::version(&self.provenance, program);
        match of(program) {
            Some(cause) => Finding::new(cause, Confidence::Likely, evidence),
            None => match of("vitreo") {
                Some(cause) => Finding::new(cause, Confidence::Possible, evidence),
                None => {
                    Finding::new(Cause::Unexplained { what: entry.into() }, Confidence::Possible, evidence)
                }
            },
        }
    }
}

/// Whether a result depends on a key: not what a run was called, where it wrote, or how long it lasted.
fn is_result(key: &KeyDifference) -> bool {
    key.part != Part::Config || key.key.starts_with("tracker.")
}

/// Compares the hashes of steps of one field.
fn compare_states(a: &Side, b: &Side, fields: &FieldPairs) -> (StateFigures, Option<StepSeen>) {
    let mut figures = StateFigures::default();
    let versions = [a, b].map(|side| side.provenance.versions.get(STATE_HASH));
    // This build knows which versions hash such a scene alike.
    let known = [a, b].iter().all(|side| side.provenance.other_state_hash_version().is_none());
    if versions[0] != versions[1] && !known {
        let version = |v: Option<&String>| v.cloned().unwrap_or_else(|| "1".into());
        let [p, q] = versions.map(version);
        figures.incomparable = Some(format!("hashes are of versions {p} and {q}"));
        return (figures, None);
    }
    let of_b: std::collections::HashMap<u64, &StepSeen> = b.steps.iter().map(|s| (s.field, s)).collect();
    let mut first = None;
    for step in &a.steps {
        let Some(other) = of_b.get(&step.field.wrapping_add_signed(fields.number_offset)) else { continue };
        figures.compared += 1;
        figures.identical += u64::from(step.state_hash == other.state_hash);
        if step.state_hash != other.state_hash && first.is_none() {
            first = Some(*step);
        }
    }
    (figures, first)
}

/// Names the first entry that differs in two frames, by reading them again.
fn name_entry(a: &Side, b: &Side, pair: &FramePair) -> String {
    let (Some(p), Some(q)) = (
        frame_of(&a.file, pair.a.field, pair.a.exposed_ns),
        frame_of(&b.file, pair.b.field, pair.b.exposed_ns),
    ) else {
        return "bodies".into();
    };
    let mut bodies = p.bodies.iter().zip(&q.bodies).zip(BODY_NAMES);
    let found = bodies.find(|((p, q), _)| {
        let same = |p: &protocol::poses::BodyState| protocol::poses::BodyState { measured_ns: 0, ..*p };
        bytemuck::bytes_of(&same(p)) != bytemuck::bytes_of(&same(q))
    });
    let part = |p, q| first_difference(p, q).split(" recorded").next().unwrap_or_default().to_owned();
    found.map_or("bodies".into(), |((p, q), name)| format!("bodies.{name}.{}", part(p, q)))
}

fn frame_of(file: &Path, field: u64, exposed_ns: u64) -> Option<Box<TrackerFrame>> {
    let items = Recording::open(file).ok()?.items_of(&["poses"]);
    items.filter_map(Result::ok).find_map(|(_, item)| match item {
        Item::Poses(frame) if frame.field == field && frame.instants.exposed == exposed_ns => Some(frame),
        _ => None,
    })
}
