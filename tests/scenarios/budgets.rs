//! What no load of the machine can move: the order of the stages, the camera's own time, and which
//! stage is blamed for a delay that was put into it. `make latency` judges the rest on a quiet machine.

use protocol::time::Instants;
use recording::{Item, Recording};
use renderer::gpu::Gpu;
use rig::Rig;
use vitreo_tests::{instance_name, json, vitreo};

/// From the middle of the exposure until the last line that can hold a marker has left the sensor, at
/// least; blobs leave then, before the lines below.
const MARKERS_READ_NS: u64 = 17_000_000;

/// Runs with a delay and returns the stages that the report says are broken.
fn broken_stages(stage: &str, delay_ms: u32, picture: bool) -> Option<Vec<String>> {
    let folder = tempfile::tempdir().expect("folder");
    let report = folder.path().join("report.json");
    // Wide limits, which a slow machine keeps and a delay of this size does not.
    let budgets = folder.path().join("budgets.toml");
    let limit = f64::from(delay_ms) * 0.8;
    let table = ["camera", "camera-wait", "tracking", "simulation", "rendering"].map(|s| {
        // Blobs leave 18 ms after the middle of the exposure.
        let slack = if s == "camera" { 19.5 } else { 0.0 };
        format!("[[budget]]\nstage = \"{s}\"\nlimit_ms = {}\n", limit + slack)
    });
    let whole = "[[budget]]\nstage = \"whole-system\"\nlimit_ms = 0\n";
    std::fs::write(&budgets, format!("percentile = 50\n{}{whole}", table.concat())).expect("budgets");
    let name = instance_name();
    let inject = format!("{stage}={delay_ms}");
    let view = if picture { "--headless" } else { "--no-picture" };
    let finished = vitreo(&[
        "run",
        view,
        "--direct",
        "--duration",
        "4",
        "--instance",
        &name,
        "--assert-budgets",
        "--budgets",
        budgets.to_str().expect("UTF-8"),
        "--report",
        report.to_str().expect("UTF-8"),
        "--inject-delay",
        &inject,
    ]);
    if picture && finished.code == Some(1) && finished.stderr.contains("mesa-vulkan-drivers") {
        return None;
    }
    let finished = finished.expect_code(4);
    let stages = json(&report)["stages"].as_array().expect("stages").clone();
    let broken = stages.iter().filter(|s| s["broken"] == true);
    let broken: Vec<String> = broken.map(|s| s["stage"].as_str().expect("name").to_owned()).collect();
    for stage in &broken {
        assert!(finished.stderr.contains(stage.as_str()), "{stage} is not named in:\n{}", finished.stderr);
    }
    Some(broken)
}

#[test]
fn a_slow_camera_is_blamed() {
    assert_eq!(broken_stages("camera", 15, false).expect("no picture"), ["camera"]);
}

#[test]
fn a_late_camera_is_blamed() {
    // The tracker gives up after 3 ms; a limit of 80 % of that is broken by the wait itself.
    assert_eq!(broken_stages("camera-wait", 3, false).expect("no picture"), ["camera-wait"]);
}

#[test]
fn a_slow_tracker_is_blamed() {
    assert_eq!(broken_stages("tracking", 12, false).expect("no picture"), ["tracking"]);
}

#[test]
fn a_slow_simulation_is_blamed() {
    assert_eq!(broken_stages("simulation", 15, false).expect("no picture"), ["simulation"]);
}

#[test]
fn a_slow_picture_is_blamed() {
    match broken_stages("rendering", 400, true) {
        Some(broken) => assert_eq!(broken, ["rendering"]),
        None => skips::skip(&"no graphics driver on this machine"),
    }
}

/// Of a run that is recorded: instants in the order of the data path, on one clock.
fn instants_in_order(view: &str) {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("r.mcap");
    let name = instance_name();
    let record = file.to_str().expect("UTF-8");
    vitreo(&["run", view, "--direct", "--duration", "2", "--instance", &name, "--record", record])
        .expect_code(0);
    let recording = Recording::open(&file).expect("a recording");
    let (mut steps, mut frames) = (0, 0);
    for (_, item) in recording.items_of(&["poses", "steps", "frames"]).flatten() {
        match item {
            Item::Poses(frame) => in_order(&path_to_poses(&frame.instants)),
            Item::Step(step) => {
                let stepped = step.instants.stepped;
                in_order(&[&path_to_poses(&step.instants)[..], &[stepped]].concat());
                steps += 1;
            }
            // Before the first pose there is nothing to be late.
            Item::Frame(f) if f.instants.exposed > 0 => {
                // The scene is older than the pose that was latched.
                in_order(&[&path_to_poses(&f.instants)[..], &[f.latched, f.drawn, f.displayed]].concat());
                in_order(&[f.instants.stepped, f.latched]);
                in_order(&[f.frame_start, f.latched]);
                frames += 1;
            }
            _ => {}
        }
    }
    assert!(steps > 20, "{steps} steps");
    assert_eq!(frames > 0, view == "--headless", "{frames} frames");
}

/// A camera cannot be faster than its read-out, and takes as long for that as the rig says.
fn path_to_poses(instants: &Instants) -> [u64; 4] {
    let Instants { exposed, read_out, blobs_out, taken, tracked, .. } = *instants;
    assert_eq!(
        read_out - exposed,
        Rig::load_or_shipped(None).expect("the shipped rig").read_out_ns(),
        "{instants:?}"
    );
    assert!(blobs_out - exposed >= MARKERS_READ_NS, "{instants:?}");
    [exposed, blobs_out, taken, tracked]
}

fn in_order(instants: &[u64]) {
    assert!(instants[0] > 0 && instants.is_sorted(), "{instants:?}");
}

#[test]
fn no_load_changes_the_order_of_the_stages() {
    instants_in_order("--no-picture");
    match Gpu::headless() {
        Ok(_) => instants_in_order("--headless"),
        Err(e) => skips::skip(&e),
    }
}
