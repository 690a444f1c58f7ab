//! A process or a source that sends nothing: the run says so while it goes on, and does not end well.

use std::net::TcpListener;
use std::process::Command;
use vitreo_tests::{Running, instance_name, json, repository, vitreo};

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

/// Of a source that never delivers: how it is given, and what the run says of it.
struct Unheard {
    args: Vec<String>,
    source: String,
    while_it_waits: &'static str,
}

#[test]
fn a_source_that_never_delivers_is_named_and_its_run_fails() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let pipes = ["blobs", "a", "b", "c"].map(path);
    assert!(Command::new("mkfifo").args(&pipes).status().expect("mkfifo").success());
    let [blobs, a, b, c] = pipes;
    // Connections are made, and nobody speaks.
    let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
    let poses = format!("igtl:{}", silent.local_addr().expect("a port"));
    let rig = repository().join("tests/data/tracker/nominal/rig.json").display().to_string();
    let with_rig = |option: &str, value: String, while_it_waits| Unheard {
        source: format!("{option} {value}"),
        args: [option, &value, "--rig", &rig].map(String::from).to_vec(),
        while_it_waits,
    };
    let cases = [
        Unheard {
            source: poses.clone(),
            args: vec!["--poses".into(), poses],
            while_it_waits: "is the tracker sending?",
        },
        with_rig("--blobs", blobs, "is it sending?"),
        with_rig(
            "--cameras",
            format!("y4m:{a},y4m:{b},y4m:{c}"),
            "no program has written a picture into its pipe",
        ),
        with_rig("--external", "blobs".into(), "waiting for a program that sends blobs"),
    ];
    // They wait side by side.
    let runs = cases.each_ref().map(|case| {
        let name = instance_name();
        let own = ["run", "--no-picture", "--duration", "6", "--instance", &name];
        let given: Vec<&str> = case.args.iter().map(String::as_str).collect();
        Running::start(&[&own[..], &given].concat())
    });
    for (case, run) in cases.iter().zip(runs) {
        let done = run.finish().expect_code(1);
        let source = &case.source;
        let lines = || done.stderr.lines().filter(|line| line.contains(source.as_str()));
        let waits = |line: &str| line.contains(" from ") && line.contains(case.while_it_waits);
        assert!(lines().any(waits), "{source}: {done:?}");
        let end = format!("no pose was computed in this run: nothing of use came from {source}");
        assert!(lines().any(|line| line.contains(&end)), "{source}: {done:?}");
    }
}
