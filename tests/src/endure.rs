//! Campaigns against a running simulator: processes are killed or stopped at random instants, and
//! what that costs is measured. The short form runs with the tests, the long one by `make endure`.

use crate::verified::verify;
use crate::{Observer, binaries, instance_name, json, repository, signal, vitreo};
use ipc::clock::now;
use protocol::health::{Health, Process, STATE_STARTING};
use protocol::random::Random;
use protocol::time::Nanos;
use recording::{Item, Recording};
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// How long a process may take to be back before it is given up.
const GIVEN_UP_NS: u64 = 60_000_000_000;
/// Longest run of a campaign, s; it is asked to end before.
const LONGEST_S: &str = "7200";

/// Poses and states of a campaign's recording that must verify; the first two seconds alone have as many.
const LEAST_VERIFIED: [u64; 2] = [50, 50];

/// What is done to the processes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Blow {
    /// Killed; one in five of them again while it starts, one in seven together with another.
    Kill,
    /// Stopped for up to this time, s, and continued.
    Stop(f64),
}

/// A campaign.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// What is done.
    pub blow: Blow,
    /// How often.
    pub blows: usize,
    /// Least and longest time between two, s.
    pub gap_s: [f64; 2],
    /// Where it is drawn from.
    pub seed: u64,
    /// Further arguments of `vitreo run`: the view, the scene.
    pub run: Vec<String>,
}

/// What became of it.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Blows dealt.
    pub blows: usize,
    /// Of them, to a process that was starting.
    pub while_starting: usize,
    /// Time from a death to the first heartbeat at work, ms, by process.
    pub restarts_ms: BTreeMap<&'static str, Vec<f64>>,
    /// Processes that did not come back.
    pub given_up: usize,
    /// Exit code of the run.
    pub code: Option<i32>,
    /// Why its recording does not verify, with [`LEAST_VERIFIED`] poses and states at least.
    pub unverified: Option<String>,
    /// Poses and states that were verified.
    pub verified: [u64; 2],
    /// Why not all of them could be.
    pub verdict: String,
    /// Exposures between the first and the last tracked frame, and those of them without a frame.
    pub poses: [u64; 2],
    /// The same of camera fields.
    pub fields: [u64; 2],
    /// Longest time between two pictures, ms; 0 without a picture.
    pub longest_without_picture_ms: f64,
    /// Processes and files in shared memory that were left over.
    pub left_over: Vec<String>,
    /// What the run wrote to standard error, where it ended badly.
    pub told: String,
}

impl Outcome {
    /// True if nothing was lost but time: the run ended well, its recording verifies, nothing is
    /// left over.
    pub fn survived(&self) -> bool {
        let good = |code| matches!(code, Some(0 | 3));
        good(self.code) && self.unverified.is_none() && self.left_over.is_empty() && self.given_up == 0
    }
}

/// The state of the processes of a run, by their heartbeats.
struct Watched {
    observer: Observer,
    newest: BTreeMap<u32, Health>,
    /// Blows whose process is not at work again: when, and the process that died.
    waiting: Vec<(Process, u32, Nanos)>,
    outcome: Outcome,
}

impl Watched {
    /// Takes heartbeats in for some ms.
    fn listen(&mut self, most: Duration) {
        let until = now() + most.as_nanos() as u64;
        loop {
            for beat in self.observer.heartbeats() {
                self.newest.insert(beat.process, beat);
                self.note(&beat);
            }
            if now() >= until {
                return;
            }
        }
    }

    fn note(&mut self, beat: &Health) {
        let at = now();
        let restarts = &mut self.outcome.restarts_ms;
        self.waiting.retain(|(process, died, since)| {
            let back = beat.process == *process as u32 && beat.pid != *died && beat.state != STATE_STARTING;
            if back {
                restarts.entry(process.name()).or_default().push((at - since) as f64 * 1e-6);
            }
            !back
        });
    }

    /// The process at work or starting; `None` between two.
    fn alive(&self, process: Process) -> Option<Health> {
        let newest = *self.newest.get(&(process as u32))?;
        let dead = self.waiting.iter().any(|(p, died, _)| *p == process && *died == newest.pid);
        (!dead).then_some(newest)
    }

    fn kill(&mut self, process: Process) {
        let Some(health) = self.alive(process) else { return };
        signal(health.pid, Signal::KILL);
        self.outcome.blows += 1;
        self.outcome.while_starting += usize::from(health.state == STATE_STARTING);
        // One that had not come back is waited for from now on.
        self.waiting.retain(|(p, ..)| *p != process);
        self.waiting.push((process, health.pid, now()));
    }

    fn stop(&mut self, process: Process, s: f64) {
        let Some(health) = self.alive(process) else { return };
        signal(health.pid, Signal::STOP);
        self.outcome.blows += 1;
        self.listen(Duration::from_secs_f64(s));
        signal(health.pid, Signal::CONT);
        let killed = self.newest.get(&(process as u32)).is_some_and(|h| h.pid != health.pid);
        if !killed {
            self.listen(Duration::from_millis(300));
        }
    }

    /// Waits until everything is back.
    fn recover(&mut self) {
        let until = now() + GIVEN_UP_NS;
        while !self.waiting.is_empty() && now() < until {
            self.listen(Duration::from_millis(20));
        }
        self.outcome.given_up += self.waiting.drain(..).count();
    }
}

/// Runs a campaign; the recording lies in `folder`.
pub fn run(campaign: &Campaign, folder: &Path, mut progress: impl FnMut(usize)) -> Outcome {
    let name = instance_name();
    let path = |file: &str| folder.join(format!("{file}-{}", campaign.seed)).display().to_string();
    let (record, report) = (path("run") + ".mcap", path("report") + ".json");
    let fixed = ["run", "--duration", LONGEST_S, "--instance", &name, "--max-restarts", "1000000", "--force"];
    let outputs = ["--record", &record, "--report", &report];
    let own: Vec<&str> = campaign.run.iter().map(String::as_str).collect();
    let told = folder.join(format!("told-{}.txt", campaign.seed));
    let mut child = start(&[&fixed[..], &outputs, &own].concat(), &told);
    let observer = Observer::join(&name);
    let directory = ipc::instance_directory(&name).expect("valid name");
    let token = std::fs::read_to_string(directory.join("token")).unwrap_or_default();
    let (newest, waiting, outcome) = (BTreeMap::new(), Vec::new(), Outcome::default());
    let mut watched = Watched { observer, newest, waiting, outcome };
    strike(campaign, &mut watched, &mut progress);
    watched.recover();
    watched.listen(Duration::from_secs(1));
    let Watched { mut outcome, observer, .. } = watched;
    drop(observer);
    vitreo(&["ctl", "quit", "--instance", &name]);
    outcome.code = end(&mut child);
    outcome.told = std::fs::read_to_string(&told).unwrap_or_default();
    let verified = verify(Path::new(&record));
    outcome.unverified = verified.holds(LEAST_VERIFIED).err();
    if outcome.unverified.is_none() {
        outcome.verified = [verified.poses().identical, verified.states().identical];
        outcome.verdict = verified.reasons().join("; ");
    }
    measure(Path::new(&record), &mut outcome);
    let left = shared_memory().into_iter().filter(|file| file.contains(&name) || file.contains(token.trim()));
    outcome.left_over = left.chain(processes_of(&name)).collect();
    if Path::new(&report).exists() {
        let lost = json(Path::new(&report))["states_lost"].as_u64().unwrap_or(0);
        outcome.given_up += lost as usize;
    }
    outcome
}

/// Starts `vitreo`, which writes what it has to say into a file: a pipe would have no reader that long.
fn start(args: &[&str], told: &Path) -> Child {
    let mut command = Command::new(binaries().join("vitreo"));
    command.args(args).current_dir(repository()).stdin(Stdio::null()).stdout(Stdio::null());
    command.stderr(std::fs::File::create(told).expect("a file for its messages"));
    command.spawn().expect("vitreo starts")
}

/// Waits for its end; kills it where it does not come. Its exit code.
fn end(child: &mut Child) -> Option<i32> {
    let until = now() + GIVEN_UP_NS;
    while now() < until {
        if let Ok(Some(status)) = child.try_wait() {
            return status.code();
        }
        ipc::wait(&[], 20_000_000);
    }
    let _ = child.kill();
    let _ = child.wait();
    None
}

fn strike(campaign: &Campaign, watched: &mut Watched, progress: &mut impl FnMut(usize)) {
    let mut random = Random::from_seed(campaign.seed);
    let picture = !campaign.run.iter().any(|a| a == "--no-picture");
    let pixels = !campaign.run.iter().any(|a| a == "--direct");
    let taken = |p: &Process| match p {
        Process::Renderer => picture,
        Process::FpgaModel => pixels,
        Process::Desk | Process::Controls => false,
        _ => true,
    };
    let processes: Vec<Process> = Process::ALL.into_iter().filter(taken).collect();
    let at_work = |w: &Watched| {
        processes.iter().all(|p| w.newest.get(&(*p as u32)).is_some_and(|h| h.state != STATE_STARTING))
    };
    let until = now() + GIVEN_UP_NS;
    while !at_work(watched) && now() < until {
        watched.listen(Duration::from_millis(50));
    }
    while watched.outcome.blows < campaign.blows && watched.outcome.given_up == 0 {
        let gap_s = random.between(campaign.gap_s[0], campaign.gap_s[1]);
        watched.listen(Duration::from_secs_f64(gap_s));
        let victim = random.one_of(&processes);
        match campaign.blow {
            Blow::Stop(most_s) => watched.stop(victim, random.between(0.1, most_s)),
            Blow::Kill => {
                watched.kill(victim);
                if random.once_in(7) {
                    watched.kill(random.one_of(&processes));
                }
                if random.once_in(5) {
                    again_while_it_starts(watched, victim);
                }
            }
        }
        progress(watched.outcome.blows);
        let late = watched.waiting.iter().filter(|(.., since)| now() - since > GIVEN_UP_NS).count();
        watched.outcome.given_up += late;
    }
}

/// Kills a process again as soon as its successor gives its first sign of life.
fn again_while_it_starts(watched: &mut Watched, process: Process) {
    let Some(&(_, died, _)) = watched.waiting.iter().find(|(p, ..)| *p == process) else { return };
    let until = now() + 2_000_000_000;
    let reborn = |w: &Watched| w.newest.get(&(process as u32)).is_some_and(|h| h.pid != died);
    while !reborn(watched) && now() < until {
        watched.listen(Duration::from_millis(1));
    }
    watched.kill(process);
}

/// What the recording holds, and lacks.
fn measure(record: &Path, outcome: &mut Outcome) {
    let Ok(recording) = Recording::open(record) else { return };
    let (mut exposed, mut cameras, mut shown) = (BTreeSet::new(), BTreeMap::new(), Vec::new());
    for (_, item) in recording.items_of(&["poses", "blobs", "frames"]).flatten() {
        match item {
            Item::Poses(frame) => {
                exposed.insert(frame.field);
            }
            Item::Blobs(field) => {
                cameras.entry(field.camera).or_insert_with(BTreeSet::new).insert(field.field);
            }
            Item::Frame(frame) => shown.push(frame.displayed),
            _ => {}
        }
    }
    outcome.poses = lacking(&exposed);
    let sum = |a: [u64; 2], b: [u64; 2]| [a[0] + b[0], a[1] + b[1]];
    outcome.fields = cameras.values().map(lacking).fold([0; 2], sum);
    shown.sort_unstable();
    let gaps = shown.windows(2).map(|w| (w[1] - w[0]) as f64 * 1e-6);
    outcome.longest_without_picture_ms = gaps.fold(0.0, f64::max);
}

/// Numbers from the first to the last, and how many of them are not there.
fn lacking(fields: &BTreeSet<u64>) -> [u64; 2] {
    match (fields.first(), fields.last()) {
        (Some(first), Some(last)) => [last - first + 1, last - first + 1 - fields.len() as u64],
        _ => [0, 0],
    }
}

/// Names of everything in shared memory.
fn shared_memory() -> BTreeSet<String> {
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
    entries.map(|e| e.file_name().to_string_lossy().into_owned()).collect()
}

/// Processes of an instance that still run.
fn processes_of(name: &str) -> Vec<String> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let lines = entries.filter_map(|e| std::fs::read(e.path().join("cmdline")).ok());
    let named = |line: &Vec<u8>| line.split(|b| *b == 0).any(|word| word == name.as_bytes());
    lines.filter(named).map(|line| String::from_utf8_lossy(&line).replace('\0', " ")).collect()
}
