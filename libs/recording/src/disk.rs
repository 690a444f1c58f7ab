//! Where a recording's bytes go: whole pieces at the end of a file, and what becomes of them when the
//! disk is full, slow or loses its power.
//!
//! A piece (a chunk with its indexes) is on the file whole or not at all: what a failed write left of
//! it is cut off, and the piece waits for the next attempt. A [`Syncer`] carries what was written to
//! the platter on a thread of its own, because `fdatasync` may take as long as the disk likes.

use super::RecordingError;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Carries what was written to the disk.
pub(super) type Carry = Box<dyn FnMut() -> io::Result<()> + Send>;

/// A file, or what stands for one in tests.
pub(super) trait Medium: Send {
    /// Writes all of `bytes` at the end.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Makes the file `length` bytes long and goes on there.
    fn cut(&mut self, length: u64) -> io::Result<()>;
    /// What carries the data to the disk, for another thread.
    fn syncing(&self) -> io::Result<Carry>;
    /// Carries data and directory entry to the disk.
    fn sync_all(&self) -> io::Result<()>;
    /// An unnamed file on the same disk, which vanishes with the process.
    fn scratch(&self) -> io::Result<File>;
}

/// A file with the folder that names it.
pub(super) struct NamedFile {
    pub file: File,
    pub path: PathBuf,
}

impl Medium for NamedFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.file.set_len(length)?;
        self.file.seek(SeekFrom::Start(length)).map(|_| ())
    }

    fn syncing(&self) -> io::Result<Carry> {
        let (file, path) = (self.file.try_clone()?, self.path.clone());
        let mut named = false;
        Ok(Box::new(move || {
            confirmed(file.sync_data())?;
            if !std::mem::replace(&mut named, true) {
                sync_folder_of(&path)?;
            }
            Ok(())
        }))
    }

    fn sync_all(&self) -> io::Result<()> {
        confirmed(self.file.sync_all())?;
        sync_folder_of(&self.path)
    }

    fn scratch(&self) -> io::Result<File> {
        tempfile::tempfile_in(folder_of(&self.path))
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Pipes, devices and the folders of some file systems are not carried to any disk.
fn confirmed(done: io::Result<()>) -> io::Result<()> {
    match done {
        Err(e) if matches!(e.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        done => done,
    }
}

/// Carries a file's directory entry to the disk.
fn sync_folder_of(path: &Path) -> io::Result<()> {
    confirmed(File::open(folder_of(path))?.sync_all())
}

/// A piece that is to be written whole.
struct Piece {
    bytes: Vec<u8>,
    items: u64,
}

/// The end of a file that grows piece by piece.
pub(super) struct Disk {
    file: String,
    medium: Box<dyn Medium>,
    /// Bytes of whole pieces on the file.
    length: u64,
    /// Something of a failed piece may stand behind them.
    torn: bool,
    waiting: VecDeque<Piece>,
    syncer: Option<Syncer>,
}

impl Disk {
    pub fn new(file: String, medium: Box<dyn Medium>) -> Self {
        Disk { file, medium, length: 0, torn: false, waiting: VecDeque::new(), syncer: None }
    }

    /// Bytes of whole pieces on the file.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Items in pieces that are not on the file.
    pub fn waiting_items(&self) -> u64 {
        self.waiting.iter().map(|piece| piece.items).sum()
    }

    /// Takes a piece, to be written by [`Disk::settle`].
    pub fn put(&mut self, bytes: Vec<u8>, items: u64) {
        if !bytes.is_empty() {
            self.waiting.push_back(Piece { bytes, items });
        }
    }

    /// Writes the pieces that wait.
    ///
    /// # Errors
    /// Where the file cannot be written; what is not on it goes on waiting.
    pub fn settle(&mut self) -> Result<(), RecordingError> {
        while let Some(piece) = self.waiting.front() {
            if self.torn {
                self.medium.cut(self.length).map_err(|e| io_error(&self.file, e))?;
                self.torn = false;
            }
            if let Err(problem) = self.medium.append(&piece.bytes) {
                self.torn = self.medium.cut(self.length).is_err();
                return Err(io_error(&self.file, problem));
            }
            self.length += piece.bytes.len() as u64;
            self.waiting.pop_front();
            if let Some(syncer) = &self.syncer {
                syncer.ask(self.length);
            }
        }
        Ok(())
    }

    /// From now on carries to the disk what is written, on a thread of its own.
    ///
    /// # Errors
    /// Where the system refuses a descriptor or a thread.
    pub fn sync_along(&mut self) -> Result<(), RecordingError> {
        let syncer = self.medium.syncing().and_then(Syncer::start).map_err(|e| io_error(&self.file, e))?;
        syncer.ask(self.length);
        self.syncer = Some(syncer);
        Ok(())
    }

    /// Carries everything to the disk, with the directory entry.
    ///
    /// # Errors
    /// Where the disk refuses, now or before.
    pub fn sync(&mut self) -> Result<(), RecordingError> {
        let before = self.syncer.take().and_then(Syncer::end);
        let now = self.medium.sync_all().err().map(|e| self.unsafe_because(&e));
        before.map(|e| self.unsafe_because(&e)).or(now).map_or(Ok(()), Err)
    }

    fn unsafe_because(&self, problem: &io::Error) -> RecordingError {
        RecordingError::NotSafe { file: self.file.clone(), problem: problem.to_string() }
    }

    /// How long written bytes have been waiting for the disk.
    pub fn sync_lag(&self) -> Duration {
        self.syncer.as_ref().map_or(Duration::ZERO, Syncer::lag)
    }
}

fn io_error(file: &str, problem: io::Error) -> RecordingError {
    RecordingError::Io { file: file.into(), problem }
}

#[derive(Default)]
struct Wanted {
    written: u64,
    synced: u64,
    /// Since when `synced` is behind `written`.
    since: Option<Instant>,
    ended: bool,
    problem: Option<io::Error>,
}

type Shared = Arc<(Mutex<Wanted>, Condvar)>;

/// A thread that carries to the disk what was written.
struct Syncer {
    shared: Shared,
    thread: thread::JoinHandle<()>,
}

fn lock(shared: &Shared) -> MutexGuard<'_, Wanted> {
    shared.0.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Syncer {
    fn start(sync: Carry) -> io::Result<Self> {
        let shared = Shared::default();
        let own = Arc::clone(&shared);
        let thread = thread::Builder::new().name("disk".into()).spawn(move || sync_all(&own, sync))?;
        Ok(Syncer { shared, thread })
    }

    /// Asks for the first `length` bytes.
    fn ask(&self, length: u64) {
        let mut wanted = lock(&self.shared);
        wanted.written = length;
        wanted.since.get_or_insert_with(Instant::now);
        self.shared.1.notify_one();
    }

    fn lag(&self) -> Duration {
        lock(&self.shared).since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    /// Waits for what is under way; the first refusal, if there was one.
    fn end(self) -> Option<io::Error> {
        lock(&self.shared).ended = true;
        self.shared.1.notify_one();
        let _ = self.thread.join();
        lock(&self.shared).problem.take()
    }
}

/// The thread's loop. Several requests that come while the disk is busy are served at once.
fn sync_all(shared: &Shared, mut sync: Carry) {
    loop {
        let mut wanted = lock(shared);
        while wanted.written == wanted.synced && !wanted.ended {
            wanted = shared.1.wait(wanted).unwrap_or_else(PoisonError::into_inner);
        }
        if wanted.ended {
            return;
        }
        let (target, begun) = (wanted.written, Instant::now());
        drop(wanted);
        let done = sync();
        let mut wanted = lock(shared);
        wanted.synced = target;
        wanted.since = (wanted.written > target).then_some(begun);
        if let (Err(problem), None) = (done, &wanted.problem) {
            wanted.problem = Some(problem);
        }
    }
}
