//! Shadows of shafts at the tiers whose mask of light has one sample a texel: their edges follow their
//! line and are as soft as similar triangles have them.

use crate::focus::linear_red;
use crate::geometry::project;
use crate::stage::Stage;
use glam::{DQuat, DVec3};
use protocol::geometry::Pose;
use renderer::governor::{Shading, TIERS};
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, SceneBlock, scene_with};

/// The light pipe's face, and the tip of a shaft between it and the retina, mm.
const LAMP: DVec3 = DVec3::new(0.0, 1.6, -4.5);
const TIP: DVec3 = DVec3::new(-5.0, -1.3, -8.0);
/// Part of the shaft whose shadow is looked at, mm over the tip.
const FROM_MM: f64 = 3.0;
const TO_MM: f64 = 7.0;
/// Radius of the light pipe's bright face, mm.
const FIBRE_MM: f64 = 0.125;
/// Half the angle of the mask, rad.
const MASK_RAD: f64 = 0.86;
/// Share of the light that a shadow leaves at most where it is measured.
const DARK: f64 = 0.2;
/// Farthest that an edge wanders from its line, root of the mean square, and lies beside it, px.
const WANDERS_PX: f64 = 0.15;
const BESIDE_PX: f64 = 0.25;
/// How soft it is, over what similar triangles say; a texel of the leanest mask is half a soft edge.
const SOFT: std::ops::Range<f64> = 0.85..1.6;

fn along() -> DVec3 {
    DVec3::new(1.0, 0.23, 0.06).normalize()
}

/// With the shaft, or with the light pipe alone.
fn lit(stage: &Stage, shaft: bool) -> SceneBlock {
    let mut scene = scene_with(&stage.file, &stage.rig, [0.0; 3], 0.0, &Contents::default());
    let [forceps, pipe] = &mut scene.header.instruments;
    pipe.world_from_instrument = Pose { position_mm: LAMP.to_array(), ..Pose::IDENTITY };
    let q = DQuat::from_rotation_arc(DVec3::Z, along());
    forceps.world_from_instrument = Pose { position_mm: TIP.to_array(), rotation_wxyz: [q.w, q.x, q.y, q.z] };
    if !shaft {
        forceps.tool = u32::MAX;
    }
    scene
}

/// Where an edge of the shaft throws its shadow, and how wide that is from a tenth to nine tenths of the
/// light: `side` 1 or −1 of the shaft, `mm` over the tip.
fn expected(stage: &Stage, side: f64, mm: f64) -> (DVec3, f64) {
    let axis = TIP + along() * mm;
    let across = along().cross(LAMP - axis).normalize();
    let edge = axis + across * (side * stage.file.instruments[0].shaft_radius_mm);
    let ray = (edge - LAMP).normalize();
    let (b, radius) = (LAMP.dot(ray), stage.file.eye.retina_radius_mm);
    let far = (b * b - LAMP.length_squared() + radius * radius).sqrt() - b;
    let near = (edge - LAMP).length();
    // A disc that sets behind an edge shows a tenth when the edge has 0.687 of its radius to go.
    (LAMP + ray * far, 2.0 * 0.687 * FIBRE_MM * (far - near) / near)
}

/// Of an edge in channel 0, at every column: px beside where it is expected, and its width over the
/// expected one.
fn measured(stage: &Stage, [with, without]: &[Picture; 2], side: f64) -> Vec<[f64; 2]> {
    let places: Vec<_> = (0..=40)
        .map(|k| expected(stage, side, FROM_MM + (TO_MM - FROM_MM) * f64::from(k) / 40.0))
        .map(|(p, wide_mm)| (project(stage, with, 0, p), wide_mm))
        .collect();
    let px_per_mm = f64::from(with.height_px) * 0.98 / stage.file.microscope.field_mm;
    let mut found = Vec::new();
    for pair in places.windows(2) {
        let [([ax, ay], wide_mm), ([bx, by], _)] = [pair[0], pair[1]];
        let slope = (by - ay) / (bx - ax);
        for column in ax.min(bx).ceil() as u32..ax.max(bx).ceil() as u32 {
            let line = ay + slope * (f64::from(column) + 0.5 - ax) - 0.5;
            // From the dark to the light.
            let outwards = if side_is_lower(&places, stage, with, side) { 1.0 } else { -1.0 };
            let reach = 0.5 * px_per_mm;
            let share = |d: f64| {
                let y = (line + outwards * d).round() as u32;
                (
                    outwards * (f64::from(y) - line),
                    linear_red(with, column, y) / linear_red(without, column, y),
                )
            };
            let profile: Vec<_> = (-(reach as i32)..=reach as i32).map(|d| share(f64::from(d))).collect();
            let dark = profile.iter().map(|p| p.1).fold(f64::MAX, f64::min);
            // In the soft edge of the beam there is too little light to detect an edge.
            if dark > DARK {
                continue;
            }
            let crossing = |level: f64| {
                let at = |p: &(f64, f64)| (p.1 - dark) / (1.0 - dark) - level;
                let w = profile.windows(2).find(|w| at(&w[0]) < 0.0 && at(&w[1]) >= 0.0).expect("an edge");
                w[0].0 + (w[1].0 - w[0].0) * at(&w[0]) / (at(&w[0]) - at(&w[1]))
            };
            let steep = slope.hypot(1.0);
            let width = (crossing(0.9) - crossing(0.1)) / steep;
            found.push([crossing(0.5) / steep, width / (wide_mm * px_per_mm)]);
        }
    }
    found
}

/// True if the edge of this side lies lower in the picture than the other.
fn side_is_lower(places: &[([f64; 2], f64)], stage: &Stage, picture: &Picture, side: f64) -> bool {
    places[0].0[1] > project(stage, picture, 0, expected(stage, -side, FROM_MM).0)[1]
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count().max(1) as f64
}

#[test]
fn shadows_of_shafts_follow_their_line_and_are_soft_at_lean_tiers() {
    let Some(stage) = Stage::open() else { return };
    let scenes = [true, false].map(|shaft| [lit(&stage, shaft)]);
    let mut failed = Vec::new();
    for tier in (0..TIERS.len()).filter(|&t| TIERS[t].shading == Shading::Lean) {
        let pictures = [0, 1].map(|i: usize| stage.draw(&scenes[i], tier));
        let texel_mm = 2.0 * MASK_RAD.tan() / f64::from(TIERS[tier].shadow_px) * 7.0;
        for side in [1.0, -1.0] {
            let found = measured(&stage, &pictures, side);
            let beside = mean(found.iter().map(|f| f[0]));
            let wanders = mean(found.iter().map(|f| (f[0] - beside).powi(2))).sqrt();
            let softness = mean(found.iter().map(|f| f[1]));
            println!(
                "tier {tier}, side {side}: {} columns, {beside:.3} px beside, wanders by {wanders:.3} px, \
                 {softness:.2} times as soft as expected (a texel is {texel_mm:.3} mm)",
                found.len()
            );
            let right = wanders < WANDERS_PX && beside.abs() < BESIDE_PX && SOFT.contains(&softness);
            if found.len() < 20 || !right {
                failed.push(tier);
            }
        }
    }
    assert!(failed.is_empty(), "tiers {failed:?}");
}
