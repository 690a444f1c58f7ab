//! Reads an instrument's mesh from a binary glTF file and checks it: the right parts, closed, at
//! gauge, the tip at the origin.

use super::{
    FIBRE, JAW_LENGTH_MM, METAL, Model, NOMINAL_CANNULA_MM, NOMINAL_LENGTH_MM, NOMINAL_RADIUS_MM, PORT, Part,
};
use crate::layout::MetalVertex;
use glam::Vec3;
use gltf::accessor::{DataType, Dimensions};
use gltf::{Gltf, Node, Primitive};
use protocol::handles::{PORT_HEIGHT_MM, PORT_RADIUS_MM, Tool};
use std::collections::HashMap;

/// Most that a measure may differ from what the simulation has, mm.
const EXACT_MM: f32 = 0.005;
/// The tip may stand out by as much: the face of a fibre bulges, mm.
const TIP_MM: f32 = 0.03;
/// Corners that are nearer to each other are one, mm.
const WELD_MM: f32 = 1e-5;
/// Most that the length of a normal may differ from 1.
const UNIT: f32 = 1e-3;

/// Why a mesh cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct ModelError {
    /// Path or name of the file.
    pub file: String,
    /// What is wrong, in which node of it where it is one, and what was expected.
    pub problem: String,
}

/// Name of a tool's file without its ending, and of the root node in it.
pub fn name(tool: Tool) -> &'static str {
    match tool {
        Tool::Forceps => "forceps",
        Tool::LightPipe => "light-pipe",
        Tool::Pick => "pick",
        Tool::Vitrector => "vitrector",
        Tool::Needle => "needle",
    }
}

/// Names of the nodes that a tool's file must have, in the order in which they are kept.
pub fn parts(tool: Tool) -> &'static [&'static str] {
    match tool {
        Tool::Forceps => &["shaft", "jaw-plus", "jaw-minus"],
        Tool::LightPipe => &["shaft", "fibre"],
        Tool::Pick => &["shaft", "hook"],
        Tool::Vitrector => &["shaft"],
        Tool::Needle => &["shaft", "cannula"],
    }
}

/// The mesh of `tool` from the bytes of `file`.
///
/// # Errors
/// If the file is not binary glTF, lacks a part, or a part is not closed, not at gauge or not in
/// place.
pub fn load(tool: Tool, file: &str, bytes: &[u8]) -> Result<Model, ModelError> {
    let whole = |problem: String| ModelError { file: file.to_owned(), problem };
    let gltf = parse(bytes).map_err(whole)?;
    let buffer = gltf.blob.as_deref().ok_or_else(|| whole("expected a binary glTF file (.glb)".into()))?;
    let expected = format!("expected a root node '{}'", name(tool));
    let root = gltf.nodes().find(|n| n.name() == Some(name(tool))).ok_or_else(|| whole(expected))?;
    let part = |wanted: &&str| {
        let node = root.children().find(|n| n.name() == Some(wanted));
        let in_node = |problem: String| whole(format!("node '{wanted}': {problem}"));
        let node = node.ok_or_else(|| in_node(missing(&root)))?;
        let part = read(&node, buffer).map_err(in_node)?;
        check_part(wanted, &part).map_err(in_node)?;
        Ok(part)
    };
    let model = Model { parts: parts(tool).iter().map(part).collect::<Result<_, _>>()? };
    check_tool(tool, &model).map_err(whole)?;
    Ok(model)
}

/// The file's parsed and validated contents.
fn parse(bytes: &[u8]) -> Result<Gltf, String> {
    let no_file = |e: gltf::Error| format!("not a glTF file: {e}");
    // The library takes the header's length off the file's without a look at it.
    let length = bytes.get(8..12).and_then(|b| Some(u32::from_le_bytes(b.try_into().ok()?)));
    if bytes.starts_with(b"glTF") && length.is_none_or(|length| length < 12) {
        return Err("not a glTF file: its header is truncated or its length too short".into());
    }
    let Gltf { document, blob } = Gltf::from_slice_without_validation(bytes).map_err(no_file)?;
    let root = document.into_json();
    // The library's validation looks up the positions' accessor before it checks that there is one.
    let known = |accessor: &gltf::json::Index<gltf::json::Accessor>| accessor.value() < root.accessors.len();
    let mut primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    if !primitives.all(|p| p.attributes.values().all(known)) {
        return Err(
            "not a valid glTF file: an attribute of a mesh names an accessor that does not exist".into()
        );
    }
    let document = gltf::Document::from_json(root).map_err(no_file)?;
    Ok(Gltf { document, blob })
}

fn missing(root: &Node<'_>) -> String {
    let there: Vec<_> = root.children().map(|n| n.name().unwrap_or("(unnamed)").to_owned()).collect();
    format!("missing; the root has: {}", there.join(", "))
}

/// A node's vertices and triangles in the instrument's frame.
fn read(node: &Node<'_>, buffer: &[u8]) -> Result<Part, String> {
    let name = node.name().unwrap_or_default();
    let (at, rotation, scale) = node.transform().decomposed();
    if rotation != [0.0, 0.0, 0.0, 1.0] || scale != [1.0; 3] {
        return Err("expected a translation only, found a rotation or a scale".into());
    }
    let side = match name {
        "jaw-plus" => 1.0,
        "jaw-minus" => -1.0,
        _ => 0.0,
    };
    let mut part = Part { name: name.to_owned(), at: at.into(), vertices: vec![], indices: vec![] };
    let mesh = node.mesh().ok_or("it has no mesh")?;
    mesh.primitives().try_for_each(|p| add(&mut part, &p, buffer, side))?;
    Ok(part)
}

fn add(part: &mut Part, primitive: &Primitive<'_>, buffer: &[u8], side: f32) -> Result<(), String> {
    if primitive.mode() != gltf::mesh::Mode::Triangles {
        return Err(format!("expected triangles, found {:?}", primitive.mode()));
    }
    // The reader trusts the file's lengths.
    for (semantic, accessor) in primitive.attributes() {
        let is_read = matches!(semantic, gltf::Semantic::Positions | gltf::Semantic::Normals);
        let vectors = (accessor.data_type(), accessor.dimensions()) == (DataType::F32, Dimensions::Vec3);
        if is_read && !vectors {
            return Err(format!("expected three floats a vertex as {semantic:?}, found other numbers"));
        }
        inside(&accessor, buffer)?;
    }
    if let Some(accessor) = primitive.indices() {
        let counts = matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32);
        if !counts || accessor.dimensions() != Dimensions::Scalar {
            return Err(format!("expected whole numbers as indices, found {:?}", accessor.data_type()));
        }
        inside(&accessor, buffer)?;
    }
    let material = match primitive.material().name() {
        Some("metal") => METAL,
        Some("fibre") => FIBRE,
        Some("port") => PORT,
        other => return Err(format!("expected material metal, fibre or port, found {other:?}")),
    };
    let reader = primitive.reader(|_| Some(buffer));
    let positions: Vec<[f32; 3]> = reader.read_positions().ok_or("it has no positions")?.collect();
    let normals: Vec<[f32; 3]> = reader.read_normals().ok_or("it has no normals")?.collect();
    let indices: Vec<u32> = reader.read_indices().ok_or("it has no indices")?.into_u32().collect();
    if normals.len() != positions.len() || !indices.len().is_multiple_of(3) {
        return Err("expected a normal for each position, and three indices for each triangle".into());
    }
    let first = part.vertices.len() as u32;
    for (i, (p, n)) in positions.iter().zip(&normals).enumerate() {
        let (position, normal) = (part.at + Vec3::from(*p), Vec3::from(*n));
        if !position.is_finite() || (normal.length() - 1.0).abs() > UNIT || normal.is_nan() {
            return Err(format!(
                "vertex {i}: expected a finite position and a unit normal, found {p:?}, {n:?}"
            ));
        }
        let (position, normal) = (position.to_array(), normal.normalize().to_array());
        part.vertices.push(MetalVertex { position, normal, part: side, material });
    }
    if let Some(index) = indices.iter().find(|&&i| i as usize >= positions.len()) {
        return Err(format!("index {index} of {} vertices", positions.len()));
    }
    part.indices.extend(indices.iter().map(|i| first + i));
    Ok(())
}

fn inside(accessor: &gltf::Accessor<'_>, buffer: &[u8]) -> Result<(), String> {
    let view = accessor.view().ok_or("sparse data is not supported")?;
    let stride = view.stride().unwrap_or(accessor.size());
    let needs =
        accessor.count().checked_sub(1).and_then(|n| n.checked_mul(stride)?.checked_add(accessor.size()));
    let needs = needs.and_then(|n| n.checked_add(accessor.offset())).ok_or("it has no vertices")?;
    let end = view.offset().checked_add(view.length());
    if needs > view.length() || end.is_none_or(|end| end > buffer.len()) {
        return Err(format!("its data needs {needs} bytes beyond the file's {}", buffer.len()));
    }
    Ok(())
}

/// What every part must be, and what the simulation relies on.
fn check_part(name: &str, part: &Part) -> Result<(), String> {
    check_closed(part)?;
    let close = |what: &str, found: f32, expected: f32| {
        let good = (found - expected).abs() <= EXACT_MM;
        if good { Ok(()) } else { Err(format!("expected {what} of {expected} mm, found {found}")) }
    };
    let widest = part.vertices.iter().map(|v| v.position[0].hypot(v.position[1])).fold(0.0, f32::max);
    let high = part.vertices.iter().map(|v| v.position[2]).fold(f32::MIN, f32::max);
    match name {
        "shaft" => {
            close("a shaft of 25 gauge, a radius", widest, NOMINAL_RADIUS_MM)?;
            close("a length from the tip", high, NOMINAL_LENGTH_MM)
        }
        "cannula" => close("a cannula of 41 gauge, a radius", widest, NOMINAL_CANNULA_MM),
        "jaw-plus" | "jaw-minus" => {
            let apart = part.at.distance(Vec3::Z * JAW_LENGTH_MM);
            close("a pivot at the jaws' length, apart from it by 0", apart, 0.0)
        }
        _ => Ok(()),
    }
}

/// Every edge must belong to two triangles that run along it in opposite directions.
fn check_closed(part: &Part) -> Result<(), String> {
    let welded = |i: u32| part.vertices[i as usize].position.map(|c| (c / WELD_MM).round() as i64);
    let mut edges: HashMap<[[i64; 3]; 2], i32> = HashMap::new();
    let mut volume = 0.0;
    for t in part.indices.chunks_exact(3) {
        let p = [0, 1, 2].map(|i| Vec3::from(part.vertices[t[i] as usize].position).as_dvec3());
        volume += p[0].dot(p[1].cross(p[2])) / 6.0;
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let (a, b) = (welded(a), welded(b));
            *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
        }
    }
    if let Some(([a, _], _)) = edges.iter().filter(|(_, n)| **n != 0).min() {
        return Err(format!("not closed: an open edge at {:?} mm", a.map(|c| c as f32 * WELD_MM)));
    }
    if volume <= 0.0 || volume.is_nan() {
        return Err(format!("expected triangles that face outwards, found a volume of {volume} mm³"));
    }
    Ok(())
}

/// What all parts make together.
fn check_tool(tool: Tool, model: &Model) -> Result<(), String> {
    let vertices = || model.parts.iter().flat_map(|p| &p.vertices);
    let lowest = vertices().map(|v| v.position[2]).fold(f32::MAX, f32::min);
    if lowest.abs() > TIP_MM {
        return Err(format!("expected the tip at z = 0 mm, found it at {lowest}"));
    }
    if tool == Tool::Vitrector {
        let port = vertices().filter(|v| v.material == PORT);
        let reach =
            port.map(|v| v.position[1].hypot(v.position[2] - PORT_HEIGHT_MM as f32)).fold(0.0, f32::max);
        if (reach - PORT_RADIUS_MM as f32).abs() > EXACT_MM {
            return Err(format!(
                "expected a port of radius {PORT_RADIUS_MM} mm at z = {PORT_HEIGHT_MM} mm, found {reach}"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{SHIPPED, TOOLS};
    use super::*;
    use proptest::prelude::*;

    fn shipped(tool: Tool) -> Vec<u8> {
        SHIPPED[TOOLS.iter().position(|&t| t == tool).unwrap()].to_vec()
    }

    /// The file of `tool` with `from` in its description replaced by `to` of the same length.
    fn altered(tool: Tool, from: &str, to: &str) -> String {
        assert_eq!(from.len(), to.len());
        let mut bytes = shipped(tool);
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).expect("text of the file");
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
        load(tool, "x.glb", &bytes).unwrap_err().to_string()
    }

    #[test]
    fn every_problem_names_file_and_node() {
        let missing = altered(Tool::Forceps, "\"name\":\"jaw-minus\",\"t", "\"name\":\"jaw-third\",\"t");
        assert!(
            missing.starts_with("x.glb: node 'jaw-minus': missing; the root has: shaft, jaw-plus"),
            "{missing}"
        );
        let pivot = altered(Tool::Forceps, "\"translation\":[0.0,0.0,1.5]", "\"translation\":[0.0,0.0,1.4]");
        assert!(pivot.starts_with("x.glb: node 'jaw-plus': expected a pivot"), "{pivot}");
        let material = altered(Tool::Pick, "\"name\":\"metal\"", "\"name\":\"petal\"");
        assert!(material.contains("node 'shaft': expected material metal, fibre or port"), "{material}");
        let wrong = load(Tool::Pick, "x.glb", &shipped(Tool::Needle)).unwrap_err().to_string();
        assert_eq!(wrong, "x.glb: expected a root node 'pick'");
        let short = altered(Tool::Needle, "\"byteOffset\":0,", "\"byteOffset\":9,");
        assert!(short.starts_with("x.glb"), "{short}");
        let without = altered(Tool::Needle, "\"accessors\":", "\"Accessors\":");
        assert!(without.contains("names an accessor that does not exist"), "{without}");
        assert!(
            load(Tool::Pick, "x.glb", b"teapot")
                .unwrap_err()
                .to_string()
                .starts_with("x.glb: not a glTF file")
        );
    }

    #[test]
    fn an_open_a_widened_and_a_moved_mesh_are_refused() {
        let model = load(Tool::Vitrector, "x.glb", &shipped(Tool::Vitrector)).unwrap();
        let mut part = model.parts[0].clone();
        part.indices.truncate(part.indices.len() - 3);
        assert!(check_part("shaft", &part).unwrap_err().starts_with("not closed: an open edge at"));
        let mut part = model.parts[0].clone();
        part.indices.chunks_exact_mut(3).for_each(|t| t.swap(0, 1));
        assert!(check_part("shaft", &part).unwrap_err().contains("face outwards"));
        let mut part = model.parts[0].clone();
        part.vertices.iter_mut().for_each(|v| v.position[0] *= 1.1);
        assert!(check_part("shaft", &part).unwrap_err().contains("25 gauge"));
        let mut moved = model;
        moved.parts[0].vertices.iter_mut().for_each(|v| v.position[2] += 0.1);
        assert!(check_tool(Tool::Vitrector, &moved).unwrap_err().contains("tip at z = 0"));
    }

    proptest! {
        #[test]
        fn broken_files_are_refused_and_never_break_the_reader(
            tool in 0..TOOLS.len(), at in 0.0..1.0f64, byte: u8, keep in 0.0..1.0f64,
        ) {
            let mut bytes = SHIPPED[tool].to_vec();
            let i = (at * bytes.len() as f64) as usize;
            bytes[i] = byte;
            let _ = load(TOOLS[tool], "x.glb", &bytes);
            bytes.truncate((keep * bytes.len() as f64) as usize);
            prop_assert!(load(TOOLS[tool], "x.glb", &bytes).is_err());
        }
    }
}
