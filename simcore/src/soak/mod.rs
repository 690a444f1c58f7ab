//! Random tool programmes over random scenes: whatever the hands do, numbers stay finite, energy bounded, meshes whole and
//! accounts balanced, and the same seed gives the same states. Shared by the tests and by `make soak`.

mod draw;
mod programme;
mod scene;

pub use draw::Draw;
pub use scene::random_scene;

use crate::world::{StepInput, World, no_clock};
use programme::Programme;
use protocol::limits::FIELD_PERIOD_NS;
use protocol::message::Message;
use protocol::scene::NODE_FREE;

/// Time at the end of a programme with the instruments out of the eye, s: what was stirred comes to rest.
const QUIET_S: f64 = 1.0;
/// Mean speed of free nodes that tissue at rest must be below, mm/s.
const QUIET_MM_S: f64 = 20.0;

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
    /// Largest kinetic energy of the membrane, µN·mm.
    pub most_energy_un_mm: f64,
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

/// Runs the programme of a seed twice over `seconds` of simulated time and checks every step.
pub fn run(seed: u64, seconds: f64) -> Result<Outcome, Failure> {
    let first = run_once(seed, seconds)?;
    let again = run_once(seed, seconds)?;
    if first.hash != again.hash {
        let problem = format!("hash {:016x}, on repeat {:016x}", first.hash, again.hash);
        return Err(Failure { seed, scene: first.scene, step: first.steps, problem });
    }
    Ok(first)
}

fn run_once(seed: u64, seconds: f64) -> Result<Outcome, Failure> {
    let mut draw = Draw::new(seed);
    let scene = random_scene(&mut draw);
    let fail = |step: u64, problem: String| Failure { seed, scene: scene.title.clone(), step, problem };
    let mut world = World::new(&scene).map_err(|e| fail(0, e.to_string()))?;
    let steps = ((seconds + QUIET_S) * 1e9) as u64 / FIELD_PERIOD_NS;
    let busy = (seconds * 1e9) as u64 / FIELD_PERIOD_NS;
    let mut programme = Programme::new(&scene, draw);
    let mut outcome =
        Outcome { scene: scene.title.clone(), steps, events: 0, hash: 0, most_energy_un_mm: 0.0 };
    for step in 0..steps {
        let input = if step < busy { programme.next() } else { programme.leave() };
        let input = StepInput { frame: &input.frame, handles: &input.handles, pedals: &input.pedals };
        let report = world.step(&input, &mut no_clock);
        outcome.hash = (outcome.hash.rotate_left(5) ^ report.state_hash).wrapping_mul(0x0000_0100_0000_01b3);
        outcome.events += world.events().len() as u64;
        world.audit().map_err(|problem| fail(step, problem))?;
        let energy = kinetic_energy_un_mm(&world).map_err(|problem| fail(step, problem))?;
        outcome.most_energy_un_mm = outcome.most_energy_un_mm.max(energy);
        if let Some(bad) = world.events().iter().find_map(|e| e.validate().err()) {
            return Err(fail(step, bad.to_string()));
        }
    }
    let speed = mean_speed_mm_s(&world);
    if speed > QUIET_MM_S {
        let problem = format!("the tissue does not come to rest: {speed:.1} mm/s on average");
        return Err(fail(steps, problem));
    }
    Ok(outcome)
}

/// Kinetic energy of the membrane, µN·mm; an error where it passes what the limit of speed allows.
fn kinetic_energy_un_mm(world: &World) -> Result<f64, String> {
    let (Some(scene), m) = (&world.scene().membrane, &world.state().membrane) else { return Ok(0.0) };
    let free = (0..m.nodes()).filter(|&n| m.flag[n] == NODE_FREE);
    let (mut energy, mut nodes) = (0.0, 0.0);
    for n in free {
        energy += 0.5 * scene.node_mass_g * m.velocity(n).map(f64::from).norm_squared();
        nodes += 1.0;
    }
    // Tools push nodes to their own speed, which may be above the tissue's limit.
    let limit = scene.v_max_mm_s.max(crate::constants::MAX_TIP_SPEED_MM_S) * 1.001;
    let most = 0.5 * scene.node_mass_g * limit * limit * nodes;
    if energy <= most {
        Ok(energy)
    } else {
        Err(format!("kinetic energy {energy:.0} µN·mm, at most {most:.0}"))
    }
}

fn mean_speed_mm_s(world: &World) -> f64 {
    let m = &world.state().membrane;
    let free: Vec<f64> =
        (0..m.nodes()).filter(|&n| m.flag[n] == NODE_FREE).map(|n| f64::from(m.velocity(n).norm())).collect();
    if free.is_empty() { 0.0 } else { free.iter().sum::<f64>() / free.len() as f64 }
}
