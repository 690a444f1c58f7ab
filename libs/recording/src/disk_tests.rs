//! Full, slow and failing disks under a writer.

use super::disk::{Carry, Medium};
use super::{Item, Note, NoteKind, Packing, Provenance, Recording, Writer};
use std::fs::File;
use std::io;
use std::sync::{Arc, Mutex, mpsc};

/// A disk that counts what is asked of it.
#[derive(Default)]
struct State {
    bytes: Vec<u8>,
    /// Bytes that it holds at most.
    room: usize,
    synced: Vec<usize>,
    closed: bool,
}

#[derive(Clone)]
struct Fake {
    state: Arc<Mutex<State>>,
    /// Receives each sync of the helper thread.
    told: mpsc::Sender<usize>,
}

impl Medium for Fake {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut state = self.state.lock().unwrap();
        let fits = bytes.len().min(state.room - state.bytes.len().min(state.room));
        state.bytes.extend_from_slice(&bytes[..fits]);
        if fits == bytes.len() { Ok(()) } else { Err(io::ErrorKind::StorageFull.into()) }
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.state.lock().unwrap().bytes.truncate(length as usize);
        Ok(())
    }

    fn syncing(&self) -> io::Result<Carry> {
        let own = self.clone();
        Ok(Box::new(move || {
            let length = own.state.lock().unwrap().bytes.len();
            own.state.lock().unwrap().synced.push(length);
            let _ = own.told.send(length);
            Ok(())
        }))
    }

    fn sync_all(&self) -> io::Result<()> {
        self.state.lock().unwrap().closed = true;
        Ok(())
    }

    fn scratch(&self) -> io::Result<File> {
        Err(io::ErrorKind::StorageFull.into())
    }
}

fn note(count: u64) -> Item {
    let text = format!("{count}: {}", "x".repeat(200));
    Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
}

fn fake(room: usize) -> (Writer, Arc<Mutex<State>>, mpsc::Receiver<usize>) {
    let state = Arc::new(Mutex::new(State { room, ..State::default() }));
    let (told, syncs) = mpsc::channel();
    let medium = Fake { state: Arc::clone(&state), told };
    let (path, provenance) = ("/full/a.mcap".into(), Provenance::default());
    let writer = Writer::begin(path, Box::new(medium), &provenance, Packing::default(), None).unwrap();
    (writer, state, syncs)
}

/// Closes the chunk that is open.
fn flush(writer: &mut Writer) -> Result<(), super::RecordingError> {
    writer.flush_aged(0)?;
    writer.flush_aged(1 << 40)
}

fn counts(state: &Mutex<State>) -> (bool, Vec<u64>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, &state.lock().unwrap().bytes).unwrap();
    let recording = Recording::open(&path).unwrap();
    let count = |item| match item {
        Ok((_, Item::Note(note))) => note.count,
        other => panic!("{other:?}"),
    };
    (recording.is_finished(), recording.items().map(count).collect())
}

#[test]
fn every_chunk_is_carried_to_the_disk_and_the_end_with_its_name() {
    let (mut writer, state, syncs) = fake(usize::MAX);
    writer.sync_along().unwrap();
    for i in 0..3 {
        writer.write(i, &note(i)).unwrap();
        flush(&mut writer).unwrap();
        let length = state.lock().unwrap().bytes.len();
        // Ends only if the chunk is carried to the disk without a further call.
        while syncs.recv().unwrap() < length {}
    }
    writer.finish().unwrap();
    let state = state.lock().unwrap();
    assert!(state.closed && state.synced.len() >= 3, "{:?}", state.synced);
}

#[test]
fn after_a_full_disk_the_recording_goes_on_where_it_was() {
    let (mut writer, state, _syncs) = fake(usize::MAX);
    writer.write(0, &note(0)).unwrap();
    flush(&mut writer).unwrap();
    let whole = state.lock().unwrap().bytes.len();
    state.lock().unwrap().room = whole + 20;
    writer.write(1, &note(1)).unwrap();
    let refused = flush(&mut writer).unwrap_err().to_string();
    assert_eq!(refused, "the disk is full: /full/a.mcap");
    assert_eq!(state.lock().unwrap().bytes.len(), whole, "nothing torn stays");
    assert_eq!((writer.unwritten(), writer.bytes()), (1, whole as u64));
    assert!(writer.flush_aged(2 << 40).is_err(), "still full");
    state.lock().unwrap().room = usize::MAX;
    writer.flush_aged(3 << 40).unwrap();
    writer.write(2, &note(2)).unwrap();
    writer.finish().unwrap();
    assert_eq!(counts(&state), (true, vec![0, 1, 2]));
}

#[test]
fn where_space_never_returns_the_file_ends_with_a_whole_chunk() {
    let (mut writer, state, _syncs) = fake(usize::MAX);
    writer.write(0, &note(0)).unwrap();
    flush(&mut writer).unwrap();
    let whole = state.lock().unwrap().bytes.len();
    state.lock().unwrap().room = whole + 99;
    writer.write(1, &note(1)).unwrap();
    writer.write(2, &note(2)).unwrap();
    assert!(writer.end().is_err());
    assert_eq!((writer.unwritten(), writer.bytes()), (2, whole as u64));
    assert_eq!(counts(&state), (false, vec![0]));
}
