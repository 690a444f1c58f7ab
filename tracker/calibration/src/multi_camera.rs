//! Several cameras that see a common target in several views, and triangulation with them.

use crate::lens::LENS;
use crate::target_problem::{
    Calibrated, FreeParameters, Robustness, Scene, TargetProblem, TargetView, calibrate, calibrate_lens,
    camera_pose, set_camera_pose,
};
use crate::{CalibrationError, degenerate, linear};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Vector2, Vector3};
use rig::camera::Camera;

/// Called with the iteration and the cost.
pub type Progress<'a> = dyn FnMut(usize, f64) + 'a;

/// How the lenses are found of cameras that see a target together.
#[derive(Debug, Clone)]
pub enum LensMode {
    /// Calibrated by each camera alone, then refined together.
    Refined,
    /// Calibrated by each camera alone, then fixed.
    Held,
    /// Given, by camera, and fixed.
    Given(Vec<Camera>),
}

/// Calibrates cameras that see a target together: each lens alone, then all lenses and extrinsics
/// in one problem. The world is the frame of the first camera.
///
/// # Errors
/// Degenerate views, a camera that shares no view with the others, or a problem without a solution.
pub fn calibrate_cameras(
    sizes_px: &[[u32; 2]],
    sheets: &[TargetView],
    free: [bool; LENS],
    lenses: &LensMode,
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let views = sheets.iter().map(|s| s.view + 1).max().unwrap_or(0);
    let (mut alone, mut left_out) = (Vec::new(), Vec::new());
    let mut lens = vec![free; sizes_px.len()];
    for (c, &size) in sizes_px.iter().enumerate() {
        let own: Vec<TargetView> = sheets.iter().filter(|s| s.camera == c).cloned().collect();
        let (camera, found) = match lenses {
            LensMode::Given(cameras) => before(&cameras[c], &own)?,
            _ => {
                let all = FreeParameters { lens: free, place: false };
                let found = calibrate_lens(c as u32, size, &own, all, robustness, progress)?;
                // What a camera's own views leave open, those that it shares do not determine either.
                for &(_, term) in &found.left_out {
                    lens[c][term] = false;
                    left_out.push((c, term));
                }
                (found.scene.cameras[0].clone(), found.scene.views)
            }
        };
        // By view: where the target is before this camera.
        let mut places: Vec<Option<Isometry3<f64>>> = vec![None; views];
        own.iter().zip(found).for_each(|(sheet, place)| places[sheet.view] = Some(place));
        alone.push((camera, places));
    }
    let cameras = placed(&alone)?;
    let place = |v: usize| {
        let seen = alone.iter().zip(&cameras);
        let seen = seen.filter_map(|((_, places), camera)| Some(camera_pose(camera).inverse() * places[v]?));
        // A view that no camera saw has no unknowns; its pose does not matter.
        seen.into_iter().next().unwrap_or_else(Isometry3::identity)
    };
    let start = Scene { views: (0..views).map(place).collect(), cameras };
    let refined = matches!(lenses, LensMode::Refined);
    let free = lens.into_iter().enumerate().map(|(c, own)| {
        let lens = if refined { own } else { [false; LENS] };
        FreeParameters { lens, place: c > 0 }
    });
    let problem = TargetProblem::new(sheets, free.collect(), false, views);
    let found = calibrate(problem, start, robustness, progress)?;
    Ok(Calibrated { left_out, ..found })
}

/// A camera of known lens at the origin, and `camera_from_target` of each of its views.
fn before(known: &Camera, own: &[TargetView]) -> Result<(Camera, Vec<Isometry3<f64>>), CalibrationError> {
    let mut camera = known.clone();
    set_camera_pose(&mut camera, &Isometry3::identity());
    let places =
        own.iter().map(|s| linear::target_in_camera(&camera, &s.samples)).collect::<Result<_, _>>()?;
    Ok((camera, places))
}

type Alone = (Camera, Vec<Option<Isometry3<f64>>>);

/// Camera poses from views that two of them share, from the first camera outwards.
fn placed(alone: &[Alone]) -> Result<Vec<Camera>, CalibrationError> {
    let mut cameras: Vec<Option<Camera>> = vec![None; alone.len()];
    cameras[0] = Some(alone[0].0.clone());
    while let Some(next) = (0..alone.len()).find(|&c| {
        cameras[c].is_none()
            && (0..alone.len()).any(|k| cameras[k].is_some() && !shared(alone, k, c).is_empty())
    }) {
        let known = (0..alone.len()).filter(|&k| cameras[k].is_some());
        let from = known.max_by_key(|&k| shared(alone, k, next).len()).unwrap_or(0);
        let relative = medoid(&shared(alone, from, next));
        let mut camera = alone[next].0.clone();
        let base = cameras[from].as_ref().map_or_else(Isometry3::identity, camera_pose);
        set_camera_pose(&mut camera, &(relative * base));
        cameras[next] = Some(camera);
    }
    let lost = |c| degenerate(format!("camera {c} shares no view of the target with the others"));
    cameras.into_iter().enumerate().map(|(c, camera)| camera.ok_or_else(|| lost(c))).collect()
}

/// `c_from_k` by every view of both cameras.
fn shared(alone: &[Alone], k: usize, c: usize) -> Vec<Isometry3<f64>> {
    let both = alone[k].1.iter().zip(&alone[c].1);
    both.filter_map(|(a, b)| Some((*b)? * (*a)?.inverse())).collect()
}

/// The pose nearest to all others, robust against single wrong views.
fn medoid(all: &[Isometry3<f64>]) -> Isometry3<f64> {
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let far = a.translation.vector.norm().max(f64::MIN_POSITIVE);
        (a.translation.vector - b.translation.vector).norm() / far + a.rotation.angle_to(&b.rotation)
    };
    let sum = |a: &&Isometry3<f64>| all.iter().map(|b| distance(a, b)).sum::<f64>();
    all.iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).copied().unwrap_or_else(Isometry3::identity)
}

/// Most steps of the triangulation, and the step at which it ends, mm.
const TRIANGULATION: (usize, f64) = (20, 1e-9);

/// Covariance of what a dot's image points are off in all cameras (x and y of the first, then of the next, px²), from the
/// errors of known dots.
///
/// Cameras and axes differ. Errors of different cameras go together where dots are elsewhere than their list says, as in
/// lists that were triangulated themselves. Of `n` unknowns, few dots say little about such pairs: they count less by a
/// share of `n` over the number of dots.
pub fn noise_of(errors_px: &[DVector<f64>]) -> DMatrix<f64> {
    let (n, dots) = (errors_px.first().map_or(0, |e| e.len()), errors_px.len().max(1) as f64);
    let sum = errors_px.iter().fold(DMatrix::zeros(n, n), |sum, e| sum + e * e.transpose());
    let kept = 1.0 - (n as f64 / dots).min(1.0);
    let mut noise = sum.map_with_location(|r, c, v| v / dots * if r / 2 == c / 2 { 1.0 } else { kept });
    // Exact data have no noise; a thousandth of a pixel keeps the weights finite.
    noise += DMatrix::identity(n, n) * 1e-6;
    noise
}

/// An image point of one camera.
#[derive(Debug, Clone, Copy)]
pub struct ImagePoint<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The point, px.
    pub pixel: Vector2<f64>,
}

/// The most likely point of some image points, whose errors have a covariance as [`noise_of`] gives it. `None` for fewer
/// than two, parallel rays, or a point behind a camera.
pub fn triangulate(points: &[ImagePoint<'_>], covariance_px2: &DMatrix<f64>) -> Option<Point3<f64>> {
    if points.len() < 2 {
        return None;
    }
    let covariance = covariance_px2.clone().cholesky()?;
    let rays = points.iter().map(|p| Some((p.camera.centre_in_world(), p.camera.ray_in_world(p.pixel)?)));
    let mut at = linear::triangulate_rays(&rays.collect::<Option<Vec<_>>>()?)?;
    let (mut slope, mut off) = (DMatrix::zeros(2 * points.len(), 3), DVector::zeros(2 * points.len()));
    for _ in 0..TRIANGULATION.0 {
        for (i, ImagePoint { camera, pixel }) in points.iter().enumerate() {
            slope.fixed_view_mut::<2, 3>(2 * i, 0).copy_from(&camera.projection_jacobian(&at)?);
            off.fixed_rows_mut::<2>(2 * i).copy_from(&(pixel - camera.project(&at)?));
        }
        let weighted = covariance.solve(&slope);
        let step = slope.tr_mul(&weighted).cholesky()?.solve(&weighted.tr_mul(&off));
        at += Vector3::new(step[0], step[1], step[2]);
        if step.norm() < TRIANGULATION.1 {
            break;
        }
    }
    Some(at)
}
