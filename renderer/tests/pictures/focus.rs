//! Depth of field and the soft edges of shadows, against formulas written out here, in the full
//! tiers.

use crate::markers::{BLUE, ball, scene};
use crate::stage::Stage;
use glam::DVec3;
use protocol::geometry::Pose;
use protocol::scene::{Microscope, SceneBody};
use renderer::readback::Picture;

/// A fully shaded tier.
const TIER: usize = 2;
/// Share of the picture's height that the round field fills.
const FILL: f64 = 0.98;
/// The microscope looks at the fovea.
const FOVEA: DVec3 = DVec3::new(0.0, 0.0, -11.5);

fn looking_at_the_fovea(stage: &Stage, field_mm: f64, aperture_mm: f64, focus_mm: f64) -> Microscope {
    let target_in_world_mm = FOVEA.to_array();
    Microscope { target_in_world_mm, field_mm, aperture_mm, focus_mm, ..stage.file.start_microscope() }
}

fn draw(stage: &Stage, microscope: &Microscope, bodies: Vec<SceneBody>) -> Picture {
    let mut scene = scene(stage, bodies, false);
    scene.header.microscope = *microscope;
    stage.draw(&[scene], TIER)
}

/// Light of a channel of colour as the picture holds it: square roots, 8 bits.
fn light(picture: &Picture, x: u32, y: u32, colour: usize) -> f64 {
    (f64::from(picture.rgb(x, y)[colour]) / 255.0).powi(2)
}

/// Light of red, the strongest colour, before the tone curve 1.35 x / (0.6 + x).
pub fn linear_red(picture: &Picture, x: u32, y: u32) -> f64 {
    let shown = light(picture, x, y, 0);
    0.6 * shown / (1.35 - shown)
}

/// Mean variance along x and y of the blue light that a ball adds to the left channel, px².
fn spread_px2(with: &Picture, without: &Picture) -> f64 {
    let width = with.width_px / 2;
    let all = (0..with.height_px).flat_map(|y| (0..width).map(move |x| (x, y)));
    let mut sums = [0.0; 4];
    for (x, y) in all {
        let more = light(with, x, y, 2) - light(without, x, y, 2);
        if more > 1e-3 {
            let (fx, fy) = (f64::from(x), f64::from(y));
            for (sum, value) in sums.iter_mut().zip([1.0, fx, fy, fx * fx + fy * fy]) {
                *sum += more * value;
            }
        }
    }
    let [n, x, y, squares] = sums;
    assert!(n > 10.0, "a ball is seen");
    0.5 * (squares / n - (x / n).powi(2) - (y / n).powi(2))
}

#[test]
fn a_marker_out_of_focus_is_as_wide_as_the_formula_says() {
    let Some(stage) = Stage::open() else { return };
    // Aperture, focus over the fovea and height of the ball over it, mm: nearer than the plane of
    // focus, and farther.
    for (aperture, focus, height) in [(6.0, 0.0, 4.0), (6.0, 0.0, 7.0), (10.0, 3.0, 8.0), (10.0, 6.0, 2.0)] {
        let blurred = looking_at_the_fovea(&stage, 8.0, aperture, focus);
        let sharp = Microscope { aperture_mm: 0.0, ..blurred };
        let p = FOVEA + DVec3::Z * height;
        let [wide, narrow] = [blurred, sharp].map(|m| {
            let [with, without] =
                [vec![ball(p.to_array(), 0.2, BLUE)], vec![]].map(|bodies| draw(&stage, &m, bodies));
            (spread_px2(&with, &without), with.height_px)
        });
        // A uniform disc of the diameter c has the variance c² / 16 along an axis; variances add
        // up.
        let found = 4.0 * (wide.0 - narrow.0).max(0.0).sqrt();
        let (half, over) = (0.5 * blurred.stereo_base_mm, blurred.working_distance_mm);
        let axis = DVec3::new(-half, 0.0, -over).normalize();
        let distance = (p - (FOVEA + DVec3::new(half, 0.0, over))).dot(axis);
        let in_focus = half.hypot(over) - focus;
        let px_per_mm = FILL * f64::from(wide.1) / 8.0;
        let expected = aperture * (in_focus - distance).abs() / distance * px_per_mm;
        println!(
            "aperture {aperture}, focus {focus}, height {height}: {found:.2} px, by the formula {expected:.2}"
        );
        assert!(
            (found - expected).abs() < 0.1 * expected + 0.3,
            "aperture {aperture}, focus {focus}, height {height}: {found:.2} px, expected {expected:.2}"
        );
    }
}

#[test]
fn what_is_in_focus_stays_as_it_is_whatever_lies_behind_it() {
    let Some(stage) = Stage::open() else { return };
    // Focused on the ball; the retina lies 5 mm behind.
    let m = looking_at_the_fovea(&stage, 8.0, 10.0, 5.0);
    let p = FOVEA + DVec3::Z * 5.0;
    let spread = [m, Microscope { aperture_mm: 0.0, ..m }].map(|m| {
        let [with, without] =
            [vec![ball(p.to_array(), 0.2, BLUE)], vec![]].map(|bodies| draw(&stage, &m, bodies));
        spread_px2(&with, &without)
    });
    let wider = 4.0 * (spread[0] - spread[1]).max(0.0).sqrt();
    assert!(wider < 1.5, "{wider:.2} px wider");
    // And a patch smaller than a pixel changes nothing at all.
    let nearly = looking_at_the_fovea(&stage, 16.0, 0.05, 0.0);
    let bodies = || vec![ball([0.5, 0.5, -9.0], 0.3, BLUE)];
    let none = Microscope { aperture_mm: 0.0, ..nearly };
    assert!(draw(&stage, &nearly, bodies()) == draw(&stage, &none, bodies()), "a copy to the bit");
}

/// Height of the lamp over the fovea, and how far beside it stands, mm.
const LAMP_MM: f64 = 7.5;
const ASIDE_MM: f64 = 2.0;
/// Radius of the light pipe's bright face, mm.
const FIBRE_MM: f64 = 0.125;

/// How wide the edge of a plate's shadow is at the fovea, from a tenth to nine tenths of the light,
/// mm. The plate lies so far below the lamp that its edge throws its shadow on the fovea.
fn shadow_edge_mm(stage: &Stage, below_mm: f64) -> f64 {
    const FIELD_MM: f64 = 4.0;
    let edge = -ASIDE_MM + ASIDE_MM * below_mm / LAMP_MM;
    let plate = SceneBody {
        shape: 1,
        half_extents_mm: [0.5, 1.5, 0.01],
        ..ball([edge - 0.5, 0.0, FOVEA.z + LAMP_MM - below_mm], 1.0, BLUE)
    };
    let microscope = looking_at_the_fovea(stage, FIELD_MM, 0.0, 0.0);
    let [with, without] = [vec![plate], vec![]].map(|bodies| {
        let mut scene = scene(stage, bodies, true);
        scene.header.microscope = microscope;
        scene.header.instruments[1].world_from_instrument =
            Pose { position_mm: [-ASIDE_MM, 0.0, FOVEA.z + LAMP_MM], ..Pose::IDENTITY };
        stage.draw(&[scene], TIER)
    });
    let px_per_mm = FILL * f64::from(with.height_px) / FIELD_MM;
    let (middle_x, middle_y) = (with.width_px / 4, with.height_px / 2);
    let red = |picture: &Picture, x: u32| {
        (middle_y - 10..middle_y + 10).map(|y| linear_red(picture, x, y)).sum::<f64>()
    };
    // Right in the picture is −x: from the lit side at the right to the dark one at the left.
    let reach = (0.6 * px_per_mm) as u32;
    let shares: Vec<f64> =
        (middle_x - reach..middle_x + reach).map(|x| red(&with, x) / red(&without, x)).collect();
    let dark = shares.iter().copied().fold(f64::MAX, f64::min);
    let lit: Vec<f64> = shares.iter().map(|s| (s - dark) / (1.0 - dark)).collect();
    let crossing = |level: f64| {
        let i = lit.windows(2).position(|w| (w[0] < level) != (w[1] < level)).expect("an edge");
        i as f64 + (level - lit[i]) / (lit[i + 1] - lit[i])
    };
    (crossing(0.9) - crossing(0.1)).abs() / px_per_mm
}

#[test]
fn shadows_are_the_softer_the_farther_their_caster_is() {
    let Some(stage) = Stage::open() else { return };
    for below in [2.0, 3.0, 4.5] {
        let found = shadow_edge_mm(&stage, below);
        let half = FIBRE_MM * (LAMP_MM - below) / below;
        // A disc that sets behind an edge shows a tenth when the edge has 0.687 of its radius to go
        // from its middle.
        let expected = 2.0 * 0.687 * half;
        println!("plate {below} mm below the lamp: {found:.4} mm, by similar triangles {expected:.4}");
        assert!(
            (found / expected - 1.0).abs() < 0.2,
            "plate {below} mm below the lamp: {found:.4} mm, expected {expected:.4}"
        );
    }
}
