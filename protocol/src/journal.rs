//! A journal: the simulation's newest checkpoint and its inputs since, as a file of plain blocks.
//!
//! A simulation that is restarted reads it and resumes where its predecessor ended. Writer and
//! reader are of one build, which the hash of their schemas proves.

use crate::handles::{HandleState, PedalState};
use crate::limits::MAX_CHECKPOINT_BYTES;
use crate::message::{Message, fnv1a};
use crate::poses::TrackerFrame;
use crate::steps::{CheckpointHeader, StepRecord};
use std::io::{ErrorKind, Read, Write};

/// First bytes of a journal; the hash of the blocks' schemas follows.
const NAME: &[u8; 16] = b"vitreo-journal1\n";

/// One entry.
#[derive(Debug, Clone)]
pub enum Entry {
    /// A state of the simulation.
    Checkpoint(CheckpointHeader, Vec<u8>),
    /// A step that was done.
    Step(StepRecord),
    /// Poses.
    Poses(Box<TrackerFrame>),
    /// An instrument's handle.
    Handle(HandleState),
    /// The pedal.
    Pedal(PedalState),
}

/// Why a journal ended early.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The operating system refused, or the file ends within an entry.
    #[error("journal: {}", in_words(.0))]
    Io(#[from] std::io::Error),
    /// Something else, or the journal of another build.
    #[error("journal: expected one of this build, found something else")]
    Foreign,
    /// An entry that makes no sense.
    #[error("journal: entry {number}: {problem}")]
    Entry {
        /// Its number from 0 on.
        number: u64,
        /// What is wrong.
        problem: String,
    },
}

fn in_words(problem: &std::io::Error) -> String {
    match problem.kind() {
        std::io::ErrorKind::UnexpectedEof => "ends within an entry, or is another file".into(),
        _ => problem.to_string(),
    }
}

fn schema() -> u64 {
    let schemas = [
        CheckpointHeader::SCHEMA,
        StepRecord::SCHEMA,
        TrackerFrame::SCHEMA,
        HandleState::SCHEMA,
        PedalState::SCHEMA,
    ];
    fnv1a(bytemuck::bytes_of(&schemas))
}

/// Writes a journal.
///
/// # Errors
/// What the operating system refuses.
pub fn write<'a>(out: &mut impl Write, entries: impl Iterator<Item = &'a Entry>) -> std::io::Result<()> {
    out.write_all(NAME)?;
    out.write_all(&schema().to_le_bytes())?;
    for entry in entries {
        let (kind, block): (u8, &[u8]) = match entry {
            Entry::Checkpoint(header, _) => (0, bytemuck::bytes_of(header)),
            Entry::Step(step) => (1, bytemuck::bytes_of(step)),
            Entry::Poses(frame) => (2, bytemuck::bytes_of(frame.as_ref())),
            Entry::Handle(handle) => (3, bytemuck::bytes_of(handle)),
            Entry::Pedal(pedal) => (4, bytemuck::bytes_of(pedal)),
        };
        out.write_all(&[kind])?;
        out.write_all(block)?;
        if let Entry::Checkpoint(header, state) = entry {
            debug_assert_eq!(header.bytes, state.len() as u64);
            out.write_all(state)?;
        }
    }
    out.flush()
}

/// Reads a journal.
pub struct Reader<R> {
    from: R,
    read: u64,
}

impl<R: Read> Reader<R> {
    /// Reads the beginning.
    ///
    /// # Errors
    /// [`JournalError::Foreign`] for anything but a journal of this build.
    pub fn new(mut from: R) -> Result<Self, JournalError> {
        let (mut name, mut found) = ([0; NAME.len()], [0; 8]);
        from.read_exact(&mut name)?;
        from.read_exact(&mut found)?;
        if &name != NAME || u64::from_le_bytes(found) != schema() {
            return Err(JournalError::Foreign);
        }
        Ok(Reader { from, read: 0 })
    }

    /// The next entry; `None` at the end.
    ///
    /// # Errors
    /// A cut file, or an entry that makes no sense.
    pub fn next_entry(&mut self) -> Result<Option<Entry>, JournalError> {
        let mut kind = [0];
        loop {
            match self.from.read(&mut kind) {
                Ok(0) => return Ok(None),
                Ok(_) => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e.into()),
            }
        }
        let entry = match kind[0] {
            0 => {
                let header: CheckpointHeader = self.block()?;
                if header.bytes > MAX_CHECKPOINT_BYTES as u64 {
                    return Err(self.bad(format!("a checkpoint of {} bytes", header.bytes)));
                }
                let mut state = Vec::new();
                (&mut self.from).take(header.bytes).read_to_end(&mut state)?;
                if state.len() as u64 != header.bytes {
                    return Err(std::io::Error::from(ErrorKind::UnexpectedEof).into());
                }
                Entry::Checkpoint(header, state)
            }
            1 => Entry::Step(self.block()?),
            2 => Entry::Poses(Box::new(self.block()?)),
            3 => Entry::Handle(self.block()?),
            4 => Entry::Pedal(self.block()?),
            other => return Err(self.bad(format!("expected a kind from 0 to 4, found {other}"))),
        };
        self.read += 1;
        Ok(Some(entry))
    }

    fn block<M: Message>(&mut self) -> Result<M, JournalError> {
        let mut block = M::zeroed();
        self.from.read_exact(bytemuck::bytes_of_mut(&mut block))?;
        block.validate().map_err(|e| self.bad(e.to_string()))?;
        Ok(block)
    }

    fn bad(&self, problem: String) -> JournalError {
        JournalError::Entry { number: self.read, problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    fn journal() -> Vec<u8> {
        let mut header = CheckpointHeader::zeroed();
        (header.step, header.bytes) = (3, 5);
        let handle = HandleState { seq: 7, tool: 1, jaw_rad: 0.5, ..HandleState::zeroed() };
        let entries = [Entry::Checkpoint(header, vec![1, 2, 3, 4, 5]), Entry::Handle(handle)];
        let mut bytes = Vec::new();
        write(&mut bytes, entries.iter()).unwrap();
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Vec<Entry>, JournalError> {
        let mut reader = Reader::new(bytes)?;
        std::iter::from_fn(|| reader.next_entry().transpose()).collect()
    }

    #[test]
    fn entries_come_back_in_order() {
        let entries = read(&journal()).unwrap();
        let [Entry::Checkpoint(header, state), Entry::Handle(handle)] = &entries[..] else {
            panic!("{entries:?}")
        };
        assert_eq!((header.step, &state[..], handle.seq), (3, &[1, 2, 3, 4, 5][..], 7));
    }

    proptest! {
        #[test]
        fn a_cut_or_damaged_journal_never_panics(cut in 0usize..200, at in 0usize..200, xor in any::<u8>()) {
            let whole = journal();
            let mut bytes = whole[..cut.min(whole.len())].to_vec();
            let length = bytes.len();
            if length > 0 {
                bytes[at % length] ^= xor;
            }
            let _ = read(&bytes);
        }
    }

    #[test]
    fn a_foreign_file_is_refused() {
        assert!(matches!(read(&[0x89; 64]), Err(JournalError::Foreign)));
        assert!(matches!(read(&journal()[..9]), Err(JournalError::Io(_))));
    }
}
