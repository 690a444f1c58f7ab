//! The parameters of a self-calibration and the derivatives of images by them: camera poses (and
//! lenses), marker positions, poses of bodies at every instant.

use crate::lens::{
    EXTRINSICS, LENS, LENS_NAMES, by_extrinsics, by_pose, lens_of, move_extrinsics, move_pose, project,
    set_lens,
};
use crate::observations::{FrameObservations, MarkerObservation};
use crate::solve::{Column, Loss, NormalEquations, Problem, Unknown};
use crate::target_problem::camera_pose;
use nalgebra::{DVector, Isometry3, Matrix1, Matrix2, SMatrix, Vector2, Vector3};
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, EYE};
use rig::Rig;
use rig::camera::Camera;
use tracker::pose_math::propagated;
use tracker::projection::{MarkerImage, project_marker};
use tracker::rig_model::{Marker, RigModel};

/// Prior standard deviations of a rig; 0 fixes a value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorSigmas {
    /// Where the world's origin is before each camera, along each of the camera's axes, mm.
    pub camera_mm: f64,
    /// How the world is turned before each camera, about each axis, rad.
    pub camera_rad: f64,
    /// Position of each marker along each axis, mm.
    pub marker_mm: f64,
    /// Focal lengths and principal points, px; the distortion by the shift it makes at the corner
    /// of the picture.
    pub lens_px: f64,
}

/// Standard deviation of a blob's centre, px, in the mean of columns and lines.
const BLOB_PX: f64 = 0.07;

impl PriorSigmas {
    /// Ratio of the image shifts by the rig's errors to the noise of a blob, at least 1.
    pub fn rough(&self, rig: &Rig) -> f64 {
        let of_camera = |c: &Camera| {
            let px_per_mm = c.focal_px.x / c.translation_mm.norm().max(1.0);
            px_per_mm * self.camera_mm.hypot(self.camera_rad * rig.workspace.tip_radius).hypot(self.marker_mm)
        };
        let shift = rig.cameras().iter().map(of_camera).fold(0.0, f64::max).hypot(self.lens_px);
        (shift / BLOB_PX).max(1.0)
    }
}

impl Default for PriorSigmas {
    /// A well-calibrated rig that may have drifted: hundredths of a millimetre.
    fn default() -> Self {
        PriorSigmas { camera_mm: 0.02, camera_rad: 0.3e-3, marker_mm: 0.005, lens_px: 0.0 }
    }
}

/// A part of a rig that is known to be elsewhere than the rig says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The camera with this index in the rig.
    Camera(usize),
    /// A marker of a body.
    Marker(usize, usize),
}

/// What is free in a problem, and how far.
#[derive(Debug, Clone, Default)]
pub struct Freedom {
    /// Of everything alike.
    pub known: PriorSigmas,
    /// Shift of each camera's time stamps, s.
    pub clock_s: f64,
    /// Shift of the lines of a field whose parity is swapped, in pixels of the frame.
    pub parity_px: f64,
    /// Share of the shift of a ball's image off the camera's axis, which is 1 in pictures and 0 in drawn blobs.
    pub aside: f64,
    /// Parts that are as free as `wide` says, against all others.
    pub elsewhere: Vec<Part>,
    /// For these.
    pub wide: PriorSigmas,
    /// Distance to the minimum that is near enough, in standard deviations; 0: as near as can be.
    pub near_enough: f64,
}

impl From<PriorSigmas> for Freedom {
    fn from(known: PriorSigmas) -> Self {
        Freedom { known, ..Freedom::default() }
    }
}

impl Freedom {
    /// Of a part.
    fn of(&self, part: Part) -> &PriorSigmas {
        if self.elsewhere.contains(&part) { &self.wide } else { &self.known }
    }

    /// As [`PriorSigmas::rough`].
    pub fn rough(&self, rig: &Rig) -> f64 {
        let known = self.known.rough(rig);
        if self.elsewhere.is_empty() { known } else { known.max(self.wide.rough(rig)) }
    }
}

/// Only the poses are free.
pub(super) const FIXED_RIG: PriorSigmas =
    PriorSigmas { camera_mm: 0.0, camera_rad: 0.0, marker_mm: 0.0, lens_px: 0.0 };
/// Standard deviations beyond which a blob loses its weight.
const SUSPECT: f64 = 4.0;

/// Values of all parameters.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// Cameras in the order of the rig.
    pub cameras: Vec<Camera>,
    /// Markers of each body.
    pub markers: Vec<Vec<Marker>>,
    /// Poses by instant and body.
    pub poses: Vec<[Option<Isometry3<f64>>; BODIES]>,
    /// By how much each camera's time stamps are late, s.
    pub late_s: Vec<f64>,
    /// How much of a swapped parity each camera shows: 0 of none, 1 of a whole one.
    pub swapped: Vec<f64>,
    /// How much of the shift off the axis balls show: 0 or 1.
    pub aside: f64,
}

impl Bundle {
    /// By how much the centre of a ball's image lies farther off the axis than the image of its centre, px.
    fn aside_px(&self, seen: &MarkerObservation, pixel: &Vector2<f64>, depth_mm: f64) -> Vector2<f64> {
        let radius = self.markers[seen.body][seen.marker].radius;
        (pixel - self.cameras[seen.camera].centre_px) * (radius / depth_mm).powi(2)
    }

    /// The rig as it is and the poses that the tracker found with it.
    pub fn new(rig: &Rig, instants: &[FrameObservations]) -> Self {
        Bundle {
            late_s: vec![0.0; rig.cameras.len()],
            swapped: vec![0.0; rig.cameras.len()],
            aside: 0.0,
            cameras: rig.cameras(),
            markers: RigModel::new(rig).bodies.iter().map(|b| b.markers.clone()).collect(),
            poses: instants.iter().map(|i| i.poses.map(|p| p.map(|p| p.pose))).collect(),
        }
    }

    /// Pose of a marker's body at the exposure of an observation of `instant`, which is number
    /// `at`.
    pub fn pose_at_exposure(
        &self,
        at: usize,
        instant: &FrameObservations,
        seen: &MarkerObservation,
    ) -> Option<Isometry3<f64>> {
        let dt_s = seen.dt_s - self.late_s[seen.camera];
        let motion = instant.poses[seen.body]?.motion_to(dt_s);
        Some(propagated(&self.poses[at][seen.body]?, &motion, dt_s))
    }

    /// Image of an observed marker whose body is at `pose`; `None` behind the camera.
    pub fn image(&self, pose: &Isometry3<f64>, seen: &MarkerObservation) -> Option<MarkerImage> {
        let marker = &self.markers[seen.body][seen.marker];
        let mut image = project_marker(marker, &pose.into(), &self.cameras[seen.camera])?;
        image.pixel.y += self.swapped[seen.camera] * seen.if_swapped_px;
        if self.aside != 0.0 {
            let depth_mm = self.cameras[seen.camera].in_camera(&image.point).z;
            image.pixel += self.aside_px(seen, &image.pixel, depth_mm) * self.aside;
        }
        Some(image)
    }

    /// The rig with these cameras and markers.
    pub fn rig(&self, rig: &Rig) -> Rig {
        let mut out = rig.clone();
        for (old, camera) in out.cameras.iter_mut().zip(&self.cameras) {
            *old = crate::rig_output::rig_camera(camera);
        }
        for (name, markers) in BODY_NAMES.iter().zip(&self.markers) {
            let Some(body) = out.bodies.iter_mut().find(|b| b.name == *name) else { continue };
            for (old, marker) in body.markers.iter_mut().zip(markers) {
                old.p = marker.position.coords.into();
            }
        }
        out
    }
}

/// A shared parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Value {
    /// Camera, value of its lens.
    Lens(usize, usize),
    /// Camera, value of its place.
    Place(usize, usize),
    /// Body, marker, axis.
    Marker(usize, usize, usize),
    /// Camera.
    Late(usize),
    /// Camera.
    Swapped(usize),
    /// Of all balls.
    Aside,
}

impl Value {
    /// By how much it differs.
    pub(super) fn change(self, from: &Bundle, to: &Bundle) -> f64 {
        match self {
            Value::Lens(c, i) => lens_of(&to.cameras[c])[i] - lens_of(&from.cameras[c])[i],
            Value::Place(c, i) => extrinsics_change(&from.cameras[c], &to.cameras[c])[i],
            Value::Marker(b, m, i) => to.markers[b][m].position[i] - from.markers[b][m].position[i],
            Value::Late(c) => to.late_s[c] - from.late_s[c],
            Value::Aside => to.aside - from.aside,
            Value::Swapped(c) => to.swapped[c] - from.swapped[c],
        }
    }
}

/// The least-squares problem of a self-calibration.
pub struct SelfCalibrationProblem<'a> {
    pub(super) instants: &'a [FrameObservations],
    pub(super) before: Bundle,
    pub(super) values: Vec<Value>,
    pub(super) sigmas: Vec<f64>,
    /// First unknown of each camera's lens and place, and of each marker.
    lens_at: Vec<Option<usize>>,
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
}

impl<'a> SelfCalibrationProblem<'a> {
    /// The problem for some observations, with the prior mean and initial value `before`. Only
    /// observed markers are parameters.
    pub fn new(instants: &'a [FrameObservations], before: Bundle, free: &Freedom, eye_moves: bool) -> Self {
        let known = &free.known;
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
            lens_at: vec![None; before.cameras.len()],
            place_at: vec![None; before.cameras.len()],
            marker_at: before.markers.iter().map(|m| vec![None; m.len()]).collect(),
            late_at: vec![None; before.cameras.len()],
            swapped_at: vec![None; before.cameras.len()],
            aside_at: None,
            before,
            noise: 1.0,
            near_enough: free.near_enough,
        };
        let seen = |of: &dyn Fn(&MarkerObservation) -> bool| instants.iter().any(|i| i.seen.iter().any(of));
        for c in 0..out.before.cameras.len() {
            if !seen(&|s| s.camera == c) {
                continue;
            }
            if known.lens_px > 0.0 {
                out.lens_at[c] = Some(out.values.len());
                let sigmas = lens_sigmas(&out.before.cameras[c], known.lens_px);
                for (i, sigma) in sigmas.into_iter().enumerate() {
                    out.push(Value::Lens(c, i), sigma);
                }
            }
            let own = free.of(Part::Camera(c));
            if own.camera_mm > 0.0 && own.camera_rad > 0.0 {
                out.place_at[c] = Some(out.values.len());
                for i in 0..EXTRINSICS {
                    let sigma = if i < 3 { own.camera_rad } else { own.camera_mm };
                    out.push(Value::Place(c, i), sigma);
                }
            }
            if free.clock_s > 0.0 {
                out.late_at[c] = Some(out.values.len());
                out.push(Value::Late(c), free.clock_s);
            }
            if free.parity_px > 0.0 && seen(&|s| s.camera == c && s.if_swapped_px != 0.0) {
                out.swapped_at[c] = Some(out.values.len());
                out.push(Value::Swapped(c), free.parity_px);
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

    /// Own unknowns of a body: the eye turns about the origin, instruments also move.
    fn own_of(&self, body: usize) -> usize {
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
        let seen = &self.instants[block].seen[blob];
        let pose = state.pose_at_exposure(block, &self.instants[block], seen)?;
        let camera = &state.cameras[seen.camera];
        let point = state.image(&pose, seen)?.point;
        let p = camera.in_camera(&point);
        let image = project(camera, &p)?;
        let whiten = self.whitening[block][blob] / self.noise;
        let swapped = Vector2::new(0.0, seen.if_swapped_px);
        let aside = state.aside_px(seen, &image.pixel, p.z);
        let pixel = image.pixel + swapped * state.swapped[seen.camera] + aside * state.aside;
        let residual = whiten * (pixel - seen.pixel);
        let Some(columns) = columns else { return Some(residual) };
        columns.clear();
        let by_world = image.by_point * camera.camera_from_world;
        let arm = point.coords - pose.translation.vector;
        let by_place = image.by_point * by_extrinsics(camera, &p);
        let by_marker = by_world * pose.rotation.to_rotation_matrix().matrix();
        let shared = |first: Option<usize>| first.map(Unknown::Shared);
        add_columns(columns, shared(self.lens_at[seen.camera]), &whiten, &image.by_lens);
        add_columns(columns, shared(self.place_at[seen.camera]), &whiten, &by_place);
        add_columns(columns, shared(self.marker_at[seen.body][seen.marker]), &whiten, &by_marker);
        let dt_s = seen.dt_s - state.late_s[seen.camera];
        let [speed, turning] = self.instants[block].poses[seen.body]?.motion_to(2.0 * dt_s);
        let by_late = -(by_world * (speed + turning.cross(&arm)));
        add_columns(columns, shared(self.late_at[seen.camera]), &whiten, &by_late);
        add_columns(columns, shared(self.swapped_at[seen.camera]), &whiten, &swapped);
        add_columns(columns, shared(self.aside_at), &whiten, &aside);
        let before = columns.len();
        add_columns(columns, own.map(Unknown::Own), &whiten, &by_pose(&by_world, &arm));
        columns.truncate(before + self.own_of(seen.body));
        Some(residual)
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
        for (at, (value, sigma)) in self.values.iter().zip(&self.sigmas).enumerate() {
            let off = value.change(&self.before, state);
            // The rotation's increment and its logarithm differ in second order only.
            out.add(
                &Matrix1::new(off / sigma),
                &[(Unknown::Shared(at), Matrix1::new(1.0 / sigma))],
                Loss::Square,
            );
        }
    }

    fn moved(&self, state: &Bundle, shared: &DVector<f64>, own: &[DVector<f64>]) -> Bundle {
        let mut next = state.clone();
        for (c, camera) in next.cameras.iter_mut().enumerate() {
            if let Some(at) = self.lens_at[c] {
                let mut lens = lens_of(camera);
                lens.iter_mut().enumerate().for_each(|(i, v)| *v += shared[at + i]);
                set_lens(camera, &lens);
            }
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

/// Rotation (rad, camera frame) and translation (mm) by which a camera's place has changed, as
/// [`move_extrinsics`] takes them.
pub fn extrinsics_change(before: &Camera, after: &Camera) -> [f64; EXTRINSICS] {
    let turn = (camera_pose(after).rotation * camera_pose(before).rotation.inverse()).scaled_axis();
    let shift = after.translation_mm - before.translation_mm;
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}
