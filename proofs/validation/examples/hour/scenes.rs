//! Scenes and modules through cameras, tracker and simulation.

use super::{Args, last_over_first};
use protocol::geometry::Validity;
use scene::SceneFile;
use scene::module::{self, Module};
use surgeon::skill;
use validation::pipeline::Pipeline;
use validation::streams::lasting::thread_cpu;
use virtual_rig::cameras::Path;

/// Fields of a minute.
const MINUTE_FIELDS: u64 = 3_000;
/// Fields between two audits of the simulation's state.
const AUDIT_FIELDS: u64 = 50;
/// Largest ratio of the time of a field in the end to that in the beginning.
const TIME_RATIO: f64 = 1.5;
/// Least share of frames with both instruments measured; modules take them out now and then.
const LEAST_MEASURED: f64 = 0.9;

/// Runs every scene and module, prints their table and returns what is wrong.
pub fn run(args: &Args) -> Vec<String> {
    let mut wanted = Vec::new();
    for name in scene::SHIPPED.iter().map(|(name, _)| *name).filter(|name| args.wants(name)) {
        wanted.push((name.to_owned(), SceneFile::load(name).expect("a shipped scene")));
    }
    for name in module::names().filter(|name| args.wants(&format!("module {name}"))) {
        let module = Module::load(name).expect("a shipped module");
        let skill = skill::named("average").expect("a shipped skill");
        let scene = surgeon::compose(&module, 1, &skill, args.seed).expect("a level");
        wanted.push((format!("module {name}"), scene));
    }
    if wanted.is_empty() {
        return Vec::new();
    }
    println!("\n| scene | minute | steps | both instruments measured | events | µs a field |");
    println!("|---|---|---|---|---|---|");
    wanted.iter().flat_map(|(name, scene)| one(args, name, scene)).collect()
}

/// Counts of a minute.
#[derive(Default)]
struct Counts {
    steps: u64,
    measured: u64,
    events: u64,
    /// The first defect that an audit found.
    defect: Option<String>,
}

fn one(args: &Args, name: &str, scene: &SceneFile) -> Vec<String> {
    let mut pipeline = Pipeline::new(scene, Path::Direct, None, args.seed);
    let bar = args.bar(name);
    let (mut times, mut problems) = (Vec::new(), Vec::new());
    for minute in 1..=args.minutes {
        let (begin, mut counts) = (thread_cpu(), Counts::default());
        for field in 0..MINUTE_FIELDS {
            pipeline.field(&mut |frame, world, _| {
                let measured = |i: usize| frame.bodies[i].validity() == Validity::Measured;
                counts.steps += 1;
                counts.measured += u64::from(measured(0) && measured(1));
                counts.events += world.events().len() as u64;
                if field % AUDIT_FIELDS == 0 {
                    counts.defect = counts.defect.take().or_else(|| world.audit().err());
                }
            });
        }
        let time_us = (thread_cpu() - begin).as_secs_f64() * 1e6 / MINUTE_FIELDS as f64;
        times.push(time_us);
        bar.inc(1);
        let share = counts.measured as f64 / counts.steps.max(1) as f64;
        if args.shows(minute) {
            let Counts { steps, events, .. } = counts;
            bar.suspend(|| {
                println!("| {name} | {minute} | {steps} | {share:.4} | {events} | {time_us:.0} |")
            });
        }
        if counts.steps + 2 < MINUTE_FIELDS {
            problems.push(format!("{name}, minute {minute}: {} steps of {MINUTE_FIELDS}", counts.steps));
        }
        if share < LEAST_MEASURED {
            problems.push(format!("{name}, minute {minute}: both measured in a share of {share:.3} only"));
        }
        problems.extend(counts.defect.map(|defect| format!("{name}, minute {minute}: {defect}")));
    }
    bar.finish_and_clear();
    let ratio = last_over_first(&times);
    if ratio > TIME_RATIO {
        problems.push(format!("{name}: a field takes {ratio:.2} times as long in the end"));
    }
    problems
}
