//! Every field of every block lies where Rust has it, has the same size and kind there, as seen by a C compiler, a C++
//! compiler and Python; and numbers that Rust wrote are read there.

use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::wire::{Kind, Layout};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use vitreo::layout::BLOCKS;

fn drivers() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("drivers").to_owned()
}

/// What a scalar is: letter and bytes.
fn scalar(kind: &Kind) -> String {
    match kind {
        Kind::U8 | Kind::U16 | Kind::U32 | Kind::U64 => format!("u{}", kind.size()),
        Kind::F32 | Kind::F64 => format!("f{}", kind.size()),
        Kind::Array(element, _) => scalar(element),
        Kind::Struct(_) => "s".into(),
    }
}

/// The kind of the first element.
fn is_struct(kind: &Kind) -> bool {
    matches!(kind, Kind::Struct(_)) || matches!(kind, Kind::Array(element, _) if is_struct(element))
}

/// Rust's own account: `Block.field offset size kind`, and each block's size.
fn account() -> String {
    let mut text = String::new();
    for (name, Layout { size, fields, .. }) in BLOCKS {
        for field in *fields {
            let kind = scalar(&field.kind);
            writeln!(text, "{name}.{} {} {} {kind}", field.name, field.offset, field.kind.size()).unwrap();
        }
        writeln!(text, "{name} {size}").unwrap();
    }
    text
}

fn run(program: &mut Command) -> String {
    let name = format!("{program:?}");
    let output = program.output().unwrap_or_else(|e| panic!("{name}: {e}"));
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {told}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// The same account as a program of C or C++.
fn program() -> String {
    let mut text = String::from("#include \"vitreo.h\"\n#include <stdio.h>\nint main(void) {\n");
    for (name, layout) in BLOCKS {
        let block = format!("Vitreo{name}");
        writeln!(text, "  {{ static {block} b; (void)b;").unwrap();
        for field in layout.fields {
            let f = field.name;
            let mut element = format!("b.{f}");
            let mut kind = &field.kind;
            while let Kind::Array(inner, _) = kind {
                element.push_str("[0]");
                kind = inner;
            }
            // A half is 0 in an integer, and 255 wraps to nothing negative in an unsigned one.
            let class = if is_struct(&field.kind) {
                "printf(\"s\\n\");".to_owned()
            } else {
                let probe = format!("{element} = (__typeof__({element}))0.5;");
                let sign = format!("__typeof__({element}) n = 0; n = n - 1;");
                format!(
                    "{{ {probe} {sign} printf(\"%s%zu\\n\", {element} > 0 ? \"f\" : n > 0 ? \"u\" : \"i\", sizeof {element}); }}"
                )
            };
            writeln!(
                text,
                "  printf(\"{name}.{f} %zu %zu \", offsetof({block}, {f}), sizeof b.{f}); {class}"
            )
            .unwrap();
        }
        writeln!(text, "  printf(\"{name} %zu\\n\", sizeof b); }}").unwrap();
    }
    text + "  return 0;\n}\n"
}

#[test]
fn c_and_cpp_see_every_block_as_rust_does() {
    let folder = tempfile::tempdir().expect("folder");
    for (compiler, file, standard) in [("cc", "a.c", "-std=gnu11"), ("c++", "a.cpp", "-std=gnu++17")] {
        let (source, built) = (folder.path().join(file), folder.path().join(format!("{file}.out")));
        std::fs::write(&source, program()).expect("source");
        let header = drivers().join("c");
        run(Command::new(compiler)
            .args([standard, "-Wall", "-Werror", "-I"])
            .arg(header)
            .arg(&source)
            .arg("-o")
            .arg(&built));
        assert_eq!(run(&mut Command::new(&built)), account(), "{compiler}");
    }
}

/// Python's account, and what it reads of a block that Rust wrote.
const PYTHON: &str = r#"
import ctypes, importlib.util, sys
spec = importlib.util.spec_from_file_location("blocks", sys.argv[1])
blocks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(blocks)
def scalar(kind):
    while hasattr(kind, "_length_"):
        kind = kind._type_
    if issubclass(kind, ctypes.Structure):
        return "s"
    letter = "f" if kind in (ctypes.c_float, ctypes.c_double) else "u" if kind(-1).value > 0 else "i"
    return f"{letter}{ctypes.sizeof(kind)}"
for name in sys.argv[3].split(","):
    block = getattr(blocks, name)
    for field, kind in block._fields_:
        place = getattr(block, field)
        print(f"{name}.{field}", place.offset, place.size, scalar(kind))
    print(name, ctypes.sizeof(block))
field = blocks.BlobField.from_buffer_copy(bytes.fromhex(sys.argv[2]))
print(field.field, field.camera, field.count, field.blobs[1].x_px, field.blobs[1].colour)
"#;

#[test]
fn python_sees_every_block_as_rust_does() {
    let mut field = BlobField { field: 1 << 40, camera: 2, count: 2, ..BlobField::zeroed() };
    (field.blobs[1].x_px, field.blobs[1].colour) = (12.25, 7);
    let hex: String = bytemuck::bytes_of(&field).iter().map(|b| format!("{b:02x}")).collect();
    let names: Vec<&str> = BLOCKS.iter().map(|(name, _)| *name).collect();
    let blocks = drivers().join("python/vitreo/blocks.py");
    let seen = run(Command::new("python3").args(["-c", PYTHON]).arg(blocks).args([&hex, &names.join(",")]));
    assert_eq!(seen, format!("{}{} 2 2 12.25 7\n", account(), 1u64 << 40));
}

#[test]
fn the_python_package_is_of_this_version() {
    let project = std::fs::read_to_string(drivers().join("python/pyproject.toml")).expect("pyproject.toml");
    assert!(project.contains(concat!("version = \"", env!("CARGO_PKG_VERSION"), "\"")), "{project}");
}

#[test]
fn the_examples_are_short() {
    for name in ["blobs.c", "blobs.cpp", "blobs.py", "poses.py"] {
        let text = std::fs::read_to_string(drivers().join("examples").join(name)).expect(name);
        assert!(text.lines().count() <= 60, "{name}: more than 60 lines");
    }
}

/// The page for builders.
fn page() -> String {
    std::fs::read_to_string(drivers().join("../docs/drivers.md")).expect("docs/drivers.md")
}

#[test]
fn the_page_has_the_examples_as_they_are() {
    for name in ["blobs.c", "blobs.cpp", "blobs.py"] {
        let text = std::fs::read_to_string(drivers().join("examples").join(name)).expect(name);
        assert!(page().contains(&text), "docs/drivers.md has another {name}");
    }
}

#[test]
fn the_page_names_every_function_and_every_code() {
    let header = std::fs::read_to_string(drivers().join("c/vitreo.h")).expect("vitreo.h");
    let words = header.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let functions = words.filter(|word| word.starts_with("vitreo_"));
    let codes = header.lines().filter_map(|line| line.trim().strip_suffix(',')?.split_once(" = "));
    // Roles, colours and the like have longer names.
    let codes = codes.filter(|(_, value)| value.starts_with('-')).map(|(name, _)| name);
    let page = page();
    let mut seen = 0;
    for name in functions.chain(codes) {
        assert!(page.contains(&format!("`{name}`")), "docs/drivers.md lacks {name}");
        seen += 1;
    }
    assert!(seen > 30, "only {seen} names");
}
