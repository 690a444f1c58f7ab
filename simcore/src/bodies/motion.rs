//! Integration of free bodies, and the velocities that follow from their corrected poses. Contacts
//! do not bounce.

use super::solve::SolverParams;
use super::state::BodyState;
use nalgebra::{UnitQuaternion, Vector3};

/// Fastest a body moves, mm/s: what would be faster was thrown out of an overlap, not pushed.
pub const MAX_SPEED_MM_S: f64 = 200.0;
/// Fastest a body turns, rad/s.
pub const MAX_SPIN_RAD_S: f64 = 200.0;

/// A rotation after a small turn, eye frame, rad: first order, normalised; no transcendental
/// functions.
pub(super) fn turned(rotation: &UnitQuaternion<f64>, turn: &Vector3<f64>) -> UnitQuaternion<f64> {
    let small = nalgebra::Quaternion::from_parts(0.0, turn * 0.5);
    UnitQuaternion::new_normalize(rotation.into_inner() + small * rotation.into_inner())
}

/// Weight and damping change the velocities, the velocities the pose.
pub(super) fn integrate(body: &mut BodyState, params: &SolverParams) {
    // Implicit damping: stable for any constant.
    let keep = 1.0 / (1.0 + params.damping_per_s * params.dt_s);
    body.velocity_mm_s = (body.velocity_mm_s + params.weight_mm_s2 * params.dt_s) * keep;
    body.angular_velocity_rad_s *= keep;
    body.eye_from_body.translation.vector += body.velocity_mm_s * params.dt_s;
    body.eye_from_body.rotation =
        turned(&body.eye_from_body.rotation, &(body.angular_velocity_rad_s * params.dt_s));
}

/// The velocities that lead from `before` to where the body is now, within their limits; `false`
/// for a body whose numbers ran away.
pub(super) fn update_velocity(body: &mut BodyState, before: &BodyState, dt_s: f64) -> bool {
    let way = body.eye_from_body.translation.vector - before.eye_from_body.translation.vector;
    let turn = body.eye_from_body.rotation * before.eye_from_body.rotation.inverse();
    let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
    body.velocity_mm_s = within(way / dt_s, MAX_SPEED_MM_S);
    body.angular_velocity_rad_s = within(turn.imag() * (sign / dt_s), MAX_SPIN_RAD_S);
    body.is_sound()
}

/// A body whose numbers ran away stays where it was, at rest; where that is no place either, it
/// goes to where it began.
pub(super) fn reset(body: &mut BodyState, before: &BodyState, begin: &BodyState) {
    *body =
        BodyState { velocity_mm_s: Vector3::zeros(), angular_velocity_rad_s: Vector3::zeros(), ..*before };
    if !body.is_sound() {
        *body = *begin;
    }
}

fn within(v: Vector3<f64>, most: f64) -> Vector3<f64> {
    let size = v.norm();
    if size > most { v * (most / size) } else { v }
}
