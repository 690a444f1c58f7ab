//! The border of a membrane: tissue thins out in an irregular line, and nothing shows where the
//! simulation's mesh ends.

use crate::geometry::project;
use crate::stage::Stage;
use glam::DVec3;
use protocol::scene::{NODE_FREE, SceneHome, SceneNode, SceneTriangle, TISSUE_MEMBRANE};
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, scene_with};

/// A fully shaded tier and a lean one.
const TIERS: [usize; 2] = [2, 3];
/// Cells along the membrane's edge, and their width, mm.
const CELLS: u32 = 20;
const CELL_MM: f64 = 0.24;
/// Most by which the picture changes across the mesh's edge, mean of three colours, levels of 255.
const STEP: f64 = 1.0;
/// Least by which the membrane changes the picture in its middle.
const SEEN: f64 = 8.0;

/// Place of a node of a square membrane about the pole, `height_mm` over the choroid.
fn place(radius_mm: f64, [i, j]: [u32; 2], height_mm: f64) -> DVec3 {
    let at = |n: u32| (f64::from(n) - 0.5 * f64::from(CELLS)) * CELL_MM;
    let (x, y) = (at(i), at(j));
    DVec3::new(x, y, -(radius_mm * radius_mm - x * x - y * y).sqrt()).normalize() * (radius_mm - height_mm)
}

fn membrane(radius_mm: f64) -> Contents {
    let along = CELLS + 1;
    let nodes = (0..along * along).map(|n| [n % along, n / along]);
    let position = |n: [u32; 2]| place(radius_mm, n, 0.02).as_vec3().to_array();
    let corner = |i: u32, j: u32| j * along + i;
    let triangles = (0..CELLS * CELLS).flat_map(|c| {
        let (i, j) = (c % CELLS, c / CELLS);
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        [[a, b, c], [a, c, d]].map(|nodes| SceneTriangle { nodes, tissue: TISSUE_MEMBRANE })
    });
    let home = |(node, n): (u32, [u32; 2])| {
        let cells = n.into_iter().map(|k| k.min(CELLS - k)).min().unwrap_or(0);
        SceneHome { position_mm: position(n), node, from_edge_mm: (f64::from(cells) * CELL_MM) as f32 }
    };
    Contents {
        nodes: nodes
            .clone()
            .map(|n| SceneNode { position_mm: position(n), flag: NODE_FREE as u16, dye: u16::MAX })
            .collect(),
        triangles: triangles.collect(),
        homes: (0..).zip(nodes).map(home).collect(),
        ..Contents::default()
    }
}

/// Mean difference of two pictures about a place in channel 0.
fn change(pictures: &[Picture; 2], [x, y]: [f64; 2]) -> f64 {
    let [a, b] = [0, 1].map(|i: usize| pictures[i].rgb(x.round() as u32, y.round() as u32).map(f64::from));
    (0..3).map(|c| b[c] - a[c]).sum::<f64>() / 3.0
}

#[test]
fn nothing_shows_where_the_mesh_of_a_membrane_ends() {
    let Some(stage) = Stage::open() else { return };
    let radius = stage.file.eye.retina_radius_mm;
    for tier in TIERS {
        let pictures = [Contents::default(), membrane(radius)].map(|contents| {
            let mut scene = scene_with(&stage.file, &stage.rig, [0.0; 3], 0.0, &contents);
            scene.header.instruments.iter_mut().for_each(|i| i.tool = u32::MAX);
            stage.draw(&[scene], tier)
        });
        let seen = |p: DVec3| change(&pictures, project(&stage, &pictures[0], 0, p)).abs();
        let middle = seen(place(radius, [CELLS / 2; 2], 0.02));
        // Just inside and outside of the two edges that run up and down.
        let steps = (4..CELLS - 4).flat_map(|j| [[0, j], [CELLS, j]]).map(|n| {
            let edge = place(radius, n, 0.02);
            let inwards = DVec3::new(if n[0] == 0 { 0.05 } else { -0.05 }, 0.0, 0.0);
            (seen(edge + inwards) - seen(edge - inwards)).abs()
        });
        let steps: Vec<f64> = steps.collect();
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        println!("tier {tier}: {middle:.1} levels in the middle, {mean:.2} across the mesh's edge");
        assert!(middle > SEEN, "tier {tier}: a membrane is seen, {middle:.1}");
        assert!(mean < STEP, "tier {tier}: the mesh's edge shows, {mean:.2}");
    }
}
