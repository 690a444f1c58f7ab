//! A delay put into one stage is blamed on that stage.

use vitreo_tests::{instance_name, json, vitreo};

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
        None => println!("skipped: no graphics driver on this machine"),
    }
}
