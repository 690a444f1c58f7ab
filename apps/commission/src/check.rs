//! Step `check`: what the cameras see of the workspace, how well tips can be known, and whether the rig fits a stream.

use crate::folder::{Folder, Outcome};
use crate::lenses::residual_picture;
use crate::live::LiveArgs;
use crate::poses::{Fit, add_figures, instants};
use crate::stream::Origin;
use anyhow::Result;
use calibration::cli::{LIMIT_PX, drift_report, judged};
use calibration::drift_check;
use calibration::rig_view::picture::Maps;
use calibration::rig_view::{RigView, Viewer};
use calibration::self_calibration::{fitted, residuals_of};
use calibration::target_problem::Residual;
use plots::Format;
use rig::Rig;
use std::path::PathBuf;

/// Least share of a stream's blobs that fit a rig that holds, and what may be left of all, px.
pub const LEAST_SHARE: f64 = 0.8;
/// The most that may be left of all blobs, px.
pub const LARGEST_LEFT_PX: f64 = 0.9;

/// Arguments of the step.
#[derive(Debug, Clone, clap::Args)]
pub struct CheckArgs {
    /// Stream (.mcap, .jsonl) of moving instruments [default: only the rig file is checked].
    #[arg(long, value_name = "STREAM")]
    pub from: Option<PathBuf>,
    /// Or live cameras.
    #[command(flatten)]
    pub live: LiveArgs,
}

/// Runs the step; the second value is false where something is missing, or a camera has moved.
///
/// # Errors
/// A rig that cannot be tracked with, a stream that cannot be read or shows too little.
pub fn run(folder: &Folder, rig: &Rig, args: &CheckArgs) -> Result<(Outcome, bool)> {
    tracker::rig_check::check(rig).map_err(|defect| anyhow::anyhow!("rig.json: {defect}"))?;
    let viewer = Viewer::new(rig);
    let view = viewer.view();
    let maps = Maps { viewer: &viewer, radius_mm: rig.workspace.tip_radius };
    let mut outcome = Outcome::default();
    let caption = "how well tips are known, from one frame".to_owned();
    outcome.pictures.push(("rig.png".into(), caption, plots::bytes(&maps, Format::Png)?));
    seen_by_cameras(&view, &mut outcome);
    let origin = Origin::of(args.from.as_deref(), &args.live);
    let holds = match origin {
        Some(origin) => holds(folder, rig, origin, &mut outcome)?,
        None => {
            let said = "whether the rig fits its cameras is unknown without a stream: run check --from STREAM, or --cameras";
            outcome.record.advice.push(said.into());
            true
        }
    };
    let record = &mut outcome.record;
    let lacks = if view.missing.is_empty() { "nothing is missing" } else { "something is missing" };
    let fits = match (origin, holds) {
        (None, _) => "not checked against a stream",
        (_, true) => "the calibration is still valid",
        (_, false) => "the calibration is no longer valid",
    };
    record.summary = format!("{lacks}; {fits}");
    Ok((outcome, holds && view.missing.is_empty()))
}

fn seen_by_cameras(view: &RigView, outcome: &mut Outcome) {
    let record = &mut outcome.record;
    for camera in &view.cameras {
        record.figure(
            format!("camera {}", camera.camera),
            format!(
                "sees {:.0} % of the workspace from {:.0} mm, {:.1} px/mm",
                100.0 * camera.sees,
                camera.distance_mm,
                camera.px_per_mm
            ),
        );
    }
    let um = |value: Option<f64>| value.map_or("unknown".into(), |um| format!("{um:.1} µm"));
    for tip in &view.tips {
        record.figure(
            format!("{}: tip from one frame", tip.body),
            format!("{} (median), {} (95 %)", um(tip.median_um), um(tip.p95_um)),
        );
    }
    record.advice.extend(view.missing.iter().cloned());
}

fn holds(folder: &Folder, rig: &Rig, origin: Origin<'_>, outcome: &mut Outcome) -> Result<bool> {
    let (stream, seen) = instants(folder, rig, origin)?;
    let found = drift_check::check(rig, &seen, LIMIT_PX)?;
    let (seen, bundle) = fitted(rig, &seen)?;
    let residuals = residuals_of(&seen, &bundle);
    for (index, camera) in rig.cameras.iter().enumerate() {
        let own: Vec<Residual> = residuals.iter().filter(|r| r.camera == index).copied().collect();
        let id = camera.id;
        outcome.pictures.push((
            format!("check-cam{id}.png"),
            format!("camera {id}: residuals of the stream over the picture"),
            residual_picture([camera.width, camera.height], &own)?,
        ));
    }
    let record = &mut outcome.record;
    record.from = origin.names();
    record.figure("residuals of the stream", format!("{:.3} px", found.rms_px));
    let judgement = judged(rig, &stream.fields);
    add_figures(&drift_report(rig, &found, LIMIT_PX, &judgement), record);
    if !judgement.holds {
        record.advice.push(judgement.text());
    }
    for (camera, shift) in rig.cameras.iter().zip(&found.cameras).filter(|(_, c)| c.drifted) {
        record.advice.push(format!(
            "camera {}: its residuals are shifted by {:.3} px (limit {LIMIT_PX}): fasten it, then repeat \
             poses --from STREAM (waved instruments) with --force",
            camera.id, shift.systematic_px
        ));
    }
    record.advice.extend(stream.advice());
    let fit = Fit::of(rig, &stream.fields);
    record.figure("residual of all blobs of the stream", fit.to_string());
    let fits = fit.share >= LEAST_SHARE && fit.left_px <= LARGEST_LEFT_PX;
    if !fits {
        record.advice.push(format!(
            "the rig does not fit the stream ({fit}; at least {:.0} % and at most {LARGEST_LEFT_PX} px are \
             required): repeat poses; vitreo residuals RECORDING --causes names the likely cause",
            100.0 * LEAST_SHARE
        ));
    }
    Ok(fits && !found.drifted() && judgement.holds)
}
