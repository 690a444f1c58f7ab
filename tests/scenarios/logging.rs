//! Messages of a run on standard error: text for a person, JSON lines for a program.

use serde_json::Value;
use std::process::{Command, Stdio};
use vitreo_tests::{binaries, instance_name, repository, vitreo};

/// Standard error of a run of one second; `None` where no driver can draw its picture.
fn run(extra: &[&str]) -> Option<String> {
    let name = instance_name();
    let mut args = vec!["run", "--direct", "--duration", "1", "--instance", &name];
    args.extend(extra);
    let finished = vitreo(&args);
    if finished.code == Some(1) && finished.stderr.contains("mesa-vulkan-drivers") {
        return None;
    }
    Some(finished.expect_code(0).stderr)
}

#[test]
fn json_lines_of_all_processes_come_unchanged() {
    let text = run(&["--no-picture", "--log-format", "json", "--log", "debug"]).expect("no picture");
    let lines: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e} in: {line}")))
        .collect();
    for line in &lines {
        for key in ["time", "level", "process", "target", "message"] {
            assert!(line[key].as_str().is_some_and(|t| !t.is_empty()), "{key} is missing in {line}");
        }
    }
    let has = |process: &str| lines.iter().any(|l| l["process"] == process);
    assert!(has("launcher") && has("simcore"), "{text}");
}

#[test]
fn a_failure_is_one_json_line() {
    let refused = vitreo(&["info", "/nowhere/file.mcap", "--log-format", "json"]).expect_code(1).stderr;
    let line: Value = serde_json::from_str(&refused).unwrap_or_else(|e| panic!("{e} in: {refused}"));
    assert_eq!((&line["level"], &line["process"]), (&"ERROR".into(), &"replay".into()));
    assert!(line["message"].as_str().is_some_and(|m| m.contains("/nowhere/file.mcap")), "{line}");
}

#[test]
fn graphics_libraries_write_nothing() {
    let Some(text) = run(&["--headless"]) else { return };
    for chatter in ["XDG_RUNTIME_DIR", "libEGL", "MESA"] {
        assert!(!text.contains(chatter), "{chatter} in:\n{text}");
    }
}

/// Every program begins to log when it starts; on a terminal it does so in colours.
#[test]
fn programs_start_on_a_terminal() {
    let vitreo = binaries().join("vitreo");
    let output = Command::new("script")
        .args(["-qec", &format!("{} modules", vitreo.display()), "/dev/null"])
        .current_dir(repository())
        .stdin(Stdio::null())
        .output()
        .expect("script, of Debian's base system, gives a terminal");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("navigation"), "{text}");
    assert!(!text.contains("tracing-subscriber"), "{text}");
}
