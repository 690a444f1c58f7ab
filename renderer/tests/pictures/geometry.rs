//! Geometry of the picture against formulas written out here: places of markers in each channel,
//! disparity between the channels, places of shadows, occlusion.

use crate::markers::{BLUE, ball, blue_centroid, centroid, is_blue, scene};
use crate::stage::Stage;
use glam::DVec3;
use renderer::readback::Picture;

/// A fully shaded tier and a lean one.
const TIERS: [usize; 2] = [2, 6];
/// Share of the picture's height that the round field fills.
const FILL: f64 = 0.98;

const RED: [f32; 4] = [0.9, 0.02, 0.02, 1.0];

/// Pinhole projection of `p` into `channel`, px of the channel; the surgeon's right is −x, up is
/// −y.
pub fn project(stage: &Stage, picture: &Picture, channel: u32, p: DVec3) -> [f64; 2] {
    let m = &stage.file.microscope;
    let target = DVec3::from(m.target_in_world_mm);
    let side = (f64::from(channel) - 0.5) * m.stereo_base_mm;
    let objective = target + DVec3::new(-side, 0.0, m.working_distance_mm);
    let axis = (target - objective).normalize();
    let right = axis.cross(DVec3::NEG_Y).normalize();
    let down = axis.cross(right);
    let (w, h) = (f64::from(picture.width_px / 2), f64::from(picture.height_px));
    let px_per_slope = 0.5 * h * FILL / (0.5 * m.field_mm) * objective.distance(target);
    let to = p - objective;
    let slope = |v: DVec3| to.dot(v) / to.dot(axis);
    [0.5 * w + px_per_slope * slope(right), 0.5 * h + px_per_slope * slope(down)]
}

/// Places over the retina, at three heights.
fn grid() -> impl Iterator<Item = DVec3> {
    let places = (-2..=2).flat_map(|i| (-2..=2).map(move |j| (i, j)));
    places.map(|(i, j)| {
        let height = [-9.6, -7.5, -5.0][(i + 2 * j + 6) as usize % 3];
        DVec3::new(2.3 * f64::from(i), 2.3 * f64::from(j), height)
    })
}

#[test]
fn markers_appear_where_a_pinhole_would_show_them() {
    let Some(stage) = Stage::open() else { return };
    let at: Vec<DVec3> = grid().filter(|p| p.truncate().length() < 6.0).collect();
    for tier in TIERS {
        let bodies = at.iter().map(|p| ball(p.to_array(), 0.4, BLUE)).collect();
        let scene = scene(&stage, bodies, false);
        let picture = stage.draw(&[scene], tier);
        for (channel, p) in (0..2).flat_map(|c| at.iter().map(move |p| (c, p))) {
            let expected = project(&stage, &picture, channel, *p);
            let reach = 0.045 * f64::from(picture.height_px);
            let found = blue_centroid(&picture, channel, expected, reach).expect("a blue ball");
            let apart = (found[0] - expected[0]).hypot(found[1] - expected[1]);
            assert!(apart < 0.25, "tier {tier}, channel {channel}, {p}: {found:?}, expected {expected:?}");
        }
    }
}

#[test]
fn channels_are_as_far_apart_as_the_height_says() {
    let Some(stage) = Stage::open() else { return };
    let m = stage.file.microscope.clone();
    for height in [1.5, 4.0, 8.0] {
        let p = DVec3::from(m.target_in_world_mm) + DVec3::Z * height;
        let scene = scene(&stage, vec![ball(p.to_array(), 0.4, BLUE)], false);
        let picture = stage.draw(&[scene], TIERS[0]);
        let middle = [0.25 * f64::from(picture.width_px), 0.5 * f64::from(picture.height_px)];
        let x = [0, 1].map(|c| blue_centroid(&picture, c, middle, 60.0).expect("a blue ball")[0]);
        // Angle at an objective between the target and a point over it, times the picture's focal
        // length.
        let (half, distance) = (0.5 * m.stereo_base_mm, m.working_distance_mm);
        let angle = (half / (distance - height)).atan() - (half / distance).atan();
        let focal_px = 0.5 * f64::from(picture.height_px) * FILL / (0.5 * m.field_mm) * half.hypot(distance);
        let expected = 2.0 * focal_px * angle.tan();
        assert!((x[0] - x[1] - expected).abs() < 0.25, "{height} mm: {} and {expected} px", x[0] - x[1]);
    }
}

#[test]
fn a_shadow_falls_where_the_ray_from_the_lamp_ends() {
    let Some(stage) = Stage::open() else { return };
    // The light pipe's tip, as the scene has it, and a small ball below it.
    let (lamp, caster, radius) =
        (DVec3::new(-2.6, 0.6, -5.0), DVec3::new(-1.4, -0.3, -8.5), stage.file.eye.retina_radius_mm);
    let ray = (caster - lamp).normalize();
    let b = caster.dot(ray);
    let shadow = caster + ray * ((b * b - caster.length_squared() + radius * radius).sqrt() - b);
    for (tier, shadow_px) in TIERS.map(|t| (t, renderer::governor::TIERS[t].shadow_px)) {
        let (without, with) =
            (scene(&stage, vec![], true), scene(&stage, vec![ball(caster.to_array(), 0.16, BLUE)], true));
        let (without, with) = (stage.draw(&[without], tier), stage.draw(&[with], tier));
        for channel in 0..2 {
            let expected = project(&stage, &with, channel, shadow);
            let darkness = |x, y| {
                let (before, after) = (without.rgb(x, y), with.rgb(x, y));
                if is_blue(after) { 0.0 } else { f64::from(before[0].saturating_sub(after[0])) }
            };
            let px_per_mm = f64::from(with.height_px) * FILL / stage.file.microscope.field_mm;
            let found = centroid(&with, channel, expected, 0.6 * px_per_mm, darkness).expect("a shadow");
            let texel_mm = 2.0 * 0.86f64.tan() / f64::from(shadow_px) * (shadow - lamp).length();
            let apart_mm = (found[0] - expected[0]).hypot(found[1] - expected[1]) / px_per_mm;
            assert!(
                apart_mm < texel_mm,
                "tier {tier}, channel {channel}: {apart_mm} mm, a texel is {texel_mm}"
            );
        }
    }
}

#[test]
fn what_is_nearer_hides_what_is_farther() {
    let Some(stage) = Stage::open() else { return };
    for (tier, low, reversed) in TIERS.iter().flat_map(|&t| {
        [-10.5, -9.0].into_iter().flat_map(move |low| [false, true].map(move |reversed| (t, low, reversed)))
    }) {
        // Over each other on the middle axis, 0.02 mm apart, in both orders of drawing.
        let mut bodies = vec![ball([0.0, 0.0, low], 0.5, RED), ball([0.0, 0.0, low + 0.12], 0.4, BLUE)];
        if reversed {
            bodies.reverse();
        }
        let scene = scene(&stage, bodies, false);
        let picture = stage.draw(&[scene], tier);
        for channel in 0..2 {
            let [x, y] =
                project(&stage, &picture, channel, DVec3::new(0.0, 0.0, low + 0.5)).map(|c| c as u32);
            let seen = picture.rgb(channel * picture.width_px / 2 + x, y);
            assert!(is_blue(seen), "tier {tier}, {low}, reversed {reversed}: {seen:?}");
        }
    }
}

#[test]
fn the_retina_hides_what_is_behind_it_and_shows_what_lies_on_it() {
    let Some(stage) = Stage::open() else { return };
    for (tier, x) in TIERS.iter().flat_map(|&t| [-4.0, 0.0, 3.0].map(|x| (t, x))) {
        let outwards = DVec3::new(x, 1.0, -11.0).normalize();
        let blue = |stage: &Stage, at: f64| {
            let scene = scene(stage, vec![ball((outwards * at).to_array(), 0.3, BLUE)], false);
            let picture = stage.draw(&[scene], tier);
            let all = (0..picture.height_px).flat_map(|y| (0..picture.width_px).map(move |x| (x, y)));
            all.filter(|&(x, y)| is_blue(picture.rgb(x, y))).count()
        };
        assert_eq!(blue(&stage, 12.0), 0, "tier {tier}: a ball behind the retina");
        assert!(blue(&stage, 11.4) > 40, "tier {tier}: a ball that lies on the retina");
    }
}
