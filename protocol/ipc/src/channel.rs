//! Senders and receivers of fixed blocks.

use super::instance::{Instance, Service};
use super::wake::{Listener, Notifier, Wakes};
use super::{IpcError, Queue, transport};
use crate::clock::now;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use protocol::message::{Invalid, Message};
use protocol::time::Nanos;

/// A message as iceoryx2 sees it.
#[repr(transparent)]
#[derive(Debug, Clone, Copy)]
pub(super) struct Wire<M: Message>(pub(super) M);

// SAFETY: `Message` demands `Pod`: fixed layout, no pointers, no padding, every bit pattern valid.
unsafe impl<M: Message + std::fmt::Debug> ZeroCopySend for Wire<M> {
    unsafe fn type_name() -> &'static str {
        M::CHANNEL
    }
}

/// Travels before each block: who sent it, which number it has, when it left.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Stamp {
    /// Instant at which the sender was opened: a restarted sender has another than its predecessor.
    pub(super) epoch: u64,
    /// Counts up by one.
    pub(super) seq: u64,
    /// When it was sent.
    pub(super) sent_ns: Nanos,
}

// SAFETY: three integers, `repr(C)`, no padding.
unsafe impl ZeroCopySend for Stamp {}

/// Subscribers of a channel: four processes, launcher, recorder, console and one to spare.
pub(super) const MAX_SUBSCRIBERS: usize = 8;
/// Publishers of a channel: `health` and `answers` have one a process.
pub(super) const MAX_PUBLISHERS: usize = 8;

/// Key of the service attribute that carries the schema hash.
const SCHEMA_KEY: &str = "vitreo-schema";

pub(super) fn schema_attribute<M: Message>() -> Result<AttributeVerifier, IpcError> {
    let value = format!("{:016x}", M::SCHEMA);
    AttributeVerifier::new()
        .require(
            &SCHEMA_KEY.try_into().map_err(transport(M::CHANNEL, "schema attribute"))?,
            &value.as_str().try_into().map_err(transport(M::CHANNEL, "schema attribute"))?,
        )
        .map_err(transport(M::CHANNEL, "schema attribute"))
}

pub(super) fn open_error<M: Message>(e: PublishSubscribeOpenOrCreateError) -> IpcError {
    use PublishSubscribeOpenError::{IncompatibleAttributes, IncompatibleTypes};
    use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as Open;
    match e {
        Open(IncompatibleAttributes | IncompatibleTypes) => {
            IpcError::SchemaDiffers { channel: M::CHANNEL, schema: M::SCHEMA }
        }
        other => transport(M::CHANNEL, "open")(other),
    }
}

/// Sends blocks of one channel.
pub struct Sender<M: Message + std::fmt::Debug> {
    publisher: Publisher<Service, Wire<M>, Stamp>,
    notifier: Notifier,
    stamp: Stamp,
}

impl<M: Message + std::fmt::Debug> Sender<M> {
    /// Copies a block into shared memory and wakes its receivers.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn send(&mut self, message: &M) -> Result<(), IpcError> {
        let mut sample = self.publisher.loan_uninit().map_err(transport(M::CHANNEL, "loan"))?;
        self.stamp.sent_ns = now();
        *sample.user_header_mut() = self.stamp;
        let sample = sample.write_payload(Wire(*message));
        sample.send().map_err(transport(M::CHANNEL, "send"))?;
        self.stamp.seq += 1;
        self.notifier.notify();
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
pub struct Receiver<M: Message + std::fmt::Debug> {
    subscriber: Subscriber<Service, Wire<M>, Stamp>,
    listener: Listener,
    account: Account,
}

impl<M: Message + std::fmt::Debug> Receiver<M> {
    /// The next block (or the newest, if opened so), checked; `None` when there is nothing new.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn receive(&mut self) -> Result<Option<Received<M>>, IpcError> {
        let sample = self.subscriber.receive().map_err(transport(M::CHANNEL, "receive"))?;
        let Some(sample) = sample else { return Ok(None) };
        self.account.note(sample.user_header());
        let message = sample.payload().0;
        if let Err(invalid) = message.validate() {
            self.account.refused += 1;
            return Ok(Some(Err(invalid)));
        }
        Ok(Some(Ok(message)))
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

impl<M: Message + std::fmt::Debug> Wakes for Receiver<M> {
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

impl Instance {
    fn service<M: Message + std::fmt::Debug>(
        &self,
    ) -> Result<PortFactory<Service, Wire<M>, Stamp>, IpcError> {
        self.check()?;
        let name = M::CHANNEL.try_into().map_err(transport(M::CHANNEL, "service name"))?;
        self.node
            .service_builder(&name)
            .publish_subscribe::<Wire<M>>()
            .user_header::<Stamp>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(M::QUEUE)
            .subscriber_max_borrowed_samples(2)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_publishers(MAX_PUBLISHERS)
            .open_or_create_with_attributes(&schema_attribute::<M>()?)
            .map_err(open_error::<M>)
    }

    /// Opens the sending side of a channel.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn sender<M: Message + std::fmt::Debug>(&self) -> Result<Sender<M>, IpcError> {
        let _limit = self.open_limit(M::CHANNEL);
        let publisher =
            self.service::<M>()?.publisher_builder().create().map_err(transport(M::CHANNEL, "publisher"))?;
        let notifier = Notifier::open(self, M::CHANNEL)?;
        self.reserve()?;
        Ok(Sender { publisher, notifier, stamp: Stamp { epoch: now(), ..Stamp::default() } })
    }

    /// Opens the receiving side of a channel.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn receiver<M: Message + std::fmt::Debug>(&self, queue: Queue) -> Result<Receiver<M>, IpcError> {
        let _limit = self.open_limit(M::CHANNEL);
        let depth = match queue {
            Queue::InOrder => M::QUEUE,
            Queue::Newest => 1,
        };
        let subscriber = self
            .service::<M>()?
            .subscriber_builder()
            .buffer_size(depth)
            .create()
            .map_err(transport(M::CHANNEL, "subscriber"))?;
        let listener = Listener::open(self, M::CHANNEL)?;
        self.reserve()?;
        Ok(Receiver { subscriber, listener, account: Account::default() })
    }
}
