//! Cameras that are not at 50 Hz, through a whole run: poses, steps and pictures at their rate, a recording that
//! verifies to the bit, and a score.

use protocol::fields::PixelFormat;
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, FieldUsed};
use protocol::time::Nanos;
use recording::{Item, Recording};
use rig::Rig;
use rig::sensor::Scan;
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
    // A machine without time for it loses some, which exit code 3 reports, and which is counted below.
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

/// The largest sensors, with a mosaic of colours: what has no time to scan all fields scans what it can.
#[test]
fn the_largest_cameras_with_a_mosaic_give_blobs_also_where_the_machine_is_too_slow() {
    let folder = tempfile::tempdir().expect("folder");
    let mut rig = Rig::load_or_shipped(None).expect("the shipped rig");
    (rig.scan, rig.field_rule, rig.frame, rig.line_ns) = (Scan::Progressive, None, None, 8_000);
    rig.pixel_format = PixelFormat::BayerRg8;
    for camera in &mut rig.cameras {
        let scale = [1920.0 / f64::from(camera.width), 1200.0 / f64::from(camera.height)];
        (camera.width, camera.height) = (1920, 1200);
        (camera.fx, camera.cx) = (scale[0] * camera.fx, scale[0] * camera.cx);
        (camera.fy, camera.cy) = (scale[1] * camera.fy, scale[1] * camera.cy);
    }
    let [file, report] = ["rig.json", "r.json"].map(|name| folder.path().join(name));
    std::fs::write(&file, rig.to_json()).expect("a rig");
    let [rig, report_path] = [&file, &report].map(|p| p.to_str().expect("UTF-8"));
    let name = instance_name();
    let run = ["run", "--no-picture", "--duration", "5", "--instance", &name];
    let finished = vitreo(&[&run[..], &["--rig", rig, "--report", report_path]].concat());
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    let report = json(&report);
    assert!(report["restarts"].get("fpga-model").is_none_or(|n| *n == 0), "{}", report["restarts"]);
    assert!(finished.stdout.contains("inst0 measured"), "{}", finished.stdout);
}

/// Cameras of 50, 100 and 200 Hz: frames at 200, each with the fields that were exposed in its period.
#[test]
fn cameras_of_different_rates_run_together_and_their_recording_verifies() {
    let folder = tempfile::tempdir().expect("folder");
    let mut rig = Rig::load(&repository().join("assets/rig-200hz.json")).expect("the shipped rig");
    (rig.cameras[0].field_hz, rig.cameras[1].field_hz) = (Some(50.0), Some(100.0));
    let file = folder.path().join("rig.json");
    std::fs::write(&file, rig.to_json()).expect("a rig");
    let (_, record) = run(folder.path(), &file, "--no-picture");
    let (mut poses, mut frames, mut measured) = (Vec::new(), Vec::new(), [0; 3]);
    let mut fields = [const { Vec::new() }; 3];
    for (_, item) in Recording::open(&record).expect("a recording").items_of(&["poses", "blobs"]).flatten() {
        match item {
            Item::Poses(frame) => {
                poses.push((frame.field, frame.instants.exposed));
                frames.push((frame.instants.exposed, frame.used[..frame.used_count as usize].to_vec()));
                let all = frame.bodies.iter().zip(&mut measured);
                all.for_each(|(body, n)| *n += u64::from(body.validity == Validity::Measured as u32));
            }
            Item::Blobs(field) => fields[field.camera as usize].push((field.field, field.exposed_ns)),
            _ => {}
        }
    }
    println!("{} poses, measured {measured:?}", poses.len());
    let apart = distances(&poses);
    assert!(apart.len() > 100 && apart.iter().all(|ns| *ns == 5_000_000), "{} in a row", apart.len());
    for (camera, (of_camera, period_ns)) in fields.iter().zip([20_000_000, 10_000_000, 5_000_000]).enumerate()
    {
        let apart = distances(of_camera);
        assert!(apart.len() > 50 && apart.iter().all(|ns| *ns == period_ns), "camera {camera}: {apart:?}");
    }
    assert_used_where_exposed(&frames, &fields);
    for (body, n) in BODY_NAMES.iter().zip(measured) {
        assert!(2 * n > poses.len() as u64, "{body} was measured in {n} of {} frames", poses.len());
    }
    let verified = verify(&record).expect_but([200, 200], &[WITHOUT_FRAME]);
    println!("verified: {:?}, {:?}", verified.poses(), verified.states());
}

/// Every frame has the fields that were exposed in its period, each field in one frame. The machine may lose frames,
/// and fields that come late may be in the next one: most are where they belong.
fn assert_used_where_exposed(frames: &[(Nanos, Vec<FieldUsed>)], fields: &[Vec<(u64, Nanos)>; 3]) {
    const PERIOD_NS: u64 = 5_000_000;
    const GENLOCK_NS: u64 = 500_000;
    let in_period = |of_frame: Nanos, exposed: Nanos| {
        let end = of_frame + GENLOCK_NS;
        (end - PERIOD_NS + 1..=end).contains(&exposed)
    };
    for (camera, of_camera) in fields.iter().enumerate() {
        let of_camera_used = |used: &[FieldUsed]| {
            used.iter()
                .filter(|f| f.camera as usize == camera)
                .map(|f| (f.field, f.exposed_ns))
                .collect::<Vec<_>>()
        };
        let all: Vec<_> = frames.iter().flat_map(|(_, used)| of_camera_used(used)).collect();
        assert!(all.windows(2).all(|pair| pair[0].0 < pair[1].0), "camera {camera}: a field is used twice");
        assert!(all.iter().all(|field| of_camera.contains(field)), "camera {camera}: a field nobody sent");
        let (mut on_time, mut belong) = (0, 0);
        for (exposed, used) in frames {
            let due: Vec<_> = of_camera.iter().filter(|field| in_period(*exposed, field.1)).collect();
            assert!(due.len() < 2, "camera {camera}: {due:?} in one period");
            belong += due.len();
            on_time += due.iter().filter(|field| of_camera_used(used).contains(field)).count();
        }
        println!(
            "camera {camera}: {on_time} of {belong} fields are in the frame of their period, {} used",
            all.len()
        );
        assert!(belong > 25 && 2 * on_time > belong, "camera {camera}: {on_time} of {belong}");
    }
}
