//! A whole blob stream through assembler and tracker, on the stream's own clock.

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::tracker::Tracker;
use protocol::blobs::BlobField;
use protocol::poses::TrackerFrame;
use protocol::rig::Rig;

/// Tracks `fields` in the order of their arrival and hands every frame with the fields it used to
/// `visit`. Time-outs follow the newest `blobs_out_ns`.
pub fn track_stream(rig: &Rig, fields: &[BlobField], mut visit: impl FnMut(&TrackerFrame, &[BlobField])) {
    let (mut assembler, mut tracker) = (FrameAssembler::new(rig), Tracker::new(rig));
    let mut now = 0;
    let mut close =
        |used: &[BlobField], closed: ClosedFrame| visit(&tracker.track(used, &closed.reference), used);
    for field in fields {
        now = field.blobs_out_ns.max(now);
        assembler.add(field, now, &mut close);
    }
    while let Some(closed) = assembler.flush(now) {
        close(assembler.used(), closed);
    }
}
