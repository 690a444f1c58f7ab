//! The pipeline of a live run in one process: virtual cameras, assembler, tracker, simulation. It
//! has no transport and no clock, so an attempt takes as long as its arithmetic; every part is that
//! of the live run.

use crate::camera_twin::CameraTwin;
use protocol::handles::HandleState;
use protocol::limits::{FIELD_PERIOD_NS, INSTRUMENTS};
use protocol::poses::TrackerFrame;
use protocol::steps::{StepInput, StepRecord};
use recording::{Item, RecordingError, Writer};
use replay::perception::WorldPerception;
use rig::Rig;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::motion::{MotionSource, MotionUse};
use tracker::assembler::FrameAssembler;
use tracker::tracker::{Tracker, close};
use training::score::Score;
use training::score::recording::is_over;
use virtual_rig::cameras::Path;

/// Exposure of the first field, ns: instants of 0 mean "not yet".
const FIRST_NS: u64 = 1_000_000_000;
/// Fields that a live run lasts after the script's round, while the last frames are in flight.
const AFTER_FIELDS: u64 = 50;

/// Called after every step with the frame, the world, and the hash of its state.
pub type OnStep<'a> = dyn FnMut(&TrackerFrame, &World, u64) + 'a;

/// A scene that is played through cameras and tracker.
pub struct Pipeline {
    cameras: CameraTwin,
    surgeon: MotionSource,
    assembler: FrameAssembler,
    tracker: Tracker,
    world: World,
    next: u64,
}

impl Pipeline {
    /// The scene on the shipped rig. `path`: through drawn fields of pixels, or with markers made
    /// straight into blobs; `hand`: a recorded hand in the place of the tremor; everything random
    /// comes from `seed`.
    ///
    /// # Panics
    /// If the scene cannot be simulated: callers have composed it.
    pub fn new(scene: &SceneFile, path: Path, hand: Option<MotionUse>, seed: u64) -> Self {
        let rig = Rig::load_or_shipped(None).expect("the shipped rig is tested");
        Pipeline {
            cameras: CameraTwin::new(&rig, path, seed, FIRST_NS),
            surgeon: MotionSource::new(scene, &rig, hand, seed),
            assembler: FrameAssembler::new(&rig),
            tracker: Tracker::new(&rig),
            world: World::new(scene).expect("a scene that can be simulated"),
            next: 0,
        }
    }

    /// Fields of the script's round, with what the surgeon has done again so far.
    fn fields(&self) -> u64 {
        (self.surgeon.period_s() * 1e9) as u64 / FIELD_PERIOD_NS
    }

    /// The simulation.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Exposes the next field of every camera and steps the simulation with every frame that is
    /// complete by then.
    pub fn field(&mut self, on_step: &mut OnStep) {
        let Pipeline { cameras, surgeon, assembler, tracker, world, next } = self;
        let number = *next;
        *next += 1;
        let exposed_ns = number * FIELD_PERIOD_NS;
        let motion = surgeon.at(exposed_ns);
        let handles: [HandleState; INSTRUMENTS] = std::array::from_fn(|i| HandleState {
            seq: number * INSTRUMENTS as u64 + i as u64,
            field: number,
            instant_ns: FIRST_NS + exposed_ns,
            instrument: i as u32,
            tool: motion.tool[i] as u32,
            jaw_rad: motion.jaw_rad[i],
        });
        let pedal = [surgeon.pedal_at(exposed_ns, number, FIRST_NS + exposed_ns)];
        let (mut steps, mut now) = (0, 0);
        for i in 0..cameras.count() {
            let field = cameras.blobs(i, surgeon, number);
            now = field.blobs_out_ns.max(now);
            assembler.add(&field, now, |used, closed| {
                let mut frame = tracker.track(used, &closed.reference);
                close(&mut frame, closed.closed_by);
                let new = steps == 0;
                let (handles, pedals) = if new { (&handles[..], &pedal[..]) } else { (&[][..], &[][..]) };
                steps += 1;
                let report = world.step(&StepInput { frame: &frame, handles, pedals }, &mut no_clock);
                on_step(&frame, world, report.state_hash);
            });
        }
        if surgeon.perceives_now(exposed_ns) {
            surgeon.see(exposed_ns, &WorldPerception(world));
        }
    }

    /// Plays one round of the script, or until the attempt at the scene's task is over; its score,
    /// and whether it ended.
    ///
    /// # Panics
    /// If the scene has no task.
    pub fn attempt(mut self, on_step: &mut OnStep) -> Score {
        while self.next < self.fields() + AFTER_FIELDS && !self.world.task().is_some_and(|(_, s)| is_over(s))
        {
            self.field(on_step);
        }
        self.world.score().expect("a module has a task")
    }

    /// The same, recorded as far as a score needs it.
    ///
    /// # Errors
    /// If the recording cannot be written.
    pub fn record(self, mut writer: Writer) -> Result<Score, RecordingError> {
        let (mut step, mut problem) = (0, None);
        let score = self.attempt(&mut |frame, world, state_hash| {
            step += 1;
            let mut record: StepRecord = bytemuck::Zeroable::zeroed();
            (record.step, record.field, record.frame) = (step, frame.field, frame.frame);
            (record.instants, record.state_hash) = (frame.instants, state_hash);
            let at = frame.instants.exposed;
            let items = [Item::Poses(Box::new(*frame)), Item::Step(record)];
            let events = world.events().iter().map(|e| Item::Event(*e));
            for item in items.into_iter().chain(events) {
                problem = problem.take().or(writer.write(at, &item).err());
            }
        });
        problem.map_or(Ok(()), Err)?;
        writer.finish()?;
        Ok(score)
    }
}
