//! Random tool programmes over random scenes: whatever the hands do, numbers stay finite, energy
//! bounded, meshes whole and accounts balanced, and the same seed gives the same states. Shared by
//! the tests and by `make soak`.

mod programme;
mod rest_check;
mod scene;

use protocol::random::Random;
pub use scene::random_scene;

use programme::Programme;
use protocol::handles::Tool;
use protocol::limits::FIELD_PERIOD_NS;
use protocol::message::Message;
use protocol::scene::NODE_FREE;
use protocol::steps::StepInput;
use rest_check::RestCheck;
use simcore::world::{StepReport, World};
use tissue::sheet::state::SheetState;

/// Time at the end of a programme with the instruments out of the eye, s: what was stirred comes to
/// rest.
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
    /// Largest lasting kinetic energy of tissue at rest, as a share of what its
    /// limits of speed allow.
    pub lasting_energy: f64,
    /// Steps in which no tool handled tissue and its rest was checked.
    pub quiet_steps: u64,
    /// Steps of each tool ([`Tool`] as a number), both hands added up.
    pub tool_steps: [u64; TOOLS],
    /// Longest step by the clock that was lent, ns, and which it was.
    pub slowest: (u64, u64),
}

/// A programme that did not.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("seed {seed} ({scene}), step {step}: {problem}")]
pub struct Failure {
    /// Seed that gives it repeat.
    pub seed: u64,
    /// Title of the scene it began from.
    pub scene: String,
    /// Step.
    pub step: u64,
    /// What was wrong.
    pub problem: String,
}

/// Runs the programme of a seed twice over `seconds` of simulated time and checks every step.
/// `clock` gives nanoseconds for [`Outcome::slowest`] and nothing else;
/// [`simcore::world::no_clock`] will do.
///
/// # Errors
/// With the seed, the step and the first check that failed.
pub fn run(seed: u64, seconds: f64, clock: &mut dyn FnMut() -> u64) -> Result<Outcome, Failure> {
    let first = run_once(seed, seconds, clock)?;
    let repeat = run_once(seed, seconds, clock)?;
    if first.hash != repeat.hash {
        let problem = format!("hash {:016x}, on repeat {:016x}", first.hash, repeat.hash);
        return Err(Failure { seed, scene: first.scene, step: first.steps, problem });
    }
    // Of two times the shorter one is the step's, the longer one the machine's.
    let slowest = if repeat.slowest.0 < first.slowest.0 { repeat.slowest } else { first.slowest };
    Ok(Outcome { slowest, ..first })
}

fn run_once(seed: u64, seconds: f64, clock: &mut dyn FnMut() -> u64) -> Result<Outcome, Failure> {
    let mut draw = Random::from_seed(seed);
    let scene = random_scene(&mut draw);
    let fail = |problem: String| Failure { seed, scene: scene.title.clone(), step: 0, problem };
    let mut world = World::new(&scene).map_err(|e| fail(e.to_string()))?;
    play(&mut world, Programme::new(&scene, draw), seconds, clock)
        .map_err(|(step, problem)| Failure { step, ..fail(problem) })
}

/// Plays a programme in a world and checks every step; on failure the step and the problem.
fn play(
    world: &mut World,
    mut programme: Programme,
    seconds: f64,
    clock: &mut dyn FnMut() -> u64,
) -> Result<Outcome, (u64, String)> {
    let steps = ((seconds + QUIET_S) * 1e9) as u64 / FIELD_PERIOD_NS;
    let busy = (seconds * 1e9) as u64 / FIELD_PERIOD_NS;
    let mut rest = RestCheck::default();
    let mut outcome = Outcome {
        scene: world.scene().title.clone(),
        steps,
        events: 0,
        hash: 0,
        lasting_energy: 0.0,
        quiet_steps: 0,
        tool_steps: [0; TOOLS],
        slowest: (0, 0),
    };
    for step in 0..steps {
        let input = if step < busy { programme.next() } else { programme.leave() };
        let input = StepInput { frame: &input.frame, handles: &input.handles, pedals: &input.pedals };
        let report = world.step(&input, clock);
        outcome.add(world, &report, step);
        check(world, &mut rest, report.advanced_ns as f64 * 1e-9).map_err(|problem| (step, problem))?;
    }
    (outcome.lasting_energy, outcome.quiet_steps) = (rest.lasting, rest.checked_steps);
    check_rest(world).map_err(|problem| (steps, problem))?;
    Ok(outcome)
}

/// What must hold after a step that advanced by `advanced_s`.
fn check(world: &World, rest: &mut RestCheck, advanced_s: f64) -> Result<(), String> {
    world.audit()?;
    rest.check(world, advanced_s)?;
    match world.events().iter().find_map(|e| e.validate().err()) {
        Some(bad) => Err(bad.to_string()),
        None => Ok(()),
    }
}

/// What must hold when the instruments have been out of the eye for [`QUIET_S`].
fn check_rest(world: &World) -> Result<(), String> {
    let retina = world.state().retina.as_ref().map(|r| &r.sheet);
    for tissue in [Some(&world.state().membrane), retina].into_iter().flatten() {
        let speed = mean_speed_mm_s(tissue);
        if speed > QUIET_MM_S {
            return Err(format!("the tissue does not come to rest: {speed:.1} mm/s on average"));
        }
    }
    Ok(())
}

impl Outcome {
    fn add(&mut self, world: &World, report: &StepReport, step: u64) {
        self.slowest = self.slowest.max((report.profile.step_ns(), step));
        self.hash = (self.hash.rotate_left(5) ^ report.state_hash).wrapping_mul(0x0000_0100_0000_01b3);
        self.events += world.events().len() as u64;
        for instrument in &world.state().instruments {
            self.tool_steps[(instrument.tool as usize).min(TOOLS - 1)] += 1;
        }
    }
}

fn free(tissue: &SheetState) -> impl Iterator<Item = usize> + '_ {
    (0..tissue.nodes()).filter(|&n| tissue.flag[n] == NODE_FREE)
}

fn mean_speed_mm_s(tissue: &SheetState) -> f64 {
    let count = free(tissue).count();
    let sum: f64 = free(tissue).map(|n| f64::from(tissue.velocity(n).norm())).sum();
    if count == 0 { 0.0 } else { sum / count as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simcore::world::no_clock;
    use tissue::sheet::material::Material;

    /// Two seconds of a programme on the shipped membrane, which is too strong to tear, with
    /// figures that no scene can ask for.
    fn spoiled(v_max_mm_s: f64, spoil: impl FnOnce(&mut Material)) -> Result<Outcome, (u64, String)> {
        let mut scene = ::scene::SceneFile::load("peel").unwrap();
        let membrane = scene.membrane.as_mut().unwrap();
        membrane.v_max_mm_s = v_max_mm_s;
        (membrane.tear_tension_n_per_m, membrane.p_tear) = (0.0, 1e9);
        let mut world = World::new(&scene).unwrap();
        world.spoil_membrane(spoil);
        play(&mut world, Programme::new(&scene, Random::from_seed(3)), 2.0, &mut no_clock)
    }

    /// At its limits an exploded tissue has finite numbers and a whole mesh: only its energy shows
    /// it.
    #[test]
    fn tissue_that_explodes_and_hangs_at_its_limits_fails() {
        assert_eq!(spoiled(300.0, |_| {}).map(|o| o.quiet_steps > 20), Ok(true));
        assert_eq!(spoiled(0.0, |_| {}).map(|o| o.quiet_steps > 20), Ok(true));
        let exploded = [
            ("negative damping", spoiled(300.0, |t| t.fluid_per_s = -300.0)),
            ("an unstable step", spoiled(300.0, |t| t.dt_s *= 4.0)),
            ("an unstable step without velocities", spoiled(0.0, |t| t.dt_s *= 4.0)),
        ];
        for (how, outcome) in exploded {
            let (_, problem) = outcome.expect_err(how);
            assert!(problem.contains("the membrane is restless"), "{how}: {problem}");
        }
    }

    /// `make test` builds unit tests with overflow checks (`tests/checked.toml`), other tests without.
    #[test]
    fn four_short_programmes_overflow_nothing() {
        let overflow = std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1));
        assert_eq!(overflow.is_err(), cfg!(debug_assertions));
        for seed in 100..104 {
            let outcome = run(seed, 2.0, &mut no_clock).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(outcome.tool_steps.iter().sum::<u64>(), 2 * outcome.steps);
        }
    }
}
