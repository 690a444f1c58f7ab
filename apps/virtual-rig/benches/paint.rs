//! Share of one core that drawing the fields of the three cameras takes at 50 fields a second.
//!
//! `cargo bench -p virtual-rig --bench paint` prints one line for each case.

use protocol::fields::FieldPicture;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::hint::black_box;
use std::time::Instant;
use surgeon::motion::MotionSource;
use virtual_rig::painter::{Light, Painter, Patch};
use virtual_rig::projection::Markers;

/// Fields of each camera that are drawn for one measurement.
const FIELDS: u64 = 100;
/// Measurements; the median counts.
const ROUNDS: usize = 11;

/// Median share of a core, in percent.
fn percent(mut draw: impl FnMut(u64)) -> f64 {
    let mut times: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let begun = Instant::now();
            (0..FIELDS).for_each(&mut draw);
            begun.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[ROUNDS / 2] / FIELDS as f64 * 50.0 * 100.0
}

fn main() {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let (cameras, markers) = (rig.cameras(), Markers::of(&rig));
    let painter = Painter::new(rig.frame, 1);
    let (mut picture, mut seen) = (FieldPicture::new(rig.frame), Markers::list());
    let motion = MotionSource::new(&scene, &rig, None, 1).at(1_000_000_000);
    let empty = percent(|number| {
        for camera in &cameras {
            painter.draw(&[], camera.id, number, &mut picture);
        }
        black_box(&picture);
    });
    println!("background and noise   {empty:5.2} % of a core");
    for smear in [0.0, 0.9, 5.0] {
        let whole = percent(|number| {
            for camera in &cameras {
                markers.project(camera, &motion, &mut seen);
                let patches = seen.iter().map(|&image| {
                    let mut patch = Patch::from(image);
                    patch.smear_px.x = smear;
                    patch
                });
                painter.paint(patches, &Light::default(), camera.id, number, &mut picture);
            }
            black_box(&picture);
        });
        println!("with markers, {smear:3.1} px of movement in the exposure   {whole:5.2} % of a core");
    }
}
