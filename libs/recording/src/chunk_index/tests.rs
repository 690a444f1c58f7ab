//! Where chunks stand: by the summary, by a scan, by instants, and in damaged files.

use super::*;
use crate::samples::any_item;
use crate::{Note, NoteKind, Provenance, Writer};
use proptest::prelude::*;
use protocol::steps::CheckpointHeader;

fn note(count: u64) -> Item {
    let text = "x".repeat(900);
    Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
}

fn checkpoint(step: u64) -> Item {
    let header = CheckpointHeader {
        step,
        field: step + 7,
        handles_below: 1,
        pedals_below: 2,
        state_hash: !step,
        bytes: 0,
    };
    // Larger than a chunk, and hardly to be packed.
    let state: Vec<u8> = (0..60_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    Item::Checkpoint(CheckpointHeader { bytes: state.len() as u64, ..header }, state)
}

/// A file with a checkpoint among every 40 notes; item `i` is of 1000 + i ns.
fn written(path: &Path) -> Vec<Item> {
    written_with(path, &Provenance::default())
}

fn written_with(path: &Path, provenance: &Provenance) -> Vec<Item> {
    let mut writer = Writer::create(path, provenance).unwrap();
    let items: Vec<_> = (0..400).map(|i| if i % 40 == 13 { checkpoint(i) } else { note(i) }).collect();
    (1000..).zip(&items).for_each(|(at, item)| writer.write(at, item).unwrap());
    writer.finish().unwrap();
    items
}

fn encoded(items: impl Iterator<Item = (Nanos, Item)>) -> Vec<(Nanos, Vec<u8>)> {
    items.map(|(at, item)| (at, item.encoded())).collect()
}

/// All that a file's index leads to is what reading it in order gives.
fn agrees(path: &Path) -> Result<ChunkIndex, TestCaseError> {
    let recording = Recording::open(path).unwrap();
    let index = recording.chunk_index().unwrap();
    let whole = encoded(recording.items().filter_map(Result::ok));
    for i in 0..index.chunks().len() {
        let from = recording.items_from(&index.place(i).unwrap());
        let rest = encoded(from.filter_map(Result::ok));
        prop_assert!(whole.ends_with(&rest), "from chunk {}", i);
        let at = index.chunks()[i].newest_ns;
        let later = whole.iter().position(|(time, _)| *time >= at).unwrap_or(whole.len());
        prop_assert!(whole.len() - rest.len() <= later || i > index.first_with(at));
    }
    prop_assert_eq!(index.first_with(u64::MAX), index.chunks().len());
    Ok(index)
}

/// The index without the summary.
fn scanned(recording: &Recording) -> ChunkIndex {
    let mut index = recording.empty_index();
    for file in recording.files.iter() {
        index.topics.push(Arc::default());
        scan(file, &mut index).unwrap();
    }
    index
}

#[test]
fn the_summary_says_what_a_scan_finds() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let items = written(&path);
    let recording = Recording::open(&path).unwrap();
    let (index, scanned) = (agrees(&path).unwrap(), scanned(&recording));
    assert!(recording.matches_checksum().unwrap());
    assert!(index.is_from_summary() && !scanned.is_from_summary());
    let of = |index: &ChunkIndex| {
        index.chunks().iter().map(|c| (c.newest_ns, c.topics)).filter(|c| c.1 > 0).collect::<Vec<_>>()
    };
    assert_eq!(of(&index), of(&scanned));
    let heads = |index: &ChunkIndex| {
        let heads = recording.checkpoint_heads(index).unwrap();
        heads.into_iter().map(|(_, head)| head).collect::<Vec<_>>()
    };
    let expected: Vec<_> = (1000..)
        .zip(&items)
        .filter_map(|(at, item)| match item {
            Item::Checkpoint(header, _) => Some((at, CheckpointHeader { bytes: 0, ..*header })),
            _ => None,
        })
        .collect();
    let found = heads(&index).into_iter().map(|head| (head.log_time_ns, head.header));
    assert!(found.eq(expected.iter().copied()) && expected.len() == 10);
    assert_eq!(heads(&index), heads(&scanned));
    let chunk = index.holding("checkpoints").nth(3).unwrap();
    let read = recording.items_of_chunk(&index, chunk, &["checkpoints"]).unwrap();
    assert_eq!(encoded(read.into_iter()), [(1133, items[133].encoded())]);
}

#[test]
fn places_are_found_by_instants_whatever_the_wall_clock_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let offset = 1_764_000_000_000_000_000_u64;
    let config = [(crate::REALTIME_OFFSET.to_string(), offset.to_string())].into();
    written_with(&path, &Provenance { config, ..Provenance::default() });
    let recording = Recording::open(&path).unwrap();
    for index in [agrees(&path).unwrap(), scanned(&recording)] {
        let chunks = index.chunks().len();
        let middle = index.first_with(1200);
        assert!(middle > 2 && middle < chunks - 2, "{middle} of {chunks}");
        let heads = recording.checkpoint_heads(&index).unwrap();
        assert_eq!(heads[3].1.log_time_ns, 1133);
    }
}

#[test]
fn a_file_that_was_not_closed_is_scanned() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    written(&path);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let index = agrees(&path).unwrap();
    assert!(!index.is_from_summary() && index.chunks().len() > 5);
}

/// Offsets and kinds of the records of a file.
fn records_in(bytes: &[u8]) -> Vec<(usize, u8)> {
    let (mut at, mut all) = (mcap::MAGIC.len(), Vec::new());
    while let Some(size) = bytes.get(at + 1..at + 9) {
        all.push((at, bytes[at]));
        at += 9 + u64::from_le_bytes(size.try_into().unwrap()) as usize;
    }
    all
}

/// Places in a file that was not closed lie before the indexes of the chunk before: one whose length is wrong
/// must not lead past the chunk that follows it.
#[test]
fn an_index_of_a_wrong_length_costs_no_chunk_to_who_begins_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    written(&path);
    let whole = std::fs::read(&path).unwrap();
    let (mut tried, records) = (0, records_in(&whole));
    for at in records.windows(4) {
        let [(_, before), (index, kind), (_, chunk), (end, _)] = *at else { unreachable!() };
        if [before, kind, chunk] == [op::MESSAGE_INDEX, op::MESSAGE_INDEX, op::CHUNK] {
            let mut bytes = whole[..end].to_vec();
            bytes[index + 2] ^= 1;
            std::fs::write(&path, &bytes).unwrap();
            agrees(&path).unwrap();
            tried += 1;
        }
    }
    assert!(tried > 10, "{tried} indexes");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]

    #[test]
    fn any_items_are_found_from_any_chunk(items in prop::collection::vec((0u64..50, any_item()), 0..40)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = Writer::create(&path, &Provenance::default()).unwrap();
        items.iter().for_each(|(at, item)| writer.write(*at, item).unwrap());
        writer.finish().unwrap();
        agrees(&path)?;
    }

    #[test]
    fn damage_never_panics_and_leaves_true_items(
        hits in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..5),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        written(&path);
        let mut bytes = std::fs::read(&path).unwrap();
        for (at, xor) in hits {
            let at = at.index(bytes.len());
            bytes[at] ^= xor;
        }
        cut.iter().for_each(|at| bytes.truncate(at.index(bytes.len())));
        std::fs::write(&path, &bytes).unwrap();
        let Ok(recording) = Recording::open(&path) else { return Ok(()) };
        prop_assert!(!recording.matches_checksum().unwrap());
        let index = agrees(&path)?;
        drop(recording.checkpoint_heads(&index));
        for i in 0..index.chunks().len() {
            drop(recording.items_of_chunk(&index, i, &["checkpoints"]));
        }
    }
}
