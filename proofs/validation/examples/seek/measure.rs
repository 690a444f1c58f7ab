//! Opening, seeking and memory, measured in a process that does nothing else.

use super::Args;
use anyhow::{Context, ensure};
use ipc::clock::now;
use protocol::steps::StepRecord;
use recording::Recording;
use replay::engine::Made;
use replay::resimulate::scene_of;
use replay::stop::StopSignal;
use replay::timeline::player::Player;
use replay::timeline::{Target, index};
use simcore::world::World;
use std::ops::ControlFlow;
use std::process::ExitCode;

/// Longest time to open a recording, s, and to go to a place, s; most memory, MB.
const OPEN_S: f64 = 1.0;
const SEEK_S: f64 = 0.2;
const MEMORY_MB: f64 = 300.0;
/// Steps that are played behind a place to compare what follows.
const FOLLOWED: usize = 25;

/// A figure and its limit.
struct Figure(&'static str, f64, f64, &'static str);

/// Measures; the exit code says whether every limit holds.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let begun = now();
    let recording = Recording::open(&args.file)?;
    let timeline = index::open(&recording, &StopSignal::install()?)?;
    let open_s = since(begun);
    let [first, last] = timeline.ends().context("the recording has no steps")?;
    let checkpoints = timeline.pairs().map_or(0, |pairs| pairs.heads().len());
    let world = World::new(&scene_of(&recording)?)?.unseen();
    let mut player = Player::new(timeline, world)?;
    let (mut seeks, mut backs, mut compared) = (Vec::new(), Vec::new(), 0);
    for place in places(args, first.exposed_ns, last.exposed_ns) {
        let begun = now();
        let at = player.seek(Target::Exposed(place))?.at.context("a place without a step")?;
        seeks.push(since(begun));
        let begun = now();
        player.step_back()?;
        backs.push(since(begun));
        ensure!(player.step_forward()? == Some(at), "a step back and one forward lead elsewhere");
        compared += follow(&mut player)?;
    }
    let begun = now();
    let events = player.timeline().events().len();
    let events_s = since(begun);
    println!("{}: {checkpoints} checkpoints, {events} events", args.file.display());
    println!("{compared} states and poses behind the places are the recorded ones");
    let [seek, back] = [&mut seeks, &mut backs].map(|all| {
        all.sort_by(f64::total_cmp);
        [all[all.len() / 2], all[all.len() - 1]]
    });
    let figures = [
        Figure("open", open_s, OPEN_S, "s"),
        Figure("seek, median", seek[0], SEEK_S, "s"),
        Figure("seek, longest", seek[1], SEEK_S, "s"),
        Figure("step back, median", back[0], SEEK_S, "s"),
        Figure("step back, longest", back[1], SEEK_S, "s"),
        Figure("list of events", events_s, OPEN_S, "s"),
        Figure("memory", peak_mb()?, MEMORY_MB, "MB"),
    ];
    let mut good = true;
    for Figure(name, value, limit, unit) in figures {
        let verdict = if value <= limit { "" } else { "  BEYOND" };
        println!("{name:20} {value:9.3} {unit:2}  at most {limit} {unit}{verdict}");
        good &= value <= limit;
    }
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn since(begun: u64) -> f64 {
    (now() - begun) as f64 * 1e-9
}

/// Random instants between two, the ends among them.
fn places(args: &Args, first: u64, last: u64) -> Vec<u64> {
    let mut state = args.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let random = |_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        first + state % (last - first + 1)
    };
    [last, first + 1].into_iter().chain((2..args.places).map(random)).collect()
}

/// Plays on and holds states and poses to the recorded ones; how many were compared.
fn follow(player: &mut Player) -> anyhow::Result<usize> {
    let (mut steps, mut compared) = (0, 0);
    player.play(|made| {
        match made {
            Made::Frame(turn, frame, _) => {
                let bodies =
                    |frame: &protocol::poses::TrackerFrame| bytemuck::bytes_of(&frame.bodies).to_vec();
                ensure!(turn.determined, "frame {} is not determined: {:?}", frame.frame, turn.lost);
                ensure!(bodies(frame) == bodies(&turn.recorded), "frame {} has other poses", frame.frame);
            }
            Made::Step(again) => {
                let of = |step: &StepRecord| (step.step, step.field, step.state_hash);
                ensure!(of(&again.step) == of(&again.recorded), "step {} has another state", again.step.step);
                steps += 1;
            }
        }
        compared += 1;
        Ok(if steps == FOLLOWED { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    Ok(compared)
}

/// Most memory that this process ever held, MB.
fn peak_mb() -> anyhow::Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status").context("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).context("VmHWM")?;
    let kb: f64 = line.trim().trim_end_matches("kB").trim().parse()?;
    Ok(kb * 1024e-6)
}
