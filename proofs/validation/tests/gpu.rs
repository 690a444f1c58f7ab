//! ZCOLL on an adapter against ZCOLL on the processor: the same bits. Runs on any adapter, the
//! software one too; where there is none it says so and proves nothing.
#![cfg(feature = "gpu")]

use collision::gpu::{GpuDevice, GpuZcoll};
use collision::instrument_image::InstrumentImage;
use collision::surface::Surface;
use collision::zcoll::{Contacts, PixelContact, Zcoll};
use nalgebra::Isometry3;
use protocol::handles::Tool;
use protocol::random::Random;
use validation::rays::{Collisions, RADIUS_MM, Scene, collisions, collisions_back, truth};

/// Scenes that are compared here; the example `collision_agreement` compares 10,000.
const SCENES: usize = 200;

/// The answer of a query, sorted.
type Answer = (Contacts, Vec<PixelContact>, Vec<(usize, i32)>, Vec<(usize, i32)>, Vec<(u32, i32)>);

/// Answers of queries from the tip and from the handle, and whether there is a collision at all.
fn answers(zcoll: &mut Zcoll, image: &InstrumentImage, scene: &Scene) -> ([Answer; 2], bool) {
    let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
    let surface = Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive };
    let touches = zcoll.touches(image, &scene.instrument_from_eye, &surface);
    type Look = fn(&mut Zcoll, &InstrumentImage, &Isometry3<f64>, &Surface) -> Contacts;
    let ends: [Look; 2] = [Zcoll::query, Zcoll::query_reversed];
    let looks = ends.map(|look| {
        let found = look(zcoll, image, &scene.instrument_from_eye, &surface);
        let (mut triangles, mut nodes): (Vec<_>, Vec<_>) =
            (zcoll.triangles().collect(), zcoll.displaced().collect());
        triangles.sort_unstable();
        nodes.sort_unstable();
        let hits = zcoll.hits().to_vec();
        (found, hits, triangles, nodes, zcoll.vertices(image, &surface).to_vec())
    });
    (looks, touches)
}

fn device() -> Option<GpuDevice> {
    GpuDevice::open().map_err(|e| eprintln!("adapter and processor not compared: {e}")).ok()
}

fn both(device: &GpuDevice, scene: &Scene) -> [([Answer; 2], bool); 2] {
    let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
    image.prepare(scene.jaw_rad, &scene.volume);
    let nodes = scene.position_mm[0].len();
    let mut zcoll = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap();
    let cpu = answers(&mut zcoll, &image, scene);
    zcoll.set_gpu(Some(GpuZcoll::new(device.clone(), scene.volume, &scene.triangles, nodes).unwrap()));
    let gpu = answers(&mut zcoll, &image, scene);
    assert!(zcoll.is_on_gpu(), "the adapter must not have failed");
    [cpu, gpu]
}

#[test]
fn a_timed_query_gives_the_same_bits_and_the_times_of_its_parts() {
    let Some(device) = device() else { return };
    // The first scene with many collisions.
    let mut random = Random::from_seed(12);
    let scene = std::iter::repeat_with(|| Scene::random(&mut random, &[32]))
        .take(SCENES)
        .find(|scene| collisions(scene).len() > 20)
        .expect("a scene with contact");
    let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
    image.prepare(scene.jaw_rad, &scene.volume);
    let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
    let surface = Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive };
    let mut gpu = GpuZcoll::new(device, scene.volume, &scene.triangles, scene.position_mm[0].len()).unwrap();
    assert_eq!(gpu.part_times().unwrap(), None, "nothing is timed unless asked for");
    let look = |gpu: &mut GpuZcoll| {
        let found = gpu.query(&image.ahead(), &scene.instrument_from_eye, &surface).unwrap();
        (found, gpu.triangles().to_vec(), gpu.displaced().to_vec(), gpu.hits().to_vec())
    };
    let plain = look(&mut gpu);
    assert!(plain.0.pixels > 0, "a scene without contact compares nothing");
    if !gpu.time_parts() {
        eprintln!("times of parts not checked: {} has no timestamps", gpu.gpu().name());
        return;
    }
    assert_eq!(look(&mut gpu), plain);
    let times = gpu.part_times().unwrap().expect("times");
    for (part, ns) in [("draw", times.draw), ("analyse", times.analyse), ("read-back", times.read_back)] {
        assert!((0.0..5e9).contains(&ns), "{part}: {ns} ns");
    }
    assert!(times.draw > 0.0, "{times:?}");
}

#[test]
fn an_adapter_gives_the_same_bits() {
    let Some(device) = device() else { return };
    let mut random = Random::from_seed(11);
    let mut pixels = [0; 2];
    for number in 0..SCENES {
        let mut scene = Scene::random(&mut random, &[8, 32, 32, 64, 256]);
        if number % 2 == 0 {
            scene.tool = Tool::Pick;
        }
        let [cpu, gpu] = both(&device, &scene);
        assert_eq!(cpu, gpu, "scene {number}");
        // Not only with each other: with exact rays, from both ends.
        let rays = [collisions(&scene), collisions_back(&scene)];
        for ((seen, rays), pixels) in gpu.0.iter().zip(rays).zip(&mut pixels) {
            let hits = seen.1.iter().map(|h| (h.pixel, (h.triangle, h.depth)));
            assert!(hits.eq(rays), "scene {number}");
            *pixels += seen.1.len();
        }
    }
    assert!(pixels[0] > 20 * SCENES && pixels[1] > 5 * SCENES, "{pixels:?}");
}

/// Corners that are no numbers or infinite, vertices on top of each other, triangles far too large,
/// flags that change between looks: the counters and everything else stay the same.
#[test]
fn bad_input_is_counted_alike() {
    let Some(device) = device() else { return };
    let mut random = Random::from_seed(12);
    let mut counted = [0; 3];
    for number in 0..40 {
        let mut scene = Scene::random(&mut random, &[32, 64]);
        scene.spoil(&mut random);
        if number % 8 == 0 {
            // A pose that is none.
            scene.instrument_from_eye.translation.vector.x = random.one_of(&[f64::NAN, 1e300, 1e9]);
        }
        let [cpu, gpu] = both(&device, &scene);
        assert_eq!(cpu, gpu, "scene {number}");
        let (found, expected) = (cpu.0[0].0, truth(&scene));
        let counts = [found.refused, found.flat, found.folded];
        assert_eq!(counts, [expected.refused, expected.flat, expected.folded], "scene {number}");
        for (sum, count) in counted.iter_mut().zip([found.refused, found.flat, found.folded]) {
            *sum += count;
        }
    }
    assert!(counted.iter().all(|&c| c > 0), "refused, flat, folded: {counted:?}");
}

/// Triangles from one limit of the number format to the other: the 64 bits made of two words do not
/// overflow either.
#[test]
fn extremes_of_the_format_are_exact_on_an_adapter() {
    let Some(device) = device() else { return };
    let mut random = Random::from_seed(14);
    let mut pixels = 0;
    for number in 0..60 {
        let scene = Scene::extreme(&mut random, [8, 32, 256][number % 3]);
        let [cpu, gpu] = both(&device, &scene);
        assert_eq!(cpu, gpu, "scene {number}");
        let hits: Collisions = gpu.0[0].1.iter().map(|h| (h.pixel, (h.triangle, h.depth))).collect();
        assert_eq!(hits, collisions(&scene), "scene {number}");
        pixels += hits.len();
    }
    assert!(pixels > 1000, "{pixels}");
}

/// Looks that follow each other on one adapter forget each other, and more results than come at
/// once all come.
#[test]
fn a_second_look_knows_nothing_of_the_first() {
    let Some(device) = device() else { return };
    let mut random = Random::from_seed(13);
    let mut scene = Scene::random(&mut random, &[256]);
    let nodes = scene.position_mm[0].len();
    let mut zcoll = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap();
    let mut plain = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap();
    zcoll.set_gpu(Some(GpuZcoll::new(device, scene.volume, &scene.triangles, nodes).unwrap()));
    let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
    let mut most = 0;
    for turn in 0..12 {
        image.prepare(0.05 * f64::from(turn), &scene.volume);
        scene.instrument_from_eye.translation.vector.z += 0.05;
        let dead = random.between(0.0, scene.triangles.len() as f64) as usize;
        scene.alive[dead] = 0;
        let [gpu, cpu] = [&mut zcoll, &mut plain].map(|z| answers(z, &image, &scene));
        assert_eq!(gpu, cpu, "look {turn}");
        most = most.max(cpu.0[0].1.len());
    }
    assert!(most > 1024, "more than one transfer must be seen: {most}");
}
