//! All that may be wrong with a rig, estimated together from one tracked stretch, and which parts of it explain
//! the rest.
//!
//! Cameras, markers, clocks and parities are free at once in one bundle adjustment. Its minimum says two things:
//! what no error of the rig explains, which is the noise of this stream, and how much the rig as it is lies above
//! it. How much of that a single cause takes away follows from the same normal equations (a score test), so that
//! every cause, every pair of cameras included, is judged without tracking again. A cause is named where it takes
//! away all but noise, and no part of it does so alone; where several do, all are named.

use super::Cause;
use super::beside::hides_an_error;
use super::judgement::Explanation;
use super::measure::measure;
use crate::CalibrationError;
use crate::bundle::{Freedom, PriorSigmas, Value};
use crate::observations::collect;
use crate::self_calibration::{
    SelfCalibration, Shared, common_clock, every_camera_saw, refine_moving, refine_stream_free,
};
use crate::target_problem::robust_sigma;
use nalgebra::{DMatrix, DVector};
use protocol::blobs::{BlobField, WHOLE_FRAME};
use rig::Rig;
use std::f64::consts::SQRT_2;

/// How far everything is free: a knocked camera, a bent marker.
pub const WIDE: PriorSigmas = PriorSigmas { camera_mm: 0.3, camera_rad: 4e-3, marker_mm: 0.3, lens_px: 0.0 };
/// The same of clocks, s, and of parities.
const FREE: (f64, f64) = (0.01, 1.0);
/// Distance to the minimum that is near enough, in standard deviations.
pub const NEAR: f64 = 0.03;
/// Clocks that are farther off are estimated once more, s.
const NEAR_CLOCK_S: f64 = 2e-3;
/// Most instants that are used.
pub const MOST: usize = 200;
/// Share of the blobs that measure poses, and their residuals, px, where the tracker follows the rig as it is.
pub const FOLLOWS: (f64, f64) = (0.85, 0.6);
/// Standard deviation of a blob, px, by which residuals deweight blobs at first.
const BLOB_PX: f64 = 0.07;
/// Mean square that a mended rig leaves, over that of the rig as it is, from which on the estimate is in a wrong minimum.
const WORSE: f64 = 1.05;

/// What a mended rig leaves at most of the blobs that measure poses, px, and noise that its blobs have at most over
/// what their covariances say.
const LEFT_PX: f64 = 0.25;
const NOISE: f64 = 1.8;
/// A rig that holds leaves less: χ², or root mean square, px.
const NOISE_CHI2: f64 = 200.0;
const NOISE_PX: f64 = 0.01;
/// The same where no part of the rig explains it: what markers leave that touch or hide each other, or shafts that hide
/// them.
const NOBODYS_PX: f64 = 0.02;
/// A cause that explains all takes away all but this share, at least.
const SHARE: f64 = 0.5;
/// What remains is nothing where it is this share.
const NOTHING: f64 = 0.03;
/// A cause explains as well as the best where no more remains beside it: χ², and as a share of all.
const ALIKE: (f64, f64) = (60.0, 0.01);

/// What may explain residuals: directions in which the rig's parameters may lie elsewhere.
struct Hypothesis {
    what: What,
    columns: DMatrix<f64>,
    /// The only place along them; `None` where it is estimated.
    fixed: Option<f64>,
}

/// What it is of; cameras by their index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum What {
    Camera(usize),
    Cameras(usize, usize),
    Marker(usize, usize),
    Clock(usize),
    Parity(Option<usize>),
    Scale,
    /// Cameras and markers, all of them.
    All,
}

/// What is wrong with a rig, everything taken together.
pub struct Together {
    /// The rig with all of it mended.
    pub found: SelfCalibration,
    /// Noise of the blobs over what their covariances say, when all is mended.
    pub noise: f64,
    /// The same of one coordinate, px.
    pub sigma_px: f64,
    /// By how much the rig as it is lies above the noise: χ², and its root mean square over all blobs, px.
    pub above: Above,
    /// What explains it alike, by what remains then.
    pub explained: Vec<(Cause, Above)>,
    /// What remains with the best cause, of all that were tried.
    pub best: Option<(Cause, Above)>,
    /// Causes that were tried.
    pub tried: usize,
}

/// What lies above the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Above {
    /// In units of the noise.
    pub chi2: f64,
    /// Root mean square over all blobs, px.
    pub px: f64,
}

/// Estimates everything from a stretch.
///
/// # Errors
/// Too few instants at which bodies are seen, or a camera that saw none.
pub fn estimate(rig: &Rig, fields: &[BlobField]) -> Result<Together, CalibrationError> {
    let (clock_s, parity_px) = FREE;
    let free =
        Freedom { known: WIDE, clock_s, parity_px, aside: 1.0, near_enough: NEAR, ..Freedom::default() };
    let mut found = adjusted(rig, fields, &free)?;
    let late_s = found.bundle.late_s.clone();
    let largest = late_s.iter().fold(0.0, |most: f64, late| most.max(late.abs()));
    if largest > NEAR_CLOCK_S {
        // So far motions follow wrong stamps: once more from there.
        let set = retimed(rig, fields, &late_s);
        found = adjusted(rig, &set, &free)?;
        let shared = &mut found.shared;
        for (change, value) in shared.change.iter_mut().zip(&shared.values) {
            if let Value::Late(c) = *value {
                *change += late_s[c];
            }
        }
        found.bundle.late_s.iter_mut().zip(&late_s).for_each(|(late, before)| *late += before);
    }
    Ok(judged(rig, found))
}

/// The fields with stamps that are not late.
fn retimed(rig: &Rig, fields: &[BlobField], late_s: &[f64]) -> Vec<BlobField> {
    let mut fields = fields.to_vec();
    for field in &mut fields {
        let Some(c) = rig.cameras.iter().position(|c| c.id == field.camera) else { continue };
        let late_ns = (late_s[c] * 1e9) as i64;
        field.exposed_ns = field.exposed_ns.saturating_add_signed(-late_ns).max(1);
    }
    fields
}

impl Together {
    /// True where it explains the stretch: with everything mended, the blobs measure poses, and leave little.
    pub fn mends(&self, rig: &Rig, fields: &[BlobField]) -> bool {
        self.followed(rig, fields) > FOLLOWS.0
    }

    /// Share of the blobs that measure poses with everything mended; 0 where they leave more than a little, or hide an
    /// error.
    pub fn followed(&self, rig: &Rig, fields: &[BlobField]) -> f64 {
        let (mended, undone) = mended(rig, fields, &self.found);
        let left = measure(&mended, &undone);
        let little = left.explained.rms().is_some_and(|px| px < LEFT_PX);
        let is_right = little && self.noise < NOISE && !hides_an_error(&mended, &undone);
        if is_right { left.explained_share() } else { 0.0 }
    }

    /// True of what a rig that holds leaves.
    pub fn is_noise(&self) -> bool {
        self.above.is_noise() || (self.names_no_part() && self.above.px < NOBODYS_PX)
    }

    /// True where nothing less than all cameras and markers explains the stretch.
    pub fn names_no_part(&self) -> bool {
        !self.above.is_noise() && self.explained.iter().all(|(cause, _)| *cause == Cause::Drifted)
    }

    /// True where more than noise remains of what is explained, little as it is beside what there was.
    pub fn leaves_more(&self) -> bool {
        self.explained.iter().any(|(_, rest)| !rest.is_noise())
    }

    /// What explains the stretch, judged by so many blobs.
    pub fn explanations(&self, blobs: u64) -> Vec<Explanation> {
        let all = self.explained.iter();
        // Of both coordinates: what the cause does not explain, and the noise.
        let left_px = |rest: &Above| SQRT_2 * rest.px.hypot(self.sigma_px);
        all.map(|(cause, rest)| Explanation { cause: cause.clone(), left_px: left_px(rest), blobs }).collect()
    }
}

/// The bundle adjustment; blobs are deweighted first where the tracker does not follow the rig as it is.
fn adjusted(rig: &Rig, fields: &[BlobField], free: &Freedom) -> Result<SelfCalibration, CalibrationError> {
    let left = measure(rig, fields);
    let px = left.explained.rms().unwrap_or(f64::MAX);
    if left.explained_share() < FOLLOWS.0 || px > FOLLOWS.1 {
        let found = refine_stream_free(rig, fields, free, MOST, &mut |_, _| {});
        // Deweighted blobs may be matched to a reflection beside a hidden marker, and the estimate with them.
        let is_no_worse = |found: &SelfCalibration| {
            let (mended, undone) = mended(rig, fields, found);
            measure(&mended, &undone).mean() < WORSE * left.mean()
        };
        if px > FOLLOWS.1 || found.as_ref().is_ok_and(is_no_worse) {
            return found;
        }
    }
    let found = refine_moving(rig, collect(rig, fields), MOST, free, (px / BLOB_PX).max(1.0))?;
    every_camera_saw(rig, &found.residuals).map(|()| found)
}

/// The rig with everything mended, and the fields without what was wrong with their stamps and parities.
fn mended(rig: &Rig, fields: &[BlobField], found: &SelfCalibration) -> (Rig, Vec<BlobField>) {
    let bundle = &found.bundle;
    let mut undone = retimed(rig, fields, &bundle.late_s);
    for field in &mut undone {
        let Some(c) = rig.cameras.iter().position(|c| c.id == field.camera) else { continue };
        if bundle.swapped[c] > 0.5 && field.parity < WHOLE_FRAME {
            field.parity ^= 1;
        }
    }
    (bundle.rig(rig), undone)
}

fn judged(rig: &Rig, found: SelfCalibration) -> Together {
    let quadratic = Quadratic::of(&found);
    let above = quadratic.above(quadratic.whole());
    let hypotheses = hypotheses(rig, &found.shared);
    let mut all: Vec<(What, Cause, Above)> = Vec::new();
    for hypothesis in &hypotheses {
        let Some((rest, at)) = quadratic.without(hypothesis) else { continue };
        let Some(cause) = cause(rig, hypothesis, &found.shared.values, &at) else { continue };
        all.push((hypothesis.what, cause, quadratic.above(rest)));
    }
    all.sort_by(|a, b| a.2.chi2.total_cmp(&b.2.chi2));
    let best = all.first().map(|(_, cause, rest)| (cause.clone(), *rest));
    let explained = minimal(&above, &all);
    let tried = hypotheses.len();
    let (noise, sigma_px) = (found.shared.noise, quadratic.rms_px);
    Together { noise, sigma_px, above, explained, best, tried, found }
}

/// The minimal sets of parameters that explain what is above the noise, as well as the best or nearly so.
fn minimal(above: &Above, all: &[(What, Cause, Above)]) -> Vec<(Cause, Above)> {
    let Some(best) =
        all.iter().filter(|(_, _, rest)| explains(above, rest)).map(|a| a.2.chi2).reduce(f64::min)
    else {
        return Vec::new();
    };
    let alike = |rest: &Above| explains(above, rest) && rest.chi2 < best + ALIKE.0 + ALIKE.1 * above.chi2;
    let named: Vec<_> = all.iter().filter(|(_, _, rest)| alike(rest)).collect();
    let part_of = |part: What, whole: What| match (part, whole) {
        (What::Camera(c), What::Cameras(a, b)) => c == a || c == b,
        (What::All, _) => false,
        (_, What::All) => true,
        _ => false,
    };
    let lesser = |what: What| named.iter().any(|(other, ..)| part_of(*other, what));
    let mut out: Vec<(Cause, Above)> = named
        .iter()
        .filter(|(what, ..)| !lesser(*what))
        .map(|(_, cause, rest)| (cause.clone(), *rest))
        .collect();
    out.sort_by(|a, b| a.0.parameters().cmp(&b.0.parameters()).then(a.1.chi2.total_cmp(&b.1.chi2)));
    out
}

/// True where what remains is noise, or nothing beside what there was.
fn explains(above: &Above, rest: &Above) -> bool {
    rest.chi2 < SHARE * above.chi2 && (rest.is_noise() || rest.chi2 < NOTHING * above.chi2)
}

impl Above {
    /// True of what a rig that holds leaves.
    pub fn is_noise(&self) -> bool {
        self.chi2 < NOISE_CHI2 || self.px < NOISE_PX
    }
}

/// The cost about the minimum.
struct Quadratic {
    information: DMatrix<f64>,
    prior: DMatrix<f64>,
    /// From the minimum to the rig as it is.
    off: DVector<f64>,
    rms_px: f64,
    equations: f64,
}

impl Quadratic {
    fn of(found: &SelfCalibration) -> Self {
        let shared = &found.shared;
        let n = shared.sigmas.len();
        let inverse_squares = shared.sigmas.iter().map(|s| 1.0 / (s * s));
        let prior = DMatrix::from_diagonal(&DVector::from_iterator(n, inverse_squares));
        let with_prior = shared.covariance.clone().try_inverse().unwrap_or_else(|| prior.clone());
        let mut information = with_prior - &prior;
        // That clocks are late together is fixed at nothing, and is nothing that the stream says.
        let common = common_clock(&shared.values);
        information -= &common * common.transpose();
        // Where a ball's image lies off the axis is no error of the rig: whatever it is, it is taken out.
        if let Some(at) = shared.values.iter().position(|v| *v == Value::Aside) {
            let column = information.column(at).into_owned();
            information -= &column * column.transpose() / (column[at] + prior[(at, at)]);
        }
        Quadratic {
            information,
            prior,
            off: shared.change.clone(),
            rms_px: robust_sigma(&found.residuals),
            equations: 2.0 * found.residuals.len() as f64,
        }
    }

    /// χ² of the rig as it is.
    fn whole(&self) -> f64 {
        self.off.dot(&(&self.information * &self.off)).max(0.0)
    }

    fn above(&self, chi2: f64) -> Above {
        let px = self.rms_px * (chi2 / self.equations.max(1.0)).sqrt();
        Above { chi2, px }
    }

    /// χ² where the rig is mended along a hypothesis, and how far that is.
    fn without(&self, hypothesis: &Hypothesis) -> Option<(f64, DVector<f64>)> {
        let b = &hypothesis.columns;
        let weighed = &self.information * b;
        let at = match hypothesis.fixed {
            Some(at) => DVector::repeat(b.ncols(), at),
            None => {
                let normal = b.transpose() * &weighed + b.transpose() * &self.prior * b;
                normal.cholesky()?.solve(&(weighed.transpose() * &self.off))
            }
        };
        let rest = &self.off - b * &at;
        Some((rest.dot(&(&self.information * &rest)).max(0.0), at))
    }
}

/// Every hypothesis that the free parameters allow.
fn hypotheses(rig: &Rig, shared: &Shared) -> Vec<Hypothesis> {
    let values = &shared.values;
    let cameras = rig.cameras.len();
    let of = |chosen: &dyn Fn(Value) -> bool| {
        let at: Vec<usize> = (0..values.len()).filter(|i| chosen(values[*i])).collect();
        DMatrix::from_fn(values.len(), at.len(), |row, column| f64::from(u8::from(at[column] == row)))
    };
    let summed = |of: DMatrix<f64>| DMatrix::from_fn(of.nrows(), 1, |row, _| of.row(row).sum());
    let place = |c: usize, value: Value| matches!(value, Value::Place(camera, _) if camera == c);
    let mut all = Vec::new();
    let mut push = |what, columns: DMatrix<f64>, fixed| {
        if columns.ncols() > 0 {
            all.push(Hypothesis { what, columns, fixed });
        }
    };
    for c in 0..cameras {
        push(What::Camera(c), of(&|v| place(c, v)), None);
        for other in c + 1..cameras {
            push(What::Cameras(c, other), of(&|v| place(c, v) || place(other, v)), None);
        }
        push(What::Clock(c), of(&|v| v == Value::Late(c)), None);
        push(What::Parity(Some(c)), of(&|v| v == Value::Swapped(c)), Some(1.0));
    }
    push(What::Parity(None), summed(of(&|v| matches!(v, Value::Swapped(_)))), Some(1.0));
    push(What::All, of(&|v| matches!(v, Value::Place(..) | Value::Marker(..))), None);
    let along = DMatrix::from_fn(values.len(), 1, |row, _| match values[row] {
        Value::Place(c, i) if i >= 3 => rig.cameras[c].t[i - 3],
        _ => 0.0,
    });
    push(What::Scale, along, None);
    let mut markers: Vec<(usize, usize)> = Vec::new();
    for value in values {
        if let Value::Marker(body, marker, 0) = *value {
            markers.push((body, marker));
        }
    }
    for (body, marker) in markers {
        let own = of(&|v| matches!(v, Value::Marker(b, m, _) if (b, m) == (body, marker)));
        push(What::Marker(body, marker), own, None);
    }
    all
}

/// The cause in words, with its size.
fn cause(rig: &Rig, hypothesis: &Hypothesis, values: &[Value], at: &DVector<f64>) -> Option<Cause> {
    let id = |c: usize| rig.cameras[c].id;
    Some(match hypothesis.what {
        What::Camera(c) => {
            let before = rig.cameras[c].model();
            let mut moved = before.clone();
            crate::lens::move_extrinsics(&mut moved, &nalgebra::SMatrix::<f64, 6, 1>::from_fn(|i, _| at[i]));
            let turn_deg = at.rows(0, 3).norm().to_degrees();
            let shift_mm = (moved.centre_in_world() - before.centre_in_world()).norm();
            Cause::CameraMoved { camera: id(c), turn_deg, shift_mm }
        }
        What::Cameras(a, b) => Cause::CamerasMoved { cameras: [id(a), id(b)] },
        What::Marker(body, marker) => Cause::marker_moved(body, marker, [at[0], at[1], at[2]]),
        What::Clock(c) => Cause::ClockShifted { camera: id(c), by_ms: at[0] * 1e3 },
        What::Parity(c) => Cause::ParitySwapped { camera: c.map(id) },
        What::All => Cause::Drifted,
        What::Scale => Cause::Scale { camera: None, factor: 1.0 / (1.0 + at[0]) },
    })
    .filter(|_| values.len() == hypothesis.columns.nrows())
}
