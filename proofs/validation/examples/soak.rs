//! Random tool programmes over random scenes, every step checked, every programme run twice:
//! `make soak`, or `cargo run --release -p validation --example soak -- --help`.

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use ipc::clock::now;
use protocol::handles::Tool;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use validation::soak::{Failure, Outcome, TOOLS, run};

/// Between two lines where no bar can be drawn.
const EVERY: Duration = Duration::from_secs(30);

/// Random tool programmes over random scenes.
#[derive(Parser)]
struct Args {
    /// Programmes.
    #[arg(long, default_value_t = 1000)]
    programmes: u64,
    /// Simulated time of each, s.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Seed of the first programme; the others follow.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Programmes at the same time; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
}

/// How far it is, for people and for logs.
struct Progress {
    bar: ProgressBar,
    terminal: bool,
    begin: Instant,
    printed: Instant,
    all: u64,
}

impl Progress {
    fn new(all: u64) -> Self {
        let style = "{bar:40} {pos}/{len} {elapsed} + {eta}";
        let style = ProgressStyle::with_template(style).expect("a template");
        let now = Instant::now();
        let terminal = std::io::stderr().is_terminal();
        Progress { bar: ProgressBar::new(all).with_style(style), terminal, begin: now, printed: now, all }
    }

    /// After `done` programmes, of which `failed` failed.
    fn print(&mut self, done: u64, failed: usize) {
        self.bar.set_position(done);
        if self.terminal || (self.printed.elapsed() < EVERY && done < self.all) {
            return;
        }
        self.printed = Instant::now();
        let passed = self.begin.elapsed().as_secs_f64();
        let left = passed / done.max(1) as f64 * (self.all - done) as f64;
        let (share, rate) = (100.0 * done as f64 / self.all.max(1) as f64, done as f64 * 60.0 / passed);
        eprintln!(
            "{done} of {} ({share:.1} %), {rate:.1} a minute, {:.0} min passed, {:.0} min left, {failed} failed",
            self.all,
            passed / 60.0,
            left / 60.0
        );
    }
}

/// What came of all programmes.
#[derive(Default)]
struct Results {
    done: Vec<(u64, Outcome)>,
    failed: Vec<Failure>,
}

fn main() -> std::process::ExitCode {
    let args = Args::parse();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let (next, results) = (AtomicU64::new(0), Mutex::new(Results::default()));
    let progress = Mutex::new(Progress::new(args.programmes));
    println!("seeds {} to {}", args.seed, args.seed + args.programmes.saturating_sub(1));
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= args.programmes {
                break;
            }
            let seed = args.seed + number;
            let outcome = run(seed, args.seconds, &mut now);
            let mut results = results.lock().expect("no thread panics with it");
            match outcome {
                Ok(outcome) => results.done.push((seed, outcome)),
                Err(failure) => {
                    let bar = &progress.lock().expect("no thread panics with it").bar;
                    bar.suspend(|| println!("{failure}\n{}", again(&failure, args.seconds)));
                    results.failed.push(failure);
                }
            }
            let (done, failed) = (results.done.len() + results.failed.len(), results.failed.len());
            progress.lock().expect("no thread panics with it").print(done as u64, failed);
        }
    };
    std::thread::scope(|scope| (0..args.threads.unwrap_or(cores).max(1)).for_each(|_| _ = scope.spawn(work)));
    progress.into_inner().expect("no thread panicked").bar.finish_and_clear();
    let mut results = results.into_inner().expect("no thread panicked");
    results.failed.sort_by_key(|f| f.seed);
    print_tables(&results, args.seconds);
    std::process::ExitCode::from(u8::from(!results.failed.is_empty()))
}

fn again(failure: &Failure, seconds: f64) -> String {
    format!("  again: make soak SOAK=\"--seed {} --programmes 1 --seconds {seconds}\"", failure.seed)
}

fn print_tables(results: &Results, seconds: f64) {
    let mut scenes: BTreeMap<&str, Vec<&(u64, Outcome)>> = BTreeMap::new();
    for entry in &results.done {
        scenes.entry(&entry.1.scene).or_default().push(entry);
    }
    println!("programmes     steps     quiet    events  energy    longest step (seed)  scene");
    for (scene, entries) in &scenes {
        let sum = |of: fn(&Outcome) -> u64| entries.iter().map(|e| of(&e.1)).sum::<u64>();
        let energy = entries.iter().map(|e| e.1.lasting_energy).fold(0.0, f64::max);
        let slowest = entries.iter().map(|e| (e.1.slowest.0, e.0)).max().unwrap_or_default();
        let (ms, seed) = (slowest.0 as f64 * 1e-6, slowest.1);
        let (steps, quiet, events) = (sum(|o| o.steps), sum(|o| o.quiet_steps), sum(|o| o.events));
        let count = entries.len();
        println!(
            "{count:>10} {steps:>9} {quiet:>9} {events:>9} {:>6.3} % {ms:>10.2} ms ({seed:>5})  {scene}",
            100.0 * energy
        );
    }
    println!(
        "quiet: steps in which no tool touched tissue; energy: largest that lasted in them, as a share of what the limits of speed allow"
    );
    let tools = (0..TOOLS).filter_map(|t| Tool::from_wire(t as u32).map(|tool| (t, tool)));
    let steps = |t: usize| results.done.iter().map(|e| e.1.tool_steps[t]).sum::<u64>();
    let tools: Vec<String> = tools.map(|(t, tool)| format!("{tool:?} {}", steps(t))).collect();
    println!("steps of a hand with each tool: {}", tools.join(", "));
    for failure in &results.failed {
        println!("FAILED {failure}\n{}", again(failure, seconds));
    }
    let (steps, events) = results.done.iter().fold((0, 0), |(s, e), (_, o)| (s + o.steps, e + o.events));
    println!(
        "{} programmes of {seconds} s, {steps} steps (each done twice), {events} events, {} failed",
        results.done.len() + results.failed.len(),
        results.failed.len()
    );
}
