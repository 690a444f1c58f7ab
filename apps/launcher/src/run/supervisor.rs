//! Starts the processes of a run, detects dead and hung processes, and restarts them.

use super::external::Presence;
use super::options::{RunArgs, View};
use super::policy::{CpuAccount, RestartLimit, WINDOW_NS};
use super::standby::{self, Standby};
use crate::children::{self, Child, LineSender, Surroundings, realtime_allowed};
use crate::exit::{WRONG_USE, WrongUse};
use crate::programs::{BRIDGE, STREAMS};
use anyhow::{Context, bail, ensure};
use diagnosis::Finding;
use ipc::{Instance, Sender};
use protocol::control::{Command, Request};
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_FINISHED, STATE_STARTING};
use protocol::limits::HEARTBEAT_LOST_NS;
use protocol::time::Nanos;
use std::sync::Arc;
use tokio::sync::Notify;

/// Timeout from the start of a process to its first heartbeat as ready, ns. Compiling shaders takes seconds
/// on a slow machine.
const START_NS: u64 = 60_000_000_000;
/// If the launcher itself was not running for this long (a suspended laptop), ns, it does not treat silence
/// as a hang.
const OWN_SLEEP_NS: u64 = 1_000_000_000;
/// Niceness of the renderer if the other processes are real-time processes: it takes precedence over programs
/// outside the simulator, if this user may do so.
const NICE_BESIDE_REALTIME: i32 = -5;
/// Niceness of the renderer if the other processes are ordinary processes: they take precedence over it.
const NICE_BESIDE_USUAL: i32 = 10;
/// Timeout of a start for the standby renderer, ns.
const PREPARE_NS: u64 = 15_000_000_000;

/// A change in the state of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProcessEvent {
    /// The process has opened its channels and is still preparing.
    Joined(Process),
    /// The process is ready, for the first time or after a restart.
    Ready(Process),
    /// The process died or hung and will be restarted; with a text about its end.
    Restarting(Process, String),
    /// The cameras have sent their last field.
    StreamEnded,
    /// The user closed the window.
    WindowClosed,
    /// An external driver sends no heartbeat.
    Gone(Process),
}

/// A process of the run.
#[derive(Debug)]
pub struct Slot {
    /// The process.
    pub process: Process,
    /// Its newest heartbeat.
    pub health: Option<Health>,
    /// Number of restarts.
    pub restarts: u32,
    /// Its CPU time since its first heartbeat, over all restarts.
    pub cpu: CpuAccount,
    /// The running child; `None` while it waits for its restart, after the end of the run, and for external
    /// drivers.
    child: Option<Child>,
    /// Time of the planned restart, ns.
    restart_at: Option<Nanos>,
    joined: bool,
    ready: bool,
    was_ready: bool,
    /// Time at which it became ready, ns.
    ready_at: Nanos,
    last_sign_ns: Nanos,
    limit: RestartLimit,
    /// State of an external driver, which the launcher does not start; `None` for other processes.
    pub presence: Option<Presence>,
}

/// Starts and restarts the processes of a run.
pub struct Supervisor {
    /// The processes of the run.
    pub slots: Vec<Slot>,
    pub(super) args: RunArgs,
    view: View,
    requests: Sender<Request>,
    requests_sent: u64,
    last_check_ns: Nanos,
    stream_ended: bool,
    standby: Standby,
    /// Receives the children's standard error.
    lines: LineSender,
    /// Notified when a child has ended.
    child_ended: Arc<Notify>,
}

impl Supervisor {
    /// Creates a supervisor without processes.
    ///
    /// # Errors
    /// If the channel of requests cannot be opened.
    pub fn new(instance: &Instance, args: &RunArgs, view: View, lines: LineSender) -> anyhow::Result<Self> {
        Ok(Self {
            slots: Vec::new(),
            args: args.clone(),
            view,
            requests: instance.sender()?,
            requests_sent: 0,
            last_check_ns: 0,
            stream_ended: false,
            standby: Standby::default(),
            lines,
            child_ended: Arc::default(),
        })
    }

    /// Notified when a child has ended; [`Supervisor::find_dead`] then finds it.
    pub fn child_ended(&self) -> Arc<Notify> {
        Arc::clone(&self.child_ended)
    }

    /// Starts a process; `remaining_s` is the remaining duration of the run, s.
    ///
    /// # Errors
    /// If the program is missing or cannot be started.
    pub fn start(&mut self, process: Process, remaining_s: Option<f64>, now: Nanos) -> anyhow::Result<()> {
        let child = self.spawn(process, remaining_s, 0, &[])?;
        let slot = self.slot(process, now);
        self.slots.push(Slot { child: Some(child), ..slot });
        Ok(())
    }

    /// Adds an external driver, which may connect and disconnect at any time.
    pub fn expect(&mut self, driver: Process, now: Nanos) {
        let slot = self.slot(driver, now);
        self.slots.push(Slot { presence: Some(Presence::default()), ..slot });
    }

    fn slot(&self, process: Process, now: Nanos) -> Slot {
        Slot {
            process,
            health: None,
            restarts: 0,
            cpu: CpuAccount::default(),
            child: None,
            restart_at: None,
            joined: false,
            ready: false,
            was_ready: false,
            ready_at: 0,
            last_sign_ns: now,
            limit: RestartLimit::of(self.args.trial.max_restarts),
            presence: None,
        }
    }

    fn spawn(
        &self,
        process: Process,
        remaining_s: Option<f64>,
        restarts: u32,
        extra: &[String],
    ) -> anyhow::Result<Child> {
        let mut args = self.args.arguments_of(process, self.view, remaining_s, restarts);
        args.extend_from_slice(extra);
        let (lines, ended) = (Some(self.lines.clone()), Arc::clone(&self.child_ended));
        let listens = extra.iter().any(|a| a == standby::OPTION);
        let mut surroundings = Surroundings { lines, ended, listens, ..Surroundings::default() };
        match process {
            Process::Renderer => {
                let threads = software_threads(realtime_allowed()).to_string();
                surroundings.environment = vec![("LP_NUM_THREADS", threads)];
                let niceness = if realtime_allowed() { NICE_BESIDE_REALTIME } else { NICE_BESIDE_USUAL };
                args.extend(["--niceness".into(), niceness.to_string()]);
            }
            // A field must not wait for the end of the renderer's time slice.
            _ => surroundings.realtime = true,
        }
        if process == Process::VirtualRig {
            surroundings.program = match self.args.real.streams() {
                Some(_) => Some(ipc::programs::find(STREAMS)?),
                None => self.args.real.program().map(Into::into),
            };
        }
        if process == Process::PosesDriver {
            surroundings.program = Some(ipc::programs::find(BRIDGE)?);
        }
        Child::spawn(process, &self.args.instance, &args, &surroundings)
    }

    /// True once every started process is ready.
    pub fn all_ready(&self) -> bool {
        self.ours().all(|s| s.ready && s.child.is_some())
    }

    /// True once every started process is ready and the standby renderer is prepared, if one is used.
    pub fn all_prepared(&self, now: Nanos) -> bool {
        let renderer = self.slots.iter().find(|s| s.process == Process::Renderer);
        let waited = renderer.map_or(0, |s| now.saturating_sub(s.ready_at));
        let needs_none = self.view != View::Headless || waited > PREPARE_NS;
        self.all_ready() && (needs_none || self.standby.is_prepared())
    }

    /// The processes that the launcher starts.
    fn ours(&self) -> impl Iterator<Item = &Slot> {
        self.slots.iter().filter(|s| s.presence.is_none())
    }

    /// Names of the processes that are not ready yet.
    pub fn awaited(&self) -> Vec<&'static str> {
        let late = self.ours().filter(|s| !s.ready || s.child.is_none());
        let standby = self.all_ready().then_some("the standby renderer");
        late.map(|s| s.process.name()).chain(standby).collect()
    }

    /// Adds a heartbeat. Returns a change in the state of its process.
    pub fn note(&mut self, beat: &Health, now: Nanos) -> Option<ProcessEvent> {
        let is_it = |s: &&mut Slot| match &s.presence {
            Some(_) => s.process as u32 == beat.process,
            None => s.child.as_ref().is_some_and(|c| c.pid() == beat.pid),
        };
        let slot = self.slots.iter_mut().find(is_it)?;
        if let Some(presence) = &mut slot.presence {
            // A new process of a driver that appears before the old one was missed must become ready again.
            slot.ready &= !presence.note(beat, now);
        }
        slot.health = Some(*beat);
        slot.last_sign_ns = now;
        if beat.state == STATE_STARTING {
            let first = !std::mem::replace(&mut slot.joined, true);
            return first.then_some(ProcessEvent::Joined(slot.process));
        }
        slot.cpu.note(beat.pid, beat.cpu_ns, beat.instant_ns);
        let first = !slot.ready;
        (slot.ready, slot.was_ready) = (true, true);
        if first {
            slot.ready_at = now;
        }
        let process = slot.process;
        if beat.state == STATE_FINISHED && beat.process == self.args.source() as u32 && !self.stream_ended {
            self.stream_ended = true;
            return Some(ProcessEvent::StreamEnded);
        }
        first.then_some(ProcessEvent::Ready(process))
    }

    /// Problem that cameras with streams of pictures report.
    pub fn trouble_of_streams(&self) -> Option<Finding> {
        self.args.real.streams()?;
        let source = self.slots.iter().find(|s| s.process == self.args.source());
        let health = source?.health.filter(|h| h.state == STATE_DEGRADED)?;
        Some(Finding {
            what: health.text(),
            cause: "its source delivers no usable pictures; tracking continues with the others".into(),
            remedy: "check its writer; it resumes by itself".into(),
            subject: "cameras".into(),
        })
    }

    /// Problem that a real pedal or real handles report.
    pub fn trouble_of_controls(&self) -> Option<Finding> {
        let controls = self.slots.iter().find(|s| s.process == Process::Controls)?;
        let health = controls.health.filter(|h| h.state == STATE_DEGRADED)?;
        Some(Finding {
            what: health.text(),
            cause: "the device, its cable, or the writer of its pipe; the run continues without it".into(),
            remedy: "check it with vitreo pedal or vitreo handles; it resumes by itself".into(),
            // With another subject, a different problem is reported again.
            subject: format!("pedal and handles: {}", health.text()),
        })
    }

    /// Problem that the tracker reports: fields that it refuses or frames that it withholds.
    pub fn trouble_of_tracker(&self) -> Option<Finding> {
        let tracker = self.slots.iter().find(|s| s.process == Process::Tracker)?;
        let health = tracker.health.filter(|h| h.state == STATE_DEGRADED)?;
        Some(Finding {
            what: format!("tracker: {}", health.text()),
            cause: "clock, counters or camera numbers of what sends them".into(),
            remedy: "check that program and the rig; the run continues with what can be used".into(),
            subject: format!("tracker: {}", health.text()),
        })
    }

    /// Number of restarts of a process.
    pub fn restarts_of(&self, process: Process) -> u32 {
        self.slots.iter().find(|s| s.process == process).map_or(0, |s| s.restarts)
    }

    /// Finds processes that have died, hung or disconnected, and plans the restarts.
    ///
    /// # Errors
    /// If a process does not start or dies too often.
    pub async fn find_dead(&mut self, now: Nanos) -> anyhow::Result<Vec<ProcessEvent>> {
        let slept = self.last_check_ns > 0 && now.saturating_sub(self.last_check_ns) > OWN_SLEEP_NS;
        self.last_check_ns = now;
        let mut events = Vec::new();
        for slot in &mut self.slots {
            if slept {
                slot.last_sign_ns = now;
            }
            if let Some(presence) = &mut slot.presence {
                if presence.has_gone(slot.last_sign_ns, now) {
                    slot.ready = false;
                    events.push(ProcessEvent::Gone(slot.process));
                }
                continue;
            }
            let Some(end) = slot.end(now).await else { continue };
            if end.orderly && slot.process == Process::Renderer && self.view == View::Window {
                events.push(ProcessEvent::WindowClosed);
                continue;
            }
            if end.orderly && slot.process == self.args.source() && self.stream_ended {
                continue;
            }
            if end.code == Some(WRONG_USE.into()) && !slot.was_ready {
                bail!(WrongUse(start_failure(slot.process, &end.how)));
            }
            let due = slot.may_restart(now, &end.how)?;
            // A standby has already started, so there is no reason to delay its promotion.
            let waits = slot.process == Process::Renderer && self.standby.waits();
            slot.restart_at = Some(if waits { now } else { due });
            slot.restarts += 1;
            slot.child = None;
            events.push(ProcessEvent::Restarting(slot.process, end.how));
        }
        Ok(events)
    }

    /// Restarts the processes that are due. `restart_arguments` returns additional arguments for a process,
    /// given whether it had been ready when it died.
    ///
    /// # Errors
    /// If a program is missing or cannot be started.
    pub fn restart_due(
        &mut self,
        now: Nanos,
        remaining_s: Option<f64>,
        mut restart_arguments: impl FnMut(Process, bool) -> Vec<String>,
    ) -> anyhow::Result<()> {
        for i in 0..self.slots.len() {
            let slot = &mut self.slots[i];
            if slot.restart_at.take_if(|at| *at <= now).is_none() {
                continue;
            }
            let (process, restarts) = (slot.process, slot.restarts);
            let further = restart_arguments(process, slot.ready);
            let child = match self.standby.take_over(process, &further) {
                Some(child) => child,
                None => self.spawn(process, remaining_s, restarts, &further)?,
            };
            let slot = &mut self.slots[i];
            (slot.child, slot.health, slot.last_sign_ns) = (Some(child), None, now);
            (slot.joined, slot.ready) = (false, false);
        }
        Ok(())
    }

    /// Prepares a standby renderer, if one is needed and the renderer is working.
    pub fn keep_standby(&mut self, now: Nanos) {
        let renderer = self.slots.iter().find(|s| s.process == Process::Renderer);
        let Some(renderer) = renderer.filter(|_| self.view == View::Headless) else { return };
        let (at_work, restarts) = (renderer.ready && renderer.child.is_some(), renderer.restarts);
        if self.standby.is_wanted(now, at_work) {
            // A failure is ignored: without a standby, a restart only takes longer.
            let child = self.spawn(Process::Renderer, None, restarts + 1, &[standby::OPTION.into()]);
            self.standby.set(child.ok());
        }
    }

    /// Sends a request. Returns its sequence number, which the answers repeat.
    pub fn ask(&mut self, target: u32, command: Command, argument: u64) -> u64 {
        let seq = self.requests_sent;
        self.requests_sent += 1;
        // A process that misses the request does not answer, or is ended by a signal.
        let _ = self.requests.send(&Request { seq, argument, target, command: command as u32 });
        seq
    }

    /// Ends all processes in order.
    pub async fn end(&mut self) -> Ends {
        self.standby = Standby::default();
        let children: Vec<Child> = self.slots.iter_mut().filter_map(|s| s.child.take()).collect();
        let killed = children::end_all(&children, &mut self.requests, self.requests_sent).await;
        let failed = children.iter().filter(|c| c.exited().is_some_and(|s| s.code().is_some_and(|c| c != 0)));
        Ends {
            killed: killed.iter().map(|p| format!("{} did not end and was killed", p.name())).collect(),
            failed: failed.map(Child::exit_report).collect(),
        }
    }
}

/// Processes that did not end as requested, as text.
pub struct Ends {
    /// Processes that had to be killed.
    pub killed: Vec<String>,
    /// Processes that ended with an error.
    pub failed: Vec<String>,
}

/// How a process ended.
struct End {
    /// True if it exited with code 0.
    orderly: bool,
    /// Exit code, if there is one.
    code: Option<i32>,
    /// Text for error messages, with the last lines of the process.
    how: String,
}

impl Slot {
    /// How the process ended; `None` if it runs. A process that hangs is killed first.
    async fn end(&mut self, now: Nanos) -> Option<End> {
        let child = self.child.as_ref()?;
        if let Some(status) = child.exited() {
            let (orderly, code) = (status.success(), status.code());
            return Some(End { orderly, code, how: child.exit_report() });
        }
        let patience = if self.ready { HEARTBEAT_LOST_NS } else { START_NS };
        let silent_ns = now.saturating_sub(self.last_sign_ns);
        if silent_ns <= patience {
            return None;
        }
        child.kill().await;
        let silent_s = silent_ns as f64 * 1e-9;
        let how = format!("{} sent no heartbeat for {silent_s:.1} s and was killed", self.process.binary());
        Some(End { orderly: false, code: None, how })
    }

    /// Time of the restart, ns. An error if a restart would not help: the process was never ready, or dies
    /// too often.
    fn may_restart(&mut self, now: Nanos, how: &str) -> anyhow::Result<Nanos> {
        ensure!(self.was_ready, "{}", start_failure(self.process, how));
        let (name, window_s) = (self.process.binary(), WINDOW_NS / 1_000_000_000);
        let worked_ns = if self.ready { now.saturating_sub(self.ready_at) } else { 0 };
        let at = self.limit.restart_at(now, worked_ns);
        at.with_context(|| {
            let most = self.limit.most();
            format!("{name} died more than {most} times in {window_s} s; the last time: {how}")
        })
    }
}

/// Phrases that only the renderer's messages about adapters and drivers contain.
const GRAPHICS: [&str; 2] = ["graphics driver", "graphics device"];

/// Message about a process that did not start, with a remedy if one is known.
fn start_failure(process: Process, how: &str) -> String {
    let hint = match process {
        Process::Renderer if GRAPHICS.iter().any(|word| how.contains(word)) => {
            "\nA software driver for the picture is installed by: sudo apt-get install mesa-vulkan-drivers libvulkan1\n\
             Everything but the picture runs without one: vitreo run --no-picture\n\
             vitreo doctor lists what this machine has and lacks"
        }
        _ => "",
    };
    format!("the {} did not start: {how}{hint}", process.name())
}

/// Number of threads of Mesa's software renderer. If tracker and simulation are real-time processes, they get
/// a processor whenever they need one, so the picture can use all processors (with half of them it takes 1.5
/// times as long, `docs/gpu.md`); otherwise one processor stays free.
fn software_threads(others_are_realtime: bool) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    if others_are_realtime { cores } else { cores.saturating_sub(1).max(1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_renderer_that_does_not_start_names_package_and_way_round() {
        let text = start_failure(Process::Renderer, "no graphics driver found");
        for word in ["no graphics driver", "mesa-vulkan-drivers", "--no-picture", "vitreo doctor"] {
            assert!(text.contains(word), "{word} is missing in {text}");
        }
        assert!(!start_failure(Process::Tracker, "x").contains("mesa"));
    }

    #[test]
    fn a_renderer_that_misses_a_file_advises_no_driver() {
        let text = start_failure(Process::Renderer, "fundus photograph eye.jpg: No such file or directory");
        assert!(
            text.contains("eye.jpg") && !text.contains("mesa") && !text.contains("--no-picture"),
            "{text}"
        );
    }
}
