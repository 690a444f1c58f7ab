//! A standby renderer: it has opened its device, loaded everything and drawn its first frames (seconds on a
//! software driver), but does not join the run. A line on standard input from the launcher promotes it; the
//! end of standard input makes it exit.

use rustix::process::{Pid, getpriority_process, nice, setpriority_process};
use std::cell::OnceCell;
use std::fs::read_dir;
use std::io::{self, BufRead, Write};
use std::sync::mpsc::{Receiver, channel};

/// Added to the niceness while it prepares: beside the one that draws it gets a tenth of a core. Less
/// would leave it unfinished for long where the machine is loaded, and there it is needed.
const PREPARING: i32 = 10;

/// Line on standard output when it is ready; the launcher waits for it.
const READY: &str = "ready";

/// Lowers the priority if that can be undone; returns the original niceness.
fn step_back() -> Option<i32> {
    let usual = getpriority_process(None).ok()?;
    // Without the right to return it would stay behind for ever.
    nice(1).and_then(|_| nice(-1)).and_then(|_| nice(PREPARING)).ok()?;
    Some(usual)
}

/// Takes every thread back to the usual niceness.
fn step_forward(usual: Option<i32>) {
    let Some(usual) = usual else { return };
    for task in read_dir("/proc/self/task").into_iter().flatten().flatten() {
        let id = task.file_name().to_str().and_then(|name| name.parse().ok());
        if let Some(id) = id.and_then(Pid::from_raw) {
            let _ = setpriority_process(Some(id), usual);
        }
    }
}

/// The order to take over, which may come while this process still prepares.
pub(super) struct Order {
    listener: Receiver<Option<usize>>,
    given: OnceCell<Option<usize>>,
    /// Niceness of a renderer at work.
    usual: Option<i32>,
}

impl Order {
    /// Steps back and listens from now on; on the order every thread goes forward at once. To be called
    /// before the driver starts its threads, which inherit the niceness.
    pub(super) fn listen() -> Self {
        let usual = step_back();
        let (told, order) = channel();
        // It ends with the line, or with the process.
        std::thread::spawn(move || {
            let mut line = String::new();
            if io::stdin().lock().read_line(&mut line).is_ok_and(|bytes| bytes > 0) {
                step_forward(usual);
                let _ = told.send(line.trim().parse().ok());
            }
        });
        Order { listener: order, given: OnceCell::new(), usual }
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
        // A reader that is gone does not matter.
        let _ = writeln!(io::stdout(), "{READY}");
        let order = self.given().or_else(|| self.listener.recv().ok())?;
        // Threads that were made since.
        step_forward(self.usual);
        Some(order)
    }
}
