//! Moves the bodies over a substep: position-based dynamics of rigid bodies (Müller, Macklin,
//! Chentanez, Jeschke and Kim 2020, *Detailed rigid body simulation with extended position based
//! dynamics*), with rigid contacts only.
//!
//! 1. Weight and damping change the velocities, the velocities the poses.
//! 2. Contacts are found once, at the predicted poses: with the instruments and with each other by
//!    parry3d, with the retina in closed form (a sphere from inside: the centre of a ball, the ends
//!    of a rod, the corners of a box).
//! 3. A few rounds push what is inside each other apart, both parties by their generalised inverse
//!    mass, and take back what would slide, as far as friction holds it (Coulomb, on positions).
//! 4. Velocities are what has become of the poses. Contacts do not bounce.

use super::contacts::{self, Contact};
use super::model::BodyModel;
use super::motion::{integrate, reset, update_velocity};
use super::state::{BodiesState, BodyState, Grip};
use collision::rigid::{Compound, RigidContact};
use collision::surface::CollisionError;
use nalgebra::{Isometry3, Vector3};
use protocol::limits::INSTRUMENTS;
use scene::BodiesScene;

/// Rounds over the contacts of a substep.
const ROUNDS: usize = 6;

/// An instrument in a substep.
#[derive(Debug, Clone, Copy)]
pub struct ToolMotion {
    /// `eye_from_instrument` at its end.
    pub pose: Isometry3<f64>,
    /// The same at its begin.
    pub before: Isometry3<f64>,
    /// It may touch bodies.
    pub touches: bool,
}

/// What acts on all bodies in a substep.
#[derive(Debug, Clone, Copy)]
pub struct SolverParams {
    /// Weight of a gram, eye frame, mm/s².
    pub weight_mm_s2: Vector3<f64>,
    /// 1/s.
    pub damping_per_s: f64,
    /// mm.
    pub retina_radius_mm: f64,
    /// Most that jaws hold, µN.
    pub grip_un: f64,
    /// Length of the substep, s.
    pub dt_s: f64,
}

/// Work space of the solver.
#[derive(Debug, Default)]
pub struct BodySolver {
    pub(super) models: Vec<BodyModel>,
    pub(super) before: Vec<BodyState>,
    /// The bodies of the scene at its begin.
    begin: Vec<BodyState>,
    pub(super) contacts: Vec<Contact>,
    pub(super) found: Vec<RigidContact>,
    /// Bodies that an instrument's jaws touch: which body, by which part, its normal in the eye
    /// frame.
    pub(super) touched: Vec<TouchedBody>,
    /// Sum of the pulls of each grip, eye frame, g·mm.
    pulls: [Vector3<f64>; INSTRUMENTS],
}

/// Bodies that were stopped because their numbers ran away.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StoppedBodies {
    /// How often one was stopped.
    pub count: u32,
    /// The last one.
    pub last: u32,
}

impl StoppedBodies {
    /// Adds those of a later substep.
    pub fn add(&mut self, later: StoppedBodies) {
        self.count += later.count;
        if later.count > 0 {
            self.last = later.last;
        }
    }
}

/// A body that an instrument touches.
#[derive(Debug, Clone, Copy)]
pub struct TouchedBody {
    /// The instrument.
    pub instrument: usize,
    /// Its part: 0 the shaft, 1 and 2 the jaws.
    pub part: usize,
    /// The body.
    pub body: usize,
    /// Out of the body, eye frame.
    pub normal: Vector3<f64>,
}

impl BodySolver {
    /// A solver for the bodies of a scene.
    ///
    /// # Errors
    /// [`CollisionError`] for a body without extent.
    pub fn new(scene: &BodiesScene) -> Result<Self, CollisionError> {
        let models: Vec<BodyModel> = scene.body.iter().map(BodyModel::new).collect::<Result<_, _>>()?;
        let n = models.len();
        Ok(BodySolver {
            before: Vec::with_capacity(n),
            begin: BodiesState::start(scene).body,
            contacts: Vec::with_capacity(n * (8 + 3 * INSTRUMENTS + n)),
            found: Vec::with_capacity(8),
            touched: Vec::with_capacity(3 * INSTRUMENTS * n),
            pulls: [Vector3::zeros(); INSTRUMENTS],
            models,
        })
    }

    /// The models.
    pub fn models(&self) -> &[BodyModel] {
        &self.models
    }

    /// Which bodies the instruments touched in the last substep.
    pub fn touched(&self) -> &[TouchedBody] {
        &self.touched
    }

    /// Force that the jaws of an instrument applied to what they hold in the last substep, eye
    /// frame, µN.
    pub fn pull_un(&self, instrument: usize, dt_s: f64) -> Vector3<f64> {
        self.pulls[instrument] / (dt_s * dt_s)
    }

    /// Moves the bodies over a substep; returns which of them were stopped.
    pub fn step(
        &mut self,
        bodies: &mut [BodyState],
        grips: &[Option<Grip>; INSTRUMENTS],
        tools: &[Compound; INSTRUMENTS],
        motions: &[ToolMotion; INSTRUMENTS],
        params: &SolverParams,
    ) -> StoppedBodies {
        self.before.clear();
        self.before.extend_from_slice(bodies);
        self.pulls = [Vector3::zeros(); INSTRUMENTS];
        bodies.iter_mut().for_each(|body| integrate(body, params));
        self.find_contacts(bodies, grips, tools, motions, params);
        for _ in 0..ROUNDS {
            for (instrument, grip) in grips.iter().enumerate() {
                if let Some(grip) = grip.filter(|_| motions[instrument].touches) {
                    self.solve_grip(bodies, &grip, instrument, &motions[instrument].pose, params);
                }
            }
            let mut contacts = std::mem::take(&mut self.contacts);
            let mut rest = &mut contacts[..];
            while !rest.is_empty() {
                let (apart, after) = rest.split_at_mut(contacts::independent(rest));
                self.solve_contacts(bodies, apart, motions, params);
                rest = after;
            }
            self.contacts = contacts;
        }
        let mut stopped = StoppedBodies::default();
        for (b, (body, before)) in bodies.iter_mut().zip(&self.before).enumerate() {
            if !update_velocity(body, before, params.dt_s) {
                reset(body, before, &self.begin[b]);
                stopped.add(StoppedBodies { count: 1, last: b as u32 });
            }
        }
        stopped
    }

    /// Pulls a held body to where the jaws have it, with no more force than they give.
    fn solve_grip(
        &mut self,
        bodies: &mut [BodyState],
        grip: &Grip,
        instrument: usize,
        pose: &Isometry3<f64>,
        params: &SolverParams,
    ) {
        let body = &mut bodies[grip.body as usize];
        let wanted = pose * grip.instrument_from_body;
        let mass = self.models[grip.body as usize].mass_g();
        let most = params.grip_un * params.dt_s * params.dt_s;
        let pull = self.pulls[instrument]
            + (wanted.translation.vector - body.eye_from_body.translation.vector) * mass;
        let size = pull.norm();
        let pull = if size > most { pull * (most / size) } else { pull };
        body.eye_from_body.translation.vector += (pull - self.pulls[instrument]) / mass;
        self.pulls[instrument] = pull;
        // Flat jaws hold against turning better than against sliding.
        body.eye_from_body.rotation = wanted.rotation;
    }
}

#[cfg(test)]
mod tests {
    use super::super::push::ROLLING_MM;
    use super::*;
    use protocol::handles::Tool;
    use scene::{BodyScene, BodyShape};

    const DT_S: f64 = 1e-3;

    fn scene(shape: BodyShape, half_extents_mm: [f64; 3], at: [f64; 3], friction: f64) -> BodiesScene {
        let body = BodyScene {
            shape,
            half_extents_mm,
            position_in_eye_mm: at,
            mass_g: 0.002,
            friction,
            rgba: [1.0; 4],
        };
        BodiesScene { weight_mm_s2: 0.0, damping_per_s: 0.0, body: vec![body] }
    }

    fn params(weight_mm_s2: [f64; 3], damping_per_s: f64, retina_radius_mm: f64) -> SolverParams {
        let weight_mm_s2 = weight_mm_s2.into();
        SolverParams { weight_mm_s2, damping_per_s, retina_radius_mm, grip_un: 100.0, dt_s: DT_S }
    }

    fn away() -> ToolMotion {
        ToolMotion { pose: Isometry3::identity(), before: Isometry3::identity(), touches: false }
    }

    fn tools() -> [Compound; INSTRUMENTS] {
        [Tool::LightPipe; INSTRUMENTS].map(|t| Compound::instrument(t, 0.25, 20.0).unwrap())
    }

    /// The body after so many substeps without instruments.
    fn left_alone(scene: &BodiesScene, params: &SolverParams, substeps: usize) -> BodyState {
        let mut bodies = BodiesState::start(scene);
        let (mut solver, tools) = (BodySolver::new(scene).unwrap(), tools());
        for _ in 0..substeps {
            solver.step(&mut bodies.body, &bodies.grip, &tools, &[away(); INSTRUMENTS], params);
        }
        bodies.body[0]
    }

    #[test]
    fn a_falling_ball_reaches_the_speed_at_which_the_fluid_carries_it() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0; 3], 0.3);
        let body = left_alone(&scene, &params([0.0, 0.0, -600.0], 12.0, 1e4), 2_000);
        assert!((body.velocity_mm_s - Vector3::new(0.0, 0.0, -50.0)).norm() < 1e-6, "weight / damping");
    }

    /// Resistance to rolling holds a ball where the slope's tangent is below lever / radius; where
    /// it rolls, it stops on such a slope.
    #[test]
    fn a_ball_comes_to_rest_on_the_retina() {
        for (x, stays) in [(1.0, true), (1.8, true), (5.0, false)] {
            let centre = [x, 0.0, -f64::sqrt(11.0 * 11.0 - x * x)];
            let scene = scene(BodyShape::Sphere, [0.5; 3], centre, 0.6);
            let body = left_alone(&scene, &params([0.0, 0.0, -5900.0], 12.0, 11.5), 4_000);
            let at = body.eye_from_body.translation.vector;
            assert!((at.norm() - 11.0).abs() < 1e-3 && body.velocity_mm_s.norm() < 0.05, "{at}");
            assert_eq!((at - Vector3::from(centre)).norm() < 0.02, stays, "{at} from {x}");
            let slope = at.x.hypot(at.y) / -at.z;
            assert!(slope < 1.1 * ROLLING_MM / 0.5, "{slope}");
        }
    }

    /// A box on a floor so wide that it is flat, the weight at a slope to it: it stays while the
    /// slope's tangent is below the friction, and else slides with the acceleration that Coulomb's
    /// friction leaves.
    #[test]
    fn a_box_slides_where_friction_says() {
        let (radius, g) = (1e5, 1_000.0);
        for (slope, friction) in [(0.2f64, 0.25), (0.4, 0.5), (0.4, 0.25), (0.5, 0.1), (0.3, 0.0)] {
            let scene = scene(BodyShape::Box, [1.0, 1.0, 0.2], [0.0, 0.0, -(radius - 0.2001)], friction);
            let weight = [g * slope.sin(), 0.0, -g * slope.cos()];
            let substeps = 200;
            let body = left_alone(&scene, &params(weight, 0.0, radius), substeps);
            let way = body.eye_from_body.translation.vector.x;
            let left = (slope.sin() - friction * slope.cos()).max(0.0);
            let t = substeps as f64 * DT_S;
            let expected = 0.5 * g * left * t * (t + DT_S);
            let error = (way - expected).abs();
            assert!(error < 0.01 + 0.03 * expected, "slope {slope}, friction {friction}: {way} {expected}");
        }
    }

    #[test]
    fn bodies_that_do_not_touch_move_as_each_would_alone() {
        let at =
            [[0.0, 0.2, -11.0], [2.5, 0.0, -10.7], [-2.0, 2.0, -10.6], [0.0, -3.0, -10.5], [4.5, 1.0, -9.8]];
        let alone = at.map(|at| scene(BodyShape::Box, [0.5, 0.3, 0.3], at, 0.5));
        let mut together = alone[0].clone();
        together.body = alone.iter().flat_map(|s| s.body.clone()).collect();
        let params = params([300.0, 0.0, -5900.0], 12.0, 11.5);
        let (mut bodies, tools) = (BodiesState::start(&together), tools());
        let mut solver = BodySolver::new(&together).unwrap();
        for _ in 0..500 {
            solver.step(&mut bodies.body, &bodies.grip, &tools, &[away(); INSTRUMENTS], &params);
        }
        for (scene, body) in alone.iter().zip(&bodies.body) {
            assert_eq!(&left_alone(scene, &params, 500), body);
        }
    }

    #[test]
    fn a_tip_pushes_a_ball_ahead_of_it() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0, 0.0, -0.52], 0.3);
        let mut bodies = BodiesState::start(&scene);
        let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
        let params = params([0.0; 3], 10.0, 1e4);
        let tip = |k: usize| Isometry3::translation(0.0, 0.0, -5.0 * DT_S * k as f64);
        for k in 1..=200 {
            let instrument = ToolMotion { pose: tip(k), before: tip(k - 1), touches: true };
            solver.step(&mut bodies.body, &bodies.grip, &tools, &[instrument, away()], &params);
        }
        let body = bodies.body[0];
        // The flat end of the pipe is at −1 mm and touches the ball's top.
        assert!((body.eye_from_body.translation.vector.z + 1.5).abs() < 1e-3, "{body:?}");
        // In front of the tip, or just thrown clear of it by the fluid's grasp of a substep.
        assert!((body.velocity_mm_s.z + 5.0).abs() < 0.1, "{body:?}");
    }

    /// Held against its weight: the jaws' pull is m·g. Held by less than that: it slides out.
    #[test]
    fn a_grip_carries_what_it_can() {
        let scene = scene(BodyShape::Sphere, [0.5; 3], [0.0, 0.0, -3.0], 0.3);
        let (m, g) = (0.002, 6_000.0);
        for (grip_un, carried) in [(1.2 * m * g, true), (0.8 * m * g, false)] {
            let mut bodies = BodiesState::start(&scene);
            let instrument =
                ToolMotion { pose: Isometry3::identity(), before: Isometry3::identity(), touches: true };
            bodies.grip[0] = Some(super::super::grip::take(0, &bodies.body[0], &instrument.pose, 0.3));
            let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
            let params = SolverParams { grip_un, ..params([0.0, 0.0, -g], 0.0, 11.5) };
            for _ in 0..50 {
                solver.step(&mut bodies.body, &bodies.grip, &tools, &[instrument, away()], &params);
            }
            let pull = solver.pull_un(0, DT_S);
            assert!((pull.z - grip_un.min(m * g)).abs() < 1e-3 * m * g, "{pull} of {grip_un}");
            let z = bodies.body[0].eye_from_body.translation.vector.z;
            assert_eq!((z + 3.0).abs() < 1e-6, carried, "{z}");
        }
    }

    #[test]
    fn numbers_that_run_away_stop_the_body() {
        let scene = scene(BodyShape::Box, [0.5; 3], [0.0, 0.0, -3.0], 0.3);
        let mut bodies = BodiesState::start(&scene);
        let (mut solver, tools) = (BodySolver::new(&scene).unwrap(), tools());
        let bad = ToolMotion {
            pose: Isometry3::translation(f64::NAN, 0.0, 0.0),
            before: Isometry3::identity(),
            touches: true,
        };
        bodies.grip[1] = Some(super::super::grip::take(0, &bodies.body[0], &Isometry3::identity(), 0.3));
        for weight in [0.0, f64::NAN, f64::INFINITY] {
            solver.step(
                &mut bodies.body,
                &bodies.grip,
                &tools,
                &[bad, bad],
                &params([0.0, 0.0, weight], 1.0, 11.5),
            );
            assert!(bodies.body[0].is_sound());
        }
    }
}
