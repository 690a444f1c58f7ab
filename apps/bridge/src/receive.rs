//! Poses of another tracker for a run: connects to its server of OpenIGTLink, and to the run as its driver of poses.
//! Either may come later, go and come again.

use crate::incoming::{Incoming, Taken};
use crate::map::Map;
use anyhow::{Context, bail};
use igtl::{Message, Reader, Refused};
use ipc::clock::{now, realtime_offset_ns};
use ipc::logging::message;
use ipc::outside;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use settings::commands::bridge::Server;
use std::collections::BTreeSet;
use std::io::{self, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;
use tracing::Level;
use vitreo::code::{Code, Failure};
use vitreo::driver::Driver;
use vitreo::roles::SENDS_POSES;

/// What the driver calls itself, and with what its source begins.
const NAME: &str = "igtl";
/// Time for a connection.
const CONNECT: Duration = Duration::from_secs(2);
/// Longest wait for bytes, and between two tries to connect.
const WAIT: Duration = Duration::from_millis(200);
/// Time without any transform after which this is reported, ns; less than the launcher's own limit.
const SILENT_NS: u64 = 400_000_000;
/// Time without the transform of one body after which this is reported, ns.
const MISSING_NS: u64 = 1_000_000_000;
/// A run is waited for in pieces of this length, ns.
const LOOK_NS: u64 = 500_000_000;
/// A run that has asked for the end takes no longer than this, ns; and the time between two looks at it.
const ENDING_NS: u64 = 10_000_000_000;
const BETWEEN: Duration = Duration::from_millis(20);
/// Failures in a row to join a run before it is given up.
const FAILURES: u32 = 20;
/// Most kinds of problems that are reported by name; further ones are left out.
const TOLD: usize = 20;

/// Hands poses of another tracker on until a signal comes.
///
/// # Errors
/// Where the map is refused, or the run takes no poses from outside.
pub fn run(instance: &str, from: &Server, map: Option<&Path>, stop: &AtomicBool) -> anyhow::Result<ExitCode> {
    let (map, mut source) = begin(from, map)?;
    let mut failures = 0;
    while !stop.load(Ordering::Relaxed) {
        match Driver::open(instance, NAME, SENDS_POSES, LOOK_NS) {
            Ok(driver) => {
                serve(driver, &map, &mut source, stop)?;
                wait_for_the_end(instance, stop)?;
            }
            Err(Failure { code: Code::NoRun, .. }) => {}
            // One that ends clears its channels away meanwhile.
            Err(Failure { code: Code::System, .. }) if failures < FAILURES => {
                failures += 1;
                std::thread::sleep(WAIT);
                continue;
            }
            Err(failure) => bail!("{failure}"),
        }
        failures = 0;
    }
    Ok(ExitCode::SUCCESS)
}

/// Waits until a run that has asked for the end is gone: until then it would be joined again.
fn wait_for_the_end(instance: &str, stop: &AtomicBool) -> anyhow::Result<()> {
    let until = now() + ENDING_NS;
    while !stop.load(Ordering::Relaxed) && now() < until && outside::invited(instance)?.is_some() {
        std::thread::sleep(BETWEEN);
    }
    Ok(())
}

/// As [`run`], as a process of the run itself: ends with it.
///
/// # Errors
/// As there, and where there is no such run.
pub fn run_within(
    instance: &str,
    from: &Server,
    map: Option<&Path>,
    stop: &AtomicBool,
) -> anyhow::Result<ExitCode> {
    let (map, mut source) = begin(from, map)?;
    match Driver::open(instance, NAME, SENDS_POSES, LOOK_NS) {
        Ok(driver) => serve(driver, &map, &mut source, stop)?,
        Err(failure) => bail!("{failure}"),
    }
    Ok(ExitCode::SUCCESS)
}

fn begin(from: &Server, map: Option<&Path>) -> anyhow::Result<(Map, Source)> {
    let map = map.map(|path| Map::load(path).with_context(|| format!("--map {}", path.display())));
    Ok((map.transpose()?.unwrap_or_default(), Source::new(from.to_string())))
}

/// The other tracker's server.
struct Source {
    address: String,
    stream: Option<TcpStream>,
    /// A connection that is being made: names may take long to be found, and hosts to answer.
    awaited: Option<mpsc::Receiver<io::Result<TcpStream>>>,
    reader: Reader,
    /// Problems that were reported already.
    reported: BTreeSet<String>,
    /// Frames that were sent.
    frames: u64,
    /// When the connection was made.
    connected_ns: Nanos,
    /// When a transform was of use last, and since when they come without a silence.
    heard_ns: Nanos,
    resumed_ns: Nanos,
}

/// Sends poses into one run to its end.
fn serve(mut driver: Driver, map: &Map, source: &mut Source, stop: &AtomicBool) -> anyhow::Result<()> {
    message(Level::INFO, &format!("poses for the simulator '{}'", driver.instance()));
    // Numbers rise where this program is started again: a frame takes longer than a millisecond.
    let begun_ns = now();
    let mut incoming = Incoming::new(map.clone(), begun_ns / 1_000_000);
    (source.heard_ns, source.resumed_ns) = (begun_ns, begun_ns);
    let mut reported = String::new();
    while !stop.load(Ordering::Relaxed) {
        let mut failed = Ok(());
        source.turn(&mut incoming, |frame| {
            if failed.is_ok() {
                failed = driver.send_poses(frame);
            }
        });
        if let Some(trouble) = source.trouble(&incoming, now()).filter(|trouble| *trouble != reported) {
            driver.tell(!trouble.is_empty(), &trouble);
            match trouble.as_str() {
                "" => message(Level::INFO, &format!("all transforms come from {}", source.address)),
                trouble => message(Level::WARN, trouble),
            }
            reported = trouble;
        }
        match failed.and_then(|()| driver.check()) {
            Ok(()) => {}
            Err(Failure { code: Code::Stop, text }) => {
                message(Level::INFO, &format!("{text}: {} frames sent", source.frames));
                break;
            }
            Err(failure) => bail!("{failure}"),
        }
    }
    Ok(())
}

impl Source {
    fn new(address: String) -> Self {
        let (reader, reported) = (Reader::default(), BTreeSet::new());
        Source {
            address,
            stream: None,
            awaited: None,
            reader,
            reported,
            frames: 0,
            connected_ns: 0,
            heard_ns: 0,
            resumed_ns: 0,
        }
    }

    /// What is wrong at an instant, in words, empty where nothing is; `None` where that will be seen soon.
    fn trouble(&self, incoming: &Incoming, at: Nanos) -> Option<String> {
        let since = |instant: Nanos| at.saturating_sub(instant);
        if since(self.heard_ns) > SILENT_NS {
            return match &self.stream {
                Some(_) if since(self.connected_ns) <= SILENT_NS => None,
                Some(_) => Some(format!("{} is connected and sends no transform of the map", self.address)),
                None => Some(format!("no answer from {}", self.address)),
            };
        }
        let missing = incoming.missing_since(at.saturating_sub(MISSING_NS));
        match missing[..] {
            [] => Some(String::new()),
            _ if since(self.resumed_ns) <= MISSING_NS => None,
            _ => Some(format!("{} does not send {}", self.address, missing.join(", "))),
        }
    }

    /// Reads what has come, waiting a little.
    fn turn(&mut self, incoming: &mut Incoming, mut send: impl FnMut(&TrackerFrame)) {
        let Some(stream) = &mut self.stream else { return self.connect() };
        let mut bytes = [0; 16_384];
        let read = stream.read(&mut bytes);
        let at: Nanos = now();
        let n = match read {
            Ok(0) => return self.lose("has closed the connection"),
            Ok(n) => n,
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                // The rest of a frame does not come any more.
                return incoming.flush(at, send);
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => return,
            Err(e) => return self.lose(&format!("is gone ({e})")),
        };
        let offset_ns = realtime_offset_ns();
        let mut heard: Vec<Result<Message, Refused>> = Vec::new();
        let whole = self.reader.take(&bytes[..n], |message| heard.push(message));
        let mut frames = 0;
        for message in heard {
            let taken = match message {
                Ok(message) => incoming.take(&message, at, offset_ns, |frame| {
                    frames += 1;
                    send(frame);
                }),
                Err(refused) => Taken::Refused(refused.to_string()),
            };
            match taken {
                Taken::Used => self.hear(at),
                Taken::Unknown(device) => {
                    self.tell(format!("transform {device:?} belongs to no body of the map"))
                }
                Taken::Refused(why) => self.tell(why),
            }
        }
        self.frames += frames;
        if let Err(broken) = whole {
            self.lose(&format!("does not speak OpenIGTLink ({broken})"));
        }
    }

    /// A transform was of use.
    fn hear(&mut self, at: Nanos) {
        if at.saturating_sub(self.heard_ns) > SILENT_NS {
            self.resumed_ns = at;
        }
        self.heard_ns = at;
    }

    /// Waits a little for the connection, which is made by a thread of its own.
    fn connect(&mut self) {
        let address = self.address.clone();
        let awaited = self.awaited.get_or_insert_with(|| {
            let (made, awaited) = mpsc::sync_channel(1);
            std::thread::spawn(move || drop(made.send(connection(&address))));
            awaited
        });
        match awaited.recv_timeout(WAIT) {
            Err(RecvTimeoutError::Timeout) => return,
            Ok(Ok(stream)) => {
                message(Level::INFO, &format!("connected to {}", self.address));
                (self.stream, self.reader, self.connected_ns) = (Some(stream), Reader::default(), now());
            }
            Ok(Err(problem)) => {
                self.tell(format!("waiting for {}: no answer ({problem})", self.address));
                std::thread::sleep(WAIT);
            }
            // The thread could not do its work.
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(WAIT),
        }
        self.awaited = None;
    }

    /// The connection is gone; it is tried again.
    fn lose(&mut self, why: &str) {
        message(Level::WARN, &format!("{} {why}", self.address));
        self.stream = None;
        std::thread::sleep(WAIT);
    }

    /// Says something once.
    fn tell(&mut self, text: String) {
        if self.reported.len() < TOLD && !self.reported.contains(&text) {
            message(Level::WARN, &text);
            self.reported.insert(text);
        }
    }
}

/// Connects to the first place of an address that answers.
fn connection(address: &str) -> io::Result<TcpStream> {
    let mut problem = io::Error::new(io::ErrorKind::AddrNotAvailable, "no such address");
    for place in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&place, CONNECT) {
            Ok(stream) => {
                stream.set_read_timeout(Some(WAIT))?;
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Err(e) => problem = e,
        }
    }
    Err(problem)
}
