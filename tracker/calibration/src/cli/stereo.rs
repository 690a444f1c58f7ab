//! Cameras that see the same board: `stereo`.

use super::checks::{self, NotCompared};
use super::lens_checks::{Determined, determined};
use super::lists::{doubt_of_size, expect_different};
use super::recorded::EveryArgs;
use super::target::{
    BoardArgs, Views, finish_unless, fit_timing, pass_over_weak, report_of, sift, views_of_pictures,
    with_notes,
};
use super::{OutputArgs, SolveArgs, pair, short, with_spinner};
use crate::exchanged::exchange;
use crate::halves::HeldOut;
use crate::multi_camera::{LensMode, calibrate_cameras, cameras_of_views};
use crate::relative_motion::contradiction;
use crate::rig_output::rig_with;
use crate::target_problem::{Calibrated, TargetView};
use crate::{point_lists, repeats};
use anyhow::{Context, ensure};
use rig::Rig;
use std::path::PathBuf;
use std::process::ExitCode;

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
    expect_different(&views.sheets, &[])?;
    repeats::number_anew(&mut views.sheets);
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
    expect_different(&sheets, &args.points)?;
    let mut notes = pass_over_weak(&mut sheets);
    notes.extend(doubt_of_size(&sheets, size));
    let sizes_px = vec![size; args.points.len()];
    checks::inside(&sheets, &sizes_px, "--size")?;
    Ok(Views { sheets, sizes_px, notes })
}

/// The rig that is replaced, and what is done with the lenses.
struct Before {
    template: Rig,
    lenses: LensMode,
}

/// Reads the rig, and checks that its lenses can be kept if they are to be.
fn before(args: &StereoArgs, sizes_px: &[[u32; 2]]) -> anyhow::Result<Before> {
    let template = Rig::load_or_shipped(args.rig.as_deref())?;
    let lenses = match (args.keep_lenses, &args.rig) {
        (false, _) => LensMode::Refined,
        (true, None) => LensMode::Held,
        (true, Some(_)) => LensMode::Given(template.cameras()),
    };
    if let LensMode::Given(cameras) = &lenses {
        let (known, seen) = (cameras.len(), sizes_px.len());
        ensure!(known == seen, "--keep-lenses: expected a rig of {seen} cameras, found {known}");
    }
    Ok(Before { template, lenses })
}

/// Reasons not to write what was found.
fn refusals(args: &StereoArgs, before: &Before, found: &Calibrated, views: &Views) -> Vec<String> {
    let Views { sheets, sizes_px, .. } = views;
    let given = args.rig.as_ref().map(|_| before.template.cameras());
    let comparable = given.filter(|cameras| cameras.iter().map(|c| &c.size_px).eq(sizes_px));
    let exchange = comparable.and_then(|cameras| exchange(&cameras, sheets));
    exchange.or_else(|| contradiction(found, sheets)).into_iter().collect()
}

/// Runs `vitreo calibrate stereo`.
///
/// # Errors
/// As [`super::target::intrinsics`]; cameras that share no views.
pub fn stereo(args: &StereoArgs) -> anyhow::Result<ExitCode> {
    let mut views = if args.points.is_empty() { views_of_pairs(args)? } else { views_of_cameras(args)? };
    let mut before = before(args, &views.sizes_px)?;
    sift(&mut views);
    let (free, loss) = (args.solve.free(), args.solve.loss);
    let found = with_spinner("least squares", |tell| {
        calibrate_cameras(&views.sizes_px, &views.sheets, free, &before.lenses, loss, tell)
    });
    let found = found.map_err(|problem| with_notes(problem, &views.notes))?;
    let mut notes = views.notes.clone();
    notes.push("the world is the frame of the first camera".into());
    if args.rig.is_none() && args.output.output.is_some() {
        notes.push(fit_timing(&mut before.template, &views.sizes_px));
    }
    notes.extend(checks::remarks(&found, &views.sheets));
    let mut refused = refusals(args, &before, &found, &views);
    if !matches!(before.lenses, LensMode::Given(_)) {
        let Determined { notes: doubts, weak, refusals } = determined(&found, &views.sheets);
        notes.extend(doubts);
        refused.extend(refusals.into_iter().chain(weak));
    }
    let mut report = report_of("stereo", &found, &views.sheets, notes);
    for camera in &found.scene.cameras[1..] {
        let name = format!("baseline from camera 0 to camera {} (squares without --pitch)", camera.id);
        report.figure(name, camera.centre_in_world().coords.norm(), "mm");
    }
    checks::add_doubts(&found, &mut report);
    let held_out = held_out(args, &before, &views);
    let json = || Ok(rig_with(&before.template, &found.scene.cameras)?.to_json());
    finish_unless(refused, &args.output, report, &found, held_out, json)
}

/// Residuals of held-out views, if a rig is replaced.
fn held_out(args: &StereoArgs, before: &Before, views: &Views) -> Option<Result<HeldOut, NotCompared>> {
    let Views { sheets, sizes_px, .. } = views;
    let (free, loss) = (args.solve.free(), args.solve.loss);
    let compared = args.rig.as_ref().filter(|_| args.output.output.is_some());
    compared.map(|_| {
        checks::beside(&before.template, sizes_px, |cameras| {
            let learnt = |part: &[TargetView]| {
                cameras_of_views(sizes_px, part, free, &before.lenses, loss, &mut |_, _| {})
            };
            HeldOut::of_views(cameras, sheets, learnt).ok_or(NotCompared::TooFewViews)
        })
    })
}
