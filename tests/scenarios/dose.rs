//! The dose of light, from the simulation that counts it to the picture that shows it.

use glam::{DMat4, DVec3, Mat4};
use protocol::dose::direction;
use protocol::scene::section;
use renderer::frame::Renderer;
use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::lamp::lamp_index;
use renderer::latch::latch_scene;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::similarity::reference_tier;
use renderer::view::view_uniform;
use scene::SceneFile;
use validation::moments::{REFERENCE_MAP_PX, ScenePlayer};

/// Angle between the light pipe's axis and the way from its tip to `p` (eye frame, mm), rad.
fn off_the_axis(block: &SceneBlock, p: DVec3) -> f64 {
    let tools = block.header.instruments.map(|i| protocol::handles::Tool::from_wire(i.tool));
    let pipe = latch_scene(&block.header).eye_from_instrument()[lamp_index(&tools).expect("a light pipe")];
    let (tip, ray) = (pipe.transform_point3(DVec3::ZERO), pipe.transform_vector3(DVec3::NEG_Z));
    (p - tip).angle_between(ray)
}

/// Mean place of what differs between two pictures of the left channel, px, and how many pixels
/// differ in either channel.
fn difference(a: &Picture, b: &Picture) -> ([f64; 2], usize) {
    let (mut sum, mut at, mut count) = (0.0, [0.0; 2], 0);
    for (y, x) in (0..a.height_px).flat_map(|y| (0..a.width_px).map(move |x| (y, x))) {
        let (p, q) = (a.rgb(x, y), b.rgb(x, y));
        let apart: f64 = (0..3).map(|c| f64::from(p[c].abs_diff(q[c]))).sum();
        count += usize::from(apart > 0.0);
        if x < a.width_px / 2 {
            sum += apart;
            at = [at[0] + apart * (f64::from(x) + 0.5), at[1] + apart * (f64::from(y) + 0.5)];
        }
    }
    (at.map(|c| c / f64::max(sum, 1.0)), count)
}

#[test]
fn the_picture_shows_most_light_where_the_lamp_points() {
    let Ok(gpu) = Gpu::headless().map_err(|e| skips::skip(&e)) else { return };
    let mut player = ScenePlayer::begin(SceneFile::load("peel").expect("a shipped scene"));
    let mut block = player.play_to(1.0);
    let radius = player.scene.eye.retina_radius_mm;
    let at = block.header.doses;
    let doses = section::<f32>(block.payload(), at).expect("doses").to_vec();
    let most = (0..doses.len()).max_by(|&a, &b| doses[a].total_cmp(&doses[b])).expect("cells");
    let centre = DVec3::from(direction(most).expect("a place on the retina")) * radius;
    // A slanting beam has retina nearer to it than on its axis, but at the full intensity; half a
    // cell is 0.1 rad from there.
    let off = off_the_axis(&block, centre);
    assert!(doses[most] > 0.0 && off < 0.30 + 0.1, "{off} rad off the axis, {centre}");

    // That cell alone, at the end of the scale: a spot about its centre.
    let start = at.offset as usize;
    let shown: &mut [f32] =
        bytemuck::cast_slice_mut(&mut block.payload_mut()[start..start + 4 * at.count as usize]);
    shown.fill(0.0);
    shown[most] = 600.0;
    for shading in Shading::ALL {
        let (tier, shading) = (reference_tier(shading), shading.name());
        let draw =
            |set_up: &dyn Fn(&mut Renderer)| player.draw_with(&gpu, &block, tier, REFERENCE_MAP_PX, set_up);
        let without = draw(&|_| {});
        let with = draw(&|r| r.show_dose(&gpu, true));
        let hidden = draw(&|r| {
            r.show_dose(&gpu, true);
            r.show_dose(&gpu, false);
        });
        assert_eq!(difference(&without, &hidden).1, 0, "{shading}: hidden again");
        let uniform = view_uniform(&block.header.microscope, 0, 1.25, &DMat4::IDENTITY);
        let ndc = Mat4::from_cols_array_2d(&uniform.clip_from_eye).project_point3(centre.as_vec3());
        let size = [with.width_px / 2, with.height_px].map(f64::from);
        let expected = [0.5 + 0.5 * f64::from(ndc.x), 0.5 - 0.5 * f64::from(ndc.y)];
        let expected = [expected[0] * size[0], expected[1] * size[1]];
        let (found, _) = difference(&with, &without);
        let px_per_mm = size[1] * 0.98 / block.header.microscope.field_mm;
        let apart_mm = (found[0] - expected[0]).hypot(found[1] - expected[1]) / px_per_mm;
        assert!(apart_mm < 0.4, "{shading}: {found:?}, expected {expected:?} px");
    }
}
