//! Random tool programmes over random scenes: whatever the hands do, numbers stay finite, energy bounded, meshes whole and
//! accounts balanced, and the same seed gives the same states. Shared by the tests and by `make soak`.

mod draw;
mod programme;
mod scene;

pub use draw::Draw;
pub use scene::random_scene;

use crate::state::MembraneState;
use crate::world::{StepInput, World};
use programme::Programme;
use protocol::handles::Tool;
use protocol::limits::FIELD_PERIOD_NS;
use protocol::message::Message;
use protocol::scene::NODE_FREE;

/// Time at the end of a programme with the instruments out of the eye, s: what was stirred comes to rest.
const QUIET_S: f64 = 1.0;
/// Mean speed of free nodes that tissue at rest must be below, mm/s.
const QUIET_MM_S: f64 = 20.0;
/// Room for the number of every tool; 0 is none.
pub const TOOLS: usize = 16;

const _: () = assert!((Tool::Needle as usize) < TOOLS);

/// A programme that went well.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Title of the scene it began from.
    pub scene: String,
    /// Steps done.
    pub steps: u64,
    /// Events raised.
    pub events: u64,
    /// Hash over the state hashes of all steps.
    pub hash: u64,
    /// Largest kinetic energy of membrane and retina as a share of what their limits of speed allow; never above 1.
    pub most_energy: f64,
    /// Steps of each tool ([`Tool`] as a number), both hands added up.
    pub tool_steps: [u64; TOOLS],
    /// Longest step by the clock that was lent, ns, and which it was.
    pub slowest: (u64, u64),
}

/// A programme that did not.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("seed {seed} ({scene}), step {step}: {problem}")]
pub struct Failure {
    /// Seed that gives it again.
    pub seed: u64,
    /// Title of the scene it began from.
    pub scene: String,
    /// Step.
    pub step: u64,
    /// What was wrong.
    pub problem: String,
}

/// Runs the programme of a seed twice over `seconds` of simulated time and checks every step. `clock` gives nanoseconds
/// for [`Outcome::slowest`] and nothing else; [`crate::world::no_clock`] will do.
pub fn run(seed: u64, seconds: f64, clock: &mut dyn FnMut() -> u64) -> Result<Outcome, Failure> {
    let first = run_once(seed, seconds, clock)?;
    let again = run_once(seed, seconds, clock)?;
    if first.hash != again.hash {
        let problem = format!("hash {:016x}, on repeat {:016x}", first.hash, again.hash);
        return Err(Failure { seed, scene: first.scene, step: first.steps, problem });
    }
    // Of two times the shorter one is the step's, the longer one the machine's.
    let slowest = if again.slowest.0 < first.slowest.0 { again.slowest } else { first.slowest };
    Ok(Outcome { slowest, ..first })
}

fn run_once(seed: u64, seconds: f64, clock: &mut dyn FnMut() -> u64) -> Result<Outcome, Failure> {
    let mut draw = Draw::new(seed);
    let scene = random_scene(&mut draw);
    let fail = |step: u64, problem: String| Failure { seed, scene: scene.title.clone(), step, problem };
    let mut world = World::new(&scene).map_err(|e| fail(0, e.to_string()))?;
    let steps = ((seconds + QUIET_S) * 1e9) as u64 / FIELD_PERIOD_NS;
    let busy = (seconds * 1e9) as u64 / FIELD_PERIOD_NS;
    let mut programme = Programme::new(&scene, draw);
    let mut outcome = Outcome {
        scene: scene.title.clone(),
        steps,
        events: 0,
        hash: 0,
        most_energy: 0.0,
        tool_steps: [0; TOOLS],
        slowest: (0, 0),
    };
    for step in 0..steps {
        let input = if step < busy { programme.next() } else { programme.leave() };
        let input = StepInput { frame: &input.frame, handles: &input.handles, pedals: &input.pedals };
        let report = world.step(&input, clock);
        let times = report.times;
        outcome.slowest = outcome.slowest.max((times.collision_ns + times.tissue_ns + times.misc_ns, step));
        outcome.hash = (outcome.hash.rotate_left(5) ^ report.state_hash).wrapping_mul(0x0000_0100_0000_01b3);
        outcome.events += world.events().len() as u64;
        for instrument in &world.state().instruments {
            outcome.tool_steps[(instrument.tool as usize).min(TOOLS - 1)] += 1;
        }
        world.audit().map_err(|problem| fail(step, problem))?;
        let energy = most_energy(&world).map_err(|problem| fail(step, problem))?;
        outcome.most_energy = outcome.most_energy.max(energy);
        if let Some(bad) = world.events().iter().find_map(|e| e.validate().err()) {
            return Err(fail(step, bad.to_string()));
        }
    }
    let retina = world.state().retina.as_ref().map(|r| &r.tissue);
    for tissue in [Some(&world.state().membrane), retina].into_iter().flatten() {
        let speed = mean_speed_mm_s(tissue);
        if speed > QUIET_MM_S {
            let problem = format!("the tissue does not come to rest: {speed:.1} mm/s on average");
            return Err(fail(steps, problem));
        }
    }
    Ok(outcome)
}

/// Kinetic energy of membrane and retina, the larger share of what their limits of speed allow; an error above 1.
fn most_energy(world: &World) -> Result<f64, String> {
    let (scene, state) = (world.scene(), world.state());
    let membrane = scene.membrane.as_ref().map(|s| (&state.membrane, s.node_mass_g, s.v_max_mm_s));
    let retina = scene.retina.as_ref().zip(state.retina.as_ref());
    let retina = retina.map(|(s, r)| (&r.tissue, s.node_mass_g, s.v_max_mm_s));
    let mut most = 0.0;
    for (tissue, mass_g, v_max_mm_s) in [membrane, retina].into_iter().flatten() {
        // Tools push nodes to their own speed, which may be above the tissue's limit.
        let limit = v_max_mm_s.max(crate::constants::MAX_TIP_SPEED_MM_S) * 1.001;
        let (energy, bound) = kinetic_energy_un_mm(tissue, mass_g, limit);
        if energy > bound {
            return Err(format!("kinetic energy {energy:.0} µN·mm, at most {bound:.0}"));
        }
        let share = if bound > 0.0 { energy / bound } else { 0.0 };
        most = if share > most { share } else { most };
    }
    Ok(most)
}

/// Kinetic energy of the free nodes, and what they would have at the speed `limit_mm_s`, µN·mm.
fn kinetic_energy_un_mm(tissue: &MembraneState, mass_g: f64, limit_mm_s: f64) -> (f64, f64) {
    let (mut energy, mut bound) = (0.0, 0.0);
    for n in free(tissue) {
        energy += 0.5 * mass_g * tissue.velocity(n).map(f64::from).norm_squared();
        bound += 0.5 * mass_g * limit_mm_s * limit_mm_s;
    }
    (energy, bound)
}

fn free(tissue: &MembraneState) -> impl Iterator<Item = usize> + '_ {
    (0..tissue.nodes()).filter(|&n| tissue.flag[n] == NODE_FREE)
}

fn mean_speed_mm_s(tissue: &MembraneState) -> f64 {
    let count = free(tissue).count();
    let sum: f64 = free(tissue).map(|n| f64::from(tissue.velocity(n).norm())).sum();
    if count == 0 { 0.0 } else { sum / count as f64 }
}
