//! A blob stream through assembler and tracker, on the stream's own clock.

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::report::Report;
use crate::tracker::Tracker;
use crate::tuning::Tuning;
use protocol::blobs::BlobField;
use protocol::matches::MatchFrame;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;

/// Tracks camera-fields in the order of their arrival; the time is the newest `blobs_out_ns`. It logs nothing: what a
/// tracker suspects of a rig is said by the command that asked, and most ask with several rigs.
pub struct StreamTracker {
    assembler: FrameAssembler,
    tracker: Tracker,
    /// `None` where nothing is logged.
    log: Option<Report>,
    now_ns: Nanos,
}

impl StreamTracker {
    /// For a checked rig.
    pub fn new(rig: &Rig) -> Self {
        Self::tuned(rig, &Tuning::default())
    }

    /// As [`StreamTracker::new`], with other constants.
    pub fn tuned(rig: &Rig, tuning: &Tuning) -> Self {
        let (assembler, tracker) = (FrameAssembler::new(rig), Tracker::tuned(rig, true, tuning));
        StreamTracker { assembler, tracker, log: None, now_ns: 0 }
    }

    /// The same, logging what it suspects of the rig.
    pub fn logging(mut self) -> Self {
        self.log = Some(Report::default());
        self
    }

    /// Takes the next field, and hands every frame that it closes to `visit`, with the fields that the
    /// frame used, how it was closed and what became of the blobs. A refused field is only counted.
    pub fn push(&mut self, field: &BlobField, mut visit: impl Visit) {
        self.now_ns = self.now_ns.max(field.blobs_out_ns);
        while let Some(closed) = self.assembler.expired(self.now_ns) {
            self.track(&closed, &mut visit);
        }
        let _ = self.assembler.push(field, self.now_ns);
        while let Some(closed) = self.assembler.complete(self.now_ns) {
            self.track(&closed, &mut visit);
        }
    }

    /// The tracker.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Fields refused since the start.
    pub fn refused(&self) -> u32 {
        self.assembler.refused()
    }

    /// Ends the stream: frames that wait for fields are made without them.
    pub fn finish(&mut self, mut visit: impl Visit) {
        while let Some(closed) = self.assembler.flush(self.now_ns) {
            self.track(&closed, &mut visit);
        }
    }

    fn track(&mut self, closed: &ClosedFrame, visit: &mut impl Visit) {
        let used = self.assembler.used();
        let frame = self.tracker.track(used, &closed.reference);
        if let Some(log) = &mut self.log {
            log.log(&mut self.tracker, frame.field);
        }
        visit(frame, used, closed, self.tracker.matches());
    }
}

/// What is done with a frame.
pub trait Visit: FnMut(TrackerFrame, &[BlobField], &ClosedFrame, &MatchFrame) {}
impl<F: FnMut(TrackerFrame, &[BlobField], &ClosedFrame, &MatchFrame)> Visit for F {}

/// Tracks a whole stream and hands every frame with the fields it used to `visit`.
pub fn track_stream(rig: &Rig, fields: &[BlobField], mut visit: impl FnMut(&TrackerFrame, &[BlobField])) {
    let mut stream = StreamTracker::new(rig);
    let mut visit =
        |frame: TrackerFrame, used: &[BlobField], _: &ClosedFrame, _: &MatchFrame| visit(&frame, used);
    fields.iter().for_each(|field| stream.push(field, &mut visit));
    stream.finish(visit);
}

#[cfg(test)]
mod tests;
