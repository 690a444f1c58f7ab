//! Pixels per second of the extractor on one core, against real time: 3 cameras × 50 fields/s × 720
//! × 288.
//!
//! `cargo bench -p fpga-model --bench scan` prints a table, with `-- --json` one object a line.

use bytemuck::Zeroable;
use protocol::fields::DARK;

use fpga_model::scan::background::Level;
use fpga_model::scan::{Scanner, Settings};
use protocol::blobs::{BlobField, Colour};
use protocol::fields::FieldPicture;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::hint::black_box;
use std::time::Instant;
use surgeon::motion::MotionSource;
use virtual_rig::painter::Painter;
use virtual_rig::projection::Markers;

/// Pixels a second of the three cameras.
const REAL_TIME: f64 = 3.0 * 50.0 * 720.0 * 288.0;
/// Measurements of a case; the median counts.
const ROUNDS: usize = 41;

/// What the cameras of the shipped rig see during the default scene.
fn live() -> Vec<FieldPicture> {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let mut source = MotionSource::new(&scene, &rig, None, 1);
    let (markers, painter) = (Markers::of(&rig), Painter::new(rig.frame, 1));
    let mut seen = Markers::list();
    let mut all = Vec::new();
    for number in 0..8 {
        let motion = source.at(number * 320_000_000);
        for camera in rig.cameras() {
            let mut picture = FieldPicture::new(rig.frame);
            markers.project(&camera, &motion, &mut seen);
            painter.draw(&seen, camera.id, number, &mut picture);
            all.push(picture);
        }
    }
    all
}

/// A field of which the pixels for which `inside` holds are red.
fn painted(inside: impl Fn(usize, usize) -> bool) -> Vec<FieldPicture> {
    let mut picture = FieldPicture::new([720, 576]);
    let [light, blue, red] = Colour::Red.reference();
    picture.blue.fill(blue);
    picture.red.fill(red);
    for (i, pixel) in picture.luma.iter_mut().enumerate() {
        *pixel = if inside(i % 720, i / 720) { light } else { DARK };
    }
    vec![picture]
}

/// Median seconds for one field.
fn seconds(settings: Settings, fields: &[FieldPicture]) -> f64 {
    let mut scanner = Scanner::new(settings, 720, 288);
    let mut out = BlobField::zeroed();
    let mut times: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let begun = Instant::now();
            for field in fields {
                (out.count, out.blobs_left_out) = (0, 0);
                scanner.scan(black_box(field), black_box(&mut out));
            }
            begun.elapsed().as_secs_f64() / fields.len() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[ROUNDS / 2]
}

fn main() {
    let json = std::env::args().any(|arg| arg == "--json");
    let tracked = Settings { level: Level::Tracked(DARK), ..Settings::default() };
    let cases = [
        ("live", Settings::default(), live()),
        ("live-tracked-background", tracked, live()),
        ("dark", Settings::default(), painted(|_, _| false)),
        ("all-on", Settings::default(), painted(|_, _| true)),
        ("comb", Settings::default(), painted(|x, y| x % 4 < 2 || y == 287)),
        ("chequerboard", Settings::default(), painted(|x, y| (x / 2 + y) % 2 == 0)),
    ];
    if !json {
        println!("{:<26} {:>10} {:>12} {:>14}", "field", "us", "Mpx/s", "× real time");
    }
    for (name, settings, fields) in cases {
        let seconds = seconds(settings, &fields);
        let rate = 720.0 * 288.0 / seconds;
        let (us, ratio) = (seconds * 1e6, rate / REAL_TIME);
        if json {
            println!(
                r#"{{"method":"{name}","median_us":{us:.2},"pixels_per_s":{rate:.0},"real_time":{ratio:.2}}}"#
            );
        } else {
            println!("{name:<26} {us:>10.1} {:>12.0} {ratio:>14.1}", rate / 1e6);
        }
    }
}
