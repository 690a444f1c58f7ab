//! Closed meshes of the instruments, instrument frame, mm: tip at the origin, handle towards +z,
//! hook, port and jaw plane along +x. Shapes follow common 25-gauge instruments.

use crate::layout::MetalVertex;
use glam::Vec3;
use protocol::handles::{self, Tool};

/// Pivot of the forceps' jaws over the tip, mm.
pub const JAW_LENGTH_MM: f32 = handles::JAW_LENGTH_MM as f32;
/// Radius of a jaw at its tip, as a share of the shaft's.
const JAW_TAPER: f32 = handles::JAW_TAPER as f32;
/// Corners of a ring: enough for a smooth outline at 50 px/mm.
const CORNERS: usize = 14;
/// Where the beam leaves the light pipe: just before its end face, mm.
pub const FIBRE_FACE_MM: f32 = -0.02;

const METAL: f32 = 0.0;
const FIBRE: f32 = 1.0;
const PORT: f32 = 2.0;

/// An indexed triangle mesh.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<MetalVertex>,
    /// Triangles, counter-clockwise from outside.
    pub indices: Vec<u32>,
}

/// A cross-section: an ellipse about (x, 0, z).
#[derive(Debug, Clone, Copy)]
struct Ring {
    z: f32,
    x: f32,
    radii: [f32; 2],
}

fn round(z: f32, radius: f32) -> Ring {
    Ring { z, x: 0.0, radii: [radius; 2] }
}

/// The mesh of `tool` with a shaft of `radius_mm` and `length_mm`.
pub fn mesh(tool: Tool, radius_mm: f32, length_mm: f32) -> Mesh {
    let mut mesh = Mesh::default();
    let (r, end) = (radius_mm, length_mm);
    match tool {
        Tool::Forceps => forceps(&mut mesh, r, end),
        Tool::LightPipe => {
            mesh.tube(&[round(0.0, r * 0.8), round(0.06, r), round(end, r)], 0.0, METAL);
            mesh.tube(&[round(FIBRE_FACE_MM, r * 0.6), round(0.001, r * 0.62)], 0.0, FIBRE);
        }
        Tool::Pick => pick(&mut mesh, r, end),
        Tool::Vitrector => {
            mesh.tube(&[round(0.0, r * 0.85), round(0.06, r), round(end, r)], 0.0, METAL);
            let port = |z, width: f32| Ring { z, x: r * 0.72, radii: [r * 0.33, width] };
            mesh.tube(
                &[port(0.3, r * 0.2), port(0.4, r * 0.6), port(0.65, r * 0.6), port(0.75, r * 0.2)],
                0.0,
                PORT,
            );
        }
        Tool::Needle => {
            // A 41-gauge cannula (0.1 mm) on the shaft.
            mesh.tube(&[round(0.0, 0.03), round(0.05, 0.05), round(4.0, 0.05)], 0.0, METAL);
            mesh.tube(&[round(3.9, r * 0.6), round(4.3, r), round(end, r)], 0.0, METAL);
        }
    }
    mesh
}

fn forceps(mesh: &mut Mesh, r: f32, end: f32) {
    let pivot = JAW_LENGTH_MM;
    mesh.tube(&[round(pivot - 0.25, r * 0.8), round(pivot, r), round(end, r)], 0.0, METAL);
    for side in [1.0, -1.0] {
        let at = |z: f32, offset: f32, thick: f32, wide: f32| Ring {
            z,
            x: side * r * offset,
            radii: [r * thick, r * wide],
        };
        let blade = [
            at(0.0, 0.16, 0.14, JAW_TAPER * 0.8),
            at(0.12, 0.20, 0.18, JAW_TAPER * 1.2),
            at(0.4, 0.34, 0.20, 0.5),
            at(0.9, 0.48, 0.24, 0.62),
            at(pivot, 0.42, 0.36, 0.75),
        ];
        mesh.tube(&blade, side, METAL);
    }
}

fn pick(mesh: &mut Mesh, r: f32, end: f32) {
    // The hook's point is the tip, at the origin; its arm reaches back to the shaft's axis.
    let arm = [
        Ring { z: 0.0, x: 0.0, radii: [0.015; 2] },
        Ring { z: 0.05, x: -0.12, radii: [0.05; 2] },
        Ring { z: 0.2, x: -0.22, radii: [0.07; 2] },
        Ring { z: 1.2, x: -0.12, radii: [0.09; 2] },
        round(2.4, r * 0.7),
        round(2.8, r),
        round(end, r),
    ];
    mesh.tube(&arm, 0.0, METAL);
}

impl Mesh {
    /// A closed tube through `rings` (z rising), with smooth sides and flat ends.
    fn tube(&mut self, rings: &[Ring], part: f32, material: f32) {
        let first = self.vertices.len() as u32;
        for (i, ring) in rings.iter().enumerate() {
            let (before, after) = (rings[i.saturating_sub(1)], rings[(i + 1).min(rings.len() - 1)]);
            for k in 0..CORNERS {
                let (sin, cos) = angle(k).sin_cos();
                let at = |r: Ring| Vec3::new(r.x + r.radii[0] * cos, r.radii[1] * sin, r.z);
                let around = Vec3::new(-ring.radii[0] * sin, ring.radii[1] * cos, 0.0);
                let normal = around.cross(at(after) - at(before)).normalize().to_array();
                let position = at(*ring).to_array();
                self.vertices.push(MetalVertex { position, normal, part, material });
            }
        }
        for i in 0..rings.len() as u32 - 1 {
            for k in 0..CORNERS as u32 {
                let next = (k + 1) % CORNERS as u32;
                let at = |ring: u32, corner: u32| first + ring * CORNERS as u32 + corner;
                let quad = [at(i, k), at(i, next), at(i + 1, next), at(i, k), at(i + 1, next), at(i + 1, k)];
                self.indices.extend(quad);
            }
        }
        self.cap(rings[0], -1.0, part, material);
        self.cap(rings[rings.len() - 1], 1.0, part, material);
    }

    /// Two triangles over four corners, counter-clockwise from outside, or clockwise where `flip`.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4], flip: bool) {
        self.indices.extend(if flip { [a, c, b, a, d, c] } else { [a, b, c, a, c, d] });
    }

    fn cap(&mut self, ring: Ring, facing: f32, part: f32, material: f32) {
        let first = self.vertices.len() as u32;
        for k in 0..CORNERS {
            let (sin, cos) = angle(k).sin_cos();
            let position = [ring.x + ring.radii[0] * cos, ring.radii[1] * sin, ring.z];
            self.vertices.push(MetalVertex { position, normal: [0.0, 0.0, facing], part, material });
        }
        for k in 1..CORNERS as u32 - 1 {
            let pair = if facing > 0.0 { [k, k + 1] } else { [k + 1, k] };
            self.indices.extend([first, first + pair[0], first + pair[1]]);
        }
    }
}

fn angle(corner: usize) -> f32 {
    corner as f32 * std::f32::consts::TAU / CORNERS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle];

    /// Position rounded to 0.1 µm, to weld the seams between sides and caps.
    fn welded(mesh: &Mesh, index: u32) -> [i32; 3] {
        mesh.vertices[index as usize].position.map(|c| (c * 1e4).round() as i32)
    }

    #[test]
    fn meshes_are_closed_and_turned_outwards() {
        for tool in TOOLS {
            let mesh = mesh(tool, 0.25, 60.0);
            let mut edges: HashMap<([i32; 3], [i32; 3]), i32> = HashMap::new();
            let mut volume = 0.0;
            for t in mesh.indices.chunks(3) {
                let p = [0, 1, 2].map(|i| Vec3::from(mesh.vertices[t[i] as usize].position));
                volume += p[0].dot(p[1].cross(p[2])) / 6.0;
                for i in 0..3 {
                    let (a, b) = (welded(&mesh, t[i]), welded(&mesh, t[(i + 1) % 3]));
                    *edges.entry((a, b)).or_default() += 1;
                    *edges.entry((b, a)).or_default() -= 1;
                }
            }
            assert!(edges.values().all(|&n| n == 0), "{tool:?} has an open edge");
            assert!(volume > 0.0, "{tool:?} is inside out");
        }
    }

    #[test]
    fn normals_are_unit_and_agree_with_the_triangles() {
        for tool in TOOLS {
            let mesh = mesh(tool, 0.25, 60.0);
            for t in mesh.indices.chunks(3) {
                let v = [0, 1, 2].map(|i| mesh.vertices[t[i] as usize]);
                let p = v.map(|v| Vec3::from(v.position));
                let face = (p[1] - p[0]).cross(p[2] - p[0]);
                for vertex in v {
                    let n = Vec3::from(vertex.normal);
                    assert!((n.length() - 1.0).abs() < 1e-4);
                    assert!(face.length() < 1e-9 || n.dot(face.normalize()) > 0.0, "{tool:?} {vertex:?}");
                }
            }
        }
    }

    #[test]
    fn tips_are_at_the_origin() {
        for tool in TOOLS {
            let mesh = mesh(tool, 0.25, 60.0);
            let lowest = mesh.vertices.iter().map(|v| v.position[2]).fold(f32::MAX, f32::min);
            assert!(lowest.abs() < 0.05, "{tool:?} begins at {lowest}");
        }
    }
}
