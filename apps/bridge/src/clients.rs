//! The programs that are connected: each has a task of its own, and what one does not read delays no other.

use anyhow::Context;
use igtl::Reader;
use ipc::logging::message;
use settings::commands::bridge::Listen;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::time::timeout;
use tracing::Level;

/// Frames that wait for a slow client; then it misses the oldest. At 200 Hz more than a second.
const WAITING: usize = 256;
/// A client that has read nothing for so long is closed.
const PATIENCE: Duration = Duration::from_secs(5);
/// Clients at a time.
const CLIENTS: usize = 16;
/// Bytes that the system keeps for a client that reads slowly: some tenths of a second.
const KEPT_BYTES: u32 = 32_768;
/// Bytes of a client that are read at a time.
const READ_BYTES: usize = 4096;
/// After a failure to accept, for want of descriptors for instance.
const PAUSE: Duration = Duration::from_millis(200);

/// One frame's messages, for all clients.
type Frame = Arc<[u8]>;

/// Hands frames on to the clients.
#[derive(Debug, Clone)]
pub struct Clients {
    frames: broadcast::Sender<Frame>,
    count: Arc<AtomicUsize>,
}

impl Clients {
    /// Listens for clients, and serves them from tasks of their own. Returns the address too, whose port
    /// may have been the system's choice.
    ///
    /// # Errors
    /// Where the address cannot be used.
    pub async fn listen(at: &Listen) -> anyhow::Result<(Self, SocketAddr)> {
        let listener = bind(at).await.with_context(|| format!("listen on {at}"))?;
        let address = listener.local_addr()?;
        let (frames, _) = broadcast::channel(WAITING);
        let clients = Clients { frames, count: Arc::default() };
        tokio::spawn(clients.clone().accept(listener));
        Ok((clients, address))
    }

    /// Hands a frame on; without clients it is forgotten.
    pub fn send(&self, frame: Vec<u8>) {
        // Fails where nobody listens.
        let _ = self.frames.send(frame.into());
    }

    /// How many are connected.
    pub fn count(&self) -> usize {
        self.count.load(Ordering::Relaxed)
    }

    async fn accept(self, listener: TcpListener) {
        loop {
            match listener.accept().await {
                Ok((stream, who)) if self.count() >= CLIENTS => {
                    message(Level::WARN, &format!("{who} was turned away: {CLIENTS} clients at a time"));
                    drop(stream);
                }
                Ok((stream, who)) => {
                    self.count.fetch_add(1, Ordering::Relaxed);
                    let (frames, count) = (self.frames.subscribe(), Arc::clone(&self.count));
                    tokio::spawn(async move {
                        serve(stream, who, frames).await;
                        count.fetch_sub(1, Ordering::Relaxed);
                    });
                }
                Err(problem) => {
                    message(Level::WARN, &format!("a client could not be taken: {problem}"));
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }
}

/// Listens on the first address that can be used.
async fn bind(at: &Listen) -> io::Result<TcpListener> {
    let mut problem = io::Error::new(io::ErrorKind::AddrNotAvailable, "no such address");
    for address in lookup_host((at.host.trim_matches(['[', ']']), at.port)).await? {
        match bind_to(address) {
            Ok(listener) => return Ok(listener),
            Err(e) => problem = e,
        }
    }
    Err(problem)
}

fn bind_to(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    // Connections inherit it: who reads slowly misses frames, and does not read old ones.
    socket.set_send_buffer_size(KEPT_BYTES)?;
    socket.bind(address)?;
    socket.listen(CLIENTS as u32)
}

/// Serves one client to its end, and says how that was.
async fn serve(stream: TcpStream, who: SocketAddr, frames: broadcast::Receiver<Frame>) {
    message(Level::INFO, &format!("{who} is connected"));
    // Small messages that must not wait for others.
    let _ = stream.set_nodelay(true);
    let (read, write) = stream.into_split();
    let mut sent = Sent::default();
    let why = tokio::select! {
        why = write_frames(write, frames, &mut sent) => why,
        why = listen_to(read) => why,
    };
    let Sent { frames, missed } = sent;
    let missed = if missed > 0 { format!(", {missed} missed") } else { String::new() };
    message(Level::INFO, &format!("{who} {why}: {frames} frames sent{missed}"));
}

#[derive(Debug, Default)]
struct Sent {
    frames: u64,
    missed: u64,
}

/// Writes frames until the client is gone or does not read; returns why.
async fn write_frames(
    mut to: OwnedWriteHalf,
    mut frames: broadcast::Receiver<Frame>,
    sent: &mut Sent,
) -> String {
    loop {
        let frame = match frames.recv().await {
            Ok(frame) => frame,
            Err(RecvError::Lagged(missed)) => {
                sent.missed += missed;
                continue;
            }
            Err(RecvError::Closed) => return "is closed, the bridge ends".into(),
        };
        match timeout(PATIENCE, to.write_all(&frame)).await {
            Ok(Ok(())) => sent.frames += 1,
            Ok(Err(problem)) => return format!("is gone ({problem})"),
            Err(_) => return format!("is closed, it has read nothing for {} s", PATIENCE.as_secs()),
        }
    }
}

/// Reads what a client says, which asks for nothing here, until it is gone or says nonsense; returns why.
async fn listen_to(mut from: OwnedReadHalf) -> String {
    let (mut reader, mut bytes) = (Reader::default(), [0; READ_BYTES]);
    loop {
        match from.read(&mut bytes).await {
            Ok(0) => return "is gone".into(),
            Ok(n) => {
                if let Err(broken) = reader.take(&bytes[..n], |_| {}) {
                    return format!("is closed, it does not speak OpenIGTLink ({broken})");
                }
            }
            Err(problem) => return format!("is gone ({problem})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::runtime::Builder;

    /// Frames that together are larger than all buffers between two programs.
    const LARGE: usize = 256 << 10;
    const FRAMES: usize = 40;

    #[test]
    fn one_that_does_not_read_is_closed_and_delays_no_other() {
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        runtime.block_on(async {
            let (clients, address) = Clients::listen(&"0".parse().unwrap()).await.unwrap();
            let deaf = TcpStream::connect(address).await.unwrap();
            let mut reader = TcpStream::connect(address).await.unwrap();
            while clients.count() < 2 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            for i in 0..FRAMES {
                clients.send(vec![i as u8; LARGE]);
            }
            let mut frame = vec![0; LARGE];
            for i in 0..FRAMES {
                reader.read_exact(&mut frame).await.unwrap();
                assert_eq!([frame[0], frame[LARGE - 1]], [i as u8; 2]);
            }
            while clients.count() > 1 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            drop(deaf);
            clients.send(vec![7]);
            assert_eq!(reader.read_u8().await.unwrap(), 7, "the other is still served");
        });
    }
}
