//! External drivers in a run: inviting them, waiting for them, and reporting when they connect and
//! disconnect.

use super::Session;
use crate::run::delivery::{UNHEARD_NS, awaited};
use crate::run::external::waiting_for;
use crate::run::report::Incident;
use ipc::clock::now;
use protocol::health::Process;
use protocol::time::Nanos;
use recording::{Note, NoteKind};

/// Period of the messages about an awaited source, ns.
const REMINDER_NS: u64 = 10_000_000_000;

impl Session<'_> {
    /// Invites external drivers, once the processes that receive from them are running.
    pub(super) fn invite_drivers(&mut self) -> anyhow::Result<()> {
        let drivers = self.args.real.drivers().to_vec();
        drivers.iter().for_each(|driver| self.supervisor.expect(*driver, now()));
        let channels: Vec<&str> = drivers.iter().filter_map(|driver| driver.drives()).collect();
        // The bridge to another tracker connects in the same way, although the launcher starts it.
        let own = self.args.source().drives().filter(|_| !self.args.has_outside_source());
        self.instance.invite(&channels.iter().copied().chain(own).collect::<Vec<&str>>())?;
        if !channels.is_empty() {
            self.screen.print(&waiting_for(&self.args.instance, &channels));
        }
        Ok(())
    }

    /// Starts the wait for the run's source.
    pub(super) fn begin_to_wait(&mut self, at: Nanos) {
        (self.awaited_ns, self.report_waiting_ns) = (at, at + UNHEARD_NS);
    }

    /// True if a run with a duration has waited long enough for its source.
    pub(super) fn has_waited_enough(&self, at: Nanos) -> bool {
        let waited_ns = at.saturating_sub(self.awaited_ns);
        self.started_ns == 0 && self.args.patience_ns().is_some_and(|patience| waited_ns > patience)
    }

    /// Reports at intervals for which source the run waits before it begins.
    pub(super) fn report_waiting(&mut self, at: Nanos) {
        let Some(source) = self.args.outside_source().filter(|_| at >= self.report_waiting_ns) else {
            return;
        };
        self.report_waiting_ns = at + REMINDER_NS;
        let driver = self.args.source().drives().filter(|_| self.args.has_outside_source());
        let says = match driver {
            Some(channel) => waiting_for(&self.args.instance, &[channel]),
            None => self.supervisor.status_text_of(self.args.source()),
        };
        self.screen.print(&awaited(&source, &says, at.saturating_sub(self.awaited_ns)));
    }

    /// Reports on the screen, in the recording and in the report that a driver has connected or disconnected.
    pub(super) fn report_driver(&mut self, at: Nanos, driver: Process, is_there: bool) {
        let (name, channel) = (self.supervisor.status_text_of(driver), driver.drives().unwrap_or_default());
        let text = if is_there {
            format!("{name} has connected and sends {channel}")
        } else {
            format!("{name}, which sent {channel}, has disconnected; the run continues and reconnects")
        };
        // The previous process of the driver may have been killed.
        self.instance.clean_up_after_the_dead();
        self.consumers.latencies.cool();
        self.screen.print(&text);
        let (kind, process) = (NoteKind::Log, Some(driver));
        self.consumers.record_note(Note { instant_ns: at, kind, process, count: 1, text: text.clone() });
        self.incidents.push(Incident { at_s: self.elapsed_s(at), what: text });
    }
}
