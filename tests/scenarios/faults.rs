//! Everything that can go wrong in the cameras goes wrong; the chain goes on, and the tracker knows
//! what it knows.

use protocol::blobs::BlobField;
use protocol::geometry::Validity;
use protocol::limits::INSTRUMENTS;
use protocol::poses::TrackerFrame;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::collections::BTreeMap;
use surgeon::motion::MotionSource;
use virtual_rig::faults::FaultInjector;
use virtual_rig::faults::spec::FaultSpec;
use vitreo_tests::{Observer, Running, instance_name, json, next};

/// Frames to look at, after those in which the tracker starts: 2 s and a half.
const FRAMES: u64 = 125;
const SKIPPED: u64 = 15;

/// What a frame says of an instrument's tip, mm in the world; `None` unless measured.
fn measured_tips(frame: &TrackerFrame) -> [Option<[f64; 3]>; INSTRUMENTS] {
    std::array::from_fn(|i| {
        let body = &frame.bodies[i];
        (body.validity() == Validity::Measured).then_some(body.world_from_body.position_mm)
    })
}

#[test]
fn the_chain_survives_hard_faults_and_the_tracker_stays_sane() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (report, log, name) = (path("report.json"), path("faults.jsonl"), instance_name());
    let running = Running::start(&[
        "run",
        "--no-picture",
        "--duration",
        "3.5",
        "--faults",
        "hard",
        "--fault-log",
        &log,
        "--report",
        &report,
        "--instance",
        &name,
    ]);
    let observer = Observer::join(&name);
    let mut poses = observer.receiver::<TrackerFrame>();
    let mut blobs = observer.receiver::<BlobField>();

    // Truth needs the start of the cameras' schedule: any field gives it, through its camera's
    // clock.
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let faults = FaultInjector::new(FaultSpec::load("hard").expect("preset"), &rig, 1).expect("faults");
    let field = next(&mut blobs, |_| true);
    let start_ns = field.exposed_ns - faults.clock(field.camera).exposed_ns(field.field);
    drop(blobs);
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let mut surgeon = MotionSource::new(&scene, &rig, None, 1);

    let (mut frames, mut errors_um, mut known) = (0u64, Vec::new(), 0u32);
    let mut last_ns = 0;
    while frames < SKIPPED + FRAMES {
        let frame = next(&mut poses, |f| f.instants.exposed > last_ns);
        last_ns = frame.instants.exposed;
        frames += 1;
        if frames <= SKIPPED || last_ns < start_ns {
            continue;
        }
        let truth = surgeon.at(last_ns - start_ns).world_from_instrument;
        for (tip, truth) in measured_tips(&frame).iter().zip(truth) {
            let Some(tip) = tip else { continue };
            let square = (0..3).map(|k| (tip[k] - truth.translation.vector[k]).powi(2)).sum::<f64>();
            errors_um.push(square.sqrt() * 1e3);
            known += 1;
        }
    }
    drop((poses, observer));
    running.finish().expect_code(0);

    errors_um.sort_by(f64::total_cmp);
    let at = |share: f64| errors_um[((errors_um.len() - 1) as f64 * share) as usize];
    let asked = (FRAMES * INSTRUMENTS as u64) as f64;
    println!("measured {known} of {asked}; tip error, µm: {:.0} {:.0} {:.0}", at(0.5), at(0.95), at(1.0));
    assert!(f64::from(known) > 0.6 * asked, "{known} of {asked} poses are measured");
    assert!(at(0.5) < 15.0 && at(0.95) < 150.0, "µm at 50 and 95 %: {:.0} {:.0}", at(0.5), at(0.95));
    assert!(at(1.0) < 1500.0, "no pose is elsewhere altogether: {:.0} µm", at(1.0));

    let report = json(&folder.path().join("report.json"));
    assert!(
        report["restarts"].as_object().is_none_or(|r| r.values().all(|n| n == 0)),
        "{}",
        report["restarts"]
    );
    let cameras =
        report["processes"].as_array().expect("processes").iter().find(|p| p["process"] == "virtual-rig");
    let said = cameras.expect("cameras")["text"].as_str().expect("text").to_owned();
    assert!(said.contains("faults: dropped ") && said.contains("late "), "the summary tells them: {said}");

    // Every line of the log is what the seed says, asked for anew.
    let mut kinds = BTreeMap::<String, u32>::new();
    for line in std::fs::read_to_string(&log).expect("fault log").lines() {
        let line: serde_json::Value = serde_json::from_str(line).expect("JSON");
        let (camera, field) =
            (line["camera"].as_u64().expect("id") as u32, line["field"].as_u64().expect("number"));
        let kind = line["kind"].as_str().expect("kind");
        match kind {
            "dropped" => assert!(faults.dropped(camera, field), "{line}"),
            "late" => assert_eq!(line["delay_ns"], faults.delay_ns(camera, field), "{line}"),
            "torn" => assert_eq!(line["line"], faults.tear(camera, field, 288).expect("torn").line, "{line}"),
            _ => {}
        }
        *kinds.entry(kind.into()).or_default() += 1;
    }
    assert!(kinds.len() >= 8, "nearly every fault occurs in 3.5 s: {kinds:?}");
}
