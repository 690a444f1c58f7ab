//! Cameras that are not at 50 Hz, through a whole run: poses, steps and pictures at their rate, a recording that
//! verifies to the bit, and a score.

use protocol::geometry::Validity;
use protocol::poses::BODY_NAMES;
use protocol::time::Nanos;
use recording::{Item, Recording};
use rig::Rig;
use vitreo_tests::verified::{WITHOUT_FRAME, verify};
use vitreo_tests::{instance_name, json, repository, vitreo};

/// Runs a module on a rig; gives the report and the file.
fn run(
    folder: &std::path::Path,
    rig: &std::path::Path,
    view: &str,
) -> (serde_json::Value, std::path::PathBuf) {
    let [file, report] = ["r.mcap", "r.json"].map(|name| folder.join(name));
    let name = instance_name();
    let [rig, record, report_path] = [rig, &file, &report].map(|p| p.to_str().expect("UTF-8"));
    let run = ["run", view, "--direct", "--module", "navigation", "--duration", "4", "--instance", &name];
    let finished = vitreo(&[&run[..], &["--rig", rig, "--record", record, "--report", report_path]].concat());
    // What a machine without time for it loses is told by 3, and counted below.
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    assert!(!finished.stderr.contains("50"), "nothing is counted at 50 Hz: {}", finished.stderr);
    (json(&report), file)
}

/// Distances in time of what follows each other without a field between.
fn distances(exposed: &[(u64, Nanos)]) -> Vec<u64> {
    let follows = |pair: &&[(u64, Nanos)]| pair[1].0 == pair[0].0 + 1;
    exposed.windows(2).filter(follows).map(|pair| pair[1].1 - pair[0].1).collect()
}

#[test]
fn a_rig_of_200_hz_runs_with_poses_steps_and_pictures_and_its_recording_verifies_and_scores() {
    let view = if renderer::gpu::Gpu::headless().is_ok() { "--headless" } else { "--no-picture" };
    let file = repository().join("assets/rig-200hz.json");
    let rig = Rig::load(&file).expect("the shipped rig");
    assert_eq!((rig.field_period_ns(), rig.sensors()[0].lines_ns()), (5_000_000, 3_000_000));
    let folder = tempfile::tempdir().expect("folder");
    let (report, record) = run(folder.path(), &file, view);
    let budget = report["stages"].as_array().expect("stages").iter().find(|s| s["stage"] == "simulation");
    assert_eq!(budget.expect("its budget")["budget_ms"], 4.0, "0.8 of the period");
    let (mut poses, mut steps, mut pictures, mut measured) = (Vec::new(), Vec::new(), 0, [0; 3]);
    for (_, item) in
        Recording::open(&record).expect("a recording").items_of(&["poses", "steps", "frames"]).flatten()
    {
        match item {
            Item::Poses(frame) => {
                poses.push((frame.field, frame.instants.exposed));
                let all = frame.bodies.iter().zip(&mut measured);
                all.for_each(|(body, n)| *n += u64::from(body.validity == Validity::Measured as u32));
            }
            Item::Step(step) => steps.push((step.field, step.instants.exposed)),
            Item::Frame(_) => pictures += 1,
            _ => {}
        }
    }
    println!("{} poses, {} steps, {pictures} pictures, measured {measured:?}", poses.len(), steps.len());
    for (what, all) in [("poses", &poses), ("steps", &steps)] {
        let apart = distances(all);
        assert!(
            apart.len() > 200 && apart.iter().all(|ns| *ns == 5_000_000),
            "{what}: {} in a row",
            apart.len()
        );
    }
    for (body, n) in BODY_NAMES.iter().zip(measured) {
        assert!(2 * n > poses.len() as u64, "{body} was measured in {n} of {} frames", poses.len());
    }
    assert!(view == "--no-picture" || pictures > 10, "{pictures} pictures");
    let verified = verify(&record).expect_but([200, 200], &[WITHOUT_FRAME]);
    println!("verified: {:?}, {:?}", verified.poses(), verified.states());
    let scored = vitreo(&["score", record.to_str().expect("UTF-8"), "--json"]);
    assert!(scored.stdout.contains("tremor"), "{scored:?}");
}
