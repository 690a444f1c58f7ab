//! Child processes: starts them, reads their output, ends them.
//!
//! Each child has a process group of its own, so that Ctrl-C reaches only the launcher, which then ends the
//! children in order. With `--supervised` a child ends with its parent. Children must be started from the
//! main thread, because the kernel ties them to the thread that started them.

mod output;
mod scheduler;

pub use output::LineSender;
pub use scheduler::{REALTIME_PRIORITY, raise_this_thread, realtime_allowed};

use crate::runtime::{StopSignal, Wakeups};
use anyhow::{Context, bail};
use ipc::logging::{arguments, is_json};
use ipc::{Receiver, Sender, instance_directory, programs, wait};
use output::Output;
use protocol::control::{Command as ControlCommand, EVERY_PROCESS, Request};
use protocol::health::{Health, Process, STATE_STARTING};
use rustix::process::{Pid, Signal, kill_process};
use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, timeout};

/// Timeout for a child to follow a request to end.
const SHUTDOWN: Duration = Duration::from_secs(3);
/// Timeout for a child to follow SIGTERM, before SIGKILL is sent.
const TERMINATE: Duration = Duration::from_secs(1);
/// Timeout for the remaining output of a dead child, whose own children may still hold the pipe.
const LAST_OUTPUT: Duration = Duration::from_secs(1);
/// Maximum wait for a heartbeat between two checks of the deadline.
const HEARTBEAT_WAIT: Duration = Duration::from_millis(50);
/// How long before fields are due a tracker under the real-time scheduler wakes up, µs. Tracking a frame with
/// cold caches takes up to 0.5 ms.
const READY_AHEAD_US: &str = "700";

/// How to start a child, apart from its arguments.
#[derive(Debug, Clone, Default)]
pub struct Surroundings {
    /// Environment variables, set only if the user has not set them.
    pub environment: Vec<(&'static str, String)>,
    /// True to use the real-time scheduler, if this user may do so.
    pub realtime: bool,
    /// True to keep the child's standard input open for [`Child::write_line`].
    pub listens: bool,
    /// Program to start instead of the one that usually does the work of this process.
    pub program: Option<PathBuf>,
    /// Receives the lines of the child's standard error; `None` for the launcher's standard error.
    pub lines: Option<LineSender>,
    /// Notified when the child has ended.
    pub ended: Arc<Notify>,
}

/// A child process. Dropping it kills it, without waiting for it.
#[derive(Debug)]
pub struct Child {
    process: Process,
    /// File name of its program.
    name: String,
    pid: u32,
    output: Arc<Output>,
    /// Its standard input, if it is open.
    input: Option<File>,
    /// True once the child has written the line `ready`.
    is_ready: Arc<AtomicBool>,
    /// Its exit status, set after it has ended and its output has been read.
    status: watch::Receiver<Option<ExitStatus>>,
}

impl Child {
    /// Starts `process` in the instance `instance`, with `--supervised` and the arguments `args`.
    ///
    /// # Errors
    /// If the program is missing or cannot be started.
    pub fn spawn(
        process: Process,
        instance: &str,
        args: &[String],
        surroundings: &Surroundings,
    ) -> anyhow::Result<Self> {
        let realtime = surroundings.realtime && realtime_allowed();
        let program = match &surroundings.program {
            Some(program) => program.clone(),
            None => programs::find(process.binary())?,
        };
        let mut command = scheduler::scheduled_command(&program, realtime);
        command.args(["--instance", instance, "--supervised"]).args(arguments()).args(args);
        if realtime && process == Process::Tracker && surroundings.program.is_none() {
            command.args(["--ready-ahead-us", READY_AHEAD_US]);
        }
        for (name, value) in &surroundings.environment {
            if std::env::var_os(name).is_none() {
                command.env(name, value);
            }
        }
        let input = if surroundings.listens { Stdio::piped() } else { Stdio::null() };
        command.stdin(input).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut command = tokio::process::Command::from(command);
        let child = command.process_group(0).kill_on_drop(true).spawn();
        let name = program.file_name().unwrap_or_default().display().to_string();
        let mut child = child.with_context(|| format!("start {}", program.display()))?;
        let input = child.stdin.take().and_then(|input| input.into_owned_fd().ok()).map(File::from);
        let pid = child.id().context("the id of a child")?;
        let output = Arc::new(Output::new(open_log(instance, process)));
        let (end, status) = watch::channel(None);
        let is_ready = Arc::<AtomicBool>::default();
        tokio::spawn(attend(child, Arc::clone(&output), Arc::clone(&is_ready), surroundings.clone(), end));
        Ok(Child { process, name, pid, output, input, is_ready, status })
    }

    /// The process whose work the child does.
    pub fn process(&self) -> Process {
        self.process
    }

    /// Its operating-system process id.
    pub fn pid(&self) -> u32 {
        self.pid
    }

    /// Its exit status; `None` while it runs.
    pub fn exited(&self) -> Option<ExitStatus> {
        *self.status.borrow()
    }

    /// Waits until the child has ended.
    pub async fn ended(&self) {
        // An error means that the task that waits for the child is gone.
        let _ = self.status.clone().wait_for(Option::is_some).await;
    }

    /// How the child ended, with its last lines, for error messages. If messages are JSON records, the lines
    /// have already been passed on and are left out.
    pub fn exit_report(&self) -> String {
        let how = match self.exited() {
            Some(status) => format!("ended ({status})"),
            None => "is running".into(),
        };
        let lines = if is_json() { Vec::new() } else { self.output.tail() };
        let lines: String = lines.iter().map(|l| format!("\n    {l}")).collect();
        format!("{} {how}{lines}", self.name)
    }

    /// Writes a line to the child's standard input and closes it.
    ///
    /// # Errors
    /// If standard input is not open, or the child has ended.
    pub fn write_line(&mut self, line: &str) -> io::Result<()> {
        let mut input = self.input.take().ok_or(io::ErrorKind::BrokenPipe)?;
        input.write_all(format!("{line}\n").as_bytes())
    }

    /// True once the child has written the line `ready` to its standard output.
    pub fn is_ready(&self) -> bool {
        self.is_ready.load(Ordering::Relaxed)
    }

    /// Sends SIGTERM.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Sends SIGKILL and waits until the child has ended.
    pub async fn kill(&self) {
        self.signal(Signal::KILL);
        self.ended().await;
    }

    fn signal(&self, signal: Signal) {
        if self.exited().is_none()
            && let Some(pid) = Pid::from_raw(self.pid as i32)
        {
            let _ = kill_process(pid, signal);
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
    }
}

/// Reads the output of a child, waits for its end, and publishes its exit status.
async fn attend(
    mut child: tokio::process::Child,
    output: Arc<Output>,
    is_ready: Arc<AtomicBool>,
    surroundings: Surroundings,
    end: watch::Sender<Option<ExitStatus>>,
) {
    let Surroundings { lines, ended, .. } = surroundings;
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let written = Arc::clone(&output);
    let printed = tokio::spawn(async move {
        if let Some(pipe) = stdout {
            let note = |line: &str| {
                is_ready.fetch_or(line == "ready", Ordering::Relaxed);
            };
            written.read(pipe, note).await;
        }
    });
    let logged = tokio::spawn(async move {
        if let Some(pipe) = stderr {
            output.read(pipe, |line| output::pass_on(line, lines.as_ref())).await;
        }
    });
    let status = child.wait().await;
    let _ = timeout(LAST_OUTPUT, async { (printed.await, logged.await) }).await;
    match status {
        Ok(status) => drop(end.send(Some(status))),
        Err(error) => tracing::error!("waiting for a child: {error}"),
    }
    ended.notify_one();
}

fn open_log(instance: &str, process: Process) -> Option<File> {
    let directory = instance_directory(instance).ok()?;
    File::options().create(true).append(true).open(directory.join(format!("{}.log", process.name()))).ok()
}

/// Waits until the heartbeats of all children report that they have started, for at most `limit`. `health`
/// must have been opened before the children were started; `ended` is that of their [`Surroundings`].
///
/// # Errors
/// If a child ends early or is late (with its last lines), `stop` is raised, or the channel fails.
pub async fn wait_until_running(
    health: &mut Receiver<Health>,
    children: &[Child],
    ended: &Notify,
    limit: Duration,
    stop: &StopSignal,
) -> anyhow::Result<()> {
    let deadline = Instant::now() + limit;
    let wakeups = Wakeups::of(&[&*health])?;
    let mut waiting: Vec<u32> = children.iter().map(Child::pid).collect();
    while !waiting.is_empty() {
        tokio::select! {
            () = wakeups.wait(HEARTBEAT_WAIT) => {}
            () = ended.notified() => {}
            () = stop.raised() => bail!("stopped while the processes were starting"),
        }
        wait(&[&*health], 0);
        while let Some(beat) = health.next_valid()? {
            if beat.state != STATE_STARTING {
                waiting.retain(|&pid| pid != beat.pid);
            }
        }
        for child in children {
            if child.exited().is_some_and(|status| !status.success() || waiting.contains(&child.pid())) {
                bail!("{}", child.exit_report());
            }
        }
        if Instant::now() > deadline && !waiting.is_empty() {
            let late = children.iter().filter(|c| waiting.contains(&c.pid()));
            let late: Vec<String> = late.map(Child::exit_report).collect();
            bail!("not ready after {} s: {}", limit.as_secs(), late.join("; "));
        }
    }
    Ok(())
}

/// Waits until all children have ended, for at most `limit`; false if some have not.
async fn all_ended(children: &[Child], limit: Duration) -> bool {
    let all = async {
        for child in children {
            child.ended().await;
        }
    };
    timeout(limit, all).await.is_ok()
}

/// Ends the children: by a request, then SIGTERM, then SIGKILL. Returns the processes that were killed.
pub async fn end_all(children: &[Child], requests: &mut Sender<Request>, seq: u64) -> Vec<Process> {
    let command = ControlCommand::Shutdown as u32;
    let shutdown = Request { seq, argument: 0, target: EVERY_PROCESS, command };
    if requests.send(&shutdown).is_ok() && all_ended(children, SHUTDOWN).await {
        return Vec::new();
    }
    children.iter().for_each(Child::terminate);
    if all_ended(children, TERMINATE).await {
        return Vec::new();
    }
    let mut killed = Vec::new();
    for child in children.iter().filter(|c| c.exited().is_none()) {
        child.kill().await;
        killed.push(child.process());
    }
    killed
}
