//! The figures of a certificate. Pure.

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

/// Of the JSON file.
pub const FORMAT: &str = "vitreo-certificate-1";
/// The goal: so much above the floor, both at this percentile.
pub const GOAL_MS: f64 = 0.5;
/// Percentile of the goal.
pub const GOAL_PERCENTILE: f64 = 99.9;
/// Bins of a histogram to a factor of ten.
const BINS: i32 = 10;

/// Figures of durations, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// How many.
    pub count: u64,
    /// Arithmetic mean.
    pub mean_ms: f64,
    /// Half are no longer.
    pub p50_ms: f64,
    /// Percentiles.
    pub p99_ms: f64,
    /// Percentiles.
    pub p99_9_ms: f64,
    /// The longest.
    pub max_ms: f64,
}

impl Figures {
    /// Of durations that were noted.
    pub fn of(durations: &Durations) -> Self {
        let [p50_ms, p99_ms, p99_9_ms, max_ms] =
            [50.0, 99.0, GOAL_PERCENTILE, 100.0].map(|p| durations.at_ms(p));
        Figures { count: durations.count(), mean_ms: durations.mean_ms(), p50_ms, p99_ms, p99_9_ms, max_ms }
    }
}

/// How often durations of a range came.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Longer than this, ms.
    pub from_ms: f64,
    /// Up to this, ms.
    pub to_ms: f64,
    /// How often.
    pub count: u64,
}

/// The ranges in which durations lie, ten to a factor of ten; adjoining, from the shortest to the longest. The first
/// one has all that is shorter.
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

/// What became of the triples of one stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Losses {
    /// Sent, and counted.
    pub triples: u64,
    /// Without poses that the subscriber could read.
    pub drops: u64,
    /// Whose poses came before all of their fields were in.
    pub incomplete: u64,
    /// Blocks that were overwritten in the subscriber's queue, or not valid.
    pub blocks_lost: u64,
    /// Fields that the tracker refused.
    pub fields_refused: u64,
}

impl Losses {
    /// Of what a subscriber read.
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

/// A stream that went as fast as it was tracked.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AtSpeed {
    /// What became of it.
    #[serde(flatten)]
    pub losses: Losses,
    /// Triples that were asked for.
    pub asked: u64,
    /// Triples a second.
    pub rate_hz: f64,
    /// Of these, from the tracker's having a triple until its poses are sent: on a processor that was not idle before.
    pub tracking: Figures,
}

/// What was measured on.
#[derive(Debug, Clone, Serialize)]
pub struct Setup {
    /// When: date and time (UTC, RFC 3339).
    pub began: String,
    /// Of this program.
    pub version: &'static str,
    /// The machine.
    pub machine: Machine,
    /// The rig file.
    pub rig: String,
    /// Its rate.
    pub field_hz: f64,
    /// Its cameras.
    pub cameras: usize,
    /// Their rates, from the slowest to the fastest.
    pub camera_hz: Vec<f64>,
    /// Markers that every camera sees.
    pub markers: usize,
    /// Noise of their centres.
    pub noise_px: f64,
    /// From the middle of the exposure until the blobs are sent: what the rig states.
    pub camera_ms: f64,
    /// Scheduling class of tracker, feeder, subscriber and floor.
    pub scheduling: String,
    /// What else the machine did.
    pub load: String,
    /// Share of the processors' time that the host of a virtual machine took while triples were sent in real time,
    /// percent; `None` where the system does not provide it.
    pub stolen_percent: Option<f64>,
}

impl Setup {
    /// Of a rig on this machine, measured from `began` on.
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

/// The goal, and whether it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Goal {
    /// Percentile of both.
    pub percentile: f64,
    /// What may lie between latency and the lower floor.
    pub above_floor_ms: f64,
    /// What does.
    pub found_ms: f64,
    /// Whether it is kept.
    pub kept: bool,
}

/// A certificate.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// [`FORMAT`].
    pub format: &'static str,
    /// What was measured on.
    pub setup: Setup,
    /// From the last blob sent to the pose read.
    pub latency: Figures,
    /// Its parts, by name.
    pub parts: Vec<(&'static str, Figures)>,
    /// What the slowest thousandth is made of, in the same parts.
    pub slowest: SlowestFigures,
    /// From the middle of the exposure; what lies before the blobs is what the rig states.
    pub from_exposure: Figures,
    /// How late the feeder itself was.
    pub feeder_late: Figures,
    /// The machine's own wake-ups, before and, where it was not stopped, afterwards.
    pub floor: Vec<Figures>,
    /// By what they were measured.
    pub floor_tool: String,
    /// The goal.
    pub goal: Goal,
    /// Triples that were to be sent in real time.
    pub asked: u64,
    /// Whether the command was stopped before its end.
    pub stopped: bool,
    /// In real time.
    pub real_time: Losses,
    /// At speed, where that was asked for.
    pub at_speed: Option<AtSpeed>,
    /// Static noise and range of motion.
    pub bodies: Vec<BodyFigures>,
    /// Of latencies.
    pub latency_histogram: Vec<Range>,
    /// Of the floor.
    pub floor_histogram: Vec<Range>,
}

impl Report {
    /// Sums up.
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
        // What disturbed only one of them is no floor.
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

    /// Triples without poses, in both streams.
    pub fn drops(&self) -> u64 {
        self.real_time.drops + self.at_speed.map_or(0, |fast| fast.losses.drops)
    }
}

/// Most triples that a stream of the past has room for: the clock began with the machine.
pub fn room_in_the_past(now: Nanos, period_ns: u64) -> u64 {
    (now / period_ns.max(1)).saturating_sub(2)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::certify::tally::Tally;
    use rig::Rig;

    /// Latencies of 0.2 ms and one of 3 ms above a floor of 0.1 ms.
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
