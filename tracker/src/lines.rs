//! Where a body is when a camera exposes each of its lines.
//!
//! With a global shutter that is one place a field. A rolling shutter exposes line after line, so that a marker is
//! seen so much earlier or later than the field's instant as its line lies above or below the middle: the body is
//! carried there with the filter's velocity, tremor included.

use crate::pose_math::{Matrix6, Vector6, propagated};
use crate::projection::{MarkerImage, PoseMatrix, project_marker};
use crate::rig_model::{Lines, Marker, RigModel};
use nalgebra::{Isometry3, Matrix2, SMatrix, Vector3};
use rig::camera::Camera;

/// What is known of a body's motion (velocity, mm/s, and angular velocity, rad/s, in the world) once its pose is: blobs
/// that were exposed at different instants see both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionGivenPose {
    /// Change of the motion with that of the pose, K.
    by_pose: Matrix6,
    /// Covariance that remains.
    covariance: Matrix6,
}

impl MotionGivenPose {
    /// From the covariances of the motion with the pose and with itself, and the inverse of that of the pose.
    pub fn new(with_pose: &Matrix6, covariance: &Matrix6, pose_information: &Matrix6) -> Self {
        let by_pose = with_pose * pose_information;
        let rest = covariance - by_pose * with_pose.transpose();
        MotionGivenPose { by_pose, covariance: (rest + rest.transpose()) * 0.5 }
    }

    /// The motion of a body whose pose is off its prediction by `off`.
    pub fn motion(&self, predicted: &[Vector3<f64>; 2], off: &Vector6) -> [Vector3<f64>; 2] {
        let change = self.by_pose * off;
        let [velocity, turning] = [0, 3].map(|row| Vector3::from(change.fixed_rows::<3>(row)));
        [predicted[0] + velocity, predicted[1] + turning]
    }

    /// Jacobian of a blob by the pose at the group's instant, from that by the pose `dt_s` seconds later.
    pub fn jacobian(&self, then: &SMatrix<f64, 2, 6>, dt_s: f64) -> SMatrix<f64, 2, 6> {
        then + then * self.by_pose * dt_s
    }

    /// What the motion that remains unknown adds to the covariance of a blob, px².
    pub fn spread(&self, then: &SMatrix<f64, 2, 6>, dt_s: f64) -> Matrix2<f64> {
        then * self.covariance * then.transpose() * (dt_s * dt_s)
    }
}

/// A body as the lines of one camera-field see it.
#[derive(Debug, Clone, Copy)]
pub struct BodyInField {
    pose: Isometry3<f64>,
    motion: [Vector3<f64>; 2],
    dt_s: f64,
    lines: Lines,
    at_field: PoseMatrix,
}

impl BodyInField {
    /// For a body that is at `pose` with this motion (mm/s and rad/s in the world) `dt_s` seconds before the instant
    /// of a field of `camera` (an id).
    pub fn new(
        rig: &RigModel,
        camera: usize,
        pose: &Isometry3<f64>,
        motion: &[Vector3<f64>; 2],
        dt_s: f64,
    ) -> Self {
        let at_field = PoseMatrix::from(&propagated(pose, motion, dt_s));
        BodyInField { pose: *pose, motion: *motion, dt_s, lines: rig.lines[camera], at_field }
    }

    /// From the instant of the pose to that at which line `y_px` of the frame is exposed, s.
    pub fn dt_s(&self, y_px: f64) -> f64 {
        self.lines.dt_s(self.dt_s, y_px)
    }

    /// The pose when line `y_px` of the frame is exposed.
    pub fn pose_at(&self, y_px: f64) -> PoseMatrix {
        if self.lines.is_global() {
            return self.at_field;
        }
        PoseMatrix::from(&propagated(&self.pose, &self.motion, self.dt_s(y_px)))
    }

    /// The image of a marker, on the line that sees it, and the pose at that line's instant; `None` behind the
    /// camera.
    pub fn image(&self, marker: &Marker, camera: &Camera) -> Option<(MarkerImage, PoseMatrix)> {
        let image = project_marker(marker, &self.at_field, camera)?;
        if self.lines.is_global() {
            return Some((image, self.at_field));
        }
        // A marker moves by a pixel or two while a field is read out: its line is known well enough at once.
        let pose = self.pose_at(image.pixel.y);
        Some((project_marker(marker, &pose, camera)?, pose))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rig::Rig;
    use rig::sensor::Shutter;

    const MOTION: [Vector3<f64>; 2] = [Vector3::new(20.0, -10.0, 5.0), Vector3::new(0.2, 0.1, -1.0)];

    fn image(shutter: Shutter, pose: &Isometry3<f64>, motion: &[Vector3<f64>; 2]) -> [f64; 2] {
        let rig = RigModel::new(&Rig { shutter, ..Rig::load_or_shipped(None).unwrap() });
        let marker = Marker { position: Point3::new(0.0, 0.0, 6.0), radius: 0.5, colour: 1, band: false };
        let body = BodyInField::new(&rig, 0, pose, motion, 0.0);
        body.image(&marker, rig.cameras[0].as_ref().unwrap()).unwrap().0.pixel.into()
    }

    #[test]
    fn a_marker_is_seen_when_its_line_is_exposed() {
        let rolling = Rig { shutter: Shutter::Rolling, ..Rig::load_or_shipped(None).unwrap() };
        let sensor = rolling.sensors()[0];
        for height_mm in [-8.0, 0.0, 8.0] {
            let pose = Isometry3::translation(1.0, height_mm, -4.0);
            let [x, y] = image(Shutter::Rolling, &pose, &MOTION);
            // Where a global shutter would see it at the instant of that line.
            let late = propagated(&pose, &MOTION, sensor.row_delay_ns(y) * 1e-9);
            let there = image(Shutter::Global, &late, &MOTION);
            // At 23 mm/s its line is known to a hundredth of what it moves.
            assert!((x - there[0]).hypot(y - there[1]) < 0.05, "{x}, {y}: {there:?}");
            assert_eq!(
                image(Shutter::Rolling, &pose, &[Vector3::zeros(); 2]),
                image(Shutter::Global, &pose, &MOTION)
            );
        }
        let far = image(Shutter::Rolling, &Isometry3::translation(1.0, 8.0, -4.0), &MOTION);
        let global = image(Shutter::Global, &Isometry3::translation(1.0, 8.0, -4.0), &MOTION);
        assert!((far[1] - global[1]).abs() > 0.2, "{far:?}, {global:?}: the test would not see a difference");
    }
}
