//! A renderer that waits to take over: it has opened its device, loaded everything and drawn its
//! first frames (seconds on a software driver), but takes part in nothing. The launcher tells it to
//! begin by a line on standard input, which ends when there is nothing to wait for any more.

use crate::config::NICENESS;
use rustix::process::{Pid, nice, setpriority_process};
use std::cell::OnceCell;
use std::fs::read_dir;
use std::io::{self, BufRead};
use std::sync::mpsc::{Receiver, channel};

/// Added to the niceness while it prepares: beside the one that draws it gets a tenth of a core. Less
/// would leave it unfinished for long where the machine is loaded, and there it is needed.
const PREPARING: i32 = 10;

/// Makes room for others where it can be taken back. To be called before the driver starts its
/// threads, which inherit it.
pub(super) fn step_back() {
    // Without the right to return it would stay behind for ever.
    if nice(1).is_ok() && nice(-1).is_ok() {
        let _ = nice(PREPARING);
    }
}

/// Takes every thread back to the usual niceness.
fn step_forward() {
    for task in read_dir("/proc/self/task").into_iter().flatten().flatten() {
        let id = task.file_name().to_str().and_then(|name| name.parse().ok());
        if let Some(id) = id.and_then(Pid::from_raw) {
            let _ = setpriority_process(Some(id), NICENESS);
        }
    }
}

/// The order to take over, which may come while this process still prepares.
pub(super) struct Order {
    listener: Receiver<Option<usize>>,
    given: OnceCell<Option<usize>>,
}

impl Order {
    /// Listens from now on; on the order every thread goes forward at once.
    pub(super) fn listen() -> Self {
        let (told, order) = channel();
        // It ends with the line, or with the process.
        std::thread::spawn(move || {
            let mut line = String::new();
            if io::stdin().lock().read_line(&mut line).is_ok_and(|bytes| bytes > 0) {
                step_forward();
                let _ = told.send(line.trim().parse().ok());
            }
        });
        Order { listener: order, given: OnceCell::new() }
    }

    /// It, if it has come: the tier to begin with, if it names one.
    pub(super) fn given(&self) -> Option<Option<usize>> {
        if let Ok(order) = self.listener.try_recv() {
            // It comes once.
            let _ = self.given.set(order);
        }
        self.given.get().copied()
    }

    /// Waits for it: the tier to begin with, if it names one. `None` where there is nothing to wait
    /// for any more.
    pub(super) fn wait(self) -> Option<Option<usize>> {
        let order = self.given().or_else(|| self.listener.recv().ok())?;
        // Threads that were made since.
        step_forward();
        Some(order)
    }
}
