//! A sheet of soft tissue with everything that acts on it: the membrane is one, the retina another.
//!
//! ```text
//! jaws ──▶ outer forces ──────────▶ advance ────────────────────────▶ push
//! grasp     adhesion, curl,          forces, tearing, creep, motion,   collider
//!           suction and cutting      strain limit, rim
//! ```
//!
//! What a sheet is made of follows from its scene: springs alone, elements, an implicit integrator,
//! bonds to the retina, a rim that comes off. The state is apart, in a [`SheetState`]; everything
//! here follows from scene and state.

use super::adhesion::Adhesion;
use super::collider::{Collider, Contact};
use super::curl::{Curl, stiffest_un_per_mm};
use super::cutter::SheetCutter;
use super::from_triangles::MeshError;
use super::grasp;
use super::guard::{self, LastGood};
use super::implicit::Implicit;
use super::material::{Material, Unstable};
use super::mesh::SheetMesh;
use super::solver::Solver;
use super::state::{NODE_PINNED, SheetState};
use super::step_counts::SheetCounts;
use super::strain_limit::limit_strain;
use super::tearing;
use crate::constants::{STRAIN_SWEEPS, SUBSTEP_S};
use crate::vitrector::Port;
use collision::instrument_image::Volume;
use collision::surface::{CollisionError, Surface};
use nalgebra::Isometry3;
use protocol::limits::INSTRUMENTS;
use protocol::scene::{NODE_DEAD, NODE_FREE};
use scene::SceneFile;
use std::ops::Range;

/// Why a scene's sheet cannot be simulated. The text follows on the name of the scene's table.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SheetError {
    /// Its mesh cannot be built.
    #[error(".mesh: {0}")]
    Mesh(#[from] MeshError),
    /// Its springs are too stiff for their mass.
    #[error(": {0}")]
    Unstable(#[from] Unstable),
    /// The collision images cannot hold it.
    #[error(": contact: {0}")]
    Collision(#[from] CollisionError),
    /// Its adhesion is too stiff for the nodes' mass and the substep.
    #[error(
        ".node_mass_g: expected at least {least_g:.3} g for adhesion of {stiffness_un_per_mm:.0} µN/mm a node, \
         found {found_g}; or give its adhesion a longer range_mm"
    )]
    Adhesion {
        /// Stiffness of the stiffest bond, µN/mm.
        stiffness_un_per_mm: f64,
        /// Mass that would do, g.
        least_g: f64,
        /// Mass there is, g.
        found_g: f64,
    },
}

/// A sheet's figures and the work space of a step.
#[derive(Debug)]
pub struct SheetBody {
    /// Connections.
    pub mesh: SheetMesh,
    /// Forces of springs and of everything outside.
    pub solver: Solver,
    /// What happened since it was last taken.
    pub(crate) counts: SheetCounts,
    pub(super) material: Material,
    /// Parts into which a substep is split for stability.
    splits: u32,
    /// What makes the substeps where the scene asks for more than the explicit core.
    implicit: Option<Implicit>,
    adhesion: Option<Adhesion>,
    curl: Option<Curl>,
    /// Force at which a pinned node comes off, µN; infinite where pins hold for ever.
    rim_tear_un: f64,
    pub(super) collider: Collider,
    cutter: SheetCutter,
    last_good: LastGood,
    /// Outer forces act in this substep, or did in the last one.
    drawn: bool,
}

impl SheetBody {
    /// The membrane of a scene, where it has one.
    ///
    /// # Errors
    /// If its mesh, its stiffness or its adhesion cannot be simulated.
    pub fn membrane(scene: &SceneFile) -> Result<Option<Self>, SheetError> {
        let Some(membrane) = &scene.membrane else { return Ok(None) };
        let (mesh, material) = (SheetMesh::new(scene)?, Material::new(scene));
        let bonds = membrane.adhesion.as_ref();
        let adhesion = bonds.map(|bonds| Adhesion::new(&mesh, bonds, scene.eye.retina_radius_mm));
        if let Some(adhesion) = &adhesion {
            check_mass(adhesion, membrane.node_mass_g)?;
        }
        let most_un_per_mm = stiffest_un_per_mm(membrane.node_mass_g, SUBSTEP_S);
        let curl = membrane.curl.as_ref().map(|curl| Curl::new(&mesh, curl, most_un_per_mm));
        let implicit = Implicit::of(membrane.integrator, &mesh, &material);
        let body = Self::build(scene, mesh, material, implicit, Contact::membrane(scene))?;
        Ok(Some(SheetBody { adhesion, curl, rim_tear_un: membrane.rim_tear_un, ..body }))
    }

    /// A sheet of springs that lies on the choroid and holds there: nothing acts on what is pinned,
    /// and pins hold for ever.
    ///
    /// # Errors
    /// If its stiffness or its mesh cannot be simulated.
    pub fn on_choroid(
        scene: &SceneFile,
        mesh: SheetMesh,
        material: Material,
        contact: Contact,
    ) -> Result<Self, SheetError> {
        let body = Self::build(scene, mesh, material, None, contact)?;
        Ok(SheetBody { solver: Solver::new(&body.mesh).without_pinned(), ..body })
    }

    fn build(
        scene: &SceneFile,
        mesh: SheetMesh,
        mut material: Material,
        implicit: Option<Implicit>,
        contact: Contact,
    ) -> Result<Self, SheetError> {
        let splits = if implicit.is_some() { 1 } else { material.split(&mesh)? };
        let mut solver = Solver::new(&mesh);
        if implicit.is_some() {
            solver.look_ahead();
        }
        Ok(SheetBody {
            splits,
            implicit,
            solver,
            counts: SheetCounts::default(),
            adhesion: None,
            curl: None,
            rim_tear_un: f64::INFINITY,
            collider: Collider::new(Volume::new(&scene.contact), contact, &mesh)?,
            cutter: SheetCutter::new(&scene.vitrector.unwrap_or_default(), &mesh)?,
            last_good: LastGood::new(&mesh.start()),
            drawn: false,
            material,
            mesh,
        })
    }

    /// The sheet before the first step: held by its adhesion where it has some, else by its rim.
    pub fn start(&self) -> SheetState {
        let mut state = self.mesh.start();
        if let Some(adhesion) = &self.adhesion {
            state.flag.fill(NODE_FREE);
            state.adhesion = Some(adhesion.start());
        }
        if self.material.is_plastic() {
            state.rest_mm.clone_from(&self.mesh.rest_mm);
        }
        state
    }

    /// Bonds to the retina, where there are some.
    pub fn adhesion(&self) -> Option<&Adhesion> {
        self.adhesion.as_ref()
    }

    /// The figures by which the sheet moves.
    pub fn material(&self) -> &Material {
        &self.material
    }

    /// Parts into which each substep is split for stability.
    pub fn splits(&self) -> u32 {
        self.splits
    }

    /// Changes the material into what no scene can ask for: for tests of what must hold whatever
    /// happens.
    pub fn spoil(&mut self, state: &SheetState, change: impl FnOnce(&mut Material)) {
        change(&mut self.material);
        self.refresh(state);
    }

    /// What does not fit the mesh, or holds bad numbers.
    ///
    /// # Errors
    /// With the first thing that is wrong.
    pub fn check(&self, state: &SheetState) -> Result<(), &'static str> {
        state.check(&self.mesh)?;
        match (&self.adhesion, &state.adhesion) {
            (Some(adhesion), Some(bonds)) if adhesion.accepts(bonds) => Ok(()),
            (None, None) => Ok(()),
            _ => Err("the sheet's adhesion is not the scene's"),
        }
    }

    /// The area of the broken bonds is the area that was freed.
    ///
    /// # Errors
    /// With both areas where they differ.
    pub fn audit(&self, state: &SheetState) -> Result<(), String> {
        self.check(state)?;
        let (Some(adhesion), Some(bonds)) = (&self.adhesion, &state.adhesion) else { return Ok(()) };
        let (broken, freed) = (adhesion.broken_mm2(bonds), bonds.freed_mm2);
        if (broken - freed).abs() <= 1e-9 * adhesion.bonded_mm2().max(1.0) {
            Ok(())
        } else {
            Err(format!("{freed} mm² were freed, the broken bonds have {broken} mm²"))
        }
    }

    /// Makes everything follow from a state that was not reached by steps: a restored or a fresh
    /// one.
    pub fn resume(&mut self, state: &mut SheetState) {
        state.reserve();
        self.last_good.remember(state);
        self.refresh(state);
    }

    /// Derives the solvers' figures and what instruments meet from the living springs and the
    /// flags.
    pub fn refresh(&mut self, state: &SheetState) {
        self.solver.refresh(&self.mesh, state, &self.material);
        if let Some(implicit) = &mut self.implicit {
            implicit.refresh(&self.mesh, state, &self.material);
        }
        self.collider.refresh(&self.mesh, state);
    }

    /// Begins a step: what goes wrong in it goes back to this state.
    pub fn begin_step(&mut self, state: &SheetState) {
        self.last_good.remember(state);
    }

    /// What happened since the last call; every phase hands it on when it ends.
    pub fn take_counts(&mut self) -> SheetCounts {
        std::mem::take(&mut self.counts)
    }

    /// Sets the outer forces of a substep: adhesion, curl, suction by the open `ports`; the blades
    /// that close in it take away what is in their ports. `true` if triangles have gone.
    pub fn draw(
        &mut self,
        state: &mut SheetState,
        ports: &[Option<Port>; INSTRUMENTS],
        eye_from_instrument: &[Isometry3<f64>; INSTRUMENTS],
    ) -> bool {
        if std::mem::take(&mut self.drawn) {
            self.solver.clear_outer();
        }
        self.pull_bonds(state);
        let mut lost = false;
        for (i, (port, pose)) in ports.iter().zip(eye_from_instrument).enumerate() {
            let acts = |p: &Port| p.cuts || (p.open && p.suction_pa > 0.0);
            let Some(port) = port.filter(acts) else { continue };
            if !self.sees(state, &port, pose) {
                continue;
            }
            if port.open {
                self.cutter.suck(&port, &self.mesh, state, &mut self.solver.outer_un);
                self.drawn = true;
            }
            let cut_um2 = if port.cuts { self.cutter.cut(&port, &self.mesh, state) } else { 0 };
            if cut_um2 > 0 {
                self.counts.cut_um2[i] += cut_um2;
                self.after_loss(state);
                lost = true;
            }
        }
        lost
    }

    fn pull_bonds(&mut self, state: &mut SheetState) {
        let solver = &mut self.solver;
        if let (Some(adhesion), Some(bonds)) = (&self.adhesion, &mut state.adhesion) {
            let (position_mm, flag) = (&state.position_mm, &state.flag[..]);
            let parting = adhesion.pull(position_mm, flag, bonds, solver, SUBSTEP_S as f32);
            self.counts.parting.add(&parting);
            self.drawn = true;
        }
        if let Some(curl) = &mut self.curl {
            let bonds = self.adhesion.as_ref().zip(state.adhesion.as_ref());
            curl.bend(state, bonds, &mut solver.outer_un);
            if self.implicit.is_some() {
                curl.stiffen(state, bonds, &mut solver.outer_un_per_mm);
            }
            self.drawn = true;
        }
    }

    /// True if a port's camera sees something of the sheet.
    fn sees(&mut self, state: &SheetState, port: &Port, eye_from_instrument: &Isometry3<f64>) -> bool {
        self.collider.is_near(state, &port.cone.apex_in_eye_mm, self.cutter.reach_mm())
            && self.cutter.render(eye_from_instrument, &self.collider.surface(&self.mesh, state))
    }

    /// 1 for each triangle that instruments can meet.
    pub fn active(&self) -> &[u8] {
        self.collider.active()
    }

    /// Numbers from the lowest to the highest of a node that instruments can meet.
    pub fn span(&self) -> Range<usize> {
        self.collider.span()
    }

    /// What instruments can meet, for collision queries.
    pub fn surface<'a>(&'a self, state: &'a SheetState) -> Surface<'a> {
        self.collider.surface(&self.mesh, state)
    }

    /// The part of the last look of a port that it saw: triangles.
    pub fn seen_by_port(&self) -> &[u32] {
        self.cutter.seen()
    }

    /// One part of a substep: forces, what they tear, motion. `true` if triangles have gone.
    pub fn advance(&mut self, state: &mut SheetState) -> bool {
        let alarms = self.solver.accelerate(&self.mesh, state, &self.material);
        let mut lost = alarms.not_finite;
        if alarms.not_finite {
            self.contain(state);
        }
        lost |= self.bear_elements(state);
        if alarms.over_acceleration || alarms.over_tension {
            // Accelerations of stiff tissue at the begin of a substep say nothing about its end.
            lost |= self.tear(state, alarms.over_acceleration && self.implicit.is_none());
        }
        if self.material.is_plastic() {
            self.solver.creep(&self.mesh, state, &self.material);
        }
        self.integrate(state);
        self.watch_rim(state);
        lost
    }

    fn integrate(&mut self, state: &mut SheetState) {
        let material = &self.material;
        match &mut self.implicit {
            Some(implicit) => _ = implicit.integrate(state, material, &self.solver),
            None => self.solver.integrate(state, material),
        }
        if material.strain_limit > 0.0 && limit_strain(&self.mesh, state, material, STRAIN_SWEEPS) > 0 {
            self.solver.stay_inside(state, material.radius_mm);
        }
    }

    /// The share of elements that carry the sheet in place of springs: forces for pins and jaws,
    /// and what they tear.
    fn bear_elements(&mut self, state: &mut SheetState) -> bool {
        let Some(implicit) = &mut self.implicit else { return false };
        implicit.bear(state, &mut self.solver, &self.material);
        let Some(&first) = implicit.torn().first() else { return false };
        implicit.torn().iter().for_each(|&t| tearing::remove_triangle(&self.mesh, state, t));
        self.counts.torn.add(implicit.torn().len() as u32, self.mesh.triangles[first][0] as usize);
        self.after_loss(state);
        true
    }

    fn contain(&mut self, state: &mut SheetState) {
        let disabled = &mut self.counts.disabled;
        guard::contain(&self.mesh, state, &mut self.solver, &self.last_good, |node| disabled.add(1, node));
        self.after_loss(state);
    }

    /// Takes nodes with bad numbers out; `true` if there were some.
    pub fn check_finite(&mut self, state: &mut SheetState) -> bool {
        if guard::all_finite(state) {
            return false;
        }
        let disabled = &mut self.counts.disabled;
        guard::disable_bad_nodes(&self.mesh, state, &self.last_good, |node| disabled.add(1, node));
        self.after_loss(state);
        true
    }

    fn tear(&mut self, state: &mut SheetState, over_acceleration: bool) -> bool {
        let (mut torn, mut place) = tearing::tear_by_tension(&self.mesh, state, &self.solver);
        if over_acceleration {
            let a_tear = self.material.a_tear;
            let (more, at) = tearing::tear_by_acceleration(&self.mesh, state, &self.solver, a_tear);
            (torn, place) = (torn + more, if more > 0 { at } else { place });
        }
        self.counts.torn.add(torn, place);
        if torn > 0 {
            self.after_loss(state);
        }
        torn > 0
    }

    /// Tears a spring; `true` if it was alive.
    pub fn tear_spring(&mut self, state: &mut SheetState, spring: usize, node: usize) -> bool {
        let torn = tearing::tear_spring(&self.mesh, state, spring);
        if torn {
            self.counts.torn.add(1, node);
            self.after_loss(state);
        }
        torn
    }

    /// After triangles have gone: the solver and the jaws forget what belonged to them.
    fn after_loss(&mut self, state: &mut SheetState) {
        for (held, lost) in state.held.iter_mut().zip(&mut self.counts.lost_grip) {
            *lost |= grasp::drop_dead(held, &state.flag) && held.is_empty();
        }
        self.refresh(state);
    }

    /// Force on the pinned nodes of the rim: the largest is kept for the warning, too large a one
    /// detaches.
    fn watch_rim(&mut self, state: &mut SheetState) {
        if self.rim_tear_un == f64::INFINITY {
            return;
        }
        let tear2 = (self.rim_tear_un * self.rim_tear_un) as f32;
        let [fx, fy, fz] = &self.solver.force_un;
        let (rim_un, before) = (&mut self.counts.rim_un, self.counts.detached.count);
        for n in self.mesh.rim.iter().map(|&n| n as usize) {
            if state.flag[n] != NODE_PINNED {
                continue;
            }
            let f2 = fx[n] * fx[n] + fy[n] * fy[n] + fz[n] * fz[n];
            if f2 > rim_un.0 * rim_un.0 {
                *rim_un = (f2.sqrt(), n);
            }
            if f2 > tear2 {
                state.flag[n] = NODE_FREE;
                self.counts.detached.add(1, n);
            }
        }
        if self.counts.detached.count > before {
            self.refresh(state);
        }
    }

    /// True if the sheet is off wherever it was held by adhesion.
    pub fn is_off(&self, state: &SheetState) -> bool {
        let (Some(adhesion), Some(bonds)) = (&self.adhesion, &state.adhesion) else { return false };
        (0..state.nodes()).all(|n| state.flag[n] == NODE_DEAD || !adhesion.holds(bonds, n))
    }
}

/// Refuses bonds that an explicit substep cannot carry. They move with the substep whatever the
/// integrator of the springs, and share the bound of [`super::material`] with them: here half of
/// it.
fn check_mass(adhesion: &Adhesion, found_g: f64) -> Result<(), SheetError> {
    let stiffness_un_per_mm = f64::from(adhesion.stiffest_un_per_mm());
    let least_g = 0.5 * SUBSTEP_S * SUBSTEP_S * stiffness_un_per_mm;
    if found_g < least_g {
        return Err(SheetError::Adhesion { stiffness_un_per_mm, least_g, found_g });
    }
    Ok(())
}
