//! A process that runs and sends nothing: the run says so while it goes on, and does not end well.

use vitreo_tests::{instance_name, json, vitreo};

#[test]
fn a_tracker_that_puts_out_nothing_is_named_and_costs_the_exit_code() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (report, record) = (path("report.json"), path("a.mcap"));
    let name = instance_name();
    let run = ["run", "--no-picture", "--direct", "--duration", "4", "--instance", &name];
    let outputs = ["--report", &report, "--record", &record, "--inject-delay", "tracking=1500"];
    let done = vitreo(&[&run[..], &outputs].concat()).expect_code(3);
    let what = "tracker sends nothing on poses";
    assert!(done.stderr.contains(&format!("! {what}")), "{done:?}");
    let report = json(std::path::Path::new(&report));
    let silences = report["silences"].as_array().expect("silences");
    assert!(!silences.is_empty(), "{report}");
    assert!(silences.iter().all(|s| s["what"].as_str().is_some_and(|w| w.contains(what))), "{report}");
    let info = vitreo(&["info", &record]).expect_code(0);
    assert!(info.stdout.contains(what), "{info:?}");
}
