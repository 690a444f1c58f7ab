//! Binary glTF 2.0 of a shape: the file is in metres with +y up as glTF asks for, by a transform of
//! the root; the parts under it are in millimetres in the instrument's frame.

use crate::shapes::{Facet, Part, Shape, Surface};
use glam::DVec3;
use serde_json::{Value, json};
use std::collections::HashMap;

/// Faces that meet at less than this angle look like one smooth surface, rad.
const CREASE_RAD: f64 = 0.75;

/// glTF's numbers for types and uses.
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// The whole file.
pub fn bytes(shape: &Shape) -> Vec<u8> {
    let mut out = Writer::default();
    let meshes: Vec<Value> = shape.parts.iter().map(|p| out.mesh(p)).collect();
    let part = |mesh: usize| {
        let p = &shape.parts[mesh];
        json!({ "name": p.name, "mesh": mesh, "translation": p.at.as_vec3().to_array() })
    };
    let mut nodes: Vec<Value> = (0..shape.parts.len()).map(part).collect();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let root = json!({
        "name": shape.name,
        "children": (0..nodes.len()).collect::<Vec<_>>(),
        "rotation": [-half, 0.0, 0.0, half],
        "scale": [0.001, 0.001, 0.001],
    });
    nodes.push(root);
    let text = json!({
        "asset": { "version": "2.0", "generator": "vitreo, example instruments" },
        "scene": 0,
        "scenes": [{ "nodes": [nodes.len() - 1] }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [
            material("metal", [0.72, 0.74, 0.78], 1.0, 0.3, 0.0),
            material("fibre", [1.0, 0.95, 0.86], 0.0, 0.2, 1.0),
            material("port", [0.06, 0.06, 0.06], 1.0, 0.6, 0.0),
        ],
        "accessors": out.accessors,
        "bufferViews": out.views,
        "buffers": [{ "byteLength": out.data.len() }],
    });
    container(text.to_string().into_bytes(), out.data)
}

fn material(name: &str, [r, g, b]: [f32; 3], metallic: f32, roughness: f32, glow: f32) -> Value {
    json!({
        "name": name,
        "emissiveFactor": [glow, glow, glow],
        "pbrMetallicRoughness":
            { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": metallic, "roughnessFactor": roughness },
    })
}

fn container(mut text: Vec<u8>, mut data: Vec<u8>) -> Vec<u8> {
    text.resize(text.len().next_multiple_of(4), b' ');
    data.resize(data.len().next_multiple_of(4), 0);
    let mut file = b"glTF".to_vec();
    let word = |n: usize| (n as u32).to_le_bytes();
    file.extend(word(2));
    file.extend(word(12 + 8 + text.len() + 8 + data.len()));
    for (kind, chunk) in [(b"JSON", text), (b"BIN\0", data)] {
        file.extend(word(chunk.len()));
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

#[derive(Default)]
struct Writer {
    data: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Writer {
    fn mesh(&mut self, part: &Part) -> Value {
        let everything: Vec<Facet> = part.surfaces.iter().flat_map(|s| s.triangles.clone()).collect();
        let around = faces_around(&everything);
        let primitives: Vec<Value> = part.surfaces.iter().map(|s| self.primitive(s, &around)).collect();
        json!({ "name": part.name, "primitives": primitives })
    }

    fn primitive(&mut self, surface: &Surface, around: &HashMap<[i64; 3], Vec<DVec3>>) -> Value {
        let mut known: HashMap<[[u32; 3]; 2], u16> = HashMap::new();
        let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for (face, corner) in surface.triangles.iter().flat_map(|f| f.map(|c| (face_vector(f), c))) {
            let (p, n) = (corner.as_vec3(), smooth(&around[&key(corner)], face).as_vec3());
            let index = *known.entry([p, n].map(|v| v.to_array().map(f32::to_bits))).or_insert_with(|| {
                positions.push(p);
                normals.push(n);
                positions.len() as u16 - 1
            });
            indices.push(index);
        }
        let (low, high) =
            positions.iter().fold((positions[0], positions[0]), |(l, h), p| (l.min(*p), h.max(*p)));
        let p = self.accessor(bytemuck::cast_slice(&positions), VERTICES, FLOAT, "VEC3", positions.len());
        self.accessors[p]["min"] = json!(low.to_array());
        self.accessors[p]["max"] = json!(high.to_array());
        let n = self.accessor(bytemuck::cast_slice(&normals), VERTICES, FLOAT, "VEC3", normals.len());
        let i =
            self.accessor(bytemuck::cast_slice(&indices), INDICES, UNSIGNED_SHORT, "SCALAR", indices.len());
        let material = ["metal", "fibre", "port"].iter().position(|m| *m == surface.material);
        json!({ "attributes": { "POSITION": p, "NORMAL": n }, "indices": i, "material": material })
    }

    fn accessor(&mut self, bytes: &[u8], target: u32, component: u32, kind: &str, count: usize) -> usize {
        self.data.resize(self.data.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.data.len(), "byteLength": bytes.len(), "target": target });
        self.data.extend(bytes);
        self.views.push(view);
        let view = self.views.len() - 1;
        self.accessors
            .push(json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }));
        view
    }
}

fn key(p: DVec3) -> [i64; 3] {
    p.to_array().map(|c| (c * 1e7).round() as i64)
}

/// Normal times twice the area.
fn face_vector([a, b, c]: &Facet) -> DVec3 {
    (*b - *a).cross(*c - *a)
}

/// The faces that meet in each corner.
fn faces_around(facets: &[Facet]) -> HashMap<[i64; 3], Vec<DVec3>> {
    let mut around: HashMap<_, Vec<DVec3>> = HashMap::new();
    for facet in facets {
        facet.iter().for_each(|&corner| around.entry(key(corner)).or_default().push(face_vector(facet)));
    }
    around
}

/// Unit normal of a corner of `face`: of all faces there that lie nearly as it does. Each counts
/// once, since the long triangles of a shaft would outvote the rest.
fn smooth(around: &[DVec3], face: DVec3) -> DVec3 {
    let unit = face.normalize();
    let alike = around.iter().map(|f| f.normalize()).filter(|n| n.dot(unit) > libm::cos(CREASE_RAD));
    alike.sum::<DVec3>().normalize()
}
