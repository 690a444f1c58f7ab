//! What a trace (`vitreo run --trace-out`) costs a frame of the tracker and a step of the simulation:
//! `cargo bench -p validation --bench trace [-- --json]`.
//!
//! Two trackers, and two worlds, get the same inputs; one of each pair is traced as its process traces it, and
//! which one comes first alternates. Of each input the least of several runs counts, so that other programs
//! do not; printed are the medians over all inputs, and the median of the difference of one input. What the other
//! three processes trace is a handful of spans a field, each as dear as the one span that is measured last.

use ipc::clock::now;
use ipc::trace::{About, Trace, TraceArgs};
use protocol::blobs::BlobField;
use protocol::health::Process;
use protocol::phases::{Phase, Unmarked};
use protocol::poses::TrackerFrame;
use protocol::steps::StepInputs;
use rig::Rig;
use scene::SceneFile;
use serde_json::json;
use simcore::world::World;
use std::hint::black_box;
use std::path::Path;
use surgeon::rehearsal::Rehearsal;
use tracker::assembler::FrameAssembler;
use tracker::{Reference, Tracker};
use validation::streams::{Recipe, Scenario};

/// Runs, of which the least time of each input counts.
const RUNS: usize = 5;
/// Fields of the simulation: twelve seconds.
const FIELDS: u64 = 600;
/// The first inputs, which fill caches and find the bodies.
const START: usize = 10;
/// What is simulated.
const SCENES: [&str; 3] = ["peel", "vitrectomy", "bodies"];
/// Room of the ring; it wraps, as in a long run.
const SPANS: u32 = 20_000;

/// What is measured, without and with a trace.
trait Subject {
    /// Does input `i` in the same way as its process; `traced` or not.
    fn turn(&mut self, i: usize, traced: bool);

    /// Spans of the trace so far.
    fn spans(&self) -> u64;
}

/// Times of each input, ns.
struct Times {
    off: Vec<u64>,
    on: Vec<u64>,
    spans_a_turn: f64,
}

fn trace(process: Process) -> Trace {
    Trace::start(process, TraceArgs { trace_spans: Some(SPANS) }, Path::new("/nowhere"))
}

fn recorded(trace: &Trace) -> u64 {
    trace.part().map_or(0, |part| part.recorded)
}

fn measure<S: Subject>(inputs: usize, make: impl Fn() -> S) -> Times {
    let mut least = vec![[u64::MAX; 2]; inputs];
    let mut spans = 0;
    for run in 0..RUNS {
        let mut pair = [make(), make()];
        for (i, least) in least.iter_mut().enumerate() {
            for which in [run + i, run + i + 1].map(|n| n % 2) {
                let begun = now();
                pair[which].turn(i, which == 1);
                least[which] = least[which].min(now() - begun);
            }
        }
        spans = pair[1].spans();
    }
    let [off, on] = [0, 1].map(|which| least[START..].iter().map(|times| times[which]).collect());
    Times { off, on, spans_a_turn: spans as f64 / inputs as f64 }
}

/// The frames of a tracker.
struct Frames<'a> {
    frames: &'a [(Vec<BlobField>, Reference)],
    tracker: Tracker,
    frame: TrackerFrame,
    trace: Trace,
}

impl Subject for Frames<'_> {
    fn turn(&mut self, i: usize, traced: bool) {
        let frames = self.frames;
        let (used, reference) = &frames[i];
        let about = About::field(reference.field);
        if !traced {
            self.tracker.track_into(&mut self.frame, used, reference, &mut Unmarked);
            black_box(&self.frame);
            self.tracker.follow_up(used);
            return;
        }
        // A field of each camera, the frame, and its sending.
        for field in used {
            self.note(Phase::Assemble, About::camera(field.field, field.camera));
        }
        let begun = self.trace.begin();
        let mut laps = self.trace.laps(about).expect("it traces");
        self.tracker.track_into(&mut self.frame, used, reference, &mut laps);
        black_box(&self.frame);
        self.note(Phase::SendPoses, about);
        self.trace.end(Phase::Track, about, begun);
        let begun = self.trace.begin();
        self.tracker.follow_up(used);
        self.trace.end(Phase::FollowUp, about, begun);
    }

    fn spans(&self) -> u64 {
        recorded(&self.trace)
    }
}

impl Frames<'_> {
    fn note(&mut self, phase: Phase, about: About) {
        let begun = self.trace.begin();
        self.trace.end(phase, about, begun);
    }
}

/// The steps of a simulation.
struct Steps<'a> {
    inputs: &'a [StepInputs],
    world: World,
    trace: Trace,
}

impl Subject for Steps<'_> {
    fn turn(&mut self, i: usize, traced: bool) {
        let inputs = self.inputs;
        let (input, about) = (inputs[i].input(), About::field(i as u64));
        // A process has a clock for its profile, traced or not.
        if !traced {
            black_box(self.world.step(&input, &mut now));
            return;
        }
        let taken = self.trace.begin();
        self.trace.end(Phase::Inputs, about, taken);
        let mut laps = self.trace.laps(about).expect("it traces");
        black_box(self.world.step_in_phases(&input, &mut laps));
        self.trace.note(Phase::Scene, about, [taken, taken]);
        self.trace.end(Phase::SendStep, about, taken);
        self.trace.end(Phase::Step, about, taken);
    }

    fn spans(&self) -> u64 {
        recorded(&self.trace)
    }
}

fn frames() -> Times {
    let recipe =
        Recipe { scenario: Scenario::Nominal, seed: 5, seconds: FIELDS as f64 / 50.0, knocks: Vec::new() };
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let stream = recipe.draw(&rig);
    let (mut assembler, mut frames) = (FrameAssembler::new(&rig), Vec::new());
    for field in &stream.fields {
        assembler
            .add(field, field.blobs_out_ns, |used, closed| frames.push((used.to_vec(), closed.reference)));
    }
    let make = || Frames {
        frames: &frames,
        tracker: Tracker::new(&rig),
        frame: bytemuck::Zeroable::zeroed(),
        trace: trace(Process::Tracker),
    };
    measure(frames.len(), make)
}

fn steps(scene: &str) -> Times {
    let scene = SceneFile::load(scene).expect("a shipped scene");
    let rehearsal = Rehearsal::shipped(&scene);
    let inputs: Vec<StepInputs> = (0..FIELDS).map(|field| rehearsal.inputs(field)).collect();
    let world = || World::new(&scene).expect("a shipped scene");
    measure(inputs.len(), || Steps { inputs: &inputs, world: world(), trace: trace(Process::Simcore) })
}

/// One span with the reading of the clock at its end, ns: the median of a thousand times a thousand.
fn one_span() -> f64 {
    let mut trace = trace(Process::Tracker);
    let mut times: Vec<u64> = (0..1000)
        .map(|field| {
            let begun = now();
            (0..1000).fold(begun, |at, _| trace.end(Phase::Track, About::field(field), at)) - begun
        })
        .collect();
    median(&mut times) as f64 / 1000.0
}

fn median<T: Ord + Copy>(times: &mut [T]) -> T {
    times.sort_unstable();
    times[times.len() / 2]
}

fn main() {
    let json = std::env::args().any(|a| a == "--json");
    let mut rows = vec![("a frame of the tracker".to_owned(), frames())];
    rows.extend(SCENES.map(|scene| (format!("a step of {scene}"), steps(scene))));
    for (what, Times { mut off, mut on, spans_a_turn }) in rows {
        let mut more: Vec<i64> = off.iter().zip(&on).map(|(off, on)| *on as i64 - *off as i64).collect();
        let [off_us, on_us] = [&mut off, &mut on].map(|times| median(times) as f64 * 1e-3);
        let more_us = median(&mut more) as f64 * 1e-3;
        let percent = more_us / off_us * 100.0;
        if json {
            let row = json!({"what": what, "off_us": off_us, "on_us": on_us, "more_us": more_us, "spans": spans_a_turn});
            println!("{row}");
        } else {
            println!(
                "{what:26} {off_us:8.2} µs, traced {on_us:8.2} µs: {more_us:5.2} µs more ({percent:.2} %), \
                 {spans_a_turn:.0} spans"
            );
        }
    }
    let span_ns = one_span();
    let row = json!({"what": "a span", "ns": span_ns});
    println!(
        "{}",
        if json { row.to_string() } else { format!("a span with its reading of the clock: {span_ns:.1} ns") }
    );
}
