//! What the commands say of streams with planted defects, seed by seed: `make judge`.

use crate::planted::{Defect, Planted, is_truth, plant_on, whole_rig};
use crate::streams::Scenario;
use calibration::bundle::PriorSigmas;
use calibration::causes::{Cause, Judgement, Verdict, Work, judge, judge_within};
use calibration::drift_check;
use calibration::mend::{Mended, mend};
use calibration::observations::collect;
use calibration::rig_view::Viewer;
use calibration::self_calibration::spread;
use rig::Rig;
use rig::sensor::Scan;

/// Length of a stream, s.
const SECONDS: f64 = 4.0;
/// Seeds from here on have the kinds of defects that were added later, too.
const LATER: u64 = 30_000;
/// Seeds from here on have strong tremor and everything that makes tracking hard, too.
const ALL_SCENARIOS: u64 = 40_000;
/// Instants that `drift` and `waved` use.
const INSTANTS: usize = 200;

/// What the commands report of a stream.
pub struct Said {
    /// Seed.
    pub seed: u64,
    /// On a rig of its own.
    pub whole: bool,
    /// What was planted.
    pub defect: Defect,
    /// The same in words.
    pub truth: String,
    /// What the judge says.
    pub judgement: Judgement,
    /// True if the planted cause is named, or nothing is where nothing was planted.
    pub right: bool,
    /// True if `rig check`, which sees the rig file alone, finds anything.
    pub rig_check_reports: bool,
    /// True if `drift` says that the rig holds; `pivot` refuses unless the judgement says so.
    pub drift_holds: bool,
    /// What `waved` does: the residuals of held-out instants before and after, px, or why nothing is written.
    pub waved: Result<[f64; 2], String>,
    /// True if `replay` says nothing at its end.
    pub replay_is_silent: bool,
}

impl Said {
    /// One explanation alone was given, and it is wrong or names a part of what is wrong.
    pub fn is_blamed_wrongly(&self) -> bool {
        self.judgement.verdict == Verdict::Explained && !self.right && self.judgement.explanations.len() == 1
    }

    /// Something is wrong, and the verdict is that the rig holds.
    pub fn holds_wrongly(&self) -> bool {
        self.defect != Defect::None && self.drift_holds
    }

    /// Nothing is wrong, and the verdict is that something is.
    pub fn is_false_alarm(&self) -> bool {
        self.defect == Defect::None && !self.drift_holds
    }
}

/// Draws the stream of a seed; what is planted follows from the seed, and is nothing where the rig is to be intact.
pub fn draw(seed: u64, whole: bool, intact: bool) -> (Defect, Planted) {
    let rig = if whole { whole_rig(seed) } else { Rig::load_or_shipped(None).expect("the shipped rig") };
    let interlaced = rig.sensors().iter().all(|s| s.scan != Scan::Progressive);
    // Whole pictures have no parity, and are not taken for halves.
    let needs_fields = |d: &Defect| matches!(d, Defect::ParitySwapped | Defect::Progressive);
    let more = if seed < LATER { &[][..] } else { &Defect::MORE };
    let all = Defect::ALL.into_iter().chain(more.iter().copied());
    let kinds: Vec<Defect> = all.filter(|d| interlaced || !needs_fields(d)).collect();
    let defect = if intact { Defect::None } else { kinds[(seed as usize) % kinds.len()] };
    (defect, plant_on(rig, defect, scenario(seed), seed, SECONDS, 0.0))
}

/// Cameras of one block of seeds in four are free-running; of later seeds, those with tremor and the hard ones as well.
fn scenario(seed: u64) -> Scenario {
    match (seed / 16) % 4 {
        0 => Scenario::Async,
        1 if seed >= ALL_SCENARIOS => Scenario::Tremor,
        2 if seed >= ALL_SCENARIOS => Scenario::Hard,
        _ => Scenario::Nominal,
    }
}

/// Draws a stream of the rig file of which a lens is wrong; which one, and how, follows from the seed.
pub fn draw_lens(seed: u64, whole: bool) -> (Defect, Planted) {
    let rig = if whole { whole_rig(seed) } else { Rig::load_or_shipped(None).expect("the shipped rig") };
    let defect = Defect::LENSES[(seed as usize) % Defect::LENSES.len()];
    (defect, plant_on(rig, defect, scenario(seed), seed, SECONDS, 0.0))
}

/// All verdicts on the stream of a seed.
pub fn said(seed: u64, whole: bool, intact: bool) -> Said {
    said_of(seed, whole, draw(seed, whole, intact))
}

/// The same of a stream that was drawn.
pub fn said_of(seed: u64, whole: bool, (defect, planted): (Defect, Planted)) -> Said {
    let Planted { rig, fields, truth, .. } = planted;
    let judgement = judge(&rig, &fields, |_, _| true);
    let named = |cause: &Cause| judgement.explanations.iter().any(|e| is_truth(&e.cause, cause));
    let right = truth.as_ref().map_or(judgement.verdict == Verdict::NothingWrong, named);
    let rig_check_reports =
        tracker::rig_check::check(&rig).is_err() || !Viewer::new(&rig).view().missing.is_empty();
    let seen = spread(collect(&rig, &fields), INSTANTS);
    let checked = drift_check::check(&rig, &seen, calibration::cli::LIMIT_PX);
    let drift_holds = judgement.holds && checked.is_ok_and(|c| !c.drifted());
    let waved = match mend(&rig, &fields, &PriorSigmas::default(), &judgement, INSTANTS, &mut |_, _| {}) {
        Ok(Mended::Better { held_out_px, .. }) => Ok(held_out_px),
        Ok(Mended::Nothing(why)) => Err(why),
        Err(problem) => Err(problem.to_string()),
    };
    let replay_is_silent = judge_within(&rig, &fields, &Work::AT_END, |_, _| true).paragraph(0.0).is_none();
    let truth = truth.map_or("nothing".into(), |c| c.to_string());
    Said {
        seed,
        whole,
        defect,
        truth,
        judgement,
        right,
        rig_check_reports,
        drift_holds,
        waved,
        replay_is_silent,
    }
}
