//! What is packed: one version, every program, files that exist, options that the commands take.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use vitreo_tests::{Watchdog, repository};

fn read(path: &str) -> String {
    std::fs::read_to_string(repository().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

fn manifest(path: &str) -> toml::Table {
    read(path).parse().unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// The folders of all crates.
fn members() -> Vec<String> {
    let workspace = manifest("Cargo.toml");
    let members = workspace["workspace"]["members"].as_array().expect("members").clone();
    members.iter().map(|m| m.as_str().expect("a folder").to_owned()).collect()
}

#[test]
fn the_version_is_said_in_one_place() {
    let workspace = manifest("Cargo.toml");
    let version = workspace["workspace"]["package"]["version"].as_str().expect("a version").to_owned();
    for crate_folder in members() {
        let crate_manifest = manifest(&format!("{crate_folder}/Cargo.toml"));
        let own = &crate_manifest["package"]["version"];
        assert!(own.as_str().is_none(), "{crate_folder} has a version of its own: {own}");
    }
    let changelog = read("CHANGELOG.md");
    let heads: Vec<&str> = changelog.lines().filter_map(|l| l.strip_prefix("## ")).collect();
    assert_eq!(heads[0], "Unreleased");
    assert_eq!(heads[1].split(" - ").next(), Some(version.as_str()), "the newest section of CHANGELOG.md");
    assert!(
        read("packaging/deploy/kubernetes-score.yaml").contains(&format!("vitreo:{version}\n")),
        "the image"
    );
}

/// Year, month and day of an entry's last line.
fn date_of(line: &str) -> Option<(u32, usize, u32)> {
    const MONTHS: &str = "JanFebMarAprMayJunJulAugSepOctNovDec";
    let (_, date) = line.strip_prefix(" -- ")?.split_once(", ")?;
    let words: Vec<&str> = date.split(' ').collect();
    Some((words[2].parse().ok()?, MONTHS.find(words[1])?, words[0].parse().ok()?))
}

#[test]
fn the_changelog_of_debian_is_made_of_ours() {
    let version = env!("CARGO_PKG_VERSION");
    let mut script = Command::new("python3");
    script.arg("packaging/debian-changelog").args([version, "0"]).current_dir(repository());
    let output = script.output().expect("python3");
    let text = String::from_utf8(output.stdout).expect("text");
    let head = format!("vitreo ({version}-1) unstable; urgency=medium\n\n  * ");
    assert!(text.starts_with(&head), "{text:.200}");
    let dates: Vec<(u32, usize, u32)> = text.lines().filter_map(date_of).collect();
    assert!(dates.len() > 1 && dates.is_sorted_by(|newer, older| newer > older), "{dates:?}");
    let entries = text.lines().filter(|l| l.starts_with("vitreo (")).count();
    let versions = read("CHANGELOG.md").lines().filter(|l| l.starts_with("## ")).count();
    assert_eq!(entries, versions - 1, "what is unreleased belongs to the version");
    let items = text.lines().filter(|l| !l.starts_with(" -- "));
    items.for_each(|l| assert!(l.chars().count() <= 79, "a long line: {l}"));
}

#[test]
fn every_program_is_installed_and_every_packed_file_exists() {
    let makefile = read("Makefile");
    let start = makefile.find("INSTALLED = ").expect("the list");
    let listed = makefile[start..].replace("\\\n", " ");
    let listed = listed.lines().next().expect("a line").to_owned();
    for folder in members().iter().filter(|m| !m.starts_with("proofs/") && *m != "tests") {
        let bins = manifest(&format!("{folder}/Cargo.toml"));
        for bin in bins.get("bin").and_then(|b| b.as_array()).into_iter().flatten() {
            let name = bin["name"].as_str().expect("a name");
            assert!(
                listed.split(|c: char| c.is_whitespace() || ",)".contains(c)).any(|word| word == name),
                "{name} is not installed"
            );
        }
    }
    let launcher = manifest("apps/launcher/Cargo.toml");
    let deb = &launcher["package"]["metadata"]["deb"];
    let sources = deb["assets"].as_array().expect("assets").iter().map(|a| a[0].as_str().expect("a file"));
    let committed: Vec<&str> = sources.filter(|s| !s.contains("/target/")).collect();
    assert!(committed.len() >= 5, "{committed:?}");
    for file in committed {
        assert!(repository().join("apps/launcher").join(file).is_file(), "{file} does not exist");
    }
}

/// What links to the library asks for its SONAME: a package with the other name alone has a link to nothing.
#[test]
fn the_library_is_packed_under_the_name_that_programs_ask_for() {
    let makefile = read("Makefile");
    let soname = makefile.lines().find_map(|line| line.strip_prefix("SONAME := ")).expect("a SONAME");
    let launcher = manifest("apps/launcher/Cargo.toml");
    let assets = launcher["package"]["metadata"]["deb"]["assets"].as_array().expect("assets");
    let packed: Vec<&str> = assets.iter().map(|a| a[0].as_str().expect("a file")).collect();
    for name in [soname, "libvitreo.so"] {
        let path = format!("../../target/package/usr/lib/{name}");
        assert!(packed.contains(&path.as_str()), "{name} is not packed: {packed:?}");
    }
}

/// The test of the booted service waits for these words in the journal.
#[test]
fn the_test_of_the_service_waits_for_what_a_run_says() {
    let said = "waiting to start: ";
    assert!(read("apps/launcher/src/run/cameras.rs").contains(said));
    for file in ["packaging/tools/test-service-inside", "docs/install.md"] {
        assert!(read(file).contains(said), "{file}");
    }
}

#[test]
fn the_service_asks_for_what_its_document_says() {
    let unit = read("packaging/systemd/vitreo-rig.service");
    for line in [
        "ExecStart=/usr/bin/vitreo run --instance rig --unscripted",
        "RestartPreventExitStatus=2",
        "User=vitreo",
        "LimitRTPRIO=50",
        "LimitNICE=-5",
        "LimitMEMLOCK=infinity",
    ] {
        assert!(unit.lines().any(|l| l == line), "{line} is missing");
    }
    // The one with a picture is the same, but for what the display needs.
    let display = read("packaging/systemd/vitreo-rig-display.service");
    let shown = "ExecStart=/usr/lib/vitreo/rig-display";
    let of_both = unit.lines().filter(|l| {
        !["Description=", "ExecStart=", "WantedBy=", "ProtectHome=", "ReadWritePaths=", "#"]
            .iter()
            .any(|w| l.starts_with(w))
    });
    for line in of_both.chain([shown, "Conflicts=vitreo-rig.service getty@tty1.service"]) {
        assert!(display.lines().any(|l| l == line), "{line} is missing from the service with a display");
    }
    let page = read("docs/install.md");
    assert!(page.contains("--instance rig") && page.contains("/var/lib/vitreo"));
    for script in ["postinst", "postrm"] {
        let text = read(&format!("packaging/debian/{script}"));
        let code: Vec<&str> = text.lines().filter(|l| !l.starts_with('#') || *l == "#DEBHELPER#").collect();
        assert!(code.contains(&"#DEBHELPER#"), "{script}");
        assert!(
            code.iter().all(|l| !l.contains("rm ") && !l.contains("deluser")),
            "{script} takes something away"
        );
    }
}

/// Runs `packaging/rig-display` with programs in the place of cage and vitreo: the one hands no exit code on, as
/// cage 0.1.4, the other does `run`. With `stop` it is asked to stop once that has begun.
fn on_a_display(run: &str, stop: bool) -> Option<i32> {
    let folder = tempfile::tempdir().expect("folder");
    let file = |name: &str| folder.path().join(name);
    let program = |name: &str, text: &str| {
        std::fs::write(file(name), format!("#!/bin/sh\n{text}\n")).expect("written");
        std::fs::set_permissions(file(name), Permissions::from_mode(0o755)).expect("made a program");
    };
    program("cage", "shift 2; \"$@\"; exit 0");
    program("vitreo", &format!("begun={}\n{run}", file("begun").display()));
    let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").expect("a path"));
    let script = repository().join("packaging/rig-display");
    let mut child = Command::new(script).env("PATH", path).spawn().expect("a shell");
    let watchdog = Watchdog::on(child.id());
    if stop {
        while !file("begun").exists() && child.try_wait().expect("asked").is_none() {
            std::thread::yield_now();
        }
        let pid = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).expect("signalled");
    }
    let code = child.wait().expect("it ends").code();
    assert!(!watchdog.barked(), "it hung");
    code
}

#[test]
fn a_rig_on_a_display_ends_with_the_code_of_its_simulator_and_stops_in_order() {
    assert_eq!(on_a_display("exit 2", false), Some(2));
    assert_eq!(on_a_display("[ \"$*\" = 'run --instance rig --unscripted --full-screen' ]", false), Some(0));
    // Ends once it is asked to, with a loss that it reported.
    let until_asked = "trap 'exit 3' TERM; >$begun; while :; do sleep 0.01; done";
    assert_eq!(on_a_display(until_asked, true), Some(3));
}
