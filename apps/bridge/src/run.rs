//! Waits for a simulator, reads its poses and hands them on, until a signal comes.

use crate::clients::Clients;
use crate::receive;
use crate::transforms::Writer;
use anyhow::Context;
use ipc::clock::{now, realtime_offset_ns};
use ipc::logging::message;
use ipc::outside::{self, Host};
use ipc::{Instance, Queue, Receiver, wait};
use outputs::exit::INTERRUPTED;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use settings::commands::bridge::BridgeArgs;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::runtime::Builder;
use tracing::Level;

/// Period of looking for a simulator.
const LOOK: Duration = Duration::from_millis(200);
/// Longest wait for poses, and how often it is looked whether the simulator is still there, ns.
const WAIT_NS: u64 = 200_000_000;
/// The wall clock is looked at again after so long, ns.
const CLOCK_NS: u64 = 1_000_000_000;

/// Runs the bridge until a signal comes.
///
/// # Errors
/// Where an address cannot be used, or a channel fails.
pub fn run(args: &BridgeArgs) -> anyhow::Result<ExitCode> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    ipc::signals::listen(INTERRUPTED, move || asked.store(true, Ordering::Relaxed)).context("signals")?;
    // Refuses a name that is none before anything is opened.
    outside::invited(&args.instance)?;
    if args.from.is_some() {
        return receive::run(args, &stop);
    }
    // Sockets are served by one thread; this one keeps the channel's port, which may not change threads.
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let at = args.igtl.as_ref().context("--igtl is needed")?;
    let (clients, address) = runtime.block_on(Clients::listen(at)).context("--igtl")?;
    message(Level::INFO, &format!("OpenIGTLink on {address}"));
    let mut bridge = Bridge {
        clients,
        writer: Writer::new(args.igtl_version),
        clock: (realtime_offset_ns(), now()),
        is_waiting: false,
        stop,
    };
    while bridge.goes_on() {
        match find(&args.instance)? {
            Some(instance) => bridge.serve(&instance)?,
            None => bridge.rest(&args.instance),
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Joins the simulator where it runs.
fn find(name: &str) -> anyhow::Result<Option<Instance>> {
    Ok(match outside::invited(name)? {
        Some(_) => Some(Instance::join(name)?),
        None => None,
    })
}

struct Bridge {
    clients: Clients,
    writer: Writer,
    /// Time since 1970 less the instant, ns, and when that was looked at.
    clock: (u64, Nanos),
    /// It was said that no simulator runs.
    is_waiting: bool,
    stop: Arc<AtomicBool>,
}

impl Bridge {
    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }

    /// Says once that nobody is there, and waits a little.
    fn rest(&mut self, name: &str) {
        if !std::mem::replace(&mut self.is_waiting, true) {
            message(Level::INFO, &format!("waiting for the simulator '{name}'"));
        }
        std::thread::sleep(LOOK);
    }

    /// What is added to an instant to get the time since 1970, ns.
    fn offset_ns(&mut self) -> u64 {
        let at = now();
        if at >= self.clock.1 + CLOCK_NS {
            self.clock = (realtime_offset_ns(), at);
        }
        self.clock.0
    }

    /// Hands the poses of a simulator on to its end.
    fn serve(&mut self, instance: &Instance) -> anyhow::Result<()> {
        self.is_waiting = false;
        let host = Host::of(instance);
        let mut poses: Receiver<TrackerFrame> = instance.receiver(Queue::InOrder)?;
        message(Level::INFO, &format!("poses of the simulator '{}'", instance.name()));
        let mut looked_ns = 0;
        while self.goes_on() {
            // Asks the file system, which costs more than a frame.
            if now() > looked_ns + WAIT_NS {
                if !host.is_there() {
                    break;
                }
                looked_ns = now();
            }
            wait(&[&poses], WAIT_NS);
            while let Some(frame) = poses.next_valid()? {
                let offset_ns = self.offset_ns();
                self.clients.send(self.writer.frame(&frame, offset_ns)?);
            }
        }
        let counts = poses.counts();
        let text = format!("{} frames handed on, {} lost", counts.received, counts.lost);
        message(Level::INFO, &text);
        self.clients.send(self.writer.ended(now().wrapping_add(realtime_offset_ns()))?);
        Ok(())
    }
}
