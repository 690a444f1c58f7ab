//! Sends checkpoints: what a process knows, as bytes behind a header.

use crate::{BlockSender, Instance, IpcError};
use protocol::limits::MAX_CHECKPOINT_BYTES;
use protocol::message::Message;

/// The channel of a process's checkpoints, and the memory in which they are written.
pub struct CheckpointSender<H: Message> {
    port: BlockSender<H>,
    saved: Vec<u8>,
    too_large: bool,
}

impl<H: Message> CheckpointSender<H> {
    /// For states that are as long as `saved`, the first, or grow to `factor` times that and `room` bytes.
    ///
    /// # Errors
    /// Where the channel cannot be opened.
    pub fn open(
        instance: &Instance,
        mut saved: Vec<u8>,
        factor: usize,
        room: usize,
    ) -> Result<Self, IpcError> {
        let capacity = (factor * saved.len() + room).min(MAX_CHECKPOINT_BYTES);
        // A process that has begun asks for no memory.
        saved.reserve_exact(capacity.saturating_sub(saved.len()));
        Ok(CheckpointSender { port: instance.block_sender(capacity)?, saved, too_large: false })
    }

    /// Sends what `save` writes, with the header that `head` makes for so many bytes. One that has grown
    /// beyond its room is left out, which is logged the first time: whoever goes on from the last one that
    /// fitted has more to do again.
    ///
    /// # Errors
    /// That of `save`, and where the transport fails.
    pub fn send<E: From<IpcError>>(
        &mut self,
        save: impl FnOnce(&mut Vec<u8>) -> Result<(), E>,
        head: impl FnOnce(u64) -> H,
    ) -> Result<(), E> {
        save(&mut self.saved)?;
        let saved = &self.saved;
        let sent = self.port.send(saved.len(), |payload| {
            payload[..saved.len()].copy_from_slice(saved);
            head(saved.len() as u64)
        });
        match sent {
            Err(problem @ IpcError::TooLarge { .. }) => {
                if !std::mem::replace(&mut self.too_large, true) {
                    tracing::warn!("no further checkpoints: {problem}");
                }
                Ok(())
            }
            other => Ok(other?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::checkpoints::TrackerCheckpointHeader;

    #[test]
    fn a_state_that_has_grown_too_long_is_left_out_and_a_shorter_one_goes_again() {
        let instance = Instance::own(&format!("cp-{}", std::process::id() % 1_000_000)).unwrap();
        let mut receiver = instance.block_receiver::<TrackerCheckpointHeader>().unwrap();
        let mut sender = CheckpointSender::open(&instance, vec![0; 100], 2, 56).unwrap();
        let mut received = Vec::new();
        for length in [100, 256, 257, 30] {
            let head = |bytes| TrackerCheckpointHeader { frame: 1, field: 2, exposed_ns: 3, bytes };
            let save = |to: &mut Vec<u8>| {
                to.clear();
                to.resize(length, length as u8);
                Ok::<_, IpcError>(())
            };
            sender.send(save, head).unwrap();
            while let Some(sample) = receiver.receive().unwrap() {
                let bytes = sample.header().bytes as usize;
                assert!(sample.payload()[..bytes].iter().all(|b| *b == length as u8));
                received.push(bytes);
            }
        }
        assert_eq!(received, [100, 256, 30]);
    }
}
