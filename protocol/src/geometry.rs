//! Poses and their validity.

use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};
use nalgebra::{Isometry3, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A rigid transform `target_from_source`: position in mm, unit quaternion (w, x, y, z).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Pose {
    /// Origin of the source frame in the target frame, mm.
    #[wire(tag = 1)]
    pub position_mm: [f64; 3],
    /// Rotation target-from-source as (w, x, y, z).
    #[wire(tag = 2)]
    pub rotation_wxyz: [f64; 4],
}

impl Pose {
    /// No translation, no rotation.
    pub const IDENTITY: Pose = Pose { position_mm: [0.0; 3], rotation_wxyz: [1.0, 0.0, 0.0, 0.0] };

    /// As a nalgebra isometry; the quaternion is normalised.
    pub fn isometry(&self) -> Isometry3<f64> {
        let [w, x, y, z] = self.rotation_wxyz;
        Isometry3::from_parts(
            Translation3::from(Vector3::from(self.position_mm)),
            UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
        )
    }

    /// From a nalgebra isometry; the quaternion's sign is chosen so that w ≥ 0.
    pub fn from_isometry(target_from_source: &Isometry3<f64>) -> Self {
        let q = target_from_source.rotation.quaternion();
        let s = if q.w < 0.0 { -1.0 } else { 1.0 };
        Pose {
            position_mm: target_from_source.translation.vector.into(),
            rotation_wxyz: [s * q.w, s * q.i, s * q.j, s * q.k],
        }
    }

    /// A point of the source frame, in the target frame, mm.
    pub fn transform(&self, p_in_source: [f64; 3]) -> [f64; 3] {
        (self.isometry() * Point3::from(p_in_source)).coords.into()
    }

    /// True if the numbers are finite and the quaternion is of unit length within 1e-6.
    pub fn is_valid(&self) -> bool {
        let q = &self.rotation_wxyz;
        let n2: f64 = q.iter().map(|c| c * c).sum();
        self.position_mm.iter().all(|c| c.is_finite() && c.abs() < 1e6) && (n2 - 1.0).abs() < 1e-6
    }
}

/// How far a value may be trusted. Travels with the value; a zero pose is never a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Validity {
    /// Nothing is known; the numbers beside it are the last good ones.
    Lost = 0,
    /// Extrapolated from earlier measurements.
    Predicted = 1,
    /// A measurement of this very instant took part.
    Measured = 2,
}

impl Validity {
    /// From the wire; `None` for a number no build ever sent.
    pub fn from_wire(code: u32) -> Option<Self> {
        [Self::Lost, Self::Predicted, Self::Measured].get(code as usize).copied()
    }
}

/// `eye_from_instrument` of a shaft whose axis runs from the tip through the trocar, turned by
/// `roll_rad` about it. With no roll, +x is as near to the eye's +y (superior) as the shaft allows.
/// Positions are in the eye frame, mm.
pub fn shaft_pose(tip: &Vector3<f64>, trocar: &Vector3<f64>, roll_rad: f64) -> Isometry3<f64> {
    let along = (trocar - tip).try_normalize(1e-6).unwrap_or(Vector3::z());
    let upright = if along.y.abs() < 0.99 { Vector3::y() } else { Vector3::x() };
    let x = (upright - along * along.dot(&upright)).normalize();
    let unrolled = Rotation3::from_basis_unchecked(&[x, along.cross(&x), along]);
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad);
    Isometry3::from_parts(Translation3::from(*tip), UnitQuaternion::from_rotation_matrix(&unrolled) * roll)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_and_isometry_agree() {
        let iso = Isometry3::new(Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.3, -0.2, 2.9));
        let pose = Pose::from_isometry(&iso);
        assert!(pose.is_valid());
        let p = pose.transform([0.1, 0.2, 0.3]);
        let q = iso * Point3::new(0.1, 0.2, 0.3);
        assert!((Vector3::from(p) - q.coords).norm() < 1e-12);
    }
}
