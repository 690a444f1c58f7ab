//! Output of child processes: kept for error messages, written to a log file, and passed on unchanged.

use outputs::printable;
use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::sync::{Mutex, PoisonError};
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader};
use tokio::sync::mpsc;

/// Number of lines of a child's output that are kept for error messages.
const TAIL_LINES: usize = 30;
/// Maximum length of a line, bytes; longer lines are split.
const LINE_BYTES: u64 = 4096;
/// Maximum size of a child's log file, bytes.
const LOG_BYTES: usize = 1 << 20;

/// Queue for the lines of children's standard error, read by the task that draws on the terminal.
pub type LineSender = mpsc::Sender<String>;

/// Output of a child so far.
#[derive(Debug, Default)]
pub(super) struct Output {
    kept: Mutex<Kept>,
}

#[derive(Debug, Default)]
struct Kept {
    tail: VecDeque<String>,
    log: Option<File>,
    logged: usize,
}

impl Output {
    /// Creates an empty output. Lines are also written to `log`, if there is one.
    pub(super) fn new(log: Option<File>) -> Self {
        Output { kept: Mutex::new(Kept { log, ..Kept::default() }) }
    }

    /// The last lines, oldest first.
    pub(super) fn tail(&self) -> Vec<String> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).tail.iter().cloned().collect()
    }

    fn put(&self, line: &[u8], text: String) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.tail.len() == TAIL_LINES {
            kept.tail.pop_front();
        }
        kept.tail.push_back(text);
        kept.logged += line.len();
        if kept.logged < LOG_BYTES
            && let Some(log) = &mut kept.log
        {
            // The file is in shared memory, so this does not wait for a disk.
            let _ = log.write_all(line);
        }
    }

    /// Reads a pipe of the child to its end, so that the child never blocks on a full pipe. Each line is also
    /// given to `pass_on`.
    pub(super) async fn read(&self, pipe: impl AsyncRead + Unpin, mut pass_on: impl FnMut(&str)) {
        let mut reader = BufReader::new(pipe);
        let mut line = Vec::new();
        while let Ok(1..) = (&mut reader).take(LINE_BYTES).read_until(b'\n', &mut line).await {
            let text = String::from_utf8_lossy(&line).trim_end().to_string();
            pass_on(&text);
            self.put(&line, text);
            line.clear();
        }
    }
}

/// Passes on a line of a child's standard error: to `lines`, if the launcher draws on the terminal, else to
/// standard error. Lines that do not fit the queue are dropped.
pub(super) fn pass_on(line: &str, lines: Option<&LineSender>) {
    match lines {
        Some(lines) => drop(lines.try_send(line.to_owned())),
        None => drop(std::io::stderr().write_all(format!("{}\n", printable(line)).as_bytes())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_pipe_is_read_to_its_end_and_cut_into_lines() {
        let output = Output::default();
        let text = format!("one\n{}\nlast", "x".repeat(LINE_BYTES as usize + 10));
        let mut passed = Vec::new();
        output.read(text.as_bytes(), |line| passed.push(line.to_owned())).await;
        let lines = output.tail();
        assert_eq!(lines.len(), 4);
        assert_eq!(lines[1].len(), LINE_BYTES as usize);
        assert_eq!(lines[3], "last");
        assert_eq!(passed, lines);
    }

    #[tokio::test]
    async fn the_tail_keeps_the_newest_lines() {
        let output = Output::default();
        let text: String = (0..TAIL_LINES + 3).map(|i| format!("{i}\n")).collect();
        output.read(text.as_bytes(), |_| {}).await;
        let tail = output.tail();
        assert_eq!((tail.len(), tail[0].as_str()), (TAIL_LINES, "3"));
    }
}
