//! Where the bytes of a live stream come in: a pipe, standard input, a terminal or a port. Nothing here
//! waits: who has nothing to read goes on.

use anyhow::{Context, Result};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags, fstatfs};
use rustix::io::Errno;
use rustix::time::Timespec;
use settings::blob_source::{BlobSource, addresses};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Bytes that are read at once.
const READ_BYTES: usize = 64 << 10;
/// The kernel's own file system of pipes without a name: whose last writer goes, has none ever after.
const PIPEFS: u64 = 0x5049_5045;
/// Answer to a writer that connects while another is writing.
const BUSY: &[u8] = b"vitreo: another writer is connected; only one is accepted at a time\n";

/// What there was.
#[derive(Debug)]
pub(super) enum Got<'a> {
    /// Nothing to read now.
    Nothing,
    /// A writer is there.
    Came,
    /// Bytes of it.
    Bytes(&'a [u8]),
    /// The writer has gone; another may come.
    Gone,
    /// The writer has gone, and no other can come.
    Ended,
    /// Another writer tried to connect, and was refused because there is one already.
    TurnedAway(String),
}

/// The place where bytes come in.
#[derive(Debug)]
pub(super) struct Inlet {
    name: String,
    door: Door,
    /// The connected writer was reported.
    came: bool,
    buffer: Box<[u8]>,
}

#[derive(Debug)]
enum Door {
    /// A pipe with a name, opened again for every writer.
    Pipe(PathBuf, File),
    /// A pipe without a name or a terminal, whose end is the end; none after it.
    Once(Option<File>),
    /// One connection at a time.
    Port(TcpListener, Option<TcpStream>),
}

impl Inlet {
    /// Opens it; waits for no writer.
    ///
    /// # Errors
    /// Where it cannot be opened, or the port is taken.
    pub(super) fn open(source: &BlobSource) -> Result<Self> {
        let (name, door) = match source {
            BlobSource::Path(path) => pipe(path).with_context(|| path.display().to_string())?,
            BlobSource::Tcp(address) => port(address).with_context(|| format!("tcp:{address}"))?,
        };
        Ok(Inlet { name, door, came: false, buffer: vec![0; READ_BYTES].into() })
    }

    /// What it is called in messages.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Whether a writer has been heard that has not gone.
    pub(super) fn has_writer(&self) -> bool {
        self.came
    }

    /// The next thing that there is. `deaf`: the present writer has been silent for long enough that another
    /// one may take its place.
    ///
    /// # Errors
    /// Where the place itself fails.
    pub(super) fn next(&mut self, deaf: bool) -> Result<Got<'_>> {
        if let Some(got) = self.knock(deaf)? {
            return Ok(got);
        }
        let (ready, hung_up) = match &self.door {
            Door::Pipe(_, file) | Door::Once(Some(file)) => state(file.as_fd())?,
            Door::Port(_, Some(stream)) => state(stream.as_fd())?,
            Door::Once(None) | Door::Port(_, None) => return Ok(Got::Nothing),
        };
        if ready && !std::mem::replace(&mut self.came, true) {
            return Ok(Got::Came);
        }
        if !ready {
            return if hung_up { self.gone() } else { Ok(Got::Nothing) };
        }
        let read = match &mut self.door {
            Door::Pipe(_, file) | Door::Once(Some(file)) => file.read(&mut self.buffer),
            Door::Port(_, Some(stream)) => stream.read(&mut self.buffer),
            Door::Once(None) | Door::Port(_, None) => Ok(0),
        };
        match read {
            Ok(0) => self.gone(),
            Ok(count) => Ok(Got::Bytes(&self.buffer[..count])),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(Got::Nothing),
            // A connection that was torn down, a terminal that went away.
            Err(_) => self.gone(),
        }
    }

    /// Runs `rest` with the files that bring something.
    pub(super) fn rest(&self, rest: impl FnOnce(&[BorrowedFd<'_>])) {
        match &self.door {
            Door::Pipe(_, file) | Door::Once(Some(file)) => rest(&[file.as_fd()]),
            Door::Once(None) => rest(&[]),
            Door::Port(port, None) => rest(&[port.as_fd()]),
            Door::Port(port, Some(stream)) => rest(&[port.as_fd(), stream.as_fd()]),
        }
    }

    /// Lets a writer in, or turns it away where another one is being heard.
    fn knock(&mut self, deaf: bool) -> Result<Option<Got<'static>>> {
        let Door::Port(port, present) = &mut self.door else { return Ok(None) };
        if deaf && present.is_some() && state(port.as_fd())?.0 {
            *present = None;
            self.came = false;
            return Ok(Some(Got::Gone));
        }
        let (mut stream, from) = match port.accept() {
            Ok(accepted) => accepted,
            Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(None),
            // It has gone again already.
            Err(e) if matches!(e.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) => {
                return Ok(None);
            }
            Err(e) => return Err(e).with_context(|| self.name.clone()),
        };
        // Without it a read could wait.
        if stream.set_nonblocking(true).is_err() {
            return Ok(None);
        }
        if present.is_some() {
            let _ = stream.write(BUSY);
            return Ok(Some(Got::TurnedAway(from.to_string())));
        }
        *present = Some(stream);
        self.came = true;
        Ok(Some(Got::Came))
    }

    /// The writer has gone; makes ready for the next.
    fn gone(&mut self) -> Result<Got<'static>> {
        let came = std::mem::take(&mut self.came);
        match &mut self.door {
            // Opened before the old one is closed: a writer that is there already keeps its reader.
            Door::Pipe(path, file) => *file = open(path).with_context(|| path.display().to_string())?,
            Door::Once(file) => {
                *file = None;
                return Ok(Got::Ended);
            }
            Door::Port(_, stream) => *stream = None,
        }
        Ok(if came { Got::Gone } else { Got::Nothing })
    }
}

fn pipe(path: &Path) -> Result<(String, Door)> {
    let standard = path.as_os_str() == protocol::file::STDIN;
    let path = if standard { Path::new("/dev/stdin") } else { path };
    let file = open(path)?;
    // The launcher gives its own standard input by this name.
    let handed_on = path.starts_with("/proc") && path.ends_with("fd/0");
    let is_named = fstatfs(&file)?.f_type as u64 != PIPEFS && file.metadata()?.file_type().is_fifo();
    let name = match (standard || handed_on, is_named) {
        (true, _) => "standard input".into(),
        (false, true) => format!("FIFO {}", path.display()),
        (false, false) => path.display().to_string(),
    };
    Ok((name, if is_named { Door::Pipe(path.to_owned(), file) } else { Door::Once(Some(file)) }))
}

fn open(path: &Path) -> std::io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    Ok(File::from(rustix::fs::open(path, flags, Mode::empty())?))
}

fn port(address: &str) -> Result<(String, Door)> {
    let port = TcpListener::bind(&addresses(address)?[..])?;
    port.set_nonblocking(true)?;
    Ok((format!("tcp:{}", port.local_addr()?), Door::Port(port, None)))
}

/// Whether there is something to read, and whether the other end has closed.
fn state(fd: BorrowedFd<'_>) -> Result<(bool, bool)> {
    let mut fds = [PollFd::from_borrowed_fd(fd, PollFlags::IN)];
    match poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })) {
        Ok(_) => {}
        Err(Errno::INTR) => return Ok((false, false)),
        Err(problem) => return Err(problem.into()),
    }
    let events = fds[0].revents();
    Ok((events.contains(PollFlags::IN), events.intersects(PollFlags::HUP | PollFlags::ERR)))
}

#[cfg(test)]
mod tests;
