//! Lists the folders of `assets/modules`, so that a new module is a new folder and nothing else.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    // Asked for when it runs, since a checkout may be moved after this was built.
    let folder = env::var("CARGO_MANIFEST_DIR").expect("CARGO_MANIFEST_DIR");
    let root = Path::new(&folder).join("../../assets/modules");
    println!("cargo:rerun-if-changed={}", root.display());
    let mut names: Vec<String> = fs::read_dir(&root)
        .unwrap_or_else(|e| panic!("{}: {e}", root.display()))
        .flatten()
        .filter(|entry| entry.path().join("module.toml").is_file())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    let mut text = String::from("&[\n");
    for name in names {
        let file = |which: &str| root.join(&name).join(which);
        println!("cargo:rerun-if-changed={}", file("module.toml").display());
        let module = fs::canonicalize(file("module.toml")).expect("module.toml");
        let scene = match fs::canonicalize(file("scene.toml")) {
            Ok(path) => format!("Some(include_str!({path:?}))"),
            Err(_) => "None".into(),
        };
        let _ = writeln!(text, "    ({name:?}, include_str!({module:?}), {scene}),");
    }
    text.push_str("]\n");
    let out = env::var("OUT_DIR").expect("OUT_DIR");
    fs::write(Path::new(&out).join("shipped.rs"), text).expect("shipped.rs");
}
