//! Untyped ports: the node, and senders and receivers of stamped bytes.
//!
//! iceoryx2's ports are generic, and a crate that so much as drops one compiles it again, with the
//! reader and writer of iceoryx2's configuration. So every channel carries units of sixteen bytes
//! after a stamp, everything generic lies behind a trait object or in a method of this crate, and
//! the processes compile none of it (docs/build.md has the times).

use super::wake::{Listener, Notifier};
use super::{IpcError, transport};
use crate::clock::now;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use protocol::message::Message;
use protocol::time::Nanos;
use std::mem::ManuallyDrop;

pub(super) type Service = ipc::Service;

/// Bytes of a unit of payload, and its alignment: every section is aligned for SIMD and the GPU.
pub(super) const UNIT: usize = 16;

/// A unit of payload.
#[repr(C, align(16))]
#[derive(Debug, Clone, Copy, Default)]
struct Unit([u8; UNIT]);

// SAFETY: sixteen bytes; no pointers, no padding.
unsafe impl ZeroCopySend for Unit {
    unsafe fn type_name() -> &'static str {
        "vitreo-unit"
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
unsafe impl ZeroCopySend for Stamp {
    unsafe fn type_name() -> &'static str {
        "vitreo-stamp"
    }
}

/// Blocks lent at a time to a sender that sends each before it builds the next but one.
const LOANS: usize = 2;

/// What is known of a channel before it is opened.
#[derive(Debug, Clone, Copy)]
pub(super) struct Channel {
    pub(super) name: &'static str,
    /// Hash of the message's layout, which both sides must share.
    pub(super) schema: u64,
    /// Blocks kept for a receiver that falls behind.
    pub(super) queue: usize,
    pub(super) max_subscribers: usize,
    pub(super) max_publishers: usize,
    /// Blocks that a sender holds at most while they are not sent.
    pub(super) loans: usize,
}

impl Channel {
    /// That of a message.
    pub(super) fn of<M: Message>(max_subscribers: usize, max_publishers: usize) -> Self {
        Channel {
            name: M::CHANNEL,
            schema: M::SCHEMA,
            queue: M::QUEUE,
            max_subscribers,
            max_publishers,
            loans: LOANS,
        }
    }

    /// Key of the service attribute that carries the schema hash.
    const SCHEMA_KEY: &str = "vitreo-schema";

    fn attributes(&self) -> Result<AttributeVerifier, IpcError> {
        let value = format!("{:016x}", self.schema);
        AttributeVerifier::new()
            .require(
                &Self::SCHEMA_KEY.try_into().map_err(transport(self.name, "schema attribute"))?,
                &value.as_str().try_into().map_err(transport(self.name, "schema attribute"))?,
            )
            .map_err(transport(self.name, "schema attribute"))
    }

    fn open_error(&self, error: PublishSubscribeOpenOrCreateError) -> IpcError {
        use PublishSubscribeOpenError::{IncompatibleAttributes, IncompatibleTypes};
        use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as Open;
        match error {
            Open(IncompatibleAttributes | IncompatibleTypes) => {
                IpcError::SchemaDiffers { channel: self.name, schema: self.schema }
            }
            other => transport(self.name, "open")(other),
        }
    }

    fn service(&self, node: &Node<Service>) -> Result<PortFactory<Service, [Unit], Stamp>, IpcError> {
        let name = self.name.try_into().map_err(transport(self.name, "service name"))?;
        node.service_builder(&name)
            .publish_subscribe::<[Unit]>()
            .user_header::<Stamp>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(self.queue)
            .subscriber_max_borrowed_samples(2)
            .max_subscribers(self.max_subscribers)
            .max_publishers(self.max_publishers)
            .open_or_create_with_attributes(&self.attributes()?)
            .map_err(|e| self.open_error(e))
    }
}

/// A node of iceoryx2.
pub(super) trait Ports {
    /// Opens the sending side of a channel of at most `capacity` bytes a block.
    fn sender(&self, channel: &Channel, capacity: usize) -> Result<Box<dyn SendPort>, IpcError>;
    /// Opens the receiving side, which keeps `depth` blocks.
    fn receiver(&self, channel: &Channel, depth: usize) -> Result<Box<dyn ReceivePort>, IpcError>;
    /// The event beside a channel.
    fn listener(&self, channel: &'static str) -> Result<Listener, IpcError>;
    /// Frees what dead processes held.
    fn clean_up_after_the_dead(&self);
}

impl Ports for Node<Service> {
    fn sender(&self, channel: &Channel, capacity: usize) -> Result<Box<dyn SendPort>, IpcError> {
        let publisher = channel
            .service(self)?
            .publisher_builder()
            .initial_max_slice_len(capacity.div_ceil(UNIT).max(1))
            .max_loaned_samples(channel.loans)
            .create()
            .map_err(transport(channel.name, "publisher"))?;
        let notifier = Notifier::open(self, channel.name)?;
        Ok(Box::new(Sending { publisher, notifier, channel: channel.name }))
    }

    fn receiver(&self, channel: &Channel, depth: usize) -> Result<Box<dyn ReceivePort>, IpcError> {
        let subscriber = channel.service(self)?.subscriber_builder().buffer_size(depth).create();
        let subscriber = subscriber.map_err(transport(channel.name, "subscriber"))?;
        Ok(Box::new(Receiving { subscriber, channel: channel.name }))
    }

    fn listener(&self, channel: &'static str) -> Result<Listener, IpcError> {
        Listener::open(self, channel)
    }

    fn clean_up_after_the_dead(&self) {
        self.try_cleanup_dead_nodes();
    }
}

/// A channel's sending side.
pub(super) trait SendPort {
    /// Lends at least `bytes` of shared memory, a multiple of [`UNIT`], to `write`, then sends them
    /// and wakes the receivers; where `write` says false, nothing is sent. The memory holds whatever an
    /// earlier block left there.
    fn send(
        &mut self,
        stamp: Stamp,
        bytes: usize,
        write: &mut dyn FnMut(&mut [u8]) -> bool,
    ) -> Result<bool, IpcError>;
    /// Lends at least `bytes` of shared memory, as [`SendPort::send`] does, to be sent later or not at all.
    fn lend(&mut self, bytes: usize) -> Result<Box<dyn Lent>, IpcError>;
    /// Sends what was lent, and wakes the receivers.
    fn send_lent(&mut self, lent: Box<dyn Lent>, stamp: Stamp) -> Result<(), IpcError>;
}

/// Lent shared memory.
pub(super) trait Lent {
    /// All of it.
    fn bytes(&mut self) -> &mut [u8];
    /// Hands it to the receivers.
    fn send(self: Box<Self>, stamp: Stamp) -> Result<(), IpcError>;
}

struct Lending {
    sample: SampleMut<Service, [Unit], Stamp>,
    channel: &'static str,
}

impl Lent for Lending {
    fn bytes(&mut self) -> &mut [u8] {
        as_bytes_mut(self.sample.payload_mut())
    }

    fn send(mut self: Box<Self>, stamp: Stamp) -> Result<(), IpcError> {
        *self.sample.user_header_mut() = stamp;
        self.sample.send().map(|_| ()).map_err(transport(self.channel, "send"))
    }
}

struct Sending {
    publisher: Publisher<Service, [Unit], Stamp>,
    notifier: Notifier,
    channel: &'static str,
}

impl SendPort for Sending {
    fn send(
        &mut self,
        stamp: Stamp,
        bytes: usize,
        write: &mut dyn FnMut(&mut [u8]) -> bool,
    ) -> Result<bool, IpcError> {
        let units = bytes.div_ceil(UNIT).max(1);
        let sample = self.publisher.loan_slice_uninit(units).map_err(transport(self.channel, "loan"))?;
        // SAFETY: `Unit` is sixteen plain bytes, valid whatever they hold, and pages of a shared
        // memory file are never uninitialised: they hold zeros or an earlier block.
        let mut sample = unsafe { sample.assume_init() };
        if !write(as_bytes_mut(sample.payload_mut())) {
            return Ok(false);
        }
        *sample.user_header_mut() = Stamp { sent_ns: now(), ..stamp };
        sample.send().map_err(transport(self.channel, "send"))?;
        self.notifier.notify();
        Ok(true)
    }

    fn lend(&mut self, bytes: usize) -> Result<Box<dyn Lent>, IpcError> {
        let units = bytes.div_ceil(UNIT).max(1);
        let sample = self.publisher.loan_slice_uninit(units).map_err(transport(self.channel, "loan"))?;
        // SAFETY: as in `send`.
        let sample = unsafe { sample.assume_init() };
        Ok(Box::new(Lending { sample, channel: self.channel }))
    }

    fn send_lent(&mut self, lent: Box<dyn Lent>, stamp: Stamp) -> Result<(), IpcError> {
        lent.send(stamp)?;
        self.notifier.notify();
        Ok(())
    }
}

/// A channel's receiving side.
pub(super) trait ReceivePort {
    /// The next block, if there is a new one.
    fn receive(&mut self) -> Result<Option<Held>, IpcError>;
}

struct Receiving {
    subscriber: Subscriber<Service, [Unit], Stamp>,
    channel: &'static str,
}

impl ReceivePort for Receiving {
    fn receive(&mut self) -> Result<Option<Held>, IpcError> {
        let sample = self.subscriber.receive().map_err(transport(self.channel, "receive"))?;
        Ok(sample.map(|sample| Held { sample: ManuallyDrop::new(sample) }))
    }
}

/// A received block; its shared memory is given back when this is dropped.
pub(super) struct Held {
    // Dropped by a function of this crate, so that no other compiles the dropping.
    sample: ManuallyDrop<Sample<Service, [Unit], Stamp>>,
}

impl Held {
    pub(super) fn stamp(&self) -> Stamp {
        *self.sample.user_header()
    }

    /// A multiple of [`UNIT`] in length, and so aligned.
    pub(super) fn bytes(&self) -> &[u8] {
        as_bytes(self.sample.payload())
    }
}

impl Drop for Held {
    #[inline(never)]
    fn drop(&mut self) {
        // SAFETY: the sample is dropped here and nowhere else, and not used after.
        unsafe { ManuallyDrop::drop(&mut self.sample) }
    }
}

fn as_bytes_mut(units: &mut [Unit]) -> &mut [u8] {
    // SAFETY: `Unit` is sixteen plain bytes without padding, so its memory is initialised bytes.
    unsafe { std::slice::from_raw_parts_mut(units.as_mut_ptr().cast(), size_of_val(units)) }
}

fn as_bytes(units: &[Unit]) -> &[u8] {
    // SAFETY: as above.
    unsafe { std::slice::from_raw_parts(units.as_ptr().cast(), size_of_val(units)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Instance;

    const CHANNEL: Channel =
        Channel { name: "raw", schema: 1, queue: 4, max_subscribers: 2, max_publishers: 1, loans: LOANS };

    #[test]
    fn blocks_are_padded_aligned_and_given_back() {
        let instance = Instance::own(&format!("raw{}", std::process::id() % 1_000_000)).unwrap();
        let mut sender = instance.ports().sender(&CHANNEL, 40).unwrap();
        let mut receiver = instance.ports().receiver(&CHANNEL, 4).unwrap();
        // More than are ever borrowed at once: what is dropped is lent again.
        for seq in 0..100 {
            let stamp = Stamp { seq, ..Stamp::default() };
            let sent = sender.send(stamp, 33, &mut |bytes| {
                bytes.fill(seq as u8);
                true
            });
            assert!(sent.unwrap());
            assert!(!sender.send(stamp, 33, &mut |_| false).unwrap(), "lent, and given back unsent");
            let held = receiver.receive().unwrap().expect("a block");
            assert_eq!((held.stamp().seq, held.bytes().len()), (seq, 48));
            assert_eq!(held.bytes().as_ptr() as usize % UNIT, 0);
            assert!(held.bytes().iter().all(|b| *b == seq as u8));
        }
        assert!(receiver.receive().unwrap().is_none());
    }
}
