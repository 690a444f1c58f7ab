//! The report of a run, as JSON and as tables. Pure.

mod paper;

pub use paper::{PaperLine, paper_table_4};

use super::latency_stats::{LatencyStats, StageFigures};
use super::load::{Load, NO_LOAD};
use crate::machine::Machine;
use blob_stream::live::LiveFigures;
use diagnosis::{TrackingFigures, Warning};
use protocol::controls::ControlFigures;
use protocol::deliveries::Delivery;
use protocol::steps::{StepProfile, StepRecord};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Version of the report's layout.
pub const FORMAT: &str = "vitreo-report-1";

/// All figures of a run.
#[derive(Debug, Serialize)]
pub struct Report {
    /// [`FORMAT`].
    pub format: &'static str,
    /// True if no budget is broken.
    pub budgets_kept: bool,
    /// Why the run ended.
    pub ended_by: String,
    /// Time from the first field to the end, s.
    pub duration_s: f64,
    /// Setup of the run.
    pub setup: Setup,
    /// Description of the machine.
    pub machine: Machine,
    /// Versions of the program.
    pub versions: Versions,
    /// Latency of every stage, compared with its budget.
    pub stages: Vec<StageFigures>,
    /// Load of the processors by other programs, if the system reports it.
    pub load: Option<Load>,
    /// Number of latencies excluded within a second after a start or restart.
    pub warm_up_left_out: u64,
    /// The paper's Table 4 with the medians of this run.
    pub paper_table_4: Vec<PaperLine>,
    /// Time of each phase of the simulation step.
    pub step_profile: Vec<PhaseFigures>,
    /// Figures of the picture, if there was one.
    pub picture: Option<Picture>,
    /// Figures of the tracking.
    pub tracking: TrackingFigures,
    /// The body that was tracked in the smallest share of frames, and that share, 0 to 1.
    #[serde(skip)]
    pub least_tracked: (&'static str, f64),
    /// Persistent problems, with likely cause and remedy.
    pub warnings: Vec<Warning>,
    /// Processes that were running but sent nothing for half a second or more.
    pub silences: Vec<Warning>,
    /// Figures of a live blob stream.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blob_stream: Option<LiveFigures>,
    /// Figures of each process.
    pub processes: Vec<ProcessFigures>,
    /// Number of restarts, by process.
    pub restarts: BTreeMap<&'static str, u32>,
    /// Incidents during the run (restarts, drivers, attempts), with the time since the start, s.
    #[serde(rename = "happenings")]
    pub incidents: Vec<Incident>,
    /// Processes that ended with an error at the end of the run, so that their output may be incomplete.
    pub unfinished: Vec<String>,
    /// Missing blocks by channel: overwritten before the launcher read them, or never published (skipped
    /// field numbers, fields without a tracker frame).
    pub lost: BTreeMap<&'static str, u64>,
    /// Number of blocks that were overwritten, on all channels.
    #[serde(skip)]
    pub overwritten: u64,
    /// Number of frames that are missing although their fields arrived.
    pub frames_withheld: u64,
    /// Number of times the simulation died and could not resume.
    pub states_lost: u64,
    /// Number of received messages by channel.
    pub received: BTreeMap<&'static str, u64>,
    /// Number of events by kind.
    pub events: BTreeMap<&'static str, u64>,
    /// Tissue removed by vitrectors, and the remaining vitreous.
    pub removed: Option<Removed>,
    /// Figures of the recording, if there was one.
    pub recording: Option<RecordingFigures>,
    /// Delivery of the pictures of each camera, if they came from devices, pipes or files.
    pub cameras: Vec<Delivery>,
    /// Figures of a real pedal and real handles.
    pub controls: Vec<ControlFigures>,
}

/// Setup of a run.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct Setup {
    pub instance: String,
    pub scene: String,
    pub rig: String,
    pub seed: u64,
    pub source: String,
    /// File of the colour classes, or `shipped`.
    pub colours: String,
    pub view: &'static str,
    /// True if cameras, tracker and simulation ran under the real-time scheduler.
    pub realtime: bool,
    pub injected_delays_ms: BTreeMap<&'static str, f64>,
}

/// Versions of the program.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct Versions {
    pub vitreo: &'static str,
    pub profile: &'static str,
}

impl Versions {
    /// Version and profile of this build.
    pub fn of_this_build() -> Self {
        let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
        Versions { vitreo: env!("CARGO_PKG_VERSION"), profile }
    }
}

/// Figures of the picture.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct Picture {
    pub frames: u64,
    pub frames_per_second: f64,
    pub missed: u64,
    /// Quality tier of the last frame; 0 is the best.
    pub tier: u32,
    /// Number of frames shown at each quality tier.
    pub frames_by_tier: BTreeMap<u32, u64>,
    /// The first hundred choices of a quality tier, including the initial one.
    pub tiers: Vec<TierChoice>,
    /// Size of one channel in the last frame, px.
    pub width_px: u32,
    pub height_px: u32,
    /// Meaning of the frames' timestamp `displayed`, on which the latency of the whole system is based.
    pub displayed: &'static str,
    /// Number of frames with a presentation time from the display server.
    pub reported: u64,
    /// Status text of the renderer: adapter and tier.
    pub renderer: String,
}

/// A choice of a quality tier.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TierChoice {
    /// Time since the first frame, s.
    pub at_s: f64,
    /// The chosen tier; 0 is the best.
    pub tier: u32,
    /// Reason for the choice.
    pub reason: &'static str,
}

/// Tissue that vitrectors removed in the last attempt, and the rest volume of the vitreous that is left.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct Removed {
    pub membrane_mm2: f64,
    pub retina_mm2: f64,
    pub vitreous_ml: f64,
    pub vitreous_left_ml: f64,
}

impl Removed {
    /// Removed tissue up to a step.
    pub fn of(step: &StepRecord) -> Self {
        Removed {
            membrane_mm2: step.membrane_cut_um2 as f64 * 1e-6,
            retina_mm2: step.retina_cut_um2 as f64 * 1e-6,
            vitreous_ml: step.vitreous_removed_um3 as f64 * 1e-12,
            vitreous_left_ml: step.vitreous_left_um3 as f64 * 1e-12,
        }
    }

    /// The figures as text; empty if nothing was removed.
    pub fn text(&self) -> String {
        let areas = [("membrane", self.membrane_mm2), ("retina", self.retina_mm2)];
        let areas = areas.into_iter().filter(|(_, mm2)| *mm2 > 0.0);
        let mut gone: Vec<String> = areas.map(|(what, mm2)| format!("{what} {mm2:.2} mm²")).collect();
        if self.vitreous_ml > 0.0 {
            gone.push(format!("vitreous {:.2} ml ({:.2} ml left)", self.vitreous_ml, self.vitreous_left_ml));
        }
        gone.join(", ")
    }
}

/// Figures of a process.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct ProcessFigures {
    pub process: &'static str,
    pub restarts: u32,
    /// CPU time, percent of one core.
    pub cpu_percent: f64,
    pub received: u64,
    pub sent: u64,
    pub lost: u64,
    pub refused: u64,
    pub text: String,
}

/// An incident during a run: a restart, a driver, or an attempt.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct Incident {
    pub at_s: f64,
    pub what: String,
}

/// Figures of the recording.
#[derive(Debug, Clone, Serialize)]
#[allow(missing_docs)]
pub struct RecordingFigures {
    pub file: String,
    pub items: u64,
    /// Number of items that are not in the file.
    pub lost: u64,
    pub bytes: u64,
    /// Number of parts, if split.
    pub parts: Option<u32>,
    /// Why the recording is incomplete; `None` if it is complete.
    pub problem: Option<String>,
}

/// Durations of a phase of the simulation step.
#[derive(Debug, Clone, Serialize)]
pub struct PhaseFigures {
    /// Name, one of [`StepProfile::PHASES`].
    pub phase: &'static str,
    /// Median, ms.
    pub p50_ms: f64,
    /// 99th percentile, ms.
    pub p99_ms: f64,
    /// Maximum, ms.
    pub max_ms: f64,
}

/// Durations of all phases of the simulation step; empty if there was no step.
pub fn step_profile(latencies: &LatencyStats) -> Vec<PhaseFigures> {
    let phases = StepProfile::PHASES.into_iter().zip(&latencies.phases).filter(|(_, d)| d.count() > 0);
    phases
        .map(|(phase, d)| PhaseFigures {
            phase,
            p50_ms: d.at_ms(50.0),
            p99_ms: d.at_ms(99.0),
            max_ms: d.at_ms(100.0),
        })
        .collect()
}

impl Report {
    /// The report as text, in tables.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_stages(&mut out);
        let _ = self.write_paper(&mut out);
        let _ = self.write_profile(&mut out);
        let _ = self.write_processes(&mut out);
        let _ = self.write_rest(&mut out);
        out
    }

    fn write_stages(&self, out: &mut String) -> std::fmt::Result {
        let percentile = self.stages.first().map_or(99.0, |s| s.percentile);
        writeln!(out, "latency, ms (budgets at p{percentile}; ran {:.1} s)", self.duration_s)?;
        writeln!(
            out,
            "{:<13} {:<25} {:>6} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>9} {:>6}  verdict",
            "stage", "from → to", "count", "mean", "p50", "p95", "p99", "p99.9", "max", "budget", "over"
        )?;
        for s in &self.stages {
            let mean = if s.mean_budget_ms > 0.0 { format!("/{}", s.mean_budget_ms) } else { String::new() };
            let ms = |ms: f64| if s.count > 0 { format!("{ms:.2}") } else { "–".into() };
            let [mean_ms, p50, p95, p99, p999, max] =
                [s.mean_ms, s.p50_ms, s.p95_ms, s.p99_ms, s.p999_ms, s.max_ms].map(ms);
            writeln!(
                out,
                "{:<13} {:<25} {:>6} {mean_ms:>7} {p50:>7} {p95:>7} {p99:>7} {p999:>7} {max:>7} {:>9} {:>6}  {}",
                s.stage.name(),
                s.span,
                s.count,
                format!("{}{mean}", s.budget_ms),
                s.violations,
                s.verdict.text()
            )?;
        }
        writeln!(out, "{}", self.judgement())
    }

    /// Text that says whether the budgets were met and, if not, whether the load of other programs explains
    /// it.
    pub fn judgement(&self) -> String {
        let judged: Vec<&StageFigures> = self.stages.iter().filter(|s| s.is_judged()).collect();
        let broken: Vec<&StageFigures> = judged.iter().copied().filter(|s| s.broken).collect();
        let names = broken.iter().map(|s| s.stage.name()).collect::<Vec<_>>().join(", ");
        let load = self.load.map_or_else(|| NO_LOAD.to_owned(), |l| l.text());
        let explained = self.load.is_some_and(|l| broken.iter().all(|s| l.explains(&s.judged())));
        match (judged.is_empty(), broken.is_empty(), explained) {
            (true, ..) => "budgets: none was checked".into(),
            (_, true, _) => format!("budgets: all {} met; {load}", judged.len()),
            (_, _, true) => format!(
                "budgets: {names} exceeded, by no more than the machine's load explains ({load}); try again on an idle machine"
            ),
            _ => format!("budgets: {names} exceeded, and the load does not explain it; {load}"),
        }
    }

    fn write_paper(&self, out: &mut String) -> std::fmt::Result {
        paper::write(&self.paper_table_4, out)
    }

    fn write_profile(&self, out: &mut String) -> std::fmt::Result {
        if self.step_profile.is_empty() {
            return Ok(());
        }
        writeln!(out, "\nphases of a step, ms            p50      p99      max")?;
        for p in &self.step_profile {
            writeln!(out, "{:<26} {:>8.3} {:>8.3} {:>8.3}", p.phase, p.p50_ms, p.p99_ms, p.max_ms)?;
        }
        Ok(())
    }

    fn write_processes(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "\n{:<11} {:>7} {:>9} {:>9} {:>7} {:>8} {:>9}",
            "process", "core %", "received", "sent", "lost", "refused", "restarts"
        )?;
        for p in &self.processes {
            writeln!(
                out,
                "{:<11} {:>7.1} {:>9} {:>9} {:>7} {:>8} {:>9}  {}",
                p.process, p.cpu_percent, p.received, p.sent, p.lost, p.refused, p.restarts, p.text
            )?;
        }
        Ok(())
    }

    fn write_rest(&self, out: &mut String) -> std::fmt::Result {
        if let Some(p) = &self.picture {
            let (width, height) = (p.width_px, p.height_px);
            write!(
                out,
                "\npicture: {} frames, {:.1} a second, {} missed, ",
                p.frames, p.frames_per_second, p.missed
            )?;
            write!(out, "2 × {width} × {height} px, tier {}", p.tier)?;
            let why = p.tiers.last().map_or("", |choice| choice.reason);
            writeln!(out, " ({why}; {} choices)", p.tiers.len())?;
            write!(out, "         displayed is {}", p.displayed)?;
            let of = format!(" ({} of {} frames with its time)", p.reported, p.frames);
            writeln!(out, "{}", if p.reported > 0 { of.as_str() } else { "" })?;
        }
        for delivery in &self.cameras {
            writeln!(out, "{}", delivery.line())?;
        }
        for control in &self.controls {
            writeln!(out, "{}", control.line())?;
        }
        for (i, line) in self.tracking.lines.iter().enumerate() {
            writeln!(out, "{} {line}", if i == 0 { "tracking:" } else { "         " })?;
        }
        if let Some(stream) = &self.blob_stream {
            writeln!(out, "blob stream: {}", stream.text())?;
        }
        if !self.events.is_empty() {
            let events: Vec<String> = self.events.iter().map(|(k, n)| format!("{k} {n}")).collect();
            writeln!(out, "events: {}", events.join(", "))?;
        }
        let removed = self.removed.map(|r| r.text()).unwrap_or_default();
        if !removed.is_empty() {
            writeln!(out, "removed: {removed}")?;
        }
        if let Some(r) = &self.recording {
            let mib = r.bytes as f64 / f64::from(1 << 20);
            let parts = r.parts.map_or(String::new(), |parts| format!(" in {parts} parts"));
            writeln!(out, "recording: {}{parts}, {} items, {mib:.1} MiB, {} lost", r.file, r.items, r.lost)?;
        }
        for h in &self.incidents {
            writeln!(out, "{:>7.1} s: {}", h.at_s, h.what)?;
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests;
