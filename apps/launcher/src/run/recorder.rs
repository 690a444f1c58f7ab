//! The recorder: a separate thread behind a bounded queue, so that a slow, full or hung disk delays nothing
//! else. What does not fit the queue is counted, and the gap is recorded as a note.
//!
//! While the disk is full, the thread takes no further items and tries again; what it holds is
//! written as soon as there is space. It is a plain thread that is not joined: a write that never
//! returns delays neither the report nor the end of the program.

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

/// Items that wait for the disk at most: about fifteen seconds of a run.
const QUEUE: usize = 8192;
/// Longest time between checks for a due chunk.
const CHUNK_CHECK: Duration = Duration::from_millis(40);
/// Time between two attempts while the disk refuses.
const RETRY: Duration = Duration::from_millis(100);
/// A write that takes longer is reported.
const STALL: Duration = Duration::from_secs(1);
/// What is queued gets this long to be written when a run ends; with what else ends, a run is over
/// within 5 s of being asked to.
const FINISH: Duration = Duration::from_secs(3);

/// Anything that stores items. After an error it keeps the item, and `keep_up` tries again.
trait Store: Send + 'static {
    fn write(&mut self, at: Nanos, item: &Item) -> Result<(), RecordingError>;
    fn keep_up(&mut self, now: Nanos) -> Result<(), RecordingError>;
    fn finish(&mut self) -> Result<(), RecordingError>;
    /// Items that were given and are not on the file.
    fn unwritten(&self) -> u64;
    fn bytes(&self) -> u64;
    /// How long written bytes have been waiting for the disk.
    fn sync_lag(&self) -> Duration;
    /// Files that were begun.
    fn parts(&self) -> u32 {
        1
    }
    /// Facts about the files to report once.
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

/// A recording that is being written.
pub struct Recorder {
    files: RecordingFiles,
    /// `None` once the thread is gone.
    queue: Option<SyncSender<(Nanos, Item)>>,
    ended: oneshot::Receiver<()>,
    thread: thread::Thread,
    gap: Gap,
    /// Items that were queued.
    queued: u64,
    progress: Arc<Progress>,
}

/// Counts missing items until a note about them is recorded.
#[derive(Debug, Default)]
struct Gap {
    open: u64,
    total: u64,
}

/// Current operation of the thread, readable without waiting for it.
#[derive(Default)]
struct Progress(Mutex<State>);

#[derive(Default)]
struct State {
    /// Operation on the file and its start.
    busy: Option<(&'static str, Instant)>,
    /// Why nothing can be written now; since when.
    trouble: Option<(String, Instant)>,
    sync_lag: Duration,
    /// Items on the file.
    written: u64,
    /// Notes of the thread's own, on the file or not.
    own_notes: u64,
    bytes: u64,
    parts: u32,
    /// No further items come.
    ending: bool,
    /// A note about the last gap, to be written at the end.
    last_note: Option<(Nanos, Item)>,
    /// Why the file could not be ended.
    failure: Option<String>,
    finished: bool,
}

impl Progress {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Why nothing is written at the moment, if so.
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
    /// Starts writing.
    ///
    /// # Errors
    /// Where the file cannot be written, or a thread cannot be made.
    pub fn start(files: RecordingFiles, provenance: &Provenance) -> anyhow::Result<Self> {
        if let Some(mut writer) = files.parts_writer(provenance)? {
            writer.sync_along()?;
            return Self::with(files, writer, QUEUE);
        }
        let mut writer = files.writer(provenance)?;
        writer.sync_along()?;
        Self::with(files, writer, QUEUE)
    }

    /// Gives the file its final name once the recorded run has begun.
    ///
    /// # Errors
    /// Where the name was taken meanwhile.
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

    /// Offers an item; never waits.
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

    /// Items lost for the file up to now.
    pub fn lost(&self) -> u64 {
        self.gap.total
    }

    /// Why nothing is written at the moment, if so.
    pub fn problem(&self) -> Option<String> {
        let stopped = self.queue.is_none().then(|| "the recorder stopped".to_owned());
        stopped.or_else(|| self.progress.lock().stall(self.files.name()))
    }

    /// Lets what is queued be written and the file be ended, and returns what became of it, after
    /// three seconds at the latest.
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
    /// A note about the items that are missing.
    fn note(&self, instant_ns: Nanos) -> Item {
        let text = format!("{} items did not fit the recorder's queue", self.open);
        Item::Note(Note::loss(instant_ns, self.open, text))
    }
}

/// The thread's side.
struct Thread<S> {
    items: Receiver<(Nanos, Item)>,
    store: S,
    progress: Arc<Progress>,
    /// Items given to the store.
    taken: u64,
}

impl<S: Store> Thread<S> {
    /// Writes items until the queue is closed and the file ended, or the run is at its end and the
    /// disk still refuses.
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
            // An error is reported while it lasts; the write is retried.
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

    /// Runs an operation on the file and publishes its start and end.
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

    /// Writes a note about the outage into the recording. If the disk refuses it again, the next attempt
    /// writes it.
    fn note_outage(&mut self, problem: &str, length: Duration) {
        self.note(format!("nothing could be written for {:.1} s: {problem}", length.as_secs_f64()));
    }

    /// Writes a note of its own.
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

    /// The file ends with its last whole chunk.
    fn give_up(self, problem: &RecordingError) {
        let text = format!("{problem}; the file could not be closed (vitreo recover makes it whole)");
        self.progress.lock().failure = Some(text);
    }
}

#[cfg(test)]
mod tests;
