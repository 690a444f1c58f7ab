//! Protobuf descriptors of the messages, which a recording carries as their schemas.
//!
//! Made from the layouts of the blocks; numbers are those of Google's `descriptor.proto`.

use super::pixels::{self, PIXELS_TAG};
use super::protobuf::{put_bytes, put_message, put_present};
use super::{LAYOUTS, NOTE};
use protocol::wire::{Field, Kind, Layout, Role};

/// Name of a heartbeat's message, and its fields in the order of their numbers.
pub(super) const HEALTH: &str = "Health";
const HEALTH_FIELDS: [&str; 10] =
    ["instant_ns", "process", "pid", "state", "text", "received", "sent", "lost", "refused", "cpu_ns"];

/// Protobuf package of the messages.
pub(super) const PACKAGE: &str = "vitreo";

const DOUBLE: u64 = 1;
const FLOAT: u64 = 2;
const UINT64: u64 = 4;
const FIXED64: u64 = 6;
const STRING: u64 = 9;
const MESSAGE: u64 = 11;
const BYTES: u64 = 12;
const UINT32: u64 = 13;
const ENUM: u64 = 14;

/// What a field's descriptor says.
struct Descriptor<'a> {
    name: &'a str,
    number: u32,
    repeated: bool,
    /// One of the constants above.
    kind: u64,
    /// Name of the message or enum in the package.
    type_name: Option<&'a str>,
}

/// The encoded `FileDescriptorSet` of one file with the message of a topic, and with those that it consists of.
/// All messages in each schema would be nine tenths of a short recording.
pub(super) fn file_descriptor_set(topic: usize) -> Vec<u8> {
    match LAYOUTS[topic] {
        Some(layout) => file_of(|out| put_layout(out, layout, &mut Vec::new())),
        None => file_of(put_note),
    }
}

/// As [`file_descriptor_set`], of the heartbeats, which are in no recording.
pub(super) fn file_of_health() -> Vec<u8> {
    file_of(|out| {
        let kinds = [UINT64, STRING, UINT32, UINT32, STRING, UINT64, UINT64, UINT64, UINT64, UINT64];
        let fields = HEALTH_FIELDS.into_iter().zip(kinds).zip(1..);
        let field =
            |((name, kind), number)| Descriptor { name, number, repeated: false, kind, type_name: None };
        let fields: Vec<Descriptor<'_>> = fields.map(field).collect();
        put_message(out, 4, |out| put_fields(out, HEALTH, &fields));
    })
}

/// A file of messages, which `put` appends.
fn file_of(put: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut out = Vec::new();
    put_message(&mut out, 1, |out| {
        put_bytes(out, 1, b"vitreo.proto");
        put_bytes(out, 2, PACKAGE.as_bytes());
        put(out);
        put_bytes(out, 12, b"proto3");
    });
    out
}

/// As [`file_descriptor_set`], of the message of a recording of pixels.
pub(super) fn of_pixels() -> Vec<u8> {
    let of_header = |(number, field)| Descriptor { number, ..descriptor(field) };
    let mut fields: Vec<Descriptor<'_>> = pixels::fields().map(of_header).collect();
    let (name, number) = ("pixels_zstd", PIXELS_TAG);
    fields.push(Descriptor { name, number, repeated: false, kind: BYTES, type_name: None });
    let mut out = Vec::new();
    put_message(&mut out, 1, |out| {
        put_bytes(out, 1, b"vitreo-pixels.proto");
        put_bytes(out, 2, PACKAGE.as_bytes());
        put_message(out, 4, |out| put_fields(out, pixels::MESSAGE, &fields));
        put_bytes(out, 12, b"proto3");
    });
    out
}

/// Appends the message of a layout after those that it consists of, each once.
fn put_layout(out: &mut Vec<u8>, layout: &'static Layout, done: &mut Vec<&'static str>) {
    if done.contains(&layout.name) {
        return;
    }
    done.push(layout.name);
    for field in layout.recorded() {
        if let Some(inner) = field.kind.layout() {
            put_layout(out, inner, done);
        }
    }
    let fields: Vec<Descriptor<'_>> = layout.recorded().map(descriptor).collect();
    put_message(out, 4, |out| put_fields(out, layout.name, &fields));
}

fn descriptor(field: &'static Field) -> Descriptor<'static> {
    let (element, repeated) = match field.kind {
        Kind::Array(element, _) => (*element, true),
        kind => (kind, false),
    };
    let (name, kind) = match (field.role, element) {
        (Role::Payload(name), _) => (name, BYTES),
        (Role::Hash, _) => (field.name, FIXED64),
        (_, Kind::F32) => (field.name, FLOAT),
        (_, Kind::F64) => (field.name, DOUBLE),
        (_, Kind::U32) => (field.name, UINT32),
        (_, Kind::U64) => (field.name, UINT64),
        (_, Kind::Struct(_)) => (field.name, MESSAGE),
        _ => unreachable!("Layout::prove refuses such a field"),
    };
    let type_name = element.layout().map(|inner| inner.name);
    Descriptor { name, number: field.tag, repeated, kind, type_name }
}

/// Appends name and fields of a message. A single double has explicit presence, which proto3
/// describes as a union (`oneof`) of its own.
fn put_fields(out: &mut Vec<u8>, name: &str, fields: &[Descriptor<'_>]) {
    put_bytes(out, 1, name.as_bytes());
    let mut optional = Vec::new();
    for field in fields {
        put_message(out, 2, |out| {
            put_bytes(out, 1, field.name.as_bytes());
            put_present(out, 3, u64::from(field.number));
            put_present(out, 4, if field.repeated { 3 } else { 1 });
            put_present(out, 5, field.kind);
            if let Some(name) = field.type_name {
                put_bytes(out, 6, format!(".{PACKAGE}.{name}").as_bytes());
            }
            let present = field.kind == DOUBLE && !field.repeated;
            if present {
                put_present(out, 9, optional.len() as u64);
                optional.push(field.name);
            }
            put_bytes(out, 10, json_name(field.name).as_bytes());
            if present {
                put_present(out, 17, 1);
            }
        });
    }
    for name in optional {
        put_message(out, 8, |out| put_bytes(out, 1, format!("_{name}").as_bytes()));
    }
}

/// A field's name in JSON: in camel case.
fn json_name(name: &str) -> String {
    let mut words = name.split('_');
    let mut out = words.next().unwrap_or_default().to_owned();
    for word in words {
        out.extend(word.chars().take(1).map(|c| c.to_ascii_uppercase()));
        out.extend(word.chars().skip(1));
    }
    out
}

/// Appends the message of a [`super::Note`].
fn put_note(out: &mut Vec<u8>) {
    let field = |name, number, kind, type_name| Descriptor { name, number, repeated: false, kind, type_name };
    let fields = [
        field("instant_ns", 1, UINT64, None),
        field("kind", 2, ENUM, Some("Note.Kind")),
        field("process", 3, UINT32, None),
        field("count", 4, UINT64, None),
        field("text", 5, STRING, None),
    ];
    put_message(out, 4, |out| {
        put_fields(out, NOTE, &fields);
        put_message(out, 4, |out| {
            put_bytes(out, 1, b"Kind");
            for (number, name) in ["LOG", "RESTART", "LOSS"].iter().enumerate() {
                put_message(out, 2, |out| {
                    put_bytes(out, 1, name.as_bytes());
                    put_present(out, 2, number as u64);
                });
            }
        });
    });
}
