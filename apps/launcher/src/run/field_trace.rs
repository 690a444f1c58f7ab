//! The trace of a run: options, expected processes, and the output file.

use ipc::logging::{inform, warn};
use ipc::trace::json::{FieldTrace, Missing};
use ipc::trace::{MAX_SECONDS, SPANS_PER_SECOND, part};
use outputs::{OutputError, Outputs};
use protocol::health::{Health, Process};
use protocol::time::Nanos;
use std::path::{Path, PathBuf};

/// Default length of a trace, s.
const SECONDS: u32 = 30;

/// Whether a run is traced.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TraceOutArgs {
    /// Write a trace of every field through all processes, for ui.perfetto.dev.
    #[arg(long, value_name = "FILE.json")]
    pub trace_out: Option<PathBuf>,
    /// Trace the last S seconds of the run, 1 to 600 [default: 30].
    #[arg(long, value_name = "S", requires = "trace_out", value_parser = settings::commands::numbers::whole::<u32>(1, MAX_SECONDS.into()))]
    pub trace_seconds: Option<u32>,
}

impl TraceOutArgs {
    fn seconds(&self) -> u32 {
        self.trace_seconds.unwrap_or(SECONDS)
    }

    /// Number of spans for which each process reserves memory; `None` without a trace.
    pub(super) fn spans(&self) -> Option<u32> {
        self.trace_out.as_ref().map(|_| self.seconds() * SPANS_PER_SECOND)
    }
}

/// Processes that have run and should be in the trace.
#[derive(Debug, Default)]
pub(super) struct Traced {
    lives: Vec<Missing>,
}

impl Traced {
    /// Adds the process of a heartbeat.
    pub(super) fn note(&mut self, beat: &Health, at: Nanos) {
        match self.lives.iter_mut().find(|life| life.pid == beat.pid) {
            Some(life) => life.from_to[1] = at,
            None => {
                self.lives.extend(
                    Process::from_wire(beat.process)
                        .filter(|p| p.drives().is_none())
                        .map(|process| Missing { process, pid: beat.pid, from_to: [at, at] }),
                )
            }
        }
    }

    /// Collects the traces that the processes have left in the instance's directory, after all have ended.
    /// With `foreign_rig`, a program of another maker replaces the virtual rig, and no trace is expected from
    /// it.
    pub(super) fn collect(
        self,
        args: &TraceOutArgs,
        directory: &Path,
        origin: Nanos,
        foreign_rig: bool,
    ) -> Option<FieldTrace> {
        args.trace_out.as_ref()?;
        let parts = part::take_all(directory).unwrap_or_else(|problem| {
            warn(&format!("the trace cannot be read: {problem}"));
            Vec::new()
        });
        let left = |life: &Missing| parts.iter().any(|part| part.pid == life.pid);
        let foreign = |life: &Missing| foreign_rig && life.process == Process::VirtualRig;
        let missing = self.lives.into_iter().filter(|life| !left(life) && !foreign(life)).collect();
        Some(FieldTrace { parts, missing, seconds: args.seconds().into(), origin })
    }
}

/// Writes the trace and logs its contents and gaps.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn write(trace: &FieldTrace, outputs: &mut Outputs, file: &Path) -> Result<(), OutputError> {
    trace.missing.iter().for_each(|missing| warn(&format!("the trace: {}", missing.text(trace.origin))));
    if trace.is_empty() {
        warn("no trace written: no process recorded a span");
        return Ok(());
    }
    let mut to = outputs.create(file)?;
    let figures = trace.write(&mut to).map_err(|problem| OutputError::io(file, problem))?;
    to.finish()?;
    inform(&figures.text());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn beat(process: Process, pid: u32) -> Health {
        Health { process: process as u32, pid, ..Health::zeroed() }
    }

    #[test]
    fn who_gave_a_sign_of_life_and_left_nothing_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let args = TraceOutArgs { trace_out: Some("t.json".into()), trace_seconds: Some(2) };
        assert_eq!(args.spans(), Some(2 * SPANS_PER_SECOND));
        let collected = |foreign| {
            let mut traced = Traced::default();
            for (at, pid) in [(10, 1), (20, 2), (30, 1)] {
                traced.note(&beat(Process::Tracker, pid), at);
            }
            traced.note(&beat(Process::VirtualRig, 3), 40);
            traced.collect(&args, folder.path(), 5, foreign).unwrap()
        };
        let found: Vec<_> = collected(false).missing.iter().map(|m| (m.pid, m.from_to)).collect();
        assert_eq!(found, [(1, [10, 30]), (2, [20, 20]), (3, [40, 40])]);
        assert_eq!(collected(true).missing.len(), 2);
        let off = TraceOutArgs::default();
        assert!(off.spans().is_none() && Traced::default().collect(&off, folder.path(), 0, false).is_none());
    }
}
