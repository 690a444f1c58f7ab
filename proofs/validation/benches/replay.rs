//! How fast recordings run through tracker and simulation again, as `vitreo replay --lockstep` does it:
//! `cargo bench -p validation --bench replay [-- --json] [NAME]`. Times real time; medians.
//!
//! Each scene and module is recorded for half a minute, with markers made straight into blobs, and then replayed.
//! `replay` is by the clock on the wall, on two cores; the others are processor time of one core: the same run in
//! one thread, what it takes to read and decode all items, and to do the steps alone (which reads what they need).

use ipc::clock::now;
use recording::Recording;
use replay::engine::Recorded;
use replay::resimulate::{scene_of, steps};
use rig::Rig;
use serde_json::json;
use simcore::world::World;
use std::ops::ControlFlow;
use validation::live_recording::Live;
use validation::streams::lasting::thread_cpu;

/// Length of a recording, fields and s.
const FIELDS: u64 = 1500;
const SECONDS: f64 = 30.0;
/// Runs, of which the median counts.
const RUNS: usize = 7;
/// What is replayed.
const SCENES: [&str; 5] = ["peel", "module navigation", "module bimanual", "module peeling", "vitrectomy"];

/// Times real time.
struct Row {
    scene: &'static str,
    replay: f64,
    one_core: f64,
    read: f64,
    steps: f64,
}

fn median(mut work: impl FnMut() -> f64) -> f64 {
    let mut times: Vec<f64> = (0..RUNS).map(|_| work()).collect();
    times.sort_by(f64::total_cmp);
    SECONDS / times[RUNS / 2]
}

fn cpu(work: impl FnOnce()) -> f64 {
    let begun = thread_cpu();
    work();
    (thread_cpu() - begun).as_secs_f64()
}

fn measure(scene: &'static str) -> Row {
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    let live = Live { scene, fields: FIELDS, seed: 11 };
    live.record(file.reopen().expect("the same file"), file.path(), |_| {}).expect("a shipped scene");
    let recording = Recording::open(file.path()).expect("it was written just now");
    let rig = Rig::parse(&recording.provenance().rig_json, "recorded").expect("the shipped rig");
    let world =
        || World::new(&scene_of(&recording).expect("a shipped scene")).expect("a shipped scene").unseen();
    let replay = median(|| {
        let run = Recorded::new(&recording, &rig, world());
        let begun = now();
        let ended = run.run_to_end(|_| Ok(ControlFlow::Continue(()))).expect("nothing fails");
        assert!(ended.steps.done.differs_at.is_none() && ended.steps.done.steps + 2 > FIELDS);
        (now() - begun) as f64 * 1e-9
    });
    let one_core = median(|| {
        let mut run = Recorded::new(&recording, &rig, world());
        let work = || assert!(!run.run(|_| Ok(ControlFlow::Continue(()))).expect("nothing fails"));
        cpu(work)
    });
    let read = median(|| cpu(|| assert!(recording.items().all(|item| item.is_ok()))));
    let steps = median(|| {
        let world = world();
        cpu(|| drop(steps(&recording, world, |_| Ok(ControlFlow::Continue(()))).expect("nothing fails")))
    });
    Row { scene, replay, one_core, read, steps }
}

fn main() {
    let options: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let name = options.iter().find(|option| !option.starts_with("--"));
    let wanted = |scene: &&str| name.is_none_or(|name| scene.contains(name.as_str()));
    let rows: Vec<Row> = SCENES.into_iter().filter(wanted).map(measure).collect();
    if options.iter().any(|option| option == "--json") {
        let rows = rows
            .iter()
            .map(|r| json!({ "scene": r.scene, "replay_x": r.replay, "one_core_x": r.one_core, "read_x": r.read, "steps_x": r.steps }));
        println!("{}", json!(rows.collect::<Vec<_>>()));
        return;
    }
    println!("{:<18} {:>9} {:>9} {:>9} {:>9}", "times real time", "replay", "one core", "read", "steps");
    for Row { scene, replay, one_core, read, steps } in rows {
        println!("{scene:<18} {replay:>9.0} {one_core:>9.0} {read:>9.0} {steps:>9.0}");
    }
}
