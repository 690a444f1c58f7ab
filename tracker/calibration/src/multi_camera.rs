//! Several cameras: from views of a common target, or from dots whose places are known.

use crate::CalibrationError;
use crate::linear;
use crate::solve::Loss;
use crate::target_problem::{
    Calibrated, Free, Residual, Robustness, Sample, Scene, Sheet, TargetProblem, calibrate, lens_of_views,
    place_of, put,
};
use nalgebra::{Isometry3, Matrix2, Point3, Vector2};
use protocol::camera::Camera;

/// Told the stage, the iteration and the cost.
pub type Progress<'a> = dyn FnMut(usize, f64) + 'a;

/// What becomes of the lenses of cameras that see a target together.
#[derive(Debug, Clone)]
pub enum Lenses {
    /// Found by each camera alone, then refined together.
    Refined,
    /// Found by each camera alone, then held.
    Held,
    /// Known before, by camera, and held.
    Known(Vec<Camera>),
}

/// Cameras that see a target together: each lens alone, then all lenses and places in one.
///
/// The world is the first camera's frame.
pub fn cameras_of_views(
    sizes_px: &[[u32; 2]],
    sheets: &[Sheet],
    free: [bool; crate::lens::LENS],
    lenses: &Lenses,
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let views = sheets.iter().map(|s| s.view + 1).max().unwrap_or(0);
    let mut alone = Vec::new();
    for (c, &size) in sizes_px.iter().enumerate() {
        let own: Vec<Sheet> = sheets.iter().filter(|s| s.camera == c).cloned().collect();
        let (camera, found) = match lenses {
            Lenses::Known(cameras) => before(&cameras[c], &own)?,
            _ => {
                let lens = Free { lens: free, place: false };
                let found = lens_of_views(c as u32, size, &own, lens, robustness, progress)?;
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
        let seen = seen.filter_map(|((_, places), camera)| Some(place_of(camera).inverse() * places[v]?));
        // A view that nobody saw has no sheets; any place will do, and it is held below.
        seen.into_iter().next().unwrap_or_else(Isometry3::identity)
    };
    let start = Scene { views: (0..views).map(place).collect(), cameras };
    let lens = if matches!(lenses, Lenses::Refined) { free } else { [false; crate::lens::LENS] };
    let problem = TargetProblem {
        sheets,
        free: (0..sizes_px.len()).map(|c| Free { lens, place: c > 0 }).collect(),
        fixed_views: false,
        views: start.views.len(),
        sigma_px: 1.0,
        loss: Loss::Square,
    };
    calibrate(problem, start, robustness, progress)
}

/// A camera of known lens at the origin, and where each sheet's target is before it.
fn before(known: &Camera, own: &[Sheet]) -> Result<(Camera, Vec<Isometry3<f64>>), CalibrationError> {
    let mut camera = known.clone();
    put(&mut camera, &Isometry3::identity());
    let places =
        own.iter().map(|s| linear::target_in_camera(&camera, &s.samples)).collect::<Result<_, _>>()?;
    Ok((camera, places))
}

type Alone = (Camera, Vec<Option<Isometry3<f64>>>);

/// Places of cameras from views that two of them share, from the first camera outwards.
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
        let base = cameras[from].as_ref().map_or_else(Isometry3::identity, place_of);
        put(&mut camera, &(relative * base));
        cameras[next] = Some(camera);
    }
    let lost = cameras.iter().position(Option::is_none);
    lost.map_or_else(
        || Ok(cameras.iter().flatten().cloned().collect()),
        |c| {
            Err(CalibrationError::Geometry(format!(
                "camera {c} shares no view of the target with the others"
            )))
        },
    )
}

/// `c_from_k` by every view that both saw.
fn shared(alone: &[Alone], k: usize, c: usize) -> Vec<Isometry3<f64>> {
    let both = alone[k].1.iter().zip(&alone[c].1);
    both.filter_map(|(a, b)| Some((*b)? * (*a)?.inverse())).collect()
}

/// The one nearest to all others: a view gone wrong does not move it.
fn medoid(all: &[Isometry3<f64>]) -> Isometry3<f64> {
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let far = a.translation.vector.norm().max(f64::MIN_POSITIVE);
        (a.translation.vector - b.translation.vector).norm() / far + a.rotation.angle_to(&b.rotation)
    };
    let sum = |a: &&Isometry3<f64>| all.iter().map(|b| distance(a, b)).sum::<f64>();
    all.iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).copied().unwrap_or_else(Isometry3::identity)
}

/// What is known of a camera before dots place it.
#[derive(Debug, Clone)]
pub enum Before {
    /// Nothing but the size of its pictures, px.
    Size([u32; 2]),
    /// Its lens, which stays as it is.
    Lens(Camera),
}

/// Cameras that see dots of known places: their places, and their lenses where those are not known.
/// Sheets are one per camera; the world is the frame of the dots.
pub fn cameras_of_dots(
    before: &[Before],
    sheets: &[Sheet],
    free: [bool; crate::lens::LENS],
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let mut cameras = Vec::new();
    for (c, before) in before.iter().enumerate() {
        let own = sheets.iter().find(|s| s.camera == c);
        let samples = own.map(|s| s.samples.as_slice()).unwrap_or_default();
        if samples.is_empty() {
            return Err(CalibrationError::Geometry(format!("camera {c} sees no dot")));
        }
        cameras.push(match before {
            Before::Size(size) => {
                if linear::plane_of(samples)?.is_some() {
                    let problem = "all dots lie in one plane, which does not fix a lens: \
                        use a stepped target, or give the lens";
                    return Err(CalibrationError::Geometry(problem.into()));
                }
                linear::camera_from_dots(c as u32, *size, samples)?
            }
            Before::Lens(camera) => {
                let mut camera = camera.clone();
                let place = linear::target_in_camera(&camera, samples)?;
                put(&mut camera, &place);
                camera
            }
        });
    }
    let free_of = |before: &Before| match before {
        Before::Size(_) => Free { lens: free, place: true },
        Before::Lens(_) => Free { lens: [false; crate::lens::LENS], place: true },
    };
    let problem = TargetProblem {
        sheets,
        free: before.iter().map(free_of).collect(),
        fixed_views: true,
        views: 1,
        sigma_px: 1.0,
        loss: Loss::Square,
    };
    let start = Scene { cameras, views: vec![Isometry3::identity()] };
    calibrate(problem, start, robustness, progress)
}

/// Steps of the triangulation, and the step in mm at which it stands still.
const TRIANGULATION: (usize, f64) = (20, 1e-9);

/// Covariance of the image points of each camera, px², from its residuals: cameras differ, and so do
/// columns and lines.
pub fn noise_of(residuals: &[Residual], cameras: usize) -> Vec<Matrix2<f64>> {
    let of_camera = |c: usize| {
        let own = residuals.iter().filter(|r| r.camera == c).map(|r| r.error);
        let n = own.clone().count().max(1) as f64;
        // Exact data have no noise; a thousandth of a pixel keeps the weights finite.
        own.map(|e| e * e.transpose()).sum::<Matrix2<f64>>() / n + Matrix2::identity() * 1e-6
    };
    (0..cameras).map(of_camera).collect()
}

/// What a camera saw of a point: the camera, the image point (px) and its covariance (px²).
pub type Sight<'a> = (&'a Camera, Vector2<f64>, Matrix2<f64>);

/// The most likely point for some sights. `None` for fewer than two, parallel rays, or a point
/// behind a camera.
pub fn triangulate(sights: &[Sight<'_>]) -> Option<Point3<f64>> {
    if sights.len() < 2 {
        return None;
    }
    let weights = sights.iter().map(|s| s.2.try_inverse()).collect::<Option<Vec<_>>>()?;
    let rays = sights.iter().map(|(c, p, _)| Some((c.centre_in_world(), c.ray_in_world(*p)?)));
    let mut at = linear::meeting_point(&rays.collect::<Option<Vec<_>>>()?)?;
    for _ in 0..TRIANGULATION.0 {
        let (mut m, mut r) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
        for ((camera, pixel, _), weight) in sights.iter().zip(&weights) {
            let slope = camera.projection_jacobian(&at)?;
            m += slope.transpose() * weight * slope;
            r += slope.transpose() * weight * (pixel - camera.project(&at)?);
        }
        let step = m.cholesky()?.solve(&r);
        at += step;
        if step.norm() < TRIANGULATION.1 {
            break;
        }
    }
    Some(at)
}

/// Root mean square errors along x, y, z (mm) of dots that all cameras see, triangulated after a
/// calibration on the other dots. `chosen` says which dots calibrate.
pub fn held_out(
    before: &[Before],
    sheets: &[Sheet],
    free: [bool; crate::lens::LENS],
    robustness: Robustness,
    chosen: &dyn Fn(usize) -> bool,
) -> Result<[f64; 3], CalibrationError> {
    let common = common_dots(sheets, before.len());
    let part = |which: &dyn Fn(usize) -> bool| -> Vec<Sheet> {
        let of = |sheet: &Sheet| Sheet {
            samples: common
                .iter()
                .enumerate()
                .filter(|(i, _)| which(*i))
                .map(|(_, dot)| Sample { point: dot.0, pixel: dot.1[sheet.camera] })
                .collect(),
            ..sheet.clone()
        };
        sheets.iter().map(of).collect()
    };
    let known = part(&|i| chosen(i));
    let calibrated = cameras_of_dots(before, &known, free, robustness, &mut |_, _| {})?;
    let cameras = &calibrated.scene.cameras;
    let noise = noise_of(&calibrated.residuals, cameras.len());
    let (mut squares, mut n) = (nalgebra::Vector3::zeros(), 0);
    for (_, (point, pixels)) in common.iter().enumerate().filter(|(i, _)| !chosen(*i)) {
        let sights = cameras.iter().zip(pixels).zip(&noise);
        let sights: Vec<Sight<'_>> =
            sights.map(|((camera, pixel), noise)| (camera, *pixel, *noise)).collect();
        let found = triangulate(&sights)
            .ok_or_else(|| CalibrationError::Geometry("rays of the cameras do not meet".into()))?;
        squares += (found - point).map(|e| e * e);
        n += 1;
    }
    Ok((squares / f64::from(n.max(1))).map(f64::sqrt).into())
}

/// Dots that every camera sees, with their pixels by camera.
pub fn common_dots(sheets: &[Sheet], cameras: usize) -> Vec<(Point3<f64>, Vec<Vector2<f64>>)> {
    let Some(first) = sheets.iter().find(|s| s.camera == 0) else { return Vec::new() };
    let pixel_of = |camera: usize, point: &Point3<f64>| {
        let own = sheets.iter().filter(|s| s.camera == camera).flat_map(|s| &s.samples);
        own.clone().find(|s| (s.point - point).norm() < 1e-6).map(|s| s.pixel)
    };
    let dot = |sample: &Sample| {
        let pixels = (0..cameras).map(|c| pixel_of(c, &sample.point)).collect::<Option<Vec<_>>>()?;
        Some((sample.point, pixels))
    };
    first.samples.iter().filter_map(dot).collect()
}
