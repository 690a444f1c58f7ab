//! Every shader is parsed and validated without a GPU, and the structs that both sides see agree.

use renderer::layout::{FrameUniform, InstrumentUniform, ViewUniform};
use renderer::passes::shader_sources;
use std::mem::offset_of;
use wgpu::naga::front::wgsl;
use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};
use wgpu::naga::{Module, TypeInner};

fn parse(name: &str, text: &str) -> Module {
    wgsl::parse_str(text).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(text)))
}

#[test]
fn shaders_are_valid() {
    for (name, text) in shader_sources() {
        let module = parse(name, &text);
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        let valid = validator.validate(&module);
        assert!(valid.is_ok(), "{name}: {}", valid.unwrap_err().emit_to_string(&text));
        assert!(!module.entry_points.is_empty(), "{name} has no entry point");
    }
}

/// Name and offset of each member of a WGSL struct, and the struct's size.
fn members(module: &Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
    let (_, found) = found.unwrap_or_else(|| panic!("no struct {name}"));
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
    let named = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize));
    (named.collect(), *span as usize)
}

macro_rules! offsets {
    ($type:ty { $($field:ident),* $(,)? }) => {
        vec![$((stringify!($field).to_owned(), offset_of!($type, $field))),*]
    };
}

#[test]
fn structs_agree() {
    let (name, text) = &shader_sources()[1];
    let module = parse(name, text);
    let frame = offsets!(FrameUniform {
        lamp_from_eye,
        lamp_position,
        lamp_direction,
        lamp_colour,
        ambient,
        retina,
        shadow,
        penumbra,
        haze_corner,
        haze_size,
        instruments,
    });
    assert_eq!(members(&module, "Frame"), (frame, size_of::<FrameUniform>()));
    let view = offsets!(ViewUniform { clip_from_eye, camera, plane_origin, plane_x, plane_y, field });
    assert_eq!(members(&module, "View"), (view, size_of::<ViewUniform>()));
    let instrument = offsets!(InstrumentUniform { eye_from_instrument, shape, shaft });
    assert_eq!(members(&module, "Instrument"), (instrument, size_of::<InstrumentUniform>()));
}
