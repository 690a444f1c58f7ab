//! The world and its step: a pure function of the previous state and of what a tracker frame, the
//! handles and the pedal say. No clock, no randomness, no order of threads enters the result.

mod audit;
mod bodies;
mod dose;
mod membrane;
mod peel;
mod plan;
mod removed;
mod retina;
mod stain;
mod task;
mod tools;
mod touch;
mod vitreous;

pub use plan::start_instrument;
pub use removed::RemovedTissue;

use crate::bodies::state::BodiesState;
use crate::checkpoint::{self, CheckpointError};
use crate::constants::{COLLISION_EVERY, MAX_MARKS, NOTICE_NS};
use crate::dose::{DoseState, LitRetina};
use crate::event_log::{EventLog, Happening};
use crate::microscope;
use crate::state::State;
use crate::tools::{ToolFigures, ToolsState};
use collision::backend::{self, Backend, BackendChoice};
use collision::instrument_image::{InstrumentImage, Volume};
use collision::surface::CollisionError;
use collision::zcoll::Zcoll;
use nalgebra::Isometry3;
use protocol::events::{Event, EventKind};
use protocol::handles::Tool;
use protocol::limits::{BODIES, INSTRUMENTS, MAX_SCENE_BYTES};
use protocol::message::fnv1a;
use protocol::poses::TrackerFrame;
use protocol::steps::{StepInput, StepTimes};
use scene::SceneFile;
use tissue::constants::MAX_HELD;
use tissue::cutting::Cutting;
use tissue::guard::LastGood;
use tissue::membrane::adhesion::Adhesion;
use tissue::membrane::curl::Curl;
use tissue::membrane::implicit::Implicit;
use tissue::membrane::mesh::MeshError;
use tissue::membrane::sheet::Sheet;
use tissue::membrane::solver::Solver;
use tissue::membrane::stain::StainState;
use tissue::membrane::tissue::{Tissue, Unstable};
use tissue::retina::{Retina, RetinaError};
use tissue::vitrector::Port;
use tissue::vitreous::Vitreous;

/// Why a scene cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// The collision volume or the mesh cannot be used.
    #[error("contact: {0}")]
    Collision(#[from] CollisionError),
    /// The membrane's own mesh cannot be a sheet.
    #[error("membrane.mesh: {0}")]
    Mesh(#[from] MeshError),
    /// The retina cannot be simulated.
    #[error("retina: {0}")]
    Retina(#[from] RetinaError),
    /// The tissue is too stiff for its time step.
    #[error(transparent)]
    Unstable(#[from] Unstable),
    /// The mesh does not fit the block that carries it to the renderer.
    #[error(
        "membrane of {nodes} nodes: the scene block would take {bytes} bytes, there is room for {room}; \
         make membrane.squares or membrane.mesh coarser"
    )]
    TooLarge {
        /// Nodes asked for.
        nodes: usize,
        /// Bytes it would take.
        bytes: usize,
        /// Bytes there are.
        room: usize,
    },
    /// The glue is too stiff for the nodes' mass and the substep.
    #[error(
        "membrane.node_mass_g: expected at least {least_g:.3} g for glue of {stiffness_un_per_mm:.0} µN/mm a node, \
         found {found_g}; or give membrane.adhesion a longer range_mm"
    )]
    Glue {
        /// Stiffness of the stiffest bond, µN/mm.
        stiffness_un_per_mm: f64,
        /// Mass that would do, g.
        least_g: f64,
        /// Mass there is, g.
        found_g: f64,
    },
}

/// What one step did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepReport {
    /// Time by which the state advanced, ns.
    pub advanced_ns: u64,
    /// Hash of the state after the step.
    pub state_hash: u64,
    /// Time spent, if a clock was lent; never part of the result.
    pub times: StepTimes,
}

/// The eye, the instruments, and the work space of a step.
#[derive(Debug)]
pub struct World {
    scene: SceneFile,
    fingerprint: u64,
    sheet: Sheet,
    tissue: Tissue,
    /// Parts of a substep that its stability needs.
    splits: u32,
    state: State,
    solver: Solver,
    adhesion: Option<Adhesion>,
    curl: Option<Curl>,
    /// What makes the substeps where the scene asks for more than the explicit core.
    implicit: Option<Implicit>,
    volume: Volume,
    /// Shapes of the rigid bodies and the instruments, where there are some.
    bodies: Option<bodies::Bodies>,
    /// Collision images of the membrane, where there is one.
    zcoll: Option<Zcoll>,
    images: [InstrumentImage; INSTRUMENTS],
    /// What the scene says of its tools.
    figures: ToolFigures,
    /// The port's camera and the membrane's areas, where there is a membrane.
    cutting: Option<Cutting>,
    /// Where vitrectors and needles are in this substep.
    aimed: tools::Aimed,
    last_good: LastGood,
    log: EventLog,
    /// What happened to the membrane in this step, for its events.
    toll: membrane::Toll,
    /// The whole retina as tissue, where the scene has it.
    retina: Option<retina::RetinaPart>,
    /// The vitreous, where there is one.
    vitreous: Option<Vitreous>,
    /// Ports that sucked at the vitreous in this step: substeps open, and the last of them.
    sucking: [Option<(u32, Port)>; INSTRUMENTS],
    /// What happened to the glue in this step, for its events.
    parting: peel::StepParting,
    /// What the trainee is asked to do, where the scene says so.
    task: Option<task::TaskPart>,
    /// Room for the dye, until the first jet reaches the membrane.
    no_stain: Option<StainState>,
    /// The retina's cells in which light is counted.
    lit_retina: LitRetina,
}

impl World {
    /// The world of a scene, before its first step.
    pub fn new(scene: &SceneFile) -> Result<Self, WorldError> {
        let sheet = Sheet::new(scene)?;
        let (model, retina) = Retina::new(scene)?.unzip();
        let vitreous = Vitreous::new(scene);
        let retina_sheet = model.as_ref().map(|m| &m.sheet);
        let glued = scene.membrane.as_ref().is_some_and(|m| m.adhesion.is_some());
        let bytes = crate::scene_block::bytes_needed(&sheet, glued, vitreous.as_ref(), retina_sheet);
        if bytes > MAX_SCENE_BYTES {
            return Err(WorldError::TooLarge { nodes: sheet.nodes(), bytes, room: MAX_SCENE_BYTES });
        }
        let adhesion = peel::adhesion(scene, &sheet)?;
        let integrator = scene.membrane.as_ref().map_or_else(Default::default, |m| m.integrator);
        let mut tissue = Tissue::new(scene);
        let implicit = Implicit::of(integrator, &sheet, &tissue);
        let mut solver = Solver::new(&sheet);
        if implicit.is_some() {
            solver.look_ahead();
        }
        let splits = if implicit.is_some() { 1 } else { tissue.split(&sheet)? };
        let mut state = State { retina, ..start_state(scene, &sheet, &tissue, adhesion.as_ref()) };
        state.vitreous = vitreous.as_ref().map(Vitreous::start);
        let volume = Volume::new(&scene.contact);
        volume.check()?;
        let zcoll = || Zcoll::new(volume, &sheet.triangles, sheet.nodes());
        let zcoll = scene.membrane.is_some().then(zcoll).transpose()?;
        let retina = model
            .map(|m| retina::RetinaPart::new(m, volume, &ToolFigures::new(scene).vitrector))
            .transpose()?;
        let figures = ToolFigures::new(scene);
        let cutting = || Cutting::new(&figures.vitrector, &sheet);
        let cutting = scene.membrane.is_some().then(cutting).transpose()?;
        let image = |i: usize| {
            let instrument = &scene.instruments[i];
            let radius = [instrument.shaft_radius_mm, figures.needle.radius_mm];
            InstrumentImage::with_needle(instrument.tool, radius, &volume)
        };
        let task = task::TaskPart::of(scene).map(|part| part.with_gel(vitreous.as_ref()));
        let mut world = World {
            fingerprint: fnv1a(scene.without_script().to_toml().as_bytes()),
            tissue,
            splits,
            solver,
            adhesion,
            curl: peel::curl(scene, &sheet),
            implicit,
            volume,
            bodies: bodies::Bodies::new(scene)?,
            zcoll,
            images: std::array::from_fn(image),
            figures,
            cutting,
            aimed: tools::Aimed::default(),
            last_good: LastGood::new(&state.membrane),
            log: EventLog::default(),
            toll: membrane::Toll::default(),
            retina,
            vitreous,
            sucking: Default::default(),
            parting: peel::StepParting::default(),
            task,
            no_stain: stain::room(scene, &sheet),
            lit_retina: LitRetina::new(scene.eye.retina_radius_mm),
            scene: scene.clone(),
            sheet,
            state,
        };
        world.refresh();
        Ok(world)
    }

    /// The same world, of which nobody will draw a picture: what only pictures need is left out. It changes no state.
    pub fn unseen(mut self) -> Self {
        if let Some(gel) = &mut self.vitreous {
            gel.leave_unseen();
        }
        self
    }

    /// Chooses who looks for collisions with the membrane; `None` where there is none. It changes no result.
    pub fn choose_collision(
        &mut self,
        wanted: Backend,
        clock: &mut dyn FnMut() -> u64,
    ) -> Option<BackendChoice> {
        let zcoll = self.zcoll.as_mut()?;
        let instrument = &self.scene.instruments[0];
        let mut image = InstrumentImage::new(instrument.tool, instrument.shaft_radius_mm, &self.volume);
        image.prepare(0.0, &self.volume);
        let surface = self.state.membrane.surface(&self.sheet);
        Some(backend::choose_backend(zcoll, wanted, &image, &surface, clock))
    }

    /// Advances to the exposure of the frame. `clock` gives nanoseconds for the report's times and
    /// nothing else; [`no_clock`] will do.
    pub fn step(&mut self, input: &StepInput, clock: &mut dyn FnMut() -> u64) -> StepReport {
        let begin = clock();
        let mut times = StepTimes::default();
        self.begin_step(input.frame);
        self.take_handles(input.handles);
        self.take_pedals(input.pedals);
        self.exchange_air();
        let plan = self.plan(input.frame);
        for k in 1..=plan.substeps {
            let poses = self.move_instruments(&plan, k);
            self.note_ways(&poses);
            let tissue_begin = clock();
            self.aim_tools(&plan, &poses);
            self.use_ports();
            self.move_tissue(&plan, &poses);
            self.use_forceps(&plan, &poses, k);
            self.move_bodies(&plan, &poses, k);
            self.move_retina(&plan, &poses, k);
            self.cut_membrane(&poses);
            let tissue_end = clock();
            times.tissue_ns += tissue_end.saturating_sub(tissue_begin);
            self.state.substeps += 1;
            self.touch_retina(&plan);
            if self.state.substeps.is_multiple_of(COLLISION_EVERY) {
                self.push_membrane(&plan, &poses);
                self.push_retina(&plan, &poses);
                times.collision_ns += clock().saturating_sub(tissue_end);
            }
        }
        let gel_begin = clock();
        self.move_vitreous(&plan);
        times.tissue_ns += clock().saturating_sub(gel_begin);
        self.tell_toll();
        self.tell_cuts();
        self.tell_peel();
        self.stain_membrane(&plan);
        self.shine(&plan);
        self.tell_stopped();
        self.check_finite();
        self.end_retina();
        self.end_task(input.frame);
        self.end_step(&plan);
        let state_hash = checkpoint::state_hash(&self.state);
        let all = clock().saturating_sub(begin);
        times.misc_ns = all.saturating_sub(times.tissue_ns + times.collision_ns);
        StepReport { advanced_ns: plan.advance_ns, state_hash, times }
    }

    /// Events of the last step.
    pub fn events(&self) -> &[Event] {
        self.log.events()
    }

    /// Events left out since the start, because one step had too many.
    pub fn events_left_out(&self) -> u64 {
        self.log.left_out()
    }

    /// The state.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Hash of the state.
    pub fn state_hash(&self) -> u64 {
        checkpoint::state_hash(&self.state)
    }

    /// The membrane's connections.
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// The scene.
    pub fn scene(&self) -> &SceneFile {
        &self.scene
    }

    /// Writes the state into `out`, whose memory is used again.
    pub fn save(&self, out: &mut Vec<u8>) -> Result<(), CheckpointError> {
        checkpoint::encode(&self.state, self.fingerprint, out)
    }

    /// Goes on from a saved state of the same scene; on an error nothing changes.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CheckpointError> {
        let state = checkpoint::decode(bytes, self.fingerprint, &self.sheet)?;
        self.check_retina(&state).map_err(CheckpointError::Content)?;
        self.check_vitreous(&state)?;
        peel::check(self.adhesion.as_ref(), state.adhesion.as_ref())?;
        BodiesState::check(state.bodies.as_ref(), self.scene.bodies.as_ref())?;
        self.check_task(&state)?;
        self.state = state;
        self.no_stain = stain::room(&self.scene, &self.sheet);
        for instrument in &mut self.state.instruments {
            instrument.held.reserve_exact(MAX_HELD - instrument.held.len());
        }
        self.state.marks.reserve_exact(MAX_MARKS - self.state.marks.len());
        self.last_good.remember(&self.state.membrane);
        for (image, instrument) in self.images.iter_mut().zip(&self.state.instruments) {
            if let Some(tool) = Tool::from_wire(instrument.tool) {
                image.set_tool(tool, &self.volume);
            }
        }
        self.refresh();
        self.refind_retina();
        self.refresh_vitreous();
        Ok(())
    }

    /// Forgets the past: the scene as it was at the start.
    pub fn reset(&mut self) {
        let retina = self.retina.as_ref().map(|part| part.model.start());
        self.state =
            State { retina, ..start_state(&self.scene, &self.sheet, &self.tissue, self.adhesion.as_ref()) };
        self.state.vitreous = self.vitreous.as_ref().map(Vitreous::start);
        self.no_stain = stain::room(&self.scene, &self.sheet);
        self.last_good.remember(&self.state.membrane);
        for (image, instrument) in self.images.iter_mut().zip(&self.scene.instruments) {
            image.set_tool(instrument.tool, &self.volume);
        }
        self.refresh();
        self.refind_retina();
        self.refresh_vitreous();
    }

    /// Derives the solver's figures from the living springs and the flags.
    fn refresh(&mut self) {
        self.solver.refresh(&self.sheet, &self.state.membrane, &self.tissue);
        if let Some(implicit) = &mut self.implicit {
            implicit.refresh(&self.sheet, &self.state.membrane, &self.tissue);
        }
    }

    fn begin_step(&mut self, frame: &TrackerFrame) {
        self.log.begin(self.state.next_event, frame.field, frame.instants.exposed);
        self.toll = membrane::Toll::default();
        self.sucking = Default::default();
        self.parting = peel::StepParting::default();
        self.last_good.remember(&self.state.membrane);
        self.begin_retina();
        let retina_splits = self.retina.as_ref().map_or(1, |part| part.model.splits());
        let splits = self.splits.max(retina_splits);
        if self.state.step == 0 && splits > 1 {
            let parts = f64::from(splits);
            self.log.raise(Happening::new(EventKind::TimeStepSplit, parts));
        }
    }

    fn end_step(&mut self, plan: &plan::Plan) {
        let state = &mut self.state;
        microscope::advance(&mut state.microscope, &state.optics, plan.advance_ns as f64 * 1e-9);
        if self.log.warning() != 0 {
            state.notice_kind = self.log.warning();
            state.notice_until_ns = state.exposed_ns + NOTICE_NS;
        } else if state.exposed_ns > state.notice_until_ns {
            state.notice_kind = 0;
        }
        state.next_event = self.log.next_seq();
        state.step += 1;
    }
}

/// A clock that stands still.
pub fn no_clock() -> u64 {
    0
}

fn start_state(scene: &SceneFile, sheet: &Sheet, tissue: &Tissue, adhesion: Option<&Adhesion>) -> State {
    let mut membrane = peel::start_membrane(sheet, adhesion);
    if tissue.is_plastic() {
        membrane.rest_mm.clone_from(&sheet.rest_mm);
    }
    State {
        step: 0,
        field: 0,
        frame: 0,
        exposed_ns: 0,
        remainder_ns: 0,
        substeps: 0,
        handles_below: 0,
        pedals_below: 0,
        next_event: 0,
        refused: 0,
        world_from_eye: Isometry3::identity(),
        tracking: [Default::default(); BODIES],
        instruments: std::array::from_fn(|i| start_instrument(scene.instruments[i].tool)),
        membrane,
        bodies: scene.bodies.as_ref().map(BodiesState::start),
        adhesion: adhesion.map(Adhesion::start),
        vitreous: None,
        microscope: microscope::start(scene),
        optics: microscope::start_optics(scene),
        stain: None,
        dose: DoseState::start(),
        tools: ToolsState::default(),
        marks: Vec::with_capacity(MAX_MARKS),
        notice_kind: 0,
        notice_until_ns: 0,
        retina: None,
        task: task::start(scene),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgeon::rehearsal::Rehearsal;

    #[test]
    fn an_eye_without_a_membrane_runs() {
        let mut scene = SceneFile::load("peel").unwrap();
        scene.membrane = None;
        let scene = SceneFile::parse(&scene.to_toml(), "bare").unwrap();
        let mut world = World::new(&scene).unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        (0..500).for_each(|field| {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        });
        assert_eq!((world.state().step, world.sheet().nodes()), (500, 0));
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        let hash = world.state_hash();
        world.reset();
        world.restore(&bytes).unwrap();
        assert_eq!(world.state_hash(), hash);
    }
}
