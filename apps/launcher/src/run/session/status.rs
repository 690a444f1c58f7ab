//! Status and warnings during a run.

use super::Session;
use crate::run::screen::Status;
use crate::run::watch::{findings, replace_by_own_report};
use diagnosis::Finding;
use ipc::clock::now;
use protocol::control::Notice;
use protocol::message::text_bytes;
use protocol::time::Nanos;
use recording::{Note, NoteKind};

/// Period of the checks for warnings, ns.
const WATCH_NS: u64 = 1_000_000_000;

impl Session<'_> {
    /// Shows the status when it is due.
    pub(super) fn show(&mut self) {
        let at = now();
        if self.started_ns == 0 {
            return self.report_waiting(at);
        }
        if !self.screen.due(at) {
            return;
        }
        self.note_own_cpu(at);
        let recorder = match &self.consumers.recorder {
            None => String::new(),
            Some(r) => match r.problem() {
                Some(problem) => format!("RECORDING FAILED: {problem}"),
                None if r.lost() > 0 => format!("recording, {} lost", r.lost()),
                None => "recording".into(),
            },
        };
        let newest = self.incidents.last().map_or("", |h| h.what.lines().next().unwrap_or(""));
        let incident = if self.paused_ns.is_some() { "paused" } else { newest };
        let status = Status {
            now: at,
            elapsed_s: self.elapsed_s(at),
            duration_s: self.args.duration,
            monitor: &self.consumers.monitor,
            latencies: &self.consumers.latencies,
            budgets: self.budgets,
            slots: &self.supervisor.slots,
            recorder,
            incident,
            watch: &self.consumers.watch,
            silence: self.consumers.silence.present(),
        };
        self.screen.show(&status);
    }

    pub(super) fn note_own_cpu(&mut self, at: Nanos) {
        let cpu = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        let cpu_ns = cpu.tv_sec as u64 * 1_000_000_000 + cpu.tv_nsec as u64;
        self.own_cpu.note(std::process::id(), cpu_ns, at);
    }

    /// Checks the last second and reports new persistent problems.
    pub(super) fn watch(&mut self) {
        let at = now();
        if self.started_ns == 0 || self.paused_ns.is_some() || at < self.watched_ns + WATCH_NS {
            return;
        }
        self.watched_ns = at;
        let consumers = &mut self.consumers;
        consumers.monitor.measure(at);
        let (monitor, since_ns) = (&consumers.monitor, at - self.started_ns);
        let mut found = findings(&self.args, &consumers.tracking, monitor, since_ns);
        if let Some(trouble) = self.supervisor.trouble_of_streams() {
            replace_by_own_report(trouble, &mut found);
        }
        found.extend(self.supervisor.trouble_of_drivers(at));
        found.extend(self.supervisor.trouble_of_controls());
        found.extend(self.supervisor.trouble_of_other_tracker());
        found.extend(self.supervisor.trouble_of_tracker());
        let at_s = self.elapsed_s(at);
        for finding in self.consumers.watch.note(at_s, &found) {
            self.warn_of(&finding, at);
        }
        // Sent at every check, because a restarted renderer has not received it.
        self.notify(at);
    }

    /// Warns immediately of a process that is running but sends nothing.
    pub(super) fn watch_silence(&mut self) {
        let (at, at_s) = (now(), self.elapsed_s(now()));
        // Silences that a process reports itself are not reported again.
        let source = self.args.source();
        let already_reported = self.supervisor.trouble_of_streams().is_some()
            || self.supervisor.trouble_of_other_tracker().is_some()
            || self.supervisor.trouble_of_tracker().is_some()
            || self.supervisor.lacks(source, at);
        if self.started_ns == 0
            || self.paused_ns.is_some()
            || already_reported
            || !self.supervisor.all_ready()
        {
            return self.consumers.silence.excuse(at, at_s);
        }
        let counts = self.consumers.monitor.traffic.map(|t| t.count);
        if let Some(finding) = self.consumers.silence.note(counts, at, at_s) {
            self.warn_of(&finding, at);
            self.notify(at);
        }
    }

    /// Prints a finding and records it.
    fn warn_of(&mut self, finding: &Finding, at: Nanos) {
        let text = finding.text();
        self.screen.print(&format!("! {text}"));
        let (kind, count) = (NoteKind::Log, 1);
        self.consumers.record_note(Note { instant_ns: at, kind, process: None, count, text });
    }

    /// Sends the current problem to the renderer, which shows it in the picture. Errors are ignored.
    fn notify(&mut self, at: Nanos) {
        let lasting = self.consumers.silence.present().or_else(|| self.consumers.watch.present().next());
        let text = text_bytes(lasting.map_or("", |finding| finding.what.as_str()));
        let _ = self.notices.send(&Notice { instant_ns: at, text });
    }
}
