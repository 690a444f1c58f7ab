//! Online estimation of the drift of a rig since its calibration, from the residuals of the
//! tracker.
//!
//! Parameters are a small rotation and translation of every camera and a shift of every marker in
//! its body. Every field of a body adds its normal equations with the pose eliminated (Schur
//! complement), so only what no pose explains is evidence; older fields are forgotten
//! exponentially. The prior is that of a carefully calibrated rig. Two columns of the Cholesky
//! factor are computed per frame, so no frame pays for the whole solution; a finished solution
//! moves the rig a part of the way.
//!
//! What changes no residual is not observable: where all markers of a body moved together, pose and
//! tip move with them. [`DriftReport::unobservable_mm`] is how much of that the prior allows.

mod saved;

use crate::constants as k;
use crate::fit::BlobMatch;
use crate::pose_math::{Matrix6, propagated};
use crate::projection::{PoseMatrix, camera_jacobian, moved_camera, pose_jacobian, project_marker};
use crate::rig_model::RigModel;
use nalgebra::{Isometry3, Matrix3, SMatrix, Vector2, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::poses::EYE;
use rig::camera::Camera;

/// Parameters of a camera: rotation and translation in its own frame.
const PER_CAMERA: usize = 6;
/// Parameters of the camera and the marker of a blob.
const PER_BLOB: usize = PER_CAMERA + 3;
/// Columns of the factor computed per frame.
const COLUMNS: usize = 2;
/// Solutions that are kept: of more than a second.
const PAST: usize = 3;

/// The estimated drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriftReport {
    /// True if noise alone does not explain the residuals.
    pub detected: bool,
    /// Decrease of χ² by the corrections, per parameter; 1 for noise.
    pub evidence: f64,
    /// Largest rotation of a camera, rad.
    pub camera_rad: f64,
    /// Largest translation of a camera, mm.
    pub camera_mm: f64,
    /// Root mean square shift of the markers in each body, per axis, mm.
    pub markers_mm: [f64; BODIES],
    /// Standard deviation of the tip (of the eye's rotation times 12 mm) from unobservable drift,
    /// mm.
    pub unobservable_mm: [f64; BODIES],
}

impl DriftReport {
    /// True if a camera or a body's markers have moved by more than half the standard deviation of
    /// their prior. Below it the corrections are those that any calibration needs.
    pub fn is_large(&self) -> bool {
        self.camera_rad > 0.5 * k::CAMERA_TURN_RAD
            || self.camera_mm > 0.5 * k::CAMERA_SHIFT_MM
            || self.markers_mm.iter().any(|mm| *mm > 0.5 * k::MARKER_SHIFT_MM)
    }
}

impl std::fmt::Display for DriftReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let um = |mm: f64| mm * 1e3;
        let [inst0, inst1, eye] = self.markers_mm.map(um);
        let (mrad, shift) = (self.camera_rad * 1e3, um(self.camera_mm));
        let (evidence, [tip0, tip1, _]) = (self.evidence, self.unobservable_mm.map(um));
        if !self.detected {
            return write!(f, "no drift of the rig is detected (evidence {evidence:.1})");
        }
        write!(
            f,
            "the rig has drifted since it was calibrated (evidence {evidence:.0}): cameras by up to {mrad:.2} mrad and {shift:.0} µm, \
             markers by {inst0:.1}, {inst1:.1} and {eye:.1} µm (inst0, inst1, eye); this is corrected while it runs. \
             Markers that moved together leave no residual, and may move the tips by {tip0:.1} and {tip1:.1} µm: \
             calibrate again"
        )
    }
}

/// Estimates the drift; all parameters are in units of their prior's standard deviation.
#[derive(Clone)]
pub struct DriftEstimator {
    calibrated: [Option<Camera>; MAX_CAMERAS],
    /// As calibrated, but for cameras that were resected.
    nominal: RigModel,
    /// First parameter of each camera; of the markers of each body.
    camera_at: [usize; MAX_CAMERAS],
    markers_at: [usize; BODIES],
    parameters: usize,
    information: Vec<f64>,
    gradient: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    applied: Vec<f64>,
    /// Parameters of the present body, and their normal equations with the pose.
    local: Vec<usize>,
    with_pose: Vec<[f64; 6]>,
    column: usize,
    turn: usize,
    report: DriftReport,
    /// What was known after the newest solutions, the newest first.
    past: [Past; PAST],
}

/// What was known after a solution.
#[derive(Debug, Clone)]
struct Past {
    information: Vec<f64>,
    gradient: Vec<f64>,
    applied: Vec<f64>,
    detected: bool,
}

impl DriftEstimator {
    /// An estimator for a rig as calibrated.
    pub fn new(rig: &RigModel) -> Self {
        let mut parameters = 0;
        let mut take = |count: usize| {
            parameters += count;
            parameters - count
        };
        let camera_at = std::array::from_fn(|c| take(if rig.cameras[c].is_some() { PER_CAMERA } else { 0 }));
        let markers_at = std::array::from_fn(|b| take(3 * rig.bodies[b].markers.len()));
        let square = vec![0.0; parameters * parameters];
        let line = vec![0.0; parameters];
        let nothing = Past {
            information: square.clone(),
            gradient: line.clone(),
            applied: line.clone(),
            detected: false,
        };
        let mut drift = DriftEstimator {
            past: std::array::from_fn(|_| nothing.clone()),
            calibrated: rig.cameras.clone(),
            nominal: rig.clone(),
            camera_at,
            markers_at,
            parameters,
            information: square.clone(),
            factor: square,
            gradient: line.clone(),
            right: line.clone(),
            applied: line,
            local: Vec::with_capacity(parameters),
            with_pose: vec![[0.0; 6]; parameters],
            column: 0,
            turn: 0,
            report: DriftReport::default(),
        };
        drift.report.unobservable_mm = std::array::from_fn(|b| drift.unobservable(b));
        drift
    }

    /// The present estimate.
    pub fn report(&self) -> &DriftReport {
        &self.report
    }

    /// Forgets everything, and restores `rig` as calibrated.
    pub fn reset(&mut self, rig: &mut RigModel) {
        for list in [&mut self.information, &mut self.gradient, &mut self.applied] {
            list.fill(0.0);
        }
        for _ in 0..PAST {
            self.remember();
        }
        (self.column, self.turn) = (0, 0);
        self.report = DriftReport { unobservable_mm: self.report.unobservable_mm, ..DriftReport::default() };
        self.nominal.cameras.clone_from(&self.calibrated);
        self.apply(rig);
    }

    /// Keeps what is known now beside what was known after former solutions.
    fn remember(&mut self) {
        self.past.rotate_right(1);
        let newest = &mut self.past[0];
        newest.information.copy_from_slice(&self.information);
        newest.gradient.copy_from_slice(&self.gradient);
        newest.applied.copy_from_slice(&self.applied);
        newest.detected = self.report.detected;
    }

    /// Returns to what was known some 1.5 s ago, without what was known of these cameras (a set): since
    /// then residuals of a moved camera came in.
    pub fn roll_back(&mut self, moved: u32, rig: &mut RigModel) {
        let past = &self.past[PAST - 1];
        self.information.copy_from_slice(&past.information);
        self.gradient.copy_from_slice(&past.gradient);
        self.applied.copy_from_slice(&past.applied);
        self.report.detected = past.detected;
        for camera in (0..MAX_CAMERAS).filter(|c| moved & (1 << c) != 0) {
            self.marginalise(camera);
        }
        self.column = 0;
        for _ in 0..PAST {
            self.remember();
        }
        self.apply(rig);
    }

    /// Marginalises the parameters of a camera out, with their prior (Schur complement), and sets them to
    /// zero.
    fn marginalise(&mut self, camera: usize) {
        let n = self.parameters;
        for p in self.camera_at[camera]..self.camera_at[camera] + PER_CAMERA {
            let pivot = self.information[p * n + p] + 1.0;
            for r in (0..n).filter(|r| *r != p) {
                let share = self.information[r * n + p] / pivot;
                self.gradient[r] -= share * self.gradient[p];
                for c in (0..n).filter(|c| *c != p) {
                    self.information[r * n + c] -= share * self.information[p * n + c];
                }
            }
            for q in 0..n {
                self.information[p * n + q] = 0.0;
                self.information[q * n + p] = 0.0;
            }
            (self.gradient[p], self.applied[p]) = (0.0, 0.0);
        }
    }

    /// Takes a camera's present place in `rig` for its nominal one.
    pub fn rebase(&mut self, camera: usize, rig: &RigModel) {
        self.nominal.cameras[camera].clone_from(&rig.cameras[camera]);
    }

    /// The body whose residuals are used next; the bodies take turns.
    pub fn next_body(&mut self) -> usize {
        self.turn = (self.turn + 1) % BODIES;
        self.turn
    }

    /// Adds the normal equations of the blobs of a fit, which was made with the corrected `rig`.
    pub fn add_residuals(
        &mut self,
        rig: &RigModel,
        body: usize,
        pose: &Isometry3<f64>,
        motion: &[Vector3<f64>; 2],
        matches: &[BlobMatch],
    ) {
        // A partly hidden marker looks like one that moved.
        let usable = || matches.iter().filter(|m| m.clean && !m.outlier);
        if usable().count() < 4 {
            return;
        }
        self.list_parameters(body);
        let mut of_pose = pose_prior(body);
        let mut gradient = SMatrix::<f64, 6, 1>::zeros();
        for m in usable() {
            let at_exposure = propagated(pose, motion, m.dt_s);
            let Some((a, j, r)) = self.equation(rig, body, &PoseMatrix::from(&at_exposure), m) else {
                continue;
            };
            let Some(weight) = m.covariance.try_inverse() else { continue };
            let (aw, jw) = (a.transpose() * weight, j.transpose() * weight);
            of_pose += jw * j;
            gradient += jw * r;
            let (own, mixed, right) = (aw * a, aw * j, aw * r);
            let at = self.indices(body, m);
            for p in 0..PER_BLOB {
                let row = at[p] * self.parameters;
                for q in 0..PER_BLOB {
                    self.information[row + at[q]] += own[(p.max(q), p.min(q))];
                }
                self.gradient[at[p]] += right[p];
                for (q, cell) in self.with_pose[at[p]].iter_mut().enumerate() {
                    *cell += mixed[(p, q)];
                }
            }
        }
        self.eliminate_pose(&of_pose, &gradient);
    }

    /// Jacobians of a blob by the parameters and by the pose, and its residual with the rig as
    /// calibrated.
    fn equation(
        &self,
        rig: &RigModel,
        body: usize,
        pose: &PoseMatrix,
        m: &BlobMatch,
    ) -> Option<(SMatrix<f64, 2, PER_BLOB>, SMatrix<f64, 2, 6>, Vector2<f64>)> {
        let camera = rig.cameras[m.camera].as_ref()?;
        let image = project_marker(&rig.bodies[body].markers[m.marker], pose, camera)?;
        let by_camera = camera_jacobian(camera, &image.jacobian, &image.point);
        let by_marker = image.jacobian * pose.rotation;
        let mut a = SMatrix::<f64, 2, PER_BLOB>::zeros();
        let [turn, shift] = [0, 3].map(|column| by_camera.fixed_view::<2, 3>(0, column));
        a.fixed_view_mut::<2, 3>(0, 0).copy_from(&(turn * k::CAMERA_TURN_RAD));
        a.fixed_view_mut::<2, 3>(0, 3).copy_from(&(shift * k::CAMERA_SHIFT_MM));
        a.fixed_view_mut::<2, 3>(0, 6).copy_from(&(by_marker * k::MARKER_SHIFT_MM));
        let at = self.indices(body, m);
        let applied = SMatrix::<f64, PER_BLOB, 1>::from_fn(|p, _| self.applied[at[p]]);
        let r = m.pixel - image.pixel + a * applied;
        Some((a, pose_jacobian(&image, pose), r))
    }

    /// Indices of the parameters of a blob.
    fn indices(&self, body: usize, m: &BlobMatch) -> [usize; PER_BLOB] {
        let (camera, marker) = (self.camera_at[m.camera], self.markers_at[body] + 3 * m.marker);
        std::array::from_fn(|p| if p < PER_CAMERA { camera + p } else { marker + p - PER_CAMERA })
    }

    fn list_parameters(&mut self, body: usize) {
        self.local.clear();
        for (id, camera) in self.nominal.cameras.iter().enumerate() {
            if camera.is_some() {
                self.local.extend(self.camera_at[id]..self.camera_at[id] + PER_CAMERA);
            }
        }
        let first = self.markers_at[body];
        self.local.extend(first..first + 3 * self.nominal.bodies[body].markers.len());
        for &p in &self.local {
            self.with_pose[p] = [0.0; 6];
        }
    }

    /// Eliminates the pose: N − C·G⁻¹·Cᵀ, b − C·G⁻¹·g. Each cell is computed once for both triangles, so
    /// that N stays symmetric to the bit.
    fn eliminate_pose(&mut self, of_pose: &Matrix6, gradient: &SMatrix<f64, 6, 1>) {
        let Some(inverse) = of_pose.cholesky().map(|c| c.inverse()) else { return };
        for &p in &self.local {
            let row = SMatrix::<f64, 1, 6>::from_row_slice(&self.with_pose[p]) * inverse;
            for &q in self.local.iter().take_while(|q| **q <= p) {
                let mixed = &self.with_pose[q];
                let mut sum = 0.0;
                for (a, b) in row.iter().zip(mixed) {
                    sum += a * b;
                }
                self.information[p * self.parameters + q] -= sum;
                if q < p {
                    self.information[q * self.parameters + p] -= sum;
                }
            }
            self.gradient[p] -= (row * gradient)[0];
        }
    }

    /// True if the next part of the solution is its last, by which the rig moves.
    pub fn moves_next(&self) -> bool {
        self.column + COLUMNS >= self.parameters
    }

    /// Computes a part of the solution. True if that was the last part and `rig` was moved.
    pub fn step(&mut self, rig: &mut RigModel) -> bool {
        let n = self.parameters;
        if self.column == 0 {
            self.factor.copy_from_slice(&self.information);
            self.right.copy_from_slice(&self.gradient);
            for p in 0..n {
                self.factor[p * n + p] += 1.0;
            }
            for list in [&mut self.information, &mut self.gradient] {
                list.iter_mut().for_each(|v| *v *= rig.tuning.drift_kept);
            }
        }
        for _ in 0..COLUMNS {
            if self.column < n && !self.factor_column(self.column) {
                self.drop_sums();
                return false;
            }
            self.column += 1;
        }
        if self.column < n {
            return false;
        }
        self.column = 0;
        if !self.solve() {
            self.drop_sums();
            return false;
        }
        self.apply(rig);
        self.remember();
        true
    }

    /// Drops sums that are not positive definite or not finite; the corrections stay.
    fn drop_sums(&mut self) {
        self.information.fill(0.0);
        self.gradient.fill(0.0);
        self.column = 0;
    }

    fn factor_column(&mut self, j: usize) -> bool {
        let n = self.parameters;
        let (above, below) = self.factor.split_at_mut((j + 1) * n);
        let row_j = &mut above[j * n..j * n + j + 1];
        let square: f64 = row_j[..j].iter().map(|v| v * v).sum();
        let pivot = row_j[j] - square;
        if pivot <= 1e-9 || !pivot.is_finite() {
            return false;
        }
        let root = libm::sqrt(pivot);
        row_j[j] = root;
        for row in below.chunks_exact_mut(n) {
            let mut sum = row[j];
            for (a, b) in row[..j].iter().zip(&row_j[..j]) {
                sum -= a * b;
            }
            row[j] = sum / root;
        }
        true
    }

    /// Moves the corrections towards the solution; false, with nothing moved, where that is not finite.
    fn solve(&mut self) -> bool {
        let n = self.parameters;
        let mut gained = 0.0;
        for p in 0..n {
            let mut sum = self.right[p];
            for q in 0..p {
                sum -= self.factor[p * n + q] * self.right[q];
            }
            self.right[p] = sum / self.factor[p * n + p];
            // |L⁻¹·b|² is the fall of the cost at the solution.
            gained += self.right[p] * self.right[p];
        }
        for p in (0..n).rev() {
            let mut sum = self.right[p];
            for q in p + 1..n {
                sum -= self.factor[q * n + p] * self.right[q];
            }
            self.right[p] = sum / self.factor[p * n + p];
        }
        if !self.right.iter().all(|v| v.is_finite()) {
            return false;
        }
        self.report.evidence = gained / n as f64;
        self.report.detected |= self.report.evidence > k::DRIFT_EVIDENCE;
        // Shrunk towards the calibration as far as noise could be the cause (James and Stein 1961).
        let shrinkage = (1.0 - k::DRIFT_NOISE / self.report.evidence.max(k::DRIFT_NOISE)).max(0.0);
        for (applied, solved) in self.applied.iter_mut().zip(&self.right) {
            let next = *applied + self.nominal.tuning.drift_step * (shrinkage * solved - *applied);
            *applied = next.clamp(-k::DRIFT_LIMIT, k::DRIFT_LIMIT);
        }
        true
    }

    /// Applies the estimated corrections to `rig`.
    fn apply(&mut self, rig: &mut RigModel) {
        (self.report.camera_rad, self.report.camera_mm) = (0.0, 0.0);
        for (id, nominal) in self.nominal.cameras.iter().enumerate() {
            let (Some(camera), Some(nominal)) = (&mut rig.cameras[id], nominal) else { continue };
            let at = |p: usize| self.applied[self.camera_at[id] + p];
            let turn = Vector3::new(at(0), at(1), at(2)) * k::CAMERA_TURN_RAD;
            let shift = Vector3::new(at(3), at(4), at(5)) * k::CAMERA_SHIFT_MM;
            *camera = moved_camera(nominal, turn, shift);
            self.report.camera_rad = self.report.camera_rad.max(turn.norm());
            self.report.camera_mm = self.report.camera_mm.max(shift.norm());
        }
        for body in 0..BODIES {
            let (markers, nominal) = (&mut rig.bodies[body].markers, &self.nominal.bodies[body].markers);
            let mut squares = 0.0;
            for (i, (marker, nominal)) in markers.iter_mut().zip(nominal).enumerate() {
                let at = |p: usize| self.applied[self.markers_at[body] + 3 * i + p];
                let shift = Vector3::new(at(0), at(1), at(2)) * k::MARKER_SHIFT_MM;
                marker.position = nominal.position + shift;
                squares += shift.norm_squared();
            }
            self.report.markers_mm[body] = libm::sqrt(squares / (3 * nominal.len()).max(1) as f64);
        }
    }

    /// Standard deviation of the tip (for the eye: of a point 12 mm from its centre) from the part
    /// of independent marker shifts that is a rigid motion of the body, mm.
    fn unobservable(&self, body: usize) -> f64 {
        let mut information = Matrix6::zeros();
        for marker in &self.nominal.bodies[body].markers {
            let arm = -marker.position.coords.cross_matrix();
            let mut j = SMatrix::<f64, 3, 6>::zeros();
            j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            j.fixed_view_mut::<3, 3>(0, 3).copy_from(&arm);
            information += j.transpose() * j;
        }
        if body == EYE {
            information.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1e12);
        }
        let Some(covariance) = information.cholesky().map(|c| c.inverse()) else { return 0.0 };
        let first = if body == EYE { 3 } else { 0 };
        let block: Matrix3<f64> = covariance.fixed_view::<3, 3>(first, first).into();
        let lever = if body == EYE { 12.0 } else { 1.0 };
        k::MARKER_SHIFT_MM * lever * libm::sqrt(block.trace())
    }
}

/// Prior information of a pose: next to none for an instrument, the centre for the eye.
pub fn pose_prior(body: usize) -> Matrix6 {
    let mut prior = Matrix6::identity();
    if body == EYE {
        prior.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0 / (k::EYE_CENTRE_MM * k::EYE_CENTRE_MM));
    }
    prior
}

#[cfg(test)]
mod tests;
