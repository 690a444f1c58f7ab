//! The recorder: a separate thread behind a bounded queue, so that a slow, full or hung disk delays nothing
//! else. Items that do not fit the queue are counted, and the gap is recorded as a note.
//!
//! While the disk is full, the thread takes no items and retries; the items that it holds are written as soon
//! as there is space. The thread is not joined, so a write that never returns delays neither the report nor
//! the exit of the program.

pub mod files;

use super::report::RecordingFigures;
use anyhow::Context;
use files::RecordingFiles;
use ipc::clock::now;
use protocol::time::Nanos;
use recording::{Item, Note, NoteKind, PartsWriter, Provenance, RecordingError, Writer};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tokio::time::timeout;

/// Capacity of the queue, items: about 15 s of a run.
const QUEUE: usize = 8192;
/// Maximum time between two checks for a due chunk.
const CHUNK_CHECK: Duration = Duration::from_millis(40);
/// Time between two attempts to write while the disk refuses.
const RETRY: Duration = Duration::from_millis(100);
/// Writes slower than this are reported.
const STALL: Duration = Duration::from_secs(1);
/// Timeout for writing the queued items at the end of a run.
const FINISH: Duration = Duration::from_secs(3);

/// A writer of items. After an error it keeps the item, and [`Store::keep_up`] retries.
trait Store: Send + 'static {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError>;
    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError>;
    fn finish(&mut self) -> Result<(), RecordingError>;
    /// Number of items that were given to the store and are not yet in the file.
    fn unwritten(&self) -> u64;
    fn bytes(&self) -> u64;
    /// How long written bytes have been waiting to reach the disk.
    fn sync_lag(&self) -> Duration;
    /// Number of files begun.
    fn parts(&self) -> u32 {
        1
    }
    /// A warning about the files, which is returned once.
    fn take_warning(&mut self) -> Option<String> {
        None
    }
}

impl Store for Writer {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError> {
        Writer::write(self, at, item)
    }

    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError> {
        Writer::flush_aged(self, now)
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        Writer::end(self)
    }

    fn unwritten(&self) -> u64 {
        Writer::unwritten(self)
    }

    fn bytes(&self) -> u64 {
        Writer::bytes(self)
    }

    fn sync_lag(&self) -> Duration {
        Writer::sync_lag(self)
    }
}

impl Store for PartsWriter {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError> {
        PartsWriter::write(self, at, item)
    }

    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError> {
        PartsWriter::flush_aged(self, now)
    }

    fn finish(&mut self) -> Result<(), RecordingError> {
        PartsWriter::end(self)
    }

    fn unwritten(&self) -> u64 {
        PartsWriter::unwritten(self)
    }

    fn bytes(&self) -> u64 {
        PartsWriter::bytes(self)
    }

    fn sync_lag(&self) -> Duration {
        PartsWriter::sync_lag(self)
    }

    fn parts(&self) -> u32 {
        self.number()
    }

    fn take_warning(&mut self) -> Option<String> {
        PartsWriter::take_warning(self)
    }
}

/// A recording in progress.
pub struct Recorder {
    files: RecordingFiles,
    /// `None` once the thread has ended.
    queue: Option<SyncSender<(Nanos, Item)>>,
    ended: oneshot::Receiver<()>,
    thread: thread::Thread,
    gap: Gap,
    /// Number of queued items.
    queued: u64,
    progress: Arc<Progress>,
}

/// Counts missing items until a note about them has been recorded.
#[derive(Debug, Default)]
struct Gap {
    open: u64,
    total: u64,
}

/// State of the thread, which can be read without waiting for the thread.
#[derive(Default)]
struct Progress(Mutex<State>);

#[derive(Default)]
struct State {
    /// Current operation on the file, and its start.
    busy: Option<(&'static str, Instant)>,
    /// Current write error, and its start.
    trouble: Option<(String, Instant)>,
    sync_lag: Duration,
    /// Number of items in the file.
    written: u64,
    /// Number of the thread's own notes, written or not.
    own_notes: u64,
    bytes: u64,
    parts: u32,
    /// No further items will be queued.
    ending: bool,
    /// Note about the last gap, to be written at the end.
    last_note: Option<(Nanos, Item)>,
    /// Why the file could not be closed.
    failure: Option<String>,
    finished: bool,
}

impl Progress {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Why nothing is written at the moment; `None` if all is well.
    fn stall(&self, file: &Path) -> Option<String> {
        let file = file.display();
        if let Some((what, since)) = self.busy.filter(|(_, since)| since.elapsed() >= STALL) {
            return Some(format!("blocked in {what} {file} for {:.0} s", since.elapsed().as_secs_f64()));
        }
        if let Some((problem, _)) = &self.trouble {
            return Some(problem.clone());
        }
        let lag = self.sync_lag;
        (lag >= STALL).then(|| format!("the disk has not confirmed {file} for {:.0} s", lag.as_secs_f64()))
    }
}

impl Recorder {
    /// Starts the thread that writes the recording.
    ///
    /// # Errors
    /// If the file cannot be written, or the thread cannot be started.
    pub fn start(files: RecordingFiles, provenance: &Provenance) -> anyhow::Result<Self> {
        if let Some(mut writer) = files.parts_writer(provenance)? {
            writer.sync_along()?;
            return Self::with(files, writer, QUEUE);
        }
        let mut writer = files.writer(provenance)?;
        writer.sync_along()?;
        Self::with(files, writer, QUEUE)
    }

    /// Gives the file its final name, once the recorded run has begun.
    ///
    /// # Errors
    /// If a file of that name was created in the meantime.
    pub fn appear(&mut self) -> anyhow::Result<()> {
        self.files.appear()
    }

    fn with(files: RecordingFiles, store: impl Store, capacity: usize) -> anyhow::Result<Self> {
        let (queue, items) = sync_channel(capacity);
        let (end, ended) = oneshot::channel();
        let progress = Arc::new(Progress::default());
        let own = Arc::clone(&progress);
        let work = move || {
            Thread { items, store, progress: own, taken: 0 }.work();
            let _ = end.send(());
        };
        let started = thread::Builder::new().name("recorder".into()).spawn(work);
        let thread = started.context("start the recorder")?.thread().clone();
        let gap = Gap::default();
        Ok(Recorder { files, queue: Some(queue), ended, thread, gap, queued: 0, progress })
    }

    /// Queues an item, without waiting. If the queue is full, the item is lost and counted.
    pub fn offer(&mut self, at: Nanos, item: Item) {
        let Some(queue) = &self.queue else {
            self.gap.total += 1;
            return;
        };
        if self.gap.open > 0 && queue.try_send((at, self.gap.note(at))).is_ok() {
            self.gap.open = 0;
            self.queued += 1;
        }
        match queue.try_send((at, item)) {
            Ok(()) => self.queued += 1,
            Err(TrySendError::Full(_)) => {
                self.gap.open += 1;
                self.gap.total += 1;
            }
            Err(TrySendError::Disconnected(_)) => {
                self.gap.total += 1;
                self.queue = None;
            }
        }
    }

    /// Number of items lost so far.
    pub fn lost(&self) -> u64 {
        self.gap.total
    }

    /// Why nothing is written at the moment; `None` if all is well.
    pub fn problem(&self) -> Option<String> {
        let stopped = self.queue.is_none().then(|| "the recorder stopped".to_owned());
        stopped.or_else(|| self.progress.lock().stall(self.files.name()))
    }

    /// Lets the thread write the queued items and close the file, for at most [`FINISH`]. Returns the figures
    /// of the recording.
    pub async fn finish(mut self) -> RecordingFigures {
        {
            let mut state = self.progress.lock();
            let at = now();
            state.last_note = (self.gap.open > 0).then(|| (at, self.gap.note(at)));
            self.queued += u64::from(state.last_note.is_some());
            state.ending = true;
        }
        self.queue = None;
        self.thread.unpark();
        let in_time = timeout(FINISH, &mut self.ended).await.is_ok();
        let state = self.progress.lock();
        let missing = (self.queued + state.own_notes).saturating_sub(state.written);
        let problem = match &state.failure {
            Some(failure) => Some(failure.clone()),
            None if state.finished => None,
            None if in_time => Some("the recorder failed".into()),
            None => {
                let why = state.stall(self.files.name()).unwrap_or_else(|| "the disk is slow".into());
                Some(format!("the recorder did not finish: {why}; {missing} items are not in the file"))
            }
        };
        RecordingFigures {
            file: self.files.name().display().to_string(),
            items: state.written,
            lost: self.gap.total + missing,
            bytes: state.bytes,
            parts: self.files.is_split().then_some(state.parts),
            problem,
        }
    }
}

impl Gap {
    /// A note about the missing items.
    fn note(&self, instant_ns: Nanos) -> Item {
        let text = format!("{} items did not fit the recorder's queue", self.open);
        Item::Note(Note::loss(instant_ns, self.open, text))
    }
}

/// State that belongs to the thread.
struct Thread<S> {
    items: Receiver<(Nanos, Item)>,
    store: S,
    progress: Arc<Progress>,
    /// Number of items given to the store.
    taken: u64,
}

impl<S: Store> Thread<S> {
    /// Writes items until the queue is closed and the file is closed, or the run has ended and the disk still
    /// refuses.
    fn work(mut self) {
        loop {
            if self.progress.lock().trouble.is_some() {
                thread::park_timeout(RETRY);
                let last = self.progress.lock().ending;
                if let (Err(problem), true) = (self.attempt("writing", |store| store.keep_up(now())), last) {
                    return self.give_up(&problem);
                }
                continue;
            }
            // The error is reported in the state while it lasts, and the write is retried.
            let _ = match self.items.recv_timeout(CHUNK_CHECK) {
                Ok((at, item)) => self.take(at, &item),
                Err(RecvTimeoutError::Timeout) => self.attempt("writing", |store| store.keep_up(now())),
                Err(RecvTimeoutError::Disconnected) => return self.end(),
            };
        }
    }

    fn take(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError> {
        self.taken += 1;
        let done = self.attempt("writing", |store| {
            store.write(at, item)?;
            store.keep_up(now())
        });
        if let Some(warning) = self.store.take_warning() {
            self.note(warning);
        }
        done
    }

    /// Runs an operation on the file, and publishes its start and result.
    fn attempt(
        &mut self,
        what: &'static str,
        act: impl FnOnce(&mut S) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        self.progress.lock().busy = Some((what, Instant::now()));
        let done = act(&mut self.store);
        let mut state = self.progress.lock();
        state.busy = None;
        state.written = self.taken - self.store.unwritten();
        (state.bytes, state.sync_lag) = (self.store.bytes(), self.store.sync_lag());
        state.parts = self.store.parts();
        let before = state.trouble.take();
        match &done {
            Ok(()) => {
                drop(state);
                if let Some((problem, since)) = before {
                    self.note_outage(&problem, since.elapsed());
                }
            }
            Err(problem) => {
                let since = before.map_or_else(Instant::now, |(_, since)| since);
                state.trouble = Some((problem.to_string(), since));
            }
        }
        done
    }

    /// Writes a note about an outage into the recording. If the disk refuses the note, the next attempt
    /// writes it.
    fn note_outage(&mut self, problem: &str, length: Duration) {
        self.note(format!("nothing could be written for {:.1} s: {problem}", length.as_secs_f64()));
    }

    /// Writes a note of the thread's own.
    fn note(&mut self, text: String) {
        let note = Note { instant_ns: now(), kind: NoteKind::Log, process: None, count: 0, text };
        self.taken += 1;
        self.progress.lock().own_notes += 1;
        let _ = self.store.write(note.instant_ns, &Item::Note(note));
    }

    fn end(mut self) {
        let last_note = self.progress.lock().last_note.take();
        if let Some((at, note)) = last_note {
            let _ = self.take(at, &note);
        }
        match self.attempt("ending", S::finish) {
            Ok(()) => self.progress.lock().finished = true,
            Err(problem @ RecordingError::NotSafe { .. }) => {
                self.progress.lock().failure = Some(problem.to_string());
            }
            Err(problem) => self.give_up(&problem),
        }
    }

    /// Gives up: the file ends with its last complete chunk.
    fn give_up(self, problem: &RecordingError) {
        let text = format!("{problem}; the file could not be closed (vitreo recover repairs it)");
        self.progress.lock().failure = Some(text);
    }
}

#[cfg(test)]
mod tests;
