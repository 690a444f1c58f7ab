//! Who sits at the terminal: a line that changes in place, answers by Enter, and the end by Ctrl-C.

use anyhow::{Result, bail};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Longest wait between two looks at a device, ns.
const LOOK_NS: i64 = 20_000_000;

/// What came of waiting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Answer {
    /// Nothing yet.
    None,
    /// Enter.
    Enter,
    /// Standard input is over.
    Over,
}

/// The person.
pub(super) struct Person {
    stop: Arc<AtomicBool>,
    /// The line that stands in the terminal.
    shown: String,
    in_place: bool,
}

impl Person {
    /// Listens for Ctrl-C.
    ///
    /// # Errors
    /// Where a signal handler is refused.
    pub(super) fn new() -> Result<Self> {
        let stop = Arc::<AtomicBool>::default();
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, Arc::clone(&stop))?;
        }
        Ok(Person { stop, shown: String::new(), in_place: io::stdout().is_terminal() })
    }

    /// Whether Ctrl-C was pressed, or the reader of the output has closed it.
    pub(super) fn has_left(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Shows a line in the place of the one before; where standard output is no terminal, below it and only
    /// where it has changed.
    pub(super) fn show(&mut self, line: &str) -> Result<()> {
        if line == self.shown {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        match self.in_place {
            true => write!(out, "\r\x1b[2K{}", outputs::printable(line))?,
            false => writeln!(out, "{}", outputs::printable(line))?,
        }
        out.flush()?;
        self.shown = line.into();
        Ok(())
    }

    /// As [`Person::show`], in a terminal alone: beside questions.
    pub(super) fn show_beside(&mut self, line: &str) -> Result<()> {
        if self.in_place { self.show(line) } else { Ok(()) }
    }

    /// Ends the line that stands.
    pub(super) fn end_line(&mut self) {
        if self.in_place && !std::mem::take(&mut self.shown).is_empty() {
            outputs::println!();
        }
    }

    /// Asks for something, in a line of its own.
    pub(super) fn ask(&mut self, question: &str) -> Result<()> {
        self.end_line();
        let mut out = io::stdout().lock();
        writeln!(out, "{question}")?;
        Ok(out.flush()?)
    }

    /// Waits a moment for Enter.
    ///
    /// # Errors
    /// Where Ctrl-C was pressed, or standard input fails.
    pub(super) fn answer(&self) -> Result<Answer> {
        if self.has_left() {
            bail!("stopped; nothing was written");
        }
        let moment = Timespec { tv_sec: 0, tv_nsec: LOOK_NS };
        let stdin = io::stdin();
        match poll(&mut [PollFd::new(&stdin, PollFlags::IN)], Some(&moment)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(Answer::None),
            Ok(_) => {}
            Err(problem) => return Err(io::Error::from(problem).into()),
        }
        // A byte at a time: what follows Enter answers the next question.
        let mut byte = [0];
        loop {
            match rustix::io::read(&stdin, &mut byte) {
                Ok(0) => return Ok(Answer::Over),
                Ok(_) if byte[0] == b'\n' => return Ok(Answer::Enter),
                Ok(_) => {}
                Err(rustix::io::Errno::INTR) if self.has_left() => return Ok(Answer::None),
                Err(rustix::io::Errno::INTR) => {}
                Err(problem) => return Err(io::Error::from(problem).into()),
            }
        }
    }
}
