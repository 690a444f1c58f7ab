//! Damage of every kind to small recordings: it is reported, or changes nothing.

use super::records::{Outer, Records};
use super::{Item, Note, NoteKind, Provenance, Recording, RecordingError, Writer, channel_numbers};
use mcap::records::op;
use protocol::handles::PedalState;
use protocol::time::Nanos;
use std::fs;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

const CHUNKS: u64 = 4;
const NOTES_IN_EACH: u64 = 3;

fn note(count: u64) -> Item {
    let text = format!("note {count} of a test");
    Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
}

fn provenance() -> Provenance {
    Provenance {
        rig_json: "{\"focal\": 1234.5}".into(),
        scene_name: "peel".into(),
        scene_toml: "[eye]\nradius_mm = 11.5\n".into(),
        seeds: [("cameras".into(), "7".into())].into(),
        ..Provenance::default()
    }
}

/// A recording of [`CHUNKS`] chunks with notes and a pedal.
fn recorded(path: &Path, finished: bool) {
    const APART_NS: u64 = 1_000_000_000;
    let mut writer = Writer::create(path, &provenance()).unwrap();
    for chunk in 0..CHUNKS {
        let at = chunk * APART_NS;
        (0..NOTES_IN_EACH).for_each(|i| writer.write(at, &note(NOTES_IN_EACH * chunk + i)).unwrap());
        let pedal = PedalState { seq: chunk, ..bytemuck::Zeroable::zeroed() };
        writer.write(at, &Item::Pedal(pedal)).unwrap();
        writer.flush_aged(at).unwrap();
        writer.flush_aged(at + APART_NS / 2).unwrap();
    }
    if finished {
        writer.finish().unwrap();
    }
}

type Read = (Provenance, bool, Vec<(Nanos, Vec<u8>)>);

/// What a reader gets that stops at the first problem.
fn read(path: &Path) -> Result<Read, RecordingError> {
    let recording = Recording::open(path)?;
    let items = recording.items().map(|item| item.map(|(at, item)| (at, item.encoded())));
    Ok((recording.provenance().clone(), recording.is_finished(), items.collect::<Result<_, _>>()?))
}

/// Changes every byte of `places` in every way of `changes`, one at a time.
fn flip_each(path: &Path, places: impl Iterator<Item = usize>, changes: &[u8]) {
    let (whole, bytes) = (read(path).unwrap(), fs::read(path).unwrap());
    let file = fs::File::options().write(true).open(path).unwrap();
    for at in places {
        for change in changes {
            file.write_all_at(&[bytes[at] ^ change], at as u64).unwrap();
            if let Ok(changed) = read(path) {
                let same = (&changed.0, &changed.2) == (&whole.0, &whole.2);
                assert!(same, "byte {at} changed by {change:#x} was not noticed");
            }
        }
        file.write_all_at(&bytes[at..=at], at as u64).unwrap();
    }
}

/// The outer records: offset, opcode, body.
fn outer(path: &Path) -> Vec<Outer> {
    let mut records = Records::open(path).unwrap();
    std::iter::from_fn(|| records.next_record().ok().flatten()).collect()
}

fn scratch() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    (folder, path)
}

#[test]
fn no_changed_byte_of_a_finished_recording_goes_unnoticed() {
    let (_folder, path) = scratch();
    recorded(&path, true);
    let data_end = outer(&path).iter().find(|o| o.opcode == op::DATA_END).unwrap().offset as usize;
    let length = fs::metadata(&path).unwrap().len() as usize;
    flip_each(&path, 0..data_end + 13, &[0x01, 0xff]);
    // The summary repeats the schemas at length.
    flip_each(&path, (data_end..length).step_by(61), &[0x10]);
    flip_each(&path, length - 37..length, &[0x01, 0xff]);
}

#[test]
fn no_changed_byte_of_a_crashed_recording_goes_unnoticed() {
    let (_folder, path) = scratch();
    recorded(&path, false);
    let length = fs::metadata(&path).unwrap().len() as usize;
    flip_each(&path, 0..length, &[0x01, 0x04, 0xff]);
}

#[test]
fn rig_and_scene_are_under_a_checksum() {
    let (_folder, path) = scratch();
    recorded(&path, true);
    let mut bytes = fs::read(&path).unwrap();
    let digit = bytes.windows(6).position(|w| w == b"1234.5").unwrap();
    bytes[digit] = b'2';
    fs::write(&path, &bytes).unwrap();
    let refused = Recording::open(&path).unwrap_err();
    assert!(
        matches!(&refused, RecordingError::Damaged { problem, .. } if problem.contains("rig")),
        "{refused}"
    );
    let in_doubt = Recording::open_in_doubt(&path).unwrap();
    assert!(in_doubt.doubt().is_some() && in_doubt.provenance().rig_json.contains("2234.5"));
}

#[test]
fn former_recordings_have_no_checksum_and_are_whole() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    let former = Recording::open(&data.join("corpus/peel.mcap")).unwrap();
    assert!(!former.has_checksum() && former.is_finished());
    assert!(former.items().all(|item| item.is_ok()));
    assert!(Recording::open(&data.join("golden/peel-2s.mcap")).unwrap().has_checksum(), "of this version");
}

/// Counts of the notes, and the problems.
fn salvaged(path: &Path) -> (Vec<u64>, Vec<String>) {
    let (mut counts, mut problems) = (Vec::new(), Vec::new());
    for item in Recording::open_in_doubt(path).unwrap().items() {
        match item {
            Ok((_, Item::Note(note))) => counts.push(note.count),
            Ok(_) => {}
            Err(problem) => problems.push(problem.to_string()),
        }
    }
    (counts, problems)
}

#[test]
fn a_wrong_opcode_or_length_of_a_chunk_is_told_and_costs_nothing() {
    let (_folder, path) = scratch();
    recorded(&path, true);
    let bytes = fs::read(&path).unwrap();
    let chunks: Vec<usize> =
        outer(&path).iter().filter(|o| o.opcode == op::CHUNK).map(|o| o.offset as usize).collect();
    // The first one holds the channels.
    assert_eq!(chunks.len() as u64, CHUNKS + 1);
    for chunk in chunks {
        for opcode in (0..=255).filter(|o| *o != op::CHUNK) {
            let mut changed = bytes.clone();
            changed[chunk] = opcode;
            fs::write(&path, &changed).unwrap();
            let (counts, problems) = salvaged(&path);
            assert!(counts.into_iter().eq(0..CHUNKS * NOTES_IN_EACH), "opcode {opcode:#x} at {chunk}");
            assert!(!problems.is_empty(), "opcode {opcode:#x} at {chunk}");
        }
        for byte in 0..64 {
            let mut changed = bytes.clone();
            changed[chunk + 1 + byte / 8] ^= 1 << (byte % 8);
            fs::write(&path, &changed).unwrap();
            let (counts, problems) = salvaged(&path);
            assert!(counts.into_iter().eq(0..CHUNKS * NOTES_IN_EACH), "length's bit {byte} at {chunk}");
            assert!(!problems.is_empty(), "length's bit {byte} at {chunk}");
        }
    }
}

#[test]
fn a_chunk_that_is_gone_costs_its_own_items() {
    let (_folder, path) = scratch();
    recorded(&path, true);
    let bytes = fs::read(&path).unwrap();
    let chunks: Vec<Outer> = outer(&path).into_iter().filter(|o| o.opcode == op::CHUNK).collect();
    for (i, chunk) in chunks.iter().enumerate() {
        let mut changed = bytes.clone();
        let from = chunk.offset as usize;
        changed[from..from + 9 + chunk.body.len()].fill(0x5a);
        fs::write(&path, &changed).unwrap();
        let (counts, problems) = salvaged(&path);
        let of_chunk = |count: &u64| i as u64 == 1 + count / NOTES_IN_EACH;
        let expected: Vec<u64> = (0..CHUNKS * NOTES_IN_EACH).filter(|count| !of_chunk(count)).collect();
        assert_eq!(counts, expected, "chunk {i}");
        assert!(problems[0].contains(&format!("byte {from}")), "{problems:?}");
        // Notes stand there twice; the first chunk holds no message.
        let missing = problems.iter().any(|p| p.contains("7 of 28 messages"));
        assert_eq!(missing, i > 0, "{problems:?}");
    }
}

#[test]
fn zeros_at_the_end_are_a_cut() {
    let (_folder, path) = scratch();
    recorded(&path, false);
    let mut bytes = fs::read(&path).unwrap();
    let end = bytes.len() as u64;
    bytes.extend([0; 10_000]);
    fs::write(&path, &bytes).unwrap();
    let problem = Recording::open(&path).unwrap().items().find_map(Result::err);
    assert!(
        matches!(problem, Some(RecordingError::Truncated { offset, .. }) if offset == end),
        "{problem:?}"
    );
}

#[test]
fn a_chunk_that_claims_gigabytes_is_refused_before_they_are_asked_for() {
    let (_folder, path) = scratch();
    recorded(&path, false);
    let bytes = fs::read(&path).unwrap();
    let chunk = outer(&path).iter().rfind(|o| o.opcode == op::CHUNK).unwrap().offset as usize;
    // Frame, times, then the size once unpacked.
    let mut changed = bytes.clone();
    changed[chunk + 9 + 16 + 3] = 0xff;
    fs::write(&path, &changed).unwrap();
    let (_, problems) = salvaged(&path);
    assert!(problems[0].contains("does not agree"), "{problems:?}");
}

#[test]
fn the_writers_channels_are_those_that_a_reader_assumes() {
    let (_folder, path) = scratch();
    recorded(&path, true);
    let summary = mcap::Summary::read(&fs::read(&path).unwrap()).unwrap().unwrap();
    for (id, topic) in channel_numbers().zip(Item::TOPICS) {
        assert_eq!(summary.channels[&id].topic, topic);
    }
}
