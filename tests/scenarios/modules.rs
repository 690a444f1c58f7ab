//! Training modules through the chain of a live run: cameras, tracker, simulation, task, score,
//! recording. One seed of each here; `make study` plays many. Modules of one hand go through drawn
//! fields of pixels; the longer ones, and operations, whose steps cost more, through markers made
//! straight into blobs, with the noise that the pixels' blobs have.

use recording::Item;
use recording::{Provenance, Recording, Source, Writer};
use scene::SceneFile;
use std::collections::BTreeMap;
use std::sync::Mutex;
use surgeon::motion::MotionUse;
use surgeon::motion::recorded::RecordedMotion;
use surgeon::skill::{CARELESS, EXPERT, Skill};
use training::score::Score;
use training::score::recording::Reader;
use training::score::table::Category;
use validation::pipeline::Pipeline;
use virtual_rig::cameras::Path;

/// What every recording says of itself.
fn provenance(scene: &SceneFile) -> Provenance {
    Provenance {
        rig_json: "{}".into(),
        scene_name: scene.title.clone(),
        scene_toml: scene.to_toml(),
        source: Source::Live,
        seeds: BTreeMap::new(),
        config: BTreeMap::new(),
        versions: BTreeMap::new(),
    }
}

/// Modules, and how their fields come about.
const PLAYED: [(&str, Path); 8] = [
    ("bimanual", Path::Direct),
    ("forceps", Path::Direct),
    ("navigation", Path::Pixels),
    ("shadow", Path::Pixels),
    ("steady-path", Path::Pixels),
    ("peeling", Path::Direct),
    ("relocation", Path::Direct),
    ("vitrectomy", Path::Direct),
];

/// An attempt, recorded; the recording must give the same score, to the bit.
fn attempt(name: &str, path: Path, surgeon: &Skill) -> Score {
    let scene = surgeon::compose(&surgeon::load(name).unwrap(), 1, surgeon, 1).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let writer = Writer::create(&file, &provenance(&scene)).unwrap();
    let score = Pipeline::new(&scene, path, None, 1).record(writer).unwrap();
    let mut reader = Reader::new(&scene).unwrap();
    let recording = Recording::open(&file).unwrap();
    for item in recording.items_of(&Reader::TOPICS) {
        match item.unwrap().1 {
            Item::Poses(frame) => reader.take_poses(frame),
            Item::Event(event) => reader.take_event(event),
            Item::Step(step) => reader.take_step(&step),
            other => panic!("{}", other.topic()),
        }
    }
    let verdict = reader.finish();
    let told = verdict.agrees();
    assert!(verdict.score == score, "{name}, {}: {:?}\n{score:?}", surgeon.name, verdict.score);
    assert_eq!((told.unwrap_or(true), verdict.unmatched), (true, 0), "{name}, {}", surgeon.name);
    score
}

#[test]
fn the_expert_finishes_and_the_careless_one_does_not() {
    let jobs: Vec<_> = PLAYED.iter().flat_map(|(n, p)| [(*n, *p, EXPERT), (*n, *p, CARELESS)]).collect();
    let (jobs, wrong) = (Mutex::new(jobs), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some((name, path, surgeon)) = { jobs.lock().unwrap().pop() } {
                    let score = attempt(name, path, &surgeon);
                    let good = score.finished && score.total >= 85.0;
                    let bad = score.total < 50.0;
                    if (surgeon == EXPERT && !good) || (surgeon == CARELESS && !bad) {
                        let (who, points) = (surgeon.name, score.total);
                        wrong.lock().unwrap().push(format!("{name}, {who}: {points:.1}, {}", score.finished));
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// The shakiest recorded hand at an otherwise still one: its tremor costs instrument handling, and
/// nothing else.
#[test]
fn recorded_tremor_lowers_instrument_handling_and_nothing_else() {
    let hand = "motion/m2s2_tremor/S_tracingxyzAI_mag1_force01_sh02.csv";
    let Some(file) = skips::data(hand) else { return };
    let still = Skill { tremor_um: 0.0, ..EXPERT };
    let scene = surgeon::compose(&surgeon::load("navigation").unwrap(), 1, &still, 1).unwrap();
    let score = |hand| Pipeline::new(&scene, Path::Direct, hand, 1).attempt(&mut |_, _, _| {});
    let (calm, shaken) = (score(None), score(Some(MotionUse::Tremor(RecordedMotion::load(&file).unwrap()))));
    for category in Category::ALL {
        let lost = calm.categories[category as usize] - shaken.categories[category as usize];
        if category == Category::Instruments {
            assert!(lost > 0.5, "{lost} points of instrument handling");
        } else {
            assert!(lost.abs() < 0.25, "{}: {lost} points", category.name());
        }
    }
}
