//! Counts where ZCOLL and the truth agree, and what the image misses at a resolution.
//!
//! `cargo run --release -p validation --example collision_agreement [-- SCENES [PICTURE.png]]`
//! compares SCENES (10,000) random π-convex scenes with exact rays through the pixel centres, to
//! the bit, and the processor with a graphics adapter where there is one; then as many with the
//! reversed camera, from the handle of a pick or a forceps. Then it draws the same 400 scenes at 8
//! to 256 pixels and counts which triangles that meet the instrument (exact pairs) no pixel
//! reports. Exit code 5 on a difference.

use collision::instrument_image::InstrumentImage;
use collision::surface::Surface;
use collision::zcoll::{Contacts, Zcoll};
use font::{Face, line_px};
use image::{Rgb, RgbImage};
use protocol::handles::Tool;
use protocol::random::Random;
use std::collections::BTreeSet;
use std::process::ExitCode;
use validation::exact::{PairQuery, StaticMesh};
use validation::rays::{Collisions, RADIUS_MM, Scene, collisions, collisions_back};

/// Scenes whose misses are counted.
const MISS_SCENES: usize = 400;
/// Resolutions of the count.
const RESOLUTIONS: [usize; 11] = [8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256];

/// Which end of the instrument the camera is at.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    Tip,
    Handle,
}

impl End {
    /// A look from this end.
    fn look(self, zcoll: &mut Zcoll, image: &InstrumentImage, scene: &Scene) -> Contacts {
        let (pose, surface) = (&scene.instrument_from_eye, surface(scene));
        match self {
            End::Tip => zcoll.query(image, pose, &surface),
            End::Handle => zcoll.query_reversed(image, pose, &surface),
        }
    }

    /// What exact rays find.
    fn rays(self, scene: &Scene) -> Collisions {
        match self {
            End::Tip => collisions(scene),
            End::Handle => collisions_back(scene),
        }
    }
}

/// What ZCOLL reports on a scene: pixels with triangle and way.
fn look(scene: &Scene, end: End) -> Vec<(u32, (u32, i32))> {
    let (mut zcoll, image) = instruments(scene);
    end.look(&mut zcoll, &image, scene);
    zcoll.hits().iter().map(|h| (h.pixel, (h.triangle, h.depth))).collect()
}

fn instruments(scene: &Scene) -> (Zcoll, InstrumentImage) {
    let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
    image.prepare(scene.jaw_rad, &scene.volume);
    let nodes = scene.position_mm[0].len();
    (Zcoll::new(scene.volume, &scene.triangles, nodes).expect("a scene is usable"), image)
}

#[cfg(feature = "gpu")]
mod adapter {
    use super::{End, Scene, instruments, surface};
    use collision::gpu::{GpuDevice, GpuZcoll};
    use collision::zcoll::Zcoll;

    /// The adapter, if this machine has one.
    pub fn open() -> Option<GpuDevice> {
        let opened = GpuDevice::open().map_err(|e| eprintln!("processor and adapter not compared: {e}"));
        opened.inspect(|device| eprintln!("comparing with {}", device.name())).ok()
    }

    /// True if the adapter's answer about a scene differs from the processor's: counters, pixels,
    /// triangles, nodes, vertices, or whether there is any collision.
    pub fn differs(device: &GpuDevice, scene: &Scene, end: End) -> bool {
        let (mut zcoll, image) = instruments(scene);
        let (pose, surface) = (&scene.instrument_from_eye, surface(scene));
        let answer = |zcoll: &mut Zcoll| {
            let (touches, found) = (zcoll.touches(&image, pose, &surface), end.look(zcoll, &image, scene));
            let (mut triangles, mut nodes): (Vec<_>, Vec<_>) =
                (zcoll.triangles().collect(), zcoll.displaced().collect());
            triangles.sort_unstable();
            nodes.sort_unstable();
            let hits = zcoll.hits().to_vec();
            (touches, found, hits, triangles, nodes, zcoll.vertices(&image, &surface).to_vec())
        };
        let cpu = answer(&mut zcoll);
        let gpu = GpuZcoll::new(device.clone(), scene.volume, &scene.triangles, surface.position_mm[0].len());
        zcoll.set_gpu(Some(gpu.expect("a scene fits")));
        let gpu = answer(&mut zcoll);
        cpu != gpu || !zcoll.is_on_gpu()
    }
}

#[cfg(not(feature = "gpu"))]
mod adapter {
    /// This program was built without adapters.
    pub fn open() -> Option<()> {
        None
    }

    /// Nothing to compare with.
    pub fn differs(_: &(), _: &super::Scene, _: super::End) -> bool {
        false
    }
}

fn surface(scene: &Scene) -> Surface<'_> {
    let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
    Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive }
}

/// Compares scenes as seen from an end; how many differ.
fn compare(scenes: usize, end: End) -> usize {
    let mut random = Random::from_seed(20_021_109);
    let (mut differ, mut colliding, mut pixels) = (0, 0, 0);
    let device = adapter::open();
    for number in 0..scenes {
        // One in fifty is large, because the rays take their time.
        let sizes: &[usize] = if number % 50 == 0 { &[128, 256] } else { &[8, 16, 32, 32, 64] };
        let mut scene = Scene::random(&mut random, sizes);
        if end == End::Handle {
            // Only these lift.
            scene.tool = if number % 3 == 0 { Tool::Forceps } else { Tool::Pick };
        }
        let expected: Vec<_> = end.rays(&scene).into_iter().collect();
        if look(&scene, end) != expected {
            differ += 1;
            eprintln!("scene {number} differs from exact rays");
        }
        if device.as_ref().is_some_and(|device| adapter::differs(device, &scene, end)) {
            differ += 1;
            eprintln!("scene {number} differs between processor and adapter");
        }
        colliding += usize::from(!expected.is_empty());
        pixels += expected.len();
    }
    let compared = if device.is_some() { "exact rays and the adapter" } else { "exact rays" };
    println!(
        "{scenes} scenes from the {}, {colliding} with a collision, {pixels} colliding pixels: {differ} differ from {compared}",
        if end == End::Tip { "tip" } else { "handle" }
    );
    differ
}

/// Triangles of the scene that meet the instrument inside the volume, exactly. `None` if the
/// membrane meets it outside as well, where the image does not look.
fn exact_triangles(scene: &Scene) -> BTreeSet<u32> {
    let v = &scene.volume;
    let within = |p: &[f64; 3]| {
        p[0].abs() < v.half_mm && p[1].abs() < v.half_mm && p[2] > v.near_mm && p[2] < v.near_mm + v.depth_mm
    };
    let mesh = StaticMesh::new(&scene.facets()).expect("an instrument is a mesh");
    let mut exact = PairQuery::new(&scene.triangles, scene.position_mm[0].len()).expect("a scene is usable");
    exact.query(&mesh, &scene.instrument_from_eye, &surface(scene));
    let inside = |t: &u32| {
        scene.triangles[*t as usize].iter().all(|&n| {
            let p = scene.position_mm.each_ref().map(|a| f64::from(a[n as usize]));
            within(&(scene.instrument_from_eye * nalgebra::Point3::from(p)).coords.into())
        })
    };
    exact.pairs().iter().map(|p| p.membrane).filter(inside).collect()
}

/// Share of the exactly meeting triangles that no pixel reports, by resolution.
fn misses() -> Vec<(usize, usize, usize)> {
    let mut counts = vec![(0, 0); RESOLUTIONS.len()];
    let mut random = Random::from_seed(7);
    for _ in 0..MISS_SCENES {
        let mut scene = Scene::random(&mut random, &[32]);
        let exact = exact_triangles(&scene);
        for (count, resolution) in counts.iter_mut().zip(RESOLUTIONS) {
            scene.volume.resolution = resolution;
            let reported: BTreeSet<u32> = look(&scene, End::Tip).into_iter().map(|(_, (t, _))| t).collect();
            count.0 += exact.difference(&reported).count();
            count.1 += exact.len();
        }
    }
    RESOLUTIONS.iter().zip(counts).map(|(r, (missed, all))| (*r, missed, all)).collect()
}

/// Size of letters, px.
const LETTER: f32 = 14.0;

/// Writes into a picture, centred on a column.
fn write(picture: &mut RgbImage, face: &mut Face, text: &str, middle: u32, top: u32) {
    let (left, width) = (middle as f32 - 0.5 * face.width_px(text, LETTER), picture.width());
    face.write(picture, width, [left.max(0.0), top as f32], text, LETTER, [40; 3]);
}

/// Bars of the missed share over the resolution, a line every tenth.
fn plot(misses: &[(usize, usize, usize)], path: &str) -> image::ImageResult<()> {
    let (bar, gap, height) = (44u32, 20u32, 400u32);
    let (left, top) = (68u32, 56u32);
    let width = left + gap + misses.len() as u32 * (bar + gap);
    let (mut face, line) = (Face::new(), line_px(LETTER) as u32);
    let mut picture = RgbImage::from_pixel(width, top + height + 68, Rgb([255; 3]));
    for tenth in 0..=10 {
        let y = top + height * tenth / 10;
        let grey = if tenth == 10 { 40 } else { 215 };
        (left..width).for_each(|x| picture.put_pixel(x, y, Rgb([grey; 3])));
        write(&mut picture, &mut face, &format!("{} %", 100 - 10 * tenth), left / 2, y - line / 2);
    }
    for (i, &(resolution, missed, all)) in misses.iter().enumerate() {
        let from = left + gap + i as u32 * (bar + gap);
        let share = missed as f64 / all.max(1) as f64;
        let above = top + height - (f64::from(height) * share).round() as u32;
        for (x, y) in (from..from + bar).flat_map(|x| (above..top + height).map(move |y| (x, y))) {
            picture.put_pixel(x, y, Rgb([40, 90, 160]));
        }
        let middle = from + bar / 2;
        write(&mut picture, &mut face, &format!("{:.1}", 100.0 * share), middle, above - line - 2);
        write(&mut picture, &mut face, &resolution.to_string(), middle, top + height + 10);
    }
    write(&mut picture, &mut face, "Meeting triangles that no pixel reports, %", width / 2, 4);
    write(&mut picture, &mut face, "Pixels along a side of the image, R", width / 2, top + height + 40);
    picture.save(path)
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let scenes = match arguments.next().map(|a| a.parse()) {
        None => 10_000,
        Some(Ok(scenes)) => scenes,
        Some(Err(_)) => {
            eprintln!("usage: collision_agreement [SCENES [PICTURE.png]]; SCENES is a whole number");
            return ExitCode::from(2);
        }
    };
    let differ = compare(scenes, End::Tip) + compare(scenes, End::Handle);
    println!(
        "\nresolution  missed  meeting  share   ({MISS_SCENES} scenes, triangles of 0.04 to 0.25 mm, volume 1.5 mm wide)"
    );
    let misses = misses();
    for &(resolution, missed, all) in &misses {
        println!(
            "{resolution:>10}  {missed:>6}  {all:>7}  {:>5.1} %",
            100.0 * missed as f64 / all.max(1) as f64
        );
    }
    if let Some(path) = arguments.next() {
        if let Err(error) = plot(&misses, &path) {
            eprintln!("{path}: {error}");
            return ExitCode::FAILURE;
        }
        eprintln!("wrote {path}: share of meeting triangles that the image misses, one bar a resolution");
    }
    if differ > 0 { ExitCode::from(5) } else { ExitCode::SUCCESS }
}
