//! Frames that should have been: one in every field period in which the cameras exposed. Pure.
//!
//! The cameras' numbers and the time between exposures together show what is missing. A jump of both
//! was never published; in a pause only time advances, and after a restart the numbers may start again.

use protocol::blobs::BlobField;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use std::collections::BTreeMap;

/// A frame is missing at the end of a run where fields are newer than the last one by more than this, ns;
/// what is younger is still under way.
const GRACE_NS: u64 = 200_000_000;

/// Frames that may be missing singly without being a loss: what a loaded machine leaves out now and then.
/// Half a second of them is as much as a silence that is named.
const TRACE: u64 = 25;
/// Longer runs may miss one frame in so many.
const TRACE_OF: u64 = 1000;

/// True if more frames are missing of those that should have been than a trace.
pub fn is_loss(missing: u64, due: u64) -> bool {
    missing > TRACE.max(due / TRACE_OF)
}

/// The newest field of a camera.
#[derive(Debug, Clone, Copy)]
struct Newest {
    field: u64,
    exposed_ns: Nanos,
    /// Fields that should have come.
    due: u64,
    /// Of them, those exposed after the newest frame.
    ahead: u64,
}

/// Counts frames and fields that should have been.
#[derive(Debug, Clone)]
pub struct Due {
    period_ns: u64,
    first_ns: Option<Nanos>,
    cameras: BTreeMap<u32, Newest>,
    /// Number, camera and exposure of the newest frame.
    last: Option<(u64, u32, Nanos)>,
    before: u64,
    between: u64,
    skipped: u64,
}

impl Due {
    /// With the field period of a rig, ns.
    pub fn new(period_ns: u64) -> Self {
        let (cameras, period_ns) = (BTreeMap::new(), period_ns.max(1));
        Due { period_ns, first_ns: None, cameras, last: None, before: 0, between: 0, skipped: 0 }
    }

    /// Takes a camera's field.
    pub fn note_field(&mut self, field: &BlobField) {
        let exposed_ns = field.exposed_ns;
        self.first_ns = Some(self.first_ns.map_or(exposed_ns, |first| first.min(exposed_ns)));
        let before = self.cameras.get(&field.camera).copied();
        let skipped = before.map_or(0, |b| {
            self.missing_between(b.exposed_ns, exposed_ns).min(field.field.saturating_sub(b.field + 1))
        });
        self.skipped += skipped;
        let [due, ahead] = before.map_or([0; 2], |b| [b.due, b.ahead]).map(|n| n + 1 + skipped);
        self.cameras.insert(field.camera, Newest { field: field.field, exposed_ns, due, ahead });
    }

    /// Takes a frame of the tracker.
    pub fn note_frame(&mut self, frame: &TrackerFrame) {
        let exposed_ns = frame.instants.exposed;
        match self.last {
            None => {
                let waited_ns = self.first_ns.map_or(0, |first| exposed_ns.saturating_sub(first));
                self.before = waited_ns / self.period_ns;
            }
            Some((field, camera, last_ns)) => {
                let by_time = self.missing_between(last_ns, exposed_ns);
                let by_number = frame.field.saturating_sub(field + 1);
                self.between += if camera == frame.camera { by_time.min(by_number) } else { by_time };
            }
        }
        self.last = Some((frame.field, frame.camera, exposed_ns));
        for camera in self.cameras.values_mut() {
            // A camera that exposes within the frame's period is not ahead of it; clocks vary a little.
            let ahead_ns = camera.exposed_ns.saturating_sub(exposed_ns);
            camera.ahead = (ahead_ns + self.period_ns / 20) / self.period_ns;
        }
    }

    /// Periods without an exposure between two exposures.
    fn missing_between(&self, from_ns: Nanos, to_ns: Nanos) -> u64 {
        let periods = (to_ns.saturating_sub(from_ns) + self.period_ns / 2) / self.period_ns;
        periods.saturating_sub(1)
    }

    /// Frames that should have been and are not.
    pub fn frames_missing(&self) -> u64 {
        let newest = |of: fn(&Newest) -> u64| self.cameras.values().map(of).max().unwrap_or(0);
        let Some((.., last_ns)) = self.last else { return newest(|c| c.due) };
        let late = newest(|c| c.exposed_ns).saturating_sub(last_ns) > GRACE_NS;
        self.before + self.between + if late { newest(|c| c.ahead) } else { 0 }
    }

    /// Of [`Due::frames_missing`] those that fields should have led to which were published: frames without
    /// a field are the cameras' loss.
    pub fn frames_withheld(&self) -> u64 {
        let skipped = self.skipped.div_ceil(self.cameras.len().max(1) as u64);
        self.frames_missing().saturating_sub(skipped)
    }

    /// Camera-fields that were never published: numbers that a camera skipped.
    pub fn fields_skipped(&self) -> u64 {
        self.skipped
    }

    /// Counts what is missing from here on only.
    pub fn begin_here(&mut self) {
        (self.before, self.between, self.skipped) = (0, 0, 0);
    }

    /// Forgets the fields after the newest frame, for the end of the evaluated part.
    pub fn end_here(&mut self) {
        self.cameras.values_mut().for_each(|camera| camera.exposed_ns = 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    const PERIOD_NS: u64 = 20_000_000;

    fn field(due: &mut Due, camera: u32, number: u64, at_ns: u64) {
        due.note_field(&BlobField { camera, field: number, exposed_ns: at_ns, ..BlobField::zeroed() });
    }

    fn frame(due: &mut Due, number: u64, at_ns: u64) {
        let mut frame = TrackerFrame { field: number, ..TrackerFrame::zeroed() };
        frame.instants.exposed = at_ns;
        due.note_frame(&frame);
    }

    /// Fields 10 to 109 of three cameras, and frames of those that `made` selects.
    fn run(made: impl Fn(u64) -> bool) -> u64 {
        let mut due = Due::new(PERIOD_NS);
        for n in 10..110 {
            (0..3)
                .for_each(|camera| field(&mut due, camera, n, n * PERIOD_NS + u64::from(camera) * 6_000_000));
            if made(n) {
                frame(&mut due, n, n * PERIOD_NS);
            }
        }
        due.frames_missing()
    }

    #[test]
    fn every_frame_that_a_field_should_have_led_to_counts() {
        assert_eq!(run(|_| true), 0);
        assert_eq!(run(|_| false), 100, "a tracker that withholds every frame");
        assert_eq!(run(|n| n < 60), 50, "or every one from some field on");
        assert_eq!(run(|n| n >= 25), 15, "or begins late");
        assert_eq!(run(|n| !(40..55).contains(&n) && n != 70), 16);
        assert_eq!(run(|n| n < 105), 0, "the last ones are under way");
    }

    #[test]
    fn more_than_a_trace_is_a_loss() {
        assert!(!is_loss(0, 0) && !is_loss(25, 100) && is_loss(26, 100));
        assert!(!is_loss(180, 180_000) && is_loss(181, 180_000), "of an hour");
    }

    #[test]
    fn frames_without_a_field_are_not_withheld() {
        let mut due = Due::new(PERIOD_NS);
        // The cameras pass over ten numbers, the tracker withholds three frames and dies for two fields.
        for n in (0..100).filter(|n| !(40..50).contains(n)) {
            (0..3).for_each(|camera| field(&mut due, camera, n, 1_000_000_000 + n * PERIOD_NS));
            if ![5, 17, 80, 90, 91].contains(&n) {
                frame(&mut due, n, 1_000_000_000 + n * PERIOD_NS);
            }
        }
        assert_eq!((due.frames_missing(), due.fields_skipped(), due.frames_withheld()), (15, 30, 5));
    }

    #[test]
    fn a_jump_of_numbers_and_time_was_published_by_nobody_and_a_pause_is_none() {
        let mut due = Due::new(PERIOD_NS);
        // Number, and periods since the start: a death of the cameras, a pause, numbers that start again.
        for (number, periods) in [(5, 0), (6, 1), (10, 5), (11, 105), (0, 106), (1, 107)] {
            field(&mut due, 0, number, 1_000_000_000 + periods * PERIOD_NS);
            frame(&mut due, number, 1_000_000_000 + periods * PERIOD_NS);
        }
        assert_eq!((due.frames_missing(), due.fields_skipped()), (3, 3));
    }

    #[test]
    fn what_is_missing_can_be_counted_from_anywhere_on() {
        let mut due = Due::new(PERIOD_NS);
        let mut missing = Vec::new();
        for n in (0..100).filter(|n| ![20, 21, 60].contains(n)) {
            field(&mut due, 0, n, 1_000_000_000 + n * PERIOD_NS);
            frame(&mut due, n, 1_000_000_000 + n * PERIOD_NS);
            if n == 40 {
                missing.push((due.frames_missing(), due.fields_skipped()));
                due.begin_here();
            }
        }
        missing.push((due.frames_missing(), due.fields_skipped()));
        assert_eq!(missing, [(2, 2), (1, 1)]);
    }

    #[test]
    fn what_was_not_looked_at_is_not_missing() {
        let mut due = Due::new(PERIOD_NS);
        (0..100).for_each(|n| field(&mut due, 0, n, 1_000_000_000 + n * PERIOD_NS));
        frame(&mut due, 0, 1_000_000_000);
        assert_eq!(due.frames_missing(), 99);
        due.end_here();
        assert_eq!(due.frames_missing(), 0);
    }
}
