//! What the hand will do next: a bank of linear models of the tip's motion, the best of which is
//! published for `protocol::predict`.
//!
//! Each model is smooth motion (position, velocity, a Singer acceleration) plus at most one damped
//! oscillator of a fixed frequency, the tremor; a Kalman filter on the measured tips, the same for
//! all three axes. A tremor's frequency differs from hand to hand and drifts, so every model keeps
//! what it foretold for [`HORIZON_NS`] later, and the one whose foresights were the nearest of late
//! speaks. A model without oscillator is among them: where there is no tremor, none is invented.

use crate::filter::Singer;
use nalgebra::{SMatrix, SVector, Vector3};
use protocol::poses::{Oscillator, Predictor};

/// States: smooth position, velocity, acceleration; oscillator's displacement, velocity.
const STATES: usize = 5;
type Square = SMatrix<f64, STATES, STATES>;

/// Frequencies of tremor tried, Hz; physiological tremor lies between 6 and 14 Hz.
const FREQUENCIES_HZ: [f64; 8] = [7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0];
/// Standard deviations of the smooth acceleration tried, mm/s²: a held and a working hand.
const SMOOTH_MM_S2: [f64; 2] = [4.0, 12.0];
/// Models in the bank.
const MODELS: usize = FREQUENCIES_HZ.len() * SMOOTH_MM_S2.len() + SMOOTH_MM_S2.len();
/// Time constant of the smooth acceleration, s.
const SMOOTH_TAU_S: f64 = 0.3;
/// Damping ratio of the tremor.
const DAMPING: f64 = 0.02;
/// Spectral density of the noise that drives it, (mm/s²)²·s.
const TREMOR_DRIVE: f64 = 100.0;
/// Noise of a measured tip, mm, for models with an oscillator.
const TIP_NOISE_MM: f64 = 0.004;
/// For models without one, the tremor is noise.
const TREMOR_NOISE_MM: f64 = 0.05;
/// How far ahead the models are judged, ns: three fields, a pose's age on the screen.
const HORIZON_NS: u64 = 60_000_000;
/// A foresight is compared with a measurement that comes within this of its instant, ns.
const NEAR_NS: u64 = 3_000_000;
/// Share of the newest comparison in a model's mean squared error.
const FORGETTING: f64 = 0.04;
/// A gap after which the bank begins anew, ns.
const GAP_NS: u64 = 100_000_000;
/// Foresights under way at once.
const PENDING: usize = 4;

/// One model.
#[derive(Debug, Clone, Copy)]
struct Model {
    smooth: Singer,
    omega: f64,
    noise_mm: f64,
    state: [Vector3<f64>; STATES],
    covariance: Square,
    foreseen: [(u64, Vector3<f64>); PENDING],
    squared_error: f64,
}

/// The bank of one instrument.
#[derive(Debug, Clone)]
pub struct MotionBank {
    models: [Model; MODELS],
    time_ns: u64,
}

impl Default for MotionBank {
    fn default() -> Self {
        let model = |i: usize| {
            let sigma = SMOOTH_MM_S2[i % SMOOTH_MM_S2.len()];
            let hz = FREQUENCIES_HZ.get(i / SMOOTH_MM_S2.len()).copied().unwrap_or(0.0);
            Model::new(sigma, 2.0 * std::f64::consts::PI * hz)
        };
        MotionBank { models: std::array::from_fn(model), time_ns: 0 }
    }
}

impl MotionBank {
    /// A tip was measured.
    pub fn measure(&mut self, tip: &Vector3<f64>, time_ns: u64) {
        if self.time_ns == 0 || time_ns <= self.time_ns || time_ns - self.time_ns > GAP_NS {
            *self = MotionBank::default();
            for model in &mut self.models {
                model.state[0] = *tip;
            }
        } else {
            let dt = (time_ns - self.time_ns) as f64 * 1e-9;
            for model in &mut self.models {
                model.advance(dt);
            }
        }
        self.time_ns = time_ns;
        for model in &mut self.models {
            model.judge(tip, time_ns);
            model.update(tip);
            model.foresee(tip, time_ns);
        }
    }

    /// Writes the best model's state at `time_ns` into `predictor`; false where there is none.
    pub fn publish(&self, time_ns: u64, predictor: &mut Predictor) -> bool {
        if self.time_ns == 0 || time_ns.abs_diff(self.time_ns) > GAP_NS {
            return false;
        }
        let better = |a: &&Model, b: &&Model| a.squared_error.total_cmp(&b.squared_error);
        let Some(best) = self.models.iter().min_by(better) else { return false };
        let mut model = *best;
        model.advance_mean(time_ns.saturating_sub(self.time_ns) as f64 * 1e-9);
        let [_, velocity, acceleration, shake, shake_velocity] = model.state.map(Into::into);
        predictor.velocity_mm_s = velocity;
        predictor.acceleration_mm_s2 = acceleration;
        predictor.acceleration_tau_s = SMOOTH_TAU_S;
        if model.omega > 0.0 {
            predictor.oscillators[0] = Oscillator {
                omega_rad_s: model.omega,
                damping: DAMPING,
                position_mm: shake,
                velocity_mm_s: shake_velocity,
            };
        }
        true
    }
}

impl Model {
    fn new(smooth_sigma: f64, omega: f64) -> Self {
        let shaking = if omega > 0.0 { 1.0 } else { 0.0 };
        let start = SVector::<f64, STATES>::from([1e-4, 100.0, 1e4, 1e-2 * shaking, 10.0 * shaking]);
        Model {
            smooth: Singer { sigma: smooth_sigma, tau_s: SMOOTH_TAU_S },
            omega,
            noise_mm: if omega > 0.0 { TIP_NOISE_MM } else { TREMOR_NOISE_MM },
            state: [Vector3::zeros(); STATES],
            covariance: Square::from_diagonal(&start),
            foreseen: [(0, Vector3::zeros()); PENDING],
            // The first word belongs to the calmest model, until a better one has shown itself.
            squared_error: if omega > 0.0 { 0.3 } else { 0.1 },
        }
    }

    /// The oscillator's transition: displacement and velocity by displacement and velocity.
    fn shake(&self, dt: f64) -> [[f64; 2]; 2] {
        if self.omega <= 0.0 {
            return [[0.0; 2]; 2];
        }
        let (w, z) = (self.omega, DAMPING);
        let wd = w * libm::sqrt(1.0 - z * z);
        let (sin, cos, decay) = (libm::sin(wd * dt), libm::cos(wd * dt), libm::exp(-z * w * dt));
        let ratio = z * w / wd * sin;
        [[decay * (cos + ratio), decay * sin / wd], [-decay * sin * w * w / wd, decay * (cos - ratio)]]
    }

    fn transition(&self, dt: f64) -> Square {
        let t = self.smooth.transition(dt);
        let s = self.shake(dt);
        let mut f = Square::identity();
        (f[(0, 1)], f[(0, 2)], f[(1, 2)], f[(2, 2)]) = (t.dt, t.h, t.g, t.e);
        (f[(3, 3)], f[(3, 4)], f[(4, 3)], f[(4, 4)]) = (s[0][0], s[0][1], s[1][0], s[1][1]);
        f
    }

    fn advance_mean(&mut self, dt: f64) {
        let f = self.transition(dt);
        let old = self.state;
        for (r, out) in self.state.iter_mut().enumerate() {
            *out = (0..STATES).fold(Vector3::zeros(), |sum, c| sum + old[c] * f[(r, c)]);
        }
    }

    fn advance(&mut self, dt: f64) {
        self.advance_mean(dt);
        let f = self.transition(dt);
        self.covariance = f * self.covariance * f.transpose();
        let [q11, q12, q13, q22, q23, q33] = self.smooth.noise(dt);
        for (r, c, q) in [(0, 0, q11), (0, 1, q12), (0, 2, q13), (1, 1, q22), (1, 2, q23), (2, 2, q33)] {
            self.covariance[(r, c)] += q;
            if r != c {
                self.covariance[(c, r)] += q;
            }
        }
        if self.omega > 0.0 {
            // ∫ of (sin ωs/ω, cos ωs) squared: white noise through an undamped oscillator.
            let (w, wt) = (self.omega, self.omega * dt);
            let (double, sin) = (libm::sin(2.0 * wt) / (2.0 * w), libm::sin(wt));
            let cross = TREMOR_DRIVE * sin * sin / (2.0 * w * w);
            self.covariance[(3, 3)] += TREMOR_DRIVE * (dt - double) / (2.0 * w * w);
            self.covariance[(4, 4)] += TREMOR_DRIVE * (dt + double) / 2.0;
            self.covariance[(3, 4)] += cross;
            self.covariance[(4, 3)] += cross;
        }
    }

    /// The tip is the sum of smooth position and displacement.
    fn update(&mut self, tip: &Vector3<f64>) {
        let p = &self.covariance;
        let towards = SVector::<f64, STATES>::from_fn(|r, _| p[(r, 0)] + p[(r, 3)]);
        let variance = towards[0] + towards[3] + self.noise_mm * self.noise_mm;
        let innovation = tip - self.state[0] - self.state[3];
        let gain = towards / variance;
        for (x, g) in self.state.iter_mut().zip(gain.iter()) {
            *x += innovation * *g;
        }
        let after = p - gain * towards.transpose();
        self.covariance = (after + after.transpose()) * 0.5;
    }

    fn judge(&mut self, tip: &Vector3<f64>, time_ns: u64) {
        for (at_ns, foreseen) in &mut self.foreseen {
            if *at_ns > 0 && at_ns.abs_diff(time_ns) <= NEAR_NS {
                let error = (tip - *foreseen).norm_squared();
                self.squared_error += FORGETTING * (error - self.squared_error);
                *at_ns = 0;
            }
        }
    }

    fn foresee(&mut self, tip: &Vector3<f64>, time_ns: u64) {
        let mut ahead = *self;
        ahead.advance_mean(HORIZON_NS as f64 * 1e-9);
        let moved = ahead.state[0] + ahead.state[3] - self.state[0] - self.state[3];
        let oldest = self.foreseen.iter_mut().min_by_key(|(at_ns, _)| *at_ns);
        *oldest.expect("a bank looks ahead") = (time_ns + HORIZON_NS, tip + moved);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::geometry::{Pose, Validity};
    use protocol::poses::BodyState;
    use protocol::predict::predict_body;

    /// RMS error of a prediction 55 ms ahead of a moving tip, µm.
    fn rms_um(tip: impl Fn(f64) -> Vector3<f64>) -> f64 {
        let mut bank = MotionBank::default();
        let mut sum = 0.0;
        for k in 1..=300u64 {
            let t = k as f64 * 0.02;
            bank.measure(&tip(t), k * 20_000_000);
            let mut body = BodyState::zeroed();
            body.world_from_body = Pose { position_mm: tip(t).into(), ..Pose::IDENTITY };
            body.validity = Validity::Measured as u32;
            assert!(bank.publish(k * 20_000_000, &mut body.predictor));
            if k > 100 {
                let ahead = Vector3::from(predict_body(&body, 0.055).world_from_body.position_mm);
                sum += (ahead - tip(t + 0.055)).norm_squared();
            }
        }
        (sum / 200.0_f64).sqrt() * 1e3
    }

    #[test]
    fn tremor_of_any_frequency_is_foreseen() {
        for hz in [7.5, 9.3, 11.8] {
            let w = 2.0 * std::f64::consts::PI * hz;
            let tip = |t: f64| Vector3::new(0.08 * (w * t).sin(), 2.0 * t, 0.05 * (w * t).cos());
            let held = 0.094 * 1e3;
            assert!(rms_um(tip) < 0.35 * held, "{hz} Hz: {}", rms_um(tip));
        }
    }

    #[test]
    fn a_still_tip_stays_and_a_steady_one_goes_on() {
        assert!(rms_um(|_| Vector3::new(1.0, 2.0, 3.0)) < 1e-3);
        assert!(rms_um(|t| Vector3::new(5.0 * t, -3.0 * t, 1.0)) < 1.0);
    }

    #[test]
    fn a_gap_begins_anew() {
        let mut bank = MotionBank::default();
        for k in 1..50u64 {
            bank.measure(&Vector3::new(k as f64, 0.0, 0.0), k * 20_000_000);
        }
        bank.measure(&Vector3::new(7.0, 0.0, 0.0), 5_000_000_000);
        let mut predictor = Predictor::zeroed();
        assert!(bank.publish(5_000_000_000, &mut predictor));
        assert!(Vector3::from(predictor.velocity_mm_s).norm() < 1e-6, "{:?}", predictor.velocity_mm_s);
        assert!(!bank.publish(6_000_000_000, &mut predictor));
    }
}
