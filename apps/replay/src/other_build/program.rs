//! Another build as a program: whether it is one, what it can do, and running it, to its end or until the user
//! has enough.

use crate::pace::Stopped;
use crate::stop::StopSignal;
use anyhow::{Context, bail};
use outputs::exit::{LOSS, WrongUse};
use outputs::printable;
use rustix::process::{Pid, Signal, kill_process_group};
use std::fmt;
use std::io::Read;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// How long a build may think about its version or its help.
const ANSWER: Duration = Duration::from_secs(30);
/// How long one that was asked to end may take. Less than a user waits until he asks again, which ends this
/// program at once.
const END: Duration = Duration::from_millis(400);
/// Between two looks at whether it has ended.
const LOOK: Duration = Duration::from_millis(20);
/// How long what it wrote may take to arrive once it has ended: somebody whom it started may hold the pipe.
const ARRIVAL: Duration = Duration::from_secs(1);
/// What is kept of what it says: the last of it, bytes.
const TOLD: usize = 64 << 10;
/// Lines of it that are shown.
const LINES: usize = 4;

/// Another build.
#[derive(Debug)]
pub struct Build {
    /// Its program.
    pub program: PathBuf,
    /// Its version, as it says.
    pub version: String,
    /// Reads no settings of the user where it knows how to: they would change what it does.
    without_settings: bool,
}

/// How it ended, where it did its work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// Well.
    Well,
    /// It says that something is missing of the recording.
    WithLoss,
}

impl fmt::Display for Build {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (vitreo {})", self.program.display(), self.version)
    }
}

impl Build {
    /// Asks a program whether it is a vitreo that can record what it makes of a recording.
    ///
    /// # Errors
    /// Where it is no program, no vitreo, or lacks that; where a signal came.
    pub fn ask(program: &Path, stop: &StopSignal) -> anyhow::Result<Self> {
        if !program.is_file() {
            let what = program.display();
            bail!(WrongUse(format!(
                "--with {what}: expected the program vitreo or vitreo-replay of another build, found no file"
            )));
        }
        // A name without a folder would be sought among the system's programs.
        let program = program.canonicalize().with_context(|| program.display().to_string())?;
        let said = answer(&program, &["--version"], stop)?;
        let version = said.strip_prefix("vitreo ").and_then(|rest| rest.split_whitespace().next());
        let Some(version) = version else {
            bail!(WrongUse(format!(
                "--with {}: is not vitreo: its version output is '{}'",
                program.display(),
                printable(said.lines().next().unwrap_or_default())
            )));
        };
        let version = printable(version).into_owned();
        let help = answer(&program, &["replay", "--help"], stop)?;
        let without_settings = help.contains("--no-config");
        let build = Build { program, version, without_settings };
        if !help.contains("--output") {
            bail!(
                "{build}: cannot record a replay: its replay has no --output; compare replay FILE --lockstep --poses OUT.csv of both builds instead"
            );
        }
        Ok(build)
    }

    /// Begins to run `recording` again, as the recording `output`.
    ///
    /// # Errors
    /// Where it cannot be started.
    pub fn replay(&self, recording: &Path, output: &Path) -> anyhow::Result<Running<'_>> {
        let mut command = Command::new(&self.program);
        command.args(self.without_settings.then_some("--no-config"));
        command.arg("replay").arg(recording).arg("-o").arg(output).stdout(Stdio::null());
        Ok(Running { build: self, output: output.into(), child: Group::start(&self.program, command)? })
    }
}

/// A build that runs a recording again.
#[derive(Debug)]
pub struct Running<'a> {
    build: &'a Build,
    output: PathBuf,
    child: Group,
}

impl Running<'_> {
    /// Waits for its end.
    ///
    /// # Errors
    /// Where it fails, crashes or writes nothing, or a signal came, which is passed on.
    pub fn finish(mut self, stop: &StopSignal) -> anyhow::Result<Ended> {
        let status = self.child.wait(stop, None)?.context("it has ended")?;
        let build = self.build;
        let last_output = self.child.last_output();
        let ended = match (status.code(), status.signal()) {
            (Some(0), _) => Ended::Well,
            (Some(code), _) if code == i32::from(LOSS) => Ended::WithLoss,
            (Some(code), _) => bail!("{build}: failed with exit code {code}{last_output}"),
            (None, Some(signal)) => bail!("{build}: crashed, by signal {signal}{last_output}"),
            (None, None) => bail!("{build}: ended without an exit code{last_output}"),
        };
        if !self.output.is_file() {
            bail!("{build}: exited successfully without writing a recording{last_output}");
        }
        Ok(ended)
    }
}

/// What a program writes to standard output when it is asked.
fn answer(program: &Path, words: &[&str], stop: &StopSignal) -> anyhow::Result<String> {
    let mut command = Command::new(program);
    command.args(words).stdout(Stdio::piped());
    let mut child = Group::start(program, command)?;
    let said = child.child.stdout.take().map(last_of);
    let name = format!("{} {}", program.display(), words.join(" "));
    let Some(status) = child.wait(stop, Some(Instant::now() + ANSWER))? else {
        bail!("--with: {name}: no answer after {} s", ANSWER.as_secs());
    };
    if !status.success() {
        bail!(WrongUse(format!("--with: {name}: failed ({status}): is it vitreo?{}", child.last_output())));
    }
    let said = said.and_then(|said| said.recv_timeout(ARRIVAL).ok());
    Ok(String::from_utf8_lossy(&said.unwrap_or_default()).into_owned())
}

/// A program with all that it starts; dropped, they are ended.
#[derive(Debug)]
struct Group {
    child: Child,
    errors: Receiver<Vec<u8>>,
    ended: bool,
}

impl Group {
    fn start(program: &Path, mut command: Command) -> anyhow::Result<Self> {
        command.stdin(Stdio::null()).stderr(Stdio::piped()).process_group(0);
        // This program has already reported which settings files are ignored.
        command.env(settings::ALREADY_REPORTED, "1");
        let mut child =
            command.spawn().with_context(|| format!("--with {}: cannot be started", program.display()))?;
        let errors = child.stderr.take().map(last_of).context("its standard error")?;
        Ok(Group { child, errors, ended: false })
    }

    /// Waits for its end, `until` at most; `None` where that has come.
    fn wait(&mut self, stop: &StopSignal, until: Option<Instant>) -> anyhow::Result<Option<ExitStatus>> {
        loop {
            if let Some(status) = self.child.try_wait()? {
                self.ended = true;
                return Ok(Some(status));
            }
            if stop.is_raised() {
                bail!(Stopped);
            }
            if until.is_some_and(|until| Instant::now() >= until) {
                return Ok(None);
            }
            stop.wait_until(Instant::now() + LOOK);
        }
    }

    /// The last lines that it wrote to standard error, behind a colon; once it has ended.
    fn last_output(&self) -> String {
        let bytes = self.errors.recv_timeout(ARRIVAL).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let lines: Vec<_> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let last = lines[lines.len().saturating_sub(LINES)..].join("; ");
        if last.is_empty() { last } else { format!(": {}", printable(&last)) }
    }

    fn signal(&self, signal: Signal) {
        if let Some(group) = Pid::from_raw(self.child.id().cast_signed()) {
            let _ = kill_process_group(group, signal);
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if self.ended {
            return;
        }
        self.signal(Signal::INT);
        let until = Instant::now() + END;
        while Instant::now() < until && matches!(self.child.try_wait(), Ok(None)) {
            std::thread::sleep(LOOK);
        }
        // Also those whom it left behind.
        self.signal(Signal::KILL);
        let _ = self.child.wait();
    }
}

/// The last of what comes, once no more will.
fn last_of(mut from: impl Read + Send + 'static) -> Receiver<Vec<u8>> {
    let (all, receiver) = channel();
    std::thread::spawn(move || {
        let (mut last, mut buffer) = (Vec::new(), [0; 8 << 10]);
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            last.extend_from_slice(&buffer[..count]);
            last.drain(..last.len().saturating_sub(TOLD));
        }
        let _ = all.send(last);
    });
    receiver
}
