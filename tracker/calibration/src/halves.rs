//! Views that take no part: a calibration is judged by the half that it did not see, beside what was there.

use crate::CalibrationError;
use crate::lens::LENS;
use crate::linear::target_in_camera;
use crate::target_problem::{
    FreeParameters, Residual, Robustness, Scene, TargetProblem, TargetView, calibrate, camera_pose, rms,
};
use nalgebra::Isometry3;
use rig::camera::Camera;

/// Every second of some sheets, by view: `odd` or even ones.
pub fn half(sheets: &[TargetView], odd: bool) -> Vec<TargetView> {
    let mut views: Vec<usize> = sheets.iter().map(|s| s.view).collect();
    views.sort_unstable();
    views.dedup();
    let mine = |view: usize| views.binary_search(&view).is_ok_and(|at| (at % 2 == 1) == odd);
    sheets.iter().filter(|s| mine(s.view)).cloned().collect()
}

/// Residuals of sheets with the cameras as they are, the board laid where it fits best.
///
/// # Errors
/// Sheets in which the board cannot be laid.
pub fn residuals_with(cameras: &[Camera], sheets: &[TargetView]) -> Result<Vec<Residual>, CalibrationError> {
    let views = sheets.iter().map(|s| s.view + 1).max().unwrap_or(0);
    let place = |view: usize| {
        let Some(sheet) = sheets.iter().find(|s| s.view == view) else { return Ok(Isometry3::identity()) };
        let camera = &cameras[sheet.camera];
        Ok(camera_pose(camera).inverse() * target_in_camera(camera, &sheet.samples)?)
    };
    let places = (0..views).map(place).collect::<Result<Vec<_>, CalibrationError>>()?;
    let held = FreeParameters { lens: [false; LENS], place: false };
    let problem = TargetProblem::new(sheets, vec![held; cameras.len()], false, views);
    let scene = Scene { cameras: cameras.to_vec(), views: places };
    Ok(calibrate(problem, scene, Robustness::Huber, &mut |_, _| {})?.residuals)
}

/// Their root mean square length, px; infinite where the board cannot be laid at all.
pub fn rms_with(cameras: &[Camera], sheets: &[TargetView]) -> f64 {
    residuals_with(cameras, sheets).map_or(f64::INFINITY, |r| rms(r.into_iter()))
}
