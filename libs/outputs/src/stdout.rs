//! Standard output that can fail (a pipe closed by its reader, a closed terminal, a full disk) without a
//! panic. The macros of the standard library panic on a closed pipe.

use super::plainly;
use crate::printable;
use std::error::Error;
use std::fmt::Arguments;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::OnceLock;

static FAILURE: OnceLock<io::ErrorKind> = OnceLock::new();

/// As [`std::print!`], but without a panic if standard output is closed.
#[macro_export]
macro_rules! print {
    ($($text:tt)*) => { $crate::write_to_stdout(::std::format_args!($($text)*), false) };
}

/// As [`std::println!`], but without a panic if standard output is closed.
#[macro_export]
macro_rules! println {
    () => { $crate::write_to_stdout(::std::format_args!(""), true) };
    ($($text:tt)*) => { $crate::write_to_stdout(::std::format_args!($($text)*), true) };
}

/// Writes to standard output, with a line feed if `line`. After the first failure nothing more is written;
/// [`standard_output_failure`] returns that failure.
pub fn write_to_stdout(text: Arguments<'_>, line: bool) {
    if FAILURE.get().is_some() {
        return;
    }
    // Texts from files and other programs must not control the terminal.
    let (text, mut out) = (text.to_string(), io::stdout().lock());
    let written = out.write_all(printable(&text).as_bytes());
    let written = written.and_then(|()| if line { out.write_all(b"\n") } else { Ok(()) });
    if let Err(problem) = written {
        let _ = FAILURE.set(problem.kind());
    }
}

/// Flushes standard output at the end of a program and returns the first error. `None` if the reader closed
/// the pipe.
pub fn standard_output_failure() -> Option<io::ErrorKind> {
    if let Err(problem) = io::stdout().flush() {
        let _ = FAILURE.set(problem.kind());
    }
    FAILURE.get().copied().filter(|kind| *kind != io::ErrorKind::BrokenPipe)
}

/// The exit code of a program. A pipe closed by its reader counts as success; any other failure of standard
/// output turns success into failure. `fail` reports the program's error and returns its exit code, `warn`
/// reports the failure of standard output.
pub fn exit_code<E: AsRef<dyn Error + 'static>>(
    done: Result<ExitCode, E>,
    fail: impl FnOnce(&E) -> ExitCode,
    warn: impl FnOnce(&str),
) -> ExitCode {
    let code = done.unwrap_or_else(|error| {
        // The reader closed the pipe, which is no failure.
        if is_broken_pipe(error.as_ref()) { ExitCode::SUCCESS } else { fail(&error) }
    });
    match standard_output_failure() {
        Some(problem) if code == ExitCode::SUCCESS => {
            warn(&format!("standard output: {}", plainly(&problem.into())));
            ExitCode::FAILURE
        }
        _ => code,
    }
}

fn is_broken_pipe(error: &(dyn Error + 'static)) -> bool {
    let is_it = |cause: &io::Error| cause.kind() == io::ErrorKind::BrokenPipe;
    error.downcast_ref().is_some_and(is_it) || error.source().is_some_and(is_broken_pipe)
}
