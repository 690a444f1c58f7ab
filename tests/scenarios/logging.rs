//! Messages of a run on standard error: text for a person, JSON lines for a program.

use protocol::blobs::BlobField;
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader};
use protocol::health::Process;
use serde_json::Value;
use std::process::{Command, Stdio};
use vitreo_tests::{Observer, Running, binaries, instance_name, next, repository, vitreo};

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

/// What one process refuses of a running simulator: a field that was there already, and one of no camera.
#[test]
fn records_about_a_field_carry_its_number() {
    let name = instance_name();
    let log = ["--log-format", "json", "--log", "tracker=debug,fpga_model=debug"];
    let run = ["run", "--no-picture", "--duration", "90", "--instance", &name];
    let running = Running::start(&[&run[..], &log].concat());
    let mut observer = Observer::join(&name);
    let mut blobs = observer.receiver::<BlobField>();
    let field = next(&mut blobs, |field| field.field >= 20);
    // Kept until it was read: what a sender that is gone has sent may be gone with it.
    let mut again = observer.sender::<BlobField>();
    again.send(&field).expect("sent");
    let foreign = FieldHeader { field: 4711, camera: 7, width: 8, height: 2, lines: 2, ..header() };
    let mut fields = observer.fields(foreign.bytes());
    fields.send(foreign.bytes(), |_| foreign).expect("sent");
    observer.health(Process::FpgaModel, |h| h.refused > 0);
    next(&mut blobs, |later| later.field > field.field + 5);
    drop((blobs, again, fields, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    let text = running.finish().expect_code(0).stderr;
    let about = |process: &str, field: u64, what: &str| {
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        lines
            .filter(|l| l["process"] == process && l["field"] == field)
            .any(|l| l["message"].to_string().contains(what))
    };
    assert!(about("tracker", field.field, "field refused"), "{text}");
    assert!(about("fpga-model", 4711, "a camera that the rig lacks"), "{text}");
}

fn header() -> FieldHeader {
    FieldHeader {
        field: 0,
        exposed_ns: 1_000_000,
        first_line_ns: 2_000_000,
        line_period_ns: 64_000,
        camera: 0,
        parity: 0,
        format: FORMAT_YCBCR_422,
        width: 0,
        height: 0,
        lines: 0,
    }
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
