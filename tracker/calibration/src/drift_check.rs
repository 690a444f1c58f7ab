//! Statistical test for a camera that has moved since the calibration of its rig.
//!
//! Every pose is fitted with the rig as it is. The residuals of an unmoved camera are noise; those
//! of a camera that was rotated or moved follow a smooth field over the sensor: the motion of its
//! image. That field is fitted to the residuals of each camera (six parameters), and its root mean
//! square over the observations is the test statistic, in px. The stream is cut into stretches,
//! whose scatter gives the standard deviation of the statistic by chance.
//!
//! The statistic is a lower bound of the drift: motions that the poses absorb (of the whole rig
//! about the eye's centre, of all markers of a body together) leave no residual.

use crate::bundle::Bundle;
use crate::lens::{EXTRINSICS, by_extrinsics, project};
use crate::observations::{FrameObservations, MarkerObservation};
use crate::self_calibration::{camera_rms, every_camera_saw, fitted, residuals_of};
use crate::target_problem::rms;
use crate::{CalibrationError, degenerate};
use nalgebra::{Matrix2, SMatrix, SVector};
use rig::Rig;

/// Stretches into which a stream is cut.
const STRETCHES: usize = 8;
/// Fewest instants of a stretch.
const FEWEST: usize = 5;
/// Least ratio of a significant shift to that by chance.
const CHANCE: f64 = 3.0;

/// The test of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraShift {
    /// Root mean square of the systematic part of the residuals, px.
    pub systematic_px: f64,
    /// What chance alone would make of it, px.
    pub chance_px: f64,
    /// Root mean square of all its residuals, px.
    pub rms_px: f64,
    /// Blobs used.
    pub blobs: usize,
    /// True if the shift is beyond the limit and significant.
    pub drifted: bool,
}

/// The result of a drift check.
#[derive(Debug, Clone)]
pub struct DriftCheck {
    /// By camera, in the order of the rig.
    pub cameras: Vec<CameraShift>,
    /// Root mean square of all residuals, px.
    pub rms_px: f64,
    /// Instants used.
    pub instants: usize,
}

impl DriftCheck {
    /// True if any camera has drifted.
    pub fn drifted(&self) -> bool {
        self.cameras.iter().any(|c| c.drifted)
    }
}

/// Checks a rig against a stream; `limit_px` is the tolerated systematic shift.
///
/// # Errors
/// Too few usable instants, or a camera without observations.
pub fn check(
    rig: &Rig,
    instants: &[FrameObservations],
    limit_px: f64,
) -> Result<DriftCheck, CalibrationError> {
    let (instants, bundle) = fitted(rig, instants)?;
    if instants.len() < STRETCHES * FEWEST {
        let needed = STRETCHES * FEWEST;
        let problem = format!("bodies were seen at {} instants; a check needs {needed}", instants.len());
        return Err(degenerate(problem));
    }
    let residuals = residuals_of(&instants, &bundle);
    every_camera_saw(rig, &residuals)?;
    let cameras = (0..rig.cameras.len()).map(|camera| {
        let (systematic_px, chance_px) = systematic(&instants, &bundle, camera);
        let blobs = residuals.iter().filter(|r| r.camera == camera).count();
        let drifted = systematic_px > limit_px && systematic_px > CHANCE * chance_px;
        CameraShift { systematic_px, chance_px, rms_px: camera_rms(&residuals, camera), blobs, drifted }
    });
    let cameras = cameras.collect();
    Ok(DriftCheck { cameras, rms_px: rms(residuals.iter().copied()), instants: instants.len() })
}

type Matrix6 = SMatrix<f64, EXTRINSICS, EXTRINSICS>;
type Vector6 = SVector<f64, EXTRINSICS>;

/// The field's root mean square, and what chance makes of it.
fn systematic(instants: &[FrameObservations], bundle: &Bundle, camera: usize) -> (f64, f64) {
    let mut stretches = Vec::new();
    let (mut spread, mut blobs) = (Matrix6::zeros(), 0.0);
    for stretch in 0..STRETCHES {
        let cut = |s: usize| s * instants.len() / STRETCHES;
        let (mut m, mut r) = (Matrix6::zeros(), Vector6::zeros());
        for i in cut(stretch)..cut(stretch + 1) {
            for (slope, error, weight) in rows(instants, bundle, camera, i) {
                m += slope.transpose() * weight * slope;
                r += slope.transpose() * weight * error;
                spread += slope.transpose() * slope;
                blobs += 1.0;
            }
        }
        // A stretch with too few observations is skipped.
        if let Some(inverse) = m.try_inverse() {
            stretches.push(inverse * r);
        }
    }
    if stretches.len() < 2 || blobs == 0.0 {
        return (0.0, 0.0);
    }
    let n = stretches.len() as f64;
    let mean = stretches.iter().sum::<Vector6>() / n;
    let scatter = stretches.iter().map(|s| (s - mean) * (s - mean).transpose()).sum::<Matrix6>();
    let chance = scatter / (n * (n - 1.0));
    let field = spread / blobs;
    ((mean.dot(&(field * mean))).max(0.0).sqrt(), (field * chance).trace().max(0.0).sqrt())
}

type Row = (SMatrix<f64, 2, EXTRINSICS>, nalgebra::Vector2<f64>, Matrix2<f64>);

/// Residuals of a camera at an instant, with how its place moves its image, and their weights.
fn rows(instants: &[FrameObservations], bundle: &Bundle, camera: usize, i: usize) -> Vec<Row> {
    let row = |seen: &MarkerObservation| {
        let pose = bundle.pose_at_exposure(i, &instants[i], seen)?;
        let model = &bundle.cameras[camera];
        let image = bundle.image(&pose, seen)?;
        let p = model.in_camera(&image.point);
        let slope = project(model, &p)?.by_point * by_extrinsics(model, &p);
        let error = seen.pixel - image.pixel;
        let weight = seen.covariance.try_inverse()?;
        // Blobs far off are outliers, not drift (Cauchy at 4 standard deviations).
        let doubt = 1.0 + error.dot(&(weight * error)) / 16.0;
        Some((slope, error, weight / doubt))
    };
    instants[i].seen.iter().filter(|s| s.camera == camera).filter_map(row).collect()
}
