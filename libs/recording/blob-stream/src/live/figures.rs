//! Figures of a live stream.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the file in an instance's directory that holds the figures so far.
const FILE: &str = "blob-stream.json";

/// What has come of a live stream.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveFigures {
    /// Where it comes from.
    pub source: String,
    /// Lines, without blank ones.
    pub lines: u64,
    /// Camera-fields put out.
    pub fields: u64,
    /// Lines that made no sense.
    pub bad: u64,
    /// Lines whose stamp contradicts those before.
    pub doubtful: u64,
    /// Lines that were no newer than the same camera's before: twice, or out of order.
    pub out_of_order: u64,
    /// Fields that came during a pause, and were not put out.
    pub in_pauses: u64,
    /// Blobs beyond the 64 of a field.
    pub blobs_left_out: u64,
    /// Writers so far; 0 while the first is waited for.
    pub writers: u64,
    /// Writers that came while another was writing.
    pub turned_away: u64,
    /// How often the writer's clock was tied to this machine's, the first time among them.
    pub time_bases: u64,
    /// Times in which no field came, though some had come before.
    pub silences: u64,
    /// The longest of them, s.
    pub longest_silence_s: f64,
    /// Delay of arrival after the stamp, median, ms.
    pub jitter_p50_ms: f64,
    /// The same, 99th percentile, ms.
    pub jitter_p99_ms: f64,
}

impl LiveFigures {
    /// Where they lie in the directory of an instance.
    pub fn file(directory: &Path) -> PathBuf {
        directory.join(FILE)
    }

    /// Those that were left there; `None` where no stream was live.
    pub fn left_in(directory: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(Self::file(directory)).ok()?).ok()
    }

    /// What is not as it should be, short, for a heartbeat.
    pub fn short(&self) -> String {
        let counts = [(self.bad, "bad"), (self.doubtful, "doubtful"), (self.out_of_order, "out of order")];
        let counts: String =
            counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}")).collect();
        format!("live: {} lines{counts}, {} writers", self.lines, self.writers)
    }

    /// In words.
    pub fn text(&self) -> String {
        let rare = [
            (self.doubtful, "with a doubtful clock"),
            (self.out_of_order, "out of order"),
            (self.in_pauses, "in pauses"),
        ];
        let rare: String =
            rare.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}")).collect();
        let away =
            if self.turned_away > 0 { format!(" ({} turned away)", self.turned_away) } else { String::new() };
        format!(
            "{}: {} lines, {} bad{rare}; {} writers{away}, clocks tied {} times; {} silences, the longest {:.1} s; \
             jitter of arrival p50 {:.2} ms, p99 {:.2} ms",
            self.source,
            self.lines,
            self.bad,
            self.writers,
            self.time_bases,
            self.silences,
            self.longest_silence_s,
            self.jitter_p50_ms,
            self.jitter_p99_ms
        )
    }
}

/// Delays from 1 µs to 1000 s to three digits; what is beyond is counted as an end.
pub(super) fn delays() -> Histogram<u64> {
    Histogram::new_with_bounds(1_000, 1_000_000_000_000, 3).expect("the bounds are in order")
}

/// The delay that a share of all does not exceed, ms; 0 without any.
pub(super) fn at_ms(delays: &Histogram<u64>, share: f64) -> f64 {
    delays.value_at_quantile(share) as f64 * 1e-6
}
