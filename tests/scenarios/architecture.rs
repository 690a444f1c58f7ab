//! Proves the arrows between crates, the borders inside them, and that the map is true.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use vitreo_tests::repository;

const PROCESS_CRATES: [&str; 5] = ["fpga-model", "tracker", "simcore", "renderer", "desk"];
/// Longest source file, lines.
const FILE_CAP: usize = 800;
/// Where `unsafe` may be used: the transport, the vectors of the springs' kernel, and the allocator with which a check counts
/// allocations.
const UNSAFE_ALLOWED: [&str; 3] =
    ["protocol/src/ipc/", "simcore/src/membrane/lanes/", "tracker/tests/any_pose.rs"];

/// Every Rust source of the repository, by path from its root.
fn sources() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let crates = ["protocol", "modules", "results", "launcher", "tests"].into_iter().chain(PROCESS_CRATES);
    for folder in crates {
        collect(&repository().join(folder), &mut found);
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
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
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
    let ours = [
        "protocol",
        "modules",
        "results",
        "fpga-model",
        "desk",
        "tracker",
        "simcore",
        "renderer",
        "launcher",
    ];
    for name in ours {
        let allowed: &[&str] = match name {
            "protocol" => &[],
            "simcore" => &["protocol", "modules"],
            "launcher" => &["protocol", "modules", "results"],
            _ => &["protocol"],
        };
        for dependency in dependencies(&metadata, name) {
            let inside = ours.contains(&dependency.as_str());
            assert!(!inside || allowed.contains(&&*dependency), "{name} must not depend on {dependency}");
        }
    }
}

#[test]
fn transport_and_graphics_stay_behind_their_borders() {
    let metadata = metadata();
    let only: [(&str, &[&str]); 7] = [
        ("iceoryx2", &["protocol"]),
        ("wgpu", &["renderer", "simcore"]),
        ("winit", &["renderer"]),
        ("mcap", &["protocol"]),
        ("evdev", &["desk"]),
        ("rusqlite", &["results"]),
        ("parquet", &["results"]),
    ];
    for (library, owners) in only {
        for name in
            ["protocol", "results", "fpga-model", "desk", "tracker", "simcore", "renderer", "launcher"]
        {
            let has = dependencies(&metadata, name).contains(&library.to_owned());
            assert_eq!(
                has,
                owners.contains(&name),
                "{library} belongs to {owners:?}; found wrong for {name}"
            );
        }
    }
    for (path, text) in sources() {
        let code = code(&text);
        let names = |library: &str| code.contains(&format!("{library}::"));
        assert!(!names("iceoryx2") || path.starts_with("protocol/src/ipc/"), "{path} names iceoryx2");
        assert!(!names("winit") || path.starts_with("renderer/src/present/"), "{path} names winit");
        let graphics = path.starts_with("renderer/") || path.starts_with("simcore/src/collision/gpu/");
        assert!(!names("wgpu") || graphics, "{path} names wgpu");
    }
}

#[test]
fn pure_modules_know_neither_transport_nor_clock() {
    for (path, text) in sources() {
        let Some(krate) =
            PROCESS_CRATES.iter().chain(&["modules"]).find(|c| path.starts_with(&format!("{c}/src/")))
        else {
            continue;
        };
        let inside = &path[krate.len() + 5..];
        let shell = inside.starts_with("process") || inside == "main.rs" || inside == "config.rs";
        // A sub-command is a shell of its own, for a person who waits.
        let shell = shell || inside.starts_with("commands/");
        let presents = inside.starts_with("present/");
        let code = code(text.split("#[cfg(test)]").next().expect("a first part"));
        for forbidden in ["ipc", "SystemTime", "std::env::"] {
            assert!(
                shell || !code.contains(forbidden),
                "{path} uses {forbidden}; only its process shell may"
            );
        }
        for clock in ["time::now(", "now()", "Instant::now"] {
            assert!(shell || presents || !code.contains(clock), "{path} reads a clock; time is an argument");
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
        "deploy/README.md",
        "docs/conventions.md",
        "docs/recording.md",
        "docs/calibration.md",
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
