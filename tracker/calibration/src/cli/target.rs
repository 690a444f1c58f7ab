//! Calibrations that look at a board: `intrinsics`, `stereo`.

use super::checks;
use super::recorded::{self, EveryArgs};
use super::{OutputArgs, SolveArgs, pair, positive, progress, short, with_spinner};
use crate::board::{Board, Pattern, Target};
use crate::charuco::CharucoBoard;
use crate::grey_image::GreyImage;
use crate::halves::HeldOut;
use crate::linear::plane_of;
use crate::multi_camera::{LensMode, calibrate_cameras};
use crate::point_lists;
use crate::report::{Report, camera_report, view_reports};
use crate::rig_output::{rig_camera, rig_with, rig_with_lens};
use crate::target_problem::{Calibrated, FreeParameters, TargetView, calibrate_lens};
use anyhow::{Context, bail, ensure};
use fpga_model::input::whole::is_recording;
use ipc::logging::warn;
use outputs::exit::{DIFFERS, WrongUse};
use rig::Rig;
use rig::camera::Camera;
use std::collections::BTreeSet;
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

/// Arguments of `vitreo calibrate stereo`.
#[derive(Debug, Clone, clap::Args)]
pub struct StereoArgs {
    /// Pictures of the first camera, or a recording (.mcap).
    #[arg(long, value_name = "PICTURE", num_args = 1.., required_unless_present = "points", help_heading = "Pictures")]
    pub left: Vec<PathBuf>,
    /// Pictures of the second camera at the same instants, in the same order, or the same recording.
    #[arg(long, value_name = "PICTURE", num_args = 1.., required_unless_present = "points", help_heading = "Pictures")]
    pub right: Vec<PathBuf>,
    #[command(flatten)]
    pub every: EveryArgs,
    /// Ids of the first and second camera in a recording.
    #[arg(long, value_name = "ID", num_args = 2, default_values_t = [0, 1], help_heading = "Pictures")]
    pub recorded: Vec<u32>,
    /// Point lists instead of pictures, one per camera for two or more cameras; views with the same name were taken at
    /// the same time.
    #[arg(
        long, value_name = "FILE", num_args = 2.., requires = "size", conflicts_with_all = ["left", "right"],
        help_heading = "Pictures"
    )]
    pub points: Vec<PathBuf>,
    /// Size in px of the pictures from which the point lists were made.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair, help_heading = "Pictures")]
    pub size: Option<[u32; 2]>,
    #[command(flatten)]
    pub board: BoardArgs,
    /// Do not refine the lenses with the poses: keep those of --rig, or without it those found for each camera alone.
    #[arg(long, help_heading = "Solver")]
    pub keep_lenses: bool,
    /// Rig whose cameras are replaced; its markers and dimensions stay [default: the shipped rig].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    #[command(flatten)]
    pub solve: SolveArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Fewest points of a view in a list; a homography has eight unknowns and a pose six more.
const FEWEST_POINTS: usize = 6;

/// What cameras saw.
struct Views {
    sheets: Vec<TargetView>,
    /// Size of the pictures of each camera, px.
    sizes_px: Vec<[u32; 2]>,
    /// What was passed over.
    notes: Vec<String>,
}

/// Takes out views that cannot hold a pose, and says which.
fn pass_over_weak(sheets: &mut Vec<TargetView>) -> Vec<String> {
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
fn views_of_pictures(
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

/// Numbers views from 0 without gaps, as pictures of a recording are not.
fn renumber(sheets: &mut [TargetView]) {
    let views: BTreeSet<usize> = sheets.iter().map(|sheet| sheet.view).collect();
    let place = |view: usize| views.range(..view).count();
    sheets.iter_mut().for_each(|sheet| sheet.view = place(sheet.view));
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
        renumber(&mut views.sheets);
        return Ok(views);
    }
    let size = args.size.context("--size is needed with --points")?;
    let mut sheets = sheets_of_lists(&args.points, 0)?;
    let all = sheets.len();
    let notes = pass_over_weak(&mut sheets);
    ensure!(!sheets.is_empty(), "none of {all} views can be used: {}", notes.join("; "));
    checks::inside(&sheets, &[size], "--size")?;
    Ok(Views { sheets, sizes_px: vec![size], notes })
}

/// Runs `vitreo calibrate intrinsics`.
///
/// # Errors
/// Pictures, lists or a rig that cannot be read, too few or degenerate views, or no solution.
pub fn intrinsics(args: &IntrinsicsArgs) -> anyhow::Result<ExitCode> {
    let Views { sheets, sizes_px, mut notes } = views_of_camera(args)?;
    let rig = args.rig.as_deref().map(Rig::load).transpose()?;
    let before = rig.as_ref().and_then(|rig| rig.cameras().into_iter().find(|c| c.id == args.camera));
    if let Some(Camera { id, size_px, .. }) = &before {
        let ([w, h], [x, y]) = (*size_px, sizes_px[0]);
        ensure!(
            [x, y] == [w, h],
            "expected pictures of {w}×{h} px, as camera {id} of the rig has, found {x}×{y}"
        );
    }
    let free = FreeParameters { lens: args.solve.free(), place: false };
    let lens = |sheets: &[TargetView], tell: &mut dyn FnMut(usize, f64)| {
        calibrate_lens(args.camera, sizes_px[0], sheets, free, args.solve.loss, tell)
    };
    let found = with_spinner("least squares", |tell| lens(&sheets, tell))?;
    notes.extend(checks::remarks(&found, &sheets));
    notes.extend(checks::held_well(&found)?);
    let held_out = before.as_ref().filter(|_| args.output.output.is_some()).map(|before| {
        HeldOut::of_views(std::slice::from_ref(before), &sheets, |half| lens(half, &mut |_, _| {}))
            .ok_or_else(|| "not compared with the rig's lens: the views are too few for halves".to_owned())
    });
    let camera = &found.scene.cameras[0];
    let json = match &rig {
        None => serde_json::to_string_pretty(&rig_camera(camera))?,
        Some(rig) => rig_with_lens(rig, camera)
            .with_context(|| format!("--camera {}: the rig has no such camera", args.camera))?
            .to_json(),
    };
    let report = report_of("intrinsics", &found, &sheets, notes);
    finish(&args.output, report, &found, held_out, || Ok(json))
}

/// Boards of two cameras' pictures.
fn views_of_pairs(args: &StereoArgs) -> anyhow::Result<Views> {
    let (l, r) = (args.left.len(), args.right.len());
    ensure!(l == r, "expected as many right as left pictures, found {l} left and {r} right");
    let board = args.board.board()?;
    let [first, second] = [args.recorded[0], args.recorded[1]].map(|id| (id, args.every));
    let mut views = views_of_pictures(&args.left, &board, 0, first)?;
    let right = views_of_pictures(&args.right, &board, 1, second)?;
    views.sheets.extend(right.sheets);
    views.sizes_px.extend(right.sizes_px);
    views.notes.extend(right.notes);
    renumber(&mut views.sheets);
    Ok(views)
}

/// Views of several cameras' point lists, put together by their names.
fn views_of_cameras(args: &StereoArgs) -> anyhow::Result<Views> {
    let size = args.size.context("--size is needed with --points")?;
    let (mut sheets, mut names) = (Vec::new(), Vec::<String>::new());
    for (camera, path) in args.points.iter().enumerate() {
        for view in point_lists::load(path)? {
            let at = names.iter().position(|n| *n == view.name).unwrap_or(names.len());
            if at == names.len() {
                names.push(view.name.clone());
            }
            let name = format!("{} {}", short(path), view.name);
            sheets.push(TargetView { name, camera, view: at, samples: view.samples });
        }
    }
    let notes = pass_over_weak(&mut sheets);
    let sizes_px = vec![size; args.points.len()];
    checks::inside(&sheets, &sizes_px, "--size")?;
    Ok(Views { sheets, sizes_px, notes })
}

/// Runs `vitreo calibrate stereo`.
///
/// # Errors
/// As [`intrinsics`]; cameras that share no views.
pub fn stereo(args: &StereoArgs) -> anyhow::Result<ExitCode> {
    let template = Rig::load_or_shipped(args.rig.as_deref())?;
    let Views { sheets, sizes_px, mut notes } =
        if args.points.is_empty() { views_of_pairs(args)? } else { views_of_cameras(args)? };
    let (free, loss) = (args.solve.free(), args.solve.loss);
    let lenses = match (args.keep_lenses, &args.rig) {
        (false, _) => LensMode::Refined,
        (true, None) => LensMode::Held,
        (true, Some(_)) => LensMode::Given(template.cameras()),
    };
    if let LensMode::Given(cameras) = &lenses {
        let (known, seen) = (cameras.len(), sizes_px.len());
        ensure!(known == seen, "--keep-lenses: expected a rig of {seen} cameras, found {known}");
    }
    let found = with_spinner("least squares", |tell| {
        calibrate_cameras(&sizes_px, &sheets, free, &lenses, loss, tell)
    })?;
    notes.push("the world is the frame of the first camera".into());
    notes.extend(checks::remarks(&found, &sheets));
    let mut report = report_of("stereo", &found, &sheets, notes);
    for camera in &found.scene.cameras[1..] {
        let name = format!("baseline from camera 0 to camera {} (squares without --pitch)", camera.id);
        report.figure(name, camera.centre_in_world().coords.norm(), "mm");
    }
    let compared = args.rig.as_ref().filter(|_| args.output.output.is_some());
    let held_out = compared.map(|_| {
        checks::beside(&template, &sizes_px, |before| {
            let learnt =
                |half: &[TargetView]| calibrate_cameras(&sizes_px, half, free, &lenses, loss, &mut |_, _| {});
            HeldOut::of_views(before, &sheets, learnt)
        })
    });
    finish(
        &args.output,
        report,
        &found,
        held_out,
        || Ok(rig_with(&template, &found.scene.cameras)?.to_json()),
    )
}

/// Prints the report and writes the result, unless the rig as it was predicts held-out points better.
pub(super) fn finish(
    out: &OutputArgs,
    mut report: Report,
    found: &Calibrated,
    held_out: Option<Result<HeldOut, String>>,
    json: impl FnOnce() -> anyhow::Result<String>,
) -> anyhow::Result<ExitCode> {
    let worse = checks::judged(held_out, &mut report);
    if let Some(why) = &worse {
        report.notes.push(format!("nothing was written: {why}"));
    }
    out.print(&report, &found.scene.cameras, &found.residuals)?;
    if let Some(why) = worse {
        warn(&format!("nothing was written: {why}"));
        return Ok(ExitCode::from(DIFFERS));
    }
    if out.output.is_some() {
        out.write(&json()?)?;
    }
    Ok(ExitCode::SUCCESS)
}
