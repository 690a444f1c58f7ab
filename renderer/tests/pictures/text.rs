//! Text over pictures as they are written into files: at its places, the same in both channels, at
//! every tier.

use crate::stage::Stage;
use protocol::scene_text::{Place, Row, push_line};
use renderer::compose::output_px;
use renderer::governor::TIERS;
use renderer::latch::{Latched, latch_scene};
use renderer::offscreen::Offscreen;
use renderer::present::blit::{Blit, Shown};
use renderer::readback::{Picture, ReadBack};
use renderer::reference_scene::{Contents, scene_with};
use renderer::stereo::{Arrangement, arrange};
use renderer::target::Target;

const FIRST_TIER: usize = 5;

/// A renderer of these tiers with a scene, and its poses.
fn opened(stage: &Stage, first_tier: usize) -> (Offscreen, Latched) {
    let mut offscreen = stage.renderer(first_tier);
    let scene = scene_with(&stage.file, &stage.rig, [6.0, 3.0, 2.0], 0.3, &Contents::default());
    offscreen.renderer.take_scene(&stage.gpu, &scene.header, scene.payload()).unwrap();
    (offscreen, latch_scene(&scene.header))
}

/// The picture of a tier for a file.
fn composed(offscreen: &mut Offscreen, tier: usize, latched: &Latched, how: Arrangement) -> Picture {
    offscreen.draw(tier, latched);
    let mut picture = Picture::default();
    offscreen.compose(tier, how, &mut picture).unwrap();
    picture
}

/// Pixels that differ from `other` by more than a driver's rounding, of channel `channel`, from its
/// upper left.
fn changed(picture: &Picture, other: &Picture, channel: u32) -> Vec<[u32; 2]> {
    assert_eq!((picture.width_px, picture.height_px), (other.width_px, other.height_px));
    let (w, h) = (picture.width_px / 2, picture.height_px);
    let differs = |x: u32, y: u32| {
        let (a, b) = (picture.rgb(channel * w + x, y), other.rgb(channel * w + x, y));
        a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > 3)
    };
    (0..h).flat_map(|y| (0..w).map(move |x| [x, y])).filter(|&[x, y]| differs(x, y)).collect()
}

/// How many of them lie in a box of shares of the channel.
fn inside(places: &[[u32; 2]], size: [u32; 2], [left, top, right, bottom]: [f64; 4]) -> usize {
    let share = |p: &[u32; 2]| [0, 1].map(|i| (f64::from(p[i]) + 0.5) / f64::from(size[i]));
    let holds = |[u, v]: [f64; 2]| (left..right).contains(&u) && (top..bottom).contains(&v);
    places.iter().filter(|p| holds(share(p))).count()
}

#[test]
fn the_status_stands_in_the_corner_of_every_tier_and_goes_again() {
    let Some(stage) = Stage::open() else { return };
    let (mut offscreen, latched) = opened(&stage, FIRST_TIER);
    for (tier, t) in TIERS.iter().enumerate().skip(FIRST_TIER) {
        let without = composed(&mut offscreen, tier, &latched, Arrangement::SideBySide);
        offscreen.renderer.set_status("tier 6: 320×256\nframes of 23 ms");
        let with = composed(&mut offscreen, tier, &latched, Arrangement::SideBySide);
        offscreen.renderer.set_status("");
        let gone = composed(&mut offscreen, tier, &latched, Arrangement::SideBySide);
        let size = [without.width_px / 2, without.height_px];
        assert_eq!(size, output_px(t), "tier {tier}");
        for channel in 0..2 {
            let text = changed(&with, &without, channel);
            let corner = inside(&text, size, [0.0, 0.0, 0.3, 0.16]);
            assert!(text.len() > 300 && corner == text.len(), "tier {tier}: {corner} of {}", text.len());
            assert!(changed(&gone, &without, channel).is_empty(), "tier {tier}");
        }
    }
}

#[test]
fn both_channels_have_the_same_text_to_the_pixel() {
    let Some(stage) = Stage::open() else { return };
    let mut text = String::new();
    push_line(&mut text, Place::Top, "Tracking lost: instrument 1");
    push_line(&mut text, Place::TopLeft, "Level 2");
    push_line(&mut text, Place::Bottom, "Πιάσε το άκρο · Возьмите край · 抓住 边缘");
    Row::Title("Peeling").push(&mut text);
    Row::Bar { name: "Tissue", share: 0.3, value: "6 of 20" }.push(&mut text);
    // Over black, so that only text is there.
    let target = Target::new(&stage.gpu.device, &TIERS[8]);
    let read_back = ReadBack::new(&stage.gpu, 0);
    let mut blit = Blit::new(&stage.gpu.device, target.texture.format());
    for tier in [&TIERS[3], &TIERS[5], &TIERS[8]] {
        let surface = Target::new(&stage.gpu.device, tier);
        for odd in [0, 1] {
            let size_px = [2 * tier.width_px - odd, tier.height_px];
            let shown =
                Shown { arrangement: Arrangement::SideBySide, channel: 0, text: &text, text_scale: 1 };
            blit.draw(&stage.gpu, &target, &surface.colour, size_px, shown);
            let mut picture = Picture::default();
            read_back.read(&stage.gpu, &surface.texture, &mut picture).unwrap();
            let w = size_px[0] / 2;
            let mut inked = 0;
            for (x, y) in (0..picture.height_px).flat_map(|y| (0..w).map(move |x| (x, y))) {
                let (left, right) = (picture.rgb(x, y), picture.rgb(w + x, y));
                assert_eq!(left, right, "{size_px:?}, pixel {x}, {y}");
                inked += usize::from(left != [0; 3]);
            }
            assert!(inked > 400, "{size_px:?}: {inked}");
        }
    }
}

#[test]
fn each_eye_of_interleaved_lines_sees_all_of_the_text() {
    let Some(stage) = Stage::open() else { return };
    let target = Target::new(&stage.gpu.device, &TIERS[8]);
    let surface = Target::new(&stage.gpu.device, &TIERS[5]);
    let mut blit = Blit::new(&stage.gpu.device, target.texture.format());
    let how = Arrangement::Interleaved;
    let shown =
        Shown { arrangement: how, channel: 0, text: "_Grasp the edge\n", text_scale: how.text_scale() };
    blit.draw(&stage.gpu, &target, &surface.colour, [TIERS[5].width_px, TIERS[5].height_px], shown);
    let mut picture = Picture::default();
    ReadBack::new(&stage.gpu, 5).read(&stage.gpu, &surface.texture, &mut picture).unwrap();
    let row = |y: u32| (0..TIERS[5].width_px).map(|x| picture.rgb(x, y)).collect::<Vec<_>>();
    let lines: Vec<_> = (0..TIERS[5].height_px).map(row).collect();
    assert!(lines.chunks(2).all(|eyes| eyes[0] == eyes[1]), "both eyes see the same lines");
    assert!(lines.concat().iter().filter(|p| **p != [0; 3]).count() > 400);
    // In files too: the arrangement is made of two channels.
    let (mut offscreen, latched) = opened(&stage, FIRST_TIER);
    offscreen.renderer.set_status("tier");
    let mut with = composed(&mut offscreen, FIRST_TIER, &latched, how);
    offscreen.renderer.set_status("");
    let mut without = composed(&mut offscreen, FIRST_TIER, &latched, how);
    arrange(&mut with, how);
    arrange(&mut without, how);
    let of_line = |y: u32| (0..60).filter(|&x| with.rgb(x, y) != without.rgb(x, y)).collect::<Vec<u32>>();
    let pairs: Vec<_> = (0..40).step_by(2).map(|y| [of_line(y), of_line(y + 1)]).collect();
    assert!(pairs.iter().all(|[even, odd]| even == odd), "{pairs:?}");
    assert!(pairs.iter().any(|[even, _]| even.len() > 10));
}

#[test]
fn a_lost_body_is_told_with_the_frame_itself() {
    let Some(stage) = Stage::open() else { return };
    let (mut offscreen, seen) = opened(&stage, FIRST_TIER);
    let lost = Latched { tracked: [false, true], ..seen };
    let mut told = |latched: &Latched| {
        let picture = composed(&mut offscreen, FIRST_TIER, latched, Arrangement::SideBySide);
        let amber = |p: [u8; 3]| p[0] > 170 && p[1] > 130 && p[2] < 130;
        let rows = 0..picture.height_px / 8;
        let middle = picture.width_px / 8..picture.width_px * 3 / 8;
        rows.flat_map(|y| middle.clone().map(move |x| (x, y)))
            .filter(|&(x, y)| amber(picture.rgb(x, y)))
            .count()
    };
    let [before, lost, after] = [&seen, &lost, &seen].map(&mut told);
    assert!(lost > before + 60, "{before}, then {lost}");
    // The fading and the ring of a frame ago may still be there.
    assert!(after < lost, "{after}");
}
