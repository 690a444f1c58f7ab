//! Wrong input ends with a clear message and the right exit code.

use std::path::Path;
use vitreo_tests::{instance_name, repository, vitreo};

fn write(folder: &Path, name: &str, text: &[u8]) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).expect("written");
    path.display().to_string()
}

/// Runs, expects failure, and expects every one of `named` in the message.
#[track_caller]
fn refused(args: &[&str], named: &[&str]) {
    let finished = vitreo(args).expect_code(1);
    for word in named {
        assert!(finished.stderr.contains(word), "'{word}' is missing in: {}", finished.stderr);
    }
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
}

#[test]
fn missing_and_foreign_files_are_named() {
    let folder = tempfile::tempdir().expect("folder");
    let foreign = write(folder.path(), "foreign.mcap", b"this is no recording at all, really not");
    let empty = write(folder.path(), "empty.mcap", b"");
    for command in ["info", "replay", "export"] {
        let tail: &[&str] = if command == "export" { &["--rig", "/dev/null"] } else { &[] };
        refused(&[&[command, "nowhere.mcap"], tail].concat(), &["nowhere.mcap"]);
        refused(&[&[command, foreign.as_str()], tail].concat(), &["foreign.mcap"]);
        refused(&[&[command, empty.as_str()], tail].concat(), &["empty.mcap"]);
    }
    let name = instance_name();
    refused(&["run", "--no-picture", "--scene", "nowhere", "--instance", &name], &["nowhere", "peel"]);
}

#[test]
fn bad_rigs_and_streams_are_refused_with_place_and_expectation() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = std::fs::read_to_string(repository().join("assets/rig.json")).expect("rig");
    let unknown = write(folder.path(), "unknown.json", rig.replacen("\"unit\"", "\"units\"", 1).as_bytes());
    let good = write(folder.path(), "good.json", rig.as_bytes());
    let field = r#"{"cam":0,"seq":0,"t_ns":47008480,"t_rx_ns":71424175,"parity":0,"blobs":[]}"#;
    let stream = write(folder.path(), "s.jsonl", field.as_bytes());
    let nan = field.replace("47008480", "NaN");
    let bad = write(folder.path(), "bad.jsonl", format!("{field}\n{nan}\n").as_bytes());
    let out = folder.path().join("o.mcap").display().to_string();
    refused(&["import", "--rig", &unknown, &stream, "-o", &out], &["unknown.json", "units"]);
    refused(&["import", "--rig", &good, &bad, "-o", &out], &["bad.jsonl", "2"]);
    let mut one: serde_json::Value = serde_json::from_str(&rig).expect("JSON");
    one["cameras"].as_array_mut().expect("cameras").truncate(1);
    let one = write(folder.path(), "one.json", one.to_string().as_bytes());
    refused(&["import", "--rig", &one, &stream, "-o", &out], &["one.json", "cameras", "2 to 8"]);
}

#[test]
fn strange_streams_are_counted_not_fatal() {
    let folder = tempfile::tempdir().expect("folder");
    let blob = r#"{"x":-1e5,"y":1e5,"area":3.0,"colour":"red","w":1.0,"h":1.0}"#;
    let field = |cam: u32, seq: u32, blobs: &str| {
        let t = 47_000_000 + u64::from(seq) * 20_000_000;
        format!(
            r#"{{"cam":{cam},"seq":{seq},"t_ns":{t},"t_rx_ns":{},"parity":{},"blobs":[{blobs}]}}"#,
            t + 24_000_000,
            seq % 2
        )
    };
    let many = vec![blob; 10_000].join(",");
    let lines = [
        field(0, 5, ""),
        field(1, 5, blob),
        field(0, 6, &many),
        field(0, 4, ""),
        field(0, 6, ""),
        field(7, 6, ""),
        field(2, 7, blob),
        field(0, 8, blob),
        field(1, 8, blob),
        field(2, 8, blob),
    ];
    let stream = write(folder.path(), "odd.jsonl", lines.join("\n").as_bytes());
    let out = folder.path().join("odd.mcap").display().to_string();
    let poses = folder.path().join("odd.csv").display().to_string();
    let rig = repository().join("assets/rig.json").display().to_string();
    vitreo(&["import", "--rig", &rig, &stream, "-o", &out]).expect_code(0);
    let name = instance_name();
    vitreo(&["replay", &out, "--lockstep", "--poses", &poses, "--instance", &name]).expect_code(0);
    let text = std::fs::read_to_string(&poses).expect("poses");
    assert!(text.starts_with("t_ns,t_out_ns,body,valid"), "{text}");
    assert!(!text.contains("NaN") && !text.contains("inf,"), "{text}");
}

#[test]
fn wrong_use_exits_with_two() {
    vitreo(&["run", "--no-such-option"]).expect_code(2);
    vitreo(&["dance"]).expect_code(2);
    vitreo(&["--help"]).expect_code(0);
}
