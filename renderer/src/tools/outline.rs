//! Outlines of round parts: strips along their axis that the shader turns towards the viewer, to
//! smooth the edges of shafts where a pixel has one sample.

use super::{JAW_LENGTH_MM, Mesh, Model, Shaft, fitted};
use crate::layout::MetalVertex;
use protocol::handles::{HOOK_THICKNESS_MM, Tool};

/// Parts that are bodies of revolution.
const ROUND: [&str; 3] = ["shaft", "cannula", "fibre"];
/// Rings of vertices nearer to each other than this are one, mm.
const SAME_MM: f32 = 1e-3;
/// Light changes along a shaft: farthest that two steps are apart, mm, up to the height over the tip
/// beyond which nothing of it is in the field.
const STEP_MM: f32 = 1.0;
const IN_FIELD_MM: f32 = 16.0;

/// Height over the tip from which a tool is round, mm: under it are jaws or a hook.
pub fn round_from_mm(tool: Tool) -> f32 {
    match tool {
        Tool::Forceps => JAW_LENGTH_MM,
        Tool::Pick => 1.5 * HOOK_THICKNESS_MM as f32,
        _ => -1.0,
    }
}

/// Strips over the round parts of `tool`: pairs of vertices on both sides of the axis, with its radius
/// as x.
pub fn outline(model: &Model, tool: Tool, shaft: &Shaft) -> Mesh {
    let mut mesh = Mesh::default();
    for part in model.parts.iter().filter(|p| ROUND.contains(&p.name.as_str())) {
        let mut vertices: Vec<_> = part.vertices.iter().map(|v| fitted(v, &part.name, shaft)).collect();
        vertices.retain(|v| v.position[2] >= round_from_mm(tool));
        let rings = with_steps(&widest_rings(&mut vertices));
        let material = if part.name == "fibre" { super::FIBRE } else { super::METAL };
        mesh.append(strip(&rings, material));
    }
    mesh
}

/// The parts of `model` that are not round.
pub fn angular(model: &Model, shaft: &Shaft) -> Mesh {
    model.mesh_of(shaft, |part| !ROUND.contains(&part))
}

/// Height and greatest radius of each ring, the lowest first; those in between that lie on the line
/// of their neighbours are left out.
fn widest_rings(vertices: &mut [MetalVertex]) -> Vec<[f32; 2]> {
    vertices.sort_by(|a, b| a.position[2].total_cmp(&b.position[2]));
    let mut rings: Vec<[f32; 2]> = Vec::new();
    for [x, y, z] in vertices.iter().map(|v| v.position) {
        match rings.last_mut() {
            Some(ring) if z - ring[0] < SAME_MM => ring[1] = ring[1].max(x.hypot(y)),
            _ => rings.push([z, x.hypot(y)]),
        }
    }
    let mut plain: Vec<[f32; 2]> = Vec::new();
    for (i, &ring) in rings.iter().enumerate() {
        let between = plain.last().zip(rings.get(i + 1));
        let on_line = between.is_some_and(|(a, b)| {
            let there = a[1] + (b[1] - a[1]) * (ring[0] - a[0]) / (b[0] - a[0]);
            (there - ring[1]).abs() < SAME_MM
        });
        if !on_line {
            plain.push(ring);
        }
    }
    plain
}

fn with_steps(rings: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let mut steps: Vec<[f32; 2]> = rings.first().copied().into_iter().collect();
    for pair in rings.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        let seen = b[0].min(IN_FIELD_MM) - a[0];
        let count = (seen / STEP_MM).ceil().max(1.0);
        for k in 1..=count as u32 {
            let z = a[0] + seen * k as f32 / count;
            if seen > 0.0 && z < b[0] - SAME_MM {
                steps.push([z, a[1] + (b[1] - a[1]) * (z - a[0]) / (b[0] - a[0])]);
            }
        }
        steps.push(b);
    }
    steps
}

fn strip(rings: &[[f32; 2]], material: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for [z, radius] in rings {
        mesh.vertices.extend([-1.0f32, 1.0].map(|side| MetalVertex {
            position: [side * radius, 0.0, *z],
            normal: [side, 0.0, 0.0],
            part: 0.0,
            material,
        }));
    }
    for k in 1..rings.len() as u32 {
        let [a, b] = [2 * (k - 1), 2 * k];
        mesh.quad([a, a + 1, b + 1, b], false);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tools::{Models, TOOLS};

    #[test]
    fn outlines_are_as_wide_as_the_meshes_and_few() {
        let shaft = Shaft { radius_mm: 0.3, length_mm: 45.0, cannula_mm: 0.06 };
        let models = Models::shipped().unwrap();
        for tool in TOOLS {
            let mesh = outline(models.of(tool), tool, &shaft);
            assert!((30..110).contains(&mesh.vertices.len()), "{tool:?}: {}", mesh.vertices.len());
            let longest = mesh.vertices.iter().map(|v| v.position[2]).fold(0.0, f32::max);
            assert!((longest - 45.0).abs() < 1e-4, "{tool:?}: {longest}");
            assert!(mesh.vertices.iter().all(|v| v.position[2] >= round_from_mm(tool)), "{tool:?}");
            for v in models.of(tool).mesh(&shaft).vertices.iter().filter(|v| v.position[2] > 6.0) {
                let [x, y, z] = v.position;
                let beside = mesh.vertices.iter().min_by_key(|o| ((o.position[2] - z).abs() * 1e4) as u64);
                let wide = beside.map_or(0.0, |o| o.position[0].abs());
                assert!(x.hypot(y) < wide + 1e-4, "{tool:?}: {} at {z}, {wide}", x.hypot(y));
            }
        }
        let needle = outline(models.of(Tool::Needle), Tool::Needle, &shaft);
        let thin = needle.vertices.iter().filter(|v| v.position[2] < 3.0 && v.position[2] > 0.1);
        assert!(thin.clone().count() > 3 && thin.clone().all(|v| (v.position[0].abs() - 0.06).abs() < 1e-5));
    }
}
