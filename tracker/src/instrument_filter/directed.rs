//! Variances that differ along the shaft and across it.

use super::{N, Row};
use crate::motion_models::VOLUNTARY;
use nalgebra::{Matrix3, Vector3};

/// A variance along the shaft, and one of each axis across it: a trocar lets an instrument be put in and taken out along
/// its shaft only, and far faster than it is moved about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Directed {
    pub along: f64,
    pub across: f64,
}

impl Directed {
    /// The same in every direction.
    pub fn even(variance: f64) -> Self {
        Directed { along: variance, across: variance }
    }

    /// Means of the axes of a matrix of expected squares.
    pub fn of(squares: &Matrix3<f64>, axis: &Vector3<f64>) -> Self {
        let along = axis.dot(&(squares * axis));
        Directed { along, across: 0.5 * (squares.trace() - along) }
    }

    /// Each direction's, changed.
    pub fn map(self, change: impl Fn(f64) -> f64) -> Self {
        Directed { along: change(self.along), across: change(self.across) }
    }

    /// Each direction's, changed by `change` of it and the other's.
    pub fn zip(self, other: Self, change: impl Fn(f64, f64) -> f64) -> Self {
        Directed { along: change(self.along, other.along), across: change(self.across, other.across) }
    }

    /// The covariance of a vector that has these variances.
    pub fn covariance(self, axis: &Vector3<f64>) -> Matrix3<f64> {
        Matrix3::identity() * self.across + axis * axis.transpose() * (self.along - self.across)
    }
}

/// Adds to the covariance of the voluntary movement the noise of an acceleration of that covariance; `noise` is that of a
/// variance of 1.
pub(super) fn add_noise_of(
    p: &mut [Row; N],
    acceleration: &Matrix3<f64>,
    noise: &[[f64; VOLUNTARY]; VOLUNTARY],
) {
    for (r, row) in noise.iter().enumerate() {
        for (c, of_unit) in row.iter().enumerate() {
            for i in 0..3 {
                for j in 0..3 {
                    p[3 * r + i][3 * c + j] += acceleration[(i, j)] * of_unit;
                }
            }
        }
    }
}
