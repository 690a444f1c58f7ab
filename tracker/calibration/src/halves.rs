//! Views that take no part: a calibration is judged by the half that it did not see, beside what was there.

use crate::CalibrationError;
use crate::lens::LENS;
use crate::linear::target_in_camera;
use crate::target_problem::{
    Calibrated, FreeParameters, Residual, Robustness, Scene, TargetProblem, TargetView, calibrate,
    camera_pose, residuals, rms,
};
use nalgebra::Isometry3;
use rig::camera::Camera;
use std::collections::BTreeSet;

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

/// Fewest views, or dots of a camera, of which halves are made.
const FEWEST: [usize; 2] = [6, 24];
/// Fewest views that are held out one by one.
const FEWEST_SINGLY: usize = 3;
/// Few views say little: they must be predicted better by 2 % at least.
const OF_FEW: f64 = 0.98;

/// Root mean square residuals of what took no part, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// With the cameras that were there; infinite where they see a point behind themselves.
    pub before_px: f64,
    /// With those that the other half gives.
    pub after_px: f64,
    /// Share of the residual before that may be left after.
    allowed: f64,
}

impl HeldOut {
    /// True if what was there predicts better, or of few views hardly worse.
    pub fn is_worse(&self) -> bool {
        self.after_px.is_nan() || self.after_px > self.allowed * self.before_px
    }

    /// Of views of a board: every second one, by `before` and by what `calibrated` makes of the others; of few views each
    /// one in turn. `None` of too few views, or if the others do not suffice.
    pub fn of_views(
        before: &[Camera],
        sheets: &[TargetView],
        mut calibrated: impl FnMut(&[TargetView]) -> Result<Calibrated, CalibrationError>,
    ) -> Option<Self> {
        let views: BTreeSet<usize> = sheets.iter().map(|s| s.view).collect();
        if views.len() < FEWEST_SINGLY {
            return None;
        }
        if views.len() < FEWEST[0] {
            return HeldOut::of_single_views(before, sheets, &views, calibrated);
        }
        let judge = half(sheets, true);
        let learnt = calibrated(&half(sheets, false)).ok()?;
        let [before_px, after_px] = [before, &learnt.scene.cameras].map(|cameras| rms_with(cameras, &judge));
        Some(HeldOut { before_px, after_px, allowed: 1.0 })
    }

    /// Each view in turn, by what `calibrated` makes of all others.
    fn of_single_views(
        before: &[Camera],
        sheets: &[TargetView],
        views: &BTreeSet<usize>,
        mut calibrated: impl FnMut(&[TargetView]) -> Result<Calibrated, CalibrationError>,
    ) -> Option<Self> {
        let mut sums = [0.0; 2];
        for &view in views {
            let (judge, learn): (Vec<TargetView>, Vec<TargetView>) =
                sheets.iter().cloned().partition(|s| s.view == view);
            let learnt = calibrated(&learn).ok()?;
            let points = judge.iter().map(|s| s.samples.len()).sum::<usize>() as f64;
            for (sum, cameras) in sums.iter_mut().zip([before, &learnt.scene.cameras]) {
                *sum += rms_with(cameras, &judge).powi(2) * points;
            }
        }
        let points = sheets.iter().map(|s| s.samples.len()).sum::<usize>().max(1) as f64;
        let [before_px, after_px] = sums.map(|sum| (sum / points).sqrt());
        Some(HeldOut { before_px, after_px, allowed: OF_FEW })
    }

    /// Of dots that stay in place: every second one of each camera, as [`HeldOut::of_views`] has it. The world is the frame
    /// of the dots for both.
    pub fn of_dots(
        before: &[Camera],
        sheets: &[TargetView],
        calibrated: impl FnOnce(&[TargetView]) -> Result<Calibrated, CalibrationError>,
    ) -> Option<Self> {
        if sheets.iter().any(|s| s.samples.len() < FEWEST[1]) {
            return None;
        }
        let of = |odd: usize| -> Vec<TargetView> {
            let samples = |s: &TargetView| s.samples.iter().skip(odd).step_by(2).copied().collect();
            sheets.iter().map(|s| TargetView { samples: samples(s), ..s.clone() }).collect()
        };
        let judge = of(1);
        let learnt = calibrated(&of(0)).ok()?;
        let left = |cameras: &[Camera]| {
            let scene = Scene { cameras: cameras.to_vec(), views: vec![Isometry3::identity()] };
            let left = residuals(&scene, &judge);
            let all = judge.iter().map(|s| s.samples.len()).sum::<usize>();
            if left.len() == all { rms(left.into_iter()) } else { f64::INFINITY }
        };
        Some(HeldOut { before_px: left(before), after_px: left(&learnt.scene.cameras), allowed: 1.0 })
    }
}
