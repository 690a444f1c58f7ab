//! A whole `World::step` of 20 substeps in the shipped scene, with one and with two instruments
//! that press on the membrane.

use ipc::clock::now;
use protocol::limits::INSTRUMENTS;
use scene::{SceneFile, ScriptKey};
use simcore::world::World;
use surgeon::rehearsal::Rehearsal;

/// Steps measured of each.
const STEPS: usize = 350;
/// From this step on they press.
const FIRST: u64 = 330;
/// What is asked for, µs.
const ASKED_US: [f64; 2] = [250.0, 450.0];

fn key(at_s: f64, instrument: u32, tip_in_eye_mm: [f64; 3]) -> ScriptKey {
    ScriptKey { at_s, instrument, tip_in_eye_mm, roll_rad: 0.0, jaw_rad: 0.5, tool: None }
}

/// Where the two tips press, eye frame, mm: over the membrane, which bulges to 11.11 mm from the
/// centre there.
const PLACES_MM: [[f64; 2]; INSTRUMENTS] = [[1.2, 0.4], [-1.2, -0.4]];
/// From above the membrane to close above the retina. A tip that stands still is touched now and
/// then only, because the membrane swings before it.
const WAY_MM: [f64; 2] = [-10.9, -11.4];
/// Out of reach of the membrane, mm.
const AWAY_MM: [f64; 3] = [-3.0, 0.5, -3.5];

/// The shipped scene with open jaws that press on slowly, 50 µm/s at most; an instrument that does
/// not press is away.
fn scene(instruments: usize) -> SceneFile {
    let mut scene = SceneFile::load("peel").expect("the shipped scene");
    scene.script.as_mut().unwrap().keys.clear();
    for (i, [x, y]) in PLACES_MM.into_iter().enumerate() {
        let at = |z| if i < instruments { [x, y, z] } else { AWAY_MM };
        let [from, to] = WAY_MM.map(at);
        scene.script.as_mut().unwrap().keys.extend([key(0.0, i as u32, from), key(15.0, i as u32, to)]);
    }
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
    let mut touching = [0; INSTRUMENTS];
    for field in 0..FIRST + STEPS as u64 {
        let t = world.step(&rehearsal.inputs(field).input(), &mut now).profile;
        if field < FIRST {
            continue;
        }
        for (count, contact) in touching.iter_mut().zip(&world.state().membrane.contact) {
            *count += usize::from(contact.in_contact && !contact.under);
        }
        let us = |ns: u64| ns as f64 * 1e-3;
        let [collision_ns, tissue_ns, misc_ns] = t.paper_phases_ns();
        times.whole.push(us(t.step_ns()));
        times.tissue.push(us(tissue_ns));
        times.collision.push(us(collision_ns));
        times.misc.push(us(misc_ns));
    }
    assert!(
        touching[..instruments].iter().all(|&t| t >= STEPS * 19 / 20),
        "{touching:?} of {STEPS} steps pressed"
    );
    assert!(touching[instruments..].iter().all(|&t| t == 0), "who is away does not press: {touching:?}");
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
