//! What it costs to take a copy of a run and to go back to it, on one core:
//! `cargo bench -p replay --bench snapshot [-- --json]`. Medians, µs.
//!
//! Every shipped scene and module is played by its script. At a hundred instants of its round a copy
//! of the world is taken, the script goes on for a second, and the world goes back. Beside it stand
//! the bytes of a checkpoint of that world and what its encoding costs. The last rows are of the golden
//! recording: its tracker, and all of a recorded run, with its place in the file.

use ipc::clock::now;
use recording::Recording;
use replay::engine::{Made, Recorded};
use replay::frames::Frames;
use replay::perception::perform;
use rig::Rig;
use scene::module::{self, Module};
use scene::{SHIPPED, SceneFile};
use serde_json::json;
use simcore::world::World;
use std::ops::ControlFlow;
use std::path::Path;
use surgeon::rehearsal::Rehearsal;
use tracker::{Reference, Tracker};

/// Instants at which copies are taken.
const COPIES: u64 = 100;
/// Fields between a copy and the return to it.
const AHEAD: u64 = 50;

struct Row {
    scene: String,
    take_us: f64,
    restore_us: f64,
    encode_us: f64,
    bytes: usize,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let begun = now();
    let made = work();
    (made, (now() - begun) as f64 * 1e-3)
}

/// Every shipped scene, and every shipped module at its last level.
fn scenes() -> Vec<(String, SceneFile)> {
    let scenes = SHIPPED
        .iter()
        .map(|(name, _)| (name.to_string(), SceneFile::load(name).expect("the shipped scenes are tested")));
    let modules = module::names().map(|name| {
        let module = Module::load(name).expect("the shipped modules are tested");
        let scene = module.level_scene(module.levels()).expect("the shipped modules are tested");
        (format!("module {name}"), scene)
    });
    scenes.chain(modules).collect()
}

fn measure(name: String, scene: &SceneFile) -> Row {
    let mut world = World::new(scene).expect("the shipped scenes are tested");
    let mut rehearsal = Rehearsal::shipped(scene);
    let every = (rehearsal.fields() / COPIES).max(1);
    let (mut take, mut restore, mut encode, mut bytes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut most = 0;
    for field in 0..every * COPIES {
        perform(&mut rehearsal, &mut world, field);
        if field % every == 0 {
            let (copy, us) = timed(|| world.snapshot());
            take.push(us);
            encode.push(timed(|| world.save(&mut bytes).expect("it can be saved")).1);
            most = most.max(bytes.len());
            let mut ahead = rehearsal.clone();
            (field + 1..=field + AHEAD).for_each(|f| drop(perform(&mut ahead, &mut world, f)));
            restore.push(timed(|| world.restore_snapshot(&copy).expect("it is of this scene")).1);
        }
    }
    let [take_us, restore_us, encode_us] = [take, restore, encode].map(median);
    Row { scene: name, take_us, restore_us, encode_us, bytes: most }
}

/// The tracker of the golden recording, at every frame.
fn measure_tracker(recording: &Recording, rig: &Rig) -> Row {
    let mut tracker = Tracker::new(rig);
    let mut frames = Frames::new(rig.field_period_ns(), false);
    let (mut take, mut restore, mut encode, mut bytes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for item in recording.items() {
        let (at, item) = item.expect("the golden recording is whole");
        frames.note(at, &item);
        while let Some(turn) = frames.next_turn() {
            let recorded = &turn.recorded;
            let (camera, field) = (recorded.camera, recorded.field);
            let reference = Reference { camera, field, exposed_ns: recorded.instants.exposed };
            tracker.track(&turn.fields, &reference);
            let (copy, us) = timed(|| tracker.snapshot());
            take.push(us);
            encode.push(timed(|| tracker.save(&mut bytes).expect("it can be saved")).1);
            restore.push(timed(|| tracker.restore_snapshot(&copy)).1);
        }
    }
    let [take_us, restore_us, encode_us] = [take, restore, encode].map(median);
    Row { scene: "tracker".into(), take_us, restore_us, encode_us, bytes: bytes.len() }
}

/// The run of the golden recording, at every step.
fn measure_run(recording: &Recording, rig: &Rig) -> Row {
    let scene = &recording.provenance().scene_toml;
    let scene = SceneFile::parse(scene, "recorded").expect("the golden recording is whole");
    let world = World::new(&scene).expect("the shipped scenes are tested").unseen();
    let mut run = Recorded::new(recording, rig, world);
    let (mut take, mut restore) = (Vec::new(), Vec::new());
    let one_step = |made: Made<'_>| match made {
        Made::Step(_) => Ok(ControlFlow::Break(())),
        Made::Frame(..) => Ok(ControlFlow::Continue(())),
    };
    while run.run(one_step).expect("nothing fails") {
        let (copy, us) = timed(|| run.snapshot());
        take.push(us);
        restore.push(timed(|| run.restore(&copy).expect("it is of this scene")).1);
    }
    let [take_us, restore_us] = [take, restore].map(median);
    Row { scene: "recorded run".into(), take_us, restore_us, encode_us: 0.0, bytes: 0 }
}

fn main() {
    let mut rows: Vec<Row> = scenes().into_iter().map(|(name, scene)| measure(name, &scene)).collect();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap");
    let recording = Recording::open(&golden).expect("the golden recording is there");
    let rig = Rig::parse(&recording.provenance().rig_json, "recorded").expect("the golden rig is whole");
    rows.push(measure_tracker(&recording, &rig));
    rows.push(measure_run(&recording, &rig));
    if std::env::args().any(|a| a == "--json") {
        let rows = rows.iter().map(|r| {
            json!({ "scene": r.scene, "take_us": r.take_us, "restore_us": r.restore_us,
                    "encode_us": r.encode_us, "checkpoint_bytes": r.bytes })
        });
        println!("{}", json!(rows.collect::<Vec<_>>()));
        return;
    }
    println!(
        "{:<16} {:>9} {:>11} {:>10} {:>16}",
        "scene", "take µs", "restore µs", "encode µs", "checkpoint bytes"
    );
    for r in rows {
        println!(
            "{:<16} {:>9.1} {:>11.1} {:>10.1} {:>16}",
            r.scene, r.take_us, r.restore_us, r.encode_us, r.bytes
        );
    }
}
