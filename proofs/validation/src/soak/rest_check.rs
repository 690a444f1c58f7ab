//! Tissue that no tool handles must come to rest: a share of the energy that its limits of speed
//! allow must not last.
//!
//! Limits hold tissue that explodes at v_max, where every number is finite and the mesh may stay
//! whole; what gives it away is that it does not slow down. So, once the hands have been off for
//! [`SETTLE_STEPS`], the mean square of the nodes' speeds over the square of their limit may be
//! above [`RESTLESS`] in fewer than [`LASTING`] steps on end. Tissue that springs back loses its
//! energy to the fluid faster than that. Once no tip has been near for as long, nothing may tear.
//!
//! In the paper's quasi-static system (v_max = 0) nodes have no velocity: a substep moves each by
//! its acceleration, and the share is that of a_max. Where an implicit integrator places the nodes,
//! their way since the step before counts as well.

use nalgebra::Vector3;
use protocol::events::EventKind;
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;
use scene::MembraneIntegrator;
use simcore::world::World;
use tissue::sheet::state::SheetState;

/// Steps without a hand after which tissue must be calm.
pub const SETTLE_STEPS: u32 = 10;
/// Share of the energy at the limits of speed that calm tissue stays below.
pub const RESTLESS: f64 = 0.03;
/// Steps on end that tissue must be above it to fail.
pub const LASTING: usize = 5;
/// A tip within this distance of tissue may have touched it between two checked_steps, mm; so may
/// one that moved by half of it in a step.
const NEAR_MM: f64 = 4.0;
/// Speed that stands for the limit where a scene sets none, mm/s.
const FAST_MM_S: f64 = 100.0;

/// What the steps so far showed.
#[derive(Debug, Clone, Default)]
pub struct RestCheck {
    quiet_steps: u32,
    far_steps: u32,
    tips_mm: [Vector3<f64>; INSTRUMENTS],
    before: [Vec<[f32; 3]>; 2],
    last: [[f64; LASTING]; 2],
    /// Steps in which the tissue was looked at.
    pub checked_steps: u64,
    /// Largest share that lasted.
    pub lasting: f64,
}

impl RestCheck {
    /// Looks at the world after a step that advanced it by `advanced_s`.
    ///
    /// # Errors
    /// If tissue that no tool handles keeps moving or tears.
    pub fn check(&mut self, world: &World, advanced_s: f64) -> Result<(), String> {
        let shares = self.shares(world, advanced_s);
        if advanced_s == 0.0 {
            return Ok(());
        }
        self.far_steps = if self.is_near(world) { 0 } else { self.far_steps.saturating_add(1) };
        self.quiet_steps = if world.is_handled() { 0 } else { self.quiet_steps.saturating_add(1) };
        if self.quiet_steps <= SETTLE_STEPS {
            self.last = Default::default();
            return Ok(());
        }
        self.checked_steps += 1;
        for ((name, share), last) in ["membrane", "retina"].into_iter().zip(shares).zip(&mut self.last) {
            last.rotate_left(1);
            last[LASTING - 1] = share;
            let lasting = last.iter().copied().fold(f64::INFINITY, f64::min);
            self.lasting = self.lasting.max(lasting);
            if lasting > RESTLESS {
                let percent = 100.0 * lasting;
                return Err(format!("the {name} is restless: {percent:.1} % of its largest energy"));
            }
        }
        if self.far_steps <= SETTLE_STEPS {
            return Ok(());
        }
        match world.events().iter().find(|e| tears(e.kind)) {
            Some(torn) => Err(format!("{} springs tore though no hand was near", torn.value)),
            None => Ok(()),
        }
    }

    /// True if a tip may have touched tissue in this step.
    fn is_near(&mut self, world: &World) -> bool {
        let state = world.state();
        let tips = state.instruments.each_ref().map(|i| i.tip_in_eye_mm);
        let before = std::mem::replace(&mut self.tips_mm, tips);
        let retina = state.retina.as_ref().map(|r| &r.sheet);
        let near = |tip: &Vector3<f64>, tissue: &SheetState| {
            let way = |n: usize| tissue.position(n).map(f64::from) - tip;
            (0..tissue.nodes()).any(|n| way(n).norm() < NEAR_MM)
        };
        (0..INSTRUMENTS).any(|i| {
            let moved = (tips[i] - before[i]).norm() > 0.5 * NEAR_MM;
            moved || [Some(&state.membrane), retina].into_iter().flatten().any(|t| near(&tips[i], t))
        })
    }

    /// Kinetic energy of membrane and retina as shares of what their limits allow.
    fn shares(&mut self, world: &World, advanced_s: f64) -> [f64; 2] {
        let (scene, state) = (world.scene(), world.state());
        let [membrane_before, retina_before] = &mut self.before;
        let membrane = scene.membrane.as_ref().map_or(0.0, |m| {
            let ways = displacements_mm(&state.membrane, membrane_before);
            let euler =
                matches!(m.integrator, MembraneIntegrator::SemiImplicit | MembraneIntegrator::Explicit);
            if m.v_max_mm_s == 0.0 && euler {
                let most2 = m.a_max_mm_s2 * m.a_max_mm_s2;
                let a2 = world.membrane_acceleration2();
                return mean_free(&state.membrane, |n| (f64::from(a2[n]) / most2).min(1.0));
            }
            let limit = if m.v_max_mm_s > 0.0 { m.v_max_mm_s } else { FAST_MM_S };
            let speed2 = |n: usize| f64::from(state.membrane.velocity(n).norm_squared());
            let way2 = |n: usize| if euler { 0.0 } else { ways[n] * ways[n] / (advanced_s * advanced_s) };
            mean_free(&state.membrane, |n| speed2(n).max(way2(n)) / (limit * limit))
        });
        let retina = scene.retina.as_ref().zip(state.retina.as_ref()).map_or(0.0, |(scene, retina)| {
            displacements_mm(&retina.sheet, retina_before);
            let speed2 = |n: usize| f64::from(retina.sheet.velocity(n).norm_squared());
            mean_free(&retina.sheet, |n| speed2(n) / (scene.v_max_mm_s * scene.v_max_mm_s))
        });
        [membrane, retina]
    }
}

fn tears(kind: u32) -> bool {
    [EventKind::TissueTorn, EventKind::RetinaRipped].iter().any(|&k| k as u32 == kind)
}

/// How far each node has come since the last call.
fn displacements_mm(tissue: &SheetState, before: &mut Vec<[f32; 3]>) -> Vec<f64> {
    let now: Vec<[f32; 3]> = (0..tissue.nodes()).map(|n| tissue.position(n).into()).collect();
    if before.len() != now.len() {
        before.clone_from(&now);
    }
    let way = |a: &[f32; 3], b: &[f32; 3]| {
        let squares = (0..3).map(|i| f64::from(a[i] - b[i]) * f64::from(a[i] - b[i]));
        libm::sqrt(squares.sum())
    };
    let ways = now.iter().zip(&*before).map(|(a, b)| way(a, b)).collect();
    *before = now;
    ways
}

/// Mean over the free nodes; 0 where there are none.
fn mean_free(tissue: &SheetState, of: impl Fn(usize) -> f64) -> f64 {
    let free = || (0..tissue.nodes()).filter(|&n| tissue.flag[n] == NODE_FREE);
    let sum: f64 = free().map(of).sum();
    let count = free().count();
    if count == 0 { 0.0 } else { sum / count as f64 }
}
