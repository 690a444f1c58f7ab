//! The least-squares problem of a self-calibration: the values that are free, and the derivatives of images by them.

use crate::bundle::{Bundle, Freedom, Part, Value};
use crate::lens::{
    EXTRINSICS, LENS, LENS_NAMES, by_extrinsics, by_pose, lens_of, move_extrinsics, move_pose, project,
    set_lens,
};
use crate::observations::{FrameObservations, MarkerObservation};
use crate::solve::{Column, Loss, MAX_STEPS, NormalEquations, Problem, Unknown};
use nalgebra::{DVector, Isometry3, Matrix1, Matrix2, SMatrix, SVector, Vector2, Vector3};
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, EYE};
use rig::camera::Camera;

/// How far all clocks together may be late, s: what exposes later on a motion that is later looks the same, so that
/// only their differences are in the pictures.
const COMMON_S: f64 = 1e-5;
/// Most steps of a solution that need not be as near as can be: one with two cameras that were moved took more than 400.
const STEPS: usize = 1000;

/// The mean of all clocks over its standard deviation, by shared unknowns; nothing where no clock is free.
pub(crate) fn common_clock(values: &[Value]) -> DVector<f64> {
    let is_late = |value: &Value| matches!(value, Value::Late(_));
    let clocks = values.iter().filter(|v| is_late(v)).count().max(1) as f64;
    let slope = |value: &Value| if is_late(value) { 1.0 / (clocks * COMMON_S) } else { 0.0 };
    DVector::from_iterator(values.len(), values.iter().map(slope))
}

/// Standard deviations beyond which a blob loses its weight.
pub(super) const SUSPECT: f64 = 4.0;

/// The least-squares problem of a self-calibration.
pub struct SelfCalibrationProblem<'a> {
    pub(super) instants: &'a [FrameObservations],
    pub(super) before: Bundle,
    pub(super) values: Vec<Value>,
    pub(super) sigmas: Vec<f64>,
    /// Unknown of each value of each camera's lens.
    lens_at: Vec<[Option<usize>; LENS]>,
    /// First unknown of each camera's place, and of each marker.
    pub(super) place_at: Vec<Option<usize>>,
    marker_at: Vec<Vec<Option<usize>>>,
    late_at: Vec<Option<usize>>,
    swapped_at: Vec<Option<usize>>,
    aside_at: Option<usize>,
    /// What makes each blob's residual of unit variance, by instant.
    whitening: Vec<Vec<Matrix2<f64>>>,
    /// The eye may also move, not only turn.
    eye_moves: bool,
    pub(super) noise: f64,
    near_enough: f64,
    /// The prior of places has heavy tails.
    unnamed: bool,
}

impl<'a> SelfCalibrationProblem<'a> {
    /// The problem for some observations, with the prior mean and initial value `before`. Only
    /// observed markers are parameters.
    pub fn new(instants: &'a [FrameObservations], before: Bundle, free: &Freedom, eye_moves: bool) -> Self {
        // A blob with an invalid covariance gets no weight.
        let whiten = |s: &MarkerObservation| {
            s.covariance.cholesky().and_then(|c| c.l().try_inverse()).unwrap_or_default()
        };
        let mut out = SelfCalibrationProblem {
            instants,
            whitening: instants.iter().map(|i| i.seen.iter().map(whiten).collect()).collect(),
            eye_moves,
            values: Vec::new(),
            sigmas: Vec::new(),
            lens_at: vec![[None; LENS]; before.cameras.len()],
            place_at: vec![None; before.cameras.len()],
            marker_at: before.markers.iter().map(|m| vec![None; m.len()]).collect(),
            late_at: vec![None; before.cameras.len()],
            swapped_at: vec![None; before.cameras.len()],
            aside_at: None,
            before,
            noise: 1.0,
            near_enough: free.near_enough,
            unnamed: free.unnamed,
        };
        let seen = |of: &dyn Fn(&MarkerObservation) -> bool| instants.iter().any(|i| i.seen.iter().any(of));
        for c in 0..out.before.cameras.len() {
            if seen(&|s| s.camera == c) {
                out.push_camera(c, free, seen(&|s| s.camera == c && s.if_swapped_px != 0.0));
            }
        }
        if free.aside > 0.0 {
            out.aside_at = Some(out.values.len());
            out.push(Value::Aside, free.aside);
        }
        for body in 0..out.before.markers.len() {
            for marker in 0..out.before.markers[body].len() {
                let own = free.of(Part::Marker(body, marker)).marker_mm;
                if own > 0.0 && seen(&|s| (s.body, s.marker) == (body, marker)) {
                    out.marker_at[body][marker] = Some(out.values.len());
                    (0..3).for_each(|i| out.push(Value::Marker(body, marker, i), own));
                }
            }
        }
        out
    }

    /// Appends the parameters of a camera; its parity only if `has_lines`, because whole frames have none.
    fn push_camera(&mut self, c: usize, free: &Freedom, has_lines: bool) {
        let lens_px = free.known.lens_px.max(free.of(Part::Camera(c)).lens_px);
        if lens_px > 0.0 {
            let sigmas = lens_sigmas(&self.before.cameras[c], lens_px);
            for (i, sigma) in sigmas.into_iter().enumerate() {
                if !free.held.contains(&(c, i)) {
                    self.lens_at[c][i] = Some(self.values.len());
                    self.push(Value::Lens(c, i), sigma);
                }
            }
        }
        let own = free.of(Part::Camera(c));
        if own.camera_mm > 0.0 && own.camera_rad > 0.0 {
            self.place_at[c] = Some(self.values.len());
            for i in 0..EXTRINSICS {
                let sigma = if i < 3 { own.camera_rad } else { own.camera_mm };
                self.push(Value::Place(c, i), sigma);
            }
        }
        if free.clock_s > 0.0 {
            self.late_at[c] = Some(self.values.len());
            self.push(Value::Late(c), free.clock_s);
        }
        if free.parity_px > 0.0 && has_lines {
            self.swapped_at[c] = Some(self.values.len());
            self.push(Value::Swapped(c), free.parity_px);
        }
    }

    /// Adds the prior of the `N` values of one part, which begin at `first`. Where it is not known which parts moved, each
    /// loses its weight as a whole: a marker that moved along one axis says nothing by the others either.
    fn prior_of<const N: usize>(&self, state: &Bundle, first: usize, out: &mut NormalEquations) {
        let inverse = |i: usize| 1.0 / self.sigmas[first + i];
        // The rotation's increment and its logarithm differ in second order only.
        let off = SVector::<f64, N>::from_fn(|i, _| {
            self.values[first + i].change(&self.before, state) * inverse(i)
        });
        let columns: [Column<N>; N] = std::array::from_fn(|i| {
            let slope = SVector::from_fn(|row, _| if row == i { inverse(i) } else { 0.0 });
            (Unknown::Shared(first + i), slope)
        });
        let heavy = self.unnamed && N > 1;
        out.add(&off, &columns, if heavy { Loss::Cauchy((N as f64).sqrt()) } else { Loss::Square });
    }

    fn push(&mut self, value: Value, sigma: f64) {
        self.values.push(value);
        self.sigmas.push(sigma);
    }

    /// First own unknown of each body at an instant, and their number.
    fn own_at(&self, block: usize) -> ([Option<usize>; BODIES], usize) {
        let (mut at, mut n) = ([None; BODIES], 0);
        for (body, pose) in self.before.poses[block].iter().enumerate() {
            if pose.is_some() {
                at[body] = Some(n);
                n += self.own_of(body);
            }
        }
        (at, n)
    }

    /// The state after a step of the shared unknowns.
    pub(super) fn moved_rig(&self, state: &Bundle, shared: &DVector<f64>) -> Bundle {
        let mut next = state.clone();
        for (c, camera) in next.cameras.iter_mut().enumerate() {
            let mut lens = lens_of(camera);
            for (value, at) in lens.iter_mut().zip(self.lens_at[c]) {
                *value += at.map_or(0.0, |at| shared[at]);
            }
            set_lens(camera, &lens);
            if let Some(at) = self.place_at[c] {
                move_extrinsics(camera, &SMatrix::<f64, EXTRINSICS, 1>::from_fn(|i, _| shared[at + i]));
            }
        }
        for (values, ats) in [(&mut next.late_s, &self.late_at), (&mut next.swapped, &self.swapped_at)] {
            let free = values.iter_mut().zip(ats).filter_map(|(value, at)| Some((value, (*at)?)));
            free.for_each(|(value, at)| *value += shared[at]);
        }
        next.aside += self.aside_at.map_or(0.0, |at| shared[at]);
        for (markers, ats) in next.markers.iter_mut().zip(&self.marker_at) {
            for (marker, at) in markers.iter_mut().zip(ats) {
                if let Some(at) = *at {
                    marker.position += Vector3::new(shared[at], shared[at + 1], shared[at + 2]);
                }
            }
        }
        next
    }

    /// Own unknowns of a body: the eye turns about the origin, instruments also move.
    pub(super) fn own_of(&self, body: usize) -> usize {
        if body == EYE && !self.eye_moves { 3 } else { 6 }
    }

    /// Whitened residual (computed less seen) of a blob of a block, and its derivatives unless only
    /// the cost is wanted; `None` behind the camera.
    fn image(
        &self,
        state: &Bundle,
        block: usize,
        blob: usize,
        own: Option<usize>,
        columns: Option<&mut Vec<Column<2>>>,
    ) -> Option<Vector2<f64>> {
        let (instant, seen) = (&self.instants[block], &self.instants[block].seen[blob]);
        let pose = state.pose_at_exposure(block, instant, seen)?;
        let motion = instant.poses[seen.body]?.motion;
        let Some(columns) = columns else {
            return Some(self.residual(state, (block, blob), (&pose, &motion), None)?.0);
        };
        let (residual, by_pose) =
            self.residual(state, (block, blob), (&pose, &motion), Some(&mut *columns))?;
        let before = columns.len();
        add_columns(columns, own.map(Unknown::Own), &Matrix2::identity(), &by_pose);
        columns.truncate(before + self.own_of(seen.body));
        Some(residual)
    }

    /// Whitened residual of a blob whose body is at `pose` and moves so at its exposure, and its derivatives by the
    /// pose (turn about its origin, shift). Those by the shared unknowns are left in `columns`, unless only the cost
    /// is wanted.
    pub(super) fn residual(
        &self,
        state: &Bundle,
        (block, blob): (usize, usize),
        (pose, [speed, turning]): (&Isometry3<f64>, &[Vector3<f64>; 2]),
        columns: Option<&mut Vec<Column<2>>>,
    ) -> Option<(Vector2<f64>, SMatrix<f64, 2, EXTRINSICS>)> {
        let seen = &self.instants[block].seen[blob];
        let camera = &state.cameras[seen.camera];
        let point = state.image(pose, seen)?.point;
        let p = camera.in_camera(&point);
        let image = project(camera, &p)?;
        let whiten = self.whitening[block][blob] / self.noise;
        let swapped = Vector2::new(0.0, seen.if_swapped_px);
        let aside = state.aside_px(seen, &image.pixel, p.z);
        let pixel = image.pixel + swapped * state.swapped[seen.camera] + aside * state.aside;
        let residual = whiten * (pixel - seen.pixel);
        let Some(columns) = columns else { return Some((residual, SMatrix::zeros())) };
        columns.clear();
        let by_world = image.by_point * camera.camera_from_world;
        let arm = point.coords - pose.translation.vector;
        let by_place = image.by_point * by_extrinsics(camera, &p);
        let by_marker = by_world * pose.rotation.to_rotation_matrix().matrix();
        let by_late = -(by_world * (speed + turning.cross(&arm)));
        let shared = |first: Option<usize>| first.map(Unknown::Shared);
        for (at, slope) in self.lens_at[seen.camera].iter().zip(image.by_lens.column_iter()) {
            add_columns::<1>(columns, shared(*at), &whiten, &slope.into_owned());
        }
        add_columns(columns, shared(self.place_at[seen.camera]), &whiten, &by_place);
        add_columns(columns, shared(self.marker_at[seen.body][seen.marker]), &whiten, &by_marker);
        add_columns(columns, shared(self.late_at[seen.camera]), &whiten, &by_late);
        add_columns(columns, shared(self.swapped_at[seen.camera]), &whiten, &swapped);
        add_columns(columns, shared(self.aside_at), &whiten, &aside);
        Some((residual, whiten * by_pose(&by_world, &arm)))
    }
}

/// Adds the whitened derivatives of an image by the unknowns from `first` on; none where they are
/// fixed.
fn add_columns<const N: usize>(
    columns: &mut Vec<Column<2>>,
    first: Option<Unknown>,
    whiten: &Matrix2<f64>,
    by_unknowns: &SMatrix<f64, 2, N>,
) {
    let Some(first) = first else { return };
    for (i, slope) in by_unknowns.column_iter().enumerate() {
        let unknown = match first {
            Unknown::Shared(first) => Unknown::Shared(first + i),
            Unknown::Own(first) => Unknown::Own(first + i),
        };
        columns.push((unknown, whiten * Vector2::from(slope)));
    }
}

/// Standard deviations of the nine values of a lens that each shift the picture's corner by `px`.
fn lens_sigmas(camera: &Camera, px: f64) -> [f64; LENS] {
    let [w, h] = camera.size_px.map(|n| f64::from(n) / 2.0);
    let corner = Vector2::new(w / camera.focal_px.x, h / camera.focal_px.y);
    let r2 = corner.norm_squared();
    let reach = corner.norm() * camera.focal_px.x;
    let radial = px / reach;
    [px, px, px, px, radial / r2, radial / (r2 * r2), radial / r2, radial / r2, radial / (r2 * r2 * r2)]
}

impl Problem for SelfCalibrationProblem<'_> {
    type State = Bundle;

    fn shared(&self) -> usize {
        self.values.len()
    }

    fn name(&self, shared: usize) -> String {
        match self.values[shared] {
            Value::Lens(camera, i) => format!("{} of camera {camera}", LENS_NAMES[i]),
            Value::Place(camera, i) if i < 3 => format!("rotation of camera {camera}"),
            Value::Place(camera, _) => format!("translation of camera {camera}"),
            Value::Marker(body, marker, _) => format!("marker {marker} of {}", BODY_NAMES[body]),
            Value::Late(camera) => format!("clock of camera {camera}"),
            Value::Aside => "shift off the axis".into(),
            Value::Swapped(camera) => format!("parity of camera {camera}"),
        }
    }

    fn near_enough(&self) -> f64 {
        self.near_enough
    }

    fn most_steps(&self) -> usize {
        if self.near_enough > 0.0 { STEPS } else { MAX_STEPS }
    }

    fn blocks(&self) -> usize {
        self.instants.len()
    }

    fn own(&self, block: usize) -> usize {
        self.own_at(block).1
    }

    fn equations(&self, state: &Bundle, block: usize, out: &mut NormalEquations) {
        let (own, _) = self.own_at(block);
        let mut columns = Vec::with_capacity(LENS + 2 * EXTRINSICS + 6);
        for (blob, seen) in self.instants[block].seen.iter().enumerate() {
            let wanted = (!out.cost_only()).then_some(&mut columns);
            match self.image(state, block, blob, own[seen.body], wanted) {
                Some(residual) => out.add(&residual, &columns, Loss::Cauchy(SUSPECT)),
                None => out.refuse(),
            }
        }
    }

    fn prior(&self, state: &Bundle, out: &mut NormalEquations) {
        for (at, value) in self.values.iter().enumerate() {
            match *value {
                Value::Place(_, 0) => self.prior_of::<EXTRINSICS>(state, at, out),
                Value::Marker(_, _, 0) => self.prior_of::<3>(state, at, out),
                Value::Place(..) | Value::Marker(..) => {}
                _ => self.prior_of::<1>(state, at, out),
            }
        }
        let slopes = common_clock(&self.values);
        let clocks = self.values.iter().enumerate().filter(|(at, _)| slopes[*at] != 0.0);
        let clocks: Vec<(usize, f64)> =
            clocks.map(|(at, v)| (at, v.change(&self.before, state) * slopes[at])).collect();
        if clocks.len() > 1 {
            let columns: Vec<Column<1>> =
                clocks.iter().map(|(at, _)| (Unknown::Shared(*at), Matrix1::new(slopes[*at]))).collect();
            let mean = clocks.iter().map(|(_, off)| off).sum::<f64>();
            out.add(&Matrix1::new(mean), &columns, Loss::Square);
        }
    }

    fn moved(&self, state: &Bundle, shared: &DVector<f64>, own: &[DVector<f64>]) -> Bundle {
        let mut next = self.moved_rig(state, shared);
        for (block, (poses, step)) in next.poses.iter_mut().zip(own).enumerate() {
            let (ats, _) = self.own_at(block);
            for (body, (pose, at)) in poses.iter_mut().zip(ats).enumerate() {
                let (Some(pose), Some(at)) = (pose, at) else { continue };
                move_pose(pose, &step.as_slice()[at..at + self.own_of(body)]);
            }
        }
        next
    }
}
