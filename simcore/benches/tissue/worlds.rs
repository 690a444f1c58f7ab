//! A whole `World::step` of 20 substeps in the shipped scene, with one and with two instruments that press on the membrane.

use protocol::scene_file::{SceneFile, ScriptKey};
use protocol::time::now;
use simcore::rehearsal::Rehearsal;
use simcore::world::World;

/// Steps measured of each.
const STEPS: usize = 400;
/// What is asked for, µs.
const ASKED_US: [f64; 2] = [250.0, 450.0];

fn key(at_s: f64, instrument: u32, tip_in_eye_mm: [f64; 3]) -> ScriptKey {
    ScriptKey { at_s, instrument, tip_in_eye_mm, roll_rad: 0.0, jaw_rad: 0.5, tool: None }
}

/// The shipped scene with open jaws that press on the membrane for most of the round, and the other instrument beside it or far away.
fn scene(instruments: usize) -> SceneFile {
    let mut scene = SceneFile::load("peel").expect("the shipped scene");
    let second = if instruments == 2 { [-1.2, -0.4, -11.08] } else { [-3.0, 0.5, -3.5] };
    scene.script.keys = vec![
        key(0.0, 0, [1.2, 0.4, -10.4]),
        key(2.0, 0, [1.2, 0.4, -11.08]),
        key(14.0, 0, [1.3, 0.5, -11.05]),
        key(0.0, 1, [-3.0, 0.5, -3.5]),
        key(2.0, 1, second),
        key(14.0, 1, second),
    ];
    scene
}

struct Times {
    whole: Vec<f64>,
    tissue: Vec<f64>,
    collision: Vec<f64>,
    misc: Vec<f64>,
}

fn measure(instruments: usize) -> Times {
    let scene = scene(instruments);
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).expect("it is tested");
    let mut times = Times { whole: Vec::new(), tissue: Vec::new(), collision: Vec::new(), misc: Vec::new() };
    let mut touching = 0;
    // From 3 s on both instruments are where they press.
    for field in 0..150 + STEPS as u64 {
        let t = rehearsal.play(&mut world, field, &mut now).times;
        if field < 150 {
            continue;
        }
        touching += world.state().instruments.iter().filter(|i| i.in_contact).count();
        let us = |ns: u64| ns as f64 * 1e-3;
        times.whole.push(us(t.tissue_ns + t.collision_ns + t.misc_ns));
        times.tissue.push(us(t.tissue_ns));
        times.collision.push(us(t.collision_ns));
        times.misc.push(us(t.misc_ns));
    }
    assert!(touching >= STEPS * instruments / 2, "they press: {touching} of {}", STEPS * instruments);
    times
}

/// Prints both rows.
pub fn report(json: bool) {
    if !json {
        println!(
            "World::step, 20 substeps, 1,000 triangles     median µs   best µs  tissue  collision  rest   asked for"
        );
    }
    for instruments in 1..=2 {
        let mut times = measure(instruments);
        let median = |list: &mut Vec<f64>| {
            list.sort_by(f64::total_cmp);
            (list[list.len() / 2], list[0])
        };
        let ((whole, best), (tissue, _)) = (median(&mut times.whole), median(&mut times.tissue));
        let ((collision, _), (misc, _)) = (median(&mut times.collision), median(&mut times.misc));
        let method = format!("world-{instruments}");
        if json {
            let object = serde_json::json!({
                "method": method, "springs": 1545, "step_us": whole, "best_us": best,
                "tissue_us": tissue, "collision_us": collision, "rest_us": misc,
            });
            println!("{object}");
        } else {
            let asked = ASKED_US[instruments - 1];
            println!(
                "{method:44} {whole:>10.1} {best:>9.1} {tissue:>7.1} {collision:>10.1} {misc:>5.1}   ≤ {asked:.0}"
            );
        }
    }
}
