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
use plots::{Area, COLOURS, Drawn, FONT, Figure, Format, bytes};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
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

/// Share of the meeting triangles that the image misses, a bar a resolution.
struct Bars<'a>(&'a [(usize, usize, usize)]);

impl Figure for Bars<'_> {
    fn size_px(&self) -> (u32, u32) {
        (90 + 64 * self.0.len() as u32, 520)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let mut chart = ChartBuilder::on(area)
            .caption("Meeting triangles that no pixel reports, %", (FONT, 16))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(44)
            .build_cartesian_2d((0..self.0.len().max(1) - 1).into_segmented(), 0.0..100.0)?;
        let resolution = |at: &SegmentValue<usize>| match at {
            SegmentValue::CenterOf(i) => self.0.get(*i).map_or(String::new(), |(r, ..)| r.to_string()),
            _ => String::new(),
        };
        let mut mesh = chart.configure_mesh();
        mesh.disable_x_mesh().light_line_style(WHITE).x_desc("Pixels along a side of the image, R");
        mesh.x_labels(self.0.len()).x_label_formatter(&resolution);
        mesh.y_label_formatter(&|share| format!("{share:.0}")).label_style((FONT, 14)).draw()?;
        for (i, &(_, missed, all)) in self.0.iter().enumerate() {
            let share = 100.0 * missed as f64 / all.max(1) as f64;
            let corners = [(SegmentValue::Exact(i), 0.0), (SegmentValue::Exact(i + 1), share)];
            let mut bar = Rectangle::new(corners, COLOURS[0].filled());
            bar.set_margin(0, 0, 9, 9);
            chart.draw_series([bar])?;
            let number = format!("{share:.1}");
            let style = (FONT, 14).into_text_style(area).pos(Pos::new(HPos::Center, VPos::Bottom));
            chart.draw_series([Text::new(number, (SegmentValue::CenterOf(i), share), style)])?;
        }
        Ok(())
    }
}

fn plot(misses: &[(usize, usize, usize)], path: &str) -> anyhow::Result<()> {
    Ok(std::fs::write(path, bytes(&Bars(misses), Format::Png)?)?)
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
