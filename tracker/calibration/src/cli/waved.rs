//! `vitreo calibrate waved`: a rig refined by waved instruments, which `vitreo commission poses` does as well.

use super::fields::StreamArgs;
use super::stream::{judged, judged_enough, nothing_written};
use super::{OutputArgs, positive, with_spinner};
use crate::CalibrationError;
use crate::bundle::PriorSigmas;
use crate::causes::Judgement;
use crate::lens::LENS_NAMES;
use crate::mend::{Mended, mend};
use crate::report::{Report, camera_report};
use crate::self_calibration::SelfCalibration;
use crate::target_problem::{rms, robust_sigma};
use anyhow::Context;
use nalgebra::Vector3;
use protocol::blobs::BlobField;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vitreo calibrate waved`.
#[derive(Debug, Clone, clap::Args)]
pub struct WavedArgs {
    /// Blob stream (.jsonl), recording or recording of pixels (.mcap).
    #[arg(value_name = "STREAM")]
    pub stream: PathBuf,
    #[command(flatten)]
    pub from: StreamArgs,
    /// Standard deviation of the world origin's position relative to each camera, mm.
    #[arg(long, value_name = "MM", default_value = "0.02", value_parser = positive, allow_negative_numbers = true, help_heading = "Prior knowledge of the rig")]
    pub camera_mm: f64,
    /// Standard deviation of the world's orientation relative to each camera, mrad.
    #[arg(long, value_name = "MRAD", default_value = "0.3", value_parser = positive, allow_negative_numbers = true, help_heading = "Prior knowledge of the rig")]
    pub camera_mrad: f64,
    /// Standard deviation of the markers' positions, mm.
    #[arg(long, value_name = "MM", default_value = "0.005", value_parser = positive, allow_negative_numbers = true, help_heading = "Prior knowledge of the rig")]
    pub marker_mm: f64,
    /// Refine the lenses too. Standard deviation of focal lengths and principal point, and of the shift by distortion
    /// at the corners of the picture, px.
    #[arg(long, value_name = "PX", value_parser = positive, allow_negative_numbers = true, help_heading = "Prior knowledge of the rig")]
    pub lens_px: Option<f64>,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Result of a refinement by waved instruments.
pub enum Waved {
    /// The refined rig predicts held-out instants better.
    Better {
        /// The refinement.
        found: Box<SelfCalibration>,
        /// Its figures and notes, with the judgement of the rig as it was.
        report: Report,
    },
    /// The rig stays as it is.
    Kept {
        /// The judgement of the rig.
        judgement: Judgement,
        /// Why it stays.
        why: String,
    },
}

/// Judges a rig by a stream of waved instruments, and refines what the judgement allows by at most `most` instants. A
/// refined rig is returned only if it predicts held-out instants better.
///
/// # Errors
/// Too few usable instants, or a problem without a solution.
pub fn refined_by_waving(
    rig: &Rig,
    fields: &[BlobField],
    known: &PriorSigmas,
    most: usize,
) -> Result<Waved, CalibrationError> {
    refined(rig, fields, known, most, judged(rig, fields))
}

/// As [`refined_by_waving`], with the judgement of the rig.
fn refined(
    rig: &Rig,
    fields: &[BlobField],
    known: &PriorSigmas,
    most: usize,
    judgement: Judgement,
) -> Result<Waved, CalibrationError> {
    let mended = with_spinner("bundle adjustment", |tell| mend(rig, fields, known, &judgement, most, tell))?;
    let (found, [before, after]) = match mended {
        Mended::Better { found, held_out_px } => (found, held_out_px),
        Mended::Nothing(why) => return Ok(Waved::Kept { judgement, why }),
    };
    let mut report = waved_report(rig, &found, !judgement.holds);
    report.notes.push(judgement.text());
    report.figure("residual of held-out instants, before", before, "px");
    report.figure("residual of held-out instants, after", after, "px");
    Ok(Waved::Better { found, report })
}

/// Runs `vitreo calibrate waved`.
///
/// # Errors
/// A stream or rig that cannot be read, a stream that shows too little, or a problem without a solution.
pub fn waved(args: &WavedArgs) -> anyhow::Result<ExitCode> {
    let (rig, fields) = args.from.fields(&args.stream)?;
    let known = PriorSigmas {
        camera_mm: args.camera_mm,
        camera_rad: args.camera_mrad * 1e-3,
        marker_mm: args.marker_mm,
        lens_px: args.lens_px.unwrap_or(0.0),
    };
    let judgement = judged_enough(&args.stream, &rig, &fields)?;
    let outcome = refined(&rig, &fields, &known, args.from.instants, judgement);
    let (found, report) = match outcome.with_context(|| args.stream.display().to_string())? {
        Waved::Better { found, report } => (found, report),
        Waved::Kept { judgement, why } => return nothing_written(&args.output, "waved", &judgement, &why),
    };
    args.output.print(&report, &found.bundle.cameras, &found.residuals)?;
    // Checked as when it is read: a refined rig must be one.
    args.output.write(&Rig::parse(&found.bundle.rig(&rig).to_json(), "of the calibration")?.to_json())?;
    Ok(ExitCode::SUCCESS)
}

/// What a refinement found. `drifted`: the rig as it was does not hold.
pub fn waved_report(rig: &Rig, found: &SelfCalibration, drifted: bool) -> Report {
    let cameras = found.bundle.cameras.iter().zip(&found.sigmas).enumerate();
    let mut report = Report {
        task: "waved",
        rms_px: rms(found.residuals.iter().copied()),
        sigma_px: robust_sigma(&found.residuals),
        iterations: found.iterations,
        cameras: cameras.map(|(i, (camera, s))| camera_report(camera, s, &found.residuals, i)).collect(),
        ..Report::default()
    };
    report.figure("instants", found.bundle.poses.len() as f64, "");
    report.figure("rms of residuals before", rms(found.before.iter().copied()), "px");
    report.figure("rms of residuals after", report.rms_px, "px");
    report.figure("cost per degree of freedom (1: as blobs vary)", found.reduced_cost, "");
    for (camera, (shift, sigma)) in rig.cameras.iter().zip(&found.shifts_px) {
        report.uncertain(format!("camera {}: its image has moved by", camera.id), [*shift, *sigma], "px");
    }
    add_marker_moves(&mut report, rig, found);
    report.notes.push(
        "gauge: the world's origin is the eye's centre; its axes, and the frame of each body, follow the cameras and \
         markers that moved least"
            .into(),
    );
    report.notes.extend(undetermined(rig, found));
    if !drifted {
        report.notes.push("the residuals show no drift: the rig as given is as good".into());
    }
    report
}

/// Adds how far the markers of each body have moved.
fn add_marker_moves(report: &mut Report, rig: &Rig, found: &SelfCalibration) {
    for (body, name) in BODY_NAMES.iter().enumerate() {
        let old = rig.body(name).map(|b| b.markers.as_slice()).unwrap_or_default();
        let moved = found.bundle.markers[body].iter().zip(old);
        let squares: Vec<f64> =
            moved.map(|(m, o)| (m.position.coords - Vector3::from(o.p)).norm_squared()).collect();
        let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        report.figure(format!("markers of {name} have moved by (rms)"), mean.sqrt() * 1e3, "µm");
    }
}

/// What the stream does not determine, or only weakly.
fn undetermined(rig: &Rig, found: &SelfCalibration) -> Vec<String> {
    let mut notes = Vec::new();
    if !found.weakly_observed.is_empty() {
        notes.push(format!("weakly determined by the stream: {}", found.weakly_observed.join(", ")));
    }
    for (c, camera) in rig.cameras.iter().enumerate() {
        let own = found.held.iter().filter(|(of, _)| *of == c);
        let terms: Vec<&str> = own.map(|&(_, term)| LENS_NAMES[term]).collect();
        if !terms.is_empty() {
            let (id, terms) = (camera.id, terms.join(", "));
            notes.push(format!("camera {id}: the stream does not determine {terms}: kept as in the rig"));
        }
    }
    notes
}
