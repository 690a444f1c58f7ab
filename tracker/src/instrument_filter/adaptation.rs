//! How an instrument's filter adapts its variances to what the hand does.

use super::directed::Directed;
use super::transition::roll_tremor_model;
use super::{Hand, InstrumentFilter, ROLL_TREMOR, TREMOR, tip_of};
use crate::constants as k;
use crate::motion_models::VoluntaryMotion;
use crate::tremor_bank::{self, BANDS};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Normalised innovation squared of an update: of pose and of the tip's place alone.
pub(super) struct Nis {
    pub all: f64,
    pub of_tip: f64,
}

impl InstrumentFilter {
    /// Adapts the variances of the tremor and of the voluntary acceleration: running means over the
    /// axes of the expected squares of their states, E[x²] = x̂² + P.
    ///
    /// A band in which there is no tremor would lose its variance v only as 1/t: most of E[x²] is then P. So the steps of the
    /// bands are longer by 1/(1 − P/v), the share of the band that the blobs determine (MacKay 1992, Bayesian Interpolation), and their
    /// means are multiplied by n/(n + 2), n the degrees of freedom: the most probable v under Jeffreys' prior 1/v.
    pub(super) fn adapt_variances(&mut self, dt: f64) {
        let p = &self.covariance;
        let share = (dt / self.tuning.tremor_learning_s).min(0.2);
        let Hand { mut tremor_variance, mut roll_tremor_variance, lever_mm } = self.hand;
        for ((variance, range), band) in
            tremor_variance.iter_mut().zip(tremor_bank::ranges()).zip(&k::TREMOR_BANDS)
        {
            // Displacement and quadrature: the sums of real and of imaginary parts.
            let parts = [0, 1].map(|part| self.band_moments(&range, part));
            let [square, unknown] = [0, 1].map(|n| 0.5 * (parts[0][n] + parts[1][n]));
            // Three axes, and 2·B·T of each; a running mean is as good as one over twice its time constant.
            let freedom = 3.0 * 2.0 * (band.high_hz - band.low_hz) * 2.0 * self.tuning.tremor_learning_s;
            let now = (square + unknown) * freedom / (freedom + 2.0);
            let known = (1.0 - unknown / *variance).clamp(k::LEAST_KNOWN, 1.0);
            *variance += (share / known).min(0.2) * (now - *variance);
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
        let squares = self.vectors[2] * self.vectors[2].transpose()
            + Matrix3::from_fn(|r, c| self.covariance[6 + r][6 + c]);
        let now = Directed::of(&squares, &self.axis());
        self.voluntary_variance = self.voluntary_variance.zip(now, |variance, now| {
            let adapted = variance + share * (now - variance);
            adapted.clamp(k::VOLUNTARY_RANGE_MM2_S4.0, k::VOLUNTARY_RANGE_MM2_S4.1)
        });
        self.hand = Hand { tremor_variance, roll_tremor_variance, lever_mm };
    }

    /// Square and variance of the sum of the parts (0 real, 1 imaginary) of the pole pairs of a band: mean of the axes.
    fn band_moments(&self, pairs: &Range<usize>, part: usize) -> [f64; 2] {
        let vectors = || pairs.clone().map(|pair| TREMOR + 2 * pair + part);
        let sum: Vector3<f64> = vectors().map(|v| self.vectors[v]).sum();
        let mut variance = 0.0;
        for r in vectors() {
            for c in vectors() {
                variance += (0..3).map(|axis| self.covariance[3 * r + axis][3 * c + axis]).sum::<f64>();
            }
        }
        [sum.norm_squared() / 3.0, variance / 3.0]
    }

    /// Scales the variances of the tremor with the lever, the distance of the tip from the trocar. A hand turns the shaft
    /// about the trocar, so the tip trembles by so much more as it is further in. Where the trocar is unknown, or too near
    /// for a direction, nothing changes.
    pub(super) fn scale_tremor(&mut self) {
        let to_trocar = self.axis().dot(&(self.pivot.position - tip_of(&self.vectors)));
        if !self.pivot.tracked || to_trocar < k::SHORTEST_LEVER_MM {
            return;
        }
        let (_, lever) = self.shaft();
        if self.hand.lever_mm > 0.0 {
            let ratio = (lever / self.hand.lever_mm).clamp(k::LEVER_RATIO.0, k::LEVER_RATIO.1);
            for variance in &mut self.hand.tremor_variance {
                *variance = (*variance * ratio * ratio).clamp(k::TREMOR_RANGE_MM2.0, k::TREMOR_RANGE_MM2.1);
            }
        }
        self.hand.lever_mm = lever;
    }

    /// Where the NIS is too large, once by much or several times in a row, raises the variance of the voluntary
    /// acceleration: the instrument manoeuvres. While the hand is not known yet and the NIS is larger still, and most of
    /// it the tip's, its tremor is wider than expected.
    pub(super) fn adapt_to_nis(&mut self, nis: Nis, expected: f64) {
        let Nis { all: nis, of_tip } = nis;
        self.nis_ratio += self.nis_gain * (nis / expected.max(1.0) - self.nis_ratio);
        let (once, lasting) = k::UNKNOWN_HAND_NIS;
        let is_unknown = self.time_ns < self.hand_known_ns && of_tip > 0.5 * nis;
        if is_unknown && (nis > once || self.nis_ratio > lasting) {
            return self.spread_tremor();
        }
        let ratio = (nis / k::NIS_LIMIT).max(self.nis_ratio / k::NIS_RATIO_LIMIT);
        if ratio > 1.0 {
            let factor = (ratio * ratio).min(10.0);
            let before = self.voluntary_variance;
            self.voluntary_variance = before.map(|v| (v * factor).min(k::VOLUNTARY_RANGE_MM2_S4.1));
            let raised = self.voluntary_variance.zip(before, |after, before| after - before);
            self.inflate_lags(raised.map(|raised| k::MANOEUVRE_SHARE * raised));
        }
    }

    /// Raises the variance of every band to the density of the main one.
    fn spread_tremor(&mut self) {
        let before = self.hand.tremor_variance;
        let width_hz = |band: usize| k::TREMOR_BANDS[band].high_hz - k::TREMOR_BANDS[band].low_hz;
        let density = before[k::MAIN_TREMOR_BAND] / width_hz(k::MAIN_TREMOR_BAND);
        let after: [f64; BANDS] = std::array::from_fn(|band| before[band].max(density * width_hz(band)));
        self.take_in_tremor(std::array::from_fn(|band| after[band] - before[band]));
        self.hand.tremor_variance = after;
        self.renew_cross();
    }

    /// Adds tremor of these variances, of unknown phase, to the states. The tip is as well known as before, and has that
    /// tremor in it: of its voluntary movement is known what the tremor leaves.
    pub(super) fn take_in_tremor(&mut self, variances: [f64; BANDS]) {
        self.add_tremor(variances, |bank, i, j| *bank.stationary(i, j));
        for (range, variance) in tremor_bank::ranges().zip(variances) {
            for (pair, part) in range.clone().flat_map(|pair| [(pair, 0), (pair, 1)]) {
                let with_all: f64 = range.clone().map(|i| self.bank.stationary(i, pair)[0][part]).sum();
                let (with_all, at) = (variance * with_all, 3 * (TREMOR + 2 * pair + part));
                for axis in 0..3 {
                    self.covariance[axis][at + axis] -= with_all;
                    self.covariance[at + axis][axis] -= with_all;
                    self.covariance[axis][axis] += if part == 0 { with_all } else { 0.0 };
                }
            }
        }
    }

    /// Adds a variance of the acceleration, mm²/s⁴, and what belongs to it, to acceleration and lags. New noise enters behind
    /// the last lag, and would take all their time to reach the acceleration.
    fn inflate_lags(&mut self, variance: Directed) {
        let added = variance.covariance(&self.axis());
        for (lag, ratio) in VoluntaryMotion::LAG_VARIANCES.iter().enumerate() {
            let at = 3 * (2 + lag);
            for (r, c) in (0..9).map(|n| (n / 3, n % 3)) {
                self.covariance[at + r][at + c] += ratio * added[(r, c)];
            }
        }
        self.renew_cross();
    }
}
