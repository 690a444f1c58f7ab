//! Status screen of a run on a terminal; elsewhere one line every 10 s.

use super::external::Presence;
use super::latency_stats::LatencyStats;
use super::monitor::{CHANNELS, Monitor};
use super::supervisor::Slot;
use bytemuck::Zeroable;
use diagnosis::{Finding, Watch};
use ipc::logging::{inform, is_json};
use outputs::printable;
use protocol::budget::{Budgets, Stage};
use protocol::frames::FrameRecord;
use protocol::health::{Health, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use protocol::message::Message;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::steps::{StepProfile, StepRecord};
use protocol::time::Nanos;
use std::io::{IsTerminal, Write};

/// Period of the status screen on a terminal, ns.
const REDRAW_NS: u64 = 333_000_000;
/// Period of the status line elsewhere, ns.
const LINE_NS: u64 = 10_000_000_000;

/// Data for the status.
pub struct Status<'a> {
    /// Current time, ns of `CLOCK_MONOTONIC`.
    pub now: Nanos,
    /// Time since the first field, s.
    pub elapsed_s: f64,
    /// Length of the run, if limited, s.
    pub duration_s: Option<f64>,
    /// Traffic, events, bodies and picture.
    pub monitor: &'a Monitor,
    /// Latency histograms.
    pub latencies: &'a LatencyStats,
    /// Latency budgets.
    pub budgets: &'a Budgets,
    /// The processes.
    pub slots: &'a [Slot],
    /// State of the recorder as text; empty without a recorder.
    pub recorder: String,
    /// The newest incident, or "paused"; empty if there was none.
    pub incident: &'a str,
    /// Persistent problems.
    pub watch: &'a Watch,
    /// The process or stream that sends nothing, if there is one.
    pub silence: Option<&'a Finding>,
}

impl Status<'_> {
    /// All lines of the screen.
    pub fn lines(&self) -> Vec<String> {
        let of = self.duration_s.map(|d| format!(" of {d:.0} s")).unwrap_or_default();
        let mut lines =
            vec![format!("vitreo  {:.0} s{of}   {}   Ctrl-C ends the run", self.elapsed_s, self.recorder)];
        self.traffic(&mut lines);
        self.latencies(&mut lines);
        self.processes(&mut lines);
        self.warnings(&mut lines);
        lines
    }

    fn traffic(&self, lines: &mut Vec<String>) {
        let row = |title: &str, cell: &dyn Fn(usize) -> String| {
            let cells: String = (0..CHANNELS.len()).map(|c| format!("{:>10}", cell(c))).collect();
            format!("{title:<14}{cells}")
        };
        lines.push(row("", &|c| CHANNELS[c].into()));
        lines.push(row("per second", &|c| format!("{:.0}", self.monitor.traffic[c].rate_hz)));
        lines.push(row("age, ms", &|c| match self.monitor.traffic[c].newest_ns {
            0 => "–".into(),
            newest => format!("{:.0}", self.now.saturating_sub(newest) as f64 * 1e-6),
        }));
        let bodies = BODY_NAMES.iter().zip(self.monitor.bodies);
        let bodies: Vec<String> = bodies.map(|(name, status)| format!("{name} {status}")).collect();
        let picture = self.monitor.frame.map(|f| {
            format!("picture 2 × {} × {} px, tier {}, {} missed", f.width_px, f.height_px, f.tier, f.missed)
        });
        lines.push(format!("{}   {}", bodies.join(", "), picture.unwrap_or_default()));
        let removed = self.monitor.removed.map(|r| r.text()).unwrap_or_default();
        if !removed.is_empty() {
            lines.push(format!("removed: {removed}"));
        }
    }

    fn latencies(&self, lines: &mut Vec<String>) {
        lines.push(format!("{:<14}{:>10}{:>10}{:>10}", "latency, ms", "p50", "p99", "budget"));
        for stage in Stage::ALL {
            let durations = self.latencies.stage(stage);
            if durations.count() == 0 {
                continue;
            }
            let (p50, p99) = (durations.at_ms(50.0), durations.at_ms(99.0));
            let limit = self.budgets.of(stage).limit_ms;
            let over =
                if limit > 0.0 && durations.at_ms(self.budgets.percentile) > limit { "  over" } else { "" };
            lines.push(format!("{:<14}{p50:>10.2}{p99:>10.2}{limit:>10}{over}", stage.name()));
        }
        let phases = StepProfile::PHASES.iter().zip(&self.latencies.phases);
        let phases = phases.filter(|(_, durations)| durations.count() > 0);
        let phases: Vec<String> =
            phases.map(|(name, durations)| format!("{name} {:.2}", durations.at_ms(50.0))).collect();
        if !phases.is_empty() {
            lines.push(format!("step, ms p50: {}", phases.join(", ")));
        }
    }

    fn processes(&self, lines: &mut Vec<String>) {
        for slot in self.slots {
            let health = slot.health.unwrap_or_else(Health::zeroed);
            let state = match health.state {
                STATE_RUNNING => "running",
                STATE_DEGRADED => "degraded",
                STATE_FINISHED => "finished",
                _ => "starting",
            };
            let state = if slot.presence.as_ref().is_some_and(Presence::is_away) { "awaited" } else { state };
            let (text, lost, refused) = (health.text(), health.lost, health.refused);
            let percent = slot.cpu.share() * 100.0;
            lines.push(format!(
                "{:<11} {state:<9} {percent:>5.1} % cpu  {} restarts  {lost} lost  {refused} refused  {text}",
                slot.process.name(),
                slot.restarts
            ));
        }
    }

    fn warnings(&self, lines: &mut Vec<String>) {
        if !self.incident.is_empty() {
            lines.push(format!("! {}", self.incident));
        }
        for finding in self.silence.into_iter().chain(self.watch.present()) {
            lines.push(format!("! {}", finding.text()));
        }
        for event in &self.monitor.warnings {
            lines.push(format!("! field {}: {}", event.field, event.describe()));
        }
    }

    /// The status as one line, without the picture and stages that have no samples.
    pub fn line(&self) -> String {
        let rate = |channel: &str| self.monitor.traffic_of(channel).rate_hz;
        let stages =
            [(Stage::Tracking, 2), (Stage::Simulation, 2), (Stage::Rendering, 1), (Stage::WholeSystem, 1)];
        let measured = stages.map(|(stage, digits)| (stage.name(), digits, self.latencies.stage(stage)));
        let p99: Vec<String> = measured
            .iter()
            .filter(|(_, _, durations)| durations.count() > 0)
            .map(|(name, digits, durations)| format!("{name} {:.digits$}", durations.at_ms(99.0)))
            .collect();
        let p99 = if p99.is_empty() { String::new() } else { format!("; p99 ms: {}", p99.join(", ")) };
        let restarts: u32 = self.slots.iter().map(|s| s.restarts).sum();
        let picture = self
            .monitor
            .frame
            .map(|f| format!(", {:.0} frames/s, tier {}", rate(FrameRecord::CHANNEL), f.tier));
        let picture = picture.unwrap_or_default();
        let silence = self.silence.map(|finding| format!("; ! {}", finding.what)).unwrap_or_default();
        format!(
            "{:.0} s: {:.0} poses/s, {:.0} steps/s{picture}{p99}; {restarts} restarts{silence}",
            self.elapsed_s,
            rate(TrackerFrame::CHANNEL),
            rate(StepRecord::CHANNEL),
        )
    }
}

/// Shows the status on standard error.
pub struct Screen {
    terminal: bool,
    next_ns: Nanos,
    drawn_lines: usize,
}

impl Screen {
    /// A screen on standard error.
    pub fn new() -> Self {
        let terminal = std::io::stderr().is_terminal() && !is_json();
        Screen { terminal, next_ns: 0, drawn_lines: 0 }
    }

    /// True if [`Screen::show`] is due at `now`.
    pub fn due(&mut self, now: Nanos) -> bool {
        let period = if self.terminal { REDRAW_NS } else { LINE_NS };
        if self.next_ns == 0 {
            self.next_ns = now + period;
        }
        let due = now >= self.next_ns;
        if due {
            self.next_ns = now + period;
        }
        due
    }

    /// Shows the status.
    pub fn show(&mut self, status: &Status<'_>) {
        if !self.terminal {
            self.print(&status.line());
            return;
        }
        let lines = status.lines();
        let text = frame(&lines, self.drawn_lines);
        self.drawn_lines = lines.len();
        // The run continues without its terminal.
        let _ = std::io::stderr().write_all(text.as_bytes());
    }

    /// Prints a message above the status, where it stays; as a record if messages are JSON lines.
    pub fn print(&mut self, sentence: &str) {
        if is_json() {
            return inform(sentence);
        }
        self.pass_on(sentence);
    }

    /// Prints a line of a child process above the status.
    pub fn pass_on(&mut self, sentence: &str) {
        let text = format!("{}{}\n", clear(self.drawn_lines), printable(sentence));
        self.drawn_lines = 0;
        let _ = std::io::stderr().write_all(text.as_bytes());
    }
}

impl Default for Screen {
    fn default() -> Self {
        Self::new()
    }
}

/// Control sequence that erases the last `lines` lines.
fn clear(lines: usize) -> String {
    if lines == 0 { String::new() } else { format!("\x1b[{lines}F\x1b[J") }
}

/// Text that replaces `drawn` earlier lines with `lines`, each truncated at the edge of the terminal.
fn frame(lines: &[String], drawn: usize) -> String {
    const NO_WRAP: &str = "\x1b[?7l";
    const WRAP: &str = "\x1b[?7h";
    let up = if drawn == 0 { String::new() } else { format!("\x1b[{drawn}F") };
    let body: String = lines.iter().map(|l| format!("{}\x1b[K\n", printable(l))).collect();
    format!("{up}{NO_WRAP}{body}\x1b[J{WRAP}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::events::{Event, EventKind, Severity};
    use recording::Item;

    fn with_status(check: impl FnOnce(&Status<'_>)) {
        let (mut monitor, mut latencies) = (Monitor::default(), LatencyStats::default());
        latencies.warm_from(1);
        let mut step = StepRecord::zeroed();
        step.instants.exposed = 1_000_000;
        step.instants.tracked = 2_000_000;
        step.instants.stepped = 14_000_000;
        step.profile.tissue_ns = 7_000_000;
        latencies.note_step(&step);
        monitor.note(&Item::Step(step));
        let kind = EventKind::RimForceHigh as u32;
        let severity = Severity::Warning as u32;
        monitor.note(&Item::Event(Event { kind, severity, field: 42, value: 7.5, ..Event::zeroed() }));
        monitor.measure(1_000_000_000);
        check(&Status {
            now: 24_000_000,
            elapsed_s: 3.0,
            duration_s: Some(20.0),
            monitor: &monitor,
            latencies: &latencies,
            budgets: &Budgets::default(),
            slots: &[],
            recorder: "recording".into(),
            incident: "tracker restarted",
            watch: &Watch::default(),
            silence: None,
        });
    }

    #[test]
    fn the_screen_shows_rates_ages_latencies_and_warnings() {
        with_status(|status| {
            let text = status.lines().join("\n");
            for part in [
                "3 s of 20 s",
                "steps",
                "age, ms",
                "simulation",
                "12.00",
                "tissue 7.00",
                "over",
                "field 42",
                "7.50 µN",
                "tracker restarted",
            ] {
                assert!(text.contains(part), "{part} is missing in\n{text}");
            }
            assert!(!text.contains("rendering "), "stages without samples are not shown");
            let line = status.line();
            assert!(line.contains("simulation 12.0"), "{line}");
            assert!(!line.contains("frames/s") && !line.contains("rendering"), "{line}");
        });
    }

    #[test]
    fn a_redraw_goes_up_by_what_was_drawn() {
        let text = frame(&["a".into(), "b".into()], 5);
        assert!(text.starts_with("\x1b[5F") && text.matches('\n').count() == 2);
        assert!(!frame(&["a".into()], 0).contains('F'));
        assert_eq!(clear(0), "");
    }
}
