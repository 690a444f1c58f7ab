//! A recorder runs for hours: its memory does not grow with its recording. Alone in its process,
//! because it measures that.

use recording::{Item, Note, NoteKind, Provenance, Recording, Writer};

/// Chunks of an hour, one each 83 ms.
const CHUNKS: u64 = 43_200;
/// The index of as many chunks takes 12 MB.
const MOST_KB: u64 = 3_000;

/// Private memory of this process, kB.
fn private_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("RssAnon");
    line.trim().trim_end_matches("kB").trim().parse().expect("a number")
}

#[test]
fn an_hour_of_recording_takes_no_memory() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("hour.mcap");
    let mut writer = Writer::create(&path, &Provenance::default()).expect("a recording");
    let mut begun = 0;
    for count in 0..CHUNKS {
        let at = count * 83_000_000;
        let note = Note { instant_ns: at, kind: NoteKind::Log, process: None, count, text: String::new() };
        writer.write(at, &Item::Note(note)).expect("room on the disk");
        // Once to see the open chunk, and once when it is old enough.
        [at, at + 82_000_000].into_iter().for_each(|now| writer.flush_aged(now).expect("room on the disk"));
        if count == CHUNKS / 60 {
            begun = private_kb();
        }
    }
    let grown = private_kb().saturating_sub(begun);
    writer.finish().expect("room on the disk");
    assert!(grown < MOST_KB, "{grown} kB in an hour");
    let chunks = mcap::Summary::read(&std::fs::read(&path).expect("the file")).expect("a summary");
    assert!(chunks.expect("a summary").chunk_indexes.len() as u64 > CHUNKS);
    assert_eq!(Recording::open(&path).expect("a recording").items().count() as u64, CHUNKS);
}
