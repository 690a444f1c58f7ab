//! Adaptive linear prediction of a tip by recursive least squares (RLS).
//!
//! With d_k the steps of the tip from field to field, the displacement over the next h fields is
//! predicted as Σ w_h,k·d_k over the last L steps, with the same weights for the three axes. The
//! weights minimise the squared errors of past predictions, older fields counting less (Haykin,
//! Adaptive Filter Theory, RLS). Initial weights are the least-squares ones of a typical motion:
//! voluntary movement, a flat tremor between 6 and 14 Hz, noise. The gain depends on the steps
//! alone, so one inverse serves all horizons.

use crate::motion_models::VoluntaryMotion;
use nalgebra::{SMatrix, SVector, Vector3};

/// Number of horizons: 1 to 4 fields, 20 to 80 ms.
pub const HORIZONS: usize = 4;

/// Forgetting factor per field.
const FORGETTING: f64 = 0.995;
/// Weight of the typical motion, in fields.
const PRIOR_FIELDS: f64 = 20.0;
/// Largest trace of the inverse correlation, over its initial trace: without excitation, forgetting
/// alone would wind the inverse up.
const WIND_UP: f64 = 1e4;

/// Voluntary movement of the typical motion.
const TYPICAL_VOLUNTARY: VoluntaryMotion = VoluntaryMotion { sigma: 15.0, tau_s: 0.3 };
/// Standard deviation of its tremor per axis, mm.
const TYPICAL_TREMOR_MM: f64 = 0.02;
/// Standard deviation of the noise of a measured tip per axis, mm.
const TYPICAL_NOISE_MM: f64 = 0.003;
/// Band of its tremor, Hz.
const BAND_HZ: (f64, f64) = (6.0, 14.0);

/// Adaptive weights of the last `L` steps.
#[derive(Debug, Clone, PartialEq)]
pub struct RlsPredictor<const L: usize> {
    inverse: SMatrix<f64, L, L>,
    weights: [SVector<f64, L>; HORIZONS],
    /// Gains and steps of the last fields, newest first, until the displacements they predict are
    /// measured.
    pending: [PendingUpdate<L>; HORIZONS],
    start_trace: f64,
}

/// Gain and steps of a field, per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PendingUpdate<const L: usize> {
    gains: [SVector<f64, L>; 3],
    steps: [SVector<f64, L>; 3],
}

impl<const L: usize> PendingUpdate<L> {
    const NONE: Self = PendingUpdate { gains: [Self::ZERO; 3], steps: [Self::ZERO; 3] };
    const ZERO: SVector<f64, L> =
        SVector::<f64, L>::from_array_storage(nalgebra::ArrayStorage([[0.0; L]; 1]));
}

impl<const L: usize> RlsPredictor<L> {
    /// Starts with the weights of the typical motion, sampled every `period_s`.
    pub fn new(period_s: f64) -> Self {
        let covariance = typical_autocovariance(L + HORIZONS, period_s);
        // Steps are differences of neighbours: cov(d_i, d_j) = 2·c(i−j) − c(i−j+1) − c(i−j−1).
        let c = |n: i64| covariance[n.unsigned_abs() as usize];
        let steps = SMatrix::<f64, L, L>::from_fn(|i, j| {
            let n = i as i64 - j as i64;
            2.0 * c(n) - c(n + 1) - c(n - 1)
        });
        // The displacement over h fields, x(h) − x(0), with d_k = x(−k) − x(−k−1).
        let ahead = |h: i64| {
            SVector::<f64, L>::from_fn(|k, _| {
                let k = k as i64;
                c(h + k) - c(h + k + 1) - c(k) + c(k + 1)
            })
        };
        let inverse = steps.cholesky().map_or_else(SMatrix::identity, |s| s.inverse());
        let weights = std::array::from_fn(|h| inverse * ahead(h as i64 + 1));
        let inverse = inverse / PRIOR_FIELDS;
        RlsPredictor {
            inverse,
            weights,
            pending: [PendingUpdate::NONE; HORIZONS],
            start_trace: inverse.trace(),
        }
    }

    /// Updates the weights with a field: `steps` are the last steps, newest first, `moved` the
    /// displacement over the last 1, 2 … fields, where both ends were measured.
    pub fn update(&mut self, steps: &[Vector3<f64>; L], moved: &[Option<Vector3<f64>>; HORIZONS]) {
        for (h, moved) in moved.iter().enumerate() {
            let Some(moved) = moved else { continue };
            let update = &self.pending[h];
            let weights = &mut self.weights[h];
            for ((moved, steps), gain) in moved.iter().zip(&update.steps).zip(&update.gains) {
                let error = moved - steps.dot(weights);
                *weights += gain * error;
            }
        }
        if self.inverse.trace() < WIND_UP * self.start_trace {
            self.inverse /= FORGETTING;
        }
        let mut update = PendingUpdate::NONE;
        for (axis, (gains, seen_steps)) in update.gains.iter_mut().zip(&mut update.steps).enumerate() {
            let seen = SVector::<f64, L>::from_iterator(steps.iter().map(|step| step[axis]));
            let projected = self.inverse * seen;
            let gain = projected / (1.0 + seen.dot(&projected));
            self.inverse.ger(-1.0, &gain, &projected, 1.0);
            (*gains, *seen_steps) = (gain, seen);
        }
        self.pending.rotate_right(1);
        self.pending[0] = update;
    }

    /// Drops the pending updates; the weights are kept.
    pub fn interrupt(&mut self) {
        self.pending = [PendingUpdate::NONE; HORIZONS];
    }

    /// Predicted displacements over the next 1, 2 … fields.
    pub fn predict(&self, steps: &[Vector3<f64>; L]) -> [Vector3<f64>; HORIZONS] {
        self.weights.map(|weights| {
            steps.iter().zip(weights.iter()).fold(Vector3::zeros(), |sum, (step, w)| sum + step * *w)
        })
    }
}

/// Autocovariance of the typical motion at lags of 0, 1 … `lags` fields, mm², up to a constant that
/// cancels in differences: ∫ S(f)·(cos 2πfτ − 1) df of its spectrum.
fn typical_autocovariance(lags: usize, period_s: f64) -> [f64; 40] {
    const STEP_HZ: f64 = 0.02;
    let (voluntary, tremor, noise) = (TYPICAL_VOLUNTARY, TYPICAL_TREMOR_MM, TYPICAL_NOISE_MM);
    let mut covariance = [0.0; 40];
    for n in 1..1250 {
        let f = f64::from(n) * STEP_HZ;
        let w = 2.0 * std::f64::consts::PI * f;
        let lag = 1.0 + (w * voluntary.tau_s) * (w * voluntary.tau_s);
        let voluntary_psd =
            voluntary.sigma * voluntary.sigma * 4.0 * voluntary.tau_s / (lag * lag) / (w * w * w * w);
        let tremor_psd =
            if f >= BAND_HZ.0 && f <= BAND_HZ.1 { tremor * tremor / (BAND_HZ.1 - BAND_HZ.0) } else { 0.0 };
        for (lag, value) in covariance.iter_mut().enumerate().take(lags + 1) {
            *value += (voluntary_psd + tremor_psd) * STEP_HZ * (libm::cos(w * lag as f64 * period_s) - 1.0);
        }
    }
    covariance[0] += noise * noise;
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_is_predicted_after_a_while() {
        let mut predictor = RlsPredictor::<8>::new(0.02);
        let tip = |n: i64| {
            let t = n as f64 * 0.02;
            Vector3::new((58.0 * t).sin(), 0.7 * (58.0 * t).cos(), 0.3 * (58.0 * t + 1.0).sin()) * 0.05
        };
        let steps = |n: i64| std::array::from_fn(|k| tip(n - k as i64) - tip(n - k as i64 - 1));
        for n in 10..300 {
            predictor.update(&steps(n), &std::array::from_fn(|h| Some(tip(n) - tip(n - h as i64 - 1))));
        }
        for (h, ahead) in predictor.predict(&steps(300)).iter().enumerate() {
            let truth = tip(301 + h as i64) - tip(300);
            assert!((ahead - truth).norm() < 1e-3, "{h}: {ahead} {truth}");
        }
    }

    #[test]
    fn no_excitation_winds_nothing_up() {
        let mut predictor = RlsPredictor::<8>::new(0.02);
        let still = [Vector3::zeros(); 8];
        for _ in 0..20_000 {
            predictor.update(&still, &[Some(Vector3::zeros()); HORIZONS]);
        }
        assert!(predictor.inverse.iter().all(|v| v.is_finite()));
        assert!(predictor.predict(&[Vector3::new(0.01, 0.0, 0.0); 8]).iter().all(|d| d.norm() < 0.2));
    }
}
