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
                    tracing::warn!("--resume: {error}; continuing with what precedes it");
                    break;
                }
            }
        }
        let resumed = past.replay(world).with_context(|| format!("--resume {}", file.display()))?;
        if !resumed.agrees || resumed.missing > 0 {
            let ResumeOutcome { steps, missing, agrees } = resumed;
            let field = world.state().field;
            tracing::warn!(
                field,
                "resumed with {steps} steps; missing: {missing}; state as recorded: {agrees}"
            );
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
        let (handles, pedals, poses) = past.unconsumed();
        self.drain()?;
        put_before(&mut self.handle_queue, handles);
        put_before(&mut self.pedal_queue, pedals);
        self.inherited = true;
        self.passed_over += poses;
        Ok(())
    }
}

/// Puts what the journal holds before what came by the channel. The queue's room stays: a step takes in
/// no more inputs than there is room for.
fn put_before<T: PartialEq>(queue: &mut Vec<T>, past: Vec<T>) {
    queue.retain(|input| !past.contains(input));
    queue.splice(..0, past);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_both_hold_is_taken_once_and_the_room_stays() {
        for past in [vec![], vec![1, 2, 3]] {
            let mut queue = Vec::with_capacity(64);
            queue.extend([2, 3, 4]);
            put_before(&mut queue, past.clone());
            let both = if past.is_empty() { vec![2, 3, 4] } else { vec![1, 2, 3, 4] };
            assert_eq!(queue, both);
            assert!(queue.capacity() >= 64, "room for {} after {past:?}", queue.capacity());
        }
    }
}
