//! Starts the processes of a run, detects dead and hung ones, and restarts them.

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

/// How long a process may take from its start to its first work, ns. Compiling shaders on a slow
/// machine takes some seconds.
const START_NS: u64 = 60_000_000_000;
/// After a pause of its own of this length (a suspended laptop) the launcher restarts no process
/// for its silence, ns.
const OWN_SLEEP_NS: u64 = 1_000_000_000;
/// Niceness of the renderer beside real-time processes: it goes before programs that have nothing to do
/// with the simulator, where this user has the right.
const NICE_BESIDE_REALTIME: i32 = -5;
/// The same where the others cannot be real-time processes: they still go first.
const NICE_BESIDE_USUAL: i32 = 10;
/// How long a start waits for the standby renderer.
const PREPARE_NS: u64 = 15_000_000_000;

/// A change in the state of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProcessEvent {
    /// A process has opened its channels and is still preparing.
    Joined(Process),
    /// A process is ready for work, at first or again.
    Ready(Process),
    /// A process died or hung and is being restarted; with the way it ended.
    Restarting(Process, String),
    /// The cameras will send nothing more.
    StreamEnded,
    /// The window was closed.
    WindowClosed,
    /// A driver gives no sign of life any more.
    Gone(Process),
}

/// One process of the run.
#[derive(Debug)]
pub struct Slot {
    /// Which.
    pub process: Process,
    /// Its newest heartbeat.
    pub health: Option<Health>,
    /// How often it was restarted.
    pub restarts: u32,
    /// Its CPU time while it was at work.
    pub cpu: CpuAccount,
    /// `None` while it waits for its restart, and once the run has ended.
    child: Option<Child>,
    /// When it is to be started again.
    restart_at: Option<Nanos>,
    joined: bool,
    ready: bool,
    was_ready: bool,
    /// When it became so.
    ready_at: Nanos,
    last_sign_ns: Nanos,
    limit: RestartLimit,
    /// Of a program of another maker, which is not ours to start.
    pub presence: Option<Presence>,
}

/// Starts and restarts the processes.
pub struct Supervisor {
    /// The processes of this run.
    pub slots: Vec<Slot>,
    pub(super) args: RunArgs,
    view: View,
    requests: Sender<Request>,
    requests_sent: u64,
    last_check_ns: Nanos,
    stream_ended: bool,
    standby: Standby,
    /// Collects the children's standard error.
    lines: LineSender,
    /// Notified when a child has ended.
    child_ended: Arc<Notify>,
}

impl Supervisor {
    /// Nothing runs yet.
    ///
    /// # Errors
    /// Where the channel of requests cannot be opened.
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

    /// Notified when a child has ended; [`Supervisor::check`] then finds out which.
    pub fn child_ended(&self) -> Arc<Notify> {
        Arc::clone(&self.child_ended)
    }

    /// Starts a process. `extra` arguments come after those of the run.
    ///
    /// # Errors
    /// Where its binary is absent or cannot be run.
    pub fn start(&mut self, process: Process, remaining_s: Option<f64>, now: Nanos) -> anyhow::Result<()> {
        let child = self.spawn(process, remaining_s, 0, &[])?;
        let slot = self.slot(process, now);
        self.slots.push(Slot { child: Some(child), ..slot });
        Ok(())
    }

    /// Expects a program of another maker, which comes and goes as it likes.
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
            // A field must not wait for a time slice of the renderer's to end.
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

    /// True once every started process is at work.
    pub fn all_ready(&self) -> bool {
        self.ours().all(|s| s.ready && s.child.is_some())
    }

    /// True once every started process is working and the standby is ready.
    pub fn all_prepared(&self, now: Nanos) -> bool {
        let renderer = self.slots.iter().find(|s| s.process == Process::Renderer);
        let waited = renderer.map_or(0, |s| now.saturating_sub(s.ready_at));
        let needs_none = self.view != View::Headless || waited > PREPARE_NS;
        self.all_ready() && (needs_none || self.standby.is_prepared())
    }

    /// The processes that the launcher has started.
    fn ours(&self) -> impl Iterator<Item = &Slot> {
        self.slots.iter().filter(|s| s.presence.is_none())
    }

    /// Names of the processes that are not ready yet.
    pub fn awaited(&self) -> Vec<&'static str> {
        let late = self.ours().filter(|s| !s.ready || s.child.is_none());
        let standby = self.all_ready().then_some("the standby renderer");
        late.map(|s| s.process.name()).chain(standby).collect()
    }

    /// Takes a heartbeat.
    pub fn note(&mut self, beat: &Health, now: Nanos) -> Option<ProcessEvent> {
        let is_it = |s: &&mut Slot| match &s.presence {
            Some(_) => s.process as u32 == beat.process,
            None => s.child.as_ref().is_some_and(|c| c.pid() == beat.pid),
        };
        let slot = self.slots.iter_mut().find(is_it)?;
        if let Some(presence) = &mut slot.presence {
            // A successor that started within a moment starts again.
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

    /// Problems reported by cameras that read pipes.
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

    /// Problems reported by a real pedal and real handles.
    pub fn trouble_of_controls(&self) -> Option<Finding> {
        let controls = self.slots.iter().find(|s| s.process == Process::Controls)?;
        let health = controls.health.filter(|h| h.state == STATE_DEGRADED)?;
        Some(Finding {
            what: health.text(),
            cause: "the device, its cable, or the writer of its pipe; the run continues without it".into(),
            remedy: "check it with vitreo pedal or vitreo handles; it resumes by itself".into(),
            // A different problem is reported again.
            subject: format!("pedal and handles: {}", health.text()),
        })
    }

    /// What the tracker refuses or withholds, in its words.
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

    /// How often a process was restarted.
    pub fn restarts_of(&self, process: Process) -> u32 {
        self.slots.iter().find(|s| s.process == process).map_or(0, |s| s.restarts)
    }

    /// Finds the processes that have ended or are silent, and plans their restarts.
    ///
    /// # Errors
    /// Where a process does not start or dies too often.
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
            // One that waits has nothing left to fail at.
            let waits = slot.process == Process::Renderer && self.standby.waits();
            slot.restart_at = Some(if waits { now } else { due });
            slot.restarts += 1;
            slot.child = None;
            events.push(ProcessEvent::Restarting(slot.process, end.how));
        }
        Ok(events)
    }

    /// Restarts the processes that are due. `restart_arguments` gives the further arguments of a process,
    /// which was at work when it died or was not.
    ///
    /// # Errors
    /// Where a binary is absent or cannot be run.
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

    /// Has a renderer wait to take over, once the one at work has found its pace.
    pub fn keep_standby(&mut self, now: Nanos) {
        let renderer = self.slots.iter().find(|s| s.process == Process::Renderer);
        let Some(renderer) = renderer.filter(|_| self.view == View::Headless) else { return };
        let (at_work, restarts) = (renderer.ready && renderer.child.is_some(), renderer.restarts);
        if self.standby.is_wanted(now, at_work) {
            // Without one a restart only takes longer.
            let child = self.spawn(Process::Renderer, None, restarts + 1, &[standby::OPTION.into()]);
            self.standby.set(child.ok());
        }
    }

    /// Sends a request; returns its number, which its answers carry.
    pub fn ask(&mut self, target: u32, command: Command, argument: u64) -> u64 {
        let seq = self.requests_sent;
        self.requests_sent += 1;
        // A process that misses it does not answer, or is ended by signal.
        let _ = self.requests.send(&Request { seq, argument, target, command: command as u32 });
        seq
    }

    /// Ends every process in order.
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

/// Of processes that were to end in order, those that did not, in words.
pub struct Ends {
    /// Had to be killed.
    pub killed: Vec<String>,
    /// Ended with an error.
    pub failed: Vec<String>,
}

/// How a process ended.
struct End {
    /// By itself, with success.
    orderly: bool,
    /// Its exit code, if it has one.
    code: Option<i32>,
    /// For a person, with its last lines.
    how: String,
}

impl Slot {
    /// How the process ended, if it has; one that hangs is killed first.
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

    /// When it is started again. Fails where that would not help: the process never worked, or dies
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

/// Words that only the renderer's messages about adapters and drivers contain.
const GRAPHICS: [&str; 2] = ["graphics driver", "graphics device"];

/// Why a process did not start, and what helps.
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

/// Threads of Mesa's software renderer. Where tracker and simulation are real-time processes they
/// take a core whenever they need one, and the picture may use them all (with half of them it takes
/// half as long again: `docs/gpu.md`); else one stays free.
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
