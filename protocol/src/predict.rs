//! The only predictor: carries a tracked body to another instant.
//!
//! Smooth motion: the acceleration dies out with time constant τa and the velocity with τv, so
//! that for Δ = t − t₀ the displacement is v·g(Δ, τv) + a·h(Δ, τa), with g = τ(1 − e^(−Δ/τ)) and
//! h = τ(Δ − g(Δ, τ)), the integrals of an exponentially correlated velocity and acceleration
//! (Singer 1970). On top of it come free damped oscillators in closed form (the tremor). The
//! rotation turns by ω·g(Δ, τv) about ω. Deterministic: transcendental functions come from `libm`.

use crate::geometry::{Pose, Validity};
use crate::poses::{BodyState, Oscillator, TrackerFrame};
use crate::time::Nanos;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Longest extrapolation that is still a prediction, s. Beyond it the motion is held.
pub const MAX_HORIZON_S: f64 = 0.25;

/// Bound of the exponents. Going back in time undoes a decay; a short time constant would
/// otherwise turn a look back of 0.25 s into an overflow.
const MAX_EXPONENT: f64 = 3.0;

/// A body at an instant that was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// `world_from_body`.
    pub world_from_body: Pose,
    /// `Measured` only if the instant asked for is that of the measurement.
    pub validity: Validity,
}

/// Body `body` of `frame` at `at_ns`.
pub fn predict(frame: &TrackerFrame, body: usize, at_ns: Nanos) -> Predicted {
    let state = &frame.bodies[body];
    let ahead_s = at_ns.wrapping_sub(frame.instants.exposed) as i64 as f64 * 1e-9;
    predict_body(state, ahead_s)
}

/// `state` carried by `ahead_s` seconds (negative: back), limited to ±[`MAX_HORIZON_S`].
pub fn predict_body(state: &BodyState, ahead_s: f64) -> Predicted {
    let validity = state.validity();
    if validity == Validity::Lost || ahead_s == 0.0 {
        return Predicted { world_from_body: state.world_from_body, validity };
    }
    let dt = ahead_s.clamp(-MAX_HORIZON_S, MAX_HORIZON_S);
    let motion = &state.predictor;
    let start = state.world_from_body.isometry();
    let v_time = decaying_integral(dt, motion.velocity_tau_s);
    let mut shift = Vector3::from(motion.velocity_mm_s) * v_time;
    if motion.acceleration_tau_s > 0.0 {
        let tau = motion.acceleration_tau_s;
        shift += Vector3::from(motion.acceleration_mm_s2) * (tau * (dt - decaying_integral(dt, tau)));
    }
    for oscillator in &motion.oscillators {
        shift += oscillator_shift(oscillator, dt);
    }
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(motion.angular_velocity_rad_s) * v_time);
    let moved =
        Isometry3::from_parts(Translation3::from(start.translation.vector + shift), turn * start.rotation);
    let world_from_body = Pose::from_isometry(&moved);
    if !world_from_body.is_valid() {
        // Finite numbers of a state can still lead nowhere.
        return Predicted { world_from_body: state.world_from_body, validity: Validity::Lost };
    }
    Predicted { world_from_body, validity: Validity::Predicted }
}

/// ∫₀^dt e^(−s/τ) ds; `tau` 0 means no decay.
fn decaying_integral(dt: f64, tau: f64) -> f64 {
    if tau > 0.0 { tau * (1.0 - libm::exp((-dt / tau).min(MAX_EXPONENT))) } else { dt }
}

/// Displacement of a free damped oscillator after `dt`, less its displacement now.
fn oscillator_shift(o: &Oscillator, dt: f64) -> Vector3<f64> {
    if o.omega_rad_s <= 0.0 {
        return Vector3::zeros();
    }
    let zeta = o.damping.clamp(0.0, 0.999);
    let damped = o.omega_rad_s * libm::sqrt(1.0 - zeta * zeta);
    let decay = libm::exp((-zeta * o.omega_rad_s * dt).min(MAX_EXPONENT));
    let (sin, cos) = (libm::sin(damped * dt), libm::cos(damped * dt));
    let (x0, v0) = (Vector3::from(o.position_mm), Vector3::from(o.velocity_mm_s));
    let quadrature = (v0 + x0 * (zeta * o.omega_rad_s)) / damped;
    (x0 * cos + quadrature * sin) * decay - x0
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn still() -> BodyState {
        let mut body = BodyState::zeroed();
        body.world_from_body = Pose::IDENTITY;
        body.validity = Validity::Measured as u32;
        body
    }

    #[test]
    fn constant_velocity_is_exact() {
        let mut body = still();
        body.predictor.velocity_mm_s = [10.0, -5.0, 0.0];
        let p = predict_body(&body, 0.04).world_from_body.position_mm;
        assert!((p[0] - 0.4).abs() < 1e-12 && (p[1] + 0.2).abs() < 1e-12);
    }

    #[test]
    fn undamped_oscillator_returns_after_a_period() {
        let mut body = still();
        let omega = 2.0 * std::f64::consts::PI * 9.0;
        body.predictor.oscillators[0] = Oscillator {
            omega_rad_s: omega,
            damping: 0.0,
            position_mm: [0.05, 0.0, 0.0],
            velocity_mm_s: [0.0, 2.0, 0.0],
        };
        let full = predict_body(&body, 1.0 / 9.0).world_from_body.position_mm;
        assert!(full.iter().all(|c| c.abs() < 1e-9), "{full:?}");
        let half = predict_body(&body, 0.5 / 9.0).world_from_body.position_mm;
        assert!((half[0] + 0.1).abs() < 1e-9, "{half:?}");
    }

    #[test]
    fn a_motion_that_leads_nowhere_is_lost_where_it_was() {
        for (velocity, turn) in [(1e300, 0.0), (f64::MAX, 0.0), (0.0, 1e300), (-1e8, f64::MAX)] {
            let mut body = still();
            body.predictor.velocity_mm_s = [velocity, 0.0, velocity];
            body.predictor.angular_velocity_rad_s = [turn, turn, 0.0];
            for ahead_s in [0.06, -0.2, 1e9] {
                let p = predict_body(&body, ahead_s);
                assert!(p.world_from_body.is_valid(), "{velocity} {turn} {ahead_s}: {p:?}");
            }
        }
        let mut body = still();
        body.predictor.velocity_mm_s = [1e300, 0.0, 0.0];
        let p = predict_body(&body, 0.06);
        assert_eq!((p.validity, p.world_from_body), (Validity::Lost, Pose::IDENTITY));
    }

    #[test]
    fn lost_bodies_stay_where_they_were() {
        let mut body = still();
        body.validity = Validity::Lost as u32;
        body.predictor.velocity_mm_s = [10.0, 0.0, 0.0];
        let p = predict_body(&body, 0.04);
        assert_eq!((p.validity, p.world_from_body), (Validity::Lost, Pose::IDENTITY));
    }
}
