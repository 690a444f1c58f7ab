//! Poses of another tracker for a run: connects to its server of OpenIGTLink, and to the run as its driver of poses.
//! Either may come later, go and come again.

use crate::incoming::{Incoming, Taken};
use crate::map::Map;
use anyhow::{Context, bail};
use igtl::{Message, Reader, Refused};
use ipc::clock::{now, realtime_offset_ns};
use ipc::logging::message;
use protocol::time::Nanos;
use settings::commands::bridge::BridgeArgs;
use std::collections::BTreeSet;
use std::io::Read;
use std::net::{TcpStream, ToSocketAddrs};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
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
/// So long without a transform is told, ns.
const SILENT_NS: u64 = 1_000_000_000;
/// A run is waited for in pieces of this length, ns.
const LOOK_NS: u64 = 500_000_000;
/// Kinds of trouble that are told by name; more are counted.
const TOLD: usize = 20;

/// Hands poses of another tracker on until a signal comes.
///
/// # Errors
/// Where the map is refused, or the run takes no poses from outside.
pub fn run(args: &BridgeArgs, stop: &Arc<AtomicBool>) -> anyhow::Result<ExitCode> {
    let from = args.from.as_ref().context("--from is needed")?;
    let map =
        args.map.as_deref().map(|path| Map::load(path).with_context(|| format!("--map {}", path.display())));
    let map = map.transpose()?.unwrap_or_default();
    let mut source = Source {
        address: from.to_string(),
        stream: None,
        reader: Reader::default(),
        told: BTreeSet::new(),
        counts: Counts::default(),
        is_awaited: false,
    };
    while !stop.load(Ordering::Relaxed) {
        match Driver::open(&args.instance, NAME, SENDS_POSES, LOOK_NS) {
            Ok(driver) => serve(driver, &map, &mut source, stop)?,
            Err(Failure { code: Code::NoRun, .. }) => {}
            Err(failure) => bail!("{failure}"),
        }
    }
    Ok(ExitCode::SUCCESS)
}

#[derive(Debug, Default)]
struct Counts {
    frames: u64,
    refused: u64,
}

/// The other tracker's server.
struct Source {
    address: String,
    stream: Option<TcpStream>,
    reader: Reader,
    /// What was told already.
    told: BTreeSet<String>,
    counts: Counts,
    /// It was said that nobody answers.
    is_awaited: bool,
}

/// Sends poses into one run to its end.
fn serve(mut driver: Driver, map: &Map, source: &mut Source, stop: &AtomicBool) -> anyhow::Result<()> {
    message(Level::INFO, &format!("poses for the simulator '{}'", driver.instance()));
    // Numbers rise where this program is started again: a frame takes longer than a millisecond.
    let mut incoming = Incoming::new(map.clone(), now() / 1_000_000);
    let mut heard_ns = now();
    let mut is_silent = false;
    while !stop.load(Ordering::Relaxed) {
        let mut failed = Ok(());
        let came = source.turn(&mut incoming, |frame| {
            if failed.is_ok() {
                failed = driver.send_poses(frame);
            }
        });
        let at = now();
        heard_ns = if came { at } else { heard_ns };
        let silent = at.saturating_sub(heard_ns) > SILENT_NS;
        if silent != is_silent {
            is_silent = silent;
            let words = if silent { "no transforms come" } else { "" };
            driver.tell(silent, words);
            let news = if silent { words } else { "transforms come again" };
            message(
                if silent { Level::WARN } else { Level::INFO },
                &format!("{news} from {}", source.address),
            );
        }
        match failed.and_then(|()| driver.check()) {
            Ok(()) => {}
            Err(Failure { code: Code::Stop, text }) => {
                message(Level::INFO, &format!("{text}: {} frames sent", source.counts.frames));
                break;
            }
            Err(failure) => bail!("{failure}"),
        }
    }
    Ok(())
}

impl Source {
    /// Reads what has come, waiting a little; true where a transform was of use.
    fn turn(
        &mut self,
        incoming: &mut Incoming,
        mut send: impl FnMut(&protocol::poses::TrackerFrame),
    ) -> bool {
        let Some(stream) = &mut self.stream else {
            self.connect();
            return false;
        };
        let mut bytes = [0; 16_384];
        let read = stream.read(&mut bytes);
        let at: Nanos = now();
        let n = match read {
            Ok(0) => return self.lose("has closed the connection"),
            Ok(n) => n,
            Err(e) if matches!(e.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {
                return false;
            }
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => return false,
            Err(e) => return self.lose(&format!("is gone ({e})")),
        };
        let offset_ns = realtime_offset_ns();
        let mut heard: Vec<Result<Message, Refused>> = Vec::new();
        let whole = self.reader.take(&bytes[..n], |message| heard.push(message));
        let (mut came, mut frames) = (false, 0);
        for message in heard {
            let taken = match message {
                Ok(message) => incoming.take(&message, at, offset_ns, |frame| {
                    frames += 1;
                    send(frame);
                }),
                Err(refused) => Taken::Refused(refused.to_string()),
            };
            match taken {
                Taken::Used => came = true,
                Taken::Unknown(device) => self.tell(format!("transform {device:?} is of no body in --map")),
                Taken::Refused(why) => {
                    self.counts.refused += 1;
                    self.tell(why);
                }
            }
        }
        self.counts.frames += frames;
        if let Err(broken) = whole {
            return self.lose(&format!("does not speak OpenIGTLink ({broken})"));
        }
        came
    }

    fn connect(&mut self) {
        let addresses = self.address.to_socket_addrs().map(Vec::from_iter).unwrap_or_default();
        let tried = addresses.iter().find_map(|address| TcpStream::connect_timeout(address, CONNECT).ok());
        match tried.filter(|stream| stream.set_read_timeout(Some(WAIT)).is_ok()) {
            Some(stream) => {
                let _ = stream.set_nodelay(true);
                message(Level::INFO, &format!("connected to {}", self.address));
                (self.stream, self.reader, self.is_awaited) = (Some(stream), Reader::default(), false);
            }
            None => {
                if !std::mem::replace(&mut self.is_awaited, true) {
                    message(Level::INFO, &format!("waiting for {}: nobody answers there", self.address));
                }
                std::thread::sleep(WAIT);
            }
        }
    }

    /// The connection is gone; it is tried again.
    fn lose(&mut self, why: &str) -> bool {
        message(Level::WARN, &format!("{} {why}", self.address));
        self.stream = None;
        std::thread::sleep(WAIT);
        false
    }

    /// Says something once.
    fn tell(&mut self, text: String) {
        if self.told.len() < TOLD && !self.told.contains(&text) {
            message(Level::WARN, &text);
            self.told.insert(text);
        }
    }
}
