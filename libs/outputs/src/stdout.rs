//! Standard output that can fail: a pipe closed by its reader, a closed terminal, a full disk. The standard
//! macros end the program there, and with it whatever it had yet to do.

use super::plainly;
use crate::printable;
use std::error::Error;
use std::fmt::Arguments;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::OnceLock;

static FAILURE: OnceLock<io::ErrorKind> = OnceLock::new();

/// As the standard macro, but a closed standard output ends nothing.
#[macro_export]
macro_rules! print {
    ($($text:tt)*) => { $crate::write_to_stdout(::std::format_args!($($text)*), false) };
}

/// As the standard macro, but a closed standard output ends nothing.
#[macro_export]
macro_rules! println {
    () => { $crate::write_to_stdout(::std::format_args!(""), true) };
    ($($text:tt)*) => { $crate::write_to_stdout(::std::format_args!($($text)*), true) };
}

/// Writes to standard output, with a line's end if asked. After a first failure nothing more is
/// written, and [`standard_output_failure`] returns it.
pub fn write_to_stdout(text: Arguments<'_>, line: bool) {
    if FAILURE.get().is_some() {
        return;
    }
    // Texts from files and other programs must not command the terminal.
    let (text, mut out) = (text.to_string(), io::stdout().lock());
    let written = out.write_all(printable(&text).as_bytes());
    let written = written.and_then(|()| if line { out.write_all(b"\n") } else { Ok(()) });
    if let Err(problem) = written {
        let _ = FAILURE.set(problem.kind());
    }
}

/// Why standard output did not take everything; for the end of a program, which writes out what is
/// still buffered. Nothing where its reader went away: he has seen enough.
pub fn standard_output_failure() -> Option<io::ErrorKind> {
    if let Err(problem) = io::stdout().flush() {
        let _ = FAILURE.set(problem.kind());
    }
    FAILURE.get().copied().filter(|kind| *kind != io::ErrorKind::BrokenPipe)
}

/// The exit code of a program: that of what it has done, but success where the reader of its output closed
/// the pipe, and failure where standard output did not take everything. `fail` and `warn` say why.
pub fn exit_code<E: AsRef<dyn Error + 'static>>(
    done: Result<ExitCode, E>,
    fail: impl FnOnce(&E) -> ExitCode,
    warn: impl FnOnce(&str),
) -> ExitCode {
    let code = done.unwrap_or_else(|error| {
        // He has seen enough of it.
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
