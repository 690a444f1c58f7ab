//! A moment of every shipped scene and training module, in both shadings, against pictures kept in
//! `tests/data/pictures/scenes`. `make pictures` renews them; say in the commit why.
//!
//! The pictures were made by Mesa's llvmpipe 22.3.6 (LLVM 15), where another run differs by
//! nothing. Other adapters rasterise edges differently. Tissue that moves a little otherwise stays
//! within these bounds; a tool or a tear in another place does not.

use protocol::scene::SceneBody;
use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::similarity::{colour_difference, reference_sized, reference_tier, similarity};
use validation::moments::{MOMENTS, Moment, REFERENCE_MAP_PX, ScenePlayer};
use vitreo_tests::repository;

/// Least similarity where the adapter is the one that made the pictures, and elsewhere.
const SIMILAR: [f64; 2] = [0.985, 0.95];
/// Largest mean difference of colour, of 255, in the same order.
const COLOUR: [f64; 2] = [1.5, 4.0];

fn reference(name: &str) -> Picture {
    let path = repository().join("tests/data/pictures/scenes").join(name);
    let image = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgba8();
    Picture { width_px: image.width(), height_px: image.height(), rgba: image.into_raw() }
}

fn looks_as_it_did(gpu: &Gpu, moment: &Moment) {
    let name = moment.file();
    let mut player = moment.begin();
    let block = player.play_to(moment.at_s);
    let other = usize::from(!gpu.name.starts_with("llvmpipe"));
    for shading in Shading::ALL {
        let (tier, shading) = (reference_tier(shading), shading.name());
        let picture = reference_sized(&player.draw(gpu, &block, tier, REFERENCE_MAP_PX));
        let known = reference(&format!("{name}-{shading}.png"));
        let (similar, colour) = (similarity(&picture, &known), colour_difference(&picture, &known));
        assert!(
            similar >= SIMILAR[other] && colour <= COLOUR[other],
            "{name}, {shading}: similarity {similar:.4}, colour {colour:.2} on {}",
            gpu.name
        );
    }
}

#[test]
fn every_moment_looks_as_it_did() {
    let Ok(gpu) = Gpu::headless().map_err(|e| skips::skip(&e)) else { return };
    // Each is played on a thread of its own.
    std::thread::scope(|threads| {
        let gpu = &gpu;
        let played = MOMENTS.map(|moment| threads.spawn(move || looks_as_it_did(gpu, &moment)));
        let failed = played.map(|thread| thread.join().is_err());
        assert!(!failed.contains(&true), "a scene looks different");
    });
}

#[test]
fn every_shipped_scene_and_module_has_its_moment() {
    let shipped = std::fs::read_dir(repository().join("assets/scenes")).unwrap().flatten();
    let scenes = shipped.map(|f| f.path()).filter(|p| p.extension().is_some_and(|e| e == "toml"));
    let scenes = scenes.map(|p| p.file_stem().unwrap().to_string_lossy().into_owned());
    let named: Vec<_> =
        scenes.map(|n| (n, false)).chain(scene::module::names().map(|n| (n.into(), true))).collect();
    assert!(named.len() > 12, "{named:?}");
    for (name, is_module) in named {
        let found = MOMENTS.iter().any(|m| m.name == name && m.is_module == is_module);
        assert!(found, "{name} (a module: {is_module}) has no reference picture");
    }
}

/// CIE L*a*b* of an sRGB colour (of 255), for daylight D65.
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let linear = rgb.map(|c| {
        let c = c / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    let row = |r: [f64; 3]| r[0] * linear[0] + r[1] * linear[1] + r[2] * linear[2];
    let xyz = [
        row([0.4124, 0.3576, 0.1805]) / 0.9505,
        row([0.2126, 0.7152, 0.0722]),
        row([0.0193, 0.1192, 0.9505]) / 1.089,
    ];
    let [x, y, z] = xyz.map(|t| if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// CIE76 colour difference; 2.3 is just noticeable.
fn delta_e(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// The scene's bodies, to change.
fn bodies_mut(block: &mut SceneBlock) -> &mut [SceneBody] {
    let at = block.header.bodies;
    let (start, bytes) = (at.offset as usize, at.count as usize * size_of::<SceneBody>());
    bytemuck::cast_slice_mut(&mut block.payload_mut()[start..start + bytes])
}

/// Mean colour, L*a*b*, of what a body covers in `picture`: those pixels that change where it becomes
/// black; and how many they are.
fn covered(picture: &Picture, blackened: &Picture) -> ([f64; 3], usize) {
    let places = (0..picture.height_px).flat_map(|y| (0..picture.width_px).map(move |x| (x, y)));
    let differs = |(x, y): &(u32, u32)| {
        let pairs = picture.rgb(*x, *y).into_iter().zip(blackened.rgb(*x, *y));
        pairs.map(|(a, b)| u32::from(a.abs_diff(b))).sum::<u32>() > 30
    };
    let colours: Vec<[u8; 3]> = places.filter(differs).map(|(x, y)| picture.rgb(x, y)).collect();
    let mean = |c: usize| colours.iter().map(|p| f64::from(p[c])).sum::<f64>() / colours.len().max(1) as f64;
    (lab([0, 1, 2].map(mean)), colours.len())
}

/// "Place it on the mark of its colour": in the picture the three marks differ clearly from each other
/// (seventeen just noticeable differences), and each is nearest to its own body.
#[test]
fn marks_are_told_apart_and_belong_to_their_bodies_by_colour() {
    let Ok(gpu) = Gpu::headless().map_err(|e| skips::skip(&e)) else { return };
    let module = surgeon::load("forceps").expect("module");
    let scene = surgeon::compose(&module, 3, &surgeon::skill::EXPERT, 1).expect("scene");
    let bodies = scene.bodies.as_ref().expect("bodies").body.clone();
    let mut player = ScenePlayer::begin(scene);
    let mut block = player.play_to(0.5);
    let shown = bodies_mut(&mut block).to_vec();
    let of_colour = |rgba: [f32; 4]| (bodies.len()..shown.len()).find(|&i| shown[i].rgba[..3] == rgba[..3]);
    let marks: Vec<usize> = bodies.iter().map(|b| of_colour(b.rgba).expect("a mark of its colour")).collect();
    for shading in Shading::ALL {
        let tier = reference_tier(shading);
        let picture = player.draw(&gpu, &block, tier, REFERENCE_MAP_PX);
        let mut seen = |index: usize| {
            let own = std::mem::replace(&mut bodies_mut(&mut block)[index].rgba, [0.0, 0.0, 0.0, 1.0]);
            let blackened = player.draw(&gpu, &block, tier, REFERENCE_MAP_PX);
            bodies_mut(&mut block)[index].rgba = own;
            let (colour, pixels) = covered(&picture, &blackened);
            assert!(pixels >= 12, "{}: body {index} covers {pixels} pixels", shading.name());
            colour
        };
        let of_bodies: Vec<_> = (0..bodies.len()).map(&mut seen).collect();
        let of_marks: Vec<_> = marks.iter().map(|&i| seen(i)).collect();
        for (i, mark) in of_marks.iter().enumerate() {
            for j in (0..bodies.len()).filter(|&j| j != i) {
                let apart = delta_e(*mark, of_marks[j]);
                println!("{}: marks {i} and {j} differ by {apart:.0}", shading.name());
                assert!(apart >= 40.0, "{}: marks {i} and {j}: {apart:.1}", shading.name());
                let (own, other) = (delta_e(*mark, of_bodies[i]), delta_e(*mark, of_bodies[j]));
                assert!(own < other, "{}: mark {i} is like body {j}: {own:.1}, {other:.1}", shading.name());
            }
        }
    }
}
