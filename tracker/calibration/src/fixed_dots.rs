//! Cameras that see dots of known places: each alone, since nothing but the dots binds them.

use crate::lens::{LENS, LENS_NAMES, lens_of};
use crate::multi_camera::{ImagePoint, Progress, noise_of, triangulate};
use crate::rig_output::rig_camera;
use crate::target_problem::{
    Calibrated, Correspondence, DISPENSABLE, FreeParameters, Robustness, Scene, TargetProblem, TargetView,
    calibrate, residuals, rms, set_camera_pose, with_weak_terms_held,
};
use crate::{CalibrationError, degenerate, disagreement, linear, starts};
use nalgebra::{DVector, Isometry3, Point3, Vector2};
use rig::camera::Camera;

/// What is known of a camera before its calibration.
#[derive(Debug, Clone)]
pub enum CameraPrior {
    /// Nothing but the size of its pictures, px.
    Size([u32; 2]),
    /// Its lens, which is fixed.
    Lens(Camera),
}

impl CameraPrior {
    /// Size of the camera's pictures, px.
    pub fn size_px(&self) -> [u32; 2] {
        match self {
            CameraPrior::Size(size) => *size,
            CameraPrior::Lens(camera) => camera.size_px,
        }
    }
}

/// Root mean square residual, as a share of the picture's width, from which dots and camera do not belong together;
/// that of good lenses is a tenth of it.
const MISFIT: f64 = 0.0025;
/// Standard deviation of a focal length, as a share of it, from which the dots do not fix it.
const UNSURE: f64 = 0.5;

/// Calibrates cameras that see dots of known positions: their extrinsics, and the lenses that are
/// not known. There is one view per camera; the world is the frame of the dots. Lens terms that
/// the dots of a camera do not determine are held at zero and listed in
/// [`Calibrated::left_out`]. Every point takes part; see [`crate::agreement`] for lists with wrong ones.
///
/// # Errors
/// Every camera that has no dots, or dots that do not determine it or do not fit any camera, by its
/// number.
pub fn calibrate_on_dots(
    before: &[CameraPrior],
    sheets: &[TargetView],
    free: [bool; LENS],
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let one = |(index, before): (usize, &CameraPrior)| {
        let camera = OneCamera { index, before, free, robustness };
        let own = sheets.iter().find(|s| s.camera == index).map(|s| s.samples.as_slice());
        camera.fitting(camera.solved(own.unwrap_or_default(), progress)?)
    };
    together(before.iter().enumerate().map(one).collect(), sheets)
}

/// One of the cameras, and how it is calibrated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OneCamera<'a> {
    /// Its index.
    pub(crate) index: usize,
    /// What is known of it.
    pub(crate) before: &'a CameraPrior,
    /// Values of its lens that are to be found if it is not known.
    pub(crate) free: [bool; LENS],
    /// Weights of residuals.
    pub(crate) robustness: Robustness,
}

impl OneCamera<'_> {
    /// Width of its pictures, px.
    pub(crate) fn width(&self) -> f64 {
        f64::from(self.before.size_px()[0])
    }

    /// Its place, and its lens with as many terms as the dots determine. Terms that bend or fold the picture as no lens
    /// does are not determined, although the solution has small residuals at the dots.
    pub(crate) fn solved(
        &self,
        samples: &[Correspondence],
        progress: &mut Progress<'_>,
    ) -> Result<Calibrated, CalibrationError> {
        let starts = first_guesses(self.index as u32, self.before, samples)?;
        let mut free = match self.before {
            CameraPrior::Size(_) => self.free,
            CameraPrior::Lens(_) => [false; LENS],
        };
        let mut bent = Vec::new();
        loop {
            let mut found = self.ended(samples, &starts, free, progress)?;
            found.left_out.iter().for_each(|&(_, term)| free[term] = false);
            let is_lens = rig_camera(&found.scene.cameras[0]).defect_of_distortion().is_none();
            let next = DISPENSABLE.into_iter().find(|&term| free[term]);
            let Some(term) = next.filter(|_| !is_lens) else {
                found.left_out = bent.into_iter().chain(found.left_out).collect();
                return Ok(found);
            };
            bent.extend(found.left_out.iter().copied().chain([(self.index, term)]));
            free[term] = false;
        }
    }

    /// The best end of some starts, with the values in `free` or fewer of them.
    fn ended(
        &self,
        samples: &[Correspondence],
        starts: &[Camera],
        free: [bool; LENS],
        progress: &mut Progress<'_>,
    ) -> Result<Calibrated, CalibrationError> {
        let own = [TargetView { name: String::new(), camera: 0, view: 0, samples: samples.to_vec() }];
        let ((found, rival), left_out) = with_weak_terms_held(free, |free| {
            let from = |start: Camera| {
                let problem =
                    TargetProblem::new(&own, vec![FreeParameters { lens: free, place: true }], true, 1);
                let start = Scene { cameras: vec![start], views: vec![Isometry3::identity()] };
                calibrate(problem, start, self.robustness, progress)
            };
            starts::best(starts.iter().cloned().map(from))
        })?;
        let left_out = left_out.into_iter().map(|term| (self.index, term)).collect();
        let remarks = rival.map(|said| format!("camera {}: {said}", self.index)).into_iter().collect();
        Ok(Calibrated { left_out, remarks, ..found })
    }

    /// The calibration, unless its residuals are too large for any lens or its focal length is not known.
    pub(crate) fn fitting(&self, found: Calibrated) -> Result<Calibrated, CalibrationError> {
        if found.rms_px > MISFIT * self.width() {
            return Err(disagreement(format!(
                "residuals of {:.1} px rms, expected at most {:.1} px: its image points are not those of its dots",
                found.rms_px,
                MISFIT * self.width()
            )));
        }
        let lens = lens_of(&found.scene.cameras[0]);
        let unsure = (0..2).find(|&axis| found.sigmas[0][axis] > UNSURE * lens[axis].abs());
        match unsure {
            None => Ok(found),
            Some(axis) => Err(degenerate(format!(
                "its dots do not determine its focal length: {} {:.0} ± {:.0} px",
                LENS_NAMES[axis], lens[axis], found.sigmas[0][axis]
            ))),
        }
    }
}

/// Cameras of which one at least is near that which saw the dots.
fn first_guesses(
    id: u32,
    before: &CameraPrior,
    samples: &[Correspondence],
) -> Result<Vec<Camera>, CalibrationError> {
    if samples.is_empty() {
        return Err(degenerate("it sees no dot"));
    }
    match before {
        CameraPrior::Size(size) => {
            if linear::plane_of(samples)?.is_some() {
                return Err(degenerate(
                    "all dots lie in one plane, which does not fix a lens: \
                     use a stepped target, or give the lens",
                ));
            }
            starts::starts(id, *size, samples)
        }
        CameraPrior::Lens(camera) => {
            let mut camera = camera.clone();
            let place = linear::target_in_camera(&camera, samples)?;
            set_camera_pose(&mut camera, &place);
            Ok(vec![camera])
        }
    }
}

/// The cameras' own calibrations as one.
///
/// # Errors
/// The problems of all cameras that have one.
pub(crate) fn together(
    all: Vec<Result<Calibrated, CalibrationError>>,
    sheets: &[TargetView],
) -> Result<Calibrated, CalibrationError> {
    let wrong = |(c, one): (usize, &Result<Calibrated, _>)| {
        let name = sheets.iter().find(|s| s.camera == c).map(|s| format!(" ({})", s.name));
        one.as_ref().err().map(|problem| format!("camera {c}{}: {problem}", name.unwrap_or_default()))
    };
    let wrong: Vec<String> = all.iter().enumerate().filter_map(wrong).collect();
    if !all.is_empty() && all.iter().all(|one| matches!(one, Err(CalibrationError::LeftHanded))) {
        return Err(CalibrationError::LeftHanded);
    }
    if !wrong.is_empty() {
        return Err(disagreement(wrong.join("; ")));
    }
    let all: Vec<Calibrated> = all.into_iter().flatten().collect();
    let cameras: Vec<Camera> = all.iter().map(|one| one.scene.cameras[0].clone()).collect();
    let scene = Scene { cameras, views: vec![Isometry3::identity()] };
    let residuals = residuals(&scene, sheets);
    let squares = all.iter().map(|one| one.sigma_px * one.sigma_px * one.residuals.len() as f64);
    Ok(Calibrated {
        rms_px: rms(residuals.iter().copied()),
        sigma_px: (squares.sum::<f64>() / residuals.len().max(1) as f64).sqrt(),
        sigmas: all.iter().flat_map(|one| one.sigmas.clone()).collect(),
        alone_px: 0.0,
        doubt_px: all.iter().flat_map(|one| one.doubt_px.clone()).collect(),
        iterations: all.iter().map(|one| one.iterations).max().unwrap_or(0),
        left_out: all.iter().flat_map(|one| one.left_out.clone()).collect(),
        remarks: all.iter().flat_map(|one| one.remarks.clone()).collect(),
        residuals,
        scene,
    })
}

/// Known positions nearer than this are of one dot, mm; lists round to 1e-6.
const SAME_DOT_MM: f64 = 1e-6;

/// Root mean square errors along x, y, z (mm) of dots that all cameras see, triangulated after a
/// calibration on the others of them. `chosen` is true for the dots of the calibration.
///
/// # Errors
/// A calibration without a solution, or rays that do not meet.
pub fn held_out(
    before: &[CameraPrior],
    sheets: &[TargetView],
    free: [bool; LENS],
    robustness: Robustness,
    chosen: &dyn Fn(usize) -> bool,
) -> Result<[f64; 3], CalibrationError> {
    let common = common_dots(sheets, before.len());
    let known: Vec<TargetView> = sheets
        .iter()
        .map(|sheet| {
            let kept = common.iter().enumerate().filter(|(i, _)| chosen(*i)).map(|(_, dot)| dot);
            let sample = |dot: &Dot| Correspondence { point: dot.point, pixel: dot.pixels[sheet.camera] };
            TargetView { samples: kept.map(sample).collect(), ..sheet.clone() }
        })
        .collect();
    let calibrated = calibrate_on_dots(before, &known, free, robustness, &mut |_, _| {})?;
    let cameras = &calibrated.scene.cameras;
    let behind = || degenerate("a dot lies behind a camera");
    let errors = |dot: &Dot| {
        let error = |(camera, pixel): (&Camera, &Vector2<f64>)| Some(pixel - camera.project(&dot.point)?);
        let all =
            cameras.iter().zip(&dot.pixels).map(error).collect::<Option<Vec<_>>>().ok_or_else(behind)?;
        Ok(DVector::from_iterator(2 * all.len(), all.iter().flat_map(|e| [e.x, e.y])))
    };
    let learnt = common.iter().enumerate().filter(|(i, _)| chosen(*i)).map(|(_, dot)| errors(dot));
    let noise = noise_of(&learnt.collect::<Result<Vec<_>, CalibrationError>>()?);
    let (mut squares, mut n) = (nalgebra::Vector3::zeros(), 0);
    for (_, Dot { point, pixels }) in common.iter().enumerate().filter(|(i, _)| !chosen(*i)) {
        let points = cameras.iter().zip(pixels);
        let points: Vec<ImagePoint<'_>> =
            points.map(|(camera, &pixel)| ImagePoint { camera, pixel }).collect();
        let found =
            triangulate(&points, &noise).ok_or_else(|| degenerate("rays of the cameras do not meet"))?;
        squares += (found - point).map(|e| e * e);
        n += 1;
    }
    Ok((squares / f64::from(n.max(1))).map(f64::sqrt).into())
}

/// A dot that every camera sees.
#[derive(Debug, Clone)]
pub struct Dot {
    /// Where it is, mm.
    pub point: Point3<f64>,
    /// Where each camera sees it, px.
    pub pixels: Vec<Vector2<f64>>,
}

/// Dots that every camera sees.
pub fn common_dots(sheets: &[TargetView], cameras: usize) -> Vec<Dot> {
    let Some(first) = sheets.iter().find(|s| s.camera == 0) else { return Vec::new() };
    let pixel_of = |camera: usize, point: &Point3<f64>| {
        let own = sheets.iter().filter(|s| s.camera == camera).flat_map(|s| &s.samples);
        own.clone().find(|s| (s.point - point).norm() < SAME_DOT_MM).map(|s| s.pixel)
    };
    let dot = |sample: &Correspondence| {
        let pixels = (0..cameras).map(|c| pixel_of(c, &sample.point)).collect::<Option<Vec<_>>>()?;
        Some(Dot { point: sample.point, pixels })
    };
    first.samples.iter().filter_map(dot).collect()
}
