//! The thread that reads one source. It never blocks: a pipe is opened without waiting for a writer and
//! read when it has data, and the end of the process is checked in between. It reads one
//! picture ahead; the rest waits in the pipe, and so does the writer.

use super::line::{LOOK_MS, Line};
use crate::device::Parts;
use crate::stamps::Taken;
use crate::stream::{Expected, PictureStream, is_black};
use anyhow::{Result, anyhow, bail};
use fpga_model::input::{Interlace, Picture};
use ipc::clock::now;
use protocol::time::Nanos;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FileType, Mode, OFlags, fstat, open};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Bytes read at a time.
const BUFFER: usize = 1 << 18;

/// Messages of a reader.
pub(super) enum Told {
    /// The source brings pictures of the camera's kind.
    Opened {
        /// It is a file.
        is_file: bool,
        /// What it was set to, in words; empty where nothing was set.
        settings: String,
        /// What is odd about it, in words.
        note: Option<String>,
    },
    /// A picture.
    Picture(Box<Pictured>),
    /// Whoever wrote into the pipe has closed it, or the camera was unplugged; it is waited for.
    Closed,
    /// What it brings cannot be used, in words; it is tried again.
    Refused(String),
    /// Nothing more comes from a file, where it is defective for this reason.
    Over(Option<String>),
}

/// A picture that came.
pub(super) struct Pictured {
    pub(super) picture: Picture,
    pub(super) parts: Parts,
    pub(super) arrived_ns: Nanos,
    pub(super) is_black: bool,
    /// It is the first after the source was opened.
    pub(super) is_first: bool,
    /// How many pictures came before it since the stream's header; `None` of a camera, which may lose some.
    pub(super) before: Option<u64>,
    /// What its camera's stamp says; `None` of what has no stamps.
    pub(super) taken: Option<Taken>,
}

/// Reads one source.
pub(super) struct Reader {
    pub(super) path: PathBuf,
    pub(super) expected: Expected,
    pub(super) line: Line,
}

/// How a source ended.
enum End {
    Closed,
    Over(Option<String>),
    /// The process ends.
    Stopped,
}

impl Reader {
    /// Reads until a file is over or the process ends.
    pub(super) fn run(self) {
        loop {
            let report = match self.read_source() {
                Ok(End::Closed) => Told::Closed,
                Ok(End::Over(why)) => return drop(self.line.tell(Told::Over(why))),
                Ok(End::Stopped) => return,
                Err(problem) => Told::Refused(format!("{problem:#}")),
            };
            let refused = matches!(report, Told::Refused(_));
            if self.line.tell(report).is_err() {
                return;
            }
            if refused {
                self.line.pause();
            }
            if self.line.stopping() {
                return;
            }
        }
    }

    /// Opens the source and reads it to its end.
    fn read_source(&self) -> Result<End> {
        let unopened = |e: rustix::io::Errno| anyhow!("cannot be opened: {}", io::Error::from(e));
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = open(&self.path, flags, Mode::empty()).map_err(unopened)?;
        let is_file = match FileType::from_raw_mode(fstat(&file).map_err(unopened)?.st_mode) {
            FileType::RegularFile => true,
            FileType::Fifo => false,
            _ => bail!("is neither a pipe nor a file"),
        };
        let source =
            Source { file: file.into(), is_file, stop: Arc::clone(&self.line.stop), ended: Arc::default() };
        let ended = Arc::clone(&source.ended);
        let mut input = BufReader::with_capacity(BUFFER, source);
        let read = self.read_pictures(&mut input, is_file);
        if self.line.stopping() {
            return Ok(End::Stopped);
        }
        match read {
            Err(problem) if is_file => Ok(End::Over(Some(format!("{problem:#}")))),
            // The writer broke off within a picture.
            Err(_) if ended.load(Ordering::Relaxed) => Ok(End::Closed),
            Err(problem) => Err(problem),
            Ok(()) if is_file => Ok(End::Over(None)),
            Ok(()) => Ok(End::Closed),
        }
    }

    fn read_pictures(&self, input: &mut impl BufRead, is_file: bool) -> Result<()> {
        let mut stream = PictureStream::open(input, self.expected.clone())?;
        self.line.tell(Told::Opened { is_file, settings: String::new(), note: stream.note.take() })?;
        let mut is_first = true;
        loop {
            let mut picture = self.line.picture();
            if !stream.read(&mut picture)? {
                return Ok(());
            }
            let is_black = is_black(&picture);
            let parts = match stream.interlace {
                Interlace::Progressive => Parts::one(None),
                interlaced => Parts::woven(interlaced.parities()[0]),
            };
            let (arrived_ns, taken, before) = (now(), None, Some(stream.count - 1));
            let pictured = Pictured { picture, parts, arrived_ns, is_black, is_first, before, taken };
            self.line.tell(Told::Picture(Box::new(pictured)))?;
            is_first = false;
        }
    }
}

/// A pipe or a file that is given up where the process ends.
struct Source {
    file: File,
    is_file: bool,
    stop: Arc<AtomicBool>,
    /// Its end was reached.
    ended: Arc<AtomicBool>,
}

impl Source {
    /// Waits until a pipe has data or was closed. A pipe that no writer has opened yet has neither.
    fn wait(&self) -> io::Result<()> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: LOOK_MS * 1_000_000 };
        if self.is_file {
            return Ok(());
        }
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(io::Error::other("the process ends"));
            }
            match poll(&mut [PollFd::new(&self.file, PollFlags::IN)], Some(&timeout)) {
                Ok(0) | Err(rustix::io::Errno::INTR) => {}
                Ok(_) => return Ok(()),
                Err(problem) => return Err(problem.into()),
            }
        }
    }
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            self.wait()?;
            match self.file.read(buffer) {
                Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {}
                Ok(0) => {
                    self.ended.store(true, Ordering::Relaxed);
                    return Ok(0);
                }
                read => return read,
            }
        }
    }
}
