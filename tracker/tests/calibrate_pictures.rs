//! Real pictures of a chessboard, and real dots before three cameras, against what others made of them.

use std::path::{Path, PathBuf};
use tracker::calibrate::board::{Board, Pattern};
use tracker::calibrate::grey::Grey;
use tracker::calibrate::lens::LENS;
use tracker::calibrate::many::{Before, cameras_of_views, common_dots, held_out};
use tracker::calibrate::points;
use tracker::calibrate::targets::{Free, Robustness, Sheet, lens_of_views, rms};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/chessboards")
}

/// The pictures of one side, in order.
fn sheets(side: &str, camera: usize) -> Vec<Sheet> {
    let board = Board { pattern: Pattern::Chessboard, columns: 9, rows: 6, pitch_mm: 1.0 };
    let numbers = (1..=14).filter(|n| *n != 10);
    let sheets = numbers.enumerate().map(|(view, n)| {
        let name = format!("{side}{n:02}.jpg");
        let picture = Grey::load(&folder().join(&name)).unwrap();
        let samples = board.find(&picture).unwrap_or_else(|e| panic!("{name}: {e}"));
        Sheet { name, camera, view, samples }
    });
    sheets.collect()
}

#[test]
fn lenses_agree() {
    let [left, right] = [sheets("left", 0), sheets("right", 1)];
    for s in [&left, &right] {
        for r in [Robustness::Square, Robustness::Huber, Robustness::Cauchy] {
            let c = lens_of_views(0, [640, 480], s, Free::LENS, r, &mut |_, _| {}).unwrap();
            println!("{r:?} rms {:.4} sigma {:.4} {:?}", c.rms_px, c.sigma_px, c.scene.cameras[0]);
        }
    }
    let both = [left, right].concat();
    for keep in [true, false] {
        let c =
            cameras_of_views(&[[640, 480]; 2], &both, [true; LENS], keep, Robustness::Square, &mut |_, _| {})
                .unwrap();
        println!(
            "stereo {:.4} {:?} {:?}",
            c.rms_px,
            c.scene.cameras[1].translation_mm.norm(),
            c.scene.cameras
        );
        for k in 0..2 {
            println!("  {}", rms(c.residuals.iter().copied().filter(|r| r.camera == k)));
        }
    }
}

#[test]
fn dots() {
    let data = Path::new("/work/shared/data/cameras/myptv/Calibration");
    let mut all = Vec::new();
    for c in 0..3 {
        let v = points::load(&data.join(format!("cam{}_cal_points", c + 1))).unwrap();
        all.push(Sheet { name: format!("{c}"), camera: c, view: 0, samples: v[0].samples.clone() });
    }
    let before = vec![Before::Size([1280, 1024]); 3];
    println!("{}", common_dots(&all, 3).len());
    for (name, free) in [
        ("all", [true; LENS]),
        ("k1 p", [true, true, true, true, true, false, true, true, false]),
        ("k1k2p", [true, true, true, true, true, true, true, true, false]),
    ] {
        for r in [Robustness::Square, Robustness::Huber] {
            let mut e: Vec<[f64; 3]> = Vec::new();
            for seed in 0..20u64 {
                let chosen = |i: usize| {
                    let mut z = (i as u64 + 1)
                        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
                        .wrapping_add(seed.wrapping_mul(0xD1B5_4A32_D192_ED03));
                    z = (z ^ (z >> 30)).wrapping_mul(0xBF58476D1CE4E5B9);
                    z = (z ^ (z >> 27)).wrapping_mul(0x94D049BB133111EB);
                    (z ^ (z >> 31)) & 1 == 0
                };
                e.push(held_out(&before, &all, free, r, &chosen).unwrap());
            }
            let med = |k: usize| {
                let mut v: Vec<f64> = e.iter().map(|e| e[k] * 1e3).collect();
                v.sort_by(f64::total_cmp);
                (v[9] + v[10]) / 2.0
            };
            println!("{name} {r:?}: {:.2} {:.2} {:.2}", med(0), med(1), med(2));
        }
    }
}
