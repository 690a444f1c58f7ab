//! `vitreo.toml` from the files to what the programs do: which file wins, what is reported of a wrong one,
//! and what `vitreo config` says; also how `-v` reaches the processes of a run.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use vitreo_tests::{binaries, instance_name, vitreo};

/// A user whose own files lie in `home`, at work in `here`.
struct User<'a> {
    home: &'a Path,
    here: &'a Path,
}

impl User<'_> {
    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(binaries().join("vitreo"));
        command.args(args).current_dir(self.here).stdin(Stdio::null());
        command.env("HOME", self.home).env_remove("XDG_CONFIG_HOME").env_remove("RUST_LOG");
        command
    }

    fn run(&self, args: &[&str]) -> (Option<i32>, String, String) {
        told(self.command(args).output().expect("vitreo starts"))
    }
}

fn told(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn the_folder_wins_over_the_user_and_the_command_line_over_both() {
    let (home, here) = (tempfile::tempdir().expect("home"), tempfile::tempdir().expect("folder"));
    let user = User { home: home.path(), here: here.path() };
    // A new file sets nothing.
    assert_eq!(user.run(&["config", "init"]).0, Some(0));
    let own = home.path().join(".config/vitreo/vitreo.toml");
    let all = std::fs::read_to_string(&own).expect("written");
    for part in [
        "[run]",
        "[results.delete]",
        "[blobs]",
        "[calibrate.drift]",
        "[bench.render]",
        "[colours.learn]",
        "[commission.lenses]",
    ] {
        assert!(all.contains(part), "{part} is missing");
    }
    let again = user.run(&["config", "init"]);
    assert!(again.0 == Some(1) && again.2.contains("--force"), "{again:?}");
    std::fs::write(&own, "[modules]\njson = true\n[run]\nseed = 5\n").expect("written");
    assert!(user.run(&["modules"]).1.starts_with('{'), "the user's file");
    std::fs::write(here.path().join("vitreo.toml"), "[modules]\njson = false\n[run]\nseed = 6\n")
        .expect("written");
    assert!(!user.run(&["modules"]).1.starts_with('{'), "the folder's file");
    assert!(user.run(&["modules", "--json"]).1.starts_with('{'), "the command line");
    let (code, listed, _) =
        user.command(&["config", "--json"]).env("RUST_LOG", "debug").output().map(told).expect("ran");
    assert_eq!(code, Some(0));
    let settings: Vec<Value> = serde_json::from_str(&listed).expect("JSON");
    let of = |table: &str, key: &str| {
        settings
            .iter()
            .find(|s| s["table"] == table && s["key"] == key)
            .unwrap_or_else(|| panic!("{table} {key}"))
    };
    assert_eq!((&of("run", "seed")["value"], &of("run", "seed")["line"]), (&"6".into(), &4.into()));
    assert_eq!(
        (&of("run", "level")["from"], &of("", "log")["variable"]),
        (&"default".into(), &"RUST_LOG".into())
    );
    assert_eq!(of("calibrate.intrinsics", "loss")["from"], "default");
    let paths = user.run(&["config", "path"]).1;
    assert_eq!(paths.lines().nth(1).map(Path::new), Some(own.as_path()), "{paths}");
}

#[test]
fn a_wrong_file_is_told_by_whichever_program_reads_it() {
    let (home, here) = (tempfile::tempdir().expect("home"), tempfile::tempdir().expect("folder"));
    let user = User { home: home.path(), here: here.path() };
    let file = here.path().join("vitreo.toml");
    for (text, args, parts) in [
        (
            "[run]\nlevle = 2\n",
            &["info", "a.mcap"][..],
            &["vitreo.toml: line 2: [run] levle", "did you mean level?"][..],
        ),
        (
            "[blobs]\nouptut = \"x\"\n",
            &["blobs", "a.png"],
            &["line 2: [blobs] ouptut", "did you mean output?"],
        ),
        ("[calibrate.drift]\nstreem = 1\n", &["calibrate", "drift", "a"], &["[calibrate.drift] streem"]),
        ("[bench.render]\ntier = 99\n", &["bench", "render"], &["[bench.render] tier: expected", "99"]),
    ] {
        std::fs::write(&file, text).expect("written");
        let (code, _, problem) = user.run(args);
        assert_eq!(code, Some(2), "{problem}");
        parts.iter().for_each(|part| assert!(problem.contains(part), "{part} is missing: {problem}"));
        let json = user.run(&[&["--log-format", "json"], args].concat()).2;
        let line: Value = serde_json::from_str(&json).unwrap_or_else(|e| panic!("{e} in: {json}"));
        assert_eq!(line["level"], "ERROR");
    }
    // A table of another program is that program's to judge, until all are shown.
    std::fs::write(&file, "[blobs]\nouptut = \"x\"\n").expect("written");
    assert_eq!(user.run(&["modules"]).0, Some(0));
    assert!(
        user.run(&["config"])
            .2
            .contains("line 2: [blobs] ouptut: expected an option that vitreo blobs takes")
    );
    // What helps to mend the file works, and so does every command without it.
    std::fs::write(&file, "[run]\nlevle = 2\n").expect("written");
    for args in
        [&["config", "path"][..], &["completions", "bash"], &["run", "--help"], &["--no-config", "modules"]]
    {
        assert_eq!(user.run(args).0, Some(0), "{args:?}");
    }
}

#[test]
fn v_reaches_the_processes_and_the_variable_wins() {
    let run = |extra: &[&str]| {
        let name = instance_name();
        let args = ["run", "--direct", "--no-picture", "--duration", "1", "--instance", &name];
        vitreo(&[&args[..], &["--log-format", "json"], extra].concat()).expect_code(0).stderr
    };
    let quiet_records = |text: &str| {
        let records = text.lines().filter_map(|l| serde_json::from_str::<Value>(l).ok());
        let below_warn = |r: &Value| matches!(r["level"].as_str(), Some("INFO" | "DEBUG" | "TRACE"));
        // What the launcher says to a person is no record; it bears its name.
        records.filter(|r| below_warn(r) && r["process"] != "launcher").count()
    };
    assert!(quiet_records(&run(&["-vv"])) > 0, "records of the processes");
    assert_eq!(quiet_records(&run(&[])), 0);
    let name = instance_name();
    let home = tempfile::tempdir().expect("home");
    let user = User { home: home.path(), here: home.path() };
    let args = [
        "run",
        "--direct",
        "--no-picture",
        "--duration",
        "1",
        "--instance",
        &name,
        "-vv",
        "--log-format",
        "json",
    ];
    let (code, _, text) = user.command(&args).env("RUST_LOG", "error").output().map(told).expect("ran");
    assert_eq!((code, quiet_records(&text)), (Some(0), 0), "{text}");
}
