//! The connected programs: one that does not read delays no other.
//!
//! The thread that reads the poses also does this: a frame is one `write` per client, and no other thread is woken
//! for it. What the system does not take at once waits here, a little.

use anyhow::Context;
use igtl::Reader;
use ipc::logging::message;
use protocol::time::Nanos;
use rustix::event::epoll::{self, EventData, EventFlags};
use rustix::net::sockopt::set_socket_send_buffer_size;
use rustix::time::Timespec;
use settings::commands::bridge::Listen;
use std::collections::{BTreeMap, VecDeque};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use tracing::Level;

/// Frames that wait for a slow client; then it misses the oldest. At 200 Hz more than a second.
const WAITING: usize = 256;
/// Time without reading after which a client is closed, ns.
const PATIENCE_NS: u64 = 5_000_000_000;
/// Clients at a time.
const CLIENTS: usize = 16;
/// Bytes that the system keeps for a client that reads slowly: some tenths of a second.
const KEPT_BYTES: usize = 32_768;
/// Bytes of a client that are read at a time.
const READ_BYTES: usize = 4096;
/// After a failure to accept, for want of descriptors for instance, ns.
const PAUSE_NS: u64 = 200_000_000;
/// What the listener is called among the descriptors; clients count from 1.
const LISTENER: u64 = 0;

/// The clients.
#[derive(Debug)]
pub struct Clients {
    listener: TcpListener,
    /// epoll instance of the listener and the clients.
    interest: OwnedFd,
    clients: BTreeMap<u64, Client>,
    next: u64,
    /// No client is accepted until then; 0 if accepting has not failed.
    deaf_until_ns: Nanos,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    who: SocketAddr,
    reader: Reader,
    /// What the system has not taken yet, and how much of the first frame it has.
    waiting: VecDeque<Arc<[u8]>>,
    begun: usize,
    /// When the system last took something, or had nothing to take.
    taken_ns: Nanos,
    /// Frames that the system has taken, calls of the system that gave it something, and frames left out.
    sent: u64,
    writes: u64,
    missed: u64,
}

impl Clients {
    /// Listens for clients. Returns the address too, whose port may have been the system's choice.
    ///
    /// # Errors
    /// Where the address cannot be used.
    pub fn listen(at: &Listen) -> anyhow::Result<(Self, SocketAddr)> {
        let host = at.host.trim_matches(['[', ']']);
        let listener = TcpListener::bind((host, at.port)).with_context(|| format!("listen on {at}"))?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let interest = epoll::create(epoll::CreateFlags::CLOEXEC)?;
        epoll::add(&interest, &listener, EventData::new_u64(LISTENER), EventFlags::IN)?;
        Ok((Clients { listener, interest, clients: BTreeMap::new(), next: 1, deaf_until_ns: 0 }, address))
    }

    /// Readable while somebody wants something: then [`Clients::serve`].
    pub fn wants(&self) -> BorrowedFd<'_> {
        self.interest.as_fd()
    }

    /// How many are connected.
    pub fn count(&self) -> usize {
        self.clients.len()
    }

    /// Takes new clients, reads what they say, writes what waits for them, and closes those that are gone or do not
    /// read. To be called where somebody wants something, and now and then.
    pub fn serve(&mut self, now: Nanos) {
        self.hear_again(now);
        let nothing = epoll::Event { flags: EventFlags::empty(), data: EventData::new_u64(0) };
        let mut events = [nothing; CLIENTS + 1];
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        let found = epoll::wait(&self.interest, &mut events[..], Some(&at_once)).unwrap_or(0);
        for event in &events[..found] {
            let epoll::Event { data, .. } = *event;
            match data.u64() {
                LISTENER => self.accept(now),
                id => self.attend(id, now),
            }
        }
        let late = |c: &Client| !c.waiting.is_empty() && now.saturating_sub(c.taken_ns) > PATIENCE_NS;
        let late: Vec<u64> = self.clients.iter().filter(|(_, c)| late(c)).map(|(id, _)| *id).collect();
        for id in late {
            self.close(
                id,
                &format!("was disconnected: it has read nothing for {} s", PATIENCE_NS / 1_000_000_000),
            );
        }
    }

    /// Hands a frame on; without clients it is forgotten.
    pub fn send(&mut self, frame: &[u8], now: Nanos) {
        let mut kept: Option<Arc<[u8]>> = None;
        let mut gone = Vec::new();
        for (id, client) in &mut self.clients {
            let before = client.waiting.len();
            match client.take(frame, &mut kept, now) {
                Ok(()) if before == 0 && !client.waiting.is_empty() => {
                    watch(&self.interest, &client.stream, *id, true);
                }
                Ok(()) => {}
                Err(problem) => gone.push((*id, format!("has disconnected ({problem})"))),
            }
        }
        gone.iter().for_each(|(id, why)| self.close(*id, why));
    }

    /// Closes all.
    pub fn end(&mut self) {
        let all: Vec<u64> = self.clients.keys().copied().collect();
        all.into_iter().for_each(|id| self.close(id, "was disconnected: the bridge stops"));
    }

    fn accept(&mut self, now: Nanos) {
        match self.listener.accept() {
            Ok((_, who)) if self.count() >= CLIENTS => {
                message(
                    Level::WARN,
                    &format!("{who} was rejected: {CLIENTS} clients are connected, the most at a time"),
                );
            }
            Ok((stream, who)) => match self.take_in(stream, who, now) {
                Ok(()) => message(Level::INFO, &format!("{who} is connected")),
                Err(problem) => message(Level::WARN, &format!("{who} could not be accepted: {problem}")),
            },
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(problem) => {
                message(Level::WARN, &format!("a client could not be accepted: {problem}"));
                // It goes on wanting to be taken, which must not keep this thread busy.
                let _ = epoll::delete(&self.interest, &self.listener);
                self.deaf_until_ns = now + PAUSE_NS;
            }
        }
    }

    fn hear_again(&mut self, now: Nanos) {
        if self.deaf_until_ns > 0 && now >= self.deaf_until_ns {
            let added =
                epoll::add(&self.interest, &self.listener, EventData::new_u64(LISTENER), EventFlags::IN);
            self.deaf_until_ns = if added.is_ok() { 0 } else { now + PAUSE_NS };
        }
    }

    fn take_in(&mut self, stream: TcpStream, who: SocketAddr, now: Nanos) -> io::Result<()> {
        stream.set_nonblocking(true)?;
        // Small messages that must not wait for others.
        stream.set_nodelay(true)?;
        // Who reads slowly misses frames, and does not read old ones.
        set_socket_send_buffer_size(&stream, KEPT_BYTES)?;
        epoll::add(&self.interest, &stream, EventData::new_u64(self.next), EventFlags::IN)?;
        let (reader, waiting) = (Reader::default(), VecDeque::new());
        let client =
            Client { stream, who, reader, waiting, begun: 0, taken_ns: now, sent: 0, writes: 0, missed: 0 };
        self.clients.insert(self.next, client);
        self.next += 1;
        Ok(())
    }

    /// One client wants something.
    fn attend(&mut self, id: u64, now: Nanos) {
        let Some(client) = self.clients.get_mut(&id) else { return };
        let waited = !client.waiting.is_empty();
        let done = client.listen().and_then(|()| client.write_on(now).map_err(|e| format!("is gone ({e})")));
        match done {
            Ok(()) if waited && client.waiting.is_empty() => watch(&self.interest, &client.stream, id, false),
            Ok(()) => {}
            Err(why) => self.close(id, &why),
        }
    }

    fn close(&mut self, id: u64, why: &str) {
        let Some(Client { stream, who, sent, writes, missed, .. }) = self.clients.remove(&id) else { return };
        let _ = epoll::delete(&self.interest, &stream);
        let missed = if missed > 0 { format!(", {missed} missed") } else { String::new() };
        message(Level::INFO, &format!("{who} {why}: {sent} frames sent in {writes} writes{missed}"));
    }
}

/// Starts or stops watching whether a client can be written to.
fn watch(interest: &OwnedFd, stream: &TcpStream, id: u64, writing: bool) {
    let flags = if writing { EventFlags::IN | EventFlags::OUT } else { EventFlags::IN };
    // A client that is sent nothing more is closed once it has read nothing for long.
    let _ = epoll::modify(interest, stream, EventData::new_u64(id), flags);
}

impl Client {
    /// Writes a frame, or as much as the system takes; what it does not is kept, once for all in `kept`.
    fn take(&mut self, frame: &[u8], kept: &mut Option<Arc<[u8]>>, now: Nanos) -> io::Result<()> {
        if self.waiting.is_empty() {
            self.taken_ns = now;
            self.begun = write_some(&mut self.stream, frame)?;
            self.writes += u64::from(self.begun > 0);
            if self.begun == frame.len() {
                (self.begun, self.sent) = (0, self.sent + 1);
                return Ok(());
            }
        } else if self.waiting.len() >= WAITING {
            // The first may have been begun.
            self.waiting.remove(1);
            self.missed += 1;
        }
        self.waiting.push_back(Arc::clone(kept.get_or_insert_with(|| frame.into())));
        Ok(())
    }

    /// Writes on of what waits.
    fn write_on(&mut self, now: Nanos) -> io::Result<()> {
        while let Some(frame) = self.waiting.front() {
            let taken = write_some(&mut self.stream, &frame[self.begun..])?;
            if taken > 0 {
                (self.taken_ns, self.writes) = (now, self.writes + 1);
            }
            self.begun += taken;
            if self.begun < frame.len() {
                return Ok(());
            }
            self.waiting.pop_front();
            (self.begun, self.sent) = (0, self.sent + 1);
        }
        Ok(())
    }

    /// Reads what it says, which asks for nothing here; why it is to be closed, where it is.
    fn listen(&mut self) -> Result<(), String> {
        let mut bytes = [0; READ_BYTES];
        match self.stream.read(&mut bytes) {
            Ok(0) => Err("has disconnected".into()),
            Ok(n) => self
                .reader
                .take(&bytes[..n], |_| {})
                .map_err(|broken| format!("was disconnected: it does not speak OpenIGTLink ({broken})")),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(()),
            Err(problem) => Err(format!("has disconnected ({problem})")),
        }
    }
}

/// Writes as much as the system takes at once.
fn write_some(stream: &mut TcpStream, bytes: &[u8]) -> io::Result<usize> {
    match stream.write(bytes) {
        Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
        written => written,
    }
}

#[cfg(test)]
mod tests;
