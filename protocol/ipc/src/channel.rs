//! Senders and receivers of fixed blocks.

use super::instance::Instance;
use super::port::{Channel, Held, Lent, ReceivePort, SendPort, Stamp, UNIT};
use super::wake::{Listener, Wakes};
use super::{IpcError, Queue};
use crate::clock::now;
use protocol::message::{Invalid, Message, require};
use std::marker::PhantomData;
use std::ops::Deref;

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
    /// Copies a block into shared memory and wakes its receivers: for one that its sender keeps anyway, and for
    /// those beside the data path. What is built only to be sent is built there, by [`Sender::fill`].
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send(&mut self, message: &M) -> Result<(), IpcError> {
        self.fill(|block| *block = *message)
    }

    /// Lends a block of shared memory to `build`, which sets every field, then sends it and wakes its receivers.
    /// The block holds whatever an earlier one left there.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn fill(&mut self, build: impl FnOnce(&mut M)) -> Result<(), IpcError> {
        self.send_in_place(|block| {
            build(block);
            true
        })?;
        Ok(())
    }

    /// Lends a block of shared memory that is not to be sent yet; it holds whatever an earlier one left there.
    /// The sender was opened for so many at a time ([`Instance::sender_of_many`]).
    ///
    /// # Errors
    /// Where as many are lent already, or the transport fails.
    pub fn lend(&mut self) -> Result<Lease<M>, IpcError> {
        Ok(Lease { lent: self.port.lend(size_of::<M>())?, of: PhantomData })
    }

    /// Sends a block that was lent, and wakes its receivers.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send_lease(&mut self, lease: Lease<M>) -> Result<(), IpcError> {
        self.port.send_lent(lease.lent, Stamp { sent_ns: now(), ..self.stamp })?;
        self.stamp.seq += 1;
        Ok(())
    }

    /// Lends a block of shared memory to `build`, then sends it and wakes its receivers; where `build` says
    /// false, nothing is sent. The block holds whatever an earlier one left there. True where it was sent.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send_in_place(&mut self, build: impl FnOnce(&mut M) -> bool) -> Result<bool, IpcError> {
        let mut build = Some(build);
        let sent = self.port.send(self.stamp, size_of::<M>(), &mut |bytes| {
            let block = bytemuck::from_bytes_mut(&mut bytes[..size_of::<M>()]);
            build.take().is_some_and(|build| build(block))
        })?;
        self.stamp.seq += u64::from(sent);
        Ok(sent)
    }

    /// Blocks sent so far.
    pub fn sent(&self) -> u64 {
        self.stamp.seq
    }
}

/// A block of shared memory that was lent, to be built before it is sent. Given back unsent when dropped.
pub struct Lease<M: Message> {
    lent: Box<dyn Lent>,
    of: PhantomData<fn(M)>,
}

impl<M: Message> Lease<M> {
    /// The block.
    pub fn block(&mut self) -> &mut M {
        bytemuck::from_bytes_mut(&mut self.lent.bytes()[..size_of::<M>()])
    }
}

/// A block that came in, or the reason why it was refused.
pub type Received<M> = Result<M, Invalid>;

/// A valid block, where its sender built it; the shared memory is given back when this is dropped. A receiver
/// holds two at most.
pub struct Sample<M: Message> {
    held: Held,
    holds: PhantomData<fn() -> M>,
}

impl<M: Message> Deref for Sample<M> {
    type Target = M;

    fn deref(&self) -> &M {
        bytemuck::from_bytes(&self.held.bytes()[..size_of::<M>()])
    }
}

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
        Ok(self.receive_sample()?.map(|sample| sample.map(|block| *block)))
    }

    fn receive_sample(&mut self) -> Result<Option<Result<Sample<M>, Invalid>>, IpcError> {
        let Some(held) = self.port.receive()? else { return Ok(None) };
        self.account.note(&held.stamp());
        let checked = checked::<M>(&held).map(drop);
        self.account.refused += u64::from(checked.is_err());
        Ok(Some(checked.map(|()| Sample { held, holds: PhantomData })))
    }

    /// The next valid block, to be read where it lies; refused ones are counted and passed over.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn next_sample(&mut self) -> Result<Option<Sample<M>>, IpcError> {
        loop {
            match self.receive_sample()? {
                None => return Ok(None),
                Some(Ok(sample)) => return Ok(Some(sample)),
                Some(Err(_)) => {}
            }
        }
    }

    /// The next valid block; refused ones are counted and passed over.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn next_valid(&mut self) -> Result<Option<M>, IpcError> {
        Ok(self.next_sample()?.map(|sample| *sample))
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
pub(super) fn checked<M: Message>(held: &Held) -> Result<&M, Invalid> {
    const { assert!(align_of::<M>() <= UNIT, "a block begins on a border of units") };
    let bytes = held.bytes();
    let whole = bytes.len() >= size_of::<M>();
    require(whole, M::CHANNEL, "block", "as many bytes as the message has", bytes.len() as f64)?;
    let message: &M = bytemuck::from_bytes(&bytes[..size_of::<M>()]);
    message.validate()?;
    Ok(message)
}

impl Instance {
    /// Opens the sending side of a channel.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn sender<M: Message>(&self) -> Result<Sender<M>, IpcError> {
        self.sender_over::<M>(&channel::<M>())
    }

    /// Opens the sending side of a channel for one that holds up to `loans` blocks back, each built in the memory
    /// from which it is sent.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn sender_of_many<M: Message>(&self, loans: usize) -> Result<Sender<M>, IpcError> {
        self.sender_over::<M>(&Channel { loans, ..channel::<M>() })
    }

    fn sender_over<M: Message>(&self, channel: &Channel) -> Result<Sender<M>, IpcError> {
        let port = self.open_sender(channel, size_of::<M>())?;
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
