//! Proves the arrows between crates, the borders inside them, and that the map is true.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use vitreo_tests::repository;

/// Our crates and those of ours that each may depend on. An arrow that is not here does not exist.
const ARROWS: &[(&str, &[&str])] = &[
    ("protocol-derive", &[]),
    ("protocol", &["protocol-derive"]),
    ("ipc", &["protocol", "outputs"]),
    ("rig", &["protocol"]),
    ("scene", &["protocol"]),
    ("recording", &["protocol", "rig"]),
    ("blob-stream", &["protocol"]),
    ("font", &[]),
    ("outputs", &[]),
    ("plots", &["font", "outputs"]),
    ("settings", &["protocol", "outputs"]),
    ("surgeon", &["protocol", "rig", "scene"]),
    ("training", &["protocol", "scene"]),
    ("collision", &["protocol", "scene"]),
    ("tissue", &["protocol", "scene", "collision"]),
    ("simcore", &["protocol", "ipc", "settings", "scene", "training", "collision", "tissue"]),
    (
        "replay",
        &[
            "protocol",
            "ipc",
            "outputs",
            "rig",
            "settings",
            "scene",
            "recording",
            "blob-stream",
            "surgeon",
            "training",
            "collision",
            "simcore",
            "tracker",
            "calibration",
            "diagnosis",
            "renderer",
            "plots",
            "results",
        ],
    ),
    ("virtual-rig", &["protocol", "ipc", "outputs", "rig", "settings", "scene", "surgeon", "blob-stream"]),
    ("fpga-model", &["protocol", "ipc", "outputs", "rig", "settings", "recording", "blob-stream"]),
    ("tracker", &["protocol", "ipc", "rig", "settings"]),
    ("diagnosis", &["protocol", "rig"]),
    (
        "calibration",
        &[
            "protocol",
            "ipc",
            "outputs",
            "plots",
            "rig",
            "settings",
            "recording",
            "blob-stream",
            "fpga-model",
            "tracker",
        ],
    ),
    ("renderer", &["protocol", "ipc", "outputs", "rig", "settings", "scene", "font"]),
    ("results", &["protocol", "outputs", "plots", "recording", "scene", "training"]),
    ("desk", &["protocol", "ipc", "rig", "settings", "scene"]),
    ("driver", &["protocol", "ipc"]),
    (
        "commission",
        &[
            "protocol",
            "ipc",
            "outputs",
            "plots",
            "rig",
            "settings",
            "blob-stream",
            "fpga-model",
            "tracker",
            "calibration",
            "cameras",
        ],
    ),
    (
        "cameras",
        &[
            "protocol",
            "ipc",
            "outputs",
            "rig",
            "scene",
            "settings",
            "recording",
            "surgeon",
            "virtual-rig",
            "fpga-model",
        ],
    ),
    ("controls", &["protocol", "ipc", "outputs", "rig", "settings", "scene"]),
    ("igtl", &[]),
    ("bridge", &["protocol", "ipc", "outputs", "settings", "recording", "igtl", "driver"]),
    (
        "launcher",
        &[
            "protocol",
            "ipc",
            "outputs",
            "plots",
            "rig",
            "settings",
            "scene",
            "recording",
            "blob-stream",
            "diagnosis",
            "surgeon",
            "training",
            "results",
        ],
    ),
];
/// Crates that are in no product: they may depend on everything.
const PROOFS: [&str; 4] = ["validation", "fuzz", "vitreo-tests", "skips"];
/// Crates that compute: no transport, no clock, no environment.
const PURE: [&str; 10] =
    ["igtl", "protocol", "rig", "scene", "surgeon", "training", "collision", "tissue", "font", "diagnosis"];
/// Crates of a process: their shell alone knows transport and clock.
const PROCESSES: [&str; 8] =
    ["fpga-model", "virtual-rig", "cameras", "controls", "tracker", "simcore", "renderer", "desk"];
/// What a crate must not reach, by whatever way.
const UNREACHABLE: &[(&str, &[&str])] = &[
    ("tracker", &["mcap", "prost", "image", "surgeon", "scene", "recording"]),
    ("simcore", &["mcap", "prost", "surgeon", "recording"]),
    ("renderer", &["mcap", "prost", "surgeon", "recording"]),
    ("fpga-model", &["scene", "surgeon"]),
    ("collision", &["iceoryx2", "ipc", "rustix"]),
    ("tissue", &["iceoryx2", "ipc", "rustix"]),
    ("scene", &["iceoryx2", "ipc"]),
    ("surgeon", &["iceoryx2", "ipc"]),
    ("training", &["iceoryx2", "ipc"]),
    ("launcher", &["wgpu", "iced", "simcore", "tracker", "renderer"]),
];
/// Libraries that belong to some of our crates alone.
const OWNERS: &[(&str, &[&str])] = &[
    ("iceoryx2", &["ipc"]),
    ("wgpu", &["renderer", "collision"]),
    ("winit", &["renderer"]),
    ("softbuffer", &["renderer"]),
    ("mcap", &["recording"]),
    ("bincode", &["simcore", "tracker"]),
    ("crossterm", &["replay"]),
    ("evdev", &["desk", "controls"]),
    ("quick-xml", &["replay"]),
    ("rusqlite", &["results"]),
    ("parquet", &["results"]),
    ("plotters", &["plots", "calibration", "replay", "results"]),
    ("openh264", &["renderer"]),
    ("mp4-atom", &["renderer"]),
    ("swash", &["font"]),
    ("tokio", &["launcher", "replay", "bridge"]),
    ("object_store", &["replay"]),
    ("futures-util", &["replay"]),
    ("foxglove", &["recording", "bridge"]),
];
/// Folders of crates that ship with nothing.
const PROOF_FOLDERS: [&str; 2] = ["proofs/", "tests/"];
/// Where files are made besides: in the private directory of an instance, in memory, and a recording
/// on a file that is there.
const WRITERS: [&str; 6] = [
    "libs/outputs/src/",
    "protocol/ipc/src/",
    "drivers/c/src/seats.rs",
    "apps/launcher/src/children",
    "libs/recording/src/write.rs",
    "apps/virtual-rig/src/process/kept.rs",
];
/// Longest source file, lines.
const FILE_CAP: usize = 500;
/// Where `unsafe` may be used: the transport, the stream of buffers of a camera's driver, what C calls, the vectors of the springs' kernel, and the allocator
/// with which a check counts allocations.
const UNSAFE_ALLOWED: [&str; 8] = [
    "protocol/ipc/",
    "apps/cameras/src/device/genicam/samples.rs",
    "apps/cameras/src/device/ioctl.rs",
    "drivers/c/src/ffi",
    "renderer/src/present/feedback/wayland.rs",
    "simcore/tissue/src/sheet/simd",
    "tracker/tests/any_pose.rs",
    "proofs/fuzz/src/coverage.rs",
];

/// Every Rust source of the repository, by path from its root.
fn sources() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for package in metadata()["packages"].as_array().expect("packages") {
        let manifest = Path::new(package["manifest_path"].as_str().expect("path"));
        for part in ["src", "tests", "examples", "benches", "scenarios"] {
            let folder = manifest.parent().expect("folder").join(part);
            if folder.is_dir() {
                collect(&folder, &mut found);
            }
        }
    }
    assert!(found.len() > 40, "sources are where they are expected");
    found
}

fn collect(folder: &Path, found: &mut BTreeMap<String, String>) {
    for entry in std::fs::read_dir(folder).expect("folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            collect(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let name = path.strip_prefix(repository()).expect("inside").display().to_string();
            found.insert(name, std::fs::read_to_string(&path).expect("readable"));
        }
    }
}

/// Code of a source without its comments.
fn code(text: &str) -> String {
    text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

fn metadata() -> serde_json::Value {
    cargo_metadata(&["--no-deps"])
}

fn cargo_metadata(options: &[&str]) -> serde_json::Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--offline"])
        .args(options)
        .current_dir(repository())
        .output()
        .expect("cargo metadata");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Direct dependencies of a crate, normal and build.
fn dependencies(metadata: &serde_json::Value, name: &str) -> Vec<String> {
    let packages = metadata["packages"].as_array().expect("packages");
    let package = packages.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("crate {name}"));
    let all = package["dependencies"].as_array().expect("dependencies").iter();
    all.filter(|d| d["kind"] != "dev").map(|d| d["name"].as_str().expect("name").to_owned()).collect()
}

#[test]
fn crates_point_downwards_only() {
    let metadata = metadata();
    let packages = metadata["packages"].as_array().expect("packages");
    let ours: Vec<&str> = packages.iter().map(|p| p["name"].as_str().expect("name")).collect();
    for name in &ours {
        if PROOFS.contains(name) {
            continue;
        }
        let allowed = ARROWS.iter().find(|(n, _)| n == name).map(|(_, to)| *to);
        let allowed = allowed.unwrap_or_else(|| panic!("{name} is not in the table of arrows"));
        for dependency in dependencies(&metadata, name) {
            let inside = ours.contains(&dependency.as_str());
            assert!(!inside || allowed.contains(&&*dependency), "{name} must not depend on {dependency}");
        }
        for arrow in allowed {
            let there = dependencies(&metadata, name).iter().any(|d| d == arrow);
            assert!(there, "{name} does not depend on {arrow}: take the arrow out of the table");
        }
    }
    assert_eq!(ours.len(), ARROWS.len() + PROOFS.len(), "every crate of the table exists");
}

/// `make test` builds unit tests with the settings of `tests/checked.toml`, which have to name every crate.
#[test]
fn unit_tests_of_every_crate_stop_at_an_overflow() {
    let text = std::fs::read_to_string(repository().join("tests/checked.toml")).expect("tests/checked.toml");
    let checked: toml::Table = toml::from_str(&text).expect("TOML");
    let checked = checked["profile"]["release"]["package"].as_table().expect("packages");
    let on = |settings: &toml::Value, key: &str| settings.get(key) == Some(&toml::Value::Boolean(true));
    for (name, settings) in checked {
        assert!(on(settings, "debug-assertions") && on(settings, "overflow-checks"), "{name}: {settings}");
    }
    // Derive macros run in the compiler only.
    let crates = ARROWS.iter().map(|(name, _)| *name).chain(PROOFS.iter().copied());
    let crates: BTreeSet<&str> = crates.filter(|name| *name != "protocol-derive").collect();
    assert_eq!(crates, checked.keys().map(String::as_str).collect());
}

/// Every package that a crate reaches by normal and build dependencies.
fn reached(metadata: &serde_json::Value, name: &str) -> BTreeSet<String> {
    let nodes: BTreeMap<&str, &serde_json::Value> = metadata["resolve"]["nodes"]
        .as_array()
        .expect("nodes")
        .iter()
        .map(|n| (n["id"].as_str().expect("id"), n))
        .collect();
    let names: BTreeMap<&str, &str> = metadata["packages"]
        .as_array()
        .expect("packages")
        .iter()
        .map(|p| (p["id"].as_str().expect("id"), p["name"].as_str().expect("name")))
        .collect();
    let root = names.iter().find(|(_, n)| **n == name).unwrap_or_else(|| panic!("crate {name}")).0;
    let (mut found, mut open) = (BTreeSet::new(), vec![*root]);
    while let Some(id) = open.pop() {
        for dependency in nodes[id]["deps"].as_array().expect("deps") {
            let kinds = dependency["dep_kinds"].as_array().expect("kinds");
            let id = dependency["pkg"].as_str().expect("id");
            if kinds.iter().any(|k| k["kind"] != "dev") && found.insert(id) {
                open.push(id);
            }
        }
    }
    found.into_iter().map(|id| names[id].to_owned()).collect()
}

#[test]
fn what_a_crate_must_not_link_it_does_not_reach() {
    let metadata = cargo_metadata(&["--filter-platform", "x86_64-unknown-linux-gnu"]);
    for (name, forbidden) in UNREACHABLE {
        let reached = reached(&metadata, name);
        assert!(name == &"font" || reached.len() > 3, "{name}: {reached:?}");
        for library in *forbidden {
            assert!(!reached.contains(*library), "{name} reaches {library}");
        }
    }
    for (name, _) in ARROWS {
        let reached = reached(&metadata, name);
        assert!(PROOFS.iter().all(|p| !reached.contains(*p)), "{name} reaches what only proves");
    }
}

#[test]
fn libraries_stay_behind_their_borders() {
    let metadata = metadata();
    for (library, owners) in OWNERS {
        for (name, _) in ARROWS {
            let has = dependencies(&metadata, name).iter().any(|d| d == library);
            assert_eq!(has, owners.contains(name), "{library} belongs to {owners:?}; found wrong for {name}");
        }
    }
    for (path, text) in sources() {
        let code = code(&text);
        let names = |library: &str| code.contains(&format!("{library}::"));
        assert!(!names("winit") || path.starts_with("renderer/src/present/"), "{path} names winit");
        let graphics = path.starts_with("renderer/") || path.starts_with("simcore/collision/src/gpu");
        assert!(!names("wgpu") || graphics, "{path} names wgpu");
    }
}

#[test]
fn pure_modules_know_neither_transport_nor_clock() {
    for (path, text) in sources() {
        let owner = |names: &[&str]| names.iter().any(|c| path.contains(&format!("{c}/src/")));
        let (pure, process) = (owner(&PURE), owner(&PROCESSES));
        if !pure && !process {
            continue;
        }
        let inside = path.split("/src/").nth(1).expect("a path in src");
        // A sub-command is a shell of its own, for a person who waits.
        let shells = ["process", "main.rs", "config.rs", "commands"];
        let shell = process && shells.iter().any(|s| inside.starts_with(s));
        let presents = inside.starts_with("present");
        let code = code(text.split("#[cfg(test)]").next().expect("a first part"));
        for forbidden in ["ipc::", "SystemTime", "std::env::"] {
            assert!(
                shell || !code.contains(forbidden),
                "{path} uses {forbidden}; only its process shell may"
            );
        }
        for clock in ["now()", "Instant::now"] {
            assert!(shell || presents || !code.contains(clock), "{path} reads a clock; time is an argument");
        }
    }
}

#[test]
fn files_come_into_being_in_one_crate() {
    let making = ["File::create", "File::options", "fs::write(", "OpenOptions", "fs::rename", "fs::copy("];
    for (path, text) in sources() {
        let product = path.contains("/src/") && !PROOF_FOLDERS.iter().any(|folder| path.starts_with(folder));
        let tests = path.ends_with("tests.rs") || path.contains("/tests/");
        if !product || tests || WRITERS.iter().any(|w| path.starts_with(w)) {
            continue;
        }
        let checks = ["#[cfg(test)]\nmod ", "#[cfg(test)]\npub(crate) mod "];
        let ends = checks.iter().filter_map(|mark| text.find(mark)).min();
        let code = code(&text[..ends.unwrap_or(text.len())]);
        for word in making {
            assert!(!code.contains(word), "{path} has {word}; what a command writes goes through outputs");
        }
    }
}

#[test]
fn unsafe_code_is_where_it_is_allowed() {
    for (path, text) in sources() {
        let used = code(&text).lines().any(|l| l.contains("unsafe {") || l.contains("unsafe impl"));
        let allowed = UNSAFE_ALLOWED.iter().any(|a| path.starts_with(a)) || path.starts_with("tests/");
        assert!(!used || allowed, "{path} has unsafe code");
        let bare = text.match_indices("unsafe {").filter(|(at, _)| {
            let before = &text[..*at];
            let lines: Vec<&str> = before.lines().rev().take(5).collect();
            !lines.iter().any(|l| l.contains("SAFETY"))
        });
        assert!(path.starts_with("tests/") || bare.count() == 0, "{path}: unsafe without a SAFETY comment");
    }
}

#[test]
fn every_module_says_what_it_is_and_stays_readable() {
    for (path, text) in sources() {
        assert!(text.trim_start().starts_with("//!"), "{path} lacks its opening doc");
        let lines = text.lines().count();
        assert!(lines <= FILE_CAP, "{path} has {lines} lines, more than {FILE_CAP}");
    }
}

#[test]
fn paths_named_in_the_documents_exist() {
    for document in [
        "ARCHITECTURE.md",
        "README.md",
        "docs/modules.md",
        "docs/play.md",
        "docs/results.md",
        "packaging/deploy/README.md",
        "docs/conventions.md",
        "docs/recording.md",
        "docs/calibration.md",
        "docs/commission.md",
        "docs/configuration.md",
        "docs/install.md",
        "docs/cameras.md",
    ] {
        let text = std::fs::read_to_string(repository().join(document)).expect(document);
        let mut named = 0;
        for word in text.split('`').skip(1).step_by(2) {
            let looks_like_a_path =
                word.contains('/') && !word.contains(' ') && !word.contains(['<', '*', '$', '~']);
            let first = word.split('/').next().unwrap_or("");
            if looks_like_a_path
                && repository().join(first).exists()
                && !matches!(first, "out" | "target" | "" | "..")
            {
                named += 1;
                let path: PathBuf = repository().join(word.split([':', '#']).next().unwrap_or(word));
                assert!(path.exists(), "{document} names {word}, which does not exist");
            }
        }
        assert!(named > 0 || document != "ARCHITECTURE.md", "{document} names no path");
    }
}
