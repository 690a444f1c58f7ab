//! A tracker that goes on from a checkpoint or from a copy makes the same frames, to the bit; bytes that
//! are no checkpoint of its rig change nothing, and hurt nothing.

use blob_stream::BlobReader;
use proptest::prelude::*;
use protocol::blobs::BlobField;
use protocol::limits::MAX_CHECKPOINT_BYTES;
use rig::Rig;
use std::path::PathBuf;
use std::sync::LazyLock;
use tracker::assembler::FrameAssembler;
use tracker::checkpoint::CheckpointError;
use tracker::{Reference, Tracker};

/// Streams with all that a tracker meets: late and missing fields, false blobs, equal colours, tremor.
const STREAMS: [&str; 7] = ["async", "calib", "hard", "nominal", "samecol", "static", "tremor"];
/// First frame in which camera 1 is moved, so that it is left out and resected.
const MOVED_AT: usize = 15;
/// Frames that are tracked again.
const AGAIN: usize = 40;

struct Stream {
    rig: Rig,
    frames: Vec<(Vec<BlobField>, Reference)>,
}

fn stream(name: &str) -> Stream {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name);
    let rig = Rig::load(&folder.join("rig.json")).unwrap();
    let (mut assembler, mut frames) = (FrameAssembler::new(&rig), Vec::new());
    for field in BlobReader::open(&folder.join("blobs.jsonl")).unwrap() {
        let field = field.unwrap();
        let now = field.blobs_out_ns;
        let _ = assembler.push(&field, now);
        while let Some(closed) = assembler.complete(now) {
            frames.push((assembler.used().to_vec(), closed.reference));
        }
    }
    Stream { rig, frames }
}

/// The stream with the picture of camera 1 moved by 5 px.
fn moved(name: &str) -> Stream {
    let mut stream = stream(name);
    let fields = stream.frames[MOVED_AT..].iter_mut().flat_map(|(fields, _)| fields);
    for field in fields.filter(|f| f.camera == 1) {
        let count = field.count as usize;
        field.blobs[..count].iter_mut().for_each(|b| b.x_px += 5.0);
    }
    stream
}

/// What comes of some frames, to the bit.
fn told(tracker: &mut Tracker, frames: &[(Vec<BlobField>, Reference)]) -> Vec<Vec<u8>> {
    let told = frames.iter().map(|(fields, reference)| {
        let frame = tracker.track(fields, reference);
        let mut bytes = bytemuck::bytes_of(&frame).to_vec();
        let drift = tracker.drift().map(|d| (d.evidence.to_bits(), d.camera_rad.to_bits(), d.markers_mm));
        bytes.extend(format!("{drift:?} {:?}", (tracker.restarts(), tracker.blobs_refused())).bytes());
        bytes
    });
    told.collect()
}

fn notices(tracker: &mut Tracker) -> Vec<String> {
    std::iter::from_fn(|| tracker.take_notice()).map(|n| n.to_string()).collect()
}

/// Tracks up to `at`, then goes on three times: at once, from a copy, and as another tracker from a
/// checkpoint.
fn goes_on_alike(stream: &Stream, at: usize) -> Result<usize, TestCaseError> {
    let (before, after) = stream.frames.split_at(at);
    let after = &after[..after.len().min(AGAIN)];
    let mut tracker = Tracker::new(&stream.rig);
    told(&mut tracker, before);
    let (copy, mut bytes) = (tracker.snapshot(), Vec::new());
    tracker.save(&mut bytes).unwrap();
    let first = (told(&mut tracker, after), notices(&mut tracker));
    tracker.restore_snapshot(&copy);
    prop_assert!(first == (told(&mut tracker, after), notices(&mut tracker)), "frame {}: from a copy", at);
    let mut other = Tracker::new(&stream.rig);
    told(&mut other, &stream.frames[..at / 2]);
    other.restore(&bytes).unwrap();
    let mut again = Vec::new();
    other.save(&mut again).unwrap();
    prop_assert!(bytes == again, "frame {}: saved again", at);
    prop_assert!(first == (told(&mut other, after), notices(&mut other)), "frame {}: from bytes", at);
    Ok(bytes.len())
}

#[test]
fn every_stream_goes_on_to_the_same_bits_from_any_frame() {
    for name in STREAMS {
        for stream in [stream(name), moved(name)] {
            let mut random = 7u64;
            for at in [0, 1, MOVED_AT + 4].into_iter().chain((0..4).map(|_| {
                random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (random >> 33) as usize % stream.frames.len()
            })) {
                let bytes = goes_on_alike(&stream, at).unwrap_or_else(|e| panic!("{name}: {e}"));
                assert!(bytes < MAX_CHECKPOINT_BYTES / 4, "{name}: {bytes} bytes at frame {at}");
            }
        }
    }
}

#[test]
fn a_camera_that_is_being_resected_is_resected_on() {
    let stream = moved("async");
    let mut tracker = Tracker::new(&stream.rig);
    told(&mut tracker, &stream.frames[..MOVED_AT + 30]);
    let mut bytes = Vec::new();
    tracker.save(&mut bytes).unwrap();
    let mut other = Tracker::new(&stream.rig);
    other.restore(&bytes).unwrap();
    // What was not reported before is reported by the tracker that continues.
    let all = [tracker, other].map(|mut tracker| {
        told(&mut tracker, &stream.frames[MOVED_AT + 30..]);
        notices(&mut tracker)
    });
    assert_eq!(all[0], all[1]);
    assert!(all[0].iter().any(|n| n.contains("used again with a pose estimated")), "{all:?}");
}

#[test]
fn foreign_checkpoints_are_refused_and_change_nothing() {
    let stream = stream("nominal");
    let mut tracker = Tracker::new(&stream.rig);
    told(&mut tracker, &stream.frames[..60]);
    let mut bytes = Vec::new();
    tracker.save(&mut bytes).unwrap();
    let mut refuse = |bytes: &[u8]| {
        let refused = tracker.restore(bytes).unwrap_err();
        let mut after = Vec::new();
        tracker.save(&mut after).unwrap();
        (refused, after)
    };
    for end in [0, 3, 12, 13, bytes.len() / 2, bytes.len() - 1] {
        let (refused, after) = refuse(&bytes[..end]);
        assert!(matches!(refused, CheckpointError::Damaged { .. }), "{refused}");
        assert!(after == bytes);
    }
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(refuse(&longer).0, CheckpointError::Content("bytes after its end"));
    let mut other = bytes.clone();
    other[0] = 9;
    assert_eq!(refuse(&other).0, CheckpointError::Version { found: 9 });
    let mut rig = stream.rig.clone();
    rig.trocars[0].p_eye[0] += 0.1;
    let mut tuning = tracker::Tuning::default();
    tuning.set("gate", 30.0).unwrap();
    let tuned = Tracker::tuned(&stream.rig, true, &tuning);
    for mut foreign in [Tracker::new(&rig), Tracker::with(&stream.rig, false), tuned] {
        assert!(matches!(foreign.restore(&bytes), Err(CheckpointError::Rig { .. })));
    }
}

#[test]
fn a_tracker_that_trusts_its_rig_goes_on_too() {
    let stream = stream("nominal");
    let mut tracker = Tracker::with(&stream.rig, false);
    told(&mut tracker, &stream.frames[..60]);
    let mut bytes = Vec::new();
    tracker.save(&mut bytes).unwrap();
    let mut other = Tracker::with(&stream.rig, false);
    other.restore(&bytes).unwrap();
    let after = &stream.frames[60..];
    assert!(told(&mut tracker, after) == told(&mut other, after));
}

/// A checkpoint with a camera left out, and the frames after it.
static SAVED: LazyLock<(Stream, Vec<u8>, Tracker)> = LazyLock::new(|| {
    let stream = moved("nominal");
    let mut tracker = Tracker::new(&stream.rig);
    told(&mut tracker, &stream.frames[..MOVED_AT + 30]);
    let mut bytes = Vec::new();
    tracker.save(&mut bytes).unwrap();
    let fresh = Tracker::new(&stream.rig);
    (stream, bytes, fresh)
});

/// A filter that stands an hour back would have to be predicted in half a million steps.
#[test]
fn a_filter_of_another_time_is_refused() {
    let (stream, bytes, fresh) = &*SAVED;
    // Exposures differ by frame, so that the newest one is found at its own place and in every filter.
    let newest = stream.frames[MOVED_AT + 29].1.exposed_ns;
    let places = (0..bytes.len() - 8).filter(|&at| bytes[at..at + 8] == newest.to_le_bytes());
    let mut refused = 0;
    for at in places {
        let mut old = bytes.clone();
        old[at..at + 8].copy_from_slice(&newest.wrapping_add(3_600_000_000_000).to_le_bytes());
        refused += u32::from(fresh.clone().restore(&old).is_err());
    }
    assert!(refused >= 4, "{refused}: the newest field's instant and three filters'");
}

/// Whoever takes the bytes tracks on, whatever comes of it.
fn survives(bytes: &[u8]) -> bool {
    let (stream, _, fresh) = &*SAVED;
    let mut tracker = fresh.clone();
    let taken = tracker.restore(bytes).is_ok();
    if taken {
        told(&mut tracker, &stream.frames[MOVED_AT + 30..MOVED_AT + 36]);
        tracker.save(&mut Vec::new()).unwrap();
    }
    taken
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..Default::default() })]

    #[test]
    fn random_frames_go_on_alike(at in any::<prop::sample::Index>()) {
        let (stream, ..) = &*SAVED;
        goes_on_alike(stream, at.index(stream.frames.len()))?;
    }

    #[test]
    fn flipped_bits_are_refused_or_survived(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0u8..8), 1..6),
    ) {
        let mut bytes = SAVED.1.clone();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        survives(&bytes);
    }

    #[test]
    fn numbers_of_any_size_are_refused_or_survived(
        number in prop::sample::select(vec![0, 1, u64::MAX, 1 << 61, 1e300f64.to_bits(), f64::NAN.to_bits()]),
        at in any::<prop::sample::Index>(),
    ) {
        let mut bytes = SAVED.1.clone();
        let at = at.index(bytes.len() - 8);
        bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
        survives(&bytes);
    }

    #[test]
    fn garbage_and_cut_bytes_are_refused(
        garbage in prop::collection::vec(any::<u8>(), 0..300), cut in any::<prop::sample::Index>(),
    ) {
        prop_assert!(!survives(&garbage));
        let bytes = &SAVED.1;
        prop_assert!(!survives(&bytes[..cut.index(bytes.len())]));
        // A true header, and then anything.
        prop_assert!(!survives(&[&bytes[..12], &garbage[..]].concat()));
    }
}

#[test]
fn what_was_saved_is_taken() {
    assert!(survives(&SAVED.1));
}
