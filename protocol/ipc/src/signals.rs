//! Ctrl-C, SIGTERM and SIGHUP for a command that a person started: the first asks it to end in order, one
//! that comes half a second or more after it ends the program at once.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Signals this soon after the first say the same thing: `timeout` signals its program and then the
/// program's whole group, a terminal that closes sends two kinds.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// Calls `asked` for the first signal and those that say the same, from a thread of its own; a later one
/// ends the program with `code`, even while it is busy.
///
/// # Errors
/// Where the system refuses a handler or the thread.
pub fn listen(code: u8, mut asked: impl FnMut() + Send + 'static) -> io::Result<()> {
    IN_ORDER.store(true, Ordering::Relaxed);
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        let mut first = None;
        for _ in signals.forever() {
            if first.get_or_insert_with(Instant::now).elapsed() >= SAME_REQUEST {
                end(code);
            }
            asked();
        }
    })?;
    Ok(())
}

/// Whether [`listen`] was called: signals are requests then.
static IN_ORDER: AtomicBool = AtomicBool::new(false);

/// Lets a signal end the program with `code` and without files that are not whole, until
/// [`listen`] is called: for commands that have nothing to end in order.
///
/// # Errors
/// Where the system refuses a handler or the thread.
pub fn end_by_default(code: u8) -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    std::thread::Builder::new().name("default".into()).spawn(move || {
        for _ in signals.forever() {
            if !IN_ORDER.load(Ordering::Relaxed) {
                end(code);
            }
        }
    })?;
    Ok(())
}

fn end(code: u8) {
    outputs::remove_unfinished();
    std::process::exit(code.into());
}
