//! The whole retina: it lies on the choroid until fluid injected behind it takes it off, bleb by bleb; it can then be dragged, torn,
//! drained and pressed on again (paper, section 4.5, problem 2). `docs/retina.md` tells the model and shows what it does.
//!
//! ```text
//! needle ──▶ flow ──▶ accounts ──▶ springs move ──▶ volumes held ──▶ front comes off ──▶ pieces
//!  pierces   holes     of blebs     (membrane)       (pressure)       or lies on         found anew
//! ```
//!
//! The springs are those of the membrane ([`crate::membrane`]). Fluid is a volume for each bleb that the mesh is kept at
//! exactly; the pressure that this takes drives the front, the leaks and the flow of the injection. While everything lies on, a
//! substep costs nothing.

pub mod figures;
mod fluid;
mod front;
mod hold;
mod line;
pub mod mesh;
mod needle;
mod operation;
pub mod pieces;
pub mod state;
mod surface;
pub mod volume;

pub use needle::NeedleNews;
pub use surface::Clearance;

use crate::guard::{self, LastGood};
use crate::membrane::mesh::MeshError;
use crate::membrane::sheet::Sheet;
use crate::membrane::solver::Solver;
use crate::membrane::tear;
use crate::membrane::tissue::{Tissue, Unstable};
use figures::{FRONT_EVERY, Figures};
use nalgebra::Vector3;
use pieces::Pieces;
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_DEAD;
use scene::SceneFile;
use state::RetinaState;

/// Why a scene's retina cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RetinaError {
    /// Its mesh cannot be built.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Its springs are too stiff for their mass.
    #[error(transparent)]
    Unstable(#[from] Unstable),
}

/// What happened to the retina in a step, added up so that a step raises one event of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Toll {
    /// Nodes that came off the choroid, and one of them.
    pub detached: (u32, u32),
    /// Blebs that were taken up by others, and the volume of the one that took them, mm³.
    pub merged: (u32, f64),
    /// Nodes that came to lie on the choroid again, and one of them.
    pub lying: (u32, u32),
    /// Springs torn, and a node of one of them.
    pub torn: (u32, u32),
    /// Nodes disabled because their numbers ran away, and one of them.
    pub disabled: (u32, u32),
    /// Largest flow of an injection, mm³/s.
    pub flow_mm3_s: [f64; INSTRUMENTS],
}

/// The retina's connections and figures, and the work space of a step. All of it follows from the scene and the state.
#[derive(Debug)]
pub struct Retina {
    /// Figures of the scene.
    pub figures: Figures,
    /// Connections.
    pub sheet: Sheet,
    /// What is loose.
    pub pieces: Pieces,
    /// What happened since [`Retina::begin_step`].
    pub toll: Toll,
    /// Where the nodes lie at the start, eye frame, mm.
    pub home_mm: Vec<Vector3<f32>>,
    /// Springs' forces.
    pub solver: Solver,
    tissue: Tissue,
    /// Parts into which a substep is split for stability.
    splits: u32,
    home_mm2: Vec<f32>,
    /// Nodes that always hold: the last ring, and the optic disc where the scene says where it is.
    fixed: Vec<bool>,
    /// The state before the first step.
    begun: RetinaState,
    /// Force of a pressure of 1 Pa on each node, µN.
    push: Vec<Vector3<f64>>,
    /// Work space of the searches along a line.
    sides: line::Sides,
    simd: pulp::Arch,
    /// Force on each front node, and where the bleb lies seen from it.
    front_force: Vec<[Vector3<f64>; 2]>,
    /// What each front node and its neighbours carry: µN away from the choroid, µN along it, mm of rim.
    front_load: Vec<Vector3<f64>>,
    front_sum: Vec<Vector3<f64>>,
    last_good: LastGood,
}

impl Retina {
    /// The retina of a scene and its state at the start; `None` where the scene has none.
    pub fn new(scene: &SceneFile) -> Result<Option<(Self, RetinaState)>, RetinaError> {
        let Some(table) = &scene.retina else { return Ok(None) };
        let radius_mm = scene.eye.retina_radius_mm;
        let (axes, triangles) = mesh::hemisphere(radius_mm, table.rings);
        let positions: Vec<[f32; 3]> =
            (0..axes[0].len()).map(|n| axes.each_ref().map(|axis| axis[n])).collect();
        let mut sheet = Sheet::from_triangles(&positions, &triangles, &mesh::ora(table.rings))?;
        // Shorter at rest than as it lies: the retina's own tension.
        sheet.rest_mm.iter_mut().for_each(|l| *l = (f64::from(*l) / (1.0 + table.prestrain)) as f32);
        let mut tissue = Tissue::of_retina(table, radius_mm as f32);
        let splits = tissue.split(&sheet)?;
        let mut state = state::start(sheet.start());
        let home_mm: Vec<_> = (0..sheet.nodes()).map(|n| state.tissue.position(n)).collect();
        let mut fixed = vec![false; sheet.nodes()];
        sheet.rim.iter().for_each(|&n| fixed[n as usize] = true);
        let mut retina = Retina {
            figures: Figures::new(table, radius_mm, scene.needle.unwrap_or_default().radius_mm),
            pieces: Pieces::new(&sheet),
            toll: Toll::default(),
            tissue,
            splits,
            solver: Solver::new(&sheet).without_pinned(),
            home_mm2: pieces::home_areas(&sheet, &home_mm),
            home_mm,
            fixed,
            begun: state.clone(),
            push: vec![Vector3::zeros(); sheet.nodes()],
            sides: line::Sides::new(sheet.nodes()),
            simd: pulp::Arch::new(),
            front_force: Vec::with_capacity(sheet.structural),
            front_load: Vec::with_capacity(sheet.structural),
            front_sum: Vec::with_capacity(sheet.structural),
            last_good: LastGood::new(&state.tissue),
            sheet,
        };
        retina.find_again(&state);
        if let Some(disc) = table.disc_in_eye_mm {
            let node = retina.nearest_node(&state, &disc.into());
            retina.fixed[node as usize] = true;
        }
        if let Some(operation) = &table.operation {
            retina.operate(&mut state, operation);
        }
        retina.begun.clone_from(&state);
        Ok(Some((retina, state)))
    }

    /// The state before the first step.
    pub fn start(&self) -> RetinaState {
        let mut state = self.begun.clone();
        state.reserve();
        state
    }

    /// True if a node lies elsewhere than at the start.
    pub fn has_moved(&self, state: &RetinaState, node: u32) -> bool {
        let home = self.home_mm[node as usize];
        (state.tissue.position(node as usize) - home).norm_squared() > figures::MOVED_MM * figures::MOVED_MM
    }

    /// True if an instrument's tip comes within `reach_mm` of loose retina, axis by axis.
    pub fn reaches(&self, state: &RetinaState, tip_mm: &Vector3<f64>, reach_mm: f64) -> bool {
        let tissue = &state.tissue;
        let near = |&n: &u32| (volume::at(tissue, n) - tip_mm).iter().all(|c| c.abs() < reach_mm);
        self.pieces.loose().iter().any(near)
    }

    /// Derives everything from a state that was not reached by steps: a restored or a fresh one.
    pub fn find_again(&mut self, state: &RetinaState) {
        self.pieces.find(&self.sheet, state, &self.home_mm2);
        self.solver.refresh(&self.sheet, &state.tissue, &self.tissue);
        self.last_good.remember(&state.tissue);
    }

    /// True if a state's blebs are those that its flags make; a checkpoint that says otherwise is damaged.
    pub fn agrees(&self, state: &RetinaState) -> bool {
        let mut pieces = Pieces::new(&self.sheet);
        pieces.find(&self.sheet, state, &self.home_mm2);
        pieces.label == state.bleb_of && pieces.count() == state.blebs.len()
    }

    /// Parts into which each substep is split for stability.
    pub fn splits(&self) -> u32 {
        self.splits
    }

    /// Begins a step.
    pub fn begin_step(&mut self, state: &RetinaState) {
        self.toll = Toll::default();
        self.last_good.remember(&state.tissue);
    }

    /// One substep of the loose retina, after the needles and jaws were moved: forces, tears, ways, volumes, front.
    pub fn substep(&mut self, state: &mut RetinaState, substep: u64) {
        if self.pieces.count() == 0 {
            return;
        }
        for _ in 0..self.splits {
            self.advance(state);
        }
        self.hold_volumes(state);
        if substep.is_multiple_of(FRONT_EVERY) {
            if state.air {
                self.lie_on_under_air(state);
            } else {
                self.advance_front(state);
            }
        }
    }

    /// One part of a substep: forces, what they tear, motion.
    fn advance(&mut self, state: &mut RetinaState) {
        let alarms = self.solver.accelerate(&self.sheet, &state.tissue, &self.tissue);
        if alarms.not_finite {
            self.contain(state);
        }
        if alarms.over_acceleration || alarms.over_tension {
            self.tear(state, alarms.over_acceleration);
        }
        self.solver.integrate(&mut state.tissue, &self.tissue);
    }

    /// The last corrections of a step: the mesh holds the accounts' volumes, and every number is finite.
    pub fn end_step(&mut self, state: &mut RetinaState) {
        // Before volumes are measured, and again after nodes were moved to hold them.
        self.check_finite(state);
        self.contain_fluid(state);
        self.settle_volumes(state);
        if self.check_finite(state) {
            self.contain_fluid(state);
        }
    }

    /// Takes nodes with bad numbers out; true if there were some.
    fn check_finite(&mut self, state: &mut RetinaState) -> bool {
        if guard::all_finite(&state.tissue) {
            return false;
        }
        let (mut count, mut last) = self.toll.disabled;
        let culprit = |node: usize| (count, last) = (count + 1, node as u32);
        guard::disable_bad_nodes(&self.sheet, &mut state.tissue, &self.last_good, culprit);
        self.toll.disabled = (count, last);
        self.after_loss(state);
        true
    }

    /// A bleb whose account or pressure is not a number gets what the mesh holds, and the leaks take up the difference.
    fn contain_fluid(&mut self, state: &mut RetinaState) {
        let bad = |b: &state::Bleb| !(b.volume_mm3.is_finite() && b.pressure_pa.is_finite());
        if state.account.leaked_mm3.is_finite() && !state.blebs.iter().any(bad) {
            return;
        }
        for bleb in 0..self.pieces.count() {
            if bad(&state.blebs[bleb]) {
                let volume_mm3 = self.measured_mm3(state, bleb);
                state.blebs[bleb] = state::Bleb { volume_mm3, pressure_pa: 0.0, ..state.blebs[bleb] };
                self.toll.disabled = (self.toll.disabled.0 + 1, self.pieces.nodes_of(bleb)[0]);
            }
        }
        state.account.leaked_mm3 = state.account.injected_mm3 - state.under_mm3();
    }

    fn contain(&mut self, state: &mut RetinaState) {
        let (mut count, mut last) = self.toll.disabled;
        let culprit = |node: usize| (count, last) = (count + 1, node as u32);
        guard::contain(&self.sheet, &mut state.tissue, &mut self.solver, &self.last_good, culprit);
        self.toll.disabled = (count, last);
        self.after_loss(state);
    }

    fn tear(&mut self, state: &mut RetinaState, over_acceleration: bool) {
        let (sheet, tissue, solver) = (&self.sheet, &mut state.tissue, &self.solver);
        let (mut torn, mut place) = tear::tear_by_tension(sheet, tissue, solver);
        if over_acceleration {
            let (more, at) = tear::tear_by_acceleration(sheet, tissue, solver, self.tissue.a_tear);
            (torn, place) = (torn + more, if more > 0 { at } else { place });
        }
        if torn > 0 {
            self.toll.torn = (self.toll.torn.0 + torn, place as u32);
            self.after_loss(state);
        }
    }

    /// After triangles have gone: what hung on them sinks to the choroid, and the fluid that was under it is lost.
    pub fn after_loss(&mut self, state: &mut RetinaState) {
        for bleb in 0..self.pieces.count() {
            let dead = |n: &u32| state.tissue.flag[*n as usize] == NODE_DEAD;
            if !self.pieces.nodes_of(bleb).iter().any(dead) {
                continue;
            }
            let before = self.measured_mm3(state, bleb);
            for &n in self.pieces.nodes_of(bleb) {
                if state.tissue.flag[n as usize] == NODE_DEAD {
                    front::lay(&mut state.tissue, n, self.figures.radius_mm);
                }
            }
            let lost = before - self.measured_mm3(state, bleb);
            state.blebs[bleb].volume_mm3 -= lost;
            state.account.leaked_mm3 += lost;
        }
        hold::drop_dead(state);
        self.reconnect(state);
    }
}
