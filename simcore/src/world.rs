//! The world and its step: a pure function of the previous state and of a tracker
//! frame, handle and pedal states. No clock, no randomness, no order of threads enters the result.

mod audit;
mod bodies;
mod dose;
mod plan;
mod profile;
mod removed;
mod retina;
mod sheet_events;
mod sheets;
mod snapshot;
mod stain;
mod task;
mod tools;
mod touch;
mod vitreous;

pub use plan::start_instrument;
pub use removed::RemovedTissue;
pub use snapshot::WorldSnapshot;

use profile::StepTimer;
use sheets::SheetsCounts;

use crate::bodies::solve::StoppedBodies;
use crate::bodies::state::BodiesState;
use crate::checkpoint::{self, CheckpointError};
use crate::constants::{MAX_MARKS, NOTICE_NS};
use crate::dose::{DoseState, LightDose};
use crate::event_log::EventLog;
use crate::microscope;
use crate::state::State;
use crate::ticks::TickState;
use crate::tools::{ToolFigures, ToolsState};
use collision::backend::{Backend, BackendChoice};
use collision::instrument_image::{InstrumentImage, Volume};
use collision::surface::CollisionError;
use nalgebra::Isometry3;
use protocol::events::{Event, EventDraft, EventKind};
use protocol::limits::{BODIES, INSTRUMENTS, MAX_SCENE_BYTES};
use protocol::message::fnv1a;
use protocol::phases::{Phase, PhaseClock};
use protocol::poses::TrackerFrame;
use protocol::steps::{InputsDigest, StepInput, StepProfile};
use scene::SceneFile;
use std::sync::LazyLock;
use tissue::retina::Retina;
use tissue::sheet::adhesion::Adhesion;
use tissue::sheet::body::{SheetBody, SheetError};
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::stain::StainState;
use tissue::vitreous::Vitreous;

/// Why a scene cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// The collision volume or the mesh cannot be used.
    #[error("contact: {0}")]
    Collision(#[from] CollisionError),
    /// The membrane cannot be simulated.
    #[error("membrane{0}")]
    Membrane(SheetError),
    /// The retina cannot be simulated.
    #[error("retina{0}")]
    Retina(SheetError),
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
}

/// The mesh of a membrane that is not there.
static NO_MESH: LazyLock<SheetMesh> = LazyLock::new(SheetMesh::default);

/// What one step did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepReport {
    /// Time by which the state advanced, ns.
    pub advanced_ns: u64,
    /// Hash of the state after the step.
    pub state_hash: u64,
    /// What it consumed.
    pub inputs: InputsDigest,
    /// Time spent in each phase, if a clock was lent; never part of the result.
    pub profile: StepProfile,
}

/// The eye, the instruments, and the work space of a step.
#[derive(Debug)]
pub struct World {
    scene: SceneFile,
    fingerprint: u64,
    state: State,
    /// The membrane, where the scene has one.
    membrane: Option<SheetBody>,
    /// The whole retina as tissue, where the scene has it.
    retina: Option<Retina>,
    volume: Volume,
    /// Shapes of the rigid bodies and the instruments, where there are some.
    bodies: Option<bodies::Bodies>,
    images: [InstrumentImage; INSTRUMENTS],
    /// Figures of the scene's tools.
    figures: ToolFigures,
    log: EventLog,
    /// The vitreous, where there is one.
    vitreous: Option<Vitreous>,
    /// The task, where the scene has one.
    task: Option<task::TaskPart>,
    /// Room for the dye, until the first jet reaches the membrane.
    no_stain: Option<StainState>,
    /// The retina's cells in which light is counted.
    light_dose: LightDose,
}

impl World {
    /// The world of a scene, before its first step.
    ///
    /// # Errors
    /// [`WorldError`] for a scene whose tissue, bodies or collision volume cannot be simulated.
    pub fn new(scene: &SceneFile) -> Result<Self, WorldError> {
        let membrane = SheetBody::membrane(scene).map_err(WorldError::Membrane)?;
        let (retina, retina_state) = Retina::new(scene).map_err(WorldError::Retina)?.unzip();
        let vitreous = Vitreous::new(scene);
        let mesh = membrane.as_ref().map_or(&*NO_MESH, |membrane| &membrane.mesh);
        let adheres = membrane.as_ref().is_some_and(|membrane| membrane.adhesion().is_some());
        let retina_mesh = retina.as_ref().map(|retina: &Retina| &retina.body.mesh);
        let bytes = crate::scene_block::bytes_needed(mesh, adheres, vitreous.as_ref(), retina_mesh);
        if bytes > MAX_SCENE_BYTES {
            return Err(WorldError::TooLarge { nodes: mesh.nodes(), bytes, room: MAX_SCENE_BYTES });
        }
        let mut state = State { retina: retina_state, ..start_state(scene, membrane.as_ref()) };
        state.vitreous = vitreous.as_ref().map(Vitreous::start);
        let volume = Volume::new(&scene.contact);
        volume.check()?;
        let figures = ToolFigures::new(scene);
        let image = |i: usize| {
            let instrument = &scene.instruments[i];
            let radius = [instrument.shaft_radius_mm, figures.needle.radius_mm];
            InstrumentImage::with_needle(instrument.tool, radius, &volume)
        };
        let task = task::TaskPart::of(scene).map(|part| part.with_gel(vitreous.as_ref()));
        let mut world = World {
            fingerprint: fnv1a(scene.without_script().to_toml().as_bytes()),
            retina,
            volume,
            bodies: bodies::Bodies::new(scene)?,
            images: std::array::from_fn(image),
            figures,
            log: EventLog::default(),
            vitreous,
            task,
            no_stain: stain::room(scene, mesh),
            light_dose: LightDose::new(scene.eye.retina_radius_mm),
            scene: scene.clone(),
            membrane,
            state,
        };
        world.resume();
        Ok(world)
    }

    /// The same world without the data that only pictures need, for runs that draw none. It
    /// changes no state.
    pub fn unseen(mut self) -> Self {
        if let Some(gel) = &mut self.vitreous {
            gel.leave_unseen();
        }
        self
    }

    /// Chooses the back end for collisions with the membrane; `None` without a membrane. It changes
    /// no result.
    pub fn choose_collision(
        &mut self,
        wanted: Backend,
        clock: &mut dyn FnMut() -> u64,
    ) -> Option<BackendChoice> {
        let membrane = self.membrane.as_mut()?;
        let instrument = &self.scene.instruments[0];
        let mut image = InstrumentImage::new(instrument.tool, instrument.shaft_radius_mm, &self.volume);
        image.prepare(0.0, &self.volume);
        Some(membrane.choose_collision(&self.state.membrane, wanted, &image, clock))
    }

    /// Advances to the exposure of the frame. `clock` gives nanoseconds for the report's profile
    /// and nothing else; [`no_clock`] will do.
    pub fn step(&mut self, input: &StepInput, mut clock: &mut dyn FnMut() -> u64) -> StepReport {
        self.step_in_phases(input, &mut clock)
    }

    /// As [`World::step`], by a clock that takes note of each phase too.
    pub fn step_in_phases(&mut self, input: &StepInput, clock: &mut impl PhaseClock) -> StepReport {
        let mut timer = StepTimer::start(clock);
        let mut sheets = self.begin_step(input.frame);
        self.apply_handles(input.handles);
        self.apply_pedals(input.pedals);
        self.apply_infusion();
        let plan = self.plan(input.frame);
        let mut stopped = StoppedBodies::default();
        for k in 1..=plan.substeps {
            let poses = self.move_instruments(&plan, k);
            timer.lap(Phase::Misc);
            let tools = self.place_tools(&plan, &poses);
            self.apply_suction(&tools, &poses);
            self.use_forceps(&plan, &poses, k);
            timer.lap(Phase::Tools);
            sheets.merge(&self.move_sheets(&poses, &tools));
            timer.lap(Phase::Tissue);
            stopped.add(self.move_bodies(&plan, &poses, k));
            timer.lap(Phase::Bodies);
            self.state.substeps += 1;
            self.touch_retina(&plan);
            sheets.merge(&self.push_sheets(&plan, &poses, &tools));
            timer.lap(Phase::Collision);
        }
        self.move_vitreous(&plan);
        timer.lap(Phase::Vitreous);
        self.stain_membrane(&plan);
        self.accumulate_light_dose(&plan);
        timer.lap(Phase::Tools);
        self.emit_stopped(stopped);
        self.end_sheets(&plan, sheets);
        timer.lap(Phase::Tissue);
        self.end_task(&plan, input.frame);
        timer.lap(Phase::Task);
        self.end_step(&plan);
        timer.lap(Phase::Misc);
        let state_hash = checkpoint::state_hash(&self.state);
        let inputs = checkpoint::inputs_digest(input);
        timer.lap(Phase::Hash);
        StepReport { advanced_ns: plan.advance_ns, state_hash, inputs, profile: timer.profile() }
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

    /// The membrane's connections; none where the scene has no membrane.
    pub fn sheet(&self) -> &SheetMesh {
        self.membrane.as_ref().map_or(&*NO_MESH, |membrane| &membrane.mesh)
    }

    /// The membrane, where the scene has one.
    pub fn membrane(&self) -> Option<&SheetBody> {
        self.membrane.as_ref()
    }

    /// Bonds of the membrane, where the scene has some.
    pub fn adhesion(&self) -> Option<&Adhesion> {
        self.membrane.as_ref()?.adhesion()
    }

    /// The scene.
    pub fn scene(&self) -> &SceneFile {
        &self.scene
    }

    /// Writes the state into `out`, whose memory is used again.
    ///
    /// # Errors
    /// [`CheckpointError`] when the state cannot be encoded.
    pub fn save(&self, out: &mut Vec<u8>) -> Result<(), CheckpointError> {
        checkpoint::encode(&self.state, self.fingerprint, out)
    }

    /// Goes on from a saved state of the same scene.
    ///
    /// # Errors
    /// [`CheckpointError`] for bytes that are damaged or belong to another scene; nothing changes
    /// then.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CheckpointError> {
        let state = checkpoint::decode(bytes, self.fingerprint)?;
        self.check_sheets(&state)?;
        self.check_vitreous(&state)?;
        BodiesState::check(state.bodies.as_ref(), self.scene.bodies.as_ref())?;
        self.check_task(&state)?;
        self.take_state(state);
        self.resume();
        Ok(())
    }

    /// Forgets the past: the scene as it was at the start.
    pub fn reset(&mut self) {
        let retina = self.retina.as_ref().map(Retina::start);
        self.state = State { retina, ..start_state(&self.scene, self.membrane.as_ref()) };
        self.state.vitreous = self.vitreous.as_ref().map(Vitreous::start);
        for (image, instrument) in self.images.iter_mut().zip(&self.scene.instruments) {
            image.set_tool(instrument.tool, &self.volume);
        }
        self.resume();
    }

    /// Derives everything from a state that was not reached by steps.
    fn resume(&mut self) {
        self.resume_sheets();
        self.refresh_vitreous();
    }

    /// Of that, all but the vitreous.
    fn resume_sheets(&mut self) {
        self.no_stain = stain::room(&self.scene, self.sheet());
        if let Some(membrane) = &mut self.membrane {
            membrane.resume(&mut self.state.membrane);
        }
        if let (Some(model), Some(retina)) = (&mut self.retina, &mut self.state.retina) {
            model.resume(retina);
        }
    }

    /// Begins the step's events and its account of the sheets, which is empty but for what there
    /// was before.
    fn begin_step(&mut self, frame: &TrackerFrame) -> SheetsCounts {
        self.log.begin(self.state.next_event, frame.field, frame.instants.exposed);
        let mut splits = 1;
        if let Some(membrane) = &mut self.membrane {
            membrane.begin_step(&self.state.membrane);
            splits = membrane.splits();
        }
        if let (Some(model), Some(retina)) = (&mut self.retina, &self.state.retina) {
            model.begin_step(retina);
            splits = splits.max(model.body.splits());
        }
        if self.state.step == 0 && splits > 1 {
            let parts = f64::from(splits);
            self.log.emit(EventDraft::new(EventKind::TimeStepSplit, parts));
        }
        let bonds = self.state.membrane.adhesion.as_ref();
        SheetsCounts { freed_before_mm2: bonds.map_or(0.0, |b| b.freed_mm2), ..Default::default() }
    }

    fn end_step(&mut self, plan: &plan::StepPlan) {
        let state = &mut self.state;
        for (i, instrument) in state.instruments.iter().enumerate() {
            // An interrupted path starts again here: an instrument that jumped or was not seen drags nothing.
            if plan.ticks() > 0 || !plan.touches[i] {
                state.ticks.from[i] = instrument.eye_from_instrument;
            }
        }
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

fn start_state(scene: &SceneFile, membrane: Option<&SheetBody>) -> State {
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
        membrane: membrane.map_or_else(|| NO_MESH.start(), SheetBody::start),
        bodies: scene.bodies.as_ref().map(BodiesState::start),
        vitreous: None,
        microscope: microscope::start(scene),
        optics: microscope::start_optics(scene),
        stain: None,
        ticks: TickState::default(),
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
