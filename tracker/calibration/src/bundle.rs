//! The parameters of a self-calibration and the derivatives of images by them: camera poses (and
//! lenses), marker positions, poses of bodies at every instant.

use crate::lens::{EXTRINSICS, lens_of};
use crate::observations::{FrameObservations, MarkerObservation};
use crate::target_problem::camera_pose;
use nalgebra::{Isometry3, Vector2};
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
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
    /// Shift of each camera's timestamps, s.
    pub clock_s: f64,
    /// Shift of the lines of a field whose parity is swapped, in pixels of the frame.
    pub parity_px: f64,
    /// Share of the shift of a ball's image off the camera's axis, which is 1 in pictures and 0 in drawn blobs.
    pub aside: f64,
    /// Parts that are as free as `wide` says, against all others.
    pub elsewhere: Vec<Part>,
    /// For these.
    pub wide: PriorSigmas,
    /// Some parts are elsewhere, and which is not known: the prior has heavy tails, so that the frames of the world and
    /// of the bodies follow the parts that moved least, and not the mean of all.
    pub unnamed: bool,
    /// Values of lenses that stay as they are: index of the camera, and index into
    /// [`crate::lens::LENS_NAMES`].
    pub held: Vec<(usize, usize)>,
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
    pub(super) fn of(&self, part: Part) -> &PriorSigmas {
        if self.elsewhere.contains(&part) { &self.wide } else { &self.known }
    }

    /// As [`PriorSigmas::rough`].
    pub fn rough(&self, rig: &Rig) -> f64 {
        let known = self.known.rough(rig);
        if self.elsewhere.is_empty() { known } else { known.max(self.wide.rough(rig)) }
    }
}

/// Only the poses are free.
pub(crate) const FIXED_RIG: PriorSigmas =
    PriorSigmas { camera_mm: 0.0, camera_rad: 0.0, marker_mm: 0.0, lens_px: 0.0 };
/// Values of all parameters.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// Cameras in the order of the rig.
    pub cameras: Vec<Camera>,
    /// Markers of each body.
    pub markers: Vec<Vec<Marker>>,
    /// Poses by instant and body.
    pub poses: Vec<[Option<Isometry3<f64>>; BODIES]>,
    /// By how much each camera's timestamps are late, s.
    pub late_s: Vec<f64>,
    /// How much of a swapped parity each camera shows: 0 of none, 1 of a whole one.
    pub swapped: Vec<f64>,
    /// How much of the shift off the axis balls show: 0 or 1.
    pub aside: f64,
}

impl Bundle {
    /// By how much the centre of a ball's image lies farther off the axis than the image of its centre, px.
    pub(super) fn aside_px(
        &self,
        seen: &MarkerObservation,
        pixel: &Vector2<f64>,
        depth_mm: f64,
    ) -> Vector2<f64> {
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
        let motion = instant.poses[seen.body]?.motion;
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

/// Rotation (rad, camera frame) and translation (mm) by which a camera's place has changed, as
/// [`move_extrinsics`] takes them.
pub fn extrinsics_change(before: &Camera, after: &Camera) -> [f64; EXTRINSICS] {
    let turn = (camera_pose(after).rotation * camera_pose(before).rotation.inverse()).scaled_axis();
    let shift = after.translation_mm - before.translation_mm;
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}
