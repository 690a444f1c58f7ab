//! Load on all processors during a certification.

use ipc::logging::warn;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Load on the machine during the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Beside {
    /// Work on every processor, by stress-ng where it is installed.
    #[value(alias = "both")]
    All,
    /// Nothing.
    None,
}

/// A running load, which ends on drop.
pub struct Load {
    what: Kind,
    /// Description for the report.
    pub text: String,
}

enum Kind {
    Stress(Child),
    Own(Arc<AtomicBool>),
    None,
}

impl Load {
    /// Starts the load on this number of processors.
    pub fn begin(beside: Beside, processors: usize) -> Self {
        if beside == Beside::None {
            return Load { what: Kind::None, text: "none was made".into() };
        }
        match stress(processors) {
            Ok(child) => {
                let text = format!("stress-ng --cpu {processors}, at ordinary priority");
                Load { what: Kind::Stress(child), text }
            }
            Err(problem) => {
                let why = match problem.kind() {
                    io::ErrorKind::NotFound => "stress-ng is not installed".to_owned(),
                    _ => format!("stress-ng does not start ({problem})"),
                };
                let text =
                    format!("{processors} threads of this command that count, at ordinary priority: {why}");
                warn(&format!("the load is {text}"));
                Load { what: Kind::Own(spin(processors)), text }
            }
        }
    }
}

fn stress(processors: usize) -> io::Result<Child> {
    let mut command = Command::new("stress-ng");
    command.args(["--quiet", "--cpu", &processors.to_string()]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    // In a process group of its own, stress-ng can be ended together with its workers, and Ctrl-C does not
    // end it before the measurement.
    command.process_group(0).spawn()
}

/// Starts one busy thread per processor. Raising the returned flag ends them.
fn spin(processors: usize) -> Arc<AtomicBool> {
    let end = Arc::<AtomicBool>::default();
    let counted = Arc::<AtomicU64>::default();
    for _ in 0..processors {
        let (end, counted) = (Arc::clone(&end), Arc::clone(&counted));
        std::thread::spawn(move || {
            let mut count = 0u64;
            while !end.load(Ordering::Relaxed) {
                count = std::hint::black_box(count.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
            }
            counted.fetch_xor(count, Ordering::Relaxed);
        });
    }
    end
}

impl Drop for Load {
    fn drop(&mut self) {
        match &mut self.what {
            Kind::Stress(child) => {
                if let Some(group) = Pid::from_raw(child.id() as i32) {
                    let _ = kill_process_group(group, Signal::TERM);
                }
                let _ = child.wait();
            }
            Kind::Own(end) => end.store(true, Ordering::Relaxed),
            Kind::None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_says_what_it_is_and_ends() {
        let none = Load::begin(Beside::None, 2);
        assert_eq!(none.text, "none was made");
        let load = Load::begin(Beside::All, 1);
        assert!(load.text.contains("stress-ng"), "{}", load.text);
        let ended = match &load.what {
            Kind::Own(end) => Some(Arc::clone(end)),
            _ => None,
        };
        drop(load);
        assert!(ended.is_none_or(|end| end.load(Ordering::Relaxed)));
    }
}
