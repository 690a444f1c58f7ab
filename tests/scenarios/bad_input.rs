//! Wrong input ends with a clear message and the right exit code.

use results::store::Store;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use vitreo_tests::{binaries, instance_name, interrupt, repository, vitreo};

fn write(folder: &Path, name: &str, text: &[u8]) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).expect("written");
    path.display().to_string()
}

/// Runs, expects failure, and expects every one of `named` in the message.
#[track_caller]
fn refused(args: &[&str], named: &[&str]) {
    fails(1, args, named);
}

/// As [`refused`], where what was asked for does not exist.
#[track_caller]
fn misused(args: &[&str], named: &[&str]) {
    fails(2, args, named);
}

#[track_caller]
fn fails(code: i32, args: &[&str], named: &[&str]) {
    let finished = vitreo(args).expect_code(code);
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
}

#[test]
fn files_of_options_are_named_with_their_options() {
    let name = instance_name();
    for option in ["--rig", "--motion", "--budgets", "--fundus", "--instruments"] {
        refused(&["run", "--headless", "--instance", &name, option, "no.thing"], &[option, "no.thing"]);
    }
    let folder = tempfile::tempdir().expect("folder");
    let folder = folder.path().display().to_string();
    refused(&["run", "--no-picture", "--instance", &name, "--budgets", &folder], &["--budgets", "a folder"]);
    refused(
        &["play", "--no-picture", "--inputs", "no.thing", "--instance", &name],
        &["--inputs", "no.thing"],
    );
    refused(&["film", "navigation", "--fundus", "no.thing"], &["--fundus", "no.thing"]);
    refused(&["import", "--rig", "no.thing", "b.jsonl", "-o", "o.mcap"], &["--rig", "no.thing"]);
    for process in ["vitreo-tracker", "vitreo-virtual-rig", "vitreo-fpga-model"] {
        let mut command = Command::new(binaries().join(process));
        let done = command.args(["--instance", &name, "--rig", "no.thing"]).output().expect("it starts");
        let told = String::from_utf8_lossy(&done.stderr);
        assert!(told.contains("--rig") && told.contains("no.thing"), "{process}: {told}");
        assert_eq!(done.status.code(), Some(1), "{process}: {told}");
    }
}

#[test]
fn what_does_not_exist_is_wrong_use() {
    let name = instance_name();
    let run = |args: &[&'static str], named: &[&str]| {
        misused(&[&["run", "--no-picture", "--instance", &name], args].concat(), named);
    };
    run(&["--scene", "nowhere"], &["nowhere", "peel"]);
    run(&["--module", "nowhere"], &["nowhere", "navigation"]);
    run(&["--module", "navigation", "--level", "99"], &["level from 1 to", "99"]);
    run(&["--module", "navigation", "--surgeon", "nobody"], &["--surgeon", "expert", "nobody"]);
    run(&["--faults", "mild,nonsense"], &["--faults", "dropped", "nonsense"]);
    misused(&["run", "--no-picture", "--instance", "Not a name"], &["Not a name"]);
    misused(&["ctl", "pause", "--instance", "Not a name"], &["Not a name"]);
    misused(&["film", "nowhere"], &["nowhere", "navigation"]);
    misused(&["modules", "--scene", "nowhere"], &["nowhere"]);
}

#[test]
fn a_part_that_a_recording_does_not_have_is_refused() {
    let golden = repository().join("tests/data/golden/peel-2s.mcap").display().to_string();
    let replay = |args: &[&'static str]| [&["replay", golden.as_str()], args].concat();
    misused(&replay(&["--from", "1.5", "--until", "0.5"]), &["--until 0.5", "--from 1.5"]);
    misused(&replay(&["--until", "0"]), &["--until 0"]);
    misused(&replay(&["--from", "100"]), &["--from 100", "peel-2s.mcap is only 1.", " s long"]);
}

#[test]
fn a_replay_that_is_stopped_tells_what_it_measured() {
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    let mut command = Command::new(binaries().join("vitreo"));
    command.args(["replay", "--rate", "0.05", "--log", "replay=debug"]).arg(golden);
    let mut replay = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let lines = BufReader::new(replay.stderr.take().expect("a pipe")).lines().map_while(Result::ok);
    assert_eq!(lines.filter(|line| line.contains("replayed")).take(3).count(), 3, "three frames");
    interrupt(replay.id());
    let done = replay.wait_with_output().expect("it ends");
    assert_eq!(done.status.code(), Some(0));
    let told = String::from_utf8_lossy(&done.stdout).into_owned();
    let speed = told.split(" times real time").next().and_then(|t| t.rsplit('(').next());
    let speed: f64 = speed.and_then(|s| s.parse().ok()).unwrap_or_else(|| panic!("no speed: {told}"));
    assert!(speed < 1.0, "at a twentieth of the speed: {told}");
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

/// The tracker refuses rotations by columns, and `rig check` says that they are.
#[test]
fn the_refusal_of_a_rig_names_the_command_that_explains_it() {
    let folder = tempfile::tempdir().expect("folder");
    let mut rig = rig::Rig::load_or_shipped(None).expect("the shipped rig");
    for camera in &mut rig.cameras {
        let rows = camera.rotation;
        camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| rows[j][i]));
    }
    let file = write(folder.path(), "rig.json", rig.to_json().as_bytes());
    let name = instance_name();
    let defect = "rig.json cannot work: all cameras look from the same side";
    let command = format!("for details: vitreo rig check {file}");
    refused(&["run", "--no-picture", "--instance", &name, "--rig", &file], &[defect, &command]);
    refused(&["rig", "check", &file], &["R of cameras 0, 1 and 2 were transposed"]);
}

#[test]
fn a_stream_of_which_no_field_fits_the_rig_is_no_success() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = std::fs::read(repository().join("assets/rig.json")).expect("rig");
    let rig = write(folder.path(), "rig.json", &rig);
    let field = |cam: u32, seq: u32, parity: u32| {
        let t = 47_008_480 + 20_000_000 * u64::from(seq);
        let out = t + 24_415_695;
        format!(r#"{{"cam":{cam},"seq":{seq},"t_ns":{t},"t_rx_ns":{out},"parity":{parity},"blobs":[]}}"#)
    };
    let misfits: Vec<String> = (0..20).flat_map(|n| [field(7, n, n % 2), field(1, n, 2)]).collect();
    let [out, poses] = ["o.mcap", "p.csv"].map(|name| folder.path().join(name).display().to_string());
    let stream = write(folder.path(), "s.jsonl", misfits.join("\n").as_bytes());
    vitreo(&["import", "--rig", &rig, &stream, "-o", &out]).expect_code(0);
    let told = vitreo(&["replay", &out, "--poses", &poses]).expect_code(1).stderr;
    for named in [
        "o.mcap: none of 40 camera-fields fits the rig",
        "20 fields of cameras that the rig lacks",
        "20 fields of a parity",
    ] {
        assert!(told.contains(named), "{named}: {told}");
    }
    assert!(!folder.path().join("p.csv").exists(), "nothing was tracked");
    // One field that fits is enough for a replay, which counts the others.
    let fitting =
        write(folder.path(), "f.jsonl", [misfits, vec![field(0, 30, 0)]].concat().join("\n").as_bytes());
    vitreo(&["import", "--rig", &rig, &fitting, "-o", &out, "--force"]).expect_code(0);
    let told = vitreo(&["replay", &out]).expect_code(0).stdout;
    assert!(told.contains(" 1 tracker frames") && told.contains("40 camera-fields refused"), "{told}");
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
    vitreo(&["replay", &out, "--lockstep", "--poses", &poses]).expect_code(0);
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

#[test]
fn a_store_that_cannot_be_used_is_named_with_its_reason() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("r.sqlite");
    let store = path.display().to_string();
    refused(&["results", "add", "t7", "none.mcap", "--store", &store], &["none.mcap"]);
    assert!(!path.exists(), "nothing could be added, so no store is made");
    drop(Store::open_or_create(&path).expect("a store"));
    vitreo(&["results", "--store", &store]).expect_code(0);
    let whole = std::fs::read(&path).expect("a store was made");
    let show: [&[&str]; 2] =
        [&["results", "--store", &store], &["results", "delete", "t7", "--store", &store]];
    for args in show {
        // SQLite's file format, 1.3: the version of the schema lies at offset 60, big-endian.
        let mut newer = whole.clone();
        newer[60..64].copy_from_slice(&99_u32.to_be_bytes());
        std::fs::write(&path, newer).expect("written");
        refused(args, &["r.sqlite", "found 99; use the newer vitreo"]);
        for part in [0, 100, whole.len() / 2] {
            std::fs::write(&path, &whole[..part]).expect("written");
            refused(args, &["r.sqlite", "damaged"]);
        }
        std::fs::write(&path, &whole).expect("written");
    }
    // Root may do everything, and can be somebody else.
    let Ok(()) = std::os::unix::fs::chown(&path, Some(1), None) else {
        println!("not root: a store of another user was not tried");
        return;
    };
    let open = std::fs::Permissions::from_mode;
    std::fs::set_permissions(&path, open(0o600)).expect("its mode");
    std::fs::set_permissions(folder.path(), open(0o755)).expect("its mode");
    let mut command = Command::new(binaries().join("vitreo"));
    command.args(["results", "--no-config", "--store", &store]).current_dir("/").uid(65_534);
    match command.output() {
        // Where the build lies in a folder of root's alone.
        Err(problem) => println!("another user may not start {}: {problem}", binaries().display()),
        Ok(output) => {
            let told = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{told}");
            assert!(told.contains("r.sqlite") && told.contains("it belongs to user 1 (mode 0600)"), "{told}");
        }
    }
}

#[test]
fn an_input_that_is_a_pipe_to_which_nobody_writes_is_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let pipe = folder.path().join("rig.json");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    let (pipe, name) = (pipe.display().to_string(), instance_name());
    refused(
        &["run", "--no-picture", "--instance", &name, "--rig", &pipe],
        &["--rig", "no program has written"],
    );
    refused(
        &["calibrate", "pivot", "--poses", &pipe, "--rig", &pipe],
        &["rig.json", "no program has written"],
    );
    refused(&["info", &pipe], &["rig.json", "no program has written"]);
}
