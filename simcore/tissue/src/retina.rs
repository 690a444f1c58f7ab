//! The whole retina: it lies on the choroid until fluid injected behind it takes it off, bleb by
//! bleb; it can then be dragged, torn, drained and pressed on again (paper, section 4.5, problem
//! 2). `docs/retina.md` explains the model and shows results.
//!
//! ```text
//! needle ──▶ flow ──▶ accounts ──▶ springs move ──▶ volumes held ──▶ front comes off ──▶ blebs
//!  pierces   holes     of blebs     (sheet)          (pressure)       or re-attaches      are rebuilt
//! ```
//!
//! Its mesh is a [`SheetBody`] like the membrane; what is added here is fluid and re-attachment.
//! Fluid is a volume for each bleb that the mesh is kept at exactly; the pressure that this takes
//! drives the front, the leaks and the flow of the injection. While everything lies on, a substep
//! costs nothing.

pub mod blebs;
mod clearance;
pub mod figures;
mod fluid;
mod front;
mod initial_state;
mod line;
pub mod mesh;
mod needle;
pub mod state;
pub mod volume;

pub use clearance::Clearance;
pub use needle::NeedleEvents;

use crate::sheet::body::{SheetBody, SheetError};
use crate::sheet::collider::{Contact, Friction, Pushed, Pusher};
use crate::sheet::material::Material;
use crate::sheet::mesh::SheetMesh;
use crate::sheet::step_counts::{SheetCounts, Tally};
use crate::vitrector::Port;
use blebs::Blebs;
use figures::{FRONT_EVERY, Figures};
use nalgebra::{Isometry3, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_DEAD;
use scene::SceneFile;
use state::RetinaState;

/// What happened to the retina.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RetinaCounts {
    /// What happened to its sheet.
    pub sheet: SheetCounts,
    /// Blebs that were taken up by others, and the volume of the one that took them, mm³.
    pub merged: (u32, f64),
    /// Nodes that came to lie on the choroid again.
    pub attached: Tally,
    /// Largest flow of an injection, mm³/s.
    pub flow_mm3_s: [f64; INSTRUMENTS],
}

impl RetinaCounts {
    /// Adds those of a later phase.
    pub fn merge(&mut self, later: &RetinaCounts) {
        self.sheet.merge(&later.sheet);
        self.attached.merge(later.attached);
        if later.merged.0 > 0 {
            self.merged = (self.merged.0 + later.merged.0, later.merged.1);
        }
        for (flow, later) in self.flow_mm3_s.iter_mut().zip(later.flow_mm3_s) {
            *flow = flow.max(later);
        }
    }
}

/// The retina's sheet and figures, and the work space of a step. All of it follows from the scene
/// and the state.
#[derive(Debug)]
pub struct Retina {
    /// Figures of the scene.
    pub figures: Figures,
    /// Mesh, springs, and what instruments do to them.
    pub body: SheetBody,
    /// What is loose.
    pub blebs: Blebs,
    /// What happened since it was last taken, without the sheet's part, which the sheet counts.
    counts: RetinaCounts,
    /// Where the nodes lie at the start, eye frame, mm.
    pub home_mm: Vec<Vector3<f32>>,
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
    /// What each front node and its neighbours carry: µN away from the choroid, µN along it, mm of
    /// rim.
    front_load: Vec<Vector3<f64>>,
    front_sum: Vec<Vector3<f64>>,
}

impl Retina {
    /// The retina of a scene and its state at the start; `None` where the scene has none.
    ///
    /// # Errors
    /// If its mesh or its stiffness cannot be simulated.
    pub fn new(scene: &SceneFile) -> Result<Option<(Self, RetinaState)>, SheetError> {
        let Some(table) = &scene.retina else { return Ok(None) };
        let radius_mm = scene.eye.retina_radius_mm;
        let (positions, triangles) = mesh::hemisphere(radius_mm, table.rings);
        let mut mesh = SheetMesh::from_triangles(&positions, &triangles, &mesh::ora(table.rings))?;
        // Shorter at rest than as it lies: the retina's own tension.
        mesh.rest_mm.iter_mut().for_each(|l| *l = (f64::from(*l) / (1.0 + table.prestrain)) as f32);
        let mut fixed = vec![false; mesh.nodes()];
        mesh.rim.iter().for_each(|&n| fixed[n as usize] = true);
        let mut state = state::start(mesh.start());
        let home_mm: Vec<_> = (0..mesh.nodes()).map(|n| state.sheet.position(n)).collect();
        let (nodes, springs) = (mesh.nodes(), mesh.structural);
        let contact = Contact {
            friction: Friction::Drag(table.drag as f32),
            follows_tip: false,
            lifts: false,
            pierce_un: None,
            without_pinned: true,
        };
        let mut retina = Retina {
            figures: Figures::new(table, radius_mm, scene.needle.unwrap_or_default().radius_mm),
            blebs: Blebs::new(&mesh),
            counts: RetinaCounts::default(),
            home_mm2: blebs::home_areas(&mesh, &home_mm),
            home_mm,
            fixed,
            begun: state.clone(),
            push: vec![Vector3::zeros(); nodes],
            sides: line::Sides::new(nodes),
            simd: pulp::Arch::new(),
            front_force: Vec::with_capacity(springs),
            front_load: Vec::with_capacity(springs),
            front_sum: Vec::with_capacity(springs),
            body: SheetBody::on_choroid(scene, mesh, Material::of_retina(table, radius_mm as f32), contact)?,
        };
        retina.resume(&mut state);
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
        (state.sheet.position(node as usize) - home).norm_squared() > figures::MOVED_MM * figures::MOVED_MM
    }

    /// Derives everything from a state that was not reached by steps: a restored or a fresh one.
    pub fn resume(&mut self, state: &mut RetinaState) {
        state.reserve();
        self.blebs.find(&self.body.mesh, state, &self.home_mm2);
        self.body.resume(&mut state.sheet);
    }

    /// Whether a state fits the scene, and its blebs are those that its flags make.
    ///
    /// # Errors
    /// With the first thing that is wrong.
    pub fn check(&self, state: &RetinaState) -> Result<(), &'static str> {
        self.body.check(&state.sheet)?;
        state.check()?;
        let mut blebs = Blebs::new(&self.body.mesh);
        blebs.find(&self.body.mesh, state, &self.home_mm2);
        if blebs.label == state.bleb_of && blebs.count() == state.blebs.len() {
            Ok(())
        } else {
            Err("its blebs do not match the detached area")
        }
    }

    /// Begins a step.
    pub fn begin_step(&mut self, state: &RetinaState) {
        self.body.begin_step(&state.sheet);
    }

    /// What happened since the last call; every phase hands it on when it ends.
    pub fn take_counts(&mut self) -> RetinaCounts {
        RetinaCounts { sheet: self.body.take_counts(), ..std::mem::take(&mut self.counts) }
    }

    /// One substep of the loose retina, after the needles were moved: forces, tears, motion,
    /// volumes, front.
    pub fn substep(&mut self, state: &mut RetinaState, substep: u64) {
        if self.blebs.count() == 0 {
            return;
        }
        for _ in 0..self.body.splits() {
            if self.body.advance(&mut state.sheet) {
                self.after_loss(state);
            }
        }
        self.hold_volumes(state);
        if substep.is_multiple_of(FRONT_EVERY) {
            if state.air {
                self.attach_under_air(state);
            } else {
                self.advance_front(state);
            }
        }
    }

    /// Sets the outer forces of a substep and cuts; see [`SheetBody::draw`].
    pub fn draw(
        &mut self,
        state: &mut RetinaState,
        ports: &[Option<Port>; INSTRUMENTS],
        eye_from_instrument: &[Isometry3<f64>; INSTRUMENTS],
    ) {
        if self.body.draw(&mut state.sheet, ports, eye_from_instrument) {
            self.after_loss(state);
        }
    }

    /// Pushes an instrument into the loose retina; what it presses onto the choroid attaches.
    pub fn push(&mut self, state: &mut RetinaState, pusher: &Pusher) -> Pushed {
        let pushed = self.body.push(&mut state.sheet, pusher);
        let mut attached = false;
        for k in 0..self.body.moved().len() {
            attached |= self.attach(state, self.body.moved()[k]);
        }
        if attached {
            self.reconnect(state);
        }
        pushed
    }

    /// The last corrections of a step: the mesh holds the accounts' volumes, and every number is
    /// finite.
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
        let lost = self.body.check_finite(&mut state.sheet);
        if lost {
            self.after_loss(state);
        }
        lost
    }

    /// A bleb whose account or pressure is not a number gets what the mesh holds, and the leaks
    /// take up the difference.
    fn contain_fluid(&mut self, state: &mut RetinaState) {
        let bad = |b: &state::Bleb| !(b.volume_mm3.is_finite() && b.pressure_pa.is_finite());
        if state.account.leaked_mm3.is_finite() && !state.blebs.iter().any(bad) {
            return;
        }
        for bleb in 0..self.blebs.count() {
            if bad(&state.blebs[bleb]) {
                let volume_mm3 = self.measured_mm3(state, bleb);
                state.blebs[bleb] = state::Bleb { volume_mm3, pressure_pa: 0.0, ..state.blebs[bleb] };
                self.body.counts.disabled.add(1, self.blebs.nodes_of(bleb)[0] as usize);
            }
        }
        state.account.leaked_mm3 = state.account.injected_mm3 - state.under_mm3();
    }

    /// After triangles have gone: what hung on them sinks to the choroid, and the fluid that was
    /// under it is lost.
    fn after_loss(&mut self, state: &mut RetinaState) {
        for bleb in 0..self.blebs.count() {
            let dead = |n: &u32| state.sheet.flag[*n as usize] == NODE_DEAD;
            if !self.blebs.nodes_of(bleb).iter().any(dead) {
                continue;
            }
            let before = self.measured_mm3(state, bleb);
            for &n in self.blebs.nodes_of(bleb) {
                if state.sheet.flag[n as usize] == NODE_DEAD {
                    front::lay(&mut state.sheet, n, self.figures.radius_mm);
                }
            }
            let lost = before - self.measured_mm3(state, bleb);
            state.leak(bleb, lost);
        }
        self.reconnect(state);
    }
}
