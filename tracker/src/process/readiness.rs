//! Being ready when fields come. Between two frames other programs use the processor: what tracking needs has left the
//! caches by then, and a process that rests is woken late. So, shortly before the next fields are due, the process
//! wakes, tracks the frame before once more in a tracker of its own, for the sake of the caches alone, and then looks
//! for the fields without resting. No pose depends on it: the rehearsing tracker shares nothing with the one that
//! tracks.
//!
//! It takes about `ahead` of a processor per frame, which is given up only where the process has the real-time
//! scheduler: without it another program would be preferred in just this time.

use crate::tracker::{Reference, Tracker};
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::limits::MAX_FIELDS_USED;
use protocol::phases::Unmarked;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;

/// Of the period of frames, at most this part is spent on being ready.
const LEAST_PERIODS: u64 = 6;
/// How long after the instant at which they are due fields are looked for without resting, ns. Those that come later
/// wake the process as any message does.
const LATE_NS: u64 = 150_000;
/// The delay of fields follows the least one at once, and a longer one by this part of the difference each frame.
const FORGET: u64 = 64;

/// When fields are due, and the tracker that rehearses.
pub(super) struct Readiness {
    rehearsing: Option<Box<Tracker>>,
    frame: Box<TrackerFrame>,
    /// The newest frame's fields.
    fields: Vec<BlobField>,
    reference: Reference,
    /// From frame to frame, ns.
    period_ns: u64,
    /// How long before fields are due the process wakes, ns; 0: it does not.
    ahead_ns: u64,
    /// From the exposure of a frame until it was complete, about the least of the newest ones, ns.
    delay_ns: u64,
    /// When the next frame is due; 0 where nothing is known of it.
    due_ns: Nanos,
    rehearsed: bool,
}

impl Readiness {
    /// For the tracker of a rig with this period, `ahead_ns` before fields are due; never with 0.
    pub(super) fn new(tracker: &Tracker, period_ns: u64, ahead_ns: u64) -> Self {
        let ahead_ns = ahead_ns.min(period_ns / LEAST_PERIODS);
        Readiness {
            rehearsing: (ahead_ns > 0).then(|| Box::new(tracker.clone())),
            frame: Box::new(TrackerFrame::zeroed()),
            fields: Vec::with_capacity(MAX_FIELDS_USED),
            reference: Reference { camera: 0, field: 0, exposed_ns: 0 },
            period_ns,
            ahead_ns,
            delay_ns: u64::MAX,
            due_ns: 0,
            rehearsed: false,
        }
    }

    /// A frame was complete at `taken_ns`, and was tracked in `tracking_ns`. Where that was long, as it is while bodies
    /// are searched for, the next one is not rehearsed: the fields would wait for the rehearsal.
    pub(super) fn note(
        &mut self,
        used: &[BlobField],
        reference: &Reference,
        taken_ns: Nanos,
        tracking_ns: u64,
    ) {
        if self.ahead_ns == 0 {
            return;
        }
        let delay_ns = taken_ns.saturating_sub(reference.exposed_ns);
        let later = delay_ns.saturating_sub(self.delay_ns) / FORGET;
        self.delay_ns = delay_ns.min(self.delay_ns.saturating_add(later));
        self.due_ns = reference.exposed_ns + self.period_ns + self.delay_ns;
        self.rehearsed = tracking_ns > self.ahead_ns;
        self.reference = *reference;
        self.fields.clear();
        self.fields.extend_from_slice(used);
    }

    /// When to wake, if the next frame has yet to be prepared.
    pub(super) fn wake_ns(&self) -> Option<Nanos> {
        (self.due_ns > 0).then(|| self.due_ns - self.ahead_ns)
    }

    /// True from the wake-up on, until fields are late: then they are looked for without resting. The first call
    /// rehearses.
    pub(super) fn prepare(&mut self, now: Nanos) -> bool {
        if self.due_ns == 0 || now + self.ahead_ns < self.due_ns {
            return false;
        }
        if now > self.due_ns + LATE_NS {
            self.due_ns = 0;
            return false;
        }
        if !std::mem::replace(&mut self.rehearsed, true) {
            self.rehearse();
        }
        true
    }

    fn rehearse(&mut self) {
        let Some(tracker) = &mut self.rehearsing else { return };
        tracker.track_into(&mut self.frame, &self.fields, &self.reference, &mut Unmarked);
        tracker.follow_up(&self.fields);
    }
}

#[cfg(test)]
mod tests;
