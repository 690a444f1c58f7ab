//! Senders and receivers of fixed blocks.

use super::instance::Instance;
use super::port::{Channel, Held, ReceivePort, SendPort, Stamp};
use super::wake::{Listener, Wakes};
use super::{IpcError, Queue};
use crate::clock::now;
use protocol::message::{Invalid, Message, require};
use std::marker::PhantomData;

/// Subscribers of a channel of large blocks, of which a sender has room for a queue each: four processes, launcher,
/// and three of other makers.
pub(super) const MAX_SUBSCRIBERS: usize = 8;
/// Subscribers of any other: `control` has one a process, and one a program of another maker.
pub(super) const MANY_SUBSCRIBERS: usize = 2 * MAX_SUBSCRIBERS;
/// Largest block of which many are kept, bytes.
const SMALL_BYTES: usize = 512;

/// The channel of a message.
fn channel<M: Message>() -> Channel {
    let subscribers = if size_of::<M>() <= SMALL_BYTES { MANY_SUBSCRIBERS } else { MAX_SUBSCRIBERS };
    Channel::of::<M>(subscribers, MAX_PUBLISHERS)
}

/// Publishers of a channel: `health` and `answers` have one a process, and programs of other makers come besides.
pub(super) const MAX_PUBLISHERS: usize = 16;

/// Sends blocks of one channel.
pub struct Sender<M: Message> {
    port: Box<dyn SendPort>,
    stamp: Stamp,
    sends: PhantomData<fn(M)>,
}

impl<M: Message> Sender<M> {
    /// Copies a block into shared memory and wakes its receivers.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send(&mut self, message: &M) -> Result<(), IpcError> {
        self.stamp.sent_ns = now();
        let message = bytemuck::bytes_of(message);
        self.port
            .send(self.stamp, message.len(), &mut |bytes| bytes[..message.len()].copy_from_slice(message))?;
        self.stamp.seq += 1;
        Ok(())
    }

    /// Blocks sent so far.
    pub fn sent(&self) -> u64 {
        self.stamp.seq
    }
}

/// A block that came in, or the reason why it was refused.
pub type Received<M> = Result<M, Invalid>;

/// Receives blocks of one channel.
pub struct Receiver<M: Message> {
    port: Box<dyn ReceivePort>,
    listener: Listener,
    account: Account,
    receives: PhantomData<fn() -> M>,
}

impl<M: Message> Receiver<M> {
    /// The next block (or the newest, if opened so), checked; `None` when there is nothing new.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn receive(&mut self) -> Result<Option<Received<M>>, IpcError> {
        let Some(held) = self.port.receive()? else { return Ok(None) };
        self.account.note(&held.stamp());
        let message = message_of::<M>(&held);
        self.account.refused += u64::from(message.is_err());
        Ok(Some(message))
    }

    /// The next valid block; refused ones are counted and passed over.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn next_valid(&mut self) -> Result<Option<M>, IpcError> {
        loop {
            match self.receive()? {
                None => return Ok(None),
                Some(Ok(message)) => return Ok(Some(message)),
                Some(Err(_)) => {}
            }
        }
    }

    /// Blocks taken in, lost by overflow, and refused by validation so far.
    pub fn counts(&self) -> Counts {
        self.account.counts()
    }
}

impl<M: Message> Wakes for Receiver<M> {
    fn listener(&self) -> &Listener {
        &self.listener
    }
}

/// Figures of a receiver.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Taken in.
    pub received: u64,
    /// Overwritten before they were read.
    pub lost: u64,
    /// Failed validation.
    pub refused: u64,
}

/// Keeps count per sender, from the numbers in the stamps.
#[derive(Debug, Default)]
pub(super) struct Account {
    senders: Vec<(u64, u64)>,
    counts: Counts,
    pub(super) refused: u64,
}

impl Account {
    pub(super) fn note(&mut self, stamp: &Stamp) {
        self.counts.received += 1;
        let next = stamp.seq.saturating_add(1);
        match self.senders.iter_mut().find(|(epoch, _)| *epoch == stamp.epoch) {
            Some((_, expected)) => {
                self.counts.lost += stamp.seq.saturating_sub(*expected);
                *expected = next;
            }
            // A sender met for the first time may have begun long before: nothing is known lost.
            None => self.senders.push((stamp.epoch, next)),
        }
        if self.senders.len() > 4 * MAX_PUBLISHERS {
            self.senders.remove(0);
        }
    }

    pub(super) fn counts(&self) -> Counts {
        Counts { refused: self.refused, ..self.counts }
    }
}

/// The message at the start of a block, checked.
pub(super) fn message_of<M: Message>(held: &Held) -> Received<M> {
    let bytes = held.bytes();
    let whole = bytes.len() >= size_of::<M>();
    require(whole, M::CHANNEL, "block", "as many bytes as the message has", bytes.len() as f64)?;
    let message: M = bytemuck::pod_read_unaligned(&bytes[..size_of::<M>()]);
    message.validate()?;
    Ok(message)
}

impl Instance {
    /// Opens the sending side of a channel.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn sender<M: Message>(&self) -> Result<Sender<M>, IpcError> {
        let port = self.open_sender(&channel::<M>(), size_of::<M>())?;
        Ok(Sender { port, stamp: Stamp { epoch: now(), ..Stamp::default() }, sends: PhantomData })
    }

    /// Opens the receiving side of a channel.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn receiver<M: Message>(&self, queue: Queue) -> Result<Receiver<M>, IpcError> {
        let depth = match queue {
            Queue::InOrder => M::QUEUE,
            Queue::Newest => 1,
        };
        let (port, listener) = self.open_receiver(&channel::<M>(), depth)?;
        Ok(Receiver { port, listener, account: Account::default(), receives: PhantomData })
    }
}
