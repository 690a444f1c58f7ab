//! Pixels per second of the extractor on one core: `cargo bench -p fpga-model --bench scan`. Real time is 31.1 Mpx/s:
//! 3 cameras × 50 fields/s × 720 × 288.

use bytemuck::Zeroable;
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use fpga_model::scan::background::Level;
use fpga_model::scan::{Scanner, Settings};
use protocol::blobs::{BlobField, Colour};
use protocol::fields::{DARK, FieldPicture};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use surgeon::motion::MotionSource;
use virtual_rig::painter::Painter;
use virtual_rig::projection::Markers;

fn main() {
    divan::main();
}

/// What the cameras of the shipped rig see during the default scene.
fn live() -> Vec<FieldPicture> {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let mut source = MotionSource::new(&scene, &rig, None, 1);
    let (markers, painter) = (Markers::of(&rig), Painter::new(rig.cameras()[0].size_px, 1));
    let mut seen = Markers::list();
    let mut all = Vec::new();
    for number in 0..8 {
        let motion = source.at(number * 320_000_000);
        for camera in rig.cameras() {
            let mut picture = FieldPicture::new(rig.cameras()[0].size_px);
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

/// Pictures by their name, and how the extractor is set for them.
fn case(name: &str) -> (Settings, Vec<FieldPicture>) {
    let settings = Settings::default();
    match name {
        "live" => (settings, live()),
        "live, tracked background" => (Settings { level: Level::Tracked(DARK), ..settings }, live()),
        "dark" => (settings, painted(|_, _| false)),
        "all on" => (settings, painted(|_, _| true)),
        "comb" => (settings, painted(|x, y| x % 4 < 2 || y == 287)),
        "chequerboard" => (settings, painted(|x, y| (x / 2 + y) % 2 == 0)),
        other => unreachable!("no case {other}"),
    }
}

#[divan::bench(args = ["live", "live, tracked background", "dark", "all on", "comb", "chequerboard"])]
fn field(bencher: Bencher, name: &str) {
    let (settings, fields) = case(name);
    let mut scanner = Scanner::new(settings, 720, 288);
    let (mut out, mut pictures) = (BlobField::zeroed(), fields.iter().cycle());
    bencher.counter(ItemsCount::new(720usize * 288)).bench_local(|| {
        (out.count, out.blobs_left_out) = (0, 0);
        scanner.scan(black_box(pictures.next().expect("endless")), black_box(&mut out));
    });
}
