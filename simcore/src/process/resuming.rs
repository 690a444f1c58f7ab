//! Going on where a predecessor stood: the journal, which the launcher writes once this process has
//! opened its channels, and the inputs that came since.

use super::SimcoreShell;
use crate::resume::{InputHistory, ResumeOutcome};
use crate::world::World;
use anyhow::{Context, bail};
use ipc::clock::now;
use ipc::shell::Shell;
use ipc::wait;
use protocol::events::EventKind;
use protocol::journal::{JournalError, Reader};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Longest wait for the journal, ns.
const PATIENCE_NS: u64 = 5_000_000_000;
/// Between two looks for it, ns.
const LOOK_NS: u64 = 1_000_000;

/// Waits until the journal is there.
pub(super) fn await_journal(file: &Path, shell: &Shell) -> anyhow::Result<()> {
    let until = now() + PATIENCE_NS;
    while !file.exists() && !shell.stopping() {
        if now() > until {
            bail!("--resume {}: not written in time", file.display());
        }
        wait(&[], LOOK_NS);
    }
    Ok(())
}

impl SimcoreShell {
    /// Replays the journal to its end, keeps what no step has consumed, and sends an event.
    pub(super) fn resume(&mut self, world: &mut World, file: &Path) -> anyhow::Result<()> {
        let journal = File::open(file).map_err(JournalError::Io).and_then(|f| Reader::new(BufReader::new(f)));
        let mut journal = journal.with_context(|| format!("--resume {}", file.display()))?;
        let mut past = InputHistory::default();
        loop {
            match journal.next_entry() {
                Ok(Some(entry)) => past.note(entry),
                Ok(None) => break,
                Err(error) => {
                    tracing::warn!("--resume: {error}; going on with what comes before");
                    break;
                }
            }
        }
        let resumed = past.replay(world).with_context(|| format!("--resume {}", file.display()))?;
        if !resumed.agrees || resumed.missing > 0 {
            let ResumeOutcome { steps, missing, agrees } = resumed;
            tracing::warn!("resumed with {steps} steps; missing: {missing}; state as recorded: {agrees}");
        }
        self.inherit(past)?;
        self.writer.forget();
        let exposed = world.state().exposed_ns;
        self.send_own_event(world, exposed, EventKind::Resumed, resumed.steps as f64)?;
        Ok(())
    }

    /// Keeps the inputs that no step has consumed for the next one. The channels were open before
    /// the journal was written: what both hold is taken once. Poses of the time without a
    /// simulation are passed over, as after a sleep.
    fn inherit(&mut self, past: InputHistory) -> anyhow::Result<()> {
        let (mut handles, mut pedals, poses) = past.unconsumed();
        self.drain()?;
        handles
            .extend(self.handle_queue.iter().filter(|h| !handles.contains(h)).copied().collect::<Vec<_>>());
        pedals.extend(self.pedal_queue.iter().filter(|p| !pedals.contains(p)).copied().collect::<Vec<_>>());
        (self.handle_queue, self.pedal_queue) = (handles, pedals);
        self.inherited = true;
        self.passed_over += poses;
        Ok(())
    }
}
