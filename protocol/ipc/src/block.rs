//! Senders and receivers of a header with a payload of variable size, written in place.

use super::channel::{Account, Counts, MAX_PUBLISHERS, MAX_SUBSCRIBERS, Stamp, open_error, schema_attribute};
use super::instance::{Instance, Service};
use super::wake::{Listener, Notifier, Wakes};
use super::{IpcError, transport};
use crate::clock::now;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use protocol::message::Message;
use std::fmt::Debug;

/// Payload unit: sixteen bytes, so that every section is aligned for SIMD and for the GPU.
#[repr(C, align(16))]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Unit([u8; 16]);

// SAFETY: sixteen bytes; no pointers, no padding.
unsafe impl ZeroCopySend for Unit {}

/// Header of a block as iceoryx2 sees it.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockHeader<H: Message> {
    stamp: Stamp,
    header: H,
}

impl<H: Message> Default for BlockHeader<H> {
    fn default() -> Self {
        Self { stamp: Stamp::default(), header: H::zeroed() }
    }
}

// SAFETY: `Stamp` and `H: Pod` hold no pointers; `repr(C)` fixes the layout.
unsafe impl<H: Message + Debug> ZeroCopySend for BlockHeader<H> {
    unsafe fn type_name() -> &'static str {
        H::CHANNEL
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

/// Sends blocks with a header `H`.
pub struct BlockSender<H: Message + Debug> {
    publisher: Publisher<Service, [Unit], BlockHeader<H>>,
    notifier: Notifier,
    stamp: Stamp,
    capacity: usize,
}

impl<H: Message + Debug> BlockSender<H> {
    /// Lends `bytes` of shared memory to `write`, which fills them and returns the header; then
    /// sends the block. The memory holds whatever an earlier block left there.
    ///
    /// # Errors
    /// Where the block is larger than the capacity, or the transport fails.
    pub fn send(&mut self, bytes: usize, write: impl FnOnce(&mut [u8]) -> H) -> Result<(), IpcError> {
        if bytes > self.capacity {
            return Err(IpcError::TooLarge { channel: H::CHANNEL, bytes, capacity: self.capacity });
        }
        let units = bytes.div_ceil(16).max(1);
        let sample = self.publisher.loan_slice_uninit(units).map_err(transport(H::CHANNEL, "loan"))?;
        // SAFETY: `Unit` is sixteen plain bytes, valid whatever they hold, and pages of a shared
        // memory file are never uninitialised: they hold zeros or an earlier block.
        let mut sample = unsafe { sample.assume_init() };
        let header = write(as_bytes_mut(sample.payload_mut()));
        self.stamp.sent_ns = now();
        *sample.user_header_mut() = BlockHeader { stamp: self.stamp, header };
        sample.send().map_err(transport(H::CHANNEL, "send"))?;
        self.stamp.seq += 1;
        self.notifier.notify();
        Ok(())
    }

    /// Blocks sent so far.
    pub fn sent(&self) -> u64 {
        self.stamp.seq
    }
}

/// A received block; its shared memory is given back when this is dropped.
pub struct BlockSample<H: Message + Debug> {
    sample: Sample<Service, [Unit], BlockHeader<H>>,
}

impl<H: Message + Debug> BlockSample<H> {
    /// The header.
    pub fn header(&self) -> &H {
        &self.sample.user_header().header
    }

    /// The payload; its length is a multiple of 16 and its start is aligned to 16 bytes.
    pub fn payload(&self) -> &[u8] {
        as_bytes(self.sample.payload())
    }
}

/// Receives blocks with a header `H`, in order; the newest [`Message::QUEUE`] are kept.
pub struct BlockReceiver<H: Message + Debug> {
    subscriber: Subscriber<Service, [Unit], BlockHeader<H>>,
    listener: Listener,
    account: Account,
}

impl<H: Message + Debug> BlockReceiver<H> {
    /// The next block, its header checked; refused ones are counted.
    ///
    /// # Errors
    /// Where the transport fails.
    pub fn receive(&mut self) -> Result<Option<BlockSample<H>>, IpcError> {
        loop {
            let received = self.subscriber.receive();
            let received = received.map_err(transport(H::CHANNEL, "receive"))?;
            let Some(sample) = received else { return Ok(None) };
            self.account.note(&sample.user_header().stamp);
            if sample.user_header().header.validate().is_ok() {
                return Ok(Some(BlockSample { sample }));
            }
            self.account.refused += 1;
        }
    }

    /// Blocks taken in, passed over and refused so far.
    pub fn counts(&self) -> Counts {
        self.account.counts()
    }
}

impl<H: Message + Debug> Wakes for BlockReceiver<H> {
    fn listener(&self) -> &Listener {
        &self.listener
    }
}

impl Instance {
    fn block_service<H: Message + Debug>(
        &self,
    ) -> Result<PortFactory<Service, [Unit], BlockHeader<H>>, IpcError> {
        self.check()?;
        let name = H::CHANNEL.try_into().map_err(transport(H::CHANNEL, "service name"))?;
        self.node
            .service_builder(&name)
            .publish_subscribe::<[Unit]>()
            .user_header::<BlockHeader<H>>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(H::QUEUE)
            .subscriber_max_borrowed_samples(2)
            .max_subscribers(MAX_SUBSCRIBERS.min(4))
            .max_publishers(MAX_PUBLISHERS.min(2))
            .open_or_create_with_attributes(&schema_attribute::<H>()?)
            .map_err(open_error::<H>)
    }

    /// Opens the sending side of a channel of blocks of at most `capacity` bytes.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn block_sender<H: Message + Debug>(&self, capacity: usize) -> Result<BlockSender<H>, IpcError> {
        let _limit = self.open_limit(H::CHANNEL);
        let publisher = self
            .block_service::<H>()?
            .publisher_builder()
            .initial_max_slice_len(capacity.div_ceil(16))
            .create()
            .map_err(transport(H::CHANNEL, "publisher"))?;
        let notifier = Notifier::open(self, H::CHANNEL)?;
        self.reserve()?;
        Ok(BlockSender { publisher, notifier, stamp: Stamp { epoch: now(), ..Stamp::default() }, capacity })
    }

    /// Opens the receiving side of a channel of blocks.
    ///
    /// # Errors
    /// Where another build runs with another layout, or the transport fails.
    pub fn block_receiver<H: Message + Debug>(&self) -> Result<BlockReceiver<H>, IpcError> {
        let _limit = self.open_limit(H::CHANNEL);
        let subscriber = self
            .block_service::<H>()?
            .subscriber_builder()
            .create()
            .map_err(transport(H::CHANNEL, "subscriber"))?;
        let listener = Listener::open(self, H::CHANNEL)?;
        self.reserve()?;
        Ok(BlockReceiver { subscriber, listener, account: Account::default() })
    }
}
