//! The heart of a driver: a thread that sends the launcher heartbeats and receives its commands.
//!
//! It joins the run by itself, so that a driver that waits for its hardware lives on, and so that nothing of the
//! transport is shared between threads.

use ipc::clock::now;
use ipc::outside::Host;
use ipc::{Instance, IpcError, Queue, Receiver, Sender, wait};
use protocol::control::{Answer, Command, Request};
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_RUNNING, STATE_STARTING};
use protocol::limits::HEARTBEAT_NS;
use protocol::message::text_bytes;
use protocol::time::Nanos;
use std::sync::mpsc::{self, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Time between two looks whether the run is still there, ns.
const LOOK_NS: u64 = 500_000_000;
/// Said of a run that ends in order.
const ASKED: &str = "the run asks this program to end";

/// What the heart reports about the driver, and what it has received for it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pulse {
    /// One of `STATE_…`.
    pub state: u32,
    /// The driver's name, and what it says of itself.
    pub text: String,
    /// Blocks sent, by place in the driver's processes.
    pub sent: [u64; 5],
    /// Blocks refused before they were sent, and why the newest one was, by the same place.
    pub refused: [u64; 5],
    pub refusal: [Option<String>; 5],
    /// Blocks read, lost and refused.
    pub read: [u64; 3],
    /// Why the driver has to stop, once it has.
    pub stop: Option<&'static str>,
    /// The driver was closed.
    closed: bool,
}

impl Pulse {
    /// State and words of one of the driver's processes: what it says itself, or that its blocks are refused.
    fn said(&self, place: usize) -> (u32, String) {
        match &self.refusal[place] {
            Some(why) if self.state == STATE_RUNNING => (STATE_DEGRADED, format!("{}: {why}", self.text)),
            _ => (self.state, self.text.clone()),
        }
    }
}

/// The heart of one driver.
pub(crate) struct Heart {
    pulse: Arc<Mutex<Pulse>>,
    thread: Option<JoinHandle<()>>,
}

fn lock(pulse: &Mutex<Pulse>) -> MutexGuard<'_, Pulse> {
    pulse.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Heart {
    /// Joins the run `name` as these processes; returns once the first heartbeat is out.
    pub(crate) fn start(name: &str, processes: &[Process], text: String) -> Result<Self, IpcError> {
        let state = if processes.is_empty() { STATE_STARTING } else { STATE_RUNNING };
        let pulse = Arc::new(Mutex::new(Pulse { state, text, ..Pulse::default() }));
        let (started, begun) = mpsc::sync_channel(1);
        let (name, processes, shared) = (name.to_owned(), processes.to_vec(), Arc::clone(&pulse));
        let beat = move || beat(&name, &processes, &shared, &started);
        let thread = std::thread::Builder::new().name("vitreo-heart".into()).spawn(beat);
        let failed = |problem: String| IpcError::Transport { channel: "health", operation: "start", problem };
        let thread = thread.map_err(|e| failed(e.to_string()))?;
        begun.recv().map_err(|_| failed("its thread has ended".into()))??;
        Ok(Heart { pulse, thread: Some(thread) })
    }

    /// Why the driver has to stop, if it has.
    pub(crate) fn stop(&self) -> Option<&'static str> {
        lock(&self.pulse).stop
    }

    /// Changes the reported state.
    pub(crate) fn tell(&self, change: impl FnOnce(&mut Pulse)) {
        change(&mut lock(&self.pulse));
    }
}

impl Drop for Heart {
    fn drop(&mut self) {
        self.tell(|pulse| pulse.closed = true);
        if let Some(thread) = self.thread.take() {
            // It ends within a heartbeat; a panic in it has been logged.
            let _ = thread.join();
        }
    }
}

/// The thread, from its start to the driver's end.
fn beat(name: &str, processes: &[Process], pulse: &Mutex<Pulse>, started: &SyncSender<Result<(), IpcError>>) {
    let mut beating = match Beating::join(name, processes) {
        Ok(beating) => beating,
        Err(error) => return drop(started.send(Err(error))),
    };
    // The first beat may fail as any other: the driver then has to stop.
    let mut first = Some(started);
    loop {
        let ended = beating.turn(pulse);
        if let Some(started) = first.take() {
            drop(started.send(Ok(())));
        }
        let why = match ended {
            Ok(why) => why,
            Err(_) => Some("the channels of the run have failed"),
        };
        let mut pulse = lock(pulse);
        if let Some(why) = why {
            pulse.stop.get_or_insert(why);
        }
        // Who was asked to end lives until it does.
        if pulse.closed || why.is_some_and(|why| why != ASKED) {
            return;
        }
        drop(pulse);
        wait(&[&beating.requests], HEARTBEAT_NS / 4);
    }
}

/// The heart's own ties to the run.
struct Beating {
    processes: Vec<Process>,
    health: Sender<Health>,
    requests: Receiver<Request>,
    answers: Sender<Answer>,
    host: Host,
    due_ns: Nanos,
    look_ns: Nanos,
    state: u32,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl Beating {
    fn join(name: &str, processes: &[Process]) -> Result<Self, IpcError> {
        let instance = Instance::join(name)?;
        instance.clean_up_after_the_dead();
        Ok(Beating {
            processes: processes.to_vec(),
            health: instance.sender()?,
            requests: instance.receiver(Queue::InOrder)?,
            answers: instance.sender()?,
            host: Host::of(&instance),
            due_ns: 0,
            look_ns: 0,
            state: u32::MAX,
            _instance: instance,
        })
    }

    /// Beats where it is due, and serves requests. Returns why the driver has to stop, if it has.
    fn turn(&mut self, pulse: &Mutex<Pulse>) -> Result<Option<&'static str>, IpcError> {
        let at = now();
        let reported = lock(pulse).clone();
        if at >= self.due_ns || reported.state != self.state {
            (self.due_ns, self.state) = (at + HEARTBEAT_NS, reported.state);
            self.beat(&reported, at)?;
        }
        if at >= self.look_ns {
            self.look_ns = at + LOOK_NS;
            if !self.host.is_there() {
                return Ok(Some("the run has ended"));
            }
        }
        while let Some(request) = self.requests.next_valid()? {
            if self.serve(&request)? {
                return Ok(Some(ASKED));
            }
        }
        Ok(None)
    }

    fn beat(&mut self, reported: &Pulse, at: Nanos) -> Result<(), IpcError> {
        for (place, process) in self.processes.iter().enumerate() {
            let mut health: Health = bytemuck::Zeroable::zeroed();
            let [received, lost, refused] = reported.read;
            (health.instant_ns, health.process, health.pid) = (at, *process as u32, std::process::id());
            let (state, text) = reported.said(place);
            (health.state, health.sent) = (state, reported.sent[place]);
            (health.received, health.lost) = (received, lost);
            health.refused = refused + reported.refused[place];
            health.cpu_ns = if place == 0 { ipc::clock::cpu_ns() } else { 0 };
            health.text = text_bytes(&text);
            self.health.send(&health)?;
        }
        Ok(())
    }

    /// Answers a request; true where it asks for the end. Hardware sees what there is: pauses and the like are taken
    /// note of, and ask nothing of it.
    fn serve(&mut self, request: &Request) -> Result<bool, IpcError> {
        let mut ends = false;
        for process in self.processes.clone() {
            if request.is_for(process) {
                let (seq, process) = (request.seq, process as u32);
                self.answers.send(&Answer { seq, process, result: 0, text: text_bytes("") })?;
                ends |= request.command == Command::Shutdown as u32;
            }
        }
        // Who only reads is none of the run's processes, and ends with it.
        Ok(ends)
    }
}
