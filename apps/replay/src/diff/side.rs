//! One of the two recordings of a comparison: what was recorded, in a form small enough that two
//! recordings of an hour fit into memory.

use protocol::blobs::BlobField;
use protocol::budget::{Stage, frame_latencies, pose_latencies, step_latencies};
use protocol::events::Event;
use protocol::handles::{HandleState, PedalState};
use protocol::limits::{BODIES, FIELD_PERIOD_NS};
use protocol::message::fnv1a;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use protocol::time::Nanos;
use recording::{DESK, Item, NoteKind, Provenance, Recording};
use rig::Rig;
use scene::SceneFile;
use std::path::PathBuf;
use training::score::recording::{Reader, Verdict};

/// What is read of a recording.
const TOPICS: [&str; 8] = ["blobs", "handles", "pedal", "poses", "steps", "events", "frames", "notes"];

/// Items read between two signs of progress.
const PROGRESS_ITEMS: usize = 4096;

/// A blob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlobSeen {
    /// Centre, px of the frame.
    pub at_px: [f64; 2],
    /// px of the field.
    pub area_px: f64,
    /// Colour class on the wire.
    pub colour: u32,
}

/// A camera-field.
#[derive(Debug, Clone, Copy)]
pub struct FieldSeen {
    /// Camera id.
    pub camera: u32,
    /// Its number.
    pub field: u64,
    /// Middle of its exposure, ns.
    pub exposed_ns: Nanos,
    /// Where its blobs lie in [`Side::blobs`], and how many.
    blobs: [u32; 2],
}

/// A body of a tracker frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodySeen {
    /// `world_from_body`: position, mm.
    pub position_mm: [f64; 3],
    /// Rotation, (w, x, y, z).
    pub rotation_wxyz: [f64; 4],
    /// Validity on the wire.
    pub validity: u32,
}

/// A tracker frame.
#[derive(Debug, Clone, Copy)]
pub struct FrameSeen {
    /// Field of the reference camera.
    pub field: u64,
    /// Number of the frame since the tracker started.
    pub frame: u64,
    /// Exposure that it is for, ns.
    pub exposed_ns: Nanos,
    /// Its bodies.
    pub bodies: [BodySeen; BODIES],
    /// Hash of everything that a body carries.
    pub digest: u64,
}

/// A step.
#[derive(Debug, Clone, Copy)]
pub struct StepSeen {
    /// Field of the frame that it consumed.
    pub field: u64,
    /// Its number.
    pub step: u64,
    /// Hash of the state after it.
    pub state_hash: u64,
}

/// A recording.
pub struct Side {
    /// The file.
    pub file: PathBuf,
    /// Rig, scene, configuration, versions.
    pub provenance: Provenance,
    /// Its rig; none where that is refused, as of a desk of another build.
    pub rig: Option<Rig>,
    /// Camera-fields, in the order of their cameras and numbers.
    pub fields: Vec<FieldSeen>,
    blobs: Vec<BlobSeen>,
    /// Tracker frames, in the order of their numbers.
    pub frames: Vec<FrameSeen>,
    /// Handle states, as they came.
    pub handles: Vec<HandleState>,
    /// Pedal states, as they came.
    pub pedals: Vec<PedalState>,
    /// Steps, as they came.
    pub steps: Vec<StepSeen>,
    /// Events, as they came.
    pub events: Vec<Event>,
    /// Latencies of each stage, µs, in ascending order.
    pub latencies_us: [Vec<u32>; Stage::ALL.len()],
    /// What the recorder says is missing, and what is wrong with the file.
    pub losses: Vec<String>,
    /// The score, where the scene has a task.
    pub score: Option<Verdict>,
}

impl Side {
    /// Reads a recording; damage ends it and is kept.
    ///
    /// # Errors
    /// Where the file is no recording.
    pub fn read(file: &std::path::Path, with_score: bool, each: impl Fn(u64)) -> anyhow::Result<Self> {
        let recording = Recording::open(file)?;
        let provenance = recording.provenance().clone();
        let scene = SceneFile::parse(&provenance.scene_toml, "of the recording").ok();
        let mut score = scene.filter(|_| with_score).as_ref().and_then(Reader::new);
        let mut side = Side::empty(file.into(), provenance);
        for (number, item) in recording.items_of(&TOPICS).enumerate() {
            match item {
                Ok((_, item)) => side.take(item, score.as_mut()),
                Err(problem) => side.losses.push(problem.to_string()),
            }
            if number % PROGRESS_ITEMS == PROGRESS_ITEMS - 1 {
                each(PROGRESS_ITEMS as u64);
            }
        }
        if !recording.is_finished() {
            side.losses.push("the recording was not closed properly".into());
        }
        side.score = score.map(Reader::finish);
        side.sort();
        Ok(side)
    }

    /// Of items as a reader gives them, without a score.
    pub fn of_items(provenance: Provenance, items: impl IntoIterator<Item = Item>) -> Self {
        let mut side = Side::empty(PathBuf::new(), provenance);
        items.into_iter().for_each(|item| side.take(item, None));
        side.sort();
        side
    }

    /// From one field of its cameras to the next, ns.
    pub fn period_ns(&self) -> u64 {
        self.rig.as_ref().map_or(FIELD_PERIOD_NS, Rig::field_period_ns)
    }

    /// Nothing yet.
    fn empty(file: PathBuf, provenance: Provenance) -> Self {
        Side {
            file,
            rig: Rig::parse(&provenance.rig_json, "of the recording").ok(),
            provenance,
            fields: Vec::new(),
            blobs: Vec::new(),
            frames: Vec::new(),
            handles: Vec::new(),
            pedals: Vec::new(),
            steps: Vec::new(),
            events: Vec::new(),
            latencies_us: Default::default(),
            losses: Vec::new(),
            score: None,
        }
    }

    /// Of a provenance alone.
    #[cfg(test)]
    pub fn of_provenance(provenance: Provenance) -> Self {
        Side::empty("test.mcap".into(), provenance)
    }

    fn take(&mut self, item: Item, score: Option<&mut Reader>) {
        match item {
            Item::Blobs(field) => self.take_field(&field),
            Item::Handle(handle) => self.handles.push(handle),
            Item::Pedal(pedal) => self.pedals.push(pedal),
            Item::Poses(frame) => {
                self.take_frame(&frame);
                score.into_iter().for_each(|reader| reader.take_poses(frame.clone()));
            }
            Item::Step(step) => {
                self.take_step(&step);
                score.into_iter().for_each(|reader| reader.take_step(&step));
            }
            Item::Event(event) => {
                self.events.push(event);
                score.into_iter().for_each(|reader| reader.take_event(event));
            }
            Item::Frame(frame) => self.take_latencies(frame_latencies(&frame)),
            Item::Note(note) if note.kind == NoteKind::Loss => self.losses.push(note.text),
            _ => {}
        }
    }

    fn take_field(&mut self, field: &BlobField) {
        let first = self.blobs.len() as u32;
        self.blobs.extend(field.blobs().iter().map(|blob| BlobSeen {
            at_px: [blob.x_px, field.y_frame_px(blob)],
            area_px: blob.area_px,
            colour: blob.colour,
        }));
        self.fields.push(FieldSeen {
            camera: field.camera,
            field: field.field,
            exposed_ns: field.exposed_ns,
            blobs: [first, self.blobs.len() as u32 - first],
        });
    }

    fn take_frame(&mut self, frame: &TrackerFrame) {
        self.take_latencies(pose_latencies(frame));
        self.frames.push(FrameSeen {
            field: frame.field,
            frame: frame.frame,
            exposed_ns: frame.instants.exposed,
            bodies: std::array::from_fn(|i| BodySeen {
                position_mm: frame.bodies[i].world_from_body.position_mm,
                rotation_wxyz: frame.bodies[i].world_from_body.rotation_wxyz,
                validity: frame.bodies[i].validity,
            }),
            // Instants of measurements are of a clock, which two runs do not share.
            digest: fnv1a(bytemuck::bytes_of(
                &frame.bodies.map(|b| protocol::poses::BodyState { measured_ns: 0, ..b }),
            )),
        });
    }

    fn take_step(&mut self, step: &StepRecord) {
        self.take_latencies(step_latencies(step));
        self.steps.push(StepSeen { field: step.field, step: step.step, state_hash: step.state_hash });
    }

    fn take_latencies(&mut self, stages: [(Stage, Option<u64>); 2]) {
        for (stage, ns) in stages {
            self.latencies_us[stage as usize]
                .extend(ns.map(|ns| (ns / 1000).min(u64::from(u32::MAX)) as u32));
        }
    }

    fn sort(&mut self) {
        self.fields.sort_by_key(|f| (f.camera, f.field, f.exposed_ns));
        // A tracker that was started again counts from 0; fields of a camera go on.
        self.frames.sort_by_key(|f| (f.field, f.exposed_ns));
        self.latencies_us.iter_mut().for_each(|stage| stage.sort_unstable());
    }

    /// Blobs of one of its fields.
    pub fn blobs_of(&self, field: &FieldSeen) -> &[BlobSeen] {
        let [first, count] = field.blobs.map(|n| n as usize);
        &self.blobs[first..first + count]
    }

    /// Fields of a camera.
    pub fn fields_of(&self, camera: u32) -> &[FieldSeen] {
        let first = self.fields.partition_point(|f| f.camera < camera);
        let end = self.fields.partition_point(|f| f.camera <= camera);
        &self.fields[first..end]
    }

    /// Ids of the cameras that sent fields, in ascending order.
    pub fn cameras(&self) -> Vec<u32> {
        let mut ids: Vec<u32> = self.fields.iter().map(|f| f.camera).collect();
        ids.dedup();
        ids
    }

    /// True if it was made at a desk, without cameras.
    pub fn is_desk(&self) -> bool {
        self.provenance.config.contains_key(DESK)
    }

    /// The first exposure, of cameras or of frames, ns.
    pub fn start_ns(&self) -> Nanos {
        let fields = self.fields.iter().map(|f| f.exposed_ns).min();
        fields.into_iter().chain(self.frames.first().map(|f| f.exposed_ns)).min().unwrap_or(0)
    }
}
