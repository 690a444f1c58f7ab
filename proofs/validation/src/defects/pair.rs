//! The two recordings of a planted defect.

use super::Defect;
use crate::streams::{Knock, Recipe, Scenario};
use anyhow::Context;
use nalgebra::Vector3;
use protocol::blobs::BlobField;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::steps::{STATE_HASH_VERSION, StepInput, StepRecord};
use recording::{Item, Provenance, Recording, STATE_HASH, TRACKER, TRACKER_VERSION, Writer};
use replay::what_if::outcome::{Outcome, Setting};
use replay::what_if::setting;
use rig::Rig;
use scene::SceneFile;
use settings::commands::{Assignment, WhatIfArgs};
use simcore::world::{World, no_clock};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use tracker::stream::StreamTracker;
use tracker::tracker::{close, stamp};

/// Length of a recording, s.
const SECONDS: f64 = 6.0;
/// The scene: its membrane is held by springs from the first step on.
const SCENE: &str = "peel";

/// Two recordings, in a folder that goes with them.
pub struct Pair {
    /// Where they lie.
    pub folder: TempDir,
    /// Without the defect.
    pub a: PathBuf,
    /// With it.
    pub b: PathBuf,
}

/// Records a motion twice, the second time with a defect.
///
/// # Errors
/// Where a recording cannot be written.
pub fn pair(seed: u64, defect: &Defect, rig: &Rig) -> anyhow::Result<Pair> {
    let folder = tempfile::tempdir()?;
    let (a, b) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let scenario = [Scenario::Nominal, Scenario::Async, Scenario::Tremor][(seed / 2 % 3) as usize];
    let recipe = Recipe { scenario, seed, seconds: SECONDS, knocks: vec![] };
    let mut clean = recipe.draw(rig).fields;
    let mut changed = fields(&recipe, defect, rig, &clean);
    if is_drawn_again(defect) {
        // Fields are lost by chance, of another draw others.
        let numbers =
            |fields: &[BlobField]| fields.iter().map(|f| (f.camera, f.field)).collect::<BTreeSet<_>>();
        let both: BTreeSet<_> = numbers(&clean).intersection(&numbers(&changed)).copied().collect();
        [&mut clean, &mut changed]
            .into_iter()
            .for_each(|own| own.retain(|f| both.contains(&(f.camera, f.field))));
    }
    record(&a, rig, &clean, None)?;
    match defect {
        Defect::Springs { factor } => {
            let scene = SceneFile::load(SCENE)?;
            let stiffness = scene.membrane.context("the scene has a membrane")?.stiffness_un_per_mm;
            what_if(&a, &b, "scene.membrane.stiffness_un_per_mm", stiffness * factor)?;
        }
        Defect::TrackerConstant { key, value } => what_if(&a, &b, &format!("tracker.{key}"), *value)?,
        Defect::HandleLost { seq } => record(&b, rig, &clean, Some(*seq))?,
        _ => record(&b, &given_rig(defect, rig), &changed, None)?,
    }
    Ok(Pair { folder, a, b })
}

/// Whether the defect is in the drawing of the stream, and not in what is done to it.
fn is_drawn_again(defect: &Defect) -> bool {
    match defect {
        Defect::CameraTurned { in_rig, .. } | Defect::MarkerMoved { in_rig, .. } => !in_rig,
        Defect::Focal { .. } | Defect::ExposedLate { .. } => true,
        Defect::OtherNoise | Defect::OtherMotion => true,
        _ => false,
    }
}

/// The fields with the defect.
fn fields(recipe: &Recipe, defect: &Defect, rig: &Rig, clean: &[BlobField]) -> Vec<BlobField> {
    let mut fields = clean.to_vec();
    match *defect {
        Defect::CameraTurned { camera, turn_rad, in_rig: false } => {
            let knock =
                Knock { camera, at_s: 0.0, turn: turn_rad, shift_mm: Vector3::zeros(), goes_on: false };
            fields = Recipe { knocks: vec![knock], ..recipe.clone() }.draw(rig).fields;
        }
        Defect::MarkerMoved { in_rig: false, .. } | Defect::Focal { .. } => {
            fields = recipe.draw(&real_rig(defect, rig)).fields;
        }
        Defect::ExposedLate { camera, by_ms } => fields = recipe.draw_late(rig, camera, by_ms * 1e-3).fields,
        Defect::OtherNoise => {
            fields = Recipe { seed: recipe.seed + 1_000, ..recipe.clone() }
                .draw_motion_of(rig, recipe.seed)
                .fields;
        }
        Defect::OtherMotion => fields = recipe.draw_motion_of(rig, recipe.seed + 1_000).fields,
        Defect::ColoursSwapped { colours } => {
            let [a, b] = colours.map(|c| c as u32);
            for blob in fields.iter_mut().flat_map(|f| &mut f.blobs) {
                blob.colour = if blob.colour == a {
                    b
                } else if blob.colour == b {
                    a
                } else {
                    blob.colour
                };
            }
        }
        Defect::CamerasSwapped { cameras: [a, b] } => {
            for field in &mut fields {
                field.camera = if field.camera == a {
                    b
                } else if field.camera == b {
                    a
                } else {
                    field.camera
                };
            }
        }
        Defect::StampsOff { camera, by_ms } => {
            for field in fields.iter_mut().filter(|f| f.camera == camera) {
                field.exposed_ns = field.exposed_ns.wrapping_add_signed((by_ms * 1e6) as i64);
            }
        }
        Defect::CameraLost { camera, from_s } => {
            let first_ns = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0);
            fields.retain(|f| f.camera != camera || (f.exposed_ns - first_ns) as f64 * 1e-9 < from_s);
        }
        Defect::FieldLost { camera, field } => fields.retain(|f| (f.camera, f.field) != (camera, field)),
        _ => {}
    }
    fields
}

/// The rig that is given: with the defect where it is planted there.
fn given_rig(defect: &Defect, rig: &Rig) -> Rig {
    let mut given = rig.clone();
    match *defect {
        Defect::CameraTurned { camera, turn_rad, in_rig: true } => {
            let turn = nalgebra::Rotation3::new(turn_rad);
            for own in given.cameras.iter_mut().filter(|c| c.id == camera) {
                let model = own.model();
                let r = turn.matrix() * model.camera_from_world;
                own.rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]));
                own.t = (turn * model.translation_mm).into();
            }
        }
        Defect::MarkerMoved { in_rig: true, .. } => given = real_rig(defect, rig),
        Defect::RigScaled { factor } => {
            let cameras = given.cameras.iter_mut().flat_map(|camera| &mut camera.t);
            cameras.for_each(|v| *v *= factor);
        }
        _ => {}
    }
    given
}

/// The true rig, where another is given.
fn real_rig(defect: &Defect, rig: &Rig) -> Rig {
    let mut real = rig.clone();
    match *defect {
        Defect::MarkerMoved { body, marker, by_mm, .. } => {
            let own = real.bodies.iter_mut().find(|b| b.name == BODY_NAMES[body]);
            let markers = own.map(|body| &mut body.markers[marker].p);
            markers.into_iter().for_each(|p| *p = (Vector3::from(*p) + by_mm).into());
        }
        Defect::Focal { camera, factor } => {
            for own in real.cameras.iter_mut().filter(|c| c.id == camera) {
                (own.fx, own.fy) = (own.fx * factor, own.fy * factor);
            }
        }
        _ => {}
    }
    real
}

/// The first recording with a key at another value.
fn what_if(a: &Path, b: &Path, key: &str, value: f64) -> anyhow::Result<()> {
    let recording = Recording::open(a)?;
    let set = vec![Assignment { key: key.into(), value }];
    let setting: Setting = setting(&recording, &WhatIfArgs { set, ..WhatIfArgs::default() })?;
    let mut writer = Writer::create(b, &setting.provenance)?;
    Outcome::new(&recording, &setting)?.run(|at, item| Ok(writer.write(at, item)?))?;
    Ok(writer.finish()?)
}

/// Records a stream as a live run would, with handles that open and close; without one of their states.
fn record(file: &Path, rig: &Rig, fields: &[BlobField], lost: Option<u64>) -> anyhow::Result<()> {
    let scene = SceneFile::load(SCENE)?;
    let versions = [
        ("vitreo", env!("CARGO_PKG_VERSION").into()),
        (STATE_HASH, STATE_HASH_VERSION.to_string()),
        (TRACKER, TRACKER_VERSION.to_string()),
    ];
    let provenance = Provenance {
        rig_json: rig.to_json(),
        scene_name: SCENE.into(),
        scene_toml: scene.to_toml(),
        versions: versions.map(|(key, value)| (key.to_owned(), value)).into(),
        ..Provenance::default()
    };
    let mut writer = Writer::create(file, &provenance)?;
    let mut world = World::new(&scene)?.unseen();
    let mut stream = StreamTracker::new(rig);
    let mut made = Vec::new();
    for field in fields {
        writer.write(field.blobs_out_ns, &Item::Blobs(Box::new(*field)))?;
        stream.push(field, |mut frame, used, closed, _| {
            close(&mut frame, closed.closed_by);
            stamp(&mut frame, used, closed.taken_ns);
            (frame.waited_ns, frame.instants.tracked) = (closed.waited_ns, closed.taken_ns);
            made.push(frame);
        });
        for frame in made.drain(..) {
            step(&mut writer, &mut world, &frame, lost)?;
        }
    }
    Ok(writer.finish()?)
}

/// Writes a frame, the handles and the pedal before its step, and the step.
fn step(
    writer: &mut Writer,
    world: &mut World,
    frame: &TrackerFrame,
    lost: Option<u64>,
) -> anyhow::Result<()> {
    let at = frame.instants.tracked.max(1);
    let first = frame.frame * INSTRUMENTS as u64;
    let handles: [HandleState; INSTRUMENTS] = std::array::from_fn(|i| HandleState {
        seq: first + i as u64,
        field: frame.field,
        instant_ns: at,
        instrument: i as u32,
        tool: [Tool::Forceps, Tool::LightPipe][i] as u32,
        jaw_rad: if i == 0 { 0.2 + 0.2 * libm::sin(0.1 * frame.frame as f64) } else { 0.0 },
    });
    let pedal = PedalState { seq: frame.frame, instant_ns: at, ..bytemuck::Zeroable::zeroed() };
    let kept: Vec<HandleState> = handles.into_iter().filter(|h| Some(h.seq) != lost).collect();
    kept.iter().try_for_each(|handle| writer.write(at, &Item::Handle(*handle)))?;
    writer.write(at, &Item::Pedal(pedal))?;
    writer.write(at, &Item::Poses(Box::new(*frame)))?;
    let report = world.step(&StepInput { frame, handles: &kept, pedals: &[pedal] }, &mut no_clock);
    let state = world.state();
    let record = StepRecord {
        step: state.step,
        field: frame.field,
        frame: frame.frame,
        instants: frame.instants,
        handles_below: state.handles_below,
        pedals_below: state.pedals_below,
        advanced_ns: report.advanced_ns,
        state_hash: report.state_hash,
        ..bytemuck::Zeroable::zeroed()
    }
    .with_inputs(report.inputs);
    writer.write(at, &Item::Step(record))?;
    world.events().iter().try_for_each(|event| Ok(writer.write(at, &Item::Event(*event))?))
}
