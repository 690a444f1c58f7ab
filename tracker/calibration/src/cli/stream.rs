//! Calibrations that look at a stream of blobs: `pivot`, `drift`; the judgement of a stream.

use super::fields::StreamArgs;
use super::{OutputArgs, positive, progress, warn_of_refusal, with_spinner};
use crate::CalibrationError;
use crate::causes::{Judgement, Verdict, judge};
use crate::drift_check::{self, DriftCheck};
use crate::observations::{FrameObservations, collect};
use crate::pivot::{self, Pivot, Shaft};
use crate::pose_file::{self, Poses};
use crate::report::Report;
use crate::self_calibration::{fitted, fitted_with, spread};
use anyhow::{Context, ensure};
use ipc::logging::warn;
use nalgebra::{Point3, Vector3};
use outputs::exit::DIFFERS;
use protocol::blobs::BlobField;
use protocol::poses::{BODY_NAMES, EYE};
use rig::Rig;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Systematic shift of a camera's image that is tolerated by default, px. Balls
/// seen aside of the axis are not centred on their centre's image: that alone makes 0.025 px in a
/// rig that holds.
pub const LIMIT_PX: f64 = 0.05;

/// Cameras expose at different times where the residuals of poses at one instant are so many times those of paths.
const MOVING: f64 = 2.0;
/// The verdict on a rig that is wrong although no camera has drifted.
const NOT_VALID: &str = "the calibration is no longer valid";
/// A trocar is put nowhere that is less certain than this, mm.
const DOUBT_MM: f64 = 0.1;

/// Arguments of `vitreo calibrate pivot`.
#[derive(Debug, Clone, clap::Args)]
pub struct PivotArgs {
    /// Blob stream (.jsonl), recording or recording of pixels (.mcap).
    #[arg(value_name = "STREAM", required_unless_present = "poses")]
    pub stream: Option<PathBuf>,
    #[command(flatten)]
    pub from: StreamArgs,
    /// Poses of a tracker (poses.csv) instead of a stream; they do not determine the eye's centre.
    #[arg(long, value_name = "POSES.csv", conflicts_with = "stream")]
    pub poses: Option<PathBuf>,
    /// Also move the world's origin to the point about which the eye turns.
    #[arg(long, conflicts_with = "poses")]
    pub recentre: bool,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Arguments of `vitreo calibrate drift`.
#[derive(Debug, Clone, clap::Args)]
pub struct DriftArgs {
    /// Blob stream (.jsonl), recording or recording of pixels (.mcap).
    #[arg(value_name = "STREAM")]
    pub stream: PathBuf,
    #[command(flatten)]
    pub from: StreamArgs,
    /// Tolerated systematic shift of a camera's image, px.
    #[arg(long, value_name = "PX", default_value_t = LIMIT_PX, value_parser = positive, allow_negative_numbers = true)]
    pub limit_px: f64,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Judges a stream, with a bar.
pub fn judged(rig: &Rig, fields: &[BlobField]) -> Judgement {
    let bar = progress("causes", None);
    let judgement = judge(rig, fields, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        true
    });
    bar.finish_and_clear();
    judgement
}

/// As [`judged`]; a stream that shows too little of the bodies is refused.
pub(super) fn judged_enough(stream: &Path, rig: &Rig, fields: &[BlobField]) -> anyhow::Result<Judgement> {
    let judgement = judged(rig, fields);
    ensure!(
        judgement.verdict != Verdict::TooLittle,
        "{}: {}: is it a stream of this rig, and some seconds long?",
        stream.display(),
        judgement.text()
    );
    Ok(judgement)
}

/// Reports that nothing was written, and why; the launcher's code for a verification that found a difference.
pub(super) fn nothing_written(
    output: &OutputArgs,
    task: &'static str,
    judgement: &Judgement,
    why: &str,
) -> anyhow::Result<ExitCode> {
    let refusal = format!("nothing was written: {why}");
    print_verdict(output, task, judgement, &refusal)?;
    warn_of_refusal(&refusal);
    Ok(ExitCode::from(DIFFERS))
}

/// Prints a report that holds the judgement of a stream and a verdict alone.
fn print_verdict(
    output: &OutputArgs,
    task: &'static str,
    judgement: &Judgement,
    verdict: &str,
) -> anyhow::Result<()> {
    let notes = vec![judgement.text(), verdict.into()];
    output.print(&Report { task, notes, ..Report::default() }, &[], &[])
}

/// Runs `vitreo calibrate drift`; exit code 5 if a camera has drifted.
///
/// # Errors
/// A stream or rig that cannot be read, or too few usable instants.
pub fn drift(args: &DriftArgs) -> anyhow::Result<ExitCode> {
    let (rig, fields) = args.from.fields(&args.stream)?;
    let judgement = judged_enough(&args.stream, &rig, &fields)?;
    let seen = with_spinner("tracking", |_| spread(collect(&rig, &fields), args.from.instants));
    let found = match drift_check::check(&rig, &seen, args.limit_px) {
        Ok(found) => found,
        Err(_) if !judgement.holds => {
            print_verdict(&args.output, "drift", &judgement, NOT_VALID)?;
            return Ok(ExitCode::from(DIFFERS));
        }
        Err(problem) => return Err(problem.into()),
    };
    let report = drift_report(&rig, &found, args.limit_px, &judgement);
    args.output.print(&report, &[], &[])?;
    // The rig stays as it is; the result is what was found of it.
    args.output.write(&report.to_json().to_string())?;
    if let Some(advice) = advice(&rig, &found, &judgement, args.limit_px) {
        warn(&advice);
    }
    // The launcher's code for a verification that found a difference.
    let holds = !found.drifted() && judgement.holds;
    Ok(if holds { ExitCode::SUCCESS } else { ExitCode::from(DIFFERS) })
}

/// What to do about shifted residuals of cameras. Where the rig is no longer valid the report says what helps, and cameras are
/// not listed beside it: an error of one shifts the residuals of the others too.
fn advice(rig: &Rig, found: &DriftCheck, judgement: &Judgement, limit_px: f64) -> Option<String> {
    let shifted =
        rig.cameras.iter().zip(&found.cameras).filter(|(_, shift)| judgement.holds && shift.drifted);
    let shifted: Vec<String> = shifted
        .map(|(camera, shift)| {
            format!(
                "camera {} by {:.3} px (chance {:.3} px)",
                camera.id, shift.systematic_px, shift.chance_px
            )
        })
        .collect();
    (!shifted.is_empty()).then(|| {
        format!(
            "systematic shift of residuals above the limit of {limit_px:.3} px: {}; refine the rig with: vitreo calibrate \
             waved",
            shifted.join(", ")
        )
    })
}

/// What a check for drift found.
pub fn drift_report(rig: &Rig, found: &DriftCheck, limit_px: f64, judgement: &Judgement) -> Report {
    let mut report = Report { task: "drift", rms_px: found.rms_px, ..Report::default() };
    report.figure("instants", found.instants as f64, "");
    report.figure("limit", limit_px, "px");
    for (camera, shift) in rig.cameras.iter().zip(&found.cameras) {
        let name = format!("camera {}: systematic shift of its residuals", camera.id);
        report.uncertain(name, [shift.systematic_px, shift.chance_px], "px");
        report.figure(format!("camera {}: rms of its residuals", camera.id), shift.rms_px, "px");
        report.figure(
            format!("camera {}: drifted (0 = no, 1 = yes)", camera.id),
            f64::from(u8::from(shift.drifted)),
            "",
        );
    }
    report.figure("above the noise of the stream", judgement.above_px, "px");
    if judgement.holds && found.rms_px > MOVING * judgement.used_px {
        report.notes.push(
            "the cameras expose at different times: the rms of each camera's residuals includes the motion in between"
                .into(),
        );
    }
    let verdict = match (found.drifted(), judgement.holds) {
        (false, true) => "the calibration is still valid",
        (true, _) => "the rig has drifted",
        (false, false) => NOT_VALID,
    };
    report.notes.push(verdict.into());
    report.notes.push(judgement.text());
    report
}

/// Runs `vitreo calibrate pivot`.
///
/// # Errors
/// A stream, rig or file of poses that cannot be read, or movements that determine no pivot.
pub fn pivot(args: &PivotArgs) -> anyhow::Result<ExitCode> {
    let (mut rig, poses, centre) = match &args.poses {
        Some(path) => {
            let rig = args.from.rig.as_deref().context("--rig RIG.json is needed with --poses")?;
            (Rig::load(rig)?, pose_file::load(path)?, None)
        }
        None => {
            let path = args.stream.as_deref().context("a stream is needed")?;
            let (rig, fields) = args.from.fields(path)?;
            let judgement = judged_enough(path, &rig, &fields)?;
            if !judgement.holds {
                return nothing_written(
                    &args.output,
                    "pivot",
                    &judgement,
                    "with a calibration that is no longer valid, trocars would be put in wrong places",
                );
            }
            let instants = with_spinner("tracking", |_| spread(collect(&rig, &fields), args.from.instants));
            let (poses, centre) = turned(&rig, &instants)?;
            (rig, poses, Some(centre))
        }
    };
    let report = pivoted(&mut rig, &poses, centre, args.recentre)?;
    args.output.print(&report, &[], &[])?;
    args.output.write(&Rig::parse(&rig.to_json(), "of the calibration")?.to_json())?;
    Ok(ExitCode::SUCCESS)
}

/// Where the eye turns about, in the world and in the eye.
pub type Centre = Result<(Pivot, Point3<f64>), CalibrationError>;

/// Poses of bodies that turn about their pivots, and the eye's centre.
///
/// # Errors
/// Too few usable instants.
pub fn turned(rig: &Rig, instants: &[FrameObservations]) -> anyhow::Result<(Vec<Poses>, Centre)> {
    let poses = fitted(rig, instants)?.1.poses;
    let free = fitted_with(rig, instants, true, 1.0)?.1.poses;
    let eye: Vec<_> = free.iter().filter_map(|p| p[EYE]).collect();
    Ok((poses, pivot::of_turns(&eye)))
}

/// Puts the trocars of a rig where the shafts meet; with `recentre` the world's origin, too, to where the eye turns
/// about.
///
/// # Errors
/// No pivot at all, or no eye's centre where it is needed.
pub fn pivoted(
    rig: &mut Rig,
    poses: &[Poses],
    centre: Option<Centre>,
    recentre: bool,
) -> anyhow::Result<Report> {
    let mut report = Report { task: "pivot", ..Report::default() };
    for (body, name) in BODY_NAMES.iter().enumerate().filter(|(b, _)| *b != EYE) {
        match trocar(poses, body) {
            Ok(found) => set_trocar(rig, name, &found, &mut report),
            Err(problem) => report.notes.push(format!("trocar of {name}: {problem}")),
        }
    }
    match centre {
        Some(Ok((found, in_eye))) => {
            report_pivot(&mut report, "eye's centre in the world", &found);
            if recentre {
                recentred(rig, found.point.coords, in_eye);
                report.notes.push("the world's origin was moved to the eye's centre".into());
            }
        }
        Some(Err(problem)) if recentre => return Err(problem.into()),
        Some(Err(problem)) => report.notes.push(format!("eye's centre: {problem}")),
        None => {}
    }
    ensure!(!report.figures.is_empty(), "no pivot was found: {}", report.notes.join("; "));
    Ok(report)
}

/// Where a body's shaft passes, in the eye frame.
fn trocar(poses: &[Poses], body: usize) -> anyhow::Result<Pivot> {
    Ok(pivot::of_shafts(&shafts(poses, body))?)
}

/// The shafts of a body, in the eye frame.
pub fn shafts(poses: &[Poses], body: usize) -> Vec<Shaft> {
    let shaft = |p: &Poses| {
        let (pose, eye) = (p[body]?, p[EYE]?);
        let origin = eye.inverse_transform_point(&pose.translation.vector.into());
        let direction = eye.inverse_transform_vector(&(pose.rotation * Vector3::z()));
        Some(Shaft { origin, direction })
    };
    poses.iter().filter_map(shaft).collect()
}

fn report_pivot(report: &mut Report, what: &str, found: &Pivot) {
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        report.uncertain(format!("{what}: {axis}"), [found.point[i], found.sigma_mm[i]], "mm");
    }
    report.figure(format!("{what}: play (rms)"), found.play_mm, "mm");
    report.figure(format!("{what}: poses"), found.poses as f64, "");
}

fn set_trocar(rig: &mut Rig, name: &str, found: &Pivot, report: &mut Report) {
    report_pivot(report, &format!("trocar of {name} in the eye"), found);
    let doubt_mm = found.sigma_mm.norm();
    if doubt_mm > DOUBT_MM {
        report.notes.push(format!(
            "trocar of {name}: unchanged, as it would be uncertain by {doubt_mm:.2} mm: tilt the instrument far to all \
             sides, for 20 s or more"
        ));
        return;
    }
    if let Some(old) = rig.trocars.iter_mut().find(|t| t.body == name) {
        let moved = (found.point.coords - Vector3::from(old.p_eye)).norm();
        report.figure(format!("trocar of {name}: distance from the rig's"), moved, "mm");
        old.p_eye = found.point.coords.into();
        // A shaft that fits perfectly still needs some play: the trackers divide by it.
        old.sigma = found.play_mm.max(1e-3);
    }
}

/// Moves the world's and the eye's origin to where the eye turns about.
fn recentred(rig: &mut Rig, in_world: Vector3<f64>, in_eye: Point3<f64>) {
    for camera in &mut rig.cameras {
        let moved = camera.model().camera_from_world * in_world;
        camera.t.iter_mut().zip(moved.iter()).for_each(|(t, m)| *t += m);
    }
    let shift = |p: &mut [f64; 3]| p.iter_mut().zip(in_eye.iter()).for_each(|(p, q)| *p -= q);
    for body in rig.bodies.iter_mut().filter(|b| b.name == BODY_NAMES[EYE]) {
        body.markers.iter_mut().for_each(|m| shift(&mut m.p));
    }
    rig.trocars.iter_mut().for_each(|t| shift(&mut t.p_eye));
}
