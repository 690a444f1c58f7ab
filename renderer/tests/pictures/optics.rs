//! Pictures through lenses against rays traced here: through a thin lens by its two principal rays,
//! through the flat contact lens by Snell's law.

use crate::markers::{BLUE, ball, blue_centroid, scene};
use crate::stage::Stage;
use glam::DVec3;
use protocol::optics::Lens;
use protocol::scene::Microscope;

/// A fully shaded tier and a lean one of the same size: the balls must be small against their
/// distance from the pupil, or the middle of their pictures is not the picture of their middle, and
/// yet have enough pixels.
const TIERS: [usize; 2] = [2, 3];
/// Share of the picture's height that the round field fills.
const FILL: f64 = 0.98;
/// As in the default scene's optics.
const FOCAL_MM: f64 = 12.0;
const LENS_MM: f64 = 21.5;

/// Where the two principal rays from `p` meet above a lens over the target.
fn image_by_lens(m: &Microscope, p: DVec3) -> DVec3 {
    let centre = DVec3::new(m.target_in_world_mm[0], m.target_in_world_mm[1], LENS_MM);
    // Straight on through the centre; parallel to the axis, then through the focus beyond.
    let (a, d) = (p, centre - p);
    let b = DVec3::new(p.x, p.y, LENS_MM);
    let e = centre + DVec3::Z * FOCAL_MM - b;
    // a + s d = b + t e, solved by the components across both.
    let n = d.cross(e);
    if n.length() < 1e-12 {
        let over = LENS_MM - p.z;
        return centre + DVec3::Z * (1.0 / (1.0 / FOCAL_MM - 1.0 / over));
    }
    a + d * ((b - a).cross(e).dot(n) / n.length_squared())
}

/// Place in a picture of `size` px of the point `seen` by a pinhole at the objective of `channel`,
/// focused on `target`; half a turn and the other objective with the inverter.
fn pinhole(m: &Microscope, channel: u32, size: [f64; 2], target: DVec3, seen: DVec3) -> [f64; 2] {
    let inverted = m.inverter != 0;
    let which = if inverted { 1 - channel } else { channel };
    let side = (f64::from(which) - 0.5) * m.stereo_base_mm;
    let objective = target + DVec3::new(-side, 0.0, m.working_distance_mm);
    let axis = (target - objective).normalize();
    let right = axis.cross(DVec3::NEG_Y).normalize();
    let down = axis.cross(right);
    let px_per_slope = size[1] * FILL / m.field_mm * objective.distance(target);
    let to = seen - objective;
    let turn = if inverted { -1.0 } else { 1.0 };
    let slope = |v: DVec3| turn * to.dot(v) / to.dot(axis);
    [0.5 * size[0] + px_per_slope * slope(right), 0.5 * size[1] + px_per_slope * slope(down)]
}

fn through(stage: &Stage, lens: Lens, inverter: bool) -> Microscope {
    let start = stage.file.start_microscope();
    assert_eq!((start.lens_focal_mm, start.lens_height_mm), (FOCAL_MM, LENS_MM));
    // A pinhole: places are measured, and what is out of focus has no sharp border.
    Microscope { lens: lens as u32, inverter: u32::from(inverter), aperture_mm: 0.0, ..start }
}

/// Off the axes: a disc that lies even to the pixels' rows loses or wins whole columns, a quarter
/// of a pixel.
const ASIDE: DVec3 = DVec3::new(0.17, 0.29, 0.0);

/// Places over the retina at three heights, `pitch` apart.
fn grid(pitch: f64) -> Vec<DVec3> {
    let places = (-2..=2).flat_map(|i| (-2..=2).map(move |j| (i, j)));
    let points = places.map(|(i, j)| {
        let height = [-8.6, -6.5, -4.0][(i + 2 * j + 6) as usize % 3];
        DVec3::new(pitch * f64::from(i), pitch * f64::from(j), height) + ASIDE
    });
    points.filter(|p| p.truncate().length() < 2.6 * pitch).collect()
}

/// Draws balls at `at` through `m` and gives the worst distance from where `expected` has them, px.
fn worst_px(
    stage: &Stage,
    m: &Microscope,
    tier: usize,
    at: &[DVec3],
    expected: impl Fn(u32, [f64; 2], DVec3) -> [f64; 2],
) -> f64 {
    let bodies = at.iter().map(|p| ball(p.to_array(), 0.25, BLUE)).collect();
    let mut scene = scene(stage, bodies, false);
    scene.header.microscope = *m;
    let picture = stage.draw(&[scene], tier);
    let size = [f64::from(picture.width_px / 2), f64::from(picture.height_px)];
    let mut worst: f64 = 0.0;
    for (channel, p) in (0..2).flat_map(|c| at.iter().map(move |p| (c, *p))) {
        let place = expected(channel, size, p);
        let found = blue_centroid(&picture, channel, place, 0.03 * size[1]);
        let found =
            found.unwrap_or_else(|| panic!("tier {tier}, channel {channel}: no ball for {p} at {place:?}"));
        worst = worst.max((found[0] - place[0]).hypot(found[1] - place[1]));
    }
    worst
}

#[test]
fn markers_through_the_wide_angle_lens_appear_where_its_rays_meet() {
    let Some(stage) = Stage::open() else { return };
    let at = grid(3.2);
    for (tier, inverter) in TIERS.iter().flat_map(|&t| [false, true].map(|i| (t, i))) {
        let m = through(&stage, Lens::WideAngle, inverter);
        let target = image_by_lens(&m, DVec3::from(m.target_in_world_mm));
        let rays = |c, size, p| pinhole(&m, c, size, target, image_by_lens(&m, p));
        let worst = worst_px(&stage, &m, tier, &at, rays);
        assert!(worst < 0.25, "tier {tier}, inverter {inverter}: {worst:.3} px");
    }
}

/// Where the ray from `p` in the eye leaves the flat face (at 14 mm, index 1.336 below it) on its
/// way to `objective`: where n sin(angle below) = sin(angle above), found by halving.
fn leaves_face(p: DVec3, objective: DVec3) -> DVec3 {
    let (face, index) = (14.0, 1.336);
    let away = (objective - p).truncate();
    let total = away.length();
    let at = |share: f64| (p.truncate() + away * share).extend(face);
    let excess = |share: f64| {
        let (below, above) = (total * share, total * (1.0 - share));
        index * below / below.hypot(face - p.z) - above / above.hypot(objective.z - face)
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if excess(middle) < 0.0 { low = middle } else { high = middle }
    }
    at(low)
}

#[test]
fn markers_under_the_flat_lens_appear_where_refracted_rays_arrive() {
    let Some(stage) = Stage::open() else { return };
    let at = grid(2.1);
    for (tier, inverter) in TIERS.iter().flat_map(|&t| [false, true].map(|i| (t, i))) {
        let m = through(&stage, Lens::Flat, inverter);
        // Apparent depth for a ray along the axis.
        let apparent = 14.0 - (14.0 - m.target_in_world_mm[2]) / 1.336;
        let target = DVec3::new(m.target_in_world_mm[0], m.target_in_world_mm[1], apparent);
        let rays = |c: u32, size, p| {
            let side = if (c == 1) != inverter { 0.5 } else { -0.5 };
            let objective = target + DVec3::new(-side * m.stereo_base_mm, 0.0, m.working_distance_mm);
            pinhole(&m, c, size, target, leaves_face(p, objective))
        };
        let worst = worst_px(&stage, &m, tier, &at, rays);
        assert!(worst < 0.25, "tier {tier}, inverter {inverter}: {worst:.3} px");
    }
}

#[test]
fn disparity_through_the_wide_angle_lens_is_that_of_the_pictures_depth() {
    let Some(stage) = Stage::open() else { return };
    for (inverter, height) in [false, true].into_iter().flat_map(|i| [1.5, 4.0, 8.0].map(|h| (i, h))) {
        let m = through(&stage, Lens::WideAngle, inverter);
        // The lens makes of heights over the target heights of its picture: Gauss' formula.
        let image = |s: f64| FOCAL_MM * s / (s - FOCAL_MM);
        let over = LENS_MM - m.target_in_world_mm[2];
        let higher = image(over - height) - image(over);
        let (half, distance) = (0.5 * m.stereo_base_mm, m.working_distance_mm);
        let angle = (half / (distance - higher)).atan() - (half / distance).atan();
        let p = DVec3::from(m.target_in_world_mm) + DVec3::Z * height + ASIDE;
        let mut scene = scene(&stage, vec![ball(p.to_array(), 0.4, BLUE)], false);
        scene.header.microscope = m;
        let picture = stage.draw(&[scene], TIERS[0]);
        let focal_px = f64::from(picture.height_px) * FILL / m.field_mm * half.hypot(distance);
        let expected = 2.0 * focal_px * angle.tan();
        let middle = [0.25 * f64::from(picture.width_px), 0.5 * f64::from(picture.height_px)];
        let x = [0, 1].map(|c| blue_centroid(&picture, c, middle, 60.0).expect("a blue ball")[0]);
        assert!((x[0] - x[1] - expected).abs() < 0.25, "{height} mm: {} and {expected} px", x[0] - x[1]);
        assert!(expected > 0.0, "what is nearer is seen nearer");
    }
}
