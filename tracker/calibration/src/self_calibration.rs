//! Self-calibration: bundle adjustment of camera poses (and lenses) and marker positions from a
//! stream of waved instruments.
//!
//! The cost is the sum of the image residuals of all blobs, weighted by their covariances, and of
//! the deviations from the prior. The prior fixes the gauge: a rig that moves as a whole about the
//! eye's centre, or whose markers all move alike in their body, looks the same to every camera;
//! along those directions the solution stays at the prior mean. The eye's centre is the world's
//! origin by definition; the markers' distances carry the scale.

mod paths;
mod problem;
mod spline;

use crate::bundle::{Bundle, FIXED_RIG, Freedom, PriorSigmas, Value};
use crate::lens::{EXTRINSICS, LENS, by_extrinsics, project};
use crate::observations::{FrameObservations, MarkerObservation, collect};
use crate::solve::{Problem, Solution, solve};
use crate::target_problem::{DISPENSABLE, Residual, rms};
use crate::{CalibrationError, degenerate};
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};
use paths::{PathProblem, in_stretches};
use problem::SelfCalibrationProblem;
pub(crate) use problem::common_clock;
use protocol::blobs::{BlobField, DEFAULT_VARIANCE_PX2};
use protocol::limits::BODIES;
use rig::Rig;
use tracker::rig_model::RigModel;

/// Residuals (seen less computed) under a bundle; `sheet` is the instant.
pub fn residuals_of(instants: &[FrameObservations], bundle: &Bundle) -> Vec<Residual> {
    let of_instant = |(i, instant): (usize, &FrameObservations)| {
        let residual = |seen: &MarkerObservation| {
            let pose = bundle.pose_at_exposure(i, instant, seen)?;
            let error = seen.pixel - bundle.image(&pose, seen)?.pixel;
            Some(Residual { camera: seen.camera, sheet: i, pixel: seen.pixel, error })
        };
        instant.seen.iter().filter_map(residual).collect::<Vec<_>>()
    };
    instants.iter().enumerate().flat_map(of_instant).collect()
}

/// The result of a self-calibration.
pub struct SelfCalibration {
    /// The refined rig and poses.
    pub bundle: Bundle,
    /// Its residuals.
    pub residuals: Vec<Residual>,
    /// The residuals with the rig as it was, poses fitted to it.
    pub before: Vec<Residual>,
    /// Standard deviations of lens and extrinsics by camera; 0 where fixed.
    pub sigmas: Vec<[f64; LENS + EXTRINSICS]>,
    /// Weakly observed parameters: their standard deviation is more than nine tenths of the prior
    /// one.
    pub weakly_observed: Vec<String>,
    /// Terms of lenses that were free but are as they were, since the stream does not determine them: camera, and index
    /// into [`crate::lens::LENS_NAMES`].
    pub held: Vec<(usize, usize)>,
    /// Root mean square shift of each camera's image, and its standard deviation, px.
    pub shifts_px: Vec<(f64, f64)>,
    /// Σ ρ per degree of freedom: 1 where the blobs' covariances are right.
    pub reduced_cost: f64,
    /// Iterations.
    pub iterations: usize,
    /// What the stream says of the rig's parameters together.
    pub(crate) shared: Shared,
}

/// What a stream says of parameters.
pub(crate) struct Shared {
    /// Which.
    pub values: Vec<Value>,
    /// Their prior standard deviations.
    pub sigmas: Vec<f64>,
    /// How far they were moved.
    pub change: DVector<f64>,
    /// Of them, with the prior, in units of the noise that is there.
    pub covariance: DMatrix<f64>,
    /// Noise of the blobs over that of their covariances.
    pub noise: f64,
}

/// Least spread of markers across their longest line that determines a pose, mm.
const BESIDE_MM: f64 = 0.2;
/// Fewest instants with observations.
pub const FEWEST_INSTANTS: usize = 10;

/// A parameter whose standard deviation is more than this share of the prior one is weakly observed.
const WEAK: f64 = 0.9;

/// Refines a rig from the observations made with it.
///
/// # Errors
/// Too few usable instants, or a problem without a solution.
pub fn refine(
    rig: &Rig,
    instants: &[FrameObservations],
    known: &PriorSigmas,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<SelfCalibration, CalibrationError> {
    refine_free(rig, instants, &Freedom::from(*known), known.rough(rig), progress)
}

/// As [`refine`], with blobs that are deweighted by `rough` at first.
///
/// # Errors
/// As [`refine`].
pub fn refine_free(
    rig: &Rig,
    instants: &[FrameObservations],
    free: &Freedom,
    rough: f64,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<SelfCalibration, CalibrationError> {
    let (instants, fitted) = fitted_with(rig, instants, false, rough)?;
    let instants = &instants;
    let before = residuals_of(instants, &fitted);
    let mut problem = SelfCalibrationProblem::new(instants, fitted, free, false);
    // The residuals of a rough rig come from its errors, not from the blobs.
    problem.noise = rough;
    let mut solution = solve(&problem, problem.before.clone(), progress)?;
    for _ in 0..2 {
        // The blobs' covariances may be wrong by a factor; the prior is weighed against the actual
        // noise.
        problem.noise *= (solution.cost / solution.freedom.max(1) as f64).sqrt();
        problem.noise = problem.noise.clamp(0.5, 10.0);
        solution = solve(&problem, solution.state, progress)?;
    }
    Ok(summary(&problem, solution, before))
}

/// Farthest that poses are carried by the tracker's velocities, which lag, s.
const TOGETHER_S: f64 = 1e-3;

/// As [`refine_free`] by `most` of the instants. Where cameras expose at different times, bodies follow splines
/// ([`paths`]).
///
/// # Errors
/// As [`refine`].
pub(crate) fn refine_moving(
    rig: &Rig,
    instants: Vec<FrameObservations>,
    most: usize,
    free: &Freedom,
    rough: f64,
) -> Result<SelfCalibration, CalibrationError> {
    let apart = instants.iter().flat_map(|i| &i.seen).any(|s| s.dt_s.abs() > TOGETHER_S);
    if !apart {
        return refine_free(rig, &spread(instants, most), free, rough, &mut |_, _| {});
    }
    let (instants, stretches) = in_stretches(&usable(rig, &instants), most);
    if instants.len() < FEWEST_INSTANTS {
        return Err(too_few(instants.len()));
    }
    let rig_problem = SelfCalibrationProblem::new(&instants, Bundle::new(rig, &instants), free, false);
    let (mut problem, start) = PathProblem::new(rig_problem, stretches);
    problem.rig.noise = rough;
    let mut solution = solve(&problem, start, &mut |_, _| {})?;
    for _ in 0..2 {
        problem.rig.noise *= (solution.cost / solution.freedom.max(1) as f64).sqrt();
        problem.rig.noise = problem.rig.noise.clamp(0.5, 10.0);
        solution = solve(&problem, solution.state, &mut |_, _| {})?;
    }
    let residuals = problem.residuals(&solution.state);
    let Solution { state, covariance, cost, freedom, iterations } = solution;
    let solution = Solution { state: state.rig, covariance, cost, freedom, iterations };
    Ok(summary_of(&problem.rig, solution, Vec::new(), residuals))
}

fn too_few(instants: usize) -> CalibrationError {
    degenerate(format!(
        "bodies were seen well enough by two cameras at {instants} instants; at least {FEWEST_INSTANTS} are needed"
    ))
}

/// Default variances of a blob's column and line, px².
const USUAL_PX2: (f64, f64) = (0.045 * 0.045, 0.088 * 0.088);
/// Divisor of the deweighting from one round to the next.
const DOUBT_STEP: f64 = 8.0;

/// Of each camera the first term of its distortion that its stream does not determine.
fn weak_terms(found: &SelfCalibration) -> Vec<(usize, usize)> {
    let Shared { values, sigmas, covariance, .. } = &found.shared;
    let is_weak = |value: Value| {
        let at = values.iter().position(|v| *v == value);
        at.is_some_and(|at| covariance[(at, at)].max(0.0).sqrt() > WEAK * sigmas[at])
    };
    let first =
        |c: usize| DISPENSABLE.into_iter().find(|&term| is_weak(Value::Lens(c, term))).map(|term| (c, term));
    (0..found.sigmas.len()).filter_map(first).collect()
}

/// Refines a rig from a stream: tracked with the rig as it is and blobs deweighted by the errors of
/// the rig, then again with the refined rig and less deweighting, until the blobs have their own
/// weights. At most `most` instants are used, spread over the stream.
///
/// # Errors
/// As [`refine`]; a camera without observations.
pub fn refine_stream(
    rig: &Rig,
    fields: &[BlobField],
    known: &PriorSigmas,
    most: usize,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<SelfCalibration, CalibrationError> {
    refine_stream_free(rig, fields, &Freedom::from(*known), most, progress)
}

/// As [`refine_stream`], with other freedoms. Terms of a lens's distortion that the stream does not determine stay as they
/// were, the highest power first, and are listed in [`SelfCalibration::held`].
///
/// # Errors
/// As [`refine_stream`].
pub fn refine_stream_free(
    rig: &Rig,
    fields: &[BlobField],
    free: &Freedom,
    most: usize,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<SelfCalibration, CalibrationError> {
    let (mut doubt, mut current, mut free) = (free.rough(rig), rig.clone(), free.clone());
    loop {
        let deweight = |f: &BlobField| if doubt > 1.0 { deweighted(f, doubt) } else { *f };
        let mut seen = collect(&current, &fields.iter().map(deweight).collect::<Vec<_>>());
        if doubt > 1.0 {
            let blobs = seen.iter_mut().flat_map(|i| &mut i.seen);
            blobs.for_each(|s| s.covariance /= doubt * doubt);
        }
        // The prior stays; only the poses start from better values.
        let found = if doubt <= 1.0 && free.near_enough > 0.0 {
            refine_moving(rig, seen, most, &free, free.rough(rig))?
        } else {
            refine_free(rig, &spread(seen, most), &free, free.rough(rig), progress)?
        };
        if doubt <= 1.0 {
            let weak = weak_terms(&found);
            if !weak.is_empty() {
                free.held.extend(weak);
                continue;
            }
            every_camera_saw(rig, &found.residuals)?;
            return Ok(SelfCalibration { held: free.held, ..found });
        }
        current = found.bundle.rig(rig);
        doubt = (doubt / DOUBT_STEP).max(1.0);
    }
}

/// Checks that every camera has residuals.
///
/// # Errors
/// The first camera without any.
pub fn every_camera_saw(rig: &Rig, residuals: &[Residual]) -> Result<(), CalibrationError> {
    let blind = (0..rig.cameras.len()).find(|&c| residuals.iter().all(|r| r.camera != c));
    blind.map_or(Ok(()), |c| {
        let problem = format!(
            "camera {} saw none of the bodies where the rig expects them: it was moved too far, or sees \
             nothing",
            rig.cameras[c].id
        );
        Err(degenerate(problem))
    })
}

/// `most` of the instants, evenly spread.
pub fn spread(instants: Vec<FrameObservations>, most: usize) -> Vec<FrameObservations> {
    let used = most.min(instants.len());
    (0..used).map(|i| instants[i * instants.len() / used].clone()).collect()
}

/// A field whose blobs have `times` their standard deviation.
fn deweighted(field: &BlobField, times: f64) -> BlobField {
    let mut out = *field;
    let count = out.blobs().len();
    for blob in &mut out.blobs[..count] {
        let covariance = [blob.var_x_px2, blob.var_y_px2, blob.cov_xy_px2];
        if covariance == [DEFAULT_VARIANCE_PX2, DEFAULT_VARIANCE_PX2, 0.0] {
            (blob.var_x_px2, blob.var_y_px2) = USUAL_PX2;
        }
        blob.var_x_px2 *= times * times;
        blob.var_y_px2 *= times * times;
        blob.cov_xy_px2 *= times * times;
    }
    out
}

/// The usable instants, and the poses fitted to them with the rig as it is.
///
/// # Errors
/// Too few usable instants, or a problem without a solution.
pub fn fitted(
    rig: &Rig,
    instants: &[FrameObservations],
) -> Result<(Vec<FrameObservations>, Bundle), CalibrationError> {
    fitted_with(rig, instants, false, 1.0)
}

/// As [`fitted`]; with `eye_moves` the eye's centre is free, `noise` is a factor on the blobs'
/// standard deviations.
///
/// # Errors
/// As [`fitted`].
pub fn fitted_with(
    rig: &Rig,
    instants: &[FrameObservations],
    eye_moves: bool,
    noise: f64,
) -> Result<(Vec<FrameObservations>, Bundle), CalibrationError> {
    let instants = usable(rig, instants);
    if instants.len() < FEWEST_INSTANTS {
        return Err(too_few(instants.len()));
    }
    let mut problem =
        SelfCalibrationProblem::new(&instants, Bundle::new(rig, &instants), &FIXED_RIG.into(), eye_moves);
    problem.noise = noise;
    let poses = solve(&problem, problem.before.clone(), &mut |_, _| {})?.state;
    Ok((instants, poses))
}

/// Instants with the bodies that two cameras saw with enough markers to determine a pose.
pub fn usable(rig: &Rig, instants: &[FrameObservations]) -> Vec<FrameObservations> {
    let model = RigModel::new(rig);
    // Three markers on the shaft do not determine the roll.
    let spread = |body: usize, markers: u32| {
        let all = model.bodies[body].markers.iter().enumerate();
        let own = all.filter(|(m, _)| markers & 1 << m != 0).map(|(_, m)| m.position.coords);
        let mean = own.clone().sum::<Vector3<f64>>() / f64::from(markers.count_ones().max(1));
        let spread = own.map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix3<f64>>();
        let mut values: [f64; 3] = spread.symmetric_eigenvalues().into();
        values.sort_by(f64::total_cmp);
        values[1].max(0.0).sqrt()
    };
    let strong = |instant: &FrameObservations, body: usize| {
        let own = instant.seen.iter().filter(|s| s.body == body);
        let cameras = own.clone().fold(0u32, |set, s| set | 1 << s.camera);
        let markers = own.clone().fold(0u32, |set, s| set | 1 << s.marker);
        cameras.count_ones() >= 2 && own.count() >= 5 && spread(body, markers) > BESIDE_MM
    };
    let cut = |instant: &FrameObservations| {
        let mut out = instant.clone();
        for body in 0..BODIES {
            if !strong(instant, body) {
                out.poses[body] = None;
                out.seen.retain(|s| s.body != body);
            }
        }
        (!out.seen.is_empty()).then_some(out)
    };
    instants.iter().filter_map(cut).collect()
}

fn summary(
    problem: &SelfCalibrationProblem<'_>,
    solution: Solution<Bundle>,
    before: Vec<Residual>,
) -> SelfCalibration {
    let residuals = residuals_of(problem.instants, &solution.state);
    summary_of(problem, solution, before, residuals)
}

fn summary_of(
    problem: &SelfCalibrationProblem<'_>,
    solution: Solution<Bundle>,
    before: Vec<Residual>,
    residuals: Vec<Residual>,
) -> SelfCalibration {
    let cameras = problem.before.cameras.len();
    let mut sigmas = vec![[0.0; LENS + EXTRINSICS]; cameras];
    let mut weakly_observed = Vec::new();
    for (at, value) in problem.values.iter().enumerate() {
        let sigma = solution.sigma(at);
        match *value {
            Value::Lens(c, i) => sigmas[c][i] = sigma,
            Value::Place(c, i) => sigmas[c][LENS + i] = sigma,
            Value::Marker(..) | Value::Late(..) | Value::Swapped(..) | Value::Aside => {}
        }
        if sigma > WEAK * problem.sigmas[at] {
            let name = problem.name(at);
            if weakly_observed.last() != Some(&name) {
                weakly_observed.push(name);
            }
        }
    }
    SelfCalibration {
        residuals,
        before,
        sigmas,
        weakly_observed,
        held: Vec::new(),
        shifts_px: (0..cameras).map(|c| shift_of(problem, &solution, c)).collect(),
        reduced_cost: solution.cost / solution.freedom.max(1) as f64 * problem.noise * problem.noise,
        iterations: solution.iterations,
        shared: Shared {
            values: problem.values.clone(),
            sigmas: problem.sigmas.clone(),
            change: DVector::from_iterator(
                problem.values.len(),
                problem.values.iter().map(|v| v.change(&problem.before, &solution.state)),
            ),
            covariance: solution.covariance,
            noise: problem.noise,
        },
        bundle: solution.state,
    }
}

/// Root mean square movement of a camera's image of the markers it saw, and its standard deviation.
fn shift_of(problem: &SelfCalibrationProblem<'_>, solution: &Solution<Bundle>, camera: usize) -> (f64, f64) {
    let Some(at) = problem.place_at[camera] else { return (0.0, 0.0) };
    let (old, new) = (&problem.before.cameras[camera], &solution.state.cameras[camera]);
    let covariance = solution.covariance.fixed_view::<EXTRINSICS, EXTRINSICS>(at, at);
    let (mut square, mut variance, mut n) = (0.0, 0.0, 0);
    for (i, instant) in problem.instants.iter().enumerate() {
        for seen in instant.seen.iter().filter(|s| s.camera == camera) {
            let Some(pose) = solution.state.poses[i][seen.body] else { continue };
            let point: Point3<f64> = pose * solution.state.markers[seen.body][seen.marker].position;
            let p = new.in_camera(&point);
            let (Some(before), Some(after)) = (old.project(&point), project(new, &p)) else { continue };
            let slope = after.by_point * by_extrinsics(new, &p);
            square += (after.pixel - before).norm_squared();
            variance += (slope * covariance * slope.transpose()).trace();
            n += 1;
        }
    }
    let mean = |sum: f64| (sum / f64::from(n.max(1))).max(0.0).sqrt();
    (mean(square), mean(variance))
}

/// Root mean square residual of a camera, px.
pub fn camera_rms(residuals: &[Residual], camera: usize) -> f64 {
    rms(residuals.iter().copied().filter(|r| r.camera == camera))
}
