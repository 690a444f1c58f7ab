//! Step `lenses`: the lens of each camera whose pictures show the board.

use crate::boards::{Boards, Seen, half, look, rms_with};
use crate::folder::{Outcome, Record};
use crate::pictures::PicturesArgs;
use crate::{Refused, refuse};
use anyhow::{Context, Result};
use calibration::cli::BoardArgs;
use calibration::lens::{LENS, LENS_NAMES, lens_of};
use calibration::residual_plot::ResidualPicture;
use calibration::rig_output::rig_with_lens;
use calibration::target_problem::{
    Calibrated, FreeParameters, Residual, Robustness, TargetView, calibrate_lens,
};
use plots::Format;
use rig::Rig;
use rig::camera::Camera;

/// Largest residuals of a lens, px.
pub const LARGEST_RMS_PX: f64 = 1.0;
/// A lens fits well up to this, px.
const GOOD_RMS_PX: f64 = 0.4;
/// Largest standard deviation of the focal lengths, as a share of them.
pub const LARGEST_DOUBT: f64 = 0.01;

/// Arguments of the step.
#[derive(Debug, Clone, clap::Args)]
pub struct LensesArgs {
    /// The pictures.
    #[command(flatten)]
    pub pictures: PicturesArgs,
    /// The board.
    #[command(flatten)]
    pub board: BoardArgs,
    /// Distortion terms fixed at 0, such as k2,k3; none frees all.
    #[arg(
        long, value_delimiter = ',', value_name = "TERMS", default_value = "k3",
        value_parser = ["k1", "k2", "p1", "p2", "k3", "none"], help_heading = "Solver"
    )]
    pub without: Vec<String>,
}

/// Runs the step.
///
/// # Errors
/// Pictures that cannot be read, or show too little of the board.
pub fn run(rig: &Rig, args: &LensesArgs) -> Result<Outcome> {
    let board = args.board.board()?;
    let Boards { cameras } = look(rig, &args.pictures, &board)?;
    refuse(cameras.iter().flat_map(|seen| seen.advice(true)).collect())?;
    let free = LENS_NAMES.map(|name| !args.without.iter().any(|w| w == name));
    let mut found = Vec::new();
    for seen in &cameras {
        found.push(of_camera(rig, seen, free)?);
    }
    let mut outcome = Outcome::default();
    outcome.record.from = args.pictures.names();
    let (mut new, mut rms) = (rig.clone(), Vec::new());
    for (seen, lens) in cameras.iter().zip(&found) {
        let fit = &lens.fit;
        describe(seen, lens, &mut outcome.record);
        rms.push(format!("{:.2}", fit.rms_px));
        let id = seen.id;
        outcome.pictures.push((
            format!("lens-cam{id}.png"),
            format!("camera {id}: residuals of its lens over the picture"),
            residual_picture(seen.size_px, &fit.residuals)?,
        ));
        if !lens.kept {
            new = rig_with_lens(&new, &fit.scene.cameras[0]).context("a camera of the rig")?;
        }
    }
    outcome.record.kept = found.iter().all(|lens| lens.kept);
    let ids: Vec<String> = cameras.iter().map(|c| c.id.to_string()).collect();
    outcome.record.summary = format!("cameras {}: residuals {} px", ids.join(", "), rms.join(", "));
    let others = rig.cameras.iter().filter(|c| cameras.iter().all(|s| s.id != c.id));
    outcome
        .record
        .advice
        .extend(others.map(|c| format!("camera {}: no pictures; its lens is unchanged", c.id)));
    outcome.rig = Some(new);
    Ok(outcome)
}

/// Residuals over a sensor as a PNG.
pub(crate) fn residual_picture(size_px: [u32; 2], residuals: &[Residual]) -> Result<Vec<u8>> {
    plots::bytes(&ResidualPicture { size_px, residuals }, Format::Png)
}

/// A lens, and how it and the one that was there fit pictures that took no part.
struct Lens {
    fit: Calibrated,
    held_out_px: f64,
    before_px: f64,
    kept: bool,
}

fn of_camera(rig: &Rig, seen: &Seen, free: [bool; LENS]) -> Result<Lens> {
    let id = seen.id;
    let free = FreeParameters { lens: free, place: false };
    let solve = |sheets: &[TargetView]| {
        calibrate_lens(id, seen.size_px, sheets, free, Robustness::Huber, &mut |_, _| {})
    };
    let tilt = |problem: &dyn std::fmt::Display| {
        Refused(vec![format!(
            "camera {id}: the pictures do not determine its lens ({problem}): tilt the board by 20° to 45°, to another side in \
             each picture"
        )])
    };
    let fit = solve(&seen.sheets).map_err(|problem| tilt(&problem))?;
    let rms = fit.rms_px;
    refuse(Vec::from_iter((rms > LARGEST_RMS_PX).then(|| {
        format!(
            "camera {id}: residuals of {rms:.2} px, at most {LARGEST_RMS_PX} are accepted: glue the board \
             onto something \
             flat, hold it still, and focus"
        )
    })))?;
    let [fx, fy, ..] = lens_of(&fit.scene.cameras[0]);
    let doubt = (fit.sigmas[0][0] / fx).abs().max((fit.sigmas[0][1] / fy).abs());
    if !doubt.is_finite() || doubt > LARGEST_DOUBT {
        return Err(tilt(&format!("the uncertainty of its focal length is {:.1} %", 100.0 * doubt)).into());
    }
    let before: Camera = rig.cameras[seen.index].model();
    let (learn, judge) = (alone(&half(&seen.sheets, false)), alone(&half(&seen.sheets, true)));
    let half_lens = solve(&learn).map_err(|problem| tilt(&problem))?.scene.cameras[0].clone();
    let [held_out_px, before_px] = [half_lens, before].map(|camera| rms_with(&[camera], &judge));
    Ok(Lens { fit, held_out_px, before_px, kept: before_px < held_out_px })
}

/// Sheets as of a first and only camera.
fn alone(sheets: &[TargetView]) -> Vec<TargetView> {
    sheets.iter().map(|s| TargetView { camera: 0, ..s.clone() }).collect()
}

fn describe(seen: &Seen, lens: &Lens, record: &mut Record) {
    let (id, fit) = (seen.id, &lens.fit);
    let camera = &fit.scene.cameras[0];
    record.figure(
        format!("camera {id}: pictures with the board"),
        format!("{} of {}; it fills {:.0} %", seen.sheets.len(), seen.pictures, 100.0 * seen.fill()),
    );
    let sigma = |i: usize| fit.sigmas[0][i];
    record.figure(
        format!("camera {id}: fx, fy, cx, cy"),
        format!(
            "{:.2} ± {:.2}, {:.2} ± {:.2}, {:.2} ± {:.2}, {:.2} ± {:.2} px",
            camera.focal_px.x,
            sigma(0),
            camera.focal_px.y,
            sigma(1),
            camera.centre_px.x,
            sigma(2),
            camera.centre_px.y,
            sigma(3)
        ),
    );
    let [k1, k2, p1, p2, k3] = camera.distortion;
    record.figure(
        format!("camera {id}: k1, k2, p1, p2, k3"),
        format!("{k1:.4}, {k2:.4}, {p1:.5}, {p2:.5}, {k3:.4}"),
    );
    record.figure(format!("camera {id}: residuals"), format!("{:.3} px", fit.rms_px));
    record.figure(
        format!("camera {id}: residuals of held-out pictures"),
        format!("{:.3} px; with the previous lens {:.3} px", lens.held_out_px, lens.before_px),
    );
    if lens.kept {
        record.notes.push(format!("camera {id}: the previous lens fits as well and is kept"));
    }
    if fit.rms_px > GOOD_RMS_PX {
        record.advice.push(format!(
            "camera {id}: residuals of {:.2} px are more than the usual 0.1 to 0.3: is the board flat, the picture sharp?",
            fit.rms_px
        ));
    }
    let bare = seen.bare_parts();
    if !bare.is_empty() {
        record
            .advice
            .push(format!("camera {id}: no board at the {}; a picture there would help", bare.join(", ")));
    }
}
