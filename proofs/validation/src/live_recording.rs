//! A scene through cameras, tracker and simulation in one process, recorded as a live run records it: blobs,
//! handles, poses, steps, events, and checkpoints of tracker and simulation.

use crate::camera_twin::CameraTwin;
use anyhow::Context;
use protocol::blobs::BlobField;
use protocol::checkpoints::{CheckpointTimes, TrackerCheckpointHeader};
use protocol::handles::HandleState;
use protocol::limits::{FIELD_PERIOD_NS, INSTRUMENTS};
use protocol::poses::TrackerFrame;
use protocol::steps::{STATE_HASH_VERSION, StepInput, StepRecord};
use recording::{Item, Provenance, STATE_HASH, TRACKER, TRACKER_VERSION, Writer};
use replay::perception::WorldPerception;
use replay::timeline::saving;
use rig::Rig;
use scene::SceneFile;
use scene::module::Module;
use simcore::world::{World, no_clock};
use std::fs::File;
use std::path::Path;
use surgeon::motion::MotionSource;
use surgeon::skill;
use tracker::assembler::{ClosedFrame, FrameAssembler};
use tracker::tracker::{Tracker, close, stamp};
use virtual_rig::cameras::Path as CameraPath;

/// Exposure of the first field, ns.
const FIRST_NS: u64 = 1_000_000_000;
/// From the newest field of a frame to its poses, and from there to its step, ns.
const TRACKED_AFTER_NS: u64 = 150_000;
const STEPPED_AFTER_NS: u64 = 300_000;

/// What is recorded.
pub struct Live<'a> {
    /// Scene, or `module NAME` for a shipped module.
    pub scene: &'a str,
    /// Number of fields.
    pub fields: u64,
    /// Seed of everything random.
    pub seed: u64,
}

impl Live<'_> {
    /// Writes the recording on a file that is open and empty and will have the name `path`. `progress` gets
    /// the number of every field.
    ///
    /// # Errors
    /// Where there is no such scene, or the file cannot be written.
    pub fn record(&self, file: File, path: &Path, mut progress: impl FnMut(u64)) -> anyhow::Result<()> {
        let rig = Rig::load_or_shipped(None).context("the shipped rig")?;
        let scene = self.scene()?;
        let writer = Writer::on(file, path, &self.provenance(&rig, &scene))?;
        let mut run = Run::new(&rig, &scene, self.seed, writer)?;
        for number in 0..self.fields {
            run.field(number)?;
            progress(number);
        }
        Ok(run.writer.finish()?)
    }

    fn scene(&self) -> anyhow::Result<SceneFile> {
        let Some(name) = self.scene.strip_prefix("module ") else { return Ok(SceneFile::load(self.scene)?) };
        let skill = skill::named("average").context("a shipped skill")?;
        Ok(surgeon::compose(&Module::load(name)?, 1, &skill, self.seed)?)
    }

    fn provenance(&self, rig: &Rig, scene: &SceneFile) -> Provenance {
        let versions = [(TRACKER, TRACKER_VERSION), (STATE_HASH, STATE_HASH_VERSION)];
        Provenance {
            rig_json: rig.to_json(),
            scene_name: self.scene.into(),
            scene_toml: scene.to_toml(),
            versions: versions.map(|(name, version)| (name.to_owned(), version.to_string())).into(),
            ..Provenance::default()
        }
    }
}

/// A live run in one process, and its recording.
struct Run {
    cameras: CameraTwin,
    surgeon: MotionSource,
    assembler: FrameAssembler,
    tracker: Tracker,
    world: World,
    writer: Writer,
    /// When checkpoints of tracker and simulation are due.
    times: CheckpointTimes,
    /// Inputs that no step has consumed.
    handles: Vec<HandleState>,
}

impl Run {
    fn new(rig: &Rig, scene: &SceneFile, seed: u64, writer: Writer) -> anyhow::Result<Self> {
        Ok(Run {
            cameras: CameraTwin::new(rig, CameraPath::Direct, seed, FIRST_NS),
            surgeon: MotionSource::new(scene, rig, None, seed),
            assembler: FrameAssembler::new(rig),
            tracker: Tracker::new(rig),
            world: World::new(scene)?.unseen(),
            writer,
            times: CheckpointTimes::default(),
            handles: Vec::new(),
        })
    }

    /// The next field of every camera, and what comes of it.
    fn field(&mut self, number: u64) -> anyhow::Result<()> {
        let exposed_ns = number * FIELD_PERIOD_NS;
        let motion = self.surgeon.at(exposed_ns);
        for i in 0..INSTRUMENTS {
            let handle = HandleState {
                seq: number * INSTRUMENTS as u64 + i as u64,
                field: number,
                instant_ns: FIRST_NS + exposed_ns,
                instrument: i as u32,
                tool: motion.tool[i] as u32,
                jaw_rad: motion.jaw_rad[i],
            };
            self.put(FIRST_NS + exposed_ns, &Item::Handle(handle))?;
            self.handles.push(handle);
        }
        let (mut closed, mut now_ns) = (Vec::new(), 0);
        for camera in 0..self.cameras.count() {
            let field = self.cameras.blobs(camera, &mut self.surgeon, number);
            now_ns = field.blobs_out_ns.max(now_ns);
            self.put(now_ns, &Item::Blobs(Box::new(field)))?;
            let tracker = &mut self.tracker;
            self.assembler.add(&field, now_ns, |used, how| closed.push(track(tracker, used, &how, now_ns)));
            for frame in closed.drain(..) {
                self.step(frame)?;
            }
        }
        if self.surgeon.perceives_now(exposed_ns) {
            self.surgeon.see(exposed_ns, &WorldPerception(&self.world));
        }
        Ok(())
    }

    /// Makes the step of a frame.
    fn step(&mut self, frame: TrackerFrame) -> anyhow::Result<()> {
        let tracked_ns = frame.instants.tracked;
        self.put(tracked_ns, &Item::Poses(Box::new(frame)))?;
        let handles = std::mem::take(&mut self.handles);
        let input = StepInput { frame: &frame, handles: &handles, pedals: &[] };
        let report = self.world.step(&input, &mut no_clock);
        let mut record: StepRecord = bytemuck::Zeroable::zeroed();
        let state = self.world.state();
        (record.step, record.field, record.frame) = (state.step, frame.field, frame.frame);
        record.instants = frame.instants;
        record.instants.stepped = tracked_ns + STEPPED_AFTER_NS;
        (record.handles_below, record.pedals_below) = (state.handles_below, state.pedals_below);
        (record.advanced_ns, record.state_hash) = (report.advanced_ns, report.state_hash);
        let at = record.instants.stepped;
        self.put(at, &Item::Step(record))?;
        for event in self.world.events().to_vec() {
            self.put(at, &Item::Event(event))?;
        }
        if self.times.after_frame(frame.instants.exposed) {
            let (number, field, exposed_ns) = (frame.frame, frame.field, frame.instants.exposed);
            let header = TrackerCheckpointHeader { frame: number, field, exposed_ns, bytes: 0 };
            self.put(at, &saving::of_tracker(header, &self.tracker)?)?;
            self.put(at, &saving::of_world(&self.world)?)?;
        }
        Ok(())
    }

    fn put(&mut self, at: u64, item: &Item) -> anyhow::Result<()> {
        self.writer.write(at, item)?;
        Ok(self.writer.flush_aged(at)?)
    }
}

fn track(tracker: &mut Tracker, used: &[BlobField], how: &ClosedFrame, now_ns: u64) -> TrackerFrame {
    let mut frame = tracker.track(used, &how.reference);
    close(&mut frame, how.closed_by);
    stamp(&mut frame, used, how.taken_ns);
    frame.instants.tracked = now_ns + TRACKED_AFTER_NS;
    frame
}
