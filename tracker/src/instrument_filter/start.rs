//! What is known of an instrument that was just found: its pose, the hand that held it before, and how instruments
//! are put in.

use super::directed::Directed;
use super::transition::{roll_model, roll_tremor_model};
use super::{InstrumentFilter, N, PLAY, ROLL, ROLL_TREMOR, ROLL_TREMORS, Row, tip_of};
use crate::constants as k;
use crate::motion_models::VoluntaryMotion;
use crate::pose_math::Matrix6;
use crate::tremor_bank::BANDS;
use nalgebra::{Matrix3, Vector3};

/// What is learnt of the hand that holds an instrument. It is kept while the instrument is lost: put back, it is
/// predicted with the same hand's tremor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// Variance of the displacement of each band of the tremor, mm².
    pub tremor_variance: [f64; BANDS],
    /// Variance of the angle of each oscillator of the roll, rad².
    pub roll_tremor_variance: [f64; ROLL_TREMORS],
    /// Distance of the tip from the trocar at which the tremor has those variances, mm; 0 if no trocar was known yet.
    pub lever_mm: f64,
}

impl Default for Hand {
    fn default() -> Self {
        Hand {
            tremor_variance: k::TREMOR_BANDS.map(|band| band.start_mm * band.start_mm),
            roll_tremor_variance: [k::ROLL_TREMOR_START_RAD * k::ROLL_TREMOR_START_RAD; ROLL_TREMORS],
            lever_mm: 0.0,
        }
    }
}

impl InstrumentFilter {
    pub(super) fn start_covariance(
        &mut self,
        pose: &Matrix6,
        axis: &Vector3<f64>,
        lever: f64,
        is_back: bool,
    ) {
        let position: Matrix3<f64> = pose.fixed_view::<3, 3>(0, 0).into();
        let rotation: Matrix3<f64> = pose.fixed_view::<3, 3>(3, 3).into();
        let p = &mut self.covariance;
        for r in 0..3 {
            for c in 0..3 {
                p[r][c] = 0.5 * (position[(r, c)] + position[(c, r)]);
            }
        }
        let roll = (axis.transpose() * rotation * axis)[0];
        let tilt = (rotation.trace() - roll).max(0.0);
        let play = self.pivot.sigma * self.pivot.sigma;
        for axis in 0..3 {
            let mut put = |vector: usize, variance: f64| p[3 * vector + axis][3 * vector + axis] = variance;
            put(PLAY, play + tilt * lever * lever + position.trace());
            put(PLAY + 1, play * k::PLAY_RAD_S * k::PLAY_RAD_S);
        }
        self.start_movement(axis, is_back);
        self.take_in_tremor(self.hand.tremor_variance);
        let p = &mut self.covariance;
        p[ROLL][ROLL] = roll;
        p[ROLL + 1][ROLL + 1] = k::START_TURN_RAD_S * k::START_TURN_RAD_S;
        p[ROLL + 2][ROLL + 2] = roll_model(&self.tuning).sigma * roll_model(&self.tuning).sigma;
        for (i, variance) in self.hand.roll_tremor_variance.iter().enumerate() {
            let (first, omega) = (ROLL_TREMOR + 2 * i, roll_tremor_model(i).omega);
            p[first][first] = *variance;
            p[first + 1][first + 1] = variance * omega * omega;
        }
    }

    /// Starts the movement of an instrument that was just put into its trocar. How it was waved about before says nothing of
    /// how it moves now, and has raised the variances. Pose, speed along the shaft, play and roll go on. Further in, it is
    /// the eye that was found again, and nothing changes.
    pub(super) fn start_inside(&mut self) {
        const KEPT: usize = 3 * PLAY;
        let (axis, lever) = self.shaft();
        if lever > k::JUST_PUT_IN_MM {
            return;
        }
        let (tip, along) = (tip_of(&self.vectors), axis * axis.dot(&self.velocity()));
        let (kept, pose) = (self.covariance, self.pose_covariance);
        let fastest = k::START_SPEED_MM_S * k::START_SPEED_MM_S;
        let speed = Directed {
            along: self.variance_of_speed(&axis).min(fastest),
            across: (k::PUT_IN_TURN_RAD_S * lever) * (k::PUT_IN_TURN_RAD_S * lever),
        };
        self.vectors[..PLAY].fill(Vector3::zeros());
        (self.vectors[0], self.vectors[1]) = (tip, along);
        self.voluntary_variance = Directed::even(self.tuning.voluntary_mm_s2 * self.tuning.voluntary_mm_s2);
        self.nis_ratio = 1.0;
        self.covariance = [[0.0; N]; N];
        self.scale_tremor();
        self.start_covariance(&pose, &axis, lever, true);
        self.start_vector(1, &speed.covariance(&axis));
        for (row, kept) in self.covariance[KEPT..].iter_mut().zip(&kept[KEPT..]) {
            row[KEPT..].copy_from_slice(&kept[KEPT..]);
        }
    }

    /// Covariances of the voluntary movement's velocity, acceleration and lags. An instrument that is back was put in, along
    /// its shaft; of one that is found for the first time nothing is known.
    fn start_movement(&mut self, axis: &Vector3<f64>, is_back: bool) {
        let (mut across_mm_s, mut along_mm2_s4) = (k::START_SPEED_MM_S, self.voluntary_variance.along);
        if is_back {
            across_mm_s = k::START_SPEED_ACROSS_MM_S;
            along_mm2_s4 = along_mm2_s4.max(k::START_ACCELERATION_MM_S2 * k::START_ACCELERATION_MM_S2);
        }
        let along = k::START_SPEED_MM_S * k::START_SPEED_MM_S;
        self.start_vector(1, &Directed { along, across: across_mm_s * across_mm_s }.covariance(axis));
        let acceleration = Directed { along: along_mm2_s4, ..self.voluntary_variance }.covariance(axis);
        for (lag, ratio) in VoluntaryMotion::LAG_VARIANCES.iter().enumerate() {
            self.start_vector(2 + lag, &(acceleration * *ratio));
        }
    }

    fn start_vector(&mut self, vector: usize, variance: &Matrix3<f64>) {
        for (row, column) in (0..9).map(|n| (n / 3, n % 3)) {
            self.covariance[3 * vector + row][3 * vector + column] = variance[(row, column)];
        }
    }

    /// Variance of the tip's speed along the shaft, tremor included, mm²/s².
    fn variance_of_speed(&self, axis: &Vector3<f64>) -> f64 {
        let along: Row = std::array::from_fn(|r| axis.dot(&self.tip_and_play(&self.covariance[r])[1]));
        axis.dot(&self.tip_and_play(&along)[1])
    }
}
