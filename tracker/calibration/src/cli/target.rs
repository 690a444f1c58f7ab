//! The calibration of one lens on a board, `intrinsics`, and what all calibrations on targets share.

use super::checks::{self, NotCompared};
use super::lens_checks::{Determined, determined};
use super::recorded::{self, EveryArgs};
use super::{OutputArgs, SolveArgs, lists, pair, positive, progress, short, warn_of_refusal, with_spinner};
use crate::board::{Board, Pattern, Target};
use crate::charuco::CharucoBoard;
use crate::grey_image::GreyImage;
use crate::halves::HeldOut;
use crate::linear::plane_of;
use crate::report::{Report, camera_report, view_reports};
use crate::rig_output::{rig_camera, rig_with_lens, whole_frames};
use crate::target_problem::{Calibrated, FreeParameters, TargetView, calibrate_lens, lens_of_views};
use crate::{point_lists, repeats, wrong_points};
use anyhow::{Context, bail, ensure};
use fpga_model::input::whole::is_recording;
use ipc::logging::warn;
use outputs::exit::{DIFFERS, WrongUse};
use rig::Rig;
use rig::camera::Camera;
use std::path::PathBuf;
use std::process::ExitCode;

/// What the board is.
#[derive(Debug, Clone, clap::Args)]
pub struct BoardArgs {
    /// Size of the board: inner corners (or dots) per row, and number of rows.
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = pair, help_heading = "Board")]
    pub board: Option<[u32; 2]>,
    /// ChArUco board: squares per row, number of rows, side of a square in mm [default: 1], side of a marker in mm
    /// [default: 3/4 of a square], and OpenCV dictionary, DICT_4X4_50 to DICT_6X6_1000 [default: the smallest of 4×4
    /// with enough markers]. The board need not be entirely visible.
    #[arg(
        long, value_name = "COLUMNSxROWS[,SQUARE[,MARKER[,DICTIONARY]]]", value_parser = CharucoBoard::parse,
        conflicts_with_all = ["board", "pitch", "pattern"], help_heading = "Board"
    )]
    pub charuco: Option<CharucoBoard>,
    /// Use the ChArUco layout of OpenCV before 4.6: with an even number of rows, the first square is white.
    #[arg(long, requires = "charuco", conflicts_with_all = ["board", "pitch", "pattern"], help_heading = "Board")]
    pub legacy: bool,
    /// Distance between neighbouring points, mm. With the default, all lengths are in squares.
    #[arg(long, value_name = "MM", default_value = "1", value_parser = positive, allow_negative_numbers = true, help_heading = "Board")]
    pub pitch: f64,
    /// Pattern printed on the board.
    #[arg(long, value_enum, default_value = "chessboard", help_heading = "Board")]
    pub pattern: Pattern,
}

impl BoardArgs {
    /// True where a board is named.
    pub fn is_given(&self) -> bool {
        self.board.is_some() || self.charuco.is_some()
    }

    /// The board.
    ///
    /// # Errors
    /// No board, or one of too many points.
    pub fn board(&self) -> anyhow::Result<Target> {
        if let Some(board) = self.charuco {
            return Ok(Target::Charuco(CharucoBoard { legacy: self.legacy, ..board }));
        }
        let size = self.board.ok_or_else(|| {
            WrongUse("expected a board: --board COLUMNSxROWS, or --charuco COLUMNSxROWS[,…]".into())
        })?;
        let [columns, rows] = size.map(|n| n as usize);
        ensure!(columns * rows <= 10_000, "--board: expected at most 10000 points, found {columns}x{rows}");
        Ok(Target::Whole(Board { pattern: self.pattern, columns, rows, pitch_mm: self.pitch }))
    }
}

/// Arguments of `vitreo calibrate intrinsics`.
#[derive(Debug, Clone, clap::Args)]
pub struct IntrinsicsArgs {
    /// Pictures of the board (PNG, JPEG), in a different pose in each, or a recording of vitreo cameras
    /// --record-fields (.mcap).
    #[arg(value_name = "PICTURE", required_unless_present = "points", conflicts_with = "points")]
    pub pictures: Vec<PathBuf>,
    /// Point lists instead of pictures: CSV, JSON or five columns.
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "size", help_heading = "Pictures")]
    pub points: Vec<PathBuf>,
    /// Size in px of the pictures from which the point lists were made.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair, help_heading = "Pictures")]
    pub size: Option<[u32; 2]>,
    /// Id of the camera in the rig and in a recording.
    #[arg(long, value_name = "ID", default_value_t = 0)]
    pub camera: u32,
    /// Rig whose camera gets the lens [default: only the camera is written].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    #[command(flatten)]
    pub every: EveryArgs,
    #[command(flatten)]
    pub board: BoardArgs,
    #[command(flatten)]
    pub solve: SolveArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Fewest points of a view in a list; a homography has eight unknowns and a pose six more.
const FEWEST_POINTS: usize = 6;

/// What cameras saw.
pub(super) struct Views {
    pub(super) sheets: Vec<TargetView>,
    /// Size of the pictures of each camera, px.
    pub(super) sizes_px: Vec<[u32; 2]>,
    /// What was passed over.
    pub(super) notes: Vec<String>,
}

/// Takes out views that cannot hold a pose, and says which.
pub(super) fn pass_over_weak(sheets: &mut Vec<TargetView>) -> Vec<String> {
    let mut notes = Vec::new();
    sheets.retain(|sheet| {
        let n = sheet.samples.len();
        let problem = match plane_of(&sheet.samples) {
            _ if n < FEWEST_POINTS => Some(format!("{n} points, at least {FEWEST_POINTS} are needed")),
            Err(problem) => Some(problem.to_string()),
            Ok(_) => None,
        };
        notes.extend(problem.as_ref().map(|p| format!("{} skipped: {p}", sheet.name)));
        problem.is_none()
    });
    notes
}

/// Boards in the pictures of one camera, which are of one size.
struct Search<'a> {
    board: &'a Target,
    /// Its index among the calibrated cameras.
    camera: usize,
    size: Option<[u32; 2]>,
    sheets: Vec<TargetView>,
    notes: Vec<String>,
}

impl Search<'_> {
    /// Looks at one picture; `short` is its name in tables.
    fn look(&mut self, view: usize, name: &str, short: String, picture: &GreyImage) -> anyhow::Result<()> {
        let [x, y] = [picture.width as u32, picture.height as u32];
        let [w, h] = *self.size.get_or_insert([x, y]);
        ensure!([x, y] == [w, h], "{name}: expected {w}×{h} px as in the pictures before, found {x}×{y}");
        match self.board.find(picture) {
            Ok(samples) => {
                self.sheets.push(TargetView { name: short, camera: self.camera, view, samples });
            }
            Err(problem) => self.notes.push(format!("{name} skipped: {problem}")),
        }
        Ok(())
    }
}

/// Boards in pictures, or in those of camera `id` in a recording.
pub(super) fn views_of_pictures(
    pictures: &[PathBuf],
    board: &Target,
    camera: usize,
    (id, every): (u32, EveryArgs),
) -> anyhow::Result<Views> {
    let mut search = Search { board, camera, size: None, sheets: Vec::new(), notes: Vec::new() };
    let is_recorded = pictures.iter().any(|path| is_recording(path));
    ensure!(!is_recorded || pictures.len() == 1, "expected one recording (.mcap) or pictures, found both");
    let progress = progress("pictures", (!is_recorded).then_some(pictures.len() as u64));
    for (view, path) in pictures.iter().enumerate() {
        if is_recorded {
            recorded::each(path, id, every, |number, name, picture| {
                progress.inc(1);
                search.look(number as usize, &name, format!("{} {number}", short(path)), picture)
            })?;
        } else {
            search.look(view, &path.display().to_string(), short(path), &GreyImage::load(path)?)?;
            progress.inc(1);
        }
    }
    progress.finish_and_clear();
    let Search { size, sheets, notes, .. } = search;
    if sheets.is_empty() {
        notes.iter().skip(1).for_each(|n| warn(n));
        let first = notes.first().cloned().unwrap_or_default();
        bail!("the board was not found in any of {} pictures: {first}", notes.len());
    }
    Ok(Views { sheets, sizes_px: vec![size.context("no picture")?], notes })
}

/// Views of the point lists of one camera.
fn sheets_of_lists(lists: &[PathBuf], camera: usize) -> anyhow::Result<Vec<TargetView>> {
    let mut sheets: Vec<TargetView> = Vec::new();
    for path in lists {
        for view in point_lists::load(path)? {
            let name =
                if view.name.is_empty() { short(path) } else { format!("{} {}", short(path), view.name) };
            sheets.push(TargetView { name, camera, view: sheets.len(), samples: view.samples });
        }
    }
    Ok(sheets)
}

pub(super) fn report_of(
    task: &'static str,
    found: &Calibrated,
    sheets: &[TargetView],
    notes: Vec<String>,
) -> Report {
    let cameras = found.scene.cameras.iter().zip(&found.sigmas).enumerate();
    Report {
        task,
        rms_px: found.rms_px,
        sigma_px: found.sigma_px,
        iterations: found.iterations,
        cameras: cameras.map(|(i, (camera, s))| camera_report(camera, s, &found.residuals, i)).collect(),
        sheets: view_reports(sheets.iter().map(|s| s.name.as_str()), &found.residuals),
        figures: Vec::new(),
        notes,
    }
}

/// Views of one camera, in pictures or point lists.
fn views_of_camera(args: &IntrinsicsArgs) -> anyhow::Result<Views> {
    if args.points.is_empty() {
        let from = (args.camera, args.every);
        let mut views = views_of_pictures(&args.pictures, &args.board.board()?, 0, from)?;
        repeats::number_anew(&mut views.sheets);
        return Ok(views);
    }
    let size = args.size.context("--size is needed with --points")?;
    let mut sheets = sheets_of_lists(&args.points, 0)?;
    let all = sheets.len();
    let mut notes = pass_over_weak(&mut sheets);
    ensure!(!sheets.is_empty(), "none of {all} views can be used: {}", notes.join("; "));
    checks::inside(&sheets, &[size], "--size")?;
    notes.extend(lists::doubt_of_size(&sheets, size));
    Ok(Views { sheets, sizes_px: vec![size], notes })
}

/// Takes out of views what says nothing of the lens: wrong points, and views that repeat another one.
pub(super) fn sift(views: &mut Views) {
    let Views { sheets, sizes_px, notes } = views;
    notes.extend(wrong_points::take_out(sheets, sizes_px));
    notes.extend(repeats::take_out(sheets));
}

/// What was passed over, after the message of an error that it may explain.
pub(super) fn with_notes(problem: impl Into<anyhow::Error>, notes: &[String]) -> anyhow::Error {
    let problem = problem.into();
    if notes.is_empty() { problem } else { anyhow::anyhow!("{problem}; {}", notes.join("; ")) }
}

/// Runs `vitreo calibrate intrinsics`.
///
/// # Errors
/// Pictures, lists or a rig that cannot be read, too few or degenerate views, or no solution.
pub fn intrinsics(args: &IntrinsicsArgs) -> anyhow::Result<ExitCode> {
    let mut views = views_of_camera(args)?;
    let rig = args.rig.as_deref().map(Rig::load).transpose()?;
    let before = rig.as_ref().and_then(|rig| rig.cameras().into_iter().find(|c| c.id == args.camera));
    if let Some(Camera { id, size_px, .. }) = &before {
        let ([w, h], [x, y]) = (*size_px, views.sizes_px[0]);
        ensure!(
            [x, y] == [w, h],
            "expected pictures of {w}×{h} px, as camera {id} of the rig has, found {x}×{y}"
        );
    }
    sift(&mut views);
    let Views { sheets, sizes_px, mut notes } = views;
    let (free, loss) = (FreeParameters { lens: args.solve.free(), place: false }, args.solve.loss);
    let found = with_spinner("least squares", |tell| {
        calibrate_lens(args.camera, sizes_px[0], &sheets, free, loss, tell)
    });
    let found = found.map_err(|problem| with_notes(problem, &notes))?;
    notes.extend(checks::remarks(&found, &sheets));
    let Determined { notes: doubts, weak, refusals } = determined(&found, &sheets);
    ensure!(refusals.is_empty(), "{}", refusals.join("; "));
    notes.extend(doubts);
    let held_out = before.as_ref().filter(|_| args.output.output.is_some()).map(|before| {
        let learnt =
            |part: &[TargetView]| lens_of_views(args.camera, sizes_px[0], part, free, loss, &mut |_, _| {});
        HeldOut::of_views(std::slice::from_ref(before), &sheets, learnt).ok_or(NotCompared::TooFewViews)
    });
    let camera = &found.scene.cameras[0];
    let json = match &rig {
        None => serde_json::to_string_pretty(&rig_camera(camera))?,
        Some(rig) => rig_with_lens(rig, camera)
            .with_context(|| format!("--camera {}: the rig has no such camera", args.camera))?
            .to_json(),
    };
    let mut report = report_of("intrinsics", &found, &sheets, notes);
    checks::add_doubts(&found, &mut report);
    finish_unless(weak, &args.output, report, &found, held_out, || Ok(json))
}

/// Fits the shipped rig to pictures of these sizes, if no rig is given; returns a note on what the result has from it: its
/// timing is not that of the cameras.
pub(super) fn fit_timing(template: &mut Rig, sizes_px: &[[u32; 2]]) -> String {
    let timing = match whole_frames(template, sizes_px) {
        Some(fitted) => {
            *template = fitted;
            "whole frames".to_owned()
        }
        None => format!("the shipped rig's scan ({}) and timing, with fields", template.scan.name()),
    };
    format!(
        "without --rig, the rig has {timing} at {} Hz: set field_hz, line_ns, exposure_ns, scan and shutter to those of \
         the cameras; its bodies, trocars and workspace are those of the shipped rig",
        template.field_hz
    )
}

/// Prints the report and writes the result, unless there are `refusals` or the rig as it was predicts held-out points
/// better.
pub(super) fn finish_unless(
    mut refusals: Vec<String>,
    out: &OutputArgs,
    mut report: Report,
    found: &Calibrated,
    held_out: Option<Result<HeldOut, NotCompared>>,
    json: impl FnOnce() -> anyhow::Result<String>,
) -> anyhow::Result<ExitCode> {
    refusals.extend(checks::judged(held_out, &mut report));
    let refused = (!refusals.is_empty()).then(|| {
        let kept = if out.output.is_some() { "nothing was written: " } else { "" };
        format!("{kept}{}", refusals.join("; "))
    });
    report.notes.extend(refused.clone());
    out.print(&report, &found.scene.cameras, &found.residuals)?;
    if let Some(refused) = refused {
        warn_of_refusal(&refused);
        return Ok(ExitCode::from(DIFFERS));
    }
    if out.output.is_some() {
        out.write(&json()?)?;
    }
    Ok(ExitCode::SUCCESS)
}
