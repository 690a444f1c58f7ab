//! Step `poses`: where the cameras are, from a board that they see together or from waved instruments.
//!
//! A board says where cameras are to each other; where all of them are to the eye stays as the rig has it, by least
//! squares. Waved instruments refine what is right within some 0.2 mm and 2 mrad.

use crate::boards::{Boards, half, look, rms_with};
use crate::folder::{Folder, Outcome, Record};
use crate::lenses::residual_picture;
use crate::live::{SECONDS, seconds};
use crate::pictures::PicturesArgs;
use crate::places::{beside, exchanged, laid_over, spread_mm};
use crate::stream::{self, MOST_INSTANTS, Origin, Stream};
use crate::{NotBetter, Refused, refuse};
use anyhow::Result;
use calibration::bundle::PriorSigmas;
use calibration::causes::{Judgement, measure};
use calibration::cli::{BoardArgs, Waved, refined_by_waving};
use calibration::lens::LENS;
use calibration::multi_camera::{LensMode, calibrate_cameras};
use calibration::report::Report;
use calibration::rig_output::rig_with;
use calibration::self_calibration::{SelfCalibration, fitted, residuals_of};
use calibration::target_problem::{Calibrated, Residual, Robustness, TargetView};
use fpga_model::input::whole::is_recording;
use protocol::blobs::BlobField;
use rig::Rig;
use rig::camera::Camera;
use std::collections::BTreeSet;
use std::path::Path;

/// Fewest views that a camera shares with any other.
pub const FEWEST_SHARED: usize = 6;
/// Largest residuals of a board that cameras see together, px.
pub const LARGEST_RMS_PX: f64 = 1.0;
/// Cameras are so many times farther apart than the rig says, or nearer, and are refused.
pub const LARGEST_SCALE: f64 = 1.25;
/// Distance and angle from the rig's camera pose beyond which a camera is reported, mm and rad.
const BESIDE: (f64, f64) = (5.0, 0.1);

/// Arguments of the step.
#[derive(Debug, Clone, clap::Args)]
pub struct PosesArgs {
    /// Pictures of the board, or one stream (.mcap, .jsonl) of waved instruments. A recording of pixels and live cameras
    /// show waved instruments where no board is given.
    #[command(flatten)]
    pub pictures: PicturesArgs,
    /// The board.
    #[command(flatten)]
    pub board: BoardArgs,
    /// Watch waved instruments for S seconds, with --cameras and without a board.
    #[arg(long, value_name = "S", default_value_t = SECONDS, value_parser = seconds, allow_negative_numbers = true, help_heading = "Pictures")]
    pub seconds: f64,
}

/// Runs the step.
///
/// # Errors
/// Pictures or a stream that cannot be read, or show too little.
pub fn run(folder: &Folder, rig: &Rig, args: &PosesArgs) -> Result<Outcome> {
    let is_waved = |path: &Path| stream::is_stream(path) || (is_recording(path) && !args.board.is_given());
    let cameras = &args.pictures.cameras[..];
    match args.pictures.from.as_slice() {
        [path] if is_waved(path) => waved(folder, rig, Origin::File(path)),
        [] if !args.board.is_given() => waved(folder, rig, Origin::Live(cameras, args.seconds)),
        _ => boards(rig, args),
    }
}

fn boards(rig: &Rig, args: &PosesArgs) -> Result<Outcome> {
    let Boards { cameras } = look(rig, &args.pictures, &args.board.board()?)?;
    let absent = rig.cameras.iter().filter(|c| cameras.iter().all(|s| s.id != c.id));
    refuse(
        absent.map(|c| format!("camera {}: no pictures: all cameras must see the board", c.id)).collect(),
    )?;
    refuse(cameras.iter().flat_map(|seen| seen.advice(false)).collect())?;
    let sheets: Vec<TargetView> = cameras.iter().flat_map(|seen| seen.sheets.clone()).collect();
    refuse(lonely(rig, &sheets))?;
    let expected = rig.cameras();
    let found = placed(&expected, &sheets).map_err(|problem| {
        Refused(vec![format!(
            "the board does not determine where the cameras are ({problem}): hold it where several of them \
             see it"
        )])
    })?;
    let length = if args.board.charuco.is_some() { "SQUARE of --charuco" } else { "--pitch" };
    refuse(misplaced(&found, &expected, length))?;
    let placed_now = laid_over(&found.scene.cameras, &expected);
    let learnt = placed(&expected, &half(&sheets, false)).map(|c| c.scene.cameras);
    let judge = half(&sheets, true);
    let held_out_px = learnt.map_or(f64::INFINITY, |cameras| rms_with(&cameras, &judge));
    let before_px = rms_with(&expected, &judge);
    let mut outcome = Outcome::default();
    let record = &mut outcome.record;
    record.from = args.pictures.names();
    record.kept = before_px < held_out_px;
    let (n, views) = (expected.len(), sheets.iter().map(|s| s.view).collect::<BTreeSet<_>>().len());
    record.summary = format!("{n} cameras from {views} views of a board: residuals {:.2} px", found.rms_px);
    record.figure("residuals", format!("{:.3} px", found.rms_px));
    record.figure(
        "residuals of held-out views",
        format!("{held_out_px:.3} px; with the previous places {before_px:.3} px"),
    );
    note_moves(&placed_now, &expected, record);
    record.notes.push(
        "the lenses, and the place of the cameras as a whole relative to the eye, are those of the rig: \
         next, poses --from STREAM (waved instruments) with --force, then trocars"
            .into(),
    );
    pictures(rig, &found.residuals, &mut outcome)?;
    outcome.rig = keep_or(rig, rig_with(rig, &placed_now)?, &mut outcome);
    Ok(outcome)
}

/// Notes how far each camera is from its place in the rig, with advice where that is far.
fn note_moves(cameras: &[Camera], expected: &[Camera], record: &mut Record) {
    for (camera, off) in cameras.iter().zip(beside(cameras, expected)) {
        let (id, mm, mrad) = (camera.id, off.mm, off.rad * 1e3);
        record.figure(
            format!("camera {id}: away from its place in the rig"),
            format!("{mm:.3} mm, {mrad:.2} mrad"),
        );
        if off.mm > BESIDE.0 || off.rad > BESIDE.1 {
            record.advice.push(format!(
                "camera {id} is {mm:.1} mm and {mrad:.0} mrad away from its place in the rig: is it where it should be?"
            ));
        }
    }
}

/// Cameras with the lenses of `expected` from the board they see together.
fn placed(expected: &[Camera], sheets: &[TargetView]) -> Result<Calibrated, calibration::CalibrationError> {
    let sizes: Vec<[u32; 2]> = expected.iter().map(|c| c.size_px).collect();
    let given = LensMode::Given(expected.to_vec());
    let mut found =
        calibrate_cameras(&sizes, sheets, [false; LENS], &given, Robustness::Huber, &mut |_, _| {})?;
    found.scene.cameras.iter_mut().zip(expected).for_each(|(camera, own)| camera.id = own.id);
    Ok(found)
}

/// Cameras that share too few views with others.
fn lonely(rig: &Rig, sheets: &[TargetView]) -> Vec<String> {
    let shared = |index: usize| {
        let mine = sheets.iter().filter(|s| s.camera == index);
        mine.filter(|s| sheets.iter().any(|o| o.camera != index && o.view == s.view)).count()
    };
    let all = rig.cameras.iter().enumerate().map(|(i, camera)| (camera.id, shared(i)));
    all.filter(|(_, views)| *views < FEWEST_SHARED)
        .map(|(id, views)| {
            format!(
                "camera {id} and another one saw the board at one time in {views} views, at least {FEWEST_SHARED} are \
                 needed: hold it where camera {id} and others see it, and give pictures taken at one time the same \
                 number"
            )
        })
        .collect()
}

/// What is wrong with places that were found; `length` is the option that scales them.
fn misplaced(found: &Calibrated, expected: &[Camera], length: &str) -> Vec<String> {
    let mut said = Vec::new();
    let cameras = &found.scene.cameras;
    let scale = spread_mm(cameras) / spread_mm(expected).max(1e-9);
    if let Some((i, j)) = exchanged(cameras, expected) {
        let (a, b) = (expected[i].id, expected[j].id);
        said.push(format!(
            "the pictures of cameras {a} and {b} seem to be exchanged: exchange their cables, or the names of the files"
        ));
    } else if !(1.0 / LARGEST_SCALE..=LARGEST_SCALE).contains(&scale) {
        said.push(format!(
            "the cameras come out {scale:.2} times as far apart as in the rig: is {length} the distance of the board's \
             corners in mm?"
        ));
    }
    if found.rms_px > LARGEST_RMS_PX {
        said.push(format!(
            "residuals of {:.2} px, at most {LARGEST_RMS_PX} are accepted: hold the board still while all \
             cameras see it, give pictures taken at one time the same number, and do lenses first",
            found.rms_px
        ));
    }
    said
}

fn pictures(rig: &Rig, residuals: &[Residual], outcome: &mut Outcome) -> Result<()> {
    for (index, camera) in rig.cameras.iter().enumerate() {
        let own: Vec<Residual> = residuals.iter().filter(|r| r.camera == index).copied().collect();
        let id = camera.id;
        outcome.pictures.push((
            format!("poses-cam{id}.png"),
            format!("camera {id}: residuals over the picture"),
            residual_picture([camera.width, camera.height], &own)?,
        ));
    }
    Ok(())
}

/// The new rig, or the one that was there where the record says so.
fn keep_or(rig: &Rig, new: Rig, outcome: &mut Outcome) -> Option<Rig> {
    if outcome.record.kept {
        outcome.record.notes.push("the previous places fit as well and are kept".into());
        return Some(rig.clone());
    }
    Some(new)
}

/// How sure a rig is before its instruments are waved.
const BEFORE: PriorSigmas = PriorSigmas { camera_mm: 0.2, camera_rad: 2e-3, marker_mm: 0.01, lens_px: 0.0 };

/// Refines the places by waved instruments, under the conditions of `vitreo calibrate waved`.
fn waved(folder: &Folder, rig: &Rig, origin: Origin<'_>) -> Result<Outcome> {
    let stream = stream::load(rig, origin, folder.colours().as_deref())?;
    let refined = refined_by_waving(rig, &stream.fields, &BEFORE, MOST_INSTANTS).map_err(|problem| {
        Refused(vec![format!(
            "the stream does not determine where the cameras are ({problem}): do poses from a board first, wave \
             slowly, and keep instruments and eye in view of all cameras"
        )])
    })?;
    let mut outcome = match refined {
        Waved::Better { found, report } => better(rig, &found, &report, &stream)?,
        // What was there is right: the step is done.
        Waved::Kept { judgement, why } if judgement.holds => kept(rig, &judgement, why, &stream)?,
        Waved::Kept { judgement, why } => return Err(NotBetter { found: judgement.text(), why }.into()),
    };
    outcome.record.from = origin.names();
    outcome.record.advice.extend(stream.advice());
    Ok(outcome)
}

/// The refined rig, with what was found.
fn better(rig: &Rig, found: &SelfCalibration, report: &Report, stream: &Stream) -> Result<Outcome> {
    let mut outcome = Outcome::default();
    let record = &mut outcome.record;
    record.summary =
        format!("{:.0} s of waved instruments: residuals {:.3} px", stream.seconds, report.rms_px);
    add_figures(report, record);
    pictures(rig, &found.residuals, &mut outcome)?;
    outcome.rig = Some(Rig::parse(&found.bundle.rig(rig).to_json(), "of the waved instruments")?);
    Ok(outcome)
}

/// The rig as it is, which holds.
fn kept(rig: &Rig, judgement: &Judgement, why: String, stream: &Stream) -> Result<Outcome> {
    let mut outcome = Outcome { rig: Some(rig.clone()), ..Outcome::default() };
    let record = &mut outcome.record;
    record.kept = true;
    record.summary = format!("{:.0} s of waved instruments: {}", stream.seconds, judgement.text());
    record.notes.push(why);
    let (seen, bundle) = fitted(rig, &stream.seen(rig)?)?;
    pictures(rig, &residuals_of(&seen, &bundle), &mut outcome)?;
    Ok(outcome)
}

/// How a rig fits a stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fit {
    /// Root mean square of what is left of all blobs; one that fits no marker counts as 2 px.
    pub left_px: f64,
    /// Share of the blobs that fit.
    pub share: f64,
}

impl Fit {
    /// Of a rig that is trusted.
    pub(crate) fn of(rig: &Rig, fields: &[BlobField]) -> Self {
        let left = measure(rig, fields);
        let share = left.explained.count as f64 / left.all.count.max(1) as f64;
        Fit { left_px: left.mean().sqrt(), share }
    }
}

impl std::fmt::Display for Fit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} px, {:.1} % of the blobs fit", self.left_px, 100.0 * self.share)
    }
}

/// The figures of a report in a record.
pub(crate) fn add_figures(report: &Report, record: &mut Record) {
    for figure in &report.figures {
        let sigma = figure.sigma.map(|s| format!(" ± {s:.4}")).unwrap_or_default();
        let whole = figure.unit.is_empty() && figure.value.fract() == 0.0;
        let digits = if whole { 0 } else { 4 };
        record.figure(&figure.name, format!("{:.digits$}{sigma} {}", figure.value, figure.unit).trim_end());
    }
    record.notes.extend(report.notes.iter().cloned());
}

/// Instants of a stream or of live cameras with the rig.
pub(crate) fn instants(
    folder: &Folder,
    rig: &Rig,
    origin: Origin<'_>,
) -> Result<(Stream, Vec<calibration::observations::FrameObservations>)> {
    let stream = stream::load(rig, origin, folder.colours().as_deref())?;
    let seen = stream.seen(rig)?;
    Ok((stream, seen))
}
