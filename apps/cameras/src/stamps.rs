//! When the pictures of a camera were read out, from its driver's stamps. Pure: clocks are arguments.
//!
//! A stamp is believed where it can be true: the picture was there within [`LATEST_NS`] after it, and it
//! is later than the one before. Stamps of the wall clock are brought to CLOCK_MONOTONIC, and those of a camera's own
//! clock, too ([`own_clock`]). The instants of a camera that keeps
//! its pace jitter by what its driver adds; a filter of second order takes that out, and what it takes out is
//! the jitter that is reported. Where a stamp is not believed, the instant at which the picture came counts.

pub mod own_clock;

use crate::device::{Stamp, StampClock};
use own_clock::OwnClock;
use protocol::time::Nanos;

/// A picture that is older than this when it comes was not stamped by the clock that is assumed, ns.
const LATEST_NS: u64 = 1_000_000_000;
/// So much later than its arrival a stamp may seem, ns.
const AHEAD_NS: u64 = 2_000_000;
/// Share of a deviation that is taken into the instant, once the filter has settled.
const GAIN: f64 = 1.0 / 16.0;
/// Largest difference of a camera's period from the rig's that the filter follows, as a share.
const LARGEST_DRIFT: f64 = 1e-3;
/// Deviations beyond this share of a period are no jitter: the camera has changed its pace.
const LOST_LOCK: f64 = 0.25;

/// A picture's timestamp and its clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    /// Its last line left the sensor.
    pub read_out_ns: Nanos,
    /// Its stamp differed by this from the pace of the camera, ns; `None` where there is none to compare with.
    pub jitter_ns: Option<u64>,
    /// Frames that the driver has lost before it.
    pub lost: u64,
    /// Its stamp could not be true.
    pub is_odd: bool,
}

/// The instants of one camera.
#[derive(Debug, Clone)]
pub struct Stamps {
    /// From one picture to the next, ns.
    period_ns: f64,
    /// From the beginning of the exposure until the last line has left the sensor, ns.
    after_start_ns: u64,
    /// The newest picture: the filter's instant, and what it says of the period's difference, ns.
    newest: Option<(f64, f64)>,
    /// Pictures since the filter began.
    count: u32,
    sequence: Option<u32>,
    own: OwnClock,
}

impl Stamps {
    /// Of a camera that brings a picture every `period_ns`.
    pub fn new(period_ns: u64, after_start_ns: u64) -> Self {
        Stamps {
            period_ns: period_ns as f64,
            after_start_ns,
            newest: None,
            count: 0,
            sequence: None,
            own: OwnClock::default(),
        }
    }

    /// Takes a picture that was there at `arrived`; the wall clock is `realtime_offset_ns` ahead of the
    /// monotonic one.
    pub fn take(&mut self, stamp: Stamp, sequence: u32, arrived: Nanos, realtime_offset_ns: u64) -> Taken {
        let lost = self.lost(sequence);
        let believed = self.believed(stamp, arrived, realtime_offset_ns);
        let read_out_ns = believed.unwrap_or(arrived);
        let (read_out_ns, jitter_ns) = self.filter(read_out_ns, arrived);
        Taken { read_out_ns, jitter_ns, lost, is_odd: believed.is_none() }
    }

    /// Passes over a damaged frame, whose instant counts for nothing; returns the frames that were lost before it.
    pub fn pass_over(&mut self, sequence: u32) -> u64 {
        self.lost(sequence)
    }

    /// Frames between this one and the one before, by the driver's count. A count that goes back was reset.
    fn lost(&mut self, sequence: u32) -> u64 {
        let before = self.sequence.replace(sequence);
        let ahead = before.map_or(1, |before| sequence.wrapping_sub(before));
        // Two fields of a frame share their count.
        if ahead < u32::MAX / 2 { u64::from(ahead.saturating_sub(1)) } else { 0 }
    }

    /// When the picture was read out by its stamp, where that can be.
    fn believed(&mut self, stamp: Stamp, arrived: Nanos, realtime_offset_ns: u64) -> Option<Nanos> {
        let span_ns = if stamp.is_start { self.after_start_ns } else { 0 };
        let monotonic = Some(stamp.ns);
        let wall = stamp.ns.checked_sub(realtime_offset_ns);
        let candidates = match stamp.clock {
            StampClock::Monotonic => [monotonic, None],
            StampClock::Unknown => [monotonic, wall],
            StampClock::Own => [self.own.instant(stamp.ns, arrived), None],
            StampClock::Copied => [None, None],
        };
        let read_out = candidates.into_iter().flatten().map(|ns| ns.saturating_add(span_ns));
        let can_be = |ns: &u64| *ns <= arrived + AHEAD_NS && ns.saturating_add(LATEST_NS) >= arrived;
        let mut read_out = read_out.filter(can_be);
        let newest = self.newest.map_or(0.0, |(at, _)| at);
        read_out.find(|&ns| ns as f64 > newest - 0.5 * self.period_ns)
    }

    /// The instant without its jitter, and the jitter.
    fn filter(&mut self, at: Nanos, arrived: Nanos) -> (Nanos, Option<u64>) {
        let Some((newest, drift)) = self.newest else {
            (self.newest, self.count) = (Some((at as f64, 0.0)), 1);
            return (at, None);
        };
        let periods = ((at as f64 - newest) / self.period_ns).round();
        let expected = newest + periods.max(1.0) * (self.period_ns + drift);
        let off = at as f64 - expected;
        if off.abs() > LOST_LOCK * self.period_ns {
            self.newest = Some((at as f64, 0.0));
            self.count = 1;
            return (at, Some(off.abs() as u64));
        }
        self.count = self.count.saturating_add(1);
        let gain = GAIN.max(1.0 / f64::from(self.count));
        let limit = LARGEST_DRIFT * self.period_ns;
        let slow = if gain > GAIN { 0.0 } else { GAIN * GAIN / 4.0 };
        let drift = (drift + slow * off).clamp(-limit, limit);
        // A picture is never read out after it came.
        let instant = (expected + gain * off).min(arrived as f64);
        self.newest = Some((instant, drift));
        (instant as Nanos, Some(off.abs() as u64))
    }
}

#[cfg(test)]
mod tests;
