//! Several cameras that see a common target in several views, and triangulation with them.

use crate::halves::residuals_with;
use crate::lens::{DISTORTION, LENS};
use crate::target_problem::{
    Calibrated, DISPENSABLE, FreeParameters, Residual, Robustness, Scene, TargetProblem, TargetView,
    calibrate, camera_pose, check_views, lens_of_views, robust_sigma, set_camera_pose,
};
use crate::weak_terms::next_to_hold;
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
/// in one problem. The world is the frame of the first camera. Lens terms that the views do not
/// determine are held at zero and listed in [`Calibrated::left_out`].
///
/// # Errors
/// Too few or degenerate views, a camera that shares no view with the others, or a problem without a solution.
pub fn calibrate_cameras(
    sizes_px: &[[u32; 2]],
    sheets: &[TargetView],
    free: [bool; LENS],
    lenses: &LensMode,
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    if !matches!(lenses, LensMode::Given(_)) {
        for c in 0..sizes_px.len() {
            check_views(sheets.iter().filter(|s| s.camera == c))?;
        }
    }
    cameras_of_views(sizes_px, sheets, free, lenses, robustness, progress)
}

/// As [`calibrate_cameras`], also from two views, as they are left when a third one is held out.
///
/// # Errors
/// As [`calibrate_cameras`].
pub fn cameras_of_views(
    sizes_px: &[[u32; 2]],
    sheets: &[TargetView],
    free: [bool; LENS],
    lenses: &LensMode,
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let views = sheets.iter().map(|s| s.view + 1).max().unwrap_or(0);
    let mut alone = Vec::new();
    for (c, &size) in sizes_px.iter().enumerate() {
        let own: Vec<TargetView> = sheets.iter().filter(|s| s.camera == c).cloned().collect();
        let (camera, found, lens) = match lenses {
            LensMode::Given(cameras) => given(&cameras[c], &own)?,
            _ => calibrated(c, size, &own, free, robustness, progress)?,
        };
        // By view: where the target is before this camera.
        let mut places: Vec<Option<Isometry3<f64>>> = vec![None; views];
        own.iter().zip(found).for_each(|(sheet, place)| places[sheet.view] = Some(place));
        alone.push(Alone { camera, places, lens });
    }
    let start = start(&alone, views)?;
    let found = if matches!(lenses, LensMode::Refined) {
        refined(sheets, start, &alone, free, robustness, progress)?
    } else {
        let fixed = (0..alone.len()).map(|c| FreeParameters { lens: [false; LENS], place: c > 0 });
        let problem = TargetProblem::new(sheets, fixed.collect(), false, views);
        let found = calibrate(problem, start, robustness, progress)?;
        let doubt_px = alone.iter().map(|a| a.lens.doubt_px).collect();
        Calibrated { left_out: held_terms(&alone), doubt_px, ..found }
    };
    Ok(Calibrated { alone_px: alone_px(&alone, sheets), ..found })
}

/// As [`Calibrated::alone_px`].
fn alone_px(alone: &[Alone], sheets: &[TargetView]) -> f64 {
    let is_shared =
        |sheet: &TargetView| sheets.iter().any(|s| s.view == sheet.view && s.camera != sheet.camera);
    let mut all = Vec::new();
    for (c, one) in alone.iter().enumerate() {
        let shared: Vec<bool> = sheets.iter().filter(|s| s.camera == c).map(is_shared).collect();
        all.extend(one.lens.residuals.iter().filter(|r| shared[r.sheet]).copied());
    }
    if all.is_empty() { 0.0 } else { robust_sigma(&all) }
}

/// Sheets of one camera as of the only one, each a view of its own.
fn single(own: &[TargetView]) -> Vec<TargetView> {
    let sheet = |(view, s): (usize, &TargetView)| TargetView { camera: 0, view, ..s.clone() };
    own.iter().enumerate().map(sheet).collect()
}

/// Cameras and target where the cameras' own calibrations put them.
fn start(alone: &[Alone], views: usize) -> Result<Scene, CalibrationError> {
    let cameras = placed(alone)?;
    let place = |v: usize| {
        let mut seen = alone
            .iter()
            .zip(&cameras)
            .filter_map(|(one, camera)| Some(camera_pose(camera).inverse() * one.places[v]?));
        // A view that no camera saw has no unknowns; its pose does not matter.
        seen.next().unwrap_or_else(Isometry3::identity)
    };
    Ok(Scene { views: (0..views).map(place).collect(), cameras })
}

fn held_terms(alone: &[Alone]) -> Vec<(usize, usize)> {
    let of = |(c, one): (usize, &Alone)| one.lens.held.iter().map(move |&term| (c, term)).collect::<Vec<_>>();
    alone.iter().enumerate().flat_map(of).collect()
}

/// Lenses and extrinsics in one problem, without the lens terms that the views do not determine.
fn refined(
    sheets: &[TargetView],
    mut start: Scene,
    alone: &[Alone],
    free: [bool; LENS],
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    // What a camera's own views leave open, those that it shares do not determine either.
    let mut left_out = held_terms(alone);
    loop {
        let lens = |c: usize| std::array::from_fn(|term| free[term] && !left_out.contains(&(c, term)));
        let lenses: Vec<[bool; LENS]> = (0..alone.len()).map(lens).collect();
        let all = lenses.iter().enumerate().map(|(c, &lens)| FreeParameters { lens, place: c > 0 });
        let problem = TargetProblem::new(sheets, all.collect(), false, start.views.len());
        let weak = match calibrate(problem, start.clone(), robustness, progress) {
            Ok(found) => {
                let weak = (0..alone.len()).find_map(|c| Some((c, next_to_hold(&found, c, &lenses[c])?)));
                let Some(weak) = weak else { return Ok(Calibrated { left_out, ..found }) };
                weak
            }
            Err(problem) => {
                let terms = DISPENSABLE.into_iter().flat_map(|term| (0..alone.len()).map(move |c| (c, term)));
                let free = terms.into_iter().find(|&(c, term)| lenses[c][term]);
                let Some(weak) = free.filter(|_| problem.is_undetermined()) else { return Err(problem) };
                weak
            }
        };
        start.cameras[weak.0].distortion[weak.1 - DISTORTION] = 0.0;
        left_out.push(weak);
    }
}

/// A camera at the origin, `camera_from_target` of each of its views, and what is known of its lens.
type Placed = (Camera, Vec<Isometry3<f64>>, Lens);

/// A camera whose lens its own views give.
fn calibrated(
    c: usize,
    size_px: [u32; 2],
    own: &[TargetView],
    free: [bool; LENS],
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Placed, CalibrationError> {
    let all = FreeParameters { lens: free, place: false };
    let found = lens_of_views(c as u32, size_px, own, all, robustness, progress)?;
    let held = found.left_out.iter().map(|o| o.1).collect();
    let lens = Lens { held, doubt_px: found.doubt_px[0], residuals: found.residuals };
    Ok((found.scene.cameras[0].clone(), found.scene.views, lens))
}

/// A camera of known lens.
fn given(known: &Camera, own: &[TargetView]) -> Result<Placed, CalibrationError> {
    let mut camera = known.clone();
    set_camera_pose(&mut camera, &Isometry3::identity());
    let places =
        own.iter().map(|s| linear::target_in_camera(&camera, &s.samples)).collect::<Result<_, _>>()?;
    // Only for a comparison: a camera that cannot be fitted alone may be fitted with the others.
    let residuals = residuals_with(std::slice::from_ref(&camera), &single(own)).unwrap_or_default();
    Ok((camera, places, Lens { held: Vec::new(), doubt_px: 0.0, residuals }))
}

/// What a camera's own views leave open of its lens.
struct Lens {
    /// Terms that are held at zero.
    held: Vec<usize>,
    /// As [`Calibrated::doubt_px`].
    doubt_px: f64,
    /// Residuals of this camera alone; their sheets are its own.
    residuals: Vec<Residual>,
}

/// A camera by itself, at the origin.
struct Alone {
    camera: Camera,
    /// `camera_from_target` of each view that it saw.
    places: Vec<Option<Isometry3<f64>>>,
    lens: Lens,
}

/// Camera poses from views that two of them share, from the first camera outwards.
fn placed(alone: &[Alone]) -> Result<Vec<Camera>, CalibrationError> {
    let mut cameras: Vec<Option<Camera>> = vec![None; alone.len()];
    cameras[0] = Some(alone[0].camera.clone());
    while let Some(next) = (0..alone.len()).find(|&c| {
        cameras[c].is_none()
            && (0..alone.len()).any(|k| cameras[k].is_some() && !shared(alone, k, c).is_empty())
    }) {
        let known = (0..alone.len()).filter(|&k| cameras[k].is_some());
        let from = known.max_by_key(|&k| shared(alone, k, next).len()).unwrap_or(0);
        let relative = medoid(&shared(alone, from, next));
        let mut camera = alone[next].camera.clone();
        let base = cameras[from].as_ref().map_or_else(Isometry3::identity, camera_pose);
        set_camera_pose(&mut camera, &(relative * base));
        cameras[next] = Some(camera);
    }
    let lost = |c| degenerate(format!("camera {c} shares no view of the target with the others"));
    cameras.into_iter().enumerate().map(|(c, camera)| camera.ok_or_else(|| lost(c))).collect()
}

/// `c_from_k` by every view of both cameras.
fn shared(alone: &[Alone], k: usize, c: usize) -> Vec<Isometry3<f64>> {
    let both = alone[k].places.iter().zip(&alone[c].places);
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
