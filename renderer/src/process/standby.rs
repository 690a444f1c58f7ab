//! A standby renderer has opened its device, loaded everything and drawn its first frames (which takes
//! seconds on a software driver), but has not joined the run. A line on standard input from the launcher
//! promotes it; the end of standard input makes it exit.

use rustix::process::{Pid, getpriority_process, nice, setpriority_process};
use std::cell::OnceCell;
use std::fs::read_dir;
use std::io::{self, BufRead, Write};
use std::sync::mpsc::{Receiver, channel};

/// Increase of the niceness during preparation, with which it gets about a tenth of a core beside the working
/// renderer. A lower priority would delay it on a loaded machine, where it is most likely to be needed.
const PREPARING: i32 = 10;

/// Line on standard output when the standby is ready; the launcher waits for it.
const READY: &str = "ready";

/// Lowers the priority of this process, if that can be undone. Returns the original niceness.
fn lower_priority() -> Option<i32> {
    let usual = getpriority_process(None).ok()?;
    // Without the right to lower the niceness again, the process could never return to it.
    nice(1).and_then(|_| nice(-1)).and_then(|_| nice(PREPARING)).ok()?;
    Some(usual)
}

/// Restores the original niceness of every thread.
fn restore_priority(usual: Option<i32>) {
    let Some(usual) = usual else { return };
    for task in read_dir("/proc/self/task").into_iter().flatten().flatten() {
        let id = task.file_name().to_str().and_then(|name| name.parse().ok());
        if let Some(id) = id.and_then(Pid::from_raw) {
            let _ = setpriority_process(Some(id), usual);
        }
    }
}

/// The promotion, which may arrive while the process is still preparing.
pub(super) struct Order {
    listener: Receiver<Option<usize>>,
    given: OnceCell<Option<usize>>,
    /// Original niceness, which is restored on promotion.
    usual: Option<i32>,
}

impl Order {
    /// Lowers the priority and listens for the promotion, which restores the priority of every thread. To be
    /// called before the driver starts its threads, which inherit the niceness.
    pub(super) fn listen() -> Self {
        let usual = lower_priority();
        let (sender, order) = channel();
        // The thread ends after the line, or with the process.
        std::thread::spawn(move || {
            let mut line = String::new();
            if io::stdin().lock().read_line(&mut line).is_ok_and(|bytes| bytes > 0) {
                restore_priority(usual);
                let _ = sender.send(line.trim().parse().ok());
            }
        });
        Order { listener: order, given: OnceCell::new(), usual }
    }

    /// The promotion, if it has arrived: the first tier, if the launcher names one.
    pub(super) fn given(&self) -> Option<Option<usize>> {
        if let Ok(order) = self.listener.try_recv() {
            // The launcher sends only one line.
            let _ = self.given.set(order);
        }
        self.given.get().copied()
    }

    /// Waits for the promotion: the first tier, if the launcher names one. `None` if standard input ends
    /// first.
    pub(super) fn wait(self) -> Option<Option<usize>> {
        // A missing reader is ignored.
        let _ = writeln!(io::stdout(), "{READY}");
        let order = self.given().or_else(|| self.listener.recv().ok())?;
        // For threads that were started after the promotion.
        restore_priority(self.usual);
        Some(order)
    }
}
