//! The recorder: writes on a thread of its own behind a bounded queue, so that a slow disk blocks
//! nobody. What does not fit the queue is counted, and the gap is recorded as a note.

use super::report::RecordingFigures;
use ipc::clock::now;
use protocol::time::Nanos;
use recording::{Item, Note, NoteKind, Provenance, RecordingError, Writer};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Items that wait for the disk at most: about fifteen seconds of a run.
const QUEUE: usize = 8192;
/// Longest time without looking whether a chunk is due.
const LOOK: Duration = Duration::from_millis(40);

/// Anything that stores items.
trait Store: Send + 'static {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError>;
    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError>;
    fn finish(self) -> Result<(), RecordingError>;
}

impl Store for Writer {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError> {
        Writer::write(self, at, item)
    }

    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError> {
        Writer::flush_aged(self, now)
    }

    fn finish(self) -> Result<(), RecordingError> {
        Writer::finish(self)
    }
}

/// A recording that is being written.
pub struct Recorder {
    file: PathBuf,
    queue: Option<SyncSender<(Nanos, Item)>>,
    thread: Option<JoinHandle<Result<(), RecordingError>>>,
    gap: Gap,
    items: u64,
    problem: Option<String>,
}

/// Counts what is missing, until a note about it could be placed.
#[derive(Debug, Default)]
struct Gap {
    open: u64,
    total: u64,
}

impl Recorder {
    /// Creates the file and starts the thread.
    pub fn start(file: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        let writer = Writer::create(file, provenance)?;
        Ok(Self::with(file, writer, QUEUE))
    }

    fn with(file: &Path, store: impl Store, capacity: usize) -> Self {
        let (queue, items) = sync_channel(capacity);
        let thread = std::thread::spawn(move || write_all(&items, store));
        let (gap, file) = (Gap::default(), file.to_path_buf());
        Recorder { file, queue: Some(queue), thread: Some(thread), gap, items: 0, problem: None }
    }

    /// Offers an item; never waits.
    pub fn offer(&mut self, at: Nanos, item: Item) {
        let Some(queue) = &self.queue else {
            self.gap.total += 1;
            return;
        };
        if self.gap.open > 0 {
            let text = format!("{} items did not fit the recorder's queue", self.gap.open);
            let count = self.gap.open;
            let note = Note { instant_ns: at, kind: NoteKind::Loss, process: None, count, text };
            if queue.try_send((at, Item::Note(note))).is_ok() {
                self.gap.open = 0;
                self.items += 1;
            }
        }
        match queue.try_send((at, item)) {
            Ok(()) => self.items += 1,
            Err(TrySendError::Full(_)) => {
                self.gap.open += 1;
                self.gap.total += 1;
            }
            Err(TrySendError::Disconnected(_)) => {
                self.gap.total += 1;
                self.close();
            }
        }
    }

    /// Items that did not reach the file so far.
    pub fn lost(&self) -> u64 {
        self.gap.total
    }

    /// Why nothing more is written, if so.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn close(&mut self) {
        self.queue = None;
        let Some(thread) = self.thread.take() else { return };
        self.problem = match thread.join() {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(error.to_string()),
            Err(_) => Some("the recorder's thread panicked".into()),
        };
    }

    /// Writes what is queued, ends the file, and says what became of it.
    pub fn finish(mut self) -> RecordingFigures {
        if self.gap.open > 0 {
            // The thread empties the queue; waiting is no harm now.
            let (instant_ns, count) = (now(), self.gap.open);
            let text = format!("{count} items did not fit the recorder's queue");
            let note = Note { instant_ns, kind: NoteKind::Loss, process: None, count, text };
            if let Some(queue) = &self.queue {
                self.items += u64::from(queue.send((instant_ns, Item::Note(note))).is_ok());
            }
        }
        self.close();
        RecordingFigures {
            file: self.file.display().to_string(),
            items: self.items,
            lost: self.gap.total,
            bytes: std::fs::metadata(&self.file).map_or(0, |m| m.len()),
            problem: self.problem.take(),
        }
    }
}

fn write_all(items: &Receiver<(Nanos, Item)>, mut store: impl Store) -> Result<(), RecordingError> {
    loop {
        match items.recv_timeout(LOOK) {
            Ok((at, item)) => store.write(at, &item)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return store.finish(),
        }
        store.keep_up(now())?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::handles::PedalState;
    use std::sync::{Arc, Mutex, mpsc};

    /// Waits at each item for leave to go on, and keeps what it was given.
    struct Slow {
        leave: mpsc::Receiver<()>,
        kept: Arc<Mutex<Vec<Item>>>,
        full_after: usize,
    }

    impl Store for Slow {
        fn write(&mut self, _: Nanos, item: &Item) -> Result<(), RecordingError> {
            let _ = self.leave.recv();
            let mut kept = self.kept.lock().unwrap();
            if kept.len() == self.full_after {
                let problem = std::io::Error::from(std::io::ErrorKind::StorageFull);
                return Err(RecordingError::Io { file: "f".into(), problem });
            }
            kept.push(item.clone());
            Ok(())
        }

        fn keep_up(&mut self, _: Nanos) -> Result<(), RecordingError> {
            Ok(())
        }

        fn finish(self) -> Result<(), RecordingError> {
            Ok(())
        }
    }

    fn pedal(seq: u64) -> Item {
        Item::Pedal(PedalState { seq, ..PedalState::zeroed() })
    }

    fn slow(full_after: usize) -> (Recorder, mpsc::Sender<()>, Arc<Mutex<Vec<Item>>>) {
        let (go, leave) = mpsc::channel();
        let kept = Arc::new(Mutex::new(Vec::new()));
        let store = Slow { leave, kept: Arc::clone(&kept), full_after };
        (Recorder::with(Path::new("/nonexistent/x"), store, 4), go, kept)
    }

    #[test]
    fn a_slow_disk_blocks_nobody_and_the_gap_is_noted() {
        let (mut recorder, go, kept) = slow(usize::MAX);
        (0..20).for_each(|seq| recorder.offer(seq, pedal(seq)));
        let lost = recorder.lost();
        assert!((15..=16).contains(&lost), "queue of four, at most one in the store: {lost}");
        drop(go);
        let figures = recorder.finish();
        assert_eq!((figures.lost, figures.problem), (lost, None));
        let kept = kept.lock().unwrap();
        let noted = kept.iter().filter_map(|i| match i {
            Item::Note(n) if n.kind == NoteKind::Loss => Some(n.count),
            _ => None,
        });
        assert_eq!(noted.sum::<u64>(), lost);
        assert_eq!(kept.len() as u64, figures.items);
    }

    #[test]
    fn a_full_disk_ends_the_recording_not_the_run() {
        let (mut recorder, go, _) = slow(2);
        drop(go);
        (0..3).for_each(|seq| recorder.offer(seq, pedal(seq)));
        // The third write fails; from then on offers find nobody.
        while recorder.problem().is_none() {
            recorder.offer(9, pedal(9));
        }
        recorder.offer(10, pedal(10));
        let figures = recorder.finish();
        assert!(figures.problem.is_some() && figures.lost >= 2, "{figures:?}");
    }
}
