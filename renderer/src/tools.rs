//! Meshes of the instruments, instrument frame, mm: tip at the origin, handle towards +z, hook,
//! port and jaw plane along +x. They come from glTF files (`assets/instruments`, made by the
//! example `instruments`), drawn at 25 gauge, and are widened here to the gauge of a scene.

mod load;
mod outline;

pub use load::{ModelError, load, name, parts};
pub use outline::{angular, outline, round_from_mm};

use crate::layout::MetalVertex;
use glam::Vec3;
use protocol::file::read_bytes;
use protocol::handles::{self, Tool};
use std::ops::Range;
use std::path::Path;

/// Pivot of the forceps' jaws over the tip, mm.
pub const JAW_LENGTH_MM: f32 = handles::JAW_LENGTH_MM as f32;
/// Where the beam leaves the light pipe: just before its end face, mm.
pub const FIBRE_FACE_MM: f32 = -0.02;
/// Radius of the shafts in the files: 25 gauge, mm.
pub const NOMINAL_RADIUS_MM: f32 = 0.25;
/// Length of the shafts in the files, from the tip, mm.
pub const NOMINAL_LENGTH_MM: f32 = 60.0;
/// Radius of the needle's cannula in its file: 41 gauge, mm.
pub const NOMINAL_CANNULA_MM: f32 = 0.05;
/// A shaft is made longer or shorter beyond this height over its tip, mm.
const STRETCHED_FROM_MM: f32 = 5.0;

/// Longest file, bytes.
const MAX_MESH_BYTES: u64 = 16 << 20;

/// Materials of [`MetalVertex`].
const METAL: f32 = 0.0;
const FIBRE: f32 = 1.0;
const PORT: f32 = 2.0;

/// Every tool, in the order of [`Models`].
pub const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle];

/// The shipped files, in the order of [`TOOLS`].
const SHIPPED: [&[u8]; 5] = [
    include_bytes!("../../assets/instruments/forceps.glb"),
    include_bytes!("../../assets/instruments/light-pipe.glb"),
    include_bytes!("../../assets/instruments/pick.glb"),
    include_bytes!("../../assets/instruments/vitrector.glb"),
    include_bytes!("../../assets/instruments/needle.glb"),
];

/// Shaft of an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// Outer radius, mm.
    pub radius_mm: f32,
    /// Length from the tip, mm.
    pub length_mm: f32,
    /// Outer radius of a needle's cannula, mm.
    pub cannula_mm: f32,
}

/// An indexed triangle mesh.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<MetalVertex>,
    /// Triangles, counter-clockwise from outside.
    pub indices: Vec<u32>,
}

impl Mesh {
    /// Adds another mesh; returns where its indices are.
    pub fn append(&mut self, other: Mesh) -> Range<u32> {
        let (base, first) = (self.vertices.len() as u32, self.indices.len() as u32);
        self.vertices.extend(other.vertices);
        self.indices.extend(other.indices.iter().map(|i| base + i));
        first..self.indices.len() as u32
    }

    /// Two triangles over four corners, counter-clockwise from outside, or clockwise where `flip`.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4], flip: bool) {
        self.indices.extend(if flip { [a, c, b, a, d, c] } else { [a, b, c, a, c, d] });
    }
}

/// A closed part of an instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Name of its node.
    pub name: String,
    /// Where its node lies, instrument frame, mm; a jaw turns about this.
    pub at: Vec3,
    /// Vertices, instrument frame.
    pub vertices: Vec<MetalVertex>,
    /// Triangles, counter-clockwise from outside.
    pub indices: Vec<u32>,
}

/// An instrument as its file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Its parts, in the order of [`parts`].
    pub parts: Vec<Part>,
}

impl Model {
    /// Its mesh on a given shaft, all parts together, the jaws closed.
    pub fn mesh(&self, shaft: &Shaft) -> Mesh {
        self.mesh_of(shaft, |_| true)
    }

    /// The same of parts whose names are `wanted`.
    fn mesh_of(&self, shaft: &Shaft, wanted: impl Fn(&str) -> bool) -> Mesh {
        let mut mesh = Mesh::default();
        for part in self.parts.iter().filter(|part| wanted(&part.name)) {
            let vertices = part.vertices.iter().map(|v| fitted(v, &part.name, shaft)).collect();
            mesh.append(Mesh { vertices, indices: part.indices.clone() });
        }
        mesh
    }
}

/// A vertex on a given shaft: widened across, and lengthened beyond what is seen of the tip. A hook
/// stays as it is.
fn fitted(vertex: &MetalVertex, part: &str, shaft: &Shaft) -> MetalVertex {
    let wider = match part {
        "hook" => 1.0,
        "cannula" => shaft.cannula_mm / NOMINAL_CANNULA_MM,
        _ => shaft.radius_mm / NOMINAL_RADIUS_MM,
    };
    let [x, y, z] = vertex.position;
    let beyond = z - STRETCHED_FROM_MM;
    let longer = (shaft.length_mm - STRETCHED_FROM_MM).max(1.0) / (NOMINAL_LENGTH_MM - STRETCHED_FROM_MM);
    let z = if beyond > 0.0 { STRETCHED_FROM_MM + beyond * longer } else { z };
    let [nx, ny, nz] = vertex.normal;
    let normal = Vec3::new(nx / wider, ny / wider, nz).normalize().to_array();
    MetalVertex { position: [x * wider, y * wider, z], normal, ..*vertex }
}

/// The instruments of a simulator.
#[derive(Debug, Clone, PartialEq)]
pub struct Models(Vec<Model>);

impl Models {
    /// Those that are built in.
    ///
    /// # Errors
    /// If a mesh is invalid.
    pub fn shipped() -> Result<Self, ModelError> {
        let file = |tool| format!("assets/instruments/{}.glb", name(tool));
        let load = |(tool, bytes)| load(tool, &file(tool), bytes);
        TOOLS.into_iter().zip(SHIPPED).map(load).collect::<Result<_, _>>().map(Self)
    }

    /// Those of a folder, which has a file for each tool.
    ///
    /// # Errors
    /// If a file is missing or its mesh is invalid.
    pub fn from_folder(folder: &Path) -> Result<Self, ModelError> {
        let load = |tool| {
            let path = folder.join(format!("{}.glb", name(tool)));
            let file = path.display().to_string();
            let problem = |e: std::io::Error| ModelError { file: file.clone(), problem: e.to_string() };
            load(tool, &file, &read_bytes(&path, MAX_MESH_BYTES).map_err(problem)?)
        };
        TOOLS.into_iter().map(load).collect::<Result<_, _>>().map(Self)
    }

    /// The model of `tool`.
    pub fn of(&self, tool: Tool) -> &Model {
        &self.0[TOOLS.iter().position(|&t| t == tool).unwrap_or(0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAFT: Shaft =
        Shaft { radius_mm: NOMINAL_RADIUS_MM, length_mm: NOMINAL_LENGTH_MM, cannula_mm: NOMINAL_CANNULA_MM };

    #[test]
    fn shipped_meshes_are_small_and_their_normals_agree_with_the_triangles() {
        for tool in TOOLS {
            let mesh = Models::shipped().unwrap().of(tool).mesh(&SHAFT);
            assert!((100..2_000).contains(&(mesh.indices.len() / 3)), "{tool:?}");
            for t in mesh.indices.chunks(3) {
                let v = [0, 1, 2].map(|i| mesh.vertices[t[i] as usize]);
                let p = v.map(|v| Vec3::from(v.position));
                let face = (p[1] - p[0]).cross(p[2] - p[0]).normalize();
                assert!(v.iter().all(|v| Vec3::from(v.normal).dot(face) > 0.3), "{tool:?} {v:?}");
            }
        }
    }

    #[test]
    fn a_shaft_has_the_gauge_and_length_of_its_scene() {
        let models = Models::shipped().unwrap();
        let shaft = Shaft { radius_mm: 0.3, length_mm: 45.0, cannula_mm: 0.06 };
        for tool in TOOLS {
            let v = models.of(tool).mesh(&shaft).vertices;
            let far = v.iter().filter(|v| v.position[2] > 10.0);
            let widest = far.clone().map(|v| v.position[0].hypot(v.position[1])).fold(0.0, f32::max);
            let longest = far.map(|v| v.position[2]).fold(0.0, f32::max);
            assert!((widest - 0.3).abs() < 1e-5 && (longest - 45.0).abs() < 1e-4, "{tool:?}");
            assert!(v.iter().all(|v| (Vec3::from(v.normal).length() - 1.0).abs() < 1e-4), "{tool:?}");
        }
        let thin = models.of(Tool::Needle).mesh(&shaft).vertices;
        let widest = thin.iter().filter(|v| v.position[2] < 3.0).map(|v| v.position[0]).fold(0.0, f32::max);
        assert!((widest - 0.06).abs() < 1e-5, "{widest}");
    }

    #[test]
    fn the_hook_keeps_its_reach_and_the_jaws_their_order() {
        let models = Models::shipped().unwrap();
        let wide = Shaft { radius_mm: 0.4, ..SHAFT };
        let reach =
            models.of(Tool::Pick).mesh(&wide).vertices.iter().map(|v| v.position[0]).fold(0.0, f32::max);
        assert!((reach - handles::HOOK_LENGTH_MM as f32).abs() < 1e-6, "{reach}");
        let forceps = models.of(Tool::Forceps).mesh(&wide);
        let side = |part: f32| forceps.vertices.iter().filter(move |v| v.part == part).map(|v| v.position[0]);
        assert!(side(1.0).all(|x| x >= -1e-6) && side(-1.0).all(|x| x <= 1e-6));
        assert!(side(1.0).count() > 50 && side(1.0).count() == side(-1.0).count());
    }
}
