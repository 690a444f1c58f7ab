//! What the shells of the processes share: arguments, stop signals, heartbeat and control; and
//! [`run`], the one loop, in which a process does its [`Work`].

mod run;

pub use run::{Served, Work, run};

use crate::awake::Awake;
use crate::clock::{cpu_ns, now, sleep_until};
use crate::logging::LogArgs;
use crate::trace::{Trace, TraceArgs};
use crate::{Instance, IpcError, MAX_SOURCES, Queue, Receiver, Sender, Wakes, wait, wait_beside};
use protocol::control::{Answer, Command, Request};
use protocol::health::{Health, Process, STATE_STARTING};
use protocol::limits::{HEARTBEAT_NS, MAX_WAIT_MS};
use protocol::message::text_bytes;
use protocol::time::Nanos;
use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time before an instant from which on a process that rests to it is woken by nothing, ns: a wait
/// for messages ends as it pleases the kernel, a sleep alone ends at the instant.
const FINE_NS: u64 = 500_000;

/// Arguments that every process takes.
#[derive(Debug, Clone, clap::Args)]
pub struct ShellArgs {
    /// Name of the simulator to join; several run side by side under different names.
    #[arg(long, value_name = "NAME", default_value = "main", help_heading = None::<&str>)]
    pub instance: String,
    /// End when the parent process ends.
    #[arg(long, hide = true)]
    pub supervised: bool,
    /// Delay this process's work by so many milliseconds, to prove that the budgets notice.
    #[arg(long, default_value_t = 0.0, hide = true)]
    pub inject_delay_ms: f64,
    /// Logging.
    #[command(flatten)]
    pub log: LogArgs,
    /// Whether it takes part in a trace.
    #[command(flatten)]
    pub trace: TraceArgs,
}

/// Has the system send SIGTERM to this process when the thread that started it ends.
pub fn end_with_parent() {
    let term = Some(rustix::process::Signal::TERM);
    let _ = rustix::process::set_parent_process_death_signal(term);
}

/// A running process's ties to the launcher.
pub struct Shell {
    process: Process,
    stop: Arc<AtomicBool>,
    health: Sender<Health>,
    control: Receiver<Request>,
    answers: Sender<Answer>,
    delay_ns: u64,
    next_beat: Nanos,
    awake: Awake,
    /// The turn before served a command: another may wait whose notification is taken away already.
    served: bool,
    /// The next heartbeat; the process keeps it up to date.
    pub report: Health,
    /// What the process did with which field, where that is traced.
    pub trace: Trace,
}

impl Shell {
    /// Joins the instance and listens for SIGTERM and SIGINT.
    ///
    /// # Errors
    /// Where a signal handler is refused, or the instance cannot be joined.
    pub fn start(process: Process, args: &ShellArgs) -> Result<(Instance, Self), IpcError> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            let registered = signal_hook::flag::register(signal, Arc::clone(&stop));
            registered.map_err(|e| IpcError::Transport {
                channel: "node",
                operation: "signal handler",
                problem: e.to_string(),
            })?;
        }
        if args.supervised {
            end_with_parent();
        }
        let instance = Instance::join(&args.instance)?;
        let mut report: Health = bytemuck::Zeroable::zeroed();
        report.process = process as u32;
        report.pid = std::process::id();
        report.state = STATE_STARTING;
        let shell = Shell {
            process,
            stop,
            health: instance.sender()?,
            control: instance.receiver(Queue::InOrder)?,
            answers: instance.sender()?,
            delay_ns: (args.inject_delay_ms.max(0.0) * 1e6) as u64,
            next_beat: 0,
            awake: Awake::default(),
            served: false,
            report,
            trace: Trace::start(process, args.trace, instance.directory()),
        };
        Ok((instance, shell))
    }

    /// True once a signal or a shutdown request asked this process to end.
    pub fn stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Ends the process's loop.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Puts a text into the next heartbeat.
    pub fn set_text(&mut self, text: &str) {
        self.report.text = text_bytes(text);
    }

    /// Sends the heartbeat at once, for instance when a state has changed.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn beat_now(&mut self, at: Nanos) -> Result<(), IpcError> {
        self.next_beat = at + HEARTBEAT_NS;
        self.report.instant_ns = at;
        self.report.cpu_ns = cpu_ns();
        self.health.send(&self.report)
    }

    /// Sends the heartbeat if it is due, and returns the next command for this process. `Shutdown`
    /// and `Ping` are served here.
    fn next_command(&mut self, at: Nanos) -> Result<Option<(Request, Command)>, IpcError> {
        if at >= self.next_beat {
            self.beat_now(at)?;
        }
        while let Some(request) = self.control.next_valid()? {
            if !request.is_for(self.process) {
                continue;
            }
            match Command::from_wire(request.command) {
                Some(Command::Shutdown) => {
                    self.stop();
                    self.answer(&request, None)?;
                    return Ok(None);
                }
                Some(Command::Ping) => self.answer(&request, None)?,
                Some(command) => return Ok(Some((request, command))),
                None => {}
            }
        }
        Ok(None)
    }

    fn answer(&mut self, request: &Request, refusal: Option<&str>) -> Result<(), IpcError> {
        let text = text_bytes(refusal.unwrap_or(""));
        let result = u32::from(refusal.is_some());
        self.answers.send(&Answer { seq: request.seq, process: self.process as u32, result, text })
    }

    /// Sleeps until one of `channels` or a request wakes it, at most until `until` and at most
    /// [`MAX_WAIT_MS`].
    ///
    /// # Panics
    /// With [`MAX_SOURCES`] channels and more.
    pub fn rest(&self, channels: &[&dyn Wakes], until: Nanos) {
        let longest_ns = if self.served { 0 } else { MAX_WAIT_MS * 1_000_000 };
        let mut sources: [&dyn Wakes; MAX_SOURCES] = [&self.control; MAX_SOURCES];
        sources[..channels.len()].copy_from_slice(channels);
        wait(&sources[..=channels.len()], until.saturating_sub(now()).min(longest_ns));
    }

    /// [`Shell::rest`] beside files that bring work: it ends when one of them can be read, or was closed at its
    /// other end.
    ///
    /// # Panics
    /// With [`MAX_SOURCES`] files and more.
    pub fn rest_beside(&self, files: &[BorrowedFd<'_>]) {
        let longest_ns = if self.served { 0 } else { MAX_WAIT_MS * 1_000_000 };
        wait_beside(&[&self.control], files, longest_ns);
    }

    /// [`Shell::rest`] for work that is due at an instant and not before: from half a millisecond before it on
    /// nothing wakes it, and it ends at `due`.
    ///
    /// # Panics
    /// With [`MAX_SOURCES`] channels and more.
    pub fn rest_to(&self, channels: &[&dyn Wakes], due: Nanos) {
        if due.saturating_sub(now()) <= FINE_NS {
            sleep_until(due);
        } else {
            self.rest(channels, due - FINE_NS / 2);
        }
    }

    /// Sleeps for the injected delay, if there is one.
    pub fn inject_delay(&self) {
        if self.delay_ns > 0 {
            sleep_until(now() + self.delay_ns);
        }
    }

    /// The injected delay, ns, for a process that holds back what it sends.
    pub fn delay_ns(&self) -> u64 {
        self.delay_ns
    }
}
