//! Lines of text stand at their places in both channels, at every tier.

use crate::stage::Stage;
use renderer::governor::TIERS;
use renderer::latch::{Latched, latch_scene};
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::{Contents, scene_with};

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
    let Some(stage) = Stage::open() else { return };
    let mut offscreen = stage.renderer(FIRST_TIER);
    let scene = scene_with(&stage.file, &stage.rig, [6.0, 3.0, 2.0], 0.3, &Contents::default());
    offscreen.renderer.take_scene(&stage.gpu, &scene.header, scene.payload()).unwrap();
    let latched = latch_scene(&scene.header);
    let draw = |offscreen: &mut Offscreen, tier: usize| {
        // Twice: text follows with the next frame.
        (0..2).for_each(|_| offscreen.draw(tier, &latched));
        let mut picture = Picture::default();
        offscreen.read(tier, &mut picture).unwrap();
        picture
    };
    let corner = [0.0, 0.0, 0.4, 0.16];
    for tier in FIRST_TIER..TIERS.len() {
        offscreen.renderer.set_status("tier 6: 320*256\nframes of 23 ms");
        let shown = draw(&mut offscreen, tier);
        offscreen.renderer.set_status("");
        let gone = draw(&mut offscreen, tier);
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

#[test]
fn what_is_settled_belongs_to_the_frame_itself() {
    let Some(stage) = Stage::open() else { return };
    let mut offscreen = stage.renderer(FIRST_TIER);
    let scene = scene_with(&stage.file, &stage.rig, [6.0, 3.0, 2.0], 0.3, &Contents::default());
    offscreen.renderer.take_scene(&stage.gpu, &scene.header, scene.payload()).unwrap();
    let seen = latch_scene(&scene.header);
    let lost = Latched { tracked: [false, true], ..seen };
    let mut bottom = |latched: &Latched| {
        offscreen.renderer.settle(&stage.gpu, latched);
        offscreen.draw(FIRST_TIER, latched);
        let mut picture = Picture::default();
        offscreen.read(FIRST_TIER, &mut picture).unwrap();
        ink(&picture, 0, [0.2, 0.85, 0.8, 1.0])
    };
    let told = [&seen, &lost, &seen].map(&mut bottom);
    assert!(told[0] == told[2] && told[1] > told[0] + 120, "a lost body is told at once: {told:?}");
}
