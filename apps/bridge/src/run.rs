//! Waits for a simulator, reads what it does and hands it on, until a signal comes.
//!
//! One thread reads the channels and writes to the clients of OpenIGTLink, and sleeps in between; only viewers have
//! a second one.

use crate::clients::Clients;
use crate::receive;
use crate::transforms::Writer;
use crate::viewers::Viewers;
use anyhow::Context;
use ipc::clock::{now, realtime_offset_ns};
use ipc::logging::message;
use ipc::outside::{self, Host};
use ipc::shell::ShellArgs;
use ipc::{Instance, Queue, Receiver, Wakes, wait_beside};
use outputs::exit::INTERRUPTED;
use protocol::events::Event;
use protocol::health::Health;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::Item;
use settings::commands::bridge::{BridgeArgs, Server};
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tracing::Level;

/// Longest wait, and how often it is looked whether there is a simulator, ns.
const WAIT_NS: u64 = 200_000_000;
/// While clients want nothing they are attended to this often, ns: to close those that do not read.
const ATTEND_NS: u64 = 1_000_000_000;
/// While frames come, the simulator's files are checked this often, ns: frames of a program that outlived it may come.
const CHECK_NS: u64 = 2_000_000_000;
/// Period of readings of the wall clock, ns.
const CLOCK_NS: u64 = 1_000_000_000;

/// Runs the bridge until a signal comes.
///
/// # Errors
/// Where an address cannot be used, or a channel fails.
pub fn run(args: &BridgeArgs) -> anyhow::Result<ExitCode> {
    let stop = stop_signal()?;
    // Refuses a name that is none before anything is opened.
    outside::invited(&args.instance)?;
    if let Some(from) = &args.from {
        return receive::run(&args.instance, from, args.map.as_deref(), &stop);
    }
    let clients = args.igtl.as_ref().map(|at| Clients::listen(at).context("--igtl")).transpose()?;
    let viewers = args.foxglove.as_ref();
    let viewers = viewers.map(|at| Viewers::listen(at, &args.instance).context("--foxglove")).transpose()?;
    if let Some((_, address)) = &clients {
        message(Level::INFO, &format!("OpenIGTLink on {address}"));
    }
    if let Some((_, address)) = &viewers {
        message(Level::INFO, &format!("Foxglove on ws://{address}"));
    }
    let mut bridge = Bridge {
        clients: clients.map(|(clients, _)| clients),
        viewers: viewers.map(|(viewers, _)| viewers),
        writer: Writer::new(args.igtl_version),
        bytes: Vec::new(),
        clock: (realtime_offset_ns(), now()),
        attended_ns: 0,
        is_waiting: false,
        stop,
    };
    while bridge.goes_on() {
        match find(&args.instance)? {
            Some(instance) => bridge.serve(&instance)?,
            None => bridge.rest(&args.instance),
        }
    }
    bridge.end();
    Ok(ExitCode::SUCCESS)
}

/// Takes the poses of another tracker into a run, as a process of it, until the run or a signal asks it to end.
///
/// # Errors
/// Where the map is refused, or there is no such run.
pub fn within(shell: &ShellArgs, from: &Server, map: Option<&Path>) -> anyhow::Result<ExitCode> {
    let stop = stop_signal()?;
    if shell.supervised {
        ipc::shell::end_with_parent();
    }
    receive::run_within(&shell.instance, from, map, &stop)
}

/// Raised by a signal that asks this program to end.
fn stop_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    ipc::signals::listen(INTERRUPTED, move || asked.store(true, Ordering::Relaxed)).context("signals")?;
    Ok(stop)
}

/// Joins the simulator where it runs.
fn find(name: &str) -> anyhow::Result<Option<Instance>> {
    Ok(match outside::invited(name)? {
        Some(_) => Some(Instance::join(name)?),
        None => None,
    })
}

struct Bridge {
    clients: Option<Clients>,
    viewers: Option<Viewers>,
    writer: Writer,
    /// The messages of a frame.
    bytes: Vec<u8>,
    /// Time since 1970 less the instant, ns, and when that was looked at.
    clock: (u64, Nanos),
    /// When it was last looked for what clients want.
    attended_ns: Nanos,
    /// It was said that no simulator runs.
    is_waiting: bool,
    stop: Arc<AtomicBool>,
}

/// What viewers are shown besides poses.
struct Seen {
    events: Receiver<Event>,
    health: Receiver<Health>,
}

impl Bridge {
    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }

    /// Reports once that no simulator runs, and waits a little.
    fn rest(&mut self, name: &str) {
        if !std::mem::replace(&mut self.is_waiting, true) {
            message(Level::INFO, &format!("waiting for the simulator '{name}'"));
        }
        // Until the next look clients come and go.
        let until = now() + WAIT_NS;
        while self.goes_on() && now() < until {
            let is_wanted = self.wait(&[], until.saturating_sub(now()));
            self.attend(is_wanted);
        }
    }

    /// Waits for messages, and for what clients want: true where one wants something.
    fn wait(&self, sources: &[&dyn Wakes], timeout_ns: u64) -> bool {
        let wants = self.clients.as_ref().map(Clients::wants);
        let files: &[BorrowedFd<'_>] = wants.as_slice();
        wait_beside(sources, files, timeout_ns)
    }

    /// Does what clients want, where one wants something, or now and then.
    fn attend(&mut self, is_wanted: bool) {
        let Some(clients) = &mut self.clients else { return };
        let at = now();
        if is_wanted || at >= self.attended_ns + ATTEND_NS {
            self.attended_ns = at;
            clients.serve(at);
        }
    }

    /// What is added to an instant to get the time since 1970, ns.
    fn offset_ns(&mut self) -> u64 {
        let at = now();
        if at >= self.clock.1 + CLOCK_NS {
            self.clock = (realtime_offset_ns(), at);
        }
        self.clock.0
    }

    /// Hands what a simulator does on, to its end.
    fn serve(&mut self, instance: &Instance) -> anyhow::Result<()> {
        self.is_waiting = false;
        let host = Host::of(instance);
        let mut poses: Receiver<TrackerFrame> = instance.receiver(Queue::InOrder)?;
        let mut seen = match &self.viewers {
            Some(_) => Some(Seen {
                events: instance.receiver(Queue::InOrder)?,
                health: instance.receiver(Queue::InOrder)?,
            }),
            None => None,
        };
        let news = format!("poses of the simulator '{}'", instance.name());
        self.tell(news);
        let (mut checked_ns, mut came) = (0, false);
        while self.goes_on() {
            // Asks the file system, which costs more than a frame.
            if now() > checked_ns + if came { CHECK_NS } else { WAIT_NS } {
                if !host.is_there() {
                    break;
                }
                checked_ns = now();
            }
            let is_wanted = match &seen {
                Some(seen) => self.wait(&[&poses, &seen.events, &seen.health], WAIT_NS),
                None => self.wait(&[&poses], WAIT_NS),
            };
            came = false;
            while let Some(frame) = poses.next_sample()? {
                self.hand_on(&frame)?;
                came = true;
            }
            self.attend(is_wanted);
            seen.as_mut().map_or(Ok(()), |seen| self.show(seen))?;
        }
        let counts = poses.counts();
        self.tell(format!("{} frames forwarded, {} lost", counts.received, counts.lost));
        self.say_that_it_ended()
    }

    fn hand_on(&mut self, frame: &TrackerFrame) -> anyhow::Result<()> {
        let (at, offset_ns) = (now(), self.offset_ns());
        if let Some(clients) = self.clients.as_mut().filter(|clients| clients.count() > 0) {
            self.bytes.clear();
            self.writer.frame(frame, offset_ns, &mut self.bytes)?;
            clients.send(&self.bytes, at);
        }
        if let Some(viewers) = &self.viewers {
            viewers.show(&Item::Poses(Box::new(*frame)), at, offset_ns);
        }
        Ok(())
    }

    /// Shows viewers what they see besides poses.
    fn show(&mut self, seen: &mut Seen) -> anyhow::Result<()> {
        let (at, offset_ns) = (now(), self.offset_ns());
        let Some(viewers) = &self.viewers else { return Ok(()) };
        while let Some(event) = seen.events.next_valid()? {
            viewers.show(&Item::Event(event), at, offset_ns);
        }
        while let Some(beat) = seen.health.next_valid()? {
            viewers.show_health(&beat, offset_ns);
        }
        Ok(())
    }

    fn say_that_it_ended(&mut self) -> anyhow::Result<()> {
        self.bytes.clear();
        let at = now();
        self.writer.ended(at.wrapping_add(realtime_offset_ns()), &mut self.bytes)?;
        if let Some(clients) = &mut self.clients {
            clients.send(&self.bytes, at);
        }
        Ok(())
    }

    /// Says something here and to viewers.
    fn tell(&mut self, text: String) {
        message(Level::INFO, &text);
        let offset_ns = self.offset_ns();
        self.viewers.iter().for_each(|viewers| viewers.tell(text.clone(), now(), offset_ns));
    }

    fn end(mut self) {
        self.clients.iter_mut().for_each(Clients::end);
        self.viewers.iter_mut().for_each(Viewers::end);
    }
}
