//! Draws the shipped scene and checks what the picture shows.

use crate::stage::Stage;
use renderer::latch::{Latched, latch_scene};
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::membrane_scene;

/// The best tier that the tests draw at: small, for the software driver.
const FIRST_TIER: usize = 5;

struct Bench {
    stage: Stage,
    offscreen: Offscreen,
}

impl Bench {
    fn new() -> Option<Self> {
        let stage = Stage::open()?;
        Some(Self { offscreen: stage.renderer(FIRST_TIER), stage })
    }

    /// The picture of the forceps at `tip`, after `change` to the latched poses.
    fn draw(&mut self, tip: [f64; 3], tier: usize, change: impl Fn(&mut Latched)) -> Picture {
        let (stage, offscreen) = (&self.stage, &mut self.offscreen);
        let scene = membrane_scene(&stage.file, &stage.rig, tip, 0.3, 0.0);
        offscreen.renderer.take_scene(&stage.gpu, &scene.header, scene.payload()).unwrap();
        let mut latched = latch_scene(&scene.header);
        change(&mut latched);
        // Twice: text and order of a lost body follow with the next frame.
        (0..2).for_each(|_| offscreen.draw(tier, &latched));
        let mut picture = Picture::default();
        offscreen.read(tier, &mut picture).unwrap();
        picture
    }
}

fn brightness(picture: &Picture, x: u32, y: u32) -> u32 {
    picture.rgb(x, y).iter().map(|&c| u32::from(c)).sum()
}

/// Pixels of one channel whose brightness differs by more than the tolerance for drivers (2 of
/// 255).
fn differing(a: &Picture, b: &Picture) -> usize {
    let pairs = a.rgba.chunks(4).zip(b.rgba.chunks(4));
    pairs.filter(|(p, q)| p.iter().zip(*q).any(|(x, y)| x.abs_diff(*y) > 2)).count()
}

const AWAY: [f64; 3] = [6.0, 3.0, 2.0];
const NEAR: [f64; 3] = [0.9, 0.5, -9.5];

#[test]
fn the_field_is_round_and_the_retina_is_warm() {
    let Some(mut bench) = Bench::new() else { return };
    let picture = bench.draw(AWAY, 5, |_| {});
    let (w, h) = (picture.width_px / 2, picture.height_px);
    for channel in 0..2 {
        for (x, y) in [(0, 0), (w - 1, 0), (0, h - 1), (w - 1, h - 1)] {
            assert_eq!(brightness(&picture, channel * w + x, y), 0, "corner of channel {channel}");
        }
        let [r, g, b] = picture.rgb(channel * w + w / 2, h / 4);
        assert!(r > 100 && r > g && g > b / 2, "lit retina is red: {:?}", [r, g, b]);
    }
}

#[test]
fn channels_see_from_two_sides() {
    let Some(mut bench) = Bench::new() else { return };
    let picture = bench.draw(NEAR, 5, |_| {});
    let (w, h) = (picture.width_px / 2, picture.height_px);
    let differ = |x: u32, y: u32| brightness(&picture, x, y).abs_diff(brightness(&picture, w + x, y)) > 30;
    let count = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| differ(x, y)).count();
    assert!(count > 200, "{count} pixels differ");
}

#[test]
fn forceps_hide_the_retina_and_throw_a_shadow() {
    let Some(mut bench) = Bench::new() else { return };
    let (without, with) = (bench.draw(AWAY, 5, |_| {}), bench.draw(NEAR, 5, |_| {}));
    let (w, h) = (with.width_px / 2, with.height_px);
    let all = || (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
    let darker = all().filter(|&(x, y)| brightness(&with, x, y) + 90 < brightness(&without, x, y)).count();
    let grey = |p: [u8; 3]| p[2] > 40 && p[0].abs_diff(p[2]) < 60;
    let metal = all().filter(|&(x, y)| grey(with.rgb(x, y)) && !grey(without.rgb(x, y))).count();
    assert!(darker > 300, "{darker} pixels in the shadow");
    assert!(metal > 150, "{metal} pixels of metal");
}

#[test]
fn the_membrane_is_seen_through_and_turns_with_the_eye() {
    let Some(mut bench) = Bench::new() else { return };
    let still = bench.draw(AWAY, 5, |_| {});
    let turned = bench.draw(AWAY, 5, |l| l.world_from_eye = glam::DMat4::from_rotation_y(0.06));
    assert!(differing(&still, &turned) > 5_000, "retina and membrane turn with the latched eye");
}

#[test]
fn a_lost_instrument_fades_and_the_picture_says_so() {
    let Some(mut bench) = Bench::new() else { return };
    let tracked = bench.draw(NEAR, 5, |_| {});
    let lost = bench.draw(NEAR, 5, |l| l.tracked[0] = false);
    let (w, h) = (lost.width_px / 2, lost.height_px);
    let amber = |p: [u8; 3]| p[0] > 180 && p[1] > 110 && p[2] < 130 && p[0] > p[2] + 90;
    let count = |picture: &Picture| {
        (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| amber(picture.rgb(x, y))).count()
    };
    assert!(count(&lost) > count(&tracked) + 500, "ring and text: {} and {}", count(&lost), count(&tracked));
}

#[test]
fn every_tier_shows_the_same_scene() {
    let Some(mut bench) = Bench::new() else { return };
    let mean = |p: &Picture| {
        let sum: u64 = p.rgba.chunks(4).map(|c| u64::from(c[0])).sum();
        sum as f64 / f64::from(p.width_px * p.height_px)
    };
    let best = mean(&bench.draw(NEAR, FIRST_TIER, |_| {}));
    for tier in FIRST_TIER + 1..renderer::governor::TIERS.len() {
        let m = mean(&bench.draw(NEAR, tier, |_| {}));
        assert!((m - best).abs() < 0.08 * best, "tier {tier}: mean red {m}, {best} at the best tier");
    }
}

#[test]
fn the_same_scene_gives_the_same_picture() {
    let Some(mut bench) = Bench::new() else { return };
    let (a, b) = (bench.draw(NEAR, 5, |_| {}), bench.draw(NEAR, 5, |_| {}));
    assert_eq!(differing(&a, &b), 0);
}
