//! Balls as markers in a picture, and measurements of their places.

use crate::stage::Stage;
use protocol::scene::SceneBody;
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, SceneBlock, scene_with};

/// A tool number without a tool: no instrument is drawn, and a chandelier lights the eye.
const NO_TOOL: u32 = 99;
/// Colour of a marker.
pub const BLUE: [f32; 4] = [0.02, 0.05, 0.9, 1.0];

/// A ball, eye frame, mm.
pub fn ball(at: [f64; 3], radius: f32, rgba: [f32; 4]) -> SceneBody {
    SceneBody {
        position_mm: at.map(|c| c as f32),
        shape: 0,
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        half_extents_mm: [radius; 3],
        reserved: 0,
        rgba,
    }
}

/// The eye with these bodies, with or without the instruments.
pub fn scene(stage: &Stage, bodies: Vec<SceneBody>, tools: bool) -> SceneBlock {
    let contents = Contents { bodies, ..Contents::default() };
    let mut scene = scene_with(&stage.file, &stage.rig, [6.0, 3.0, 2.0], 0.3, &contents);
    // A pinhole: places are measured, and what is out of focus has no sharp border.
    scene.header.microscope.aperture_mm = 0.0;
    if !tools {
        scene.header.instruments.iter_mut().for_each(|i| i.tool = NO_TOOL);
    }
    scene
}

/// Mean place of the pixels of `channel` within `reach` px of `about` that `counts` weighs, px from
/// the corner.
pub fn centroid(
    picture: &Picture,
    channel: u32,
    about: [f64; 2],
    reach: f64,
    counts: impl Fn(u32, u32) -> f64,
) -> Option<[f64; 2]> {
    let width = picture.width_px / 2;
    let mut sums = [0.0; 3];
    for (y, x) in (0..picture.height_px).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let at = [f64::from(x) + 0.5, f64::from(y) + 0.5];
        if (at[0] - about[0]).hypot(at[1] - about[1]) < reach {
            let weight = counts(channel * width + x, y);
            sums = [sums[0] + weight * at[0], sums[1] + weight * at[1], sums[2] + weight];
        }
    }
    (sums[2] > 0.0).then(|| [sums[0] / sums[2], sums[1] / sums[2]])
}

/// True for the colour of a marker, lit or not.
pub fn is_blue(p: [u8; 3]) -> bool {
    p[2] > 40 && u16::from(p[2]) > u16::from(p[0]) + 20
}

/// Middle of the marker near `about`.
pub fn blue_centroid(picture: &Picture, channel: u32, about: [f64; 2], reach: f64) -> Option<[f64; 2]> {
    // Pixels that the marker covers in part count in part, whatever lights it.
    let covered = |[r, _, b]: [u8; 3]| ((f64::from(b) - f64::from(r)) / 40.0).clamp(0.0, 1.0);
    let counts = |p| if is_blue(p) { covered(p) } else { 0.0 };
    centroid(picture, channel, about, reach, |x, y| counts(picture.rgb(x, y)))
}
