//! The child processes: finding their binaries, starting them, hearing their last words.
//!
//! Each child runs in a process group of its own, so that Ctrl-C reaches the launcher alone and
//! the end is in order; `--supervised` makes it end with its parent. Start children from a thread
//! that lives as long as they shall: the kernel ties them to the thread that started them.

use anyhow::{Context, bail};
use ipc::clock::{now, sleep_until};
use ipc::logging::arguments;
use ipc::{Receiver, Sender, instance_directory, wait};
use protocol::control::{Command as Order, EVERY_PROCESS, Request};
use protocol::health::{Health, Process, STATE_STARTING};
use protocol::limits::MAX_WAIT_MS;
use protocol::time::Nanos;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;

/// Lines of a child's output that are kept for messages.
const TAIL_LINES: usize = 30;
/// Longest line that is kept, bytes; a longer one is cut into several.
const LINE_BYTES: u64 = 4096;
/// A child's log file stops growing here, bytes.
const LOG_BYTES: usize = 1 << 20;
/// How long a child may take to follow a request to end, ns.
const SHUTDOWN_NS: u64 = 3_000_000_000;
/// How long it may then take to follow SIGTERM, ns; after that comes SIGKILL.
const TERMINATE_NS: u64 = 1_000_000_000;
/// Period of looking whether a child has ended, ns.
const LOOK_NS: u64 = 5_000_000;

/// The directories where the binaries may be, given the path of this executable: beside it, and
/// for a test program in `target/PROFILE/deps`, one up.
fn candidates(executable: &Path) -> Vec<PathBuf> {
    let beside = executable.parent().map(Path::to_path_buf);
    let above = beside.as_deref().filter(|d| d.ends_with("deps")).and_then(Path::parent);
    let above = above.map(Path::to_path_buf);
    above.into_iter().chain(beside).collect()
}

/// Path of a binary of this installation, for instance `vitreo-tracker`.
pub fn find_binary(name: &str) -> anyhow::Result<PathBuf> {
    let executable = std::env::current_exe().context("path of the running program")?;
    let places = candidates(&executable);
    let found = places.iter().map(|d| d.join(name)).find(|p| p.is_file());
    found.with_context(|| {
        let first = places.first().map(|d| d.display().to_string()).unwrap_or_default();
        format!("{name} is not in {first}; build everything with: cargo build --release --workspace")
    })
}

/// How to start a child, besides its arguments.
#[derive(Debug, Clone, Default)]
pub struct Surroundings {
    /// Environment variables, set only where the user has not set them.
    pub environment: Vec<(&'static str, String)>,
    /// Niceness, 0 to 19; a nicer process lets the others go first.
    pub nice: i32,
    /// Real-time scheduling, where this user may ask for it: it runs as soon as it wakes up.
    pub realtime: bool,
}

/// Priority of real-time processes, 1 to 99; above ordinary ones, below the kernel's own threads.
const REALTIME_PRIORITY: &str = "10";

/// True if `chrt` is there and this user may start real-time processes. Tried once.
pub fn realtime_allowed() -> bool {
    static ALLOWED: OnceLock<bool> = OnceLock::new();
    *ALLOWED.get_or_init(|| {
        let mut attempt = Command::new("chrt");
        attempt.args(["--rr", REALTIME_PRIORITY, "true"]);
        attempt.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        attempt.status().is_ok_and(|s| s.success())
    })
}

/// The command that runs `binary`, under the real-time scheduler if so wished.
fn command_of(binary: &Path, realtime: bool) -> Command {
    if !realtime {
        return Command::new(binary);
    }
    // `chrt` replaces itself by the binary: the child's id is the binary's.
    let mut command = Command::new("chrt");
    command.args(["--rr", REALTIME_PRIORITY]).arg(binary);
    command
}

/// The last lines a child wrote.
#[derive(Debug, Default)]
struct Tail {
    lines: VecDeque<String>,
}

impl Tail {
    fn push(&mut self, line: String) {
        if self.lines.len() == TAIL_LINES {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
    }
}

/// A child process. Dropping it kills it.
#[derive(Debug)]
pub struct Child {
    process: Process,
    child: std::process::Child,
    tail: Arc<Mutex<Tail>>,
    readers: Vec<JoinHandle<()>>,
    ended: Option<ExitStatus>,
    started_ns: Nanos,
}

impl Child {
    /// Starts `process` in the instance `instance` with `--supervised` and further arguments.
    pub fn spawn(process: Process, instance: &str, args: &[String]) -> anyhow::Result<Self> {
        Self::spawn_in(process, instance, args, &Surroundings::default())
    }

    /// Starts `process` with an environment and a niceness of its own.
    pub fn spawn_in(
        process: Process,
        instance: &str,
        args: &[String],
        surroundings: &Surroundings,
    ) -> anyhow::Result<Self> {
        let binary = find_binary(process.binary())?;
        let mut command = command_of(&binary, surroundings.realtime && realtime_allowed());
        command.args(["--instance", instance, "--supervised"]).args(arguments()).args(args);
        for (name, value) in &surroundings.environment {
            if std::env::var_os(name).is_none() {
                command.env(name, value);
            }
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        let mut child = command.spawn().with_context(|| format!("start {}", binary.display()))?;
        if surroundings.nice > 0 {
            let pid = rustix::process::Pid::from_child(&child);
            // Without it the child works too, only less politely.
            let _ = rustix::process::setpriority_process(Some(pid), surroundings.nice);
        }
        let tail = Arc::new(Mutex::new(Tail::default()));
        let log = Arc::new(Mutex::new(open_log(instance, process)));
        let pipes: [Option<Box<dyn Read + Send>>; 2] =
            [child.stdout.take().map(|p| Box::new(p) as _), child.stderr.take().map(|p| Box::new(p) as _)];
        let read = |pipe| listen(pipe, Arc::clone(&tail), Arc::clone(&log));
        let readers = pipes.into_iter().flatten().map(read).collect();
        Ok(Child { process, child, tail, readers, ended: None, started_ns: now() })
    }

    /// Which process it is.
    pub fn process(&self) -> Process {
        self.process
    }

    /// Its operating-system id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// When it was started.
    pub fn started_ns(&self) -> Nanos {
        self.started_ns
    }

    /// Its exit status, once it has ended.
    pub fn exited(&mut self) -> Option<ExitStatus> {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().unwrap_or(None);
            if self.ended.is_some() {
                self.hear_out();
            }
        }
        self.ended
    }

    /// The last lines that it wrote.
    pub fn last_words(&self) -> Vec<String> {
        self.tail.lock().unwrap_or_else(PoisonError::into_inner).lines.iter().cloned().collect()
    }

    /// How it ended, with its last words, for a message to a person.
    pub fn obituary(&mut self) -> String {
        let how = match self.exited() {
            Some(status) => format!("ended ({status})"),
            None => "is running".into(),
        };
        let words: String = self.last_words().iter().map(|l| format!("\n    {l}")).collect();
        format!("{} {how}{words}", self.process.binary())
    }

    /// Asks it to end, by SIGTERM.
    pub fn terminate(&mut self) {
        if self.exited().is_none() {
            let pid = rustix::process::Pid::from_child(&self.child);
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
    }

    /// Ends it at once, by SIGKILL, and waits until it is gone.
    pub fn kill(&mut self) {
        if self.exited().is_none() {
            let _ = self.child.kill();
            self.ended = self.child.wait().ok();
            self.hear_out();
        }
    }

    /// Waits for the threads that read its output: its pipes are closed now.
    fn hear_out(&mut self) {
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        self.kill();
    }
}

fn open_log(instance: &str, process: Process) -> Option<File> {
    let directory = instance_directory(instance).ok()?;
    File::options().create(true).append(true).open(directory.join(format!("{}.log", process.name()))).ok()
}

/// Reads a child's pipe to its end on a thread of its own, so that the child never blocks on it.
fn listen(
    pipe: Box<dyn Read + Send>,
    tail: Arc<Mutex<Tail>>,
    log: Arc<Mutex<Option<File>>>,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let mut reader = BufReader::new(pipe);
        let (mut line, mut written) = (Vec::new(), 0);
        while let Ok(bytes @ 1..) = reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line) {
            let text = String::from_utf8_lossy(&line).trim_end().to_string();
            tail.lock().unwrap_or_else(PoisonError::into_inner).push(text);
            written += bytes;
            if let (Some(file), true) =
                (&mut *log.lock().unwrap_or_else(PoisonError::into_inner), written < LOG_BYTES)
            {
                let _ = file.write_all(&line);
            }
            line.clear();
        }
    })
}

/// Waits until every child has said that it works, for at most `timeout_ns`. `health` must have
/// been opened before the children were started. Fails with the last words of a child that ends.
pub fn wait_until_running(
    health: &mut Receiver<Health>,
    children: &mut [Child],
    timeout_ns: u64,
    stop: &dyn Fn() -> bool,
) -> anyhow::Result<()> {
    let deadline = now() + timeout_ns;
    let mut waiting: Vec<u32> = children.iter().map(Child::pid).collect();
    while !waiting.is_empty() {
        wait(&[&*health], MAX_WAIT_MS * 1_000_000);
        while let Some(beat) = health.next_valid()? {
            if beat.state != STATE_STARTING {
                waiting.retain(|&pid| pid != beat.pid);
            }
        }
        for child in children.iter_mut() {
            if child.exited().is_some_and(|status| !status.success() || waiting.contains(&child.pid())) {
                bail!("{}", child.obituary());
            }
        }
        if stop() {
            bail!("stopped while the processes were starting");
        }
        if now() > deadline && !waiting.is_empty() {
            let late: Vec<String> =
                children.iter_mut().filter(|c| waiting.contains(&c.pid())).map(Child::obituary).collect();
            bail!("not ready after {} s: {}", timeout_ns / 1_000_000_000, late.join("; "));
        }
    }
    Ok(())
}

/// Waits until every child has ended, for at most `timeout_ns`; says whether all have.
fn await_end(children: &mut [Child], timeout_ns: u64) -> bool {
    let deadline = now() + timeout_ns;
    loop {
        if children.iter_mut().all(|c| c.exited().is_some()) {
            return true;
        }
        if now() > deadline {
            return false;
        }
        sleep_until(now() + LOOK_NS);
    }
}

/// Ends children in order: a request, then SIGTERM, then SIGKILL. Returns who had to be killed.
pub fn end_all(children: &mut [Child], requests: Option<&mut Sender<Request>>, seq: u64) -> Vec<Process> {
    if let Some(requests) = requests {
        let shutdown = Request { seq, argument: 0, target: EVERY_PROCESS, command: Order::Shutdown as u32 };
        if requests.send(&shutdown).is_ok() && await_end(children, SHUTDOWN_NS) {
            return Vec::new();
        }
    }
    children.iter_mut().for_each(Child::terminate);
    if await_end(children, TERMINATE_NS) {
        return Vec::new();
    }
    let mut killed = Vec::new();
    for child in children.iter_mut().filter_map(|c| c.exited().is_none().then_some(c)) {
        child.kill();
        killed.push(child.process());
    }
    killed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binaries_are_sought_beside_the_program_and_above_a_test() {
        assert_eq!(candidates(Path::new("/x/bin/vitreo")), [Path::new("/x/bin")]);
        let test = candidates(Path::new("/x/target/debug/deps/t-1"));
        assert_eq!(test, [Path::new("/x/target/debug"), Path::new("/x/target/debug/deps")]);
    }

    #[test]
    fn a_missing_binary_says_how_to_build_it() {
        let error = find_binary("vitreo-no-such-thing").unwrap_err().to_string();
        assert!(error.contains("cargo build --release --workspace"), "{error}");
    }

    #[test]
    fn the_tail_keeps_the_newest_lines() {
        let mut tail = Tail::default();
        (0..TAIL_LINES + 3).for_each(|i| tail.push(i.to_string()));
        assert_eq!(tail.lines.len(), TAIL_LINES);
        assert_eq!(tail.lines.front().unwrap(), "3");
    }

    #[test]
    fn a_pipe_is_read_to_its_end_and_cut_into_lines() {
        let tail = Arc::new(Mutex::new(Tail::default()));
        let text = format!("one\n{}\nlast", "x".repeat(LINE_BYTES as usize + 10));
        let pipe = Box::new(std::io::Cursor::new(text.into_bytes()));
        listen(pipe, Arc::clone(&tail), Arc::new(Mutex::new(None))).join().unwrap();
        let lines = &tail.lock().unwrap().lines;
        assert_eq!(lines.len(), 4);
        assert_eq!(lines[1].len(), LINE_BYTES as usize);
        assert_eq!(lines[3], "last");
    }
}
