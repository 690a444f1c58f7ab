//! What drawing a field of each of the three cameras costs: `cargo bench -p virtual-rig --bench paint`.
//! 20 ms would be a whole core at 50 fields a second.

use divan::{Bencher, black_box};
use protocol::fields::FieldPicture;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use surgeon::motion::MotionSource;
use virtual_rig::painter::{Light, Painter, Patch};
use virtual_rig::projection::Markers;

fn main() {
    divan::main();
}

fn shipped() -> (Rig, Painter, FieldPicture) {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let (painter, picture) =
        (Painter::new(rig.cameras()[0].size_px, 1), FieldPicture::new(rig.cameras()[0].size_px));
    (rig, painter, picture)
}

#[divan::bench]
fn background_and_noise(bencher: Bencher) {
    let (rig, painter, mut picture) = shipped();
    let (cameras, mut number) = (rig.cameras(), 0);
    bencher.bench_local(|| {
        number += 1;
        for camera in &cameras {
            painter.draw(&[], camera.id, number, black_box(&mut picture));
        }
    });
}

/// With all markers, by how far they move in the exposure, px.
#[divan::bench(args = [0.0, 0.9, 5.0])]
fn markers_smeared_px(bencher: Bencher, smear_px: f64) {
    let (rig, painter, mut picture) = shipped();
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let (cameras, markers, mut number) = (rig.cameras(), Markers::of(&rig), 0);
    let (mut seen, motion) = (Markers::list(), MotionSource::new(&scene, &rig, None, 1).at(1_000_000_000));
    bencher.bench_local(|| {
        number += 1;
        for camera in &cameras {
            markers.project(camera, &motion, &mut seen);
            let patches = seen.iter().map(|&image| {
                let mut patch = Patch::from(image);
                patch.smear_px.x = smear_px;
                patch
            });
            painter.paint(patches, &Light::default(), camera.id, number, black_box(&mut picture));
        }
    });
}
