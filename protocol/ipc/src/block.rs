//! Senders and receivers of a header with a payload of variable size, written in place.

use super::IpcError;
use super::channel::{Account, Counts, MAX_SUBSCRIBERS, checked};
use super::instance::Instance;
use super::port::{Channel, Held, Lent, ReceivePort, SendPort, Stamp, UNIT};
use super::wake::{Listener, Wakes};
use crate::clock::now;
use protocol::message::Message;
use std::marker::PhantomData;

/// Bytes of the header, after which the payload begins on a border of units.
const fn head<H>() -> usize {
    size_of::<H>().next_multiple_of(UNIT)
}

/// Publishers of a channel of blocks: one, and its successor.
const BLOCK_PUBLISHERS: usize = 2;

/// Few processes take part in a channel of blocks.
fn channel<H: Message>() -> Channel {
    Channel::of::<H>(MAX_SUBSCRIBERS / 2, BLOCK_PUBLISHERS)
}

/// Shared memory that was lent for one block, to be written at leisure. Given back unsent when dropped.
pub struct Loan<H: Message> {
    lent: Box<dyn Lent>,
    bytes: usize,
    of: PhantomData<fn(H)>,
}

impl<H: Message> Loan<H> {
    /// The payload, of the length that was asked for. It holds whatever an earlier block left there, and stays where
    /// it is until the loan is sent or dropped.
    pub fn payload(&mut self) -> &mut [u8] {
        &mut self.lent.bytes()[head::<H>()..][..self.bytes]
    }
}

/// Sends blocks with a header `H`.
pub struct BlockSender<H: Message> {
    port: Box<dyn SendPort>,
    stamp: Stamp,
    capacity: usize,
    sends: PhantomData<fn(H)>,
}

impl<H: Message> BlockSender<H> {
    /// Lends `bytes` of shared memory to `write`, which fills them and returns the header; then
    /// sends the block. The memory holds whatever an earlier block left there.
    ///
    /// # Errors
    /// Where the block is larger than the capacity, or the transport fails.
    pub fn send(&mut self, bytes: usize, write: impl FnOnce(&mut [u8]) -> H) -> Result<(), IpcError> {
        if bytes > self.capacity {
            return Err(IpcError::TooLarge { channel: H::CHANNEL, bytes, capacity: self.capacity });
        }
        let mut write = Some(write);
        self.port.send(self.stamp, head::<H>() + bytes, &mut |all| {
            let (header, payload) = all.split_at_mut(head::<H>());
            if let Some(write) = write.take() {
                header[..size_of::<H>()].copy_from_slice(bytemuck::bytes_of(&write(payload)));
            }
            true
        })?;
        self.stamp.seq += 1;
        Ok(())
    }

    /// Lends `bytes` of shared memory, to be written before [`BlockSender::send_loan`].
    ///
    /// # Errors
    /// Where the block is larger than the capacity, or the transport fails.
    pub fn lend(&mut self, bytes: usize) -> Result<Loan<H>, IpcError> {
        if bytes > self.capacity {
            return Err(IpcError::TooLarge { channel: H::CHANNEL, bytes, capacity: self.capacity });
        }
        Ok(Loan { lent: self.port.lend(head::<H>() + bytes)?, bytes, of: PhantomData })
    }

    /// Sends a block that was lent, with its header.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send_loan(&mut self, mut loan: Loan<H>, header: &H) -> Result<(), IpcError> {
        self.stamp.sent_ns = now();
        loan.lent.bytes()[..size_of::<H>()].copy_from_slice(bytemuck::bytes_of(header));
        self.port.send_lent(loan.lent, self.stamp)?;
        self.stamp.seq += 1;
        Ok(())
    }

    /// Blocks sent so far.
    pub fn sent(&self) -> u64 {
        self.stamp.seq
    }
}

/// A received block; its shared memory is given back when this is dropped.
pub struct BlockSample<H: Message> {
    header: H,
    held: Held,
}

impl<H: Message> BlockSample<H> {
    /// The header.
    pub fn header(&self) -> &H {
        &self.header
    }

    /// The payload; its length is a multiple of 16 and its start is aligned to 16 bytes.
    pub fn payload(&self) -> &[u8] {
        &self.held.bytes()[head::<H>()..]
    }
}

/// Receives blocks with a header `H`, in order; the newest [`Message::QUEUE`] are kept.
pub struct BlockReceiver<H: Message> {
    port: Box<dyn ReceivePort>,
    listener: Listener,
    account: Account,
    receives: PhantomData<fn() -> H>,
}

impl<H: Message> BlockReceiver<H> {
    /// The next block, its header checked; refused ones are counted.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn receive(&mut self) -> Result<Option<BlockSample<H>>, IpcError> {
        loop {
            let Some(held) = self.port.receive()? else { return Ok(None) };
            self.account.note(&held.stamp());
            match checked::<H>(&held).copied() {
                Ok(header) if held.bytes().len() >= head::<H>() => {
                    return Ok(Some(BlockSample { header, held }));
                }
                _ => self.account.refused += 1,
            }
        }
    }

    /// Blocks taken in, passed over and refused so far.
    pub fn counts(&self) -> Counts {
        self.account.counts()
    }
}

impl<H: Message> Wakes for BlockReceiver<H> {
    fn listener(&self) -> &Listener {
        &self.listener
    }
}

impl Instance {
    /// Opens the sending side of a channel of blocks of at most `capacity` bytes.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn block_sender<H: Message>(&self, capacity: usize) -> Result<BlockSender<H>, IpcError> {
        let port = self.open_sender(&channel::<H>(), head::<H>() + capacity)?;
        let stamp = Stamp { epoch: now(), ..Stamp::default() };
        Ok(BlockSender { port, stamp, capacity, sends: PhantomData })
    }

    /// Opens the receiving side of a channel of blocks.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn block_receiver<H: Message>(&self) -> Result<BlockReceiver<H>, IpcError> {
        let (port, listener) = self.open_receiver(&channel::<H>(), H::QUEUE)?;
        Ok(BlockReceiver { port, listener, account: Account::default(), receives: PhantomData })
    }
}
