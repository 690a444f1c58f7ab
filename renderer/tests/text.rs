//! Lines of text stand where they belong in both channels, at every tier. Where there is no graphics driver the test
//! says so in one line and passes.

#[path = "../examples/common/mod.rs"]
mod common;

use common::{Contents, scene_of};
use protocol::rig::Rig;
use renderer::frame::Renderer;
use renderer::governor::TIERS;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::readback::{Picture, ReadBack};
use renderer::start::plan;
use scene::{DEFAULT_SCENE, SceneFile};

const FIRST_TIER: usize = 5;

/// Pixels of amber ink within the box (shares of a channel) of `channel`.
fn ink(picture: &Picture, channel: u32, [left, top, right, bottom]: [f64; 4]) -> usize {
    let (w, h) = (picture.width_px / 2, picture.height_px);
    let inside = |x: u32, y: u32| {
        let (u, v) = ((f64::from(x) + 0.5) / f64::from(w), (f64::from(y) + 0.5) / f64::from(h));
        (left..right).contains(&u) && (top..bottom).contains(&v)
    };
    let all = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y));
    let amber = |p: [u8; 3]| p[0] > 120 && p[1] > 100 && p[2] > 40 && p[0] > p[2] + 40;
    all.filter(|&(x, y)| amber(picture.rgb(channel * w + x, y))).count()
}

#[test]
fn the_status_stands_in_the_corner_and_goes_again() {
    let gpu = match Gpu::headless() {
        Ok(gpu) => gpu,
        Err(e) => return println!("skipped: {e}"),
    };
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE).unwrap(), Rig::load_or_shipped(None).unwrap());
    let mut renderer = Renderer::new(&gpu, plan(&file, &rig, FIRST_TIER, 512)).unwrap();
    let scene = scene_of(&file, &rig, [6.0, 3.0, 2.0], 0.3, &Contents::default());
    renderer.take_scene(&gpu, &scene.header, bytemuck::cast_slice(&scene.payload)).unwrap();
    let latched = latch_scene(&scene.header);
    let read_back = ReadBack::new(&gpu, FIRST_TIER);
    let draw = |renderer: &mut Renderer, tier: usize| {
        // Twice: text follows with the next frame.
        for _ in 0..2 {
            let commands = renderer.encode(&gpu, tier);
            renderer.submit(&gpu, tier, &latched, commands);
        }
        let mut picture = Picture::default();
        read_back.read(&gpu, renderer.target(tier), &mut picture).unwrap();
        picture
    };
    let corner = [0.0, 0.0, 0.4, 0.16];
    for tier in FIRST_TIER..TIERS.len() {
        renderer.say("tier 6: 320*256\nframes of 23 ms");
        let shown = draw(&mut renderer, tier);
        renderer.say("");
        let gone = draw(&mut renderer, tier);
        for channel in 0..2 {
            let (with, without) = (ink(&shown, channel, corner), ink(&gone, channel, corner));
            assert!(
                with > 120 && without == 0,
                "tier {tier}, channel {channel}: {with} and {without} pixels"
            );
        }
        assert_eq!(ink(&shown, 0, [0.0, 0.85, 1.0, 1.0]), ink(&gone, 0, [0.0, 0.85, 1.0, 1.0]));
    }
}
