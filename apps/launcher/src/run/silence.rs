//! Detects processes that receive input but send nothing, so that a stalled run is reported. Pure.

use super::monitor::CHANNELS;
use diagnosis::{Finding, Warning};
use protocol::health::Process;
use protocol::time::Nanos;

/// A process that sends nothing for this long is silent, ns.
const SILENT_NS: u64 = 500_000_000;
/// If nothing has come from upstream for this long, ns (five fields), a process is not expected to send.
const STARVED_NS: u64 = 100_000_000;
/// Longest time between two calls that is counted, ns, so that a suspended machine is no silence.
const LONGEST_STEP_NS: u64 = 100_000_000;
/// Maximum number of silences kept for the report.
const KEPT: usize = 100;

/// Cause and remedy for a process of the run.
const OF_PROCESS: [&str; 2] =
    ["its messages on standard error give the reason", "end the run and report this with its recording"];
/// Cause and remedy for a live blob stream.
const OF_STREAM: [&str; 2] = [
    "its writer is missing or writes nothing valid: see the messages on standard error",
    "check the writer; the run continues and reads its lines again",
];
/// Cause and remedy for an external driver.
const OF_DRIVER: [&str; 2] =
    ["its driver is missing or has nothing to send", "check the driver; the run continues and reconnects"];
/// Name of a live blob stream.
const STREAM: &str = "the blob stream";
/// Suffix of the names of external drivers.
const DRIVER: &str = "-driver";

/// Output of a process, checked for silence.
#[derive(Debug)]
struct Output {
    /// Name of the process, or of the side that sends blobs.
    name: &'static str,
    /// Index of its channel in [`CHANNELS`].
    channel: usize,
    /// Effect of a silence, as text.
    effect: &'static str,
    /// Cause and remedy, as text.
    advice: [&'static str; 2],
    /// Number of messages at the latest call.
    count: u64,
    silent_ns: u64,
    /// Index of the warning about the current silence.
    warning: Option<usize>,
}

/// Checks that every process of a run sends output for its input.
#[derive(Debug)]
pub struct SilenceWatch {
    outputs: Vec<Output>,
    warnings: Vec<Warning>,
    at_ns: Nanos,
}

impl SilenceWatch {
    /// Checks of a run whose first process is `source`. `live`: the blobs come from a stream that other
    /// programs write.
    pub fn new(source: Process, live: bool) -> Self {
        let output = |name, channel: &str, effect| Output {
            name,
            channel: CHANNELS.iter().position(|c| *c == channel).unwrap_or(0),
            effect,
            advice: match name {
                STREAM => OF_STREAM,
                driver if driver.ends_with(DRIVER) => OF_DRIVER,
                _ => OF_PROCESS,
            },
            count: 0,
            silent_ns: 0,
            warning: None,
        };
        let cameras = match source {
            driver if driver.drives().is_some() => driver.name(),
            _ if live => STREAM,
            _ => "the camera side",
        };
        let (source, poses) = match source {
            Process::Desk | Process::PosesDriver => (None, source),
            _ => (Some("blobs"), Process::Tracker),
        };
        let source = source.map(|c| output(cameras, c, "the tracker receives nothing"));
        let path = [
            output(poses.name(), "poses", "the instruments are frozen in the picture"),
            output(Process::Simcore.name(), "steps", "the tissue is frozen"),
        ];
        SilenceWatch { outputs: source.into_iter().chain(path).collect(), warnings: Vec::new(), at_ns: 0 }
    }

    /// Resets the timers, because a pause, a start or a restart is not a silence.
    pub fn excuse(&mut self, at_ns: Nanos, at_s: f64) {
        self.at_ns = at_ns;
        for output in &mut self.outputs {
            output.silent_ns = 0;
            end(&mut self.warnings, output.warning.take(), at_s);
        }
    }

    /// Adds the number of messages so far, in the order of [`CHANNELS`], at a time in ns and in s since the
    /// start. Returns a silence that has just been detected.
    pub fn note(&mut self, counts: [u64; CHANNELS.len()], at_ns: Nanos, at_s: f64) -> Option<Finding> {
        let step = at_ns.saturating_sub(self.at_ns).min(LONGEST_STEP_NS);
        self.at_ns = at_ns;
        // A process without input is not expected to send. It is checked again once its input returns.
        let mut is_fed = true;
        for output in &mut self.outputs {
            let count = counts[output.channel];
            output.silent_ns = if is_fed { output.silent_ns + step } else { 0 };
            if count != output.count {
                (output.count, output.silent_ns) = (count, 0);
                end(&mut self.warnings, output.warning.take(), at_s);
            }
            is_fed &= output.silent_ns < STARVED_NS;
        }
        let first = self.outputs.iter_mut().find(|o| o.silent_ns >= STARVED_NS)?;
        if first.silent_ns < SILENT_NS || first.warning.is_some() || self.warnings.len() >= KEPT {
            return None;
        }
        let (name, channel) = (first.name, CHANNELS[first.channel]);
        let finding = Finding {
            what: format!("{name} sends nothing on {channel}: {}", first.effect),
            cause: format!("{} messages came before; {}", first.count, first.advice[0]),
            remedy: first.advice[1].into(),
            subject: format!("silence of {name}"),
        };
        first.warning = Some(self.warnings.len());
        let from_s = at_s - first.silent_ns as f64 * 1e-9;
        self.warnings.push(Warning { from_s, to_s: None, finding: finding.clone() });
        Some(finding)
    }

    /// The current silence, if there is one.
    pub fn present(&self) -> Option<&Finding> {
        let index = self.outputs.iter().find_map(|o| o.warning)?;
        Some(&self.warnings[index].finding)
    }

    /// All silences of processes of the run.
    pub fn of_processes(&self) -> Vec<Warning> {
        self.warnings.iter().filter(|w| !is_of_stream(w)).cloned().collect()
    }

    /// All silences of streams and drivers, which are no fault of the run's processes.
    pub fn of_stream(&self) -> Vec<Warning> {
        self.warnings.iter().filter(|w| is_of_stream(w)).cloned().collect()
    }
}

fn is_of_stream(warning: &Warning) -> bool {
    [STREAM, DRIVER].iter().any(|name| warning.finding.subject.ends_with(name))
}

fn end(warnings: &mut [Warning], index: Option<usize>, at_s: f64) {
    if let Some(warning) = index.and_then(|index| warnings.get_mut(index)) {
        warning.to_s = Some(at_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Simulates a second with a call every 10 ms, in which messages arrive on the channels `flows`.
    fn second(watch: &mut SilenceWatch, from_ms: u64, flows: &[&str]) -> Vec<String> {
        let mut found = Vec::new();
        for ms in (from_ms..from_ms + 1_000).step_by(10) {
            let counts = CHANNELS.map(|c| if flows.contains(&c) { ms } else { 7 });
            found.extend(watch.note(counts, ms * MS, ms as f64 * 1e-3).map(|f| f.subject));
        }
        found
    }

    #[test]
    fn the_first_that_is_silent_is_named_once() {
        let mut watch = SilenceWatch::new(Process::VirtualRig, false);
        let all = ["blobs", "poses", "steps", "frames"];
        assert!(second(&mut watch, 0, &all).is_empty());
        assert_eq!(second(&mut watch, 1_000, &["blobs", "frames"]), ["silence of tracker"]);
        assert!(second(&mut watch, 2_000, &["blobs", "frames"]).is_empty());
        assert!(watch.present().is_some());
        assert!(second(&mut watch, 3_000, &all).is_empty() && watch.present().is_none());
        let warning = &watch.of_processes()[0];
        assert!((warning.from_s - 0.99).abs() < 0.02, "{}", warning.from_s);
        assert_eq!(warning.to_s, Some(3.0));
        assert_eq!(second(&mut watch, 4_000, &["blobs", "poses"]), ["silence of simcore"]);
        assert_eq!(second(&mut watch, 5_000, &[]), ["silence of the camera side"]);
    }

    #[test]
    fn who_got_nothing_is_judged_from_when_it_gets_something() {
        let mut watch = SilenceWatch::new(Process::VirtualRig, false);
        assert!(second(&mut watch, 0, &["blobs", "poses", "steps"]).is_empty());
        assert_eq!(second(&mut watch, 1_000, &["blobs"]), ["silence of tracker"]);
        // The poses return one call before the steps.
        let counts = |steps| CHANNELS.map(|c| if c == "steps" { steps } else { 9_000 });
        assert!(watch.note(counts(7), 2_000 * MS, 2.0).is_none(), "{:?}", watch.of_processes());
        assert!(watch.note(counts(8), 2_010 * MS, 2.01).is_none());
        assert_eq!(second(&mut watch, 3_000, &["blobs", "poses"]), ["silence of simcore"]);
        assert_eq!(watch.of_processes().len(), 2);
    }

    #[test]
    fn a_stream_that_others_write_is_no_fault_of_a_process() {
        let mut watch = SilenceWatch::new(Process::VirtualRig, true);
        assert_eq!(second(&mut watch, 0, &[]), ["silence of the blob stream"]);
        assert!(watch.present().is_some_and(|finding| finding.remedy.contains("check the writer")));
        assert!(second(&mut watch, 1_000, &["blobs", "poses", "steps"]).is_empty());
        assert_eq!(second(&mut watch, 2_000, &["blobs"]), ["silence of tracker"]);
        let silences = (watch.of_stream(), watch.of_processes());
        assert_eq!((silences.0.len(), silences.1.len()), (1, 1));
        assert_eq!(silences.0[0].to_s, Some(1.0));
    }

    #[test]
    fn a_driver_that_sends_nothing_is_no_fault_of_a_process() {
        let mut watch = SilenceWatch::new(Process::BlobsDriver, false);
        assert_eq!(second(&mut watch, 0, &[]), ["silence of blobs-driver"]);
        assert_eq!((watch.of_stream().len(), watch.of_processes().len()), (1, 0));
        let mut watch = SilenceWatch::new(Process::PosesDriver, false);
        assert_eq!(second(&mut watch, 0, &["steps"]), ["silence of poses-driver"]);
        assert!(watch.of_processes().is_empty());
    }

    #[test]
    fn a_desk_sends_poses_itself() {
        let mut watch = SilenceWatch::new(Process::Desk, false);
        assert!(second(&mut watch, 0, &["poses", "steps"]).is_empty());
        assert_eq!(second(&mut watch, 1_000, &["steps"]), ["silence of desk"]);
    }

    #[test]
    fn neither_a_sleep_nor_a_pause_is_a_silence() {
        let mut watch = SilenceWatch::new(Process::VirtualRig, false);
        let counts = [1; CHANNELS.len()];
        watch.note(counts, 0, 0.0);
        assert!(watch.note(counts, 3_600_000 * MS, 3_600.0).is_none(), "an hour of sleep");
        for n in 1..20 {
            let at = 3_600_000 + 100 * n;
            watch.excuse(at * MS, at as f64 * 1e-3);
            assert!(watch.note(counts, (at + 99) * MS, at as f64 * 1e-3).is_none());
        }
        assert!(watch.of_processes().is_empty());
    }
}
