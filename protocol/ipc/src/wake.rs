//! Waking up: one event service beside each channel, and a bounded wait on several of them.

use super::port::Service;
use super::{IpcError, transport};
use iceoryx2::prelude::*;
use std::os::fd::{AsFd, BorrowedFd, RawFd};

/// Most sources of one [`wait`].
pub const MAX_SOURCES: usize = 8;

fn event_service(
    node: &Node<Service>,
    channel: &'static str,
) -> Result<iceoryx2::service::port_factory::event::PortFactory<Service>, IpcError> {
    let name = channel.try_into().map_err(transport(channel, "event name"))?;
    node.service_builder(&name)
        .event()
        .max_notifiers(super::channel::MAX_PUBLISHERS)
        .max_listeners(super::channel::MAX_SUBSCRIBERS)
        .open_or_create()
        .map_err(transport(channel, "event"))
}

/// Wakes the receivers of a channel.
pub(super) struct Notifier(iceoryx2::port::notifier::Notifier<Service>);

impl Notifier {
    pub(super) fn open(node: &Node<Service>, channel: &'static str) -> Result<Self, IpcError> {
        let notifier = event_service(node, channel)?.notifier_builder().create();
        Ok(Self(notifier.map_err(transport(channel, "notifier"))?))
    }

    /// A notification that cannot be delivered is no error: every wait is bounded, and its caller
    /// drains the channel whatever woke it.
    pub(super) fn notify(&self) {
        let _ = self.0.notify();
    }
}

/// Receives the notifications of the senders of a channel.
pub struct Listener(Box<dyn Listens>);

/// iceoryx2's listener, behind a trait object as the ports are.
trait Listens {
    fn drain(&self);
    fn descriptor(&self) -> RawFd;
}

impl Listens for iceoryx2::port::listener::Listener<Service> {
    fn drain(&self) {
        while self.try_wait(|_| {}).unwrap_or(0) > 0 {}
    }

    fn descriptor(&self) -> RawFd {
        // SAFETY: only lent to `as_fd`, which the listener outlives.
        unsafe { self.file_descriptor().native_handle() }
    }
}

impl Listener {
    pub(super) fn open(node: &Node<Service>, channel: &'static str) -> Result<Self, IpcError> {
        let listener = event_service(node, channel)?.listener_builder().create();
        Ok(Self(Box::new(listener.map_err(transport(channel, "listener"))?)))
    }

    /// Takes all notifications away, until there are none.
    fn drain(&self) {
        self.0.drain();
    }
}

impl AsFd for Listener {
    /// Readable while a notification waits.
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the listener owns the descriptor and outlives the borrow.
        unsafe { BorrowedFd::borrow_raw(self.0.descriptor()) }
    }
}

/// A channel's receiving side that can wake a waiting process.
pub trait Wakes {
    /// Its listener.
    fn listener(&self) -> &Listener;
}

/// Sleeps until one of `sources` is notified or `timeout_ns` has passed. The caller then drains
/// all of them, whatever the reason.
///
/// # Panics
/// With more than [`MAX_SOURCES`].
pub fn wait(sources: &[&dyn Wakes], timeout_ns: u64) {
    assert!(sources.len() <= MAX_SOURCES, "at most {MAX_SOURCES} sources");
    let timeout = rustix::time::Timespec {
        tv_sec: (timeout_ns / 1_000_000_000) as i64,
        tv_nsec: (timeout_ns % 1_000_000_000) as _,
    };
    let poll_fd = |i: usize| {
        let listener = sources[i.min(sources.len() - 1)].listener();
        rustix::event::PollFd::from_borrowed_fd(listener.as_fd(), rustix::event::PollFlags::IN)
    };
    if sources.is_empty() {
        crate::clock::sleep_until(crate::clock::now() + timeout_ns);
        return;
    }
    let mut fds: [rustix::event::PollFd<'_>; MAX_SOURCES] = std::array::from_fn(poll_fd);
    // An interrupted or failed poll is a wake-up like any other.
    let _ = rustix::event::poll(&mut fds[..sources.len()], Some(&timeout));
    for source in sources {
        source.listener().drain();
    }
}
