//! The likely cause of what a recording's residuals show, for the end of a run or a replay: judged by its last
//! part, within bounds of work (not of time: repeated replays of a recording say the same).

use crate::residuals::rig_of;
use calibration::causes::{Judgement, Verdict, Work, judge_within};
use diagnosis::{Finding, Judged, Warning};
use outputs::progress::files_bar;
use protocol::blobs::BlobField;
use protocol::limits::MAX_CAMERAS;
use protocol::message::Message;
use protocol::time::Nanos;
use recording::{Item, Recording, RecordingError};
use rig::Rig;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// The part that is judged, s.
pub const LAST_S: f64 = 60.0;
/// How often a search looks whether it is to be stopped, and the stack of its thread, as large as the main one.
const STOP_CHECK: Duration = Duration::from_millis(50);
const STACK_BYTES: usize = 8 << 20;
/// Most camera-fields of it, of recordings whose stamps are odd.
const FIELDS: usize = 60_000;

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

    /// For a report; `None` if nothing is to be said, or the search was stopped.
    pub fn judged(&self) -> Option<Judged> {
        let concerned = |id: &u32| self.judgement.explanations.iter().any(|e| e.cause.concerns_camera(*id));
        let cameras = (0..MAX_CAMERAS as u32).filter(concerned).collect();
        self.warning().map(|warning| Judged { warning, cameras })
    }

    /// The cause and the remedy that the paragraph states; `None` if it names none.
    pub fn stated(&self) -> Option<Finding> {
        let is_explained = self.judgement.verdict == Verdict::Explained;
        self.warning().filter(|_| is_explained).map(|warning| warning.finding)
    }

    fn warning(&self) -> Option<Warning> {
        let judgement = &self.judgement;
        let (cause, remedy) = match judgement.verdict {
            Verdict::Explained => (judgement.named(), judgement.remedies()),
            Verdict::Unknown => (
                "no known cause explains it".into(),
                "record while both instruments are waved, then: vitreo calibrate drift RECORDING.mcap".into(),
            ),
            _ => return None,
        };
        if !judgement.is_reported() {
            return None;
        }
        let what = format!("reprojection residual {:.2} px RMS, above the noise", judgement.left_px);
        let finding = Finding { what, cause, remedy, subject: "rig".into() };
        Some(Warning { from_s: self.starts_s + judgement.since_s, to_s: None, finding })
    }
}

/// Judges the last `last_s` seconds of a recording; `go_on` as of
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
    let (fields, starts_s) = last_part(recording, last_s)?;
    Ok(OfLast { judgement: judge_within(rig, &fields, &Work::AT_END, go_on), starts_s })
}

/// The judgement at the end of a replay of the recording it was of; `None` if there are no cameras, or the
/// command was stopped, which ends it at once.
pub fn at_end(recording: &Recording, stopped: impl Fn() -> bool) -> Option<OfLast> {
    let rig = rig_of(recording).ok()?;
    let (fields, starts_s) = last_part(recording, LAST_S).ok()?;
    let (found, outcome) = mpsc::channel();
    let go_on = Arc::new(AtomicBool::new(true));
    let goes_on = Arc::clone(&go_on);
    let search = move || {
        let judgement = judge_within(&rig, &fields, &Work::AT_END, |_, _| goes_on.load(Ordering::Relaxed));
        // Nobody waits for it after a stop.
        let _ = found.send(judgement);
    };
    // An estimation may take seconds and cannot be stopped: it ends with the program.
    thread::Builder::new().stack_size(STACK_BYTES).spawn(search).ok()?;
    let bar = files_bar(0, "causes");
    let judgement = loop {
        if stopped() {
            go_on.store(false, Ordering::Relaxed);
            break None;
        }
        match outcome.recv_timeout(STOP_CHECK) {
            Err(RecvTimeoutError::Timeout) => bar.tick(),
            ended => break ended.ok(),
        }
    };
    bar.finish_and_clear();
    judgement.map(|judgement| OfLast { judgement, starts_s })
}

/// The camera-fields of the last seconds, and their begin, s after the first exposure.
fn last_part(recording: &Recording, last_s: f64) -> Result<(Vec<BlobField>, f64), RecordingError> {
    let fields = last_fields(recording, last_s)?;
    let first = recording.exposures().next().unwrap_or(0);
    let starts = fields.iter().map(|field| field.exposed_ns).min().unwrap_or(first);
    Ok((fields, starts.saturating_sub(first) as f64 * 1e-9))
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
        let healthy = at_end(&golden(), || false).expect("a judgement");
        assert!(healthy.paragraph().is_none() && healthy.warning().is_none(), "{healthy:?}");
        assert_eq!(healthy.stated(), None);
        let (_folder, swapped) = changed(|field| field.camera = [1, 0, 2][field.camera as usize]);
        let found = at_end(&swapped, || false).expect("a judgement");
        let said = found.paragraph().expect("a cause");
        let warning = found.warning().expect("a cause").finding;
        assert_eq!(found.stated().as_ref(), Some(&warning), "the paragraph has cause and remedy");
        assert!(
            warning.cause.contains("cameras 0 and 1") && warning.remedy.contains("cables"),
            "{warning:?}"
        );
        for words in ["likely cause: the ids of cameras 0 and 1 are swapped", "from the start", "cables"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        assert!(at_end(&swapped, || true).is_none(), "the command was stopped");
        let rig = rig_of(&swapped).unwrap();
        let left_off = of_last(&swapped, &rig, LAST_S, |tried, _| tried < 3).unwrap();
        assert!(left_off.paragraph().is_some_and(|said| said.contains("was stopped")), "{left_off:?}");
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
