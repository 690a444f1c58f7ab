//! Edges of shafts where a pixel has one sample: they follow their line within a fraction of a pixel.
//! Without smoothing an edge steps by whole pixels, 0.29 px of the line on average (the root of 1/12).
//!
//! The share of a pixel that the shaft covers follows from two pictures before different marks: what is seen of the
//! marks beside the shaft differs between them, the shaft does not.

use crate::geometry::project;
use crate::stage::Stage;
use glam::{DQuat, DVec3};
use protocol::geometry::Pose;
use protocol::scene::SceneMark;
use renderer::governor::{Shading, TIERS};
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, SceneBlock, scene_with};

/// Difference of the marks in the pictures from which an edge is detected, of 3 · 255.
const CONTRAST: f64 = 60.0;
/// Farthest that an edge wanders from its line, root of the mean square, px; and on average.
const WANDERS_PX: f64 = 0.08;
const BESIDE_PX: f64 = 0.05;
/// Part of the shaft that is looked at, mm over the tip.
const FROM_MM: f64 = 2.0;
const TO_MM: f64 = 7.0;

/// The forceps over a mark of this brightness.
fn before(stage: &Stage, brightness: f32) -> SceneBlock {
    let position_mm = [2.0, 1.2, -11.2];
    let rgba = [brightness, brightness, brightness, 1.0];
    let mark = SceneMark { position_mm, radius_mm: 3.0, rgba };
    let contents = Contents { marks: vec![mark], ..Contents::default() };
    scene_with(&stage.file, &stage.rig, [0.0, 0.0, -9.0], 0.3, &contents)
}

fn along(pose: &Pose) -> DVec3 {
    let [w, x, y, z] = pose.rotation_wxyz;
    DQuat::from_xyzw(x, y, z, w) * DVec3::Z
}

/// How far edges of the shaft at `pose` are from where they are expected in channel 0, px, at every
/// column in which they can be detected: `side` 1 below, −1 above.
fn deviations(stage: &Stage, pictures: &[Picture; 2], pose: &Pose, side: f64) -> Vec<f64> {
    let (tip, along) = (DVec3::from(pose.position_mm), along(pose));
    let at = |mm: f64| project(stage, &pictures[0], 0, tip + along * mm);
    let ([ax, ay], [bx, by]) = (at(FROM_MM), at(TO_MM));
    let slope = (by - ay) / (bx - ax);
    let microscope = &stage.file.microscope;
    let px_per_mm = f64::from(pictures[0].height_px) * 0.98 / microscope.field_mm;
    let seen = |x: u32, y: i64| {
        let [a, b] = [0, 1].map(|i: usize| pictures[i].rgb(x, y.max(0) as u32).map(f64::from));
        (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>()
    };
    let mut found = Vec::new();
    for column in ax.min(bx).ceil() as u32..ax.max(bx) as u32 {
        let share = (f64::from(column) + 0.5 - ax) / (bx - ax);
        let height =
            (tip + along * (FROM_MM + (TO_MM - FROM_MM) * share)).z - microscope.target_in_world_mm[2];
        let nearer = microscope.working_distance_mm / (microscope.working_distance_mm - height);
        let radius_px = stage.file.instruments[0].shaft_radius_mm * px_per_mm * nearer;
        let edge = ay + (by - ay) * share + side * radius_px * slope.hypot(1.0);
        // From the shaft outwards, the first within it.
        let first = (edge - 2.0 * side).floor() as i64;
        let free: Vec<f64> = (0..6).map(|k| seen(column, first + k * side as i64)).collect();
        let beyond = free[5];
        // A shadow beside the edge is no edge.
        if beyond > CONTRAST && (free[4] - beyond).abs() < 0.1 * beyond && free[0] < 0.1 * beyond {
            let covered: f64 = free[..5].iter().map(|f| 1.0 - (f / beyond).min(1.0)).sum();
            let start = first as f64 + if side > 0.0 { 0.0 } else { 1.0 };
            found.push((start + side * covered - edge) * side / slope.hypot(1.0));
        }
    }
    found
}

#[test]
fn edges_of_shafts_follow_their_line_at_lean_tiers() {
    let Some(stage) = Stage::open() else { return };
    let scenes = [0.9, 0.0].map(|brightness| [before(&stage, brightness)]);
    let pose = scenes[0][0].header.instruments[0].world_from_instrument;
    let mut failed: Vec<usize> = Vec::new();
    for tier in (0..TIERS.len()).filter(|&t| TIERS[t].shading == Shading::Lean) {
        let pictures = [0, 1].map(|i: usize| stage.draw(&scenes[i], tier));
        let sides = [1.0, -1.0].iter();
        let found: Vec<f64> = sides.flat_map(|&side| deviations(&stage, &pictures, &pose, side)).collect();
        let mean = found.iter().sum::<f64>() / found.len() as f64;
        let wanders = (found.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / found.len() as f64).sqrt();
        println!("tier {tier}: {} columns, {mean:.3} px beside, wanders by {wanders:.3} px", found.len());
        if found.len() < 10 || wanders > WANDERS_PX || mean.abs() > BESIDE_PX {
            failed.push(tier);
        }
    }
    assert!(failed.is_empty(), "tiers {failed:?}");
}
