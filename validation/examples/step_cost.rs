//! Time of `World::step` over a round of the shipped script, median and p99 by phase:
//! `cargo run --release -p simcore --example step_cost [ROUNDS [SCENE]]`.

use ipc::clock::now;
use scene::{DEFAULT_SCENE, SceneFile};
use simcore::world::World;
use surgeon::rehearsal::Rehearsal;

fn main() {
    let rounds: u64 = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(3);
    let name = std::env::args().nth(2).unwrap_or_else(|| DEFAULT_SCENE.to_owned());
    let scene = SceneFile::load(&name).expect("a scene");
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).expect("a scene that fits");
    let mut rows: [(&str, Vec<u64>); 4] =
        ["whole step", "collision", "tissue", "misc"].map(|name| (name, Vec::new()));
    for field in 0..rehearsal.fields() * rounds {
        let begin = now();
        let report = world.step(&rehearsal.inputs(field).input(), &mut now);
        let all = now() - begin;
        let times = report.times;
        for (row, ns) in rows.iter_mut().zip([all, times.collision_ns, times.tissue_ns, times.misc_ns]) {
            row.1.push(ns);
        }
    }
    println!("{} steps of 20 ms, µs        p50       p99       max", rows[0].1.len());
    for (name, values) in &mut rows {
        values.sort_unstable();
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize] as f64 * 1e-3;
        println!("{name:>24} {:>9.1} {:>9.1} {:>9.1}", at(0.5), at(0.99), at(1.0));
    }
}
