//! Figures of a certificate. Pure.

use super::floor::Floor;
use super::slowest::SlowestFigures;
use super::stream::{NOISE_PX, Triples};
use super::subscriber::Read;
use super::tally::{BodyFigures, PARTS};
use crate::machine::Machine;
use crate::run::Durations;
use protocol::time::Nanos;
use serde::Serialize;
use std::time::SystemTime;

/// Format name in the JSON file.
pub const FORMAT: &str = "vitreo-certificate-1";
/// Goal: maximum difference between latency and wake-up floor at [`GOAL_PERCENTILE`], ms.
pub const GOAL_MS: f64 = 0.5;
/// Percentile at which latency and floor are compared.
pub const GOAL_PERCENTILE: f64 = 99.9;
/// Histogram bins per decade.
const BINS: i32 = 10;

/// Statistics of durations, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// Number of durations.
    pub count: u64,
    /// Arithmetic mean, ms.
    pub mean_ms: f64,
    /// Median, ms.
    pub p50_ms: f64,
    /// 99th percentile, ms.
    pub p99_ms: f64,
    /// 99.9th percentile, ms.
    pub p99_9_ms: f64,
    /// Maximum, ms.
    pub max_ms: f64,
}

impl Figures {
    /// Statistics of a histogram.
    pub fn of(durations: &Durations) -> Self {
        let [p50_ms, p99_ms, p99_9_ms, max_ms] =
            [50.0, 99.0, GOAL_PERCENTILE, 100.0].map(|p| durations.at_ms(p));
        Figures { count: durations.count(), mean_ms: durations.mean_ms(), p50_ms, p99_ms, p99_9_ms, max_ms }
    }
}

/// A histogram bin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Lower limit (exclusive), ms.
    pub from_ms: f64,
    /// Upper limit (inclusive), ms.
    pub to_ms: f64,
    /// Number of durations in the bin.
    pub count: u64,
}

/// Adjoining logarithmic bins, ten per decade, from the first to the last that is not empty. Durations below
/// 1 µs are in the bin that starts at 1 µs.
pub fn ranges(durations: &Durations) -> Vec<Range> {
    let bound_ns = |i: i32| (10f64.powf(f64::from(i) / f64::from(BINS)) * 1e3) as u64;
    let mut before = 0;
    let all = (0..BINS * 6).map(|i| {
        let [from, to] = [i, i + 1].map(bound_ns);
        let up_to = durations.up_to(to);
        let count = up_to - std::mem::replace(&mut before, up_to);
        Range { from_ms: from as f64 * 1e-6, to_ms: to as f64 * 1e-6, count }
    });
    let all: Vec<Range> = all.collect();
    let first = all.iter().position(|range| range.count > 0).unwrap_or(0);
    let last = all.iter().rposition(|range| range.count > 0).map_or(0, |last| last + 1);
    all[first..last.max(first)].to_vec()
}

/// Counts of the triples of one stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Losses {
    /// Triples sent and counted.
    pub triples: u64,
    /// Triples whose poses the subscriber could not read.
    pub drops: u64,
    /// Triples whose poses were computed without all of their fields.
    pub incomplete: u64,
    /// Blocks that were overwritten in the subscriber's queue, or invalid.
    pub blocks_lost: u64,
    /// Fields that the tracker refused.
    pub fields_refused: u64,
}

impl Losses {
    /// Counts of the results of a subscriber.
    pub fn of(read: &Read) -> Self {
        Losses {
            triples: read.tally.triples(),
            drops: read.tally.drops(),
            incomplete: read.tally.incomplete,
            blocks_lost: read.counts.lost + read.counts.refused,
            fields_refused: read.fields_refused.into(),
        }
    }
}

/// Results of the stream at full speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AtSpeed {
    /// Counts of its triples.
    #[serde(flatten)]
    pub losses: Losses,
    /// Requested number of triples.
    pub asked: u64,
    /// Triples per second, pauses included.
    pub rate_hz: f64,
    /// Time from receipt of a complete triple by the tracker to the sending of its poses. The processor was
    /// not idle before, unlike in real time.
    pub tracking: Figures,
}

/// Conditions of a measurement.
#[derive(Debug, Clone, Serialize)]
pub struct Setup {
    /// Start, UTC, RFC 3339.
    pub began: String,
    /// Version of this program.
    pub version: &'static str,
    /// The machine.
    pub machine: Machine,
    /// Name of the rig file.
    pub rig: String,
    /// Field rate of the rig, Hz.
    pub field_hz: f64,
    /// Number of cameras.
    pub cameras: usize,
    /// Field rates of the cameras, ascending, Hz.
    pub camera_hz: Vec<f64>,
    /// Number of markers, all seen by every camera.
    pub markers: usize,
    /// Standard deviation of the marker centres, px.
    pub noise_px: f64,
    /// Time from mid-exposure to the sending of the blobs, ms; computed from the rig file.
    pub camera_ms: f64,
    /// Scheduling class of tracker, feeder, subscriber and floor.
    pub scheduling: String,
    /// Description of the load.
    pub load: String,
    /// Share of processor time that the host of a virtual machine took during the triples in real time,
    /// percent; `None` if the system does not report it.
    pub stolen_percent: Option<f64>,
}

impl Setup {
    /// Conditions for a rig (name, field rate in Hz) on this machine, measured from `began`.
    pub fn of(
        began: SystemTime,
        rig: (String, f64),
        triples: &Triples,
        scheduling: &str,
        (load, stolen_percent): (&str, Option<f64>),
    ) -> Self {
        Setup {
            began: humantime::format_rfc3339_seconds(began).to_string(),
            version: env!("CARGO_PKG_VERSION"),
            machine: Machine::detect(),
            rig: rig.0,
            field_hz: rig.1,
            cameras: triples.cameras(),
            camera_hz: triples.rates_hz(),
            markers: triples.markers(),
            noise_px: NOISE_PX,
            camera_ms: triples.read_out_ns() as f64 * 1e-6,
            scheduling: scheduling.into(),
            load: load.into(),
            stolen_percent,
        }
    }
}

/// The goal and its result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Goal {
    /// Percentile of latency and floor.
    pub percentile: f64,
    /// Maximum difference between the latency and the lower of the two floors, ms.
    pub above_floor_ms: f64,
    /// Measured difference, ms.
    pub found_ms: f64,
    /// True if the goal is met.
    pub kept: bool,
}

/// A certificate, serialised to JSON.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Conditions of the measurement.
    pub setup: Setup,
    /// Time from the sending of the last blobs to the reading of the poses.
    pub latency: Figures,
    /// Parts of the latency, by name.
    pub parts: Vec<(&'static str, Figures)>,
    /// Breakdown of the slowest thousandth of the triples into the same parts.
    pub slowest: SlowestFigures,
    /// Time from mid-exposure to the reading of the poses; the time before the blobs is that of the rig file.
    pub from_exposure: Figures,
    /// Delay of the feeder.
    pub feeder_late: Figures,
    /// Wake-up floor before the triples in real time and, unless the command was stopped, after them.
    pub floor: Vec<Figures>,
    /// Tool that measured the floor.
    pub floor_tool: String,
    /// The goal.
    pub goal: Goal,
    /// Requested number of triples in real time.
    pub asked: u64,
    /// True if the command was stopped before its end.
    pub stopped: bool,
    /// Counts of the triples in real time.
    pub real_time: Losses,
    /// Results at full speed, if requested.
    pub at_speed: Option<AtSpeed>,
    /// Static noise and range of motion of each body.
    pub bodies: Vec<BodyFigures>,
    /// Histogram of the latency.
    pub latency_histogram: Vec<Range>,
    /// Histogram of the wake-up latencies, before and after together.
    pub floor_histogram: Vec<Range>,
}

impl Report {
    /// Computes the figures. `asked`: requested triples in real time; `stopped`: the command ended early.
    pub fn of(
        setup: Setup,
        (read, late): (&Read, &Durations),
        (first, last): (&Floor, Option<&Floor>),
        at_speed: Option<AtSpeed>,
        (asked, stopped): (u64, bool),
    ) -> Self {
        let tally = &read.tally;
        let latency = Figures::of(&tally.latency);
        let floors = || std::iter::once(first).chain(last);
        let floor: Vec<Figures> = floors().map(|floor| Figures::of(&floor.late)).collect();
        // A disturbance in only one of the two measurements does not raise the floor.
        let found_ms = latency.p99_9_ms - floor.iter().map(|f| f.p99_9_ms).fold(f64::INFINITY, f64::min);
        let kept = tally.latency.count() > 0 && found_ms <= GOAL_MS;
        let named = PARTS.into_iter().zip(tally.parts.iter().map(Figures::of));
        Report {
            format: FORMAT,
            setup,
            latency,
            parts: named.collect(),
            slowest: tally.slowest.figures(),
            from_exposure: Figures::of(&tally.from_exposure),
            feeder_late: Figures::of(late),
            floor,
            floor_tool: first.tool.clone(),
            goal: Goal { percentile: GOAL_PERCENTILE, above_floor_ms: GOAL_MS, found_ms, kept },
            asked,
            stopped,
            real_time: Losses::of(read),
            at_speed,
            bodies: tally.bodies(),
            latency_histogram: ranges(&tally.latency),
            floor_histogram: ranges(&floors().fold(Durations::default(), |all, floor| all.with(&floor.late))),
        }
    }

    /// Triples without poses, in real time and at full speed.
    pub fn drops(&self) -> u64 {
        self.real_time.drops + self.at_speed.map_or(0, |fast| fast.losses.drops)
    }
}

/// Maximum number of triples whose exposures fit between the machine's start, at which the clock is 0, and
/// now.
pub fn room_in_the_past(now: Nanos, period_ns: u64) -> u64 {
    (now / period_ns.max(1)).saturating_sub(2)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::certify::tally::Tally;
    use rig::Rig;

    /// A report with latencies of 0.2 ms and one of 3 ms, above a floor of 0.1 ms.
    pub fn report(drops: u64) -> Report {
        let triples = Triples::of(&Rig::parse(super::super::RIG, "a rig").unwrap(), 10);
        let mut tally = Tally::of(0, 2_000);
        tally.seen = 2_000 - drops;
        (0..1_999).for_each(|n| tally.latency.note(200_000, n));
        tally.latency.note(3_000_000, 1_999);
        let floors = [100_000, 900_000].map(|ns| {
            let mut late = Durations::default();
            (0..1_000).for_each(|n| late.note(ns, n));
            Floor { late, tool: "a loop".into() }
        });
        let [first, last] = &floors;
        let read = Read { tally, counts: ipc::Counts::default(), fields_refused: 0 };
        let rig = ("a <rig>".into(), 200.0);
        let setup =
            Setup::of(SystemTime::UNIX_EPOCH, rig, &triples, "ordinary", ("none was made", Some(0.04)));
        Report::of(setup, (&read, &Durations::default()), (first, Some(last)), None, (2_000, false))
    }

    #[test]
    fn the_goal_is_above_the_floor_and_the_longest_is_no_percentile() {
        let report = report(0);
        assert_eq!(report.latency.max_ms, 3.0);
        assert!((report.goal.found_ms - 0.1).abs() < 1e-3 && report.goal.kept, "{:?}", report.goal);
        assert_eq!((report.drops(), super::tests::report(2).drops()), (0, 2));
    }

    #[test]
    fn ranges_hold_every_duration_once() {
        let mut durations = Durations::default();
        let noted = [1, 900, 1_000, 20_000, 20_000, 7_000_000, 900_000_000];
        noted.iter().enumerate().for_each(|(n, ns)| durations.note(*ns, n as u64));
        let found = ranges(&durations);
        assert_eq!(found.iter().map(|range| range.count).sum::<u64>(), noted.len() as u64, "{found:?}");
        assert!(found.windows(2).all(|pair| pair[0].to_ms == pair[1].from_ms));
        assert!(found[0].count > 0 && found.last().unwrap().count > 0);
        assert_eq!(ranges(&Durations::default()), []);
    }

    #[test]
    fn the_past_has_room_since_the_machine_began() {
        assert_eq!(room_in_the_past(5_000_000_000, 5_000_000), 998);
        assert_eq!(room_in_the_past(1, 5_000_000), 0);
    }
}
