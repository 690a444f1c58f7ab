//! One device, pipe or recorded file: opened when it is there, read without waiting, taken up again.

use ipc::clock::now;
use protocol::time::Nanos;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FileType, Mode, OFlags, fstat, open};
use rustix::io::{Errno, read};
use rustix::termios::{ControlModes, OptionalActions, isatty, tcgetattr, tcsetattr};
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

/// Time between two tries to open what is not there, ns.
const RETRY_NS: u64 = 250_000_000;

/// What a path leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Device,
    Pipe,
    File,
}

/// What reading has brought.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Got {
    /// Nothing at present.
    Nothing,
    /// So many bytes.
    Bytes(usize),
    /// The device is gone, the pipe closed by its writer, the file over.
    Closed,
}

/// A line to one device.
pub(crate) struct Line {
    path: PathBuf,
    /// Bits a second, of a serial line.
    baud: Option<u32>,
    opened: Option<(OwnedFd, Kind)>,
    retry_ns: Nanos,
    /// How often it was opened.
    pub(crate) openings: u64,
}

impl Line {
    /// Nothing is opened yet; `baud` where it is a serial line.
    pub(crate) fn new(path: &Path, baud: Option<u32>) -> Self {
        Line { path: path.to_owned(), baud, opened: None, retry_ns: 0, openings: 0 }
    }

    /// Whether it is open.
    pub(crate) fn is_open(&self) -> bool {
        self.opened.is_some()
    }

    /// What can be waited for: a file has its bytes always.
    pub(crate) fn waits(&self) -> Option<BorrowedFd<'_>> {
        self.opened.as_ref().filter(|(_, kind)| *kind != Kind::File).map(|(fd, _)| fd.as_fd())
    }

    /// Whether to try to open it now.
    pub(crate) fn is_due(&self, now: Nanos) -> bool {
        self.opened.is_none() && now >= self.retry_ns
    }

    /// Opens it; returns what it is, and a descriptor to ask it by.
    ///
    /// # Errors
    /// Why it cannot be opened, in words that follow its name.
    pub(crate) fn open(&mut self, now: Nanos) -> Result<(Kind, OwnedFd), String> {
        self.retry_ns = now.saturating_add(RETRY_NS);
        let failed = |what: &str, e: Errno| format!("{what}: {}", io::Error::from(e));
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
        let unopened = |e| failed("cannot be opened", e);
        let fd = open(&self.path, flags, Mode::empty()).map_err(unopened)?;
        let kind = match FileType::from_raw_mode(fstat(&fd).map_err(unopened)?.st_mode) {
            FileType::CharacterDevice => Kind::Device,
            FileType::Fifo => Kind::Pipe,
            FileType::RegularFile => Kind::File,
            _ => return Err("is neither a device, a pipe nor a file".into()),
        };
        if let Some(baud) = self.baud.filter(|_| isatty(&fd)) {
            set_line(&fd, baud).map_err(|e| failed(&format!("cannot be set to {baud} baud"), e))?;
        }
        let other = fd.try_clone().map_err(|e| format!("cannot be opened: {e}"))?;
        self.openings += 1;
        self.opened = Some((fd, kind));
        Ok((kind, other))
    }

    /// Reads what there is; a device that fails is closed and tried again.
    pub(crate) fn read(&mut self, buffer: &mut [u8]) -> Got {
        let Some((fd, kind)) = &self.opened else { return Got::Nothing };
        // A pipe that no writer has opened yet reads like one that was closed; only poll distinguishes them.
        let at_once = Timespec::default();
        if *kind != Kind::File && poll(&mut [PollFd::new(fd, PollFlags::IN)], Some(&at_once)) == Ok(0) {
            return Got::Nothing;
        }
        match read(fd, buffer) {
            Ok(0) => self.close(),
            Ok(bytes) => Got::Bytes(bytes),
            Err(Errno::AGAIN | Errno::INTR) => Got::Nothing,
            Err(_) => self.close(),
        }
    }

    /// Closes it; it is tried again after a while.
    pub(crate) fn close(&mut self) -> Got {
        self.opened = None;
        self.retry_ns = now() + RETRY_NS;
        Got::Closed
    }

    /// Tries it again without waiting.
    pub(crate) fn retry_at_once(&mut self) {
        self.retry_ns = 0;
    }
}

/// Bytes as they come, at this speed, without the lines of a modem.
fn set_line(fd: &OwnedFd, baud: u32) -> Result<(), Errno> {
    let mut settings = tcgetattr(fd)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CREAD | ControlModes::CLOCAL;
    settings.control_modes &= !ControlModes::CRTSCTS;
    settings.set_speed(baud)?;
    tcsetattr(fd, OptionalActions::Now, &settings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, OpenOptions};
    use std::io::Write;
    use std::process::Command;

    #[test]
    fn a_pipe_waits_for_its_writer_and_for_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p");
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        let (mut line, mut buffer) = (Line::new(&path, None), [0; 8]);
        assert!(line.is_due(0));
        assert_eq!(line.open(0).unwrap().0, Kind::Pipe);
        assert_eq!(line.read(&mut buffer), Got::Nothing, "no writer has opened it");
        for _ in 0..2 {
            let mut writer = OpenOptions::new().write(true).open(&path).unwrap();
            assert_eq!(line.read(&mut buffer), Got::Nothing);
            writer.write_all(b"abc").unwrap();
            drop(writer);
            assert_eq!(line.read(&mut buffer), Got::Bytes(3));
            assert_eq!(line.read(&mut buffer), Got::Closed);
            assert!(!line.is_open() && !line.is_due(now()) && line.is_due(Nanos::MAX));
            line.open(0).unwrap();
        }
        assert_eq!(line.openings, 3);
    }

    #[test]
    fn a_terminal_is_a_serial_line() {
        use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let (mut line, mut buffer) = (Line::new(Path::new(&name), Some(57_600)), [0; 16]);
        let (kind, fd) = line.open(0).unwrap();
        assert_eq!((kind, tcgetattr(&fd).unwrap().input_speed()), (Kind::Device, 57_600));
        assert_eq!(line.read(&mut buffer), Got::Nothing);
        let mut writer = File::from(master);
        writer.write_all(b"a\r\n\x04b").unwrap();
        // A terminal delivers a little later.
        let mut come = Vec::new();
        while come.len() < 5 {
            match line.read(&mut buffer) {
                Got::Bytes(bytes) => come.extend_from_slice(&buffer[..bytes]),
                got => assert_eq!(got, Got::Nothing),
            }
        }
        assert_eq!(come, b"a\r\n\x04b", "nothing is translated, and nothing waits for a line");
        drop(writer);
        while line.read(&mut buffer) != Got::Closed {}
        let told = line.open(0).unwrap_err();
        assert!(told.contains("cannot be opened") || told.contains("cannot be set"), "{told}");
    }

    #[test]
    fn what_cannot_be_opened_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let open = |path: &Path| Line::new(path, None).open(0).map(|(kind, _)| kind);
        assert!(open(&folder.path().join("no")).unwrap_err().contains("No such file"));
        assert!(open(folder.path()).unwrap_err().contains("neither a device"));
        assert_eq!(open(Path::new("/dev/null")), Ok(Kind::Device));
    }
}
