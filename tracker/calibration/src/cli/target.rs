//! Calibrations that look at a target: `intrinsics`, `stereo`, `dots`.

use super::{OutputArgs, SolveArgs, pair, positive, progress, short, with_spinner};
use crate::board::{Board, Pattern};
use crate::fixed_dots::{CameraPrior, calibrate_on_dots, common_dots, held_out};
use crate::grey_image::GreyImage;
use crate::known_target::match_dots;
use crate::lens::{LENS, LENS_NAMES};
use crate::linear::plane_of;
use crate::multi_camera::{LensMode, calibrate_cameras};
use crate::report::{Report, camera_report, view_reports};
use crate::rig_output::{rig_camera, rig_with, rig_with_lens};
use crate::target_problem::{Calibrated, FreeParameters, Robustness, TargetView, calibrate_lens};
use crate::{CalibrationError, dots, point_lists};
use anyhow::{Context, bail, ensure};
use ipc::logging::warn;
use rig::Rig;
use rig::camera::Camera;
use std::path::PathBuf;
use std::process::ExitCode;

/// What the board is.
#[derive(Debug, Clone, clap::Args)]
pub struct BoardArgs {
    /// Points of the board: inner corners (or dots) in a row, and rows.
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = pair)]
    pub board: Option<[u32; 2]>,
    /// Distance of neighbouring points, mm; without it lengths are in squares.
    #[arg(long, value_name = "MM", default_value = "1", value_parser = positive)]
    pub pitch: f64,
    /// What is printed on the board.
    #[arg(long, value_enum, default_value = "chessboard")]
    pub pattern: Pattern,
}

impl BoardArgs {
    /// The board.
    ///
    /// # Errors
    /// No size, or too many points.
    pub fn board(&self) -> anyhow::Result<Board> {
        let size = self.board.context("--board COLUMNSxROWS is needed to read pictures")?;
        let [columns, rows] = size.map(|n| n as usize);
        ensure!(columns * rows <= 10_000, "--board: expected at most 10000 points, found {columns}x{rows}");
        Ok(Board { pattern: self.pattern, columns, rows, pitch_mm: self.pitch })
    }
}

/// Arguments of `vitreo calibrate intrinsics`.
#[derive(Debug, Clone, clap::Args)]
pub struct IntrinsicsArgs {
    /// Pictures of the board (PNG, JPEG), held differently in each.
    #[arg(value_name = "PICTURE", required_unless_present = "points", conflicts_with = "points")]
    pub pictures: Vec<PathBuf>,
    #[command(flatten)]
    pub board: BoardArgs,
    /// Point lists instead of pictures: CSV, JSON or five columns.
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "size")]
    pub points: Vec<PathBuf>,
    /// Size of the pictures that point lists came from, px.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair)]
    pub size: Option<[u32; 2]>,
    /// Rig whose camera gets the lens; else the camera alone is written.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Id of the camera.
    #[arg(long, value_name = "ID", default_value_t = 0)]
    pub camera: u32,
    #[command(flatten)]
    pub solve: SolveArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Arguments of `vitreo calibrate stereo`.
#[derive(Debug, Clone, clap::Args)]
pub struct StereoArgs {
    /// Pictures of the first camera.
    #[arg(long, value_name = "PICTURE", num_args = 1.., required_unless_present = "points")]
    pub left: Vec<PathBuf>,
    /// Pictures of the second camera at the same instants, in the same order.
    #[arg(long, value_name = "PICTURE", num_args = 1.., required_unless_present = "points")]
    pub right: Vec<PathBuf>,
    /// Instead of pictures a point list of each camera, of two or more; views of one name are of
    /// one instant.
    #[arg(long, value_name = "FILE", num_args = 2.., requires = "size", conflicts_with_all = ["left", "right"])]
    pub points: Vec<PathBuf>,
    /// Size of the pictures that point lists came from, px.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair)]
    pub size: Option<[u32; 2]>,
    #[command(flatten)]
    pub board: BoardArgs,
    /// Keep the lenses that each camera alone gives, or those of the rig, if one is named.
    #[arg(long)]
    pub keep_lenses: bool,
    /// Rig whose cameras are replaced; its markers and sizes stay. Without it the shipped one.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    #[command(flatten)]
    pub solve: SolveArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Arguments of `vitreo calibrate dots`.
#[derive(Debug, Clone, clap::Args)]
pub struct DotsArgs {
    /// Point list of each camera, camera 0 first.
    #[arg(value_name = "POINTS", required_unless_present = "pictures")]
    pub points: Vec<PathBuf>,
    /// Instead of lists a picture of the target by each camera.
    #[arg(long, value_name = "PICTURE", num_args = 1.., requires = "target", requires = "picked", conflicts_with = "points")]
    pub pictures: Vec<PathBuf>,
    /// Dots of the target in the pictures: X Y Z a line, mm.
    #[arg(long, value_name = "FILE")]
    pub target: Option<PathBuf>,
    /// For each picture a point list of four dots or more that a person picked, not all in one
    /// plane.
    #[arg(long, value_name = "POINTS", num_args = 1..)]
    pub picked: Vec<PathBuf>,
    /// Size of the pictures, px; lenses are then found too.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair)]
    pub size: Option<[u32; 2]>,
    /// Rig whose cameras are replaced. Without --size its lenses are kept and only places are
    /// found.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Also calibrate on a random half of the dots that all cameras see and triangulate the other
    /// half, so many times; the report has the median errors.
    #[arg(long, value_name = "TIMES")]
    pub splits: Option<u32>,
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
        notes.extend(problem.as_ref().map(|p| format!("{} passed over: {p}", sheet.name)));
        problem.is_none()
    });
    notes
}

/// Boards in the pictures of one camera, which are of one size.
fn views_of_pictures(pictures: &[PathBuf], board: &Board, camera: usize) -> anyhow::Result<Views> {
    let progress = progress("pictures", Some(pictures.len() as u64));
    let (mut sheets, mut notes, mut size) = (Vec::new(), Vec::new(), None);
    for (view, path) in pictures.iter().enumerate() {
        let picture = GreyImage::load(path)?;
        let [x, y] = [picture.width as u32, picture.height as u32];
        let [w, h] = *size.get_or_insert([x, y]);
        ensure!(
            [x, y] == [w, h],
            "{}: expected {w}×{h} px as in the pictures before, found {x}×{y}",
            path.display()
        );
        match board.find(&picture) {
            Ok(samples) => sheets.push(TargetView { name: short(path), camera, view, samples }),
            Err(problem) => notes.push(format!("{} passed over: {problem}", path.display())),
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    if sheets.is_empty() {
        notes.iter().skip(1).for_each(|n| warn(n));
        let first = notes.first().cloned().unwrap_or_default();
        bail!("the board was found in none of {} pictures: {first}", pictures.len());
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

fn report_of(task: &'static str, found: &Calibrated, sheets: &[TargetView], notes: Vec<String>) -> Report {
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

/// Runs `vitreo calibrate intrinsics`.
///
/// # Errors
/// Pictures, lists or a rig that cannot be read, too few or degenerate views, or no solution.
pub fn intrinsics(args: &IntrinsicsArgs) -> anyhow::Result<ExitCode> {
    let Views { sheets, sizes_px, notes } = if args.points.is_empty() {
        views_of_pictures(&args.pictures, &args.board.board()?, 0)?
    } else {
        let size = args.size.context("--size is needed with --points")?;
        let mut sheets = sheets_of_lists(&args.points, 0)?;
        let all = sheets.len();
        let notes = pass_over_weak(&mut sheets);
        ensure!(!sheets.is_empty(), "none of {all} views can be used: {}", notes.join("; "));
        Views { sheets, sizes_px: vec![size], notes }
    };
    let rig = args.rig.as_deref().map(Rig::load).transpose()?;
    let free = FreeParameters { lens: args.solve.free(), place: false };
    let found = with_spinner("least squares", |tell| {
        calibrate_lens(args.camera, sizes_px[0], &sheets, free, args.solve.loss, tell)
    })?;
    let camera = &found.scene.cameras[0];
    let json = match &rig {
        None => serde_json::to_string_pretty(&rig_camera(camera))?,
        Some(rig) => rig_with_lens(rig, camera)
            .with_context(|| format!("--camera {}: the rig has no such camera", args.camera))?
            .to_json(),
    };
    let report = report_of("intrinsics", &found, &sheets, notes);
    args.output.print(&report, &found.scene.cameras, &found.residuals)?;
    args.output.write(&json)?;
    Ok(ExitCode::SUCCESS)
}

/// Boards of two cameras' pictures.
fn views_of_pairs(args: &StereoArgs) -> anyhow::Result<Views> {
    let (l, r) = (args.left.len(), args.right.len());
    ensure!(l == r, "expected as many right as left pictures, found {l} left and {r} right");
    let board = args.board.board()?;
    let mut views = views_of_pictures(&args.left, &board, 0)?;
    let right = views_of_pictures(&args.right, &board, 1)?;
    views.sheets.extend(right.sheets);
    views.sizes_px.extend(right.sizes_px);
    views.notes.extend(right.notes);
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
    Ok(Views { sheets, sizes_px: vec![size; args.points.len()], notes })
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
    let mut report = report_of("stereo", &found, &sheets, notes);
    for camera in &found.scene.cameras[1..] {
        let name = format!("baseline from camera 0 to camera {} (squares without --pitch)", camera.id);
        report.figure(name, camera.centre_in_world().coords.norm(), "mm");
    }
    finish(&args.output, &report, &found, &template)
}

/// Prints the report and writes `template` with the calibrated cameras.
fn finish(out: &OutputArgs, report: &Report, found: &Calibrated, template: &Rig) -> anyhow::Result<ExitCode> {
    out.print(report, &found.scene.cameras, &found.residuals)?;
    if out.output.is_some() {
        out.write(&rig_with(template, &found.scene.cameras)?.to_json())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Point lists of dots that stay in place, one a camera.
fn sheets_of_dots(args: &DotsArgs) -> anyhow::Result<Vec<TargetView>> {
    let mut sheets = Vec::new();
    for (camera, path) in args.points.iter().enumerate() {
        let mut views = sheets_of_lists(std::slice::from_ref(path), camera)?;
        let n = views.len();
        ensure!(n == 1, "{}: expected dots that stay in place, found {n} views", path.display());
        sheets.append(&mut views);
    }
    Ok(sheets)
}

/// The target's dots in a picture of each camera, and the pictures' sizes.
fn sheets_of_target(args: &DotsArgs) -> anyhow::Result<(Vec<TargetView>, Vec<[u32; 2]>)> {
    let target =
        point_lists::load_target(args.target.as_deref().context("--target is needed with --pictures")?)?;
    let (pictures, lists) = (args.pictures.len(), args.picked.len());
    ensure!(pictures == lists, "--picked: expected a list for each of {pictures} pictures, found {lists}");
    let progress = progress("pictures", Some(pictures as u64));
    let (mut sheets, mut sizes) = (Vec::new(), Vec::new());
    for (camera, (path, picked)) in args.pictures.iter().zip(&args.picked).enumerate() {
        let picture = GreyImage::load(path)?;
        let own = [picture.width as u32, picture.height as u32];
        if let Some([w, h]) = args.size {
            let ([x, y], file) = (own, path.display());
            ensure!([x, y] == [w, h], "{file}: expected {w}×{h} px by --size, found {x}×{y}");
        }
        // Picking programs write (-1, -1) for a dot that was not seen.
        let picked = point_lists::load(picked)?.into_iter().flat_map(|v| v.samples);
        let picked: Vec<_> = picked.filter(|s| s.pixel.x >= 0.0 && s.pixel.y >= 0.0).collect();
        let [bright, dark] = [false, true].map(|dark| dots::find(&picture, dark));
        let (n, file) = (target.len(), path.display());
        ensure!(
            !bright.is_empty() || !dark.is_empty(),
            "{file}: expected the {n} dots of the target, round and on an even ground, found none"
        );
        let of_colour = |dots: &[dots::Dot]| match_dots(own, dots, &target, &picked);
        let samples = match (of_colour(&bright), of_colour(&dark)) {
            (Ok(bright), Ok(dark)) if dark.len() > bright.len() => dark,
            (Ok(found), _) | (Err(_), Ok(found)) => found,
            (Err(problem), Err(_)) => return Err(problem).with_context(|| path.display().to_string()),
        };
        sizes.push(own);
        sheets.push(TargetView { name: short(path), camera, view: 0, samples });
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok((sheets, sizes))
}

/// Runs `vitreo calibrate dots`.
///
/// # Errors
/// As [`intrinsics`]; lists or pictures that do not fit the cameras.
pub fn fixed_dots(args: &DotsArgs) -> anyhow::Result<ExitCode> {
    let template = Rig::load_or_shipped(args.rig.as_deref())?;
    let (sheets, sizes) =
        if args.pictures.is_empty() { (sheets_of_dots(args)?, Vec::new()) } else { sheets_of_target(args)? };
    let before: Vec<CameraPrior> = match (args.size, &args.rig) {
        (Some(size), _) => vec![CameraPrior::Size(size); sheets.len()],
        (None, None) if !sizes.is_empty() => sizes.iter().copied().map(CameraPrior::Size).collect(),
        (None, _) => template.cameras().into_iter().map(CameraPrior::Lens).collect(),
    };
    let (lists, cameras) = (sheets.len(), before.len());
    ensure!(lists == cameras, "expected a point list of each of the rig's {cameras} cameras, found {lists}");
    for ((before, [x, y]), path) in before.iter().zip(sizes).zip(&args.pictures) {
        if let CameraPrior::Lens(Camera { id, size_px: [w, h], .. }) = before {
            let fits = [x, y] == [*w, *h];
            ensure!(fits, "{}: expected {w}×{h} px of camera {id}, found {x}×{y}", path.display());
        }
    }
    let (free, loss) = (args.solve.free(), args.solve.loss);
    let found = calibrate_on_dots(&before, &sheets, free, loss, &mut |_, _| {})?;
    let mut notes = vec!["the world is the frame of the dots".into()];
    notes.extend(found.left_out.iter().map(|&(camera, term)| {
        format!("camera {camera}: its dots do not determine {}, which is held at 0", LENS_NAMES[term])
    }));
    let mut report = report_of("dots", &found, &sheets, notes);
    if let Some(times) = args.splits {
        let [x, y, z] = median_of_splits(&before, &sheets, free, loss, times)?;
        for (axis, value) in [("x", x), ("y", y), ("z", z)] {
            let name = format!("dots held out: rms error along {axis}, {times} splits");
            report.figure(name, value * 1e3, "µm");
        }
    }
    finish(&args.output, &report, &found, &template)
}

/// Median errors over random halves; split `n` is the same on every machine.
fn median_of_splits(
    before: &[CameraPrior],
    sheets: &[TargetView],
    free: [bool; LENS],
    loss: Robustness,
    times: u32,
) -> anyhow::Result<[f64; 3]> {
    ensure!((1..=10_000).contains(&times), "--splits: expected 1 to 10000, found {times}");
    let dots = common_dots(sheets, before.len()).len();
    ensure!(dots >= 24, "--splits: expected 24 dots or more that all cameras see, found {dots}");
    let progress = progress("splits", Some(times.into()));
    let split = |seed: u32| -> Result<[f64; 3], CalibrationError> {
        let chosen = random_half(dots, seed);
        let errors = held_out(before, sheets, free, loss, &|i| chosen[i]);
        progress.inc(1);
        errors
    };
    let all = (1..=times).map(split).collect::<Result<Vec<_>, _>>()?;
    progress.finish_and_clear();
    Ok([0, 1, 2].map(|axis| {
        let mut errors: Vec<f64> = all.iter().map(|e| e[axis]).collect();
        errors.sort_by(f64::total_cmp);
        (errors[(errors.len() - 1) / 2] + errors[errors.len() / 2]) / 2.0
    }))
}

/// Half of `n` things, drawn by a shuffle from `seed` (Fisher–Yates with Knuth's MMIX generator).
fn random_half(n: usize, seed: u32) -> Vec<bool> {
    let mut state = u64::from(seed);
    let mut draw = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize) % below
    };
    // The first numbers of neighbouring seeds are alike.
    for _ in 0..8 {
        draw(2);
    }
    let mut order: Vec<usize> = (0..n).collect();
    (1..n).rev().for_each(|i| order.swap(i, draw(i + 1)));
    let mut chosen = vec![false; n];
    order[..n / 2].iter().for_each(|&i| chosen[i] = true);
    chosen
}
