//! `vitreo.h` and the blocks of the Python package are made from the sources: these tests say whether they are
//! current, and `cargo test -p driver --test header renew -- --ignored` renews them.

use cbindgen::{Builder, Config, DocumentationStyle, ExportConfig, Language, ParseConfig};
use protocol::wire::{Kind, Layout};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use vitreo::layout::{BLOCKS, LAYOUT};

/// Numbers of crate `protocol` that a driver needs.
fn constants() -> [(&'static str, u64); 18] {
    use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, WHOLE_FRAME};
    use protocol::health::{STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING, STATE_STARTING};
    use protocol::limits::{
        BODIES, INSTRUMENTS, MAX_BLOBS, MAX_CAMERAS, MAX_FIELDS_USED, OSCILLATORS, TEXT_BYTES,
    };
    use protocol::poses::{COVARIANCE_ENTRIES, EYE};
    [
        ("MAX_BLOBS", MAX_BLOBS as u64),
        ("MAX_CAMERAS", MAX_CAMERAS as u64),
        ("INSTRUMENTS", INSTRUMENTS as u64),
        ("BODIES", BODIES as u64),
        ("MAX_FIELDS_USED", MAX_FIELDS_USED as u64),
        ("OSCILLATORS", OSCILLATORS as u64),
        ("TEXT_BYTES", TEXT_BYTES as u64),
        ("COVARIANCE_ENTRIES", COVARIANCE_ENTRIES as u64),
        ("EYE", EYE as u64),
        ("BLOB_MERGED", BLOB_MERGED.into()),
        ("BLOB_CLIPPED", BLOB_CLIPPED.into()),
        ("BLOB_SATURATED", BLOB_SATURATED.into()),
        ("FORMAT_YCBCR_422", protocol::fields::FORMAT_YCBCR_422.into()),
        ("WHOLE_FRAME", WHOLE_FRAME.into()),
        ("STATE_STARTING", STATE_STARTING.into()),
        ("STATE_RUNNING", STATE_RUNNING.into()),
        ("STATE_DEGRADED", STATE_DEGRADED.into()),
        ("STATE_FINISHED", STATE_FINISHED.into()),
    ]
}

/// Enumerations whose values stand in blocks.
const ENUMS: [&str; 7] = ["PixelFormat", "Colour", "Tool", "PedalMode", "Validity", "BodyStatus", "Process"];
/// Roles of a driver.
const ROLES: [&str; 8] = [
    "SENDS_BLOBS",
    "SENDS_FIELDS",
    "SENDS_HANDLES",
    "SENDS_PEDAL",
    "SENDS_POSES",
    "READS_POSES",
    "READS_EVENTS",
    "READS_HEALTH",
];
const HEAD: &str = "/* Drivers of vitreo: see docs/drivers.md. Made from the sources by cbindgen; do not edit.\n\
    * Units are mm, g, s, rad; instants are ns of CLOCK_MONOTONIC. */";

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

fn header() -> String {
    let mut export = ExportConfig {
        include: BLOCKS.iter().map(|(name, _)| *name).chain(ENUMS).chain(["Code"]).map(Into::into).collect(),
        prefix: Some("Vitreo".into()),
        renaming_overrides_prefixing: true,
        ..ExportConfig::default()
    };
    for name in ROLES.into_iter().chain(constants().map(|(name, _)| name)) {
        export.rename.insert(name.into(), format!("VITREO_{name}"));
    }
    export.include.extend(ROLES.map(Into::into));
    export.rename.insert("Code".into(), "VitreoCode".into());
    let numbers: String =
        constants().iter().map(|(name, value)| format!("\n#define VITREO_{name} {value}")).collect();
    export.rename.insert("Nanos".into(), "VitreoNanos".into());
    let parse =
        ParseConfig { parse_deps: true, include: Some(vec!["protocol".into()]), ..ParseConfig::default() };
    let mut config = Config {
        language: Language::C,
        cpp_compat: true,
        include_guard: Some("VITREO_H".into()),
        header: Some(HEAD.into()),
        after_includes: Some(format!(
            "\n/** The layout of the blocks below, for vitreo_open. */\n#define VITREO_LAYOUT UINT64_C(0x{LAYOUT:016x})\n{numbers}\n"
        )),
        documentation_style: DocumentationStyle::C99,
        usize_is_size_t: true,
        no_includes: true,
        sys_includes: vec!["stddef.h".into(), "stdint.h".into()],
        export,
        parse,
        ..Config::default()
    };
    config.enumeration.prefix_with_name = true;
    config.enumeration.rename_variants = cbindgen::RenameRule::ScreamingSnakeCase;
    config.line_length = 110;
    let mut out = Vec::new();
    Builder::new().with_crate(folder()).with_config(config).generate().expect("a header").write(&mut out);
    // Codes bear the library's name alone.
    String::from_utf8(out).expect("UTF-8").replace("VITREO_CODE_", "VITREO_")
}

/// A kind as ctypes has it.
fn ctype(kind: &Kind) -> String {
    match kind {
        Kind::U8 => "c_uint8".into(),
        Kind::U16 => "c_uint16".into(),
        Kind::U32 => "c_uint32".into(),
        Kind::U64 => "c_uint64".into(),
        Kind::F32 => "c_float".into(),
        Kind::F64 => "c_double".into(),
        Kind::Struct(layout) => name_of(layout).into(),
        Kind::Array(element, count) => format!("{} * {count}", ctype(element)),
    }
}

/// The struct's name in Rust; its message may be called otherwise.
fn name_of(layout: &Layout) -> &'static str {
    BLOCKS.iter().find(|(_, l)| std::ptr::eq(*l, layout) || *l == layout).expect("a struct of the list").0
}

fn python() -> String {
    let head = "\"\"\"The blocks of vitreo as ctypes has them. Made from the sources; do not edit.\"\"\"\n\n\
        from ctypes import Structure, c_double, c_uint8, c_uint32, c_uint64\n";
    let mut text = format!(
        "{head}\n#: Handed to the library, which refuses blocks of another version.\nLAYOUT = 0x{LAYOUT:016x}\n"
    );
    for (name, value) in constants() {
        writeln!(text, "{name} = {value}").expect("a string");
    }
    for (name, layout) in BLOCKS {
        let fields: String = layout
            .fields
            .iter()
            .map(|field| format!("        (\"{}\", {}),\n", field.name, ctype(&field.kind)))
            .collect();
        write!(text, "\n\nclass {name}(Structure):\n    \"\"\"{name}, as in vitreo.h.\"\"\"\n\n    _fields_ = [\n{fields}    ]\n")
            .expect("a string");
    }
    text
}

/// What is made, with where it lies.
fn made() -> [(PathBuf, String); 2] {
    let python_file = folder().join("../python/vitreo/blocks.py");
    [(folder().join("vitreo.h"), header()), (python_file, python())]
}

#[test]
fn header_and_python_blocks_are_current() {
    for (file, text) in made() {
        let there = std::fs::read_to_string(&file).unwrap_or_default();
        let name = file.display();
        assert!(
            there == text,
            "{name}: renew it: cargo test --release -p driver --test header renew -- --ignored"
        );
    }
}

#[test]
#[ignore = "writes the files"]
fn renew() {
    for (file, text) in made() {
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        std::fs::write(file, text).expect("written");
    }
}
