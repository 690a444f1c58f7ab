//! Waking up: one event service beside each channel, and a bounded wait on several of them.

use super::port::Service;
use super::{IpcError, transport};
use iceoryx2::prelude::*;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::sync::Arc;

/// Most sources of one [`wait`].
pub const MAX_SOURCES: usize = 8;

fn event_service(
    node: &Node<Service>,
    channel: &'static str,
) -> Result<iceoryx2::service::port_factory::event::PortFactory<Service>, IpcError> {
    let name = channel.try_into().map_err(transport(channel, "event name"))?;
    node.service_builder(&name)
        .event()
        // Every notification has the same number. A listener swaps a counter for each that there could be.
        .event_id_max_value(0)
        .max_notifiers(super::channel::MAX_PUBLISHERS)
        .max_listeners(super::channel::MANY_SUBSCRIBERS)
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
        // Takes all that have come; one that comes meanwhile ends the next wait.
        let _ = self.try_wait(|_| {});
    }

    fn descriptor(&self) -> RawFd {
        // SAFETY: only lent to `as_fd`, which the listener outlives.
        unsafe { self.file_descriptor().native_handle() }
    }
}

impl Listens for Arc<OwnedFd> {
    fn drain(&self) {
        // It counts the rings: one read takes them all, and finds nothing where there were none.
        let _ = rustix::io::read(&**self, &mut [0; 8]);
    }

    fn descriptor(&self) -> RawFd {
        self.as_raw_fd()
    }
}

/// Wakes a process from threads of its own, which have work for it.
pub struct Bell {
    counter: Arc<OwnedFd>,
    listener: Listener,
}

/// The rope of a [`Bell`], for another thread.
#[derive(Debug, Clone)]
pub struct BellRope(Arc<OwnedFd>);

impl Bell {
    /// A bell that has not been rung.
    ///
    /// # Errors
    /// Where the system has no more descriptors.
    pub fn new() -> std::io::Result<Self> {
        use rustix::event::EventfdFlags;
        let counter = rustix::event::eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?;
        let counter = Arc::new(counter);
        Ok(Bell { listener: Listener(Box::new(Arc::clone(&counter))), counter })
    }

    /// A rope to ring it by.
    pub fn rope(&self) -> BellRope {
        BellRope(Arc::clone(&self.counter))
    }
}

impl BellRope {
    /// Wakes the process, which may be awake.
    pub fn ring(&self) {
        // Full only after 2⁶⁴ rings that no waiter consumed.
        let _ = rustix::io::write(&*self.0, &1u64.to_ne_bytes());
    }
}

impl Wakes for Bell {
    fn listener(&self) -> &Listener {
        &self.listener
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
    wait_beside(sources, &[], timeout_ns);
}

/// As [`wait`], and until one of `files` can be read or was closed at its other end: true where one is. What is in
/// them is left there.
///
/// # Panics
/// With more than [`MAX_SOURCES`] of both together.
pub fn wait_beside(sources: &[&dyn Wakes], files: &[BorrowedFd<'_>], timeout_ns: u64) -> bool {
    let count = sources.len() + files.len();
    assert!(count <= MAX_SOURCES, "at most {MAX_SOURCES} sources");
    if count == 0 {
        crate::clock::sleep_until(crate::clock::now() + timeout_ns);
        return false;
    }
    let timeout = rustix::time::Timespec {
        tv_sec: (timeout_ns / 1_000_000_000) as i64,
        tv_nsec: (timeout_ns % 1_000_000_000) as _,
    };
    let poll_fd = |i: usize| {
        let i = i.min(count - 1);
        let listened = sources.get(i).map(|source| source.listener().as_fd());
        let fd = listened.unwrap_or_else(|| files[i - sources.len()]);
        rustix::event::PollFd::from_borrowed_fd(fd, rustix::event::PollFlags::IN)
    };
    let mut fds: [rustix::event::PollFd<'_>; MAX_SOURCES] = std::array::from_fn(poll_fd);
    // An interrupted or failed poll is a wake-up like any other.
    let _ = rustix::event::poll(&mut fds[..count], Some(&timeout));
    // Draining asks the system once more, so only what was notified is drained.
    let is_ready = fds.map(|fd| !fd.revents().is_empty());
    for (source, _) in sources.iter().zip(is_ready).filter(|(_, is_ready)| *is_ready) {
        source.listener().drain();
    }
    is_ready[sources.len()..count].contains(&true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::now;

    /// Longer than any machine takes to ring.
    const LONG_NS: u64 = 60_000_000_000;

    #[test]
    fn a_bell_wakes_once_for_all_its_rings() {
        let bell = Bell::new().unwrap();
        let begun = now();
        let rope = bell.rope();
        std::thread::spawn(move || (0..3).for_each(|_| rope.ring())).join().unwrap();
        wait(&[&bell], LONG_NS);
        assert!(now() - begun < LONG_NS);
        let quiet = now();
        wait(&[&bell], 2_000_000);
        assert!(now() - quiet >= 2_000_000, "the rings before were taken away");
        let rope = bell.rope();
        let ringing = std::thread::spawn(move || rope.ring());
        wait(&[&bell], LONG_NS);
        assert!(now() - begun < LONG_NS);
        ringing.join().unwrap();
    }

    #[test]
    fn a_wait_says_whether_a_file_ended_it_and_drains_what_was_rung_beside_it() {
        let (bell, other) = (Bell::new().unwrap(), Bell::new().unwrap());
        let file = rustix::event::eventfd(0, rustix::event::EventfdFlags::NONBLOCK).unwrap();
        other.rope().ring();
        assert!(!wait_beside(&[&bell, &other], &[file.as_fd()], LONG_NS), "the bell did");
        rustix::io::write(&file, &1u64.to_ne_bytes()).unwrap();
        assert!(wait_beside(&[&bell, &other], &[file.as_fd()], LONG_NS));
        rustix::io::read(&file, &mut [0; 8]).unwrap();
        assert!(!wait_beside(&[&bell, &other], &[file.as_fd()], 1_000_000), "nobody did");
    }
}
