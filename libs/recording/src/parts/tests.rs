//! Parts read as one are the whole, whatever their limits; what is missing, swapped or of another recording is
//! named, and the rest is read.

use super::*;
use crate::{Note, NoteKind, Packing, Provenance, Recording, Writer};
use bytemuck::Zeroable;
use proptest::prelude::*;
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::time::Nanos;
use std::fs::{self, File};
use std::path::Path;

const PERIOD_NS: Nanos = 20_000_000;
/// Periods between two checkpoints.
const SAVED_EVERY: u64 = 100;

/// Files that have their names from their beginning.
struct Named;

impl PartFiles for Named {
    fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
        File::create(path).map_err(|problem| RecordingError::Io { file: path.display().to_string(), problem })
    }

    fn appear(&mut self, _: &Path) -> Result<(), RecordingError> {
        Ok(())
    }
}

fn provenance(rig: &str) -> Provenance {
    let config = [(crate::REALTIME_OFFSET.to_string(), "1764000000000000000".to_string())].into();
    Provenance { rig_json: rig.into(), scene_name: "peel".into(), config, ..Provenance::default() }
}

/// What a run of so many field periods records: inputs, some of which come late, frames, steps, checkpoints.
fn run(periods: u64) -> Vec<(Nanos, Item)> {
    let mut items = Vec::new();
    for n in 1..=periods {
        let exposed = n * PERIOD_NS;
        for camera in 0..2 {
            let mut field = BlobField { camera, field: n, exposed_ns: exposed, ..BlobField::zeroed() };
            (field.read_out_ns, field.blobs_out_ns) = (exposed + 1, exposed + 2);
            // That of the second camera is filed behind what consumed it.
            items.push((exposed + 2 + u64::from(camera) * 3_000_000, Item::Blobs(Box::new(field))));
        }
        let tool = Tool::Forceps as u32;
        let handle = HandleState { seq: n, instant_ns: exposed + 1, tool, ..HandleState::zeroed() };
        items.push((exposed + 1, Item::Handle(handle)));
        if n % 5 == 0 {
            items.push((
                exposed,
                Item::Pedal(PedalState { seq: n, instant_ns: exposed, ..PedalState::zeroed() }),
            ));
        }
        let mut frame = TrackerFrame { frame: n - 1, field: n, ..TrackerFrame::zeroed() };
        for body in &mut frame.bodies {
            body.world_from_body = protocol::geometry::Pose::IDENTITY;
        }
        (frame.instants.exposed, frame.instants.tracked) = (exposed, exposed + 4);
        items.push((exposed + 4, Item::Poses(Box::new(frame))));
        let mut step = StepRecord { step: n, field: n, frame: n - 1, ..StepRecord::zeroed() };
        (step.instants.exposed, step.instants.stepped) = (exposed, exposed + 6);
        items.push((exposed + 6, Item::Step(step)));
        if n % SAVED_EVERY == 1 {
            let state = vec![n as u8; 300];
            let bytes = state.len() as u64;
            let header = TrackerCheckpointHeader { frame: n - 1, field: n, exposed_ns: exposed, bytes };
            items.push((exposed + 5, Item::TrackerCheckpoint(header, state.clone())));
            let header = CheckpointHeader { step: n, field: n, bytes, ..CheckpointHeader::zeroed() };
            items.push((exposed + 7, Item::Checkpoint(header, state)));
        }
        if n % 40 == 7 {
            let note =
                Note { instant_ns: exposed, kind: NoteKind::Log, process: None, count: n, text: "n".into() };
            items.push((exposed + 8, Item::Note(note)));
        }
    }
    items.sort_by_key(|(at, _)| *at);
    items
}

fn written(base: &Path, limit: Limit, items: &[(Nanos, Item)], provenance: &Provenance) -> u32 {
    let first = File::create(part_file(base, 1)).unwrap();
    let files = Box::new(Named);
    let mut writer = PartsWriter::begin(base, first, provenance, Packing::Zstd, limit, files).unwrap();
    for (at, item) in items {
        writer.write(*at, item).unwrap();
        writer.flush_aged(*at).unwrap();
    }
    writer.end().unwrap();
    assert_eq!(writer.unwritten(), 0);
    let on_disk: u64 = parts_of(base).iter().map(|part| fs::metadata(part).unwrap().len()).sum();
    assert_eq!(writer.bytes(), on_disk);
    writer.number()
}

/// Log time and message of each item, or the problem.
fn told(recording: &Recording) -> Vec<Result<(Nanos, Vec<u8>), String>> {
    recording
        .items()
        .map(|item| item.map(|(at, item)| (at, item.encoded())).map_err(|e| e.to_string()))
        .collect()
}

fn expected(items: &[(Nanos, Item)]) -> Vec<Result<(Nanos, Vec<u8>), String>> {
    items.iter().map(|(at, item)| Ok((*at, item.encoded()))).collect()
}

/// That a recording holds these items, or where it does not.
#[track_caller]
fn holds(recording: &Recording, items: &[(Nanos, Item)]) {
    let (told, expected) = (told(recording), expected(items));
    if let Some(at) = (0..told.len().max(expected.len())).find(|at| told.get(*at) != expected.get(*at)) {
        let topic = items.get(at).map(|(at, item)| (at, item.topic()));
        let found = told.get(at).map(|item| item.as_ref().map(|(at, message)| (at, message.len())));
        panic!("item {at} of {} ({}): expected {topic:?}, found {found:?}", expected.len(), told.len());
    }
}

fn scratch() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let base = folder.path().join("run.mcap");
    (folder, base)
}

/// The number of problems, and the first.
fn problems(recording: &Recording) -> (usize, String) {
    let all: Vec<String> = told(recording).into_iter().filter_map(Result::err).collect();
    (all.len(), all.first().cloned().unwrap_or_default())
}

#[test]
fn parts_are_the_whole_from_every_place() {
    let (folder, base) = scratch();
    let items = run(700);
    assert_eq!(written(&base, Limit::Time(3_000_000_000), &items, &provenance("r")), 5);
    let names: Vec<_> = parts_of(&base).iter().map(|p| p.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, ["run.0001.mcap", "run.0002.mcap", "run.0003.mcap", "run.0004.mcap", "run.0005.mcap"]);
    let recording = Recording::open(&base).unwrap();
    assert!(recording.is_finished() && recording.matches_checksum().unwrap());
    assert_eq!(recording.provenance(), &provenance("r"));
    holds(&recording, &items);
    assert_eq!(recording.parts().len(), 5);
    // As one file has it.
    let whole = folder.path().join("whole.mcap");
    let mut writer = Writer::create(&whole, &provenance("r")).unwrap();
    items.iter().for_each(|(at, item)| writer.write(*at, item).unwrap());
    writer.finish().unwrap();
    let whole = Recording::open(&whole).unwrap();
    let heads = |recording: &Recording| {
        let index = recording.chunk_index().unwrap();
        recording.checkpoint_heads(&index).unwrap().into_iter().map(|(_, head)| head).collect::<Vec<_>>()
    };
    assert_eq!(heads(&recording), heads(&whole));
    assert_eq!(heads(&recording).len(), 7);
    // From any chunk and any item on, the rest follows.
    let index = recording.chunk_index().unwrap();
    let all = expected(&items);
    for chunk in 0..index.chunks().len() {
        let mut rest = recording.items_from(&index.place(chunk).unwrap());
        let first =
            rest.next().map(|item| item.map(|(at, item)| (at, item.encoded())).map_err(|e| e.to_string()));
        let left = rest.count() + usize::from(first.is_some());
        assert_eq!(first.as_ref(), all.get(all.len() - left), "from chunk {chunk}");
    }
    let mut reading = recording.items();
    for given in 0..all.len() {
        if given % 211 == 0 {
            let mut rest = recording.items();
            rest.go_to(&reading.place());
            assert_eq!(rest.count(), all.len() - given);
        }
        reading.next();
    }
    assert!(reading.bytes_read() > recording.bytes() / 2 && reading.bytes_read() <= recording.bytes());
}

#[test]
fn a_part_alone_begins_with_what_was_known_and_has_its_late_inputs() {
    let (_folder, base) = scratch();
    let items = run(700);
    written(&base, Limit::Time(3_000_000_000), &items, &provenance("r"));
    for number in 2..=5 {
        let part = Recording::open(&part_file(&base, number)).unwrap();
        assert!(part.is_finished() && part.matches_checksum().unwrap());
        assert_eq!(part.part().map(|part| part.number), Some(number));
        assert!(part.provenance().config[crate::CUT].contains("of run.mcap"));
        let own: Vec<Item> = part.items().map(|item| item.unwrap().1).collect();
        let (Item::Checkpoint(world, _), Item::TrackerCheckpoint(tracker, _)) = (&own[0], &own[1]) else {
            panic!("it begins with {} and {}", own[0].topic(), own[1].topic())
        };
        assert_eq!((world.field, world.step), (tracker.field, tracker.frame + 1));
        let fields: Vec<(u32, u64)> = own
            .iter()
            .filter_map(|i| if let Item::Blobs(f) = i { Some((f.camera, f.field)) } else { None })
            .collect();
        let frames = own.iter().filter_map(|i| if let Item::Poses(f) = i { Some(f.field) } else { None });
        let frames: Vec<u64> = frames.collect();
        assert_eq!(frames[0], tracker.field);
        // Every frame behind the checkpoint has both its fields, also the last ones.
        for field in &frames[1..] {
            assert!(fields.contains(&(0, *field)) && fields.contains(&(1, *field)), "part {number}, {field}");
        }
        let steps = own.iter().filter_map(|i| if let Item::Step(s) = i { Some(s.step) } else { None });
        let steps: Vec<u64> = steps.collect();
        assert!(steps[0] == world.step && steps.windows(2).all(|pair| pair[1] == pair[0] + 1));
        let newest = fields.iter().map(|(_, field)| *field).max().unwrap();
        assert!(newest <= frames[frames.len() - 1] + 1, "no field without its frame at the end");
    }
}

#[test]
fn a_missing_part_is_named_and_costs_no_other() {
    let items = run(700);
    for lost in 1..=5 {
        let (_folder, base) = scratch();
        written(&base, Limit::Time(3_000_000_000), &items, &provenance("r"));
        fs::remove_file(part_file(&base, lost)).unwrap();
        let recording = Recording::open(&base).unwrap();
        assert!(!recording.is_finished() && !recording.matches_checksum().unwrap());
        let (count, first) = problems(&recording);
        assert!(count == 1 && first.contains(&format!("run.000{lost}.mcap: is missing")), "{first}");
        // Each item that is left stands there once.
        let left: Vec<_> = told(&recording).into_iter().flatten().collect();
        assert!(left.len() < items.len() && left.len() > items.len() / 2);
        assert_eq!(recording.parts().iter().filter(|part| part.problem.is_some()).count(), 1);
        assert_eq!(recording.parts().len(), 5);
        // A place behind the gap, and one before it.
        let index = recording.chunk_index().unwrap();
        assert!(index.is_from_summary() && index.chunks().len() > 10);
        let from = recording.items_from(&index.place(0).unwrap());
        let problems = from.filter(Result::is_err).count();
        assert_eq!(problems, usize::from(lost > 1), "a gap before the place is not met");
    }
}

#[test]
fn foreign_damaged_empty_and_doubled_parts_are_told() {
    let items = run(700);
    let make = |base: &Path, rig: &str| written(base, Limit::Time(3_000_000_000), &items, &provenance(rig));
    let (folder, base) = scratch();
    make(&base, "r");
    let other = folder.path().join("other.mcap");
    make(&other, "r");
    let of_rig = folder.path().join("rig.mcap");
    make(&of_rig, "another rig");
    let second = part_file(&base, 2);
    let good = fs::read(&second).unwrap();
    let told_of = |bytes: &[u8], expected: &str| {
        fs::write(&second, bytes).unwrap();
        let (count, first) = problems(&Recording::open(&base).unwrap());
        assert!(
            count == 1 && first.contains("run.0002.mcap") && first.contains(expected),
            "{count}: {first}"
        );
    };
    told_of(&fs::read(part_file(&other, 2)).unwrap(), "another recording than");
    told_of(&fs::read(part_file(&other, 4)).unwrap(), "another recording than");
    told_of(&fs::read(part_file(&of_rig, 2)).unwrap(), "another recording than");
    told_of(b"", "is not an MCAP file");
    told_of(&good[..60], "ends before its provenance");
    fs::write(&second, &good).unwrap();
    // The same part under another name.
    fs::write(part_file(&base, 6), &good).unwrap();
    let (count, first) = problems(&Recording::open(&base).unwrap());
    assert!(count == 1 && first.contains("contains part 2, as does"), "{first}");
    fs::remove_file(part_file(&base, 6)).unwrap();
    // A file of its own is none of the parts.
    Writer::create(&part_file(&base, 6), &provenance("r")).unwrap().finish().unwrap();
    let (_, first) = problems(&Recording::open(&base).unwrap());
    assert!(first.contains("run.0006.mcap: is a separate recording"), "{first}");
    assert_eq!(whole_of(&part_file(&base, 6)), None);
    assert_eq!(whole_of(&second), Some(base.clone()));
    fs::remove_file(part_file(&base, 6)).unwrap();
    // Names that were exchanged do not matter.
    let third = part_file(&base, 3);
    fs::rename(&third, folder.path().join("t")).unwrap();
    fs::rename(&second, &third).unwrap();
    fs::rename(folder.path().join("t"), &second).unwrap();
    holds(&Recording::open(&base).unwrap(), &items);
}

#[test]
fn a_crash_in_a_part_leaves_the_others_whole() {
    let (_folder, base) = scratch();
    let items = run(700);
    let first = File::create(part_file(&base, 1)).unwrap();
    let limit = Limit::Time(3_000_000_000);
    let mut writer =
        PartsWriter::begin(&base, first, &provenance("r"), Packing::Zstd, limit, Box::new(Named)).unwrap();
    for (at, item) in items.iter().take_while(|(at, _)| *at < 9 * 1_000_000_000) {
        writer.write(*at, item).unwrap();
        writer.flush_aged(*at).unwrap();
    }
    assert_eq!(writer.number(), 3);
    drop(writer);
    for number in 1..=2 {
        let part = Recording::open(&part_file(&base, number)).unwrap();
        assert!(part.is_finished() && part.matches_checksum().unwrap(), "part {number}");
    }
    let recording = Recording::open(&base).unwrap();
    assert!(!recording.is_finished());
    let all = told(&recording);
    // At most the open chunk is lost.
    assert!(all.len() > items.iter().filter(|(at, _)| *at < 8_700_000_000).count());
    assert_eq!(all[..], expected(&items)[..all.len()]);
}

#[test]
fn where_no_part_can_be_made_the_present_one_goes_on() {
    struct Full;
    impl PartFiles for Full {
        fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
            let problem = std::io::ErrorKind::StorageFull.into();
            Err(RecordingError::Io { file: path.display().to_string(), problem })
        }

        fn appear(&mut self, _: &Path) -> Result<(), RecordingError> {
            Ok(())
        }
    }
    let (_folder, base) = scratch();
    let items = run(700);
    let first = File::create(part_file(&base, 1)).unwrap();
    let limit = Limit::Time(3_000_000_000);
    let mut writer =
        PartsWriter::begin(&base, first, &provenance("r"), Packing::Zstd, limit, Box::new(Full)).unwrap();
    let mut warnings = Vec::new();
    for (at, item) in &items {
        writer.write(*at, item).unwrap();
        warnings.extend(writer.take_warning());
    }
    writer.finish().unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("the disk is full"), "{warnings:?}");
    holds(&Recording::open(&base).unwrap(), &items);
}

#[test]
fn without_checkpoints_parts_begin_after_some_patience_and_are_the_whole() {
    let (_folder, base) = scratch();
    let mut items = run(1500);
    items.retain(|(_, item)| !matches!(item, Item::Checkpoint(..)));
    assert_eq!(written(&base, Limit::Time(3_000_000_000), &items, &provenance("r")), 3);
    holds(&Recording::open(&base).unwrap(), &items);
    let second = Recording::open(&part_file(&base, 2)).unwrap();
    assert!(!second.provenance().config.contains_key(crate::CUT));
}

#[test]
fn a_stream_is_split_anywhere() {
    let (_folder, base) = scratch();
    let mut items = run(300);
    items.retain(|(_, item)| matches!(item, Item::Blobs(_)));
    let source = crate::Source::Import;
    let provenance = Provenance { source, ..provenance("r") };
    assert_eq!(written(&base, Limit::Time(1_000_000_000), &items, &provenance), 6);
    holds(&Recording::open(&base).unwrap(), &items);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, failure_persistence: None, ..Default::default() })]

    #[test]
    fn any_limit_gives_parts_that_are_the_whole(
        time in prop::option::of(500u64..8_000),
        bytes in 100_000u64..400_000,
        periods in 1u64..330,
        lost in any::<prop::sample::Index>(),
    ) {
        let (_folder, base) = scratch();
        let items = run(periods);
        let limit = time.map_or(Limit::Bytes(bytes), |ms| Limit::Time(ms * 1_000_000));
        let number = written(&base, limit, &items, &provenance("r"));
        let recording = Recording::open(&base).unwrap();
        holds(&recording, &items);
        prop_assert_eq!(recording.parts().len(), number as usize);
        // Without one of them, what is left is a part of the whole, each item once.
        if number > 1 {
            fs::remove_file(part_file(&base, 1 + lost.index(number as usize) as u32)).unwrap();
            let left = Recording::open(&base).unwrap();
            prop_assert_eq!(problems(&left).0, 1);
            let all: std::collections::BTreeSet<Vec<u8>> = items.iter().map(|(_, item)| item.encoded()).collect();
            let left: Vec<_> = told(&left).into_iter().flatten().map(|(_, message)| message).collect();
            let once: std::collections::BTreeSet<_> = left.iter().cloned().collect();
            prop_assert_eq!(once.len(), left.len());
            prop_assert!(once.is_subset(&all));
        }
    }

    #[test]
    fn a_name_leads_to_its_part_and_back(name in "[a-z.0-9_ -]{1,12}", number in 1u32..=MOST_PARTS) {
        prop_assume!(name != "." && name != ".." && !name.ends_with('/'));
        let recording = Path::new("/some/folder").join(&name);
        prop_assume!(recording.file_name().is_some_and(|n| n == name.as_str()));
        let part = part_file(&recording, number);
        prop_assert_eq!(split_name(&part), Some((recording.clone(), number)));
        prop_assert!(part_file(&recording, number) < part_file(&recording, number + 1) || number == MOST_PARTS);
    }

    #[test]
    fn what_stands_in_the_metadata_is_read_or_refused(
        number in "[0-9]{0,6}|x",
        set in ".{0,10}",
        from in "([a-z-]{1,9}=?[0-9]{0,11} ?){0,4}",
    ) {
        let pairs = [(NUMBER, number), (SET, set), (FROM, from)].map(|(k, v)| (k.to_string(), v));
        if let Ok(Some(part)) = PartOf::of(&pairs.into()) {
            let again = PartOf::of(&part.pairs().into());
            prop_assert_eq!(again, Ok(Some(part)));
        }
    }
}

#[test]
fn what_parts_around_a_missing_one_hold_is_read_once() {
    let (_folder, base) = scratch();
    let items = run(400);
    // Shorter than what parts have in common, so the limit is not kept.
    let number = written(&base, Limit::Time(504_000_000), &items, &provenance("r"));
    assert!(number > 3);
    for lost in 1..=number {
        let path = part_file(&base, lost);
        let bytes = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        let left = told(&Recording::open(&base).unwrap());
        let mut seen = std::collections::BTreeSet::new();
        assert!(left.iter().flatten().all(|(_, message)| seen.insert(message)), "without part {lost}");
        assert!(seen.len() > items.len() / 3);
        fs::write(&path, bytes).unwrap();
    }
}
