//! The likely cause of what a recording's residuals show, for the end of a run or a replay: judged by its last
//! part, within bounds of time.

use crate::residuals::rig_of;
use calibration::causes::{Judgement, judge_what_breaks};
use protocol::blobs::BlobField;
use protocol::message::Message;
use protocol::time::Nanos;
use recording::{Item, Recording, RecordingError};
use rig::Rig;
use std::time::{Duration, Instant};

/// The part that is judged, s.
pub const LAST_S: f64 = 60.0;
/// Most camera-fields of it, of recordings whose stamps are odd.
const FIELDS: usize = 60_000;
/// Longest search at the end of a replay.
const WITHIN: Duration = Duration::from_secs(10);

/// A judgement of the last part of a recording.
#[derive(Debug)]
pub struct OfLast {
    /// The judgement, whose instants count from the part's begin.
    pub judgement: Judgement,
    /// The part's begin, s after the first exposure of the recording.
    pub starts_s: f64,
}

impl OfLast {
    /// For the end of a run; `None` where nothing is to be said.
    pub fn paragraph(&self) -> Option<String> {
        self.judgement.paragraph(self.starts_s)
    }
}

/// Judges the last `last_s` seconds of a recording, where its rig does not hold; `go_on` as of
/// [`calibration::causes::judge`].
///
/// # Errors
/// Where the recording cannot be read.
pub fn of_last(
    recording: &Recording,
    rig: &Rig,
    last_s: f64,
    go_on: impl Fn(usize, usize) -> bool + Sync,
) -> Result<OfLast, RecordingError> {
    let fields = last_fields(recording, last_s)?;
    let first = recording.exposures().next().unwrap_or(0);
    let starts = fields.iter().map(|field| field.exposed_ns).min().unwrap_or(first);
    let starts_s = starts.saturating_sub(first) as f64 * 1e-9;
    Ok(OfLast { judgement: judge_what_breaks(rig, &fields, go_on), starts_s })
}

/// What the end of a replay says of the recording it was of; `None` where nothing is to be said, also where there
/// are no blobs.
pub fn at_end(recording: &Recording, stopped: impl Fn() -> bool + Sync) -> Option<String> {
    let rig = rig_of(recording).ok()?;
    let until = Instant::now() + WITHIN;
    let found = of_last(recording, &rig, LAST_S, |_, _| !stopped() && Instant::now() < until);
    found.ok().filter(|_| !stopped()).and_then(|found| found.paragraph())
}

/// The camera-fields of the last seconds, in the order of arrival.
fn last_fields(recording: &Recording, last_s: f64) -> Result<Vec<BlobField>, RecordingError> {
    let chunks = recording.chunk_index()?;
    let of_chunk = |chunk| {
        let items = recording.items_of_chunk(&chunks, chunk, &[BlobField::CHANNEL]).unwrap_or_default();
        items.into_iter().filter_map(|(_, item)| field_of(item)).map(|f| f.exposed_ns).max()
    };
    let Some(end_ns) = chunks.holding(BlobField::CHANNEL).rev().find_map(of_chunk) else {
        return Ok(Vec::new());
    };
    let from_ns: Nanos = end_ns.saturating_sub((last_s * 1e9) as Nanos);
    let mut items = recording.items_of(&[BlobField::CHANNEL]);
    // Blocks are logged after their exposure.
    if let Some(place) = chunks.place(chunks.first_with(from_ns)) {
        items.go_to(&place.of_topics(&[BlobField::CHANNEL]));
    }
    let fields = items.flatten().filter_map(|(_, item)| field_of(item));
    Ok(fields.map(|field| *field).filter(|field| field.exposed_ns >= from_ns).take(FIELDS).collect())
}

fn field_of(item: Item) -> Option<Box<BlobField>> {
    match item {
        Item::Blobs(field) => Some(field),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_runs::golden;
    use recording::Writer;

    /// The golden recording with what `change` makes of its camera-fields.
    fn changed(change: impl Fn(&mut BlobField)) -> (tempfile::TempDir, Recording) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.mcap");
        let mut writer = Writer::create(&file, golden().provenance()).unwrap();
        for (at, mut item) in golden().items().map(Result::unwrap) {
            if let Item::Blobs(field) = &mut item {
                change(field);
            }
            writer.write(at, &item).unwrap();
        }
        writer.finish().unwrap();
        let recording = Recording::open(&file).unwrap();
        (folder, recording)
    }

    #[test]
    fn a_healthy_recording_says_nothing_and_swapped_cameras_are_said_with_the_remedy() {
        assert_eq!(at_end(&golden(), || false), None);
        let (_folder, swapped) = changed(|field| field.camera = [1, 0, 2][field.camera as usize]);
        let said = at_end(&swapped, || false).expect("a cause");
        for words in ["likely cause: the ids of cameras 0 and 1 are swapped", "from the start", "cables"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        assert_eq!(at_end(&swapped, || true), None, "nobody waits for it any more");
        let rig = rig_of(&swapped).unwrap();
        let left_off = of_last(&swapped, &rig, LAST_S, |tried, _| tried < 3).unwrap();
        assert!(left_off.paragraph().is_some_and(|said| said.contains("left off")), "{left_off:?}");
    }

    #[test]
    fn the_last_seconds_are_those_of_the_recording() {
        let all = last_fields(&golden(), 3600.0).unwrap();
        assert_eq!(all.len(), golden().items_of(&["blobs"]).count());
        let end_ns = all.iter().map(|f| f.exposed_ns).max().unwrap();
        let last = last_fields(&golden(), 0.5).unwrap();
        let expected: Vec<_> = all.iter().filter(|f| f.exposed_ns >= end_ns - 500_000_000).collect();
        assert!(last.len() > 60 && last.len() == expected.len(), "{} of {}", last.len(), expected.len());
    }
}
