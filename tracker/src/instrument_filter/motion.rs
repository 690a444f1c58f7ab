//! What an instrument's pose says of its motion: blobs of one field that were exposed at different instants see both.

use super::{InstrumentFilter, N, ROLL, ROLL_TREMOR, ROLL_TREMORS, Row};
use crate::lines::MotionGivenPose;
use crate::pose_math::Matrix6;

impl InstrumentFilter {
    /// Regression of the motion on the pose; `pose_information` is the inverse of
    /// [`InstrumentFilter::pose_covariance`].
    pub fn motion_given_pose(&self, pose_information: &Matrix6) -> MotionGivenPose {
        let part = |row: &Row| self.motion_part(row);
        let mut with_pose = Matrix6::zeros();
        for (c, column) in self.cross.iter().enumerate() {
            with_pose.column_mut(c).copy_from_slice(&part(column));
        }
        let mut columns = [[0.0; N]; 6];
        for (r, row) in self.covariance.iter().enumerate() {
            for (column, value) in columns.iter_mut().zip(part(row)) {
                column[r] = value;
            }
        }
        let mut covariance = Matrix6::zeros();
        for (c, column) in columns.iter().enumerate() {
            covariance.column_mut(c).copy_from_slice(&part(column));
        }
        MotionGivenPose::new(&with_pose, &covariance, pose_information)
    }

    /// Velocity and angular velocity of a column (or row) of the covariance; as [`InstrumentFilter::motion`] of a state.
    fn motion_part(&self, row: &Row) -> [f64; 6] {
        let (axis, lever) = self.shaft();
        let [_, velocity, _, play] = self.tip_and_play(row);
        let rolling = (0..ROLL_TREMORS).fold(row[ROLL + 1], |sum, i| sum + row[ROLL_TREMOR + 2 * i + 1]);
        let turning = axis.cross(&(play - velocity)) / lever + axis * rolling;
        [velocity.x, velocity.y, velocity.z, turning.x, turning.y, turning.z]
    }
}
