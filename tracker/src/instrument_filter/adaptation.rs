//! How an instrument's filter adapts its variances to what the hand does.

use super::transition::roll_tremor_model;
use super::{Hand, InstrumentFilter, ROLL_TREMOR, TREMOR};
use crate::constants as k;
use crate::tremor_bank;
use nalgebra::Vector3;
use std::ops::Range;

impl InstrumentFilter {
    /// Adapts the variances of the tremor and of the voluntary acceleration: running means over the
    /// axes of the expected squares of their states, E[x²] = x̂² + P.
    pub(super) fn adapt_variances(&mut self, dt: f64) {
        let p = &self.covariance;
        let square = |vector: usize| {
            let state = self.vectors[vector].norm_squared();
            let variance: f64 = (0..3).map(|axis| p[3 * vector + axis][3 * vector + axis]).sum();
            (state + variance) / 3.0
        };
        let share = (dt / self.tuning.tremor_learning_s).min(0.2);
        let Hand { mut tremor_variance, mut roll_tremor_variance } = self.hand;
        for (variance, range) in tremor_variance.iter_mut().zip(tremor_bank::ranges()) {
            // Displacement and quadrature: the sums of real and of imaginary parts.
            let now = 0.5 * (self.band_square(&range, 0) + self.band_square(&range, 1));
            *variance += share * (now - *variance);
            *variance = variance.clamp(k::TREMOR_RANGE_MM2.0, k::TREMOR_RANGE_MM2.1);
        }
        for (i, variance) in roll_tremor_variance.iter_mut().enumerate() {
            let (first, omega) = (ROLL_TREMOR + 2 * i, roll_tremor_model(i).omega);
            let [x, rate] = self.roll_tremor[i];
            let angle = x * x + p[first][first];
            let now = 0.5 * (angle + (rate * rate + p[first + 1][first + 1]) / (omega * omega));
            *variance += share * (now - *variance);
            *variance = variance.clamp(k::ROLL_TREMOR_RANGE_RAD2.0, k::ROLL_TREMOR_RANGE_RAD2.1);
        }
        let share = (dt / self.tuning.voluntary_learning_s).min(0.2);
        let voluntary = self.voluntary_variance + share * (square(2) - self.voluntary_variance);
        self.hand = Hand { tremor_variance, roll_tremor_variance };
        self.voluntary_variance = voluntary.clamp(k::VOLUNTARY_RANGE_MM2_S4.0, k::VOLUNTARY_RANGE_MM2_S4.1);
    }

    /// Expected square of the sum of the parts (0 real, 1 imaginary) of the pole pairs of a band: mean of the axes.
    fn band_square(&self, pairs: &Range<usize>, part: usize) -> f64 {
        let vectors = || pairs.clone().map(|pair| TREMOR + 2 * pair + part);
        let sum: Vector3<f64> = vectors().map(|v| self.vectors[v]).sum();
        let mut square = sum.norm_squared();
        for r in vectors() {
            for c in vectors() {
                square += (0..3).map(|axis| self.covariance[3 * r + axis][3 * c + axis]).sum::<f64>();
            }
        }
        square / 3.0
    }

    /// Raises the variance of the voluntary acceleration where the NIS is too large, once by much
    /// or several times in a row: the instrument manoeuvres.
    pub(super) fn adapt_to_nis(&mut self, nis: f64, expected: f64) {
        self.nis_ratio += self.nis_gain * (nis / expected.max(1.0) - self.nis_ratio);
        let ratio = (nis / k::NIS_LIMIT).max(self.nis_ratio / k::NIS_RATIO_LIMIT);
        if ratio > 1.0 {
            let factor = (ratio * ratio).min(10.0);
            self.voluntary_variance = (self.voluntary_variance * factor).min(k::VOLUNTARY_RANGE_MM2_S4.1);
        }
    }
}
