//! Latency histograms of every stage, compared with the latency budgets. Pure.
//!
//! A latency belongs to the run if its field was exposed while the run was warm. Fields exposed before that,
//! until one second after the start or after a restart of a process, are counted as warm-up and excluded from
//! all percentiles.

use super::load::Judged;
use hdrhistogram::Histogram;
use protocol::budget::{Budget, Budgets, Stage, frame_latencies, pose_latencies, step_latencies};
use protocol::frames::{BELOW_FLOOR, FrameRecord, PICTURE_HELD};
use protocol::poses::TrackerFrame;
use protocol::steps::{StepProfile, StepRecord};
use protocol::time::Nanos;
use serde::Serialize;

/// Time after a start or restart in which latencies are not counted, ns.
pub const WARM_UP_NS: u64 = 1_000_000_000;
/// Range of the histograms, ns; latencies outside are counted at the nearest end.
const RANGE_NS: (u64, u64) = (100, 100_000_000_000);
/// Significant decimal digits of the histograms.
const DIGITS: u8 = 3;

/// A histogram of durations, with the field of the longest duration.
#[derive(Debug)]
pub struct Durations {
    histogram: Histogram<u64>,
    sum_ns: u64,
    /// The longest duration, ns, and its field number.
    worst: Option<(u64, u64)>,
}

impl Default for Durations {
    fn default() -> Self {
        let histogram = Histogram::new_with_bounds(RANGE_NS.0, RANGE_NS.1, DIGITS);
        let mut histogram = histogram.expect("the bounds are in order");
        // Touches all pages of the histogram, so that rare durations do not raise the memory use of a long
        // run.
        histogram.reset();
        Durations { histogram, sum_ns: 0, worst: None }
    }
}

impl Durations {
    /// Adds a duration, ns, of a field.
    pub fn note(&mut self, ns: u64, field: u64) {
        self.histogram.saturating_record(ns);
        self.sum_ns = self.sum_ns.saturating_add(ns);
        if self.worst.is_none_or(|(worst_ns, _)| ns > worst_ns) {
            self.worst = Some((ns, field));
        }
    }

    /// Number of durations.
    pub fn count(&self) -> u64 {
        self.histogram.len()
    }

    /// Duration at a percentile (0 to 100), ms; 0 if there are no durations.
    pub fn at_ms(&self, percentile: f64) -> f64 {
        if self.count() == 0 {
            return 0.0;
        }
        // The upper edge of a bucket may be a thousandth above the longest duration in it.
        let edge_ns = self.histogram.value_at_percentile(percentile);
        edge_ns.min(self.worst.map_or(u64::MAX, |(ns, _)| ns)) as f64 * 1e-6
    }

    /// The union of two histograms.
    pub fn with(&self, others: &Durations) -> Self {
        let mut all = Durations::default();
        for one in [self, others] {
            all.histogram.add(&one.histogram).expect("the same bounds");
            all.sum_ns = all.sum_ns.saturating_add(one.sum_ns);
        }
        all.worst = self.worst.max(others.worst);
        all
    }

    /// Number of durations up to `ns`, to the histogram's three digits.
    pub fn up_to(&self, ns: u64) -> u64 {
        self.histogram.count_between(0, ns)
    }

    /// Arithmetic mean, ms; 0 if there are no durations.
    pub fn mean_ms(&self) -> f64 {
        self.sum_ns as f64 * 1e-6 / self.count().max(1) as f64
    }

    /// Number of durations longer than `limit_ms`, to the histogram's three digits.
    fn above(&self, limit_ms: f64) -> u64 {
        self.count() - self.histogram.count_between(0, (limit_ms * 1e6) as u64)
    }
}

/// Histograms for the paper's Table 4, one per line of the table.
#[derive(Debug, Default)]
pub struct PaperPhases {
    /// Collision detection of steps that ended with an instrument in contact with tissue.
    pub contact: Durations,
    /// Collision detection of all other steps.
    pub no_contact: Durations,
    /// Tissue simulation: membrane and retina.
    pub tissue: Durations,
    /// The rest of the simulation step.
    pub misc: Durations,
    /// Upload of the tissue's geometry to the graphics device, by the host's clock.
    pub transfer: Durations,
    /// From the start of a frame until it is drawn, without the upload.
    pub drawing: Durations,
}

impl PaperPhases {
    fn note_step(&mut self, step: &StepRecord) {
        let [collision, tissue, misc] = step.profile.paper_phases_ns();
        let contact = if step.contacts > 0 { &mut self.contact } else { &mut self.no_contact };
        contact.note(collision, step.field);
        self.tissue.note(tissue, step.field);
        self.misc.note(misc, step.field);
    }

    fn note_frame(&mut self, frame: &FrameRecord) {
        if frame.transfer_ns > 0 {
            self.transfer.note(frame.transfer_ns, frame.field);
        }
        let [(_, rendering), _] = frame_latencies(frame);
        if let Some(ns) = rendering {
            self.drawing.note(ns.saturating_sub(frame.transfer_ns), frame.field);
        }
    }
}

/// All latency histograms of a run.
#[derive(Debug, Default)]
pub struct LatencyStats {
    stages: [Durations; Stage::ALL.len()],
    /// Phases of the simulation step, in the order of [`StepProfile::PHASES`].
    pub phases: [Durations; StepProfile::PHASES.len()],
    /// Histograms for the paper's Table 4.
    pub paper: PaperPhases,
    /// Number of fields, steps and frames excluded as warm-up.
    pub warm_up: u64,
    warm_from_ns: Option<Nanos>,
    /// Number of frames drawn at a quality tier too low for training.
    below_floor: u64,
}

impl LatencyStats {
    /// Stops counting, until [`LatencyStats::warm_from`] is called.
    pub fn cool(&mut self) {
        self.warm_from_ns = None;
    }

    /// Counts fields exposed at `instant_ns` or later.
    pub fn warm_from(&mut self, instant_ns: Nanos) {
        self.warm_from_ns = Some(instant_ns);
    }

    /// The histogram of a stage.
    pub fn stage(&self, stage: Stage) -> &Durations {
        &self.stages[stage as usize]
    }

    fn is_warm(&mut self, exposed: Nanos) -> bool {
        let warm = self.warm_from_ns.is_some_and(|from| exposed >= from);
        self.warm_up += u64::from(!warm);
        warm
    }

    /// Adds the latencies of a tracker frame.
    pub fn note_pose(&mut self, frame: &TrackerFrame) {
        if self.is_warm(frame.instants.exposed) {
            self.note_all(&pose_latencies(frame), frame.field);
        }
    }

    /// Adds the latencies of a simulation step.
    pub fn note_step(&mut self, step: &StepRecord) {
        if !self.is_warm(step.instants.exposed) {
            return;
        }
        self.note_all(&step_latencies(step), step.field);
        for (phase, ns) in self.phases.iter_mut().zip(step.profile.phases_ns()) {
            phase.note(ns, step.field);
        }
        self.paper.note_step(step);
    }

    /// Adds the latencies of a displayed frame.
    pub fn note_frame(&mut self, frame: &FrameRecord) {
        // A held picture is marked as held; its age is not a latency of the data path.
        let held = frame.flags & PICTURE_HELD != 0;
        if self.is_warm(frame.instants.exposed) && !held {
            self.note_all(&frame_latencies(frame), frame.field);
            self.paper.note_frame(frame);
            self.below_floor += u64::from(frame.flags & BELOW_FLOOR != 0);
        }
    }

    fn note_all(&mut self, latencies: &[(Stage, Option<u64>)], field: u64) {
        for &(stage, latency) in latencies {
            if let Some(ns) = latency {
                self.stages[stage as usize].note(ns, field);
            }
        }
    }

    /// Figures of every stage, compared with its budget.
    pub fn judge(&self, budgets: &Budgets) -> Vec<StageFigures> {
        let mut all: Vec<_> = Stage::ALL.into_iter().map(|s| figures(s, self.stage(s), budgets)).collect();
        let drawn = &mut all[Stage::Rendering as usize];
        drawn.below_floor = self.below_floor;
        // As with latencies, a share of 1 − percentile of the frames may be bad.
        let allowed = (1.0 - 0.01 * budgets.percentile) * drawn.count as f64;
        if drawn.budget_ms > 0.0 && self.below_floor as f64 > allowed {
            (drawn.verdict, drawn.broken) = (Verdict::Broken, true);
        }
        all
    }
}

/// Verdict on a stage's budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// All figures are within the budget.
    Kept,
    /// A figure exceeds the budget.
    Broken,
    /// The stage has no budget.
    NotAsserted,
    /// The stage did not run.
    NoSamples,
}

impl Verdict {
    /// Verdict as text.
    pub fn text(self) -> &'static str {
        match self {
            Verdict::Kept => "met",
            Verdict::Broken => "EXCEEDED",
            Verdict::NotAsserted => "not asserted",
            Verdict::NoSamples => "no samples",
        }
    }
}

/// A line of the latency table; durations in ms.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct StageFigures {
    pub stage: Stage,
    pub span: &'static str,
    pub count: u64,
    pub mean_ms: f64,
    pub p50_ms: f64,
    pub p95_ms: f64,
    pub p99_ms: f64,
    pub p999_ms: f64,
    pub max_ms: f64,
    /// Field number of the longest duration.
    pub worst_field: Option<u64>,
    /// Percentile that is compared with the budget.
    pub percentile: f64,
    /// Duration at that percentile, ms.
    pub judged_ms: f64,
    /// Budget at that percentile, ms; 0 if there is none.
    pub budget_ms: f64,
    /// Budget of the mean, ms; 0 if there is none.
    pub mean_budget_ms: f64,
    /// Number of durations above `budget_ms`.
    pub violations: u64,
    /// For rendering: number of frames drawn at a quality tier too low for training.
    pub below_floor: u64,
    pub verdict: Verdict,
    pub broken: bool,
}

fn figures(stage: Stage, durations: &Durations, budgets: &Budgets) -> StageFigures {
    let Budget { limit_ms, mean_ms: mean_limit_ms, .. } = budgets.of(stage);
    let (judged_ms, mean_ms) = (durations.at_ms(budgets.percentile), durations.mean_ms());
    let over = |figure: f64, limit: f64| limit > 0.0 && figure > limit;
    let verdict = match durations.count() {
        0 => Verdict::NoSamples,
        _ if over(judged_ms, limit_ms) || over(mean_ms, mean_limit_ms) => Verdict::Broken,
        _ if limit_ms <= 0.0 && mean_limit_ms <= 0.0 => Verdict::NotAsserted,
        _ => Verdict::Kept,
    };
    StageFigures {
        stage,
        span: stage.span(),
        count: durations.count(),
        mean_ms,
        p50_ms: durations.at_ms(50.0),
        p95_ms: durations.at_ms(95.0),
        p99_ms: durations.at_ms(99.0),
        p999_ms: durations.at_ms(99.9),
        max_ms: durations.worst.map_or(0.0, |(ns, _)| ns as f64 * 1e-6),
        worst_field: durations.worst.map(|(_, field)| field),
        percentile: budgets.percentile,
        judged_ms,
        budget_ms: limit_ms,
        mean_budget_ms: mean_limit_ms,
        violations: if limit_ms > 0.0 { durations.above(limit_ms) } else { 0 },
        below_floor: 0,
        verdict,
        broken: verdict == Verdict::Broken,
    }
}

impl StageFigures {
    /// True if the stage ran and has a budget.
    pub fn is_judged(&self) -> bool {
        matches!(self.verdict, Verdict::Kept | Verdict::Broken)
    }

    /// The figures that are compared with the budgets.
    pub fn judged(&self) -> Judged {
        Judged {
            times_ms: [[self.judged_ms, self.budget_ms], [self.mean_ms, self.mean_budget_ms]],
            below_floor: self.below_floor,
            count: self.count,
        }
    }

    /// The exceeded budgets with the excess, and the field of the longest duration, as text.
    pub fn blame(&self) -> String {
        let stage = self.stage.name();
        let mut broken = Vec::new();
        if self.budget_ms > 0.0 && self.judged_ms > self.budget_ms {
            broken.push(format!(
                "p{} is {:.2} ms, budget {:.2} ms, {} of {} over it",
                self.percentile, self.judged_ms, self.budget_ms, self.violations, self.count
            ));
        }
        if self.mean_budget_ms > 0.0 && self.mean_ms > self.mean_budget_ms {
            broken.push(format!("mean is {:.2} ms, budget {:.2} ms", self.mean_ms, self.mean_budget_ms));
        }
        if self.below_floor > 0 {
            broken.push(format!("{} of {} frames smaller than 2×320×256", self.below_floor, self.count));
        }
        let worst = self.worst_field.unwrap_or_default();
        let (what, max) = (broken.join("; "), self.max_ms);
        format!("budget exceeded: {stage} ({}): {what}; worst: field {worst} with {max:.2} ms", self.span)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::time::Instants;

    const MS: u64 = 1_000_000;

    fn step(field: u64, tracking_ms: u64, simulation_ms: u64) -> StepRecord {
        let exposed = (field + 1) * 20 * MS;
        let blobs_out = exposed + 24 * MS;
        let tracked = blobs_out + tracking_ms * MS;
        let instants = Instants {
            exposed,
            blobs_out,
            tracked,
            stepped: tracked + simulation_ms * MS,
            ..Instants::zeroed()
        };
        StepRecord { field, instants, ..StepRecord::zeroed() }
    }

    /// Adds a field's latencies in tracker and simulation.
    fn note(latencies: &mut LatencyStats, field: u64, tracking_ms: u64, simulation_ms: u64) {
        let step = step(field, tracking_ms, simulation_ms);
        latencies.note_pose(&TrackerFrame { field, instants: step.instants, ..TrackerFrame::zeroed() });
        latencies.note_step(&step);
    }

    fn broken(latencies: &LatencyStats) -> Vec<Stage> {
        let judged = latencies.judge(&Budgets::default());
        judged.into_iter().filter(|f| f.broken).map(|f| f.stage).collect()
    }

    fn warm() -> LatencyStats {
        let mut latencies = LatencyStats::default();
        latencies.warm_from(1);
        latencies
    }

    #[test]
    fn only_the_slow_stage_is_broken_and_its_worst_field_named() {
        let mut latencies = warm();
        (0..200).for_each(|f| note(&mut latencies, f, 0, if f == 77 { 30 } else { 20 }));
        assert_eq!(broken(&latencies), [Stage::Simulation]);
        let judged = latencies.judge(&Budgets::default());
        let line = &judged[Stage::Simulation as usize];
        assert_eq!((line.worst_field, line.violations), (Some(77), 200));
        assert!(line.blame().contains("field 77 with 30.00 ms"), "{}", line.blame());
    }

    #[test]
    fn a_rare_spike_does_not_break_p99_but_breaks_p100() {
        let mut latencies = warm();
        (0..1000).for_each(|f| note(&mut latencies, f, if f == 5 { 9 } else { 0 }, 1));
        assert_eq!(broken(&latencies), []);
        let strict = Budgets { percentile: 100.0, ..Budgets::default() };
        let judged = latencies.judge(&strict);
        assert!(judged[Stage::Tracking as usize].broken);
        assert_eq!(judged[Stage::Tracking as usize].violations, 1);
    }

    #[test]
    fn pictures_too_small_to_train_with_break_the_rendering_budget() {
        let mut latencies = warm();
        for i in 0..1000 {
            let instants = Instants { exposed: 1 + i, ..Instants::zeroed() };
            let flags = if i < 30 { BELOW_FLOOR } else { 0 };
            let (frame_start, drawn) = (1, 5 * MS);
            latencies.note_frame(&FrameRecord {
                instants,
                flags,
                frame_start,
                drawn,
                ..FrameRecord::zeroed()
            });
        }
        assert_eq!(broken(&latencies), [Stage::Rendering], "3 % of quick frames, where 1 % is allowed");
        let line = latencies.judge(&Budgets::default())[Stage::Rendering as usize].blame();
        assert!(line.contains("30 of 1000 frames smaller"), "{line}");
        let lenient = Budgets { percentile: 95.0, ..Budgets::default() };
        assert!(!latencies.judge(&lenient)[Stage::Rendering as usize].broken);
    }

    #[test]
    fn fields_before_the_run_is_warm_are_left_out() {
        let mut latencies = LatencyStats::default();
        note(&mut latencies, 0, 50, 50);
        latencies.warm_from(100 * 20 * MS);
        (0..200).for_each(|f| note(&mut latencies, f, 0, if f < 99 { 60 } else { 1 }));
        assert_eq!((broken(&latencies), latencies.warm_up), (vec![], 200));
        latencies.cool();
        note(&mut latencies, 500, 50, 50);
        assert_eq!(broken(&latencies), []);
    }

    #[test]
    fn the_mean_of_the_whole_system_is_judged_beside_its_percentile() {
        let mut latencies = warm();
        for field in 0..100 {
            let exposed = (field + 1) * 20 * MS;
            let instants = Instants { exposed, ..Instants::zeroed() };
            let (frame_start, drawn) = (exposed + 40 * MS, exposed + 50 * MS);
            let displayed = exposed + 55 * MS;
            latencies.note_frame(&FrameRecord {
                field,
                instants,
                frame_start,
                drawn,
                displayed,
                ..FrameRecord::zeroed()
            });
        }
        assert_eq!(broken(&latencies), [Stage::WholeSystem]);
        let judged = latencies.judge(&Budgets::default());
        let whole = &judged[Stage::WholeSystem as usize];
        assert!(whole.blame().contains("mean is 55.00 ms, budget 50.00 ms"), "{}", whole.blame());
    }

    #[test]
    fn a_stage_that_did_not_run_is_not_judged() {
        let judged = LatencyStats::default().judge(&Budgets::default());
        assert!(judged.iter().all(|f| f.verdict == Verdict::NoSamples && !f.broken));
    }

    #[test]
    fn a_limit_of_zero_is_not_asserted() {
        let mut latencies = warm();
        note(&mut latencies, 1, 0, 400);
        let budgets = Budgets::parse("[[budget]]\nstage = \"simulation\"\nlimit_ms = 0", "b").unwrap();
        let judged = latencies.judge(&budgets);
        assert_eq!(judged[Stage::Simulation as usize].verdict, Verdict::NotAsserted);
    }

    #[test]
    fn percentiles_are_right_to_three_digits() {
        let mut durations = Durations::default();
        (1..=1000).for_each(|i| durations.note(i * MS, i));
        for (p, expected) in [(50.0, 500.0), (99.0, 990.0), (99.9, 999.0), (100.0, 1000.0)] {
            assert!((durations.at_ms(p) - expected).abs() <= expected * 2e-3, "p{p}: {}", durations.at_ms(p));
        }
        assert!((durations.mean_ms() - 500.5).abs() < 1e-9);
        assert_eq!(durations.worst, Some((1000 * MS, 1000)));
    }
}
