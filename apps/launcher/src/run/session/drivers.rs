//! External drivers in a run: inviting them, waiting for them, reporting when they connect and leave.

use super::Session;
use crate::run::external::waiting_for;
use crate::run::report::Incident;
use ipc::clock::now;
use protocol::health::Process;
use protocol::time::Nanos;
use recording::{Note, NoteKind};

impl Session<'_> {
    /// Tells programs of other makers that they can come: what receives is at work.
    pub(super) fn invite_drivers(&mut self) -> anyhow::Result<()> {
        let drivers = self.args.real.drivers().to_vec();
        drivers.iter().for_each(|driver| self.supervisor.expect(*driver, now()));
        let channels: Vec<&str> = drivers.iter().filter_map(|driver| driver.drives()).collect();
        // The bridge to another tracker, which the launcher starts, comes by the same door.
        let own = self.args.source().drives().filter(|_| !self.args.has_outside_source());
        self.instance.invite(&channels.iter().copied().chain(own).collect::<Vec<&str>>())?;
        if !channels.is_empty() {
            self.screen.print(&waiting_for(&self.args.instance, &channels));
        }
        Ok(())
    }

    /// Driver that a run waits for before it begins, if any.
    pub(super) fn say_what_is_awaited(&mut self, at: Nanos) {
        if let Some(channel) = self.args.source().drives()
            && self.args.has_outside_source()
            && self.screen.due(at)
        {
            self.screen.print(&waiting_for(&self.args.instance, &[channel]));
        }
    }

    /// Tells that a driver has come or gone, on the screen, in the recording and in the report.
    pub(super) fn tell_driver(&mut self, at: Nanos, driver: Process, is_there: bool) {
        let (name, channel) = (self.supervisor.words_of(driver), driver.drives().unwrap_or_default());
        let text = if is_there {
            format!("{name} has connected and sends {channel}")
        } else {
            format!("{name}, which sent {channel}, is gone; the run continues and reconnects")
        };
        // A predecessor was killed, perhaps.
        self.instance.clean_up_after_the_dead();
        self.consumers.latencies.cool();
        self.screen.print(&text);
        let (kind, process) = (NoteKind::Log, Some(driver));
        self.consumers.record_note(Note { instant_ns: at, kind, process, count: 1, text: text.clone() });
        self.incidents.push(Incident { at_s: self.elapsed_s(at), what: text });
    }
}
