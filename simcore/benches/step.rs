//! Cost of a step of each shipped scene by cameras of 50 and of 200 Hz: `cargo bench -p simcore --bench step`.
//! Both rates play the same seconds in turns, and each field's least time of three rounds counts.

use ipc::clock::now;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;

/// What is played of a script, s.
const SECONDS: u64 = 12;
const ROUNDS: usize = 3;
const PERIODS_NS: [u64; 2] = [20_000_000, 5_000_000];

/// Times of all steps of a round, ns, each the least so far. Gives the hash of the state at its end.
fn round(scene: &SceneFile, period_ns: u64, least: &mut Vec<u64>) -> u64 {
    let rehearsal = Rehearsal::shipped(scene).with_period(period_ns);
    let mut world = World::new(scene).expect("the shipped scenes are tested");
    let fields = SECONDS * 1_000_000_000 / period_ns;
    least.resize(fields as usize, u64::MAX);
    for field in 0..fields {
        let inputs = rehearsal.inputs(field);
        let begin = now();
        world.step(&inputs.input(), &mut no_clock);
        let took = now() - begin;
        let kept = &mut least[field as usize];
        *kept = took.min(*kept);
    }
    world.state_hash()
}

fn main() {
    let titles = ["Hz", "p50, µs", "p99, µs", "max, µs", "ms a s", "state at the end"];
    println!("{:<14}{}", "scene", titles.map(|title| format!("{title:>18}")).concat());
    for name in ["peel", "erm", "vitrectomy", "trim", "lift", "relocation", "translocation", "bodies"] {
        let scene = SceneFile::load(name).expect("shipped");
        let mut least = PERIODS_NS.map(|_| (Vec::new(), 0));
        for _ in 0..ROUNDS {
            PERIODS_NS
                .iter()
                .zip(&mut least)
                .for_each(|(&ns, (least, hash))| *hash = round(&scene, ns, least));
        }
        for (period_ns, (mut times, hash)) in PERIODS_NS.into_iter().zip(least) {
            let second_ms = times.iter().sum::<u64>() as f64 * 1e-6 / SECONDS as f64;
            times.sort_unstable();
            let at = |share: f64| times[(share * (times.len() - 1) as f64) as usize] as f64 * 1e-3;
            let (hz, [p50, p99, most]) = (1_000_000_000 / period_ns, [0.5, 0.99, 1.0].map(at));
            println!("{name:<14}{hz:>18}{p50:>18.0}{p99:>18.0}{most:>18.0}{second_ms:>18.1}  {hash:016x}");
        }
    }
}
