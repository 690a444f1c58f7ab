//! Restarts of dead processes: their arguments, and the reports about them.

use super::Session;
use crate::run::report::Incident;
use crate::run::resume::Origin;
use crate::run::supervisor::ProcessEvent;
use ipc::clock::now;
use protocol::events::{Event, EventKind};
use protocol::health::Process;
use protocol::time::Nanos;
use recording::{Note, NoteKind};

/// Message if the simulation could not resume.
const STATE_LOST: &str = "simcore restarts from its scene: the state of the eye is lost";

/// Reached goals of the task, one bit each, for a restarted surgeon, which has not received the events.
#[derive(Debug, Default)]
pub(super) struct GoalsReached(u64);

impl GoalsReached {
    pub(super) fn note(&mut self, event: &Event) {
        if event.kind == EventKind::TaskStarted as u32 {
            self.0 = 0;
        } else if event.kind == EventKind::GoalReached as u32 {
            self.0 |= 1u64.checked_shl(event.subject).unwrap_or(0);
        }
    }
}

impl Session<'_> {
    /// Finds dead processes, restarts those that are due, and writes the journal for a simulation that has
    /// joined. All messages of a dead process have been received before its successor starts.
    pub(super) async fn supervise(&mut self, events: &mut Vec<ProcessEvent>) -> anyhow::Result<()> {
        let died = self.supervisor.find_dead(now()).await?;
        if !died.is_empty() {
            events.extend(self.receive()?);
            events.extend(died);
        }
        if events.contains(&ProcessEvent::Joined(Process::Simcore)) {
            // Receives the messages that were sent before the simulation opened its channels; it receives
            // later ones itself.
            events.extend(self.receive()?);
            if let Err(error) = self.consumers.resume.serve() {
                self.screen.print(&format!("the journal of the simulation cannot be written: {error}"));
            }
        }
        let lost_before = self.states_lost;
        if events.contains(&ProcessEvent::Ready(Process::Renderer)) {
            self.send_state_to_renderer();
        }
        self.restart_due()?;
        self.supervisor.keep_standby(now());
        if self.states_lost > lost_before {
            self.report_lost_state(now());
        }
        Ok(())
    }

    fn restart_due(&mut self) -> anyhow::Result<()> {
        let remaining_s = self.remaining_ns().map(|left| (left as f64 * 1e-9).max(0.1));
        let (instance, consumers) = (&self.instance, &mut self.consumers);
        let scripted = self.args.is_scripted();
        let states_lost = &mut self.states_lost;
        self.supervisor.restart_due(now(), remaining_s, |process, was_at_work| {
            instance.clean_up_after_the_dead();
            match process {
                Process::Simcore => {
                    let (arguments, origin) = consumers.resume.arguments(instance, was_at_work);
                    *states_lost += u64::from(origin == Origin::Lost);
                    arguments
                }
                Process::Renderer => {
                    let tier = consumers.monitor.frame.map(|frame| frame.tier.to_string());
                    tier.map_or_else(Vec::new, |tier| vec!["--start-tier".into(), tier])
                }
                Process::VirtualRig if scripted => {
                    let reached = consumers.goals.0.to_string();
                    vec!["--resume".into(), "--goals-reached".into(), reached]
                }
                _ => Vec::new(),
            }
        })
    }

    fn report_lost_state(&mut self, at: Nanos) {
        self.screen.print(STATE_LOST);
        self.consumers.record_note(Note::loss(at, 1, STATE_LOST.into()));
        self.incidents.push(Incident { at_s: self.elapsed_s(at), what: STATE_LOST.into() });
    }

    /// Reports on the screen, in the recording and in the report that a process died and is restarted.
    pub(super) fn report_restart(&mut self, at: Nanos, process: Process, how: &str) {
        self.consumers.latencies.cool();
        let count = u64::from(self.supervisor.restarts_of(process));
        let text = format!("{} restarted: {how}", process.name());
        // The process's last lines have already been passed on.
        self.screen.print(text.lines().next().unwrap_or_default());
        let (kind, process) = (NoteKind::Restart, Some(process));
        self.consumers.record_note(Note { instant_ns: at, kind, process, count, text: text.clone() });
        self.incidents.push(Incident { at_s: self.elapsed_s(at), what: text });
    }
}
