//! The recorder: writes on a thread for blocking work behind a bounded queue, so that a slow disk
//! delays nothing else. What does not fit the queue is counted, and the gap is recorded as a note.

use super::report::RecordingFigures;
use ipc::clock::now;
use outputs::GrowingFile;
use protocol::time::Nanos;
use recording::{Item, Note, Provenance, RecordingError, Writer};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::timeout;

/// Items that wait for the disk at most: about fifteen seconds of a run.
const QUEUE: usize = 8192;
/// Longest time until the writer looks whether a chunk is due.
const CHUNK_CHECK: Duration = Duration::from_millis(40);

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
    file: GrowingFile,
    /// `None` once nothing more can be written.
    queue: Option<Sender<(Nanos, Item)>>,
    task: JoinHandle<()>,
    gap: Gap,
    items: u64,
    /// Why writing ended early.
    failure: Arc<OnceLock<String>>,
}

/// Counts what is missing, until a note about it could be placed.
#[derive(Debug, Default)]
struct Gap {
    open: u64,
    total: u64,
}

impl Recorder {
    /// Starts writing. To be called within the runtime.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn start(file: GrowingFile, provenance: &Provenance) -> anyhow::Result<Self> {
        let writer = Writer::on(file.handle()?, file.path(), provenance)?;
        Ok(Self::with(file, writer, QUEUE))
    }

    /// Gives the file its name: what it records has begun.
    ///
    /// # Errors
    /// Where the name was taken meanwhile.
    pub fn appear(&mut self) -> anyhow::Result<()> {
        Ok(self.file.appear()?)
    }

    fn with(file: GrowingFile, store: impl Store, capacity: usize) -> Self {
        let (queue, items) = channel(capacity);
        let failure = Arc::new(OnceLock::new());
        let (kept, runtime) = (Arc::clone(&failure), Handle::current());
        let task = spawn_blocking(move || write_all(items, store, &runtime, &kept));
        Recorder { file, queue: Some(queue), task, gap: Gap::default(), items: 0, failure }
    }

    /// Offers an item; never waits.
    pub fn offer(&mut self, at: Nanos, item: Item) {
        let Some(queue) = &self.queue else {
            self.gap.total += 1;
            return;
        };
        if self.gap.open > 0 && queue.try_send((at, self.gap.note(at))).is_ok() {
            self.gap.open = 0;
            self.items += 1;
        }
        match queue.try_send((at, item)) {
            Ok(()) => self.items += 1,
            Err(TrySendError::Full(_)) => {
                self.gap.open += 1;
                self.gap.total += 1;
            }
            Err(TrySendError::Closed(_)) => {
                self.gap.total += 1;
                self.queue = None;
            }
        }
    }

    /// Items that did not reach the file so far.
    pub fn lost(&self) -> u64 {
        self.gap.total
    }

    /// Why nothing more is written, if so.
    pub fn problem(&self) -> Option<&str> {
        let stopped = self.queue.is_none();
        stopped.then(|| self.failure.get().map_or("the recorder stopped", String::as_str))
    }

    /// Writes what is queued, ends the file, and returns what became of it.
    pub async fn finish(mut self) -> RecordingFigures {
        if let (Some(queue), 1..) = (&self.queue, self.gap.open) {
            // The writer empties the queue; waiting is no harm now.
            let at = now();
            self.items += u64::from(queue.send((at, self.gap.note(at))).await.is_ok());
        }
        self.queue = None;
        let ended = self.task.await;
        let panicked = ended.err().map(|error| format!("the recorder failed: {error}"));
        RecordingFigures {
            file: self.file.path().display().to_string(),
            items: self.items,
            lost: self.gap.total,
            bytes: self.file.path().metadata().map_or(0, |m| m.len()),
            problem: self.failure.get().cloned().or(panicked),
        }
    }
}

impl Gap {
    /// A note about the items that are missing.
    fn note(&self, instant_ns: Nanos) -> Item {
        let text = format!("{} items did not fit the recorder's queue", self.open);
        Item::Note(Note::loss(instant_ns, self.open, text))
    }
}

/// Writes items until the queue is closed or the store fails. The reason is kept before the queue
/// goes, so that it is there when the queue is found closed.
fn write_all(
    mut items: Receiver<(Nanos, Item)>,
    store: impl Store,
    runtime: &Handle,
    failure: &OnceLock<String>,
) {
    if let Err(error) = write_items(&mut items, store, runtime) {
        let _ = failure.set(error.to_string());
    }
}

fn write_items(
    items: &mut Receiver<(Nanos, Item)>,
    mut store: impl Store,
    runtime: &Handle,
) -> Result<(), RecordingError> {
    loop {
        match runtime.block_on(async { timeout(CHUNK_CHECK, items.recv()).await }) {
            Ok(Some((at, item))) => store.write(at, &item)?,
            Ok(None) => return store.finish(),
            Err(_) => {}
        }
        store.keep_up(now())?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use outputs::Outputs;
    use protocol::handles::PedalState;
    use recording::NoteKind;
    use std::path::Path;
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
        (Recorder::with(Outputs::new(false).grow(Path::new("/dev/null")).unwrap(), store, 4), go, kept)
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_slow_disk_blocks_nobody_and_the_gap_is_noted() {
        let (mut recorder, go, kept) = slow(usize::MAX);
        (0..20).for_each(|seq| recorder.offer(seq, pedal(seq)));
        let lost = recorder.lost();
        assert!((15..=16).contains(&lost), "queue of four, at most one in the store: {lost}");
        drop(go);
        let figures = recorder.finish().await;
        assert_eq!((figures.lost, figures.problem), (lost, None));
        let kept = kept.lock().unwrap();
        let noted = kept.iter().filter_map(|i| match i {
            Item::Note(n) if n.kind == NoteKind::Loss => Some(n.count),
            _ => None,
        });
        assert_eq!(noted.sum::<u64>(), lost);
        assert_eq!(kept.len() as u64, figures.items);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_full_disk_ends_the_recording_not_the_run() {
        let (mut recorder, go, _) = slow(2);
        drop(go);
        (0..3).for_each(|seq| recorder.offer(seq, pedal(seq)));
        // The third write fails; from then on the queue is closed.
        while recorder.problem().is_none() {
            recorder.offer(9, pedal(9));
        }
        recorder.offer(10, pedal(10));
        let figures = recorder.finish().await;
        assert!(figures.problem.is_some() && figures.lost >= 2, "{figures:?}");
    }
}
