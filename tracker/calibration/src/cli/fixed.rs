//! Calibrations that look at dots of known places: `dots`.

use super::checks::NotCompared;
use super::dots_checks::{self, Source};
use super::target::{finish_unless, fit_timing, report_of, with_notes};
use super::{OutputArgs, SolveArgs, checks, lists, pair, progress, recorded, short, with_spinner};
use crate::agreement::{Agreeing, calibrate_agreeing};
use crate::draws::Draws;
use crate::fixed_dots::{CameraPrior, calibrate_on_dots, common_dots, held_out};
use crate::grey_image::GreyImage;
use crate::halves::HeldOut;
use crate::known_target::match_dots;
use crate::lens::LENS;
use crate::report::Report;
use crate::rig_output::rig_with;
use crate::target_problem::{Calibrated, Robustness, TargetView};
use crate::{CalibrationError, dots, point_lists};
use anyhow::{Context, bail, ensure};
use fpga_model::input::recorded::Recorded;
use fpga_model::input::whole::is_recording;
use rig::Rig;
use rig::camera::Camera;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vitreo calibrate dots`.
#[derive(Debug, Clone, clap::Args)]
pub struct DotsArgs {
    /// Point list of each camera, camera 0 first.
    #[arg(value_name = "POINTS", required_unless_present = "pictures")]
    pub points: Vec<PathBuf>,
    /// Pictures of the target instead of point lists: one per camera, or a recording of vitreo cameras --record-fields
    /// (.mcap), of which the first whole picture of each camera is used.
    #[arg(long, value_name = "PICTURE", num_args = 1.., requires = "target", requires = "picked", conflicts_with = "points",
        help_heading = "Pictures")]
    pub pictures: Vec<PathBuf>,
    /// Positions of the dots of the target: X Y Z per line, mm.
    #[arg(long, value_name = "FILE", help_heading = "Pictures")]
    pub target: Option<PathBuf>,
    /// Point list for each picture, with at least four dots picked by hand, not all in one plane.
    #[arg(long, value_name = "POINTS", num_args = 1.., help_heading = "Pictures")]
    pub picked: Vec<PathBuf>,
    /// Size of the pictures, px. If given, the lenses are calibrated too.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pair)]
    pub size: Option<[u32; 2]>,
    /// Rig whose cameras are replaced. Without --size, its lenses are kept and only the poses are calibrated; point lists
    /// need --size or --rig [default: the rig of the recording, or the shipped one].
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Cross-validate N times: calibrate on a random half of the dots that all cameras see, and triangulate the other
    /// half. The report contains the median errors.
    #[arg(long, value_name = "N")]
    pub splits: Option<u32>,
    #[command(flatten)]
    pub solve: SolveArgs,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Point lists of dots that stay in place, one a camera, and the lines of their points.
fn sheets_of_dots(args: &DotsArgs) -> anyhow::Result<(Vec<TargetView>, Vec<Source>)> {
    let (mut sheets, mut sources) = (Vec::new(), Vec::new());
    for (camera, path) in args.points.iter().enumerate() {
        ensure!(
            !is_recording(path),
            "{}: is a recording of pixels, which has no dot positions: expected a point list of each camera, or \
             --pictures {} --target FILE --picked POINTS",
            path.display(),
            outputs::shell_word(path.display())
        );
        let views = point_lists::load(path)?;
        let n = views.len();
        ensure!(n == 1, "{}: expected dots that stay in place, found {n} views", path.display());
        for view in views {
            let name =
                if view.name.is_empty() { short(path) } else { format!("{} {}", short(path), view.name) };
            sheets.push(TargetView { name, camera, view: 0, samples: view.samples });
            sources.push(Source { counted: view.counted, lines: view.lines });
        }
    }
    lists::expect_different(&sheets, &args.points)?;
    Ok((sheets, sources))
}

/// A picture of the target.
struct Shown {
    /// Its name in tables, and in messages.
    names: [String; 2],
    picture: GreyImage,
}

impl Shown {
    fn size_px(&self) -> [u32; 2] {
        [self.picture.width as u32, self.picture.height as u32]
    }

    /// Checks that it has a size; `from` says where that comes from.
    fn expect_size(&self, [w, h]: [u32; 2], from: &str) -> anyhow::Result<()> {
        let ([x, y], name) = (self.size_px(), &self.names[1]);
        ensure!([x, y] == [w, h], "{name}: expected {w}×{h} px {from}, found {x}×{y}");
        Ok(())
    }
}

/// A picture of each camera: those of files, or the first ones in a recording.
fn shown(args: &DotsArgs) -> anyhow::Result<Vec<Shown>> {
    let progress = progress("pictures", None);
    let of_file = |path: &PathBuf| {
        progress.set_message(short(path));
        Ok(Shown { names: [short(path), path.display().to_string()], picture: GreyImage::load(path)? })
    };
    let recorded = args.pictures.iter().find(|path| is_recording(path));
    let all: anyhow::Result<Vec<Shown>> = match recorded {
        None => args.pictures.iter().map(of_file).collect(),
        Some(path) => {
            ensure!(
                args.pictures.len() == 1,
                "--pictures: expected one recording (.mcap) or a picture of each camera, found both"
            );
            let of_camera = |camera: u32| {
                let (name, picture) = recorded::first(path, camera)?;
                Ok(Shown { names: [format!("{} camera {camera}", short(path)), name], picture })
            };
            Recorded::head(path)?.cameras.into_iter().map(of_camera).collect()
        }
    };
    progress.finish_and_clear();
    let all: Vec<Shown> = all?;
    expect_different(&all)?;
    Ok(all)
}

/// Refuses one picture for two cameras.
fn expect_different(all: &[Shown]) -> anyhow::Result<()> {
    for (i, first) in all.iter().enumerate() {
        if let Some(j) = (i + 1..all.len()).find(|&j| all[j].picture == first.picture) {
            let (one, other) = (&first.names[1], &all[j].names[1]);
            bail!(
                "cameras {i} and {j}: expected a picture by each camera, found the same one in {one} and {other}"
            );
        }
    }
    Ok(())
}

/// The dots that were picked by hand, in one list per camera.
fn picked(lists: &[PathBuf]) -> anyhow::Result<Vec<TargetView>> {
    let of_camera = |(camera, path): (usize, &PathBuf)| {
        let samples = point_lists::load(path)?.into_iter().flat_map(|v| v.samples);
        // Picking programs write (-1, -1) for a dot that was not seen.
        let samples = samples.filter(|s| s.pixel.x >= 0.0 && s.pixel.y >= 0.0).collect();
        Ok(TargetView { name: short(path), camera, view: 0, samples })
    };
    let picked: Vec<TargetView> = lists.iter().enumerate().map(of_camera).collect::<anyhow::Result<_>>()?;
    lists::expect_different(&picked, lists)?;
    Ok(picked)
}

/// The target's dots in a picture of each camera.
fn sheets_of_target(args: &DotsArgs, pictures: &[Shown]) -> anyhow::Result<Vec<TargetView>> {
    let target =
        point_lists::load_target(args.target.as_deref().context("--target is needed with --pictures")?)?;
    let (count, lists) = (pictures.len(), args.picked.len());
    ensure!(count == lists, "--picked: expected a list for each of {count} pictures, found {lists}");
    let picked = picked(&args.picked)?;
    let progress = progress("dots", Some(count as u64));
    let mut sheets = Vec::new();
    for (camera, (shown, picked)) in pictures.iter().zip(&picked).enumerate() {
        if let Some(size) = args.size {
            shown.expect_size(size, "by --size")?;
        }
        let [bright, dark] = [false, true].map(|dark| dots::find(&shown.picture, dark));
        let (n, [name, file]) = (target.len(), &shown.names);
        ensure!(
            !bright.is_empty() || !dark.is_empty(),
            "{file}: expected the {n} dots of the target, round and on an even ground, found none"
        );
        let of_colour = |dots: &[dots::Dot]| match_dots(shown.size_px(), dots, &target, &picked.samples);
        let samples = match (of_colour(&bright), of_colour(&dark)) {
            (Ok(bright), Ok(dark)) if dark.len() > bright.len() => dark,
            (Ok(found), _) | (Err(_), Ok(found)) => found,
            (Err(problem), Err(_)) => return Err(problem).with_context(|| file.clone()),
        };
        sheets.push(TargetView { name: name.clone(), camera, view: 0, samples });
        progress.inc(1);
    }
    progress.finish_and_clear();
    lists::expect_different(&sheets, &[])?;
    Ok(sheets)
}

/// The rig whose cameras are replaced, and its name in messages; without a rig, the shipped one.
fn template(args: &DotsArgs) -> anyhow::Result<(Rig, String)> {
    match (&args.rig, args.pictures.iter().find(|path| is_recording(path))) {
        (None, Some(path)) => {
            let name = format!("the rig of {}", path.display());
            Ok((Rig::parse(&Recorded::head(path)?.rig_json, &format!("of {}", path.display()))?, name))
        }
        (Some(path), _) => Ok((Rig::load(path)?, path.display().to_string())),
        (None, None) => Ok((Rig::load_or_shipped(None)?, "the shipped rig".into())),
    }
}

/// What is known of the cameras that saw the dots.
fn priors(
    args: &DotsArgs,
    template: &Rig,
    sheets: &[TargetView],
    pictures: &[Shown],
) -> anyhow::Result<Vec<CameraPrior>> {
    let before: Vec<CameraPrior> = match (args.size, &args.rig) {
        (Some(size), _) => vec![CameraPrior::Size(size); sheets.len()],
        (None, None) if !pictures.is_empty() => {
            pictures.iter().map(Shown::size_px).map(CameraPrior::Size).collect()
        }
        (None, _) => template.cameras().into_iter().map(CameraPrior::Lens).collect(),
    };
    let (lists, cameras) = (sheets.len(), before.len());
    ensure!(lists == cameras, "expected a point list of each of the rig's {cameras} cameras, found {lists}");
    for (before, shown) in before.iter().zip(pictures) {
        if let CameraPrior::Lens(Camera { id, size_px, .. }) = before {
            shown.expect_size(*size_px, &format!("of camera {id}"))?;
        }
    }
    Ok(before)
}

/// Inputs of a calibration on dots.
struct Scene {
    /// The rig whose cameras are replaced.
    template: Rig,
    sheets: Vec<TargetView>,
    /// Where the points of each list come from; empty for pictures.
    sources: Vec<Source>,
    before: Vec<CameraPrior>,
    notes: Vec<String>,
}

/// Reads and checks the inputs.
fn scene(args: &DotsArgs) -> anyhow::Result<Scene> {
    // Point lists do not name their cameras, so the lenses of the shipped rig may be those of other cameras.
    ensure!(
        !args.pictures.is_empty() || args.size.is_some() || args.rig.is_some(),
        "expected --size WIDTHxHEIGHT, to find the lenses too, or --rig RIG.json, whose lenses are kept"
    );
    let ((mut template, from), pictures) = (template(args)?, shown(args)?);
    let (sheets, sources) = match pictures.is_empty() {
        true => sheets_of_dots(args)?,
        false => (sheets_of_target(args, &pictures)?, Vec::new()),
    };
    let before = priors(args, &template, &sheets, &pictures)?;
    let sizes_px: Vec<[u32; 2]> = before.iter().map(CameraPrior::size_px).collect();
    checks::inside(&sheets, &sizes_px, if args.size.is_some() { "--size" } else { "the rig" })?;
    let mut notes = vec!["the world is the frame of the dots".into()];
    let is_shipped = args.rig.is_none() && !args.pictures.iter().any(|path| is_recording(path));
    let is_written = args.output.output.is_some();
    if is_shipped && is_written {
        notes.push(fit_timing(&mut template, &sizes_px));
    }
    if is_written {
        dots_checks::writable(&template, &before, &from)?;
    }
    if args.rig.is_some() {
        dots_checks::in_order(&template, &sheets)?;
    }
    Ok(Scene { template, sheets, sources, before, notes })
}

/// Refuses to write a rig in another unit than mm; otherwise only notes it.
fn check_unit(
    args: &DotsArgs,
    scene: &Scene,
    found: &Calibrated,
    notes: &mut Vec<String>,
) -> anyhow::Result<()> {
    let cameras = &found.scene.cameras;
    let sizes = |cameras: &[Camera]| cameras.iter().map(|c| c.size_px).collect::<Vec<_>>();
    let old =
        args.rig.as_ref().map(|_| &scene.template).filter(|rig| sizes(&rig.cameras()) == sizes(cameras));
    let Some(problem) = dots_checks::other_unit(cameras, &scene.sheets, &scene.template, old) else {
        return Ok(());
    };
    ensure!(args.output.output.is_none(), "{problem}");
    notes.push(problem);
    Ok(())
}

/// What speaks against the size of the pictures, if it was given with point lists, which do not show it.
fn doubt_of_size(args: &DotsArgs, scene: &Scene) -> Option<String> {
    args.size.filter(|_| args.pictures.is_empty()).and_then(|size| lists::doubt_of_size(&scene.sheets, size))
}

/// Why the size of the pictures is wrong: smaller ones hold all points, and with their size fewer points contradict each
/// other or more terms of lenses are determined. If neither is so, the doubt is only noted.
fn wrong_size(
    args: &DotsArgs,
    scene: &Scene,
    Agreeing { found, wrong, .. }: &Agreeing,
    notes: &mut Vec<String>,
) -> Option<String> {
    let doubt = doubt_of_size(args, scene)?;
    let smaller = lists::smaller_pictures(&scene.sheets, args.size?)?;
    let [points, terms] = [wrong.len(), found.left_out.len()];
    let before = vec![CameraPrior::Size(smaller); scene.before.len()];
    let other = || {
        let (free, loss) = (args.solve.free(), args.solve.loss);
        let other = calibrate_agreeing(&before, &scene.sheets, free, loss, &mut |_, _| {}).ok()?;
        Some([other.wrong.len(), other.found.left_out.len()])
    };
    let fewer = |[p, t]: &[usize; 2]| *p < points || (*p == points && *t < terms);
    let Some([p, t]) = (points + terms > 0).then(other).flatten().filter(fewer) else {
        notes.push(doubt);
        return None;
    };
    let [x, y] = smaller;
    let left_out = format!("{p} points instead of {points} are left out");
    let held = format!("{t} lens terms instead of {terms} are fixed at 0");
    let better: Vec<String> = [(p < points, left_out), (t < terms, held)]
        .into_iter()
        .filter_map(|(is, said)| is.then_some(said))
        .collect();
    Some(format!(
        "{doubt} With {x}×{y} px, {}. If the size is right, expected dots in all parts of the pictures, or --without the \
         terms that are fixed",
        better.join(" and ")
    ))
}

/// Runs `vitreo calibrate dots`.
///
/// # Errors
/// As [`intrinsics`]; lists or pictures that do not fit the cameras.
pub fn fixed_dots(args: &DotsArgs) -> anyhow::Result<ExitCode> {
    let scene = scene(args)?;
    let (free, loss) = (args.solve.free(), args.solve.loss);
    let agreeing = with_spinner("least squares", |tell| {
        calibrate_agreeing(&scene.before, &scene.sheets, free, loss, tell)
    });
    let doubt = || Vec::from_iter(doubt_of_size(args, &scene));
    let agreeing = agreeing.map_err(|problem| with_notes(problem, &doubt()))?;
    let mut notes = scene.notes.clone();
    let refused = wrong_size(args, &scene, &agreeing, &mut notes);
    let Agreeing { found, sheets, wrong } = agreeing;
    notes.push(dots_checks::size_of(&found.scene.cameras, &sheets));
    notes.extend(dots_checks::left_out(&wrong, &scene.sheets, &scene.sources));
    notes.extend(checks::remarks(&found, &sheets));
    check_unit(args, &scene, &found, &mut notes)?;
    let mut report = report_of("dots", &found, &sheets, notes);
    let Scene { template, before, .. } = &scene;
    add_splits(&mut report, args, before, &sheets)?;
    let compared = args.rig.as_ref().filter(|_| args.output.output.is_some());
    let held_out = compared.map(|_| {
        let sizes_px: Vec<[u32; 2]> = before.iter().map(CameraPrior::size_px).collect();
        checks::beside(template, &sizes_px, |cameras| {
            let learnt = |half: &[TargetView]| calibrate_on_dots(before, half, free, loss, &mut |_, _| {});
            HeldOut::of_dots(cameras, &sheets, learnt).ok_or(NotCompared::TooFewDots)
        })
    });
    let json = || Ok(rig_with(template, &found.scene.cameras)?.to_json());
    finish_unless(Vec::from_iter(refused), &args.output, report, &found, held_out, json)
}

/// Adds the errors of held-out dots, if `--splits` is given.
fn add_splits(
    report: &mut Report,
    args: &DotsArgs,
    before: &[CameraPrior],
    sheets: &[TargetView],
) -> anyhow::Result<()> {
    let Some(times) = args.splits else { return Ok(()) };
    let [x, y, z] = median_of_splits(before, sheets, args.solve.free(), args.solve.loss, times)?;
    for (axis, value) in [("x", x), ("y", y), ("z", z)] {
        let name = format!("dots held out: rms error along {axis}, {times} splits");
        report.figure(name, value * 1e3, "µm");
    }
    Ok(())
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

/// Half of `n` things, drawn by a shuffle from `seed`.
fn random_half(n: usize, seed: u32) -> Vec<bool> {
    let mut chosen = vec![false; n];
    Draws::new(seed.into()).order(n)[..n / 2].iter().for_each(|&i| chosen[i] = true);
    chosen
}
