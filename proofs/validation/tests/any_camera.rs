//! Cameras of every kind that a rig file can say, through pixels or straight into blobs, extraction and tracking: the
//! tip is where the surgeon has it.

use protocol::fields::PixelFormat;
use protocol::geometry::Validity;
use rig::Rig;
use rig::sensor::{Scan, Shutter};
use scene::{DEFAULT_SCENE, SceneFile};
use std::path::Path as File;
use surgeon::motion::MotionSource;
use tracker::assembler::FrameAssembler;
use tracker::tracker::{Tracker, close};
use validation::camera_twin::CameraTwin;
use virtual_rig::cameras::Path;

/// Exposure of the first field, ns.
const FIRST_NS: u64 = 1_000_000_000;
/// What is found before this time is of a filter that has just begun, s.
const SETTLED_S: f64 = 0.4;

/// What was tracked of the instruments.
#[derive(Debug, Clone, Copy)]
struct Tracked {
    /// Root mean square of the tips' errors, µm.
    rms_um: f64,
    /// Share of bodies that were measured.
    measured: f64,
}

/// Tracks the default scene on a rig.
fn track(rig: &Rig, path: Path, seconds: f64) -> Tracked {
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let (mut surgeon, mut truth) =
        (MotionSource::new(&scene, rig, None, 3), MotionSource::new(&scene, rig, None, 3));
    let mut cameras = CameraTwin::new(rig, path, 3, FIRST_NS);
    let (mut assembler, mut tracker) = (FrameAssembler::new(rig), Tracker::new(rig));
    let (mut squares, mut tips, mut measured, mut all) = (0.0, 0.0, 0.0, 0.0);
    let fields = (seconds * rig.field_hz) as u64;
    for number in 0..fields {
        for i in 0..cameras.count() {
            let field = cameras.blobs(i, &mut surgeon, number);
            let now = field.blobs_out_ns.max(field.exposed_ns);
            assembler.add(&field, now, |used, closed| {
                let mut frame = tracker.track(used, &closed.reference);
                close(&mut frame, closed.closed_by);
                let since_ns = frame.instants.exposed - FIRST_NS;
                if (since_ns as f64) < SETTLED_S * 1e9 {
                    return;
                }
                let motion = truth.at(since_ns);
                for (body, pose) in frame.bodies.iter().zip(&motion.world_from_instrument) {
                    all += 1.0;
                    if body.validity() != Validity::Measured {
                        continue;
                    }
                    let found = nalgebra::Vector3::from(body.world_from_body.position_mm);
                    let off = (found - pose.translation.vector).norm_squared();
                    (measured, squares, tips) = (measured + 1.0, squares + off, tips + 1.0);
                }
            });
        }
    }
    assert!(all > 50.0, "{all} bodies in {fields} fields");
    Tracked { rms_um: 1e3 * f64::sqrt(squares / f64::max(tips, 1.0)), measured: measured / all }
}

fn fast() -> Rig {
    let file = File::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/rig-200hz.json");
    Rig::load(&file).expect("the shipped rig of 200 Hz")
}

fn checked(change: impl FnOnce(&mut Rig)) -> Rig {
    let mut rig = fast();
    change(&mut rig);
    Rig::parse(&rig.to_json(), "changed").expect("a rig that can be")
}

#[test]
fn whole_frames_of_200_hz_are_tracked_from_blobs_and_from_pixels() {
    let rig = fast();
    assert!(rig.sensors().iter().all(|s| (s.scan, s.shutter) == (Scan::Progressive, Shutter::Global)));
    let [direct, drawn] = [(Path::Direct, 3.0), (Path::Pixels, 1.0)].map(|(path, s)| track(&rig, path, s));
    println!("direct {direct:?}, drawn {drawn:?}");
    for found in [direct, drawn] {
        assert!(found.rms_um < 15.0 && found.measured > 0.9, "{found:?}");
    }
}

#[test]
fn every_format_with_colours_is_tracked() {
    for format in PixelFormat::ALL.into_iter().filter(|f| f.has_colour()) {
        let rig = checked(|rig| rig.pixel_format = format);
        let found = track(&rig, Path::Pixels, 0.7);
        println!("{}: {found:?}", format.name());
        assert!(found.rms_um < 20.0 && found.measured > 0.85, "{format:?}: {found:?}");
    }
}

#[test]
fn cameras_of_one_rig_may_differ() {
    let rig = checked(|rig| {
        (rig.field_rule, rig.frame) = (None, None);
        let camera = &mut rig.cameras[1];
        (camera.scan, camera.line_ns) = (Some(Scan::Interlaced), Some(12_500));
        (rig.cameras[2].pixel_format, rig.cameras[2].exposure_ns) = (Some(PixelFormat::Rgb8), Some(500_000));
    });
    for (path, seconds) in [(Path::Direct, 2.0), (Path::Pixels, 0.7)] {
        let found = track(&rig, path, seconds);
        println!("{path:?}: {found:?}");
        assert!(found.rms_um < 20.0 && found.measured > 0.85, "{found:?}");
    }
}

/// A rolling shutter of 14 ms from the first line to the last: each blob counts at the instant of its line, and tips are
/// nearly as good as with a global one.
#[test]
fn a_rolling_shutter_costs_next_to_nothing() {
    let with = |shutter| checked(|rig| (rig.shutter, rig.line_ns, rig.field_hz) = (shutter, 30_000, 60.0));
    let [rolling, global] =
        [Shutter::Rolling, Shutter::Global].map(with).map(|rig| track(&rig, Path::Direct, 6.0));
    println!("rolling {rolling:?}, global {global:?}");
    assert!(rolling.rms_um < 1.15 * global.rms_um && rolling.measured > 0.9, "{rolling:?}, {global:?}");
}
