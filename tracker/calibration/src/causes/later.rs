//! Later parts of a recording whose beginning holds: what begins there may leave less than a motion does, or the
//! camera that it spoils no longer takes part in frames, and neither shows in what the rest leaves.

use super::Cause;
use super::measure::{Left, SLICE_NS, START_NS, measure};
use super::remedy::{amended, undone};
use super::{places, work::Work};
use protocol::blobs::BlobField;
use protocol::time::Nanos;
use rig::Rig;

/// What a blob that measures no pose counts, px².
const STRANGER_PX2: f64 = 0.25;

/// Begins of the later stretches that are judged: of equal distance, one that reaches to the end, and the second half of
/// that one. In a stretch within which a clock steps, its camera takes part in a part of the frames, which looks right.
pub fn begins(fields: &[BlobField], stretch_ns: u64, work: &Work) -> Vec<Nanos> {
    let instants = || fields.iter().map(|f| f.exposed_ns);
    let (Some(begin), Some(end)) = (instants().min(), instants().max()) else { return Vec::new() };
    let room_ns = (end + 1 - begin).saturating_sub(stretch_ns);
    if room_ns < SLICE_NS {
        return Vec::new();
    }
    let count = room_ns.div_ceil(stretch_ns).min(work.later);
    let whole = (1..=count).map(|i| begin + room_ns / count * i);
    whole.chain([end - stretch_ns / 2]).collect()
}

/// The instant after `from` since when a cause is at work until `end`: the remedy takes away most from what follows it.
/// `None` where its remedy does not follow from it alone. `stretch` is what it was found by.
pub fn since(
    rig: &Rig,
    fields: &[BlobField],
    cause: &Cause,
    stretch: &[BlobField],
    [from, end]: [Nanos; 2],
) -> Option<Nanos> {
    let mended = mended(rig, stretch, cause)?;
    let taken = |at: Nanos| {
        let within = |f: &&BlobField| (at..at + START_NS + SLICE_NS).contains(&f.exposed_ns);
        let part: Vec<BlobField> = fields.iter().filter(within).copied().collect();
        shown(&measure(rig, &part)) - shown(&measure(&mended, &undone(rig, cause, &part)))
    };
    let last = end.saturating_sub(START_NS + SLICE_NS);
    let backwards = (0..).map(|n| last.saturating_sub(n * SLICE_NS)).take_while(|at| *at > from);
    let sums = backwards.scan(0.0, |sum, at| {
        *sum += taken(at);
        Some((at, *sum))
    });
    sums.filter(|(_, sum)| *sum > 0.0).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at)
}

/// Mean square that dates a cause, px². A blob that measures no pose counts little: a single one must not date a cause
/// that leaves next to nothing while nothing moves.
fn shown(left: &Left) -> f64 {
    let strangers = (left.all.count - left.explained.count) as f64;
    (left.explained.sum + STRANGER_PX2 * strangers) / left.all.count.max(1) as f64
}

/// The rig without a cause; `None` where it cannot be had from the cause alone.
pub fn mended(rig: &Rig, fields: &[BlobField], cause: &Cause) -> Option<Rig> {
    match cause {
        Cause::CameraMoved { .. } | Cause::MarkerMoved { .. } => places::moved(rig, fields, cause),
        Cause::CamerasMoved { .. }
        | Cause::Drifted
        | Cause::Scale { .. }
        | Cause::Lens { .. }
        | Cause::TimestampsJitter { .. } => None,
        _ => Some(amended(rig, cause)),
    }
}
