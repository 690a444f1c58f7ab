//! `rolls [--pixels] [--rate RAD_S] [--tip X Y Z]`: an instrument is rolled from −180° to 180° and
//! back, at the given speed in the middle of the way, before the virtual cameras, its tip resting at a
//! place of the eye (mm). Told by roll: blobs a frame, cameras that see the marker beside the
//! shaft, frames in which the roll was not measured, error of the roll and what the tracker thinks
//! of it.

use anyhow::{Context, bail};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::blobs::{BlobField, Colour};
use protocol::limits::FIELD_PERIOD_NS;
use protocol::poses::{BodyState, BodyStatus};
use rig::Rig;
use scene::{SceneFile, ScriptKey};
use std::f64::consts::{PI, TAU};
use surgeon::motion::{Motion, MotionSource};
use surgeon::script::Gesture;
use tracker::assembler::FrameAssembler;
use tracker::tracker::Tracker;
use validation::camera_twin::CameraTwin;
use virtual_rig::cameras::Path;

/// Exposure of the first field, ns: instants of 0 mean "not yet".
const FIRST_NS: u64 = 1_000_000_000;
/// Fields before the tracker is judged.
const SETTLED: u64 = 10;
/// Rows of the table.
const ROWS: usize = 24;

/// What is asked.
struct Asked {
    path: Path,
    rate_rad_s: f64,
    tip_in_eye_mm: [f64; 3],
}

fn asked() -> anyhow::Result<Asked> {
    let mut asked = Asked { path: Path::Direct, rate_rad_s: 2.0, tip_in_eye_mm: [1.2, -0.9, -9.5] };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut number = || -> anyhow::Result<f64> {
            let text = arguments.next().with_context(|| format!("{argument}: a number is missing"))?;
            text.parse().with_context(|| format!("{argument}: expected a number, found {text}"))
        };
        match argument.as_str() {
            "--pixels" => asked.path = Path::Pixels,
            "--rate" => asked.rate_rad_s = number()?,
            "--tip" => asked.tip_in_eye_mm = [number()?, number()?, number()?],
            other => bail!("usage: rolls [--pixels] [--rate RAD_S] [--tip X Y Z]; found {other}"),
        }
    }
    if !(0.05..=100.0).contains(&asked.rate_rad_s) {
        bail!("--rate: expected 0.05 to 100 rad/s, found {}", asked.rate_rad_s);
    }
    Ok(asked)
}

/// The other instrument rests where the scene has it.
fn scene(asked: &Asked) -> anyhow::Result<SceneFile> {
    let mut scene = SceneFile::load("bodies")?;
    // A minimum-jerk movement is 15/8 times as fast in its middle as on average.
    let way_s = TAU * 1.875 / asked.rate_rad_s;
    let other = scene
        .script
        .as_ref()
        .unwrap()
        .keys
        .iter()
        .find(|k| k.instrument == 1)
        .context("no second instrument")?;
    let rests = ScriptKey { at_s: 0.0, ..other.clone() };
    let key = |at_s: f64, roll_rad: f64| ScriptKey {
        at_s,
        instrument: 0,
        tip_in_eye_mm: asked.tip_in_eye_mm,
        roll_rad,
        jaw_rad: 0.0,
        tool: None,
    };
    scene.script.as_mut().unwrap().keys =
        vec![key(0.0, -PI), key(1.0, -PI), key(1.0 + way_s, PI), key(2.0 + way_s, PI), rests];
    scene.script.as_mut().unwrap().period_s = 2.0 + 2.0 * way_s;
    Ok(scene)
}

/// Frames with the roll between two angles.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    frames: f64,
    blobs: f64,
    cameras: f64,
    unmeasured: u32,
    squares: f64,
    worst: f64,
    variances: f64,
}

impl Row {
    fn take(&mut self, state: &BodyState, truth: &UnitQuaternion<f64>, cameras: usize) {
        let axis: Vector3<f64> = truth * Vector3::z();
        let found = state.world_from_body.isometry().rotation;
        let off = (found * truth.inverse()).scaled_axis().dot(&axis);
        let cells = (0..6).flat_map(|r| (r..6).map(move |c| (r, c))).zip(state.covariance);
        let weight = |r: usize, c: usize| if r == c { 1.0 } else { 2.0 } * axis[r - 3] * axis[c - 3];
        let variance: f64 =
            cells.filter(|((r, _), _)| *r > 2).map(|((r, c), cell)| weight(r, c) * cell).sum();
        self.frames += 1.0;
        self.blobs += f64::from(state.blobs_used);
        self.cameras += cameras as f64;
        self.unmeasured += u32::from(state.status != BodyStatus::Tracked as u32);
        self.squares += off * off;
        self.worst = off.abs().max(self.worst);
        self.variances += variance;
    }

    fn print(&self, degrees: f64) {
        let mean = |sum: f64| sum / self.frames;
        println!(
            "{degrees:8.0} {:7} {:6.1} {:8.2} {:11} {:9.1} {:9.1} {:9.1}",
            self.frames,
            mean(self.blobs),
            mean(self.cameras),
            self.unmeasured,
            mean(self.squares).sqrt() * 1e3,
            self.worst * 1e3,
            mean(self.variances).sqrt() * 1e3,
        );
    }
}

/// Roll of the first instrument, as the script counts it, rad.
fn roll_of(motion: &Motion, trocar_in_eye: Vector3<f64>) -> f64 {
    let in_eye = motion.world_from_eye.inverse() * motion.world_from_instrument[0];
    let (tip_in_eye_mm, tool) = (in_eye.translation.vector, motion.tool[0]);
    let unrolled =
        Gesture { tip_in_eye_mm, roll_rad: 0.0, jaw_rad: 0.0, tool }.eye_from_instrument(trocar_in_eye);
    (unrolled.rotation.inverse() * in_eye.rotation).scaled_axis().z
}

fn main() -> anyhow::Result<()> {
    let asked = asked()?;
    let rig = Rig::load_or_shipped(None)?;
    let trocar = Vector3::from(rig.trocar("inst0").context("the rig has no trocar of inst0")?.p_eye);
    let mut surgeon = MotionSource::new(&scene(&asked)?, &rig, None, 1);
    let mut cameras = CameraTwin::new(&rig, asked.path, 1, FIRST_NS);
    let (mut assembler, mut tracker) = (FrameAssembler::new(&rig), Tracker::new(&rig));
    let mut rows = [Row::default(); ROWS];
    for number in 0..(surgeon.period_s() * 1e9) as u64 / FIELD_PERIOD_NS {
        let motion = surgeon.at(number * FIELD_PERIOD_NS);
        let share = (roll_of(&motion, trocar) + PI) / TAU;
        let row = &mut rows[((share * ROWS as f64) as usize).min(ROWS - 1)];
        let fields: Vec<BlobField> =
            (0..cameras.count()).map(|i| cameras.blobs(i, &mut surgeon, number)).collect();
        let sees = |f: &&BlobField| f.blobs().iter().any(|b| b.colour == Colour::Yellow as u32);
        let seen = fields.iter().filter(sees).count();
        let now = fields.iter().map(|f| f.blobs_out_ns).max().context("no camera")?;
        for field in &fields {
            assembler.add(field, now, |used, closed| {
                let frame = tracker.track(used, &closed.reference);
                if number >= SETTLED {
                    row.take(&frame.bodies[0], &motion.world_from_instrument[0].rotation, seen);
                }
            });
        }
    }
    println!("  roll °  frames  blobs  cameras  unmeasured  RMS mrad     worst         σ");
    for (i, row) in rows.iter().enumerate().filter(|(_, row)| row.frames > 0.0) {
        row.print(((i as f64 + 0.5) / ROWS as f64 - 0.5) * 360.0);
    }
    Ok(())
}
