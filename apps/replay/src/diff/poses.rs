//! Differences of the poses of two recordings, body by body, and their spectrum.

use super::inputs::{FieldPairs, difference};
use super::side::{BodySeen, FrameSeen, Side};
use super::spectrum::{BANDS, band_rms};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, EYE};
use serde::Serialize;

/// Distance of the eye's wall from its centre, by which a rotation of the eye becomes a displacement, mm.
pub const EYE_WALL_MM: f64 = 12.0;

/// Two tracker frames of one field.
#[derive(Debug, Clone, Copy)]
pub struct FramePair {
    /// Of the first recording.
    pub a: FrameSeen,
    /// Of the second.
    pub b: FrameSeen,
}

/// Differences of a body.
#[derive(Debug, Clone, Default, Serialize)]
pub struct BodyFigures {
    /// Name of the body.
    pub body: &'static str,
    /// Frames in which both measured it.
    pub frames: u64,
    /// Frames in which only one of them did.
    pub measured_by_one: u64,
    /// Distance of the tips, or of points on the eye's wall, µm.
    pub rms_um: f64,
    /// 99 of 100 frames are below, µm.
    pub p99_um: f64,
    /// Largest, µm.
    pub max_um: f64,
    /// Angle between the rotations, mrad.
    pub rms_mrad: f64,
    /// 99 of 100 frames are below, mrad.
    pub p99_mrad: f64,
    /// Largest, mrad.
    pub max_mrad: f64,
    /// When the distance was largest, s from the start.
    pub max_at_s: f64,
    /// Field of that frame in the first recording.
    pub max_field: u64,
    /// Root mean square of the displacement in bands of frequency, µm.
    pub bands_um: [f64; BANDS.len()],
}

/// What became of the frames.
#[derive(Debug, Default, Serialize)]
pub struct PoseFigures {
    /// Frames of one field in both recordings.
    pub frames_compared: u64,
    /// Frames whose bodies are the same to the bit.
    pub identical: u64,
    /// Frames of one recording only.
    pub frames_missing: u64,
    /// Differences, by body.
    pub bodies: Vec<BodyFigures>,
}

/// Pairs the tracker frames of two recordings by field number; also counts those that are alone.
pub fn pair_frames(a: &Side, b: &Side, fields: &FieldPairs) -> (Vec<FramePair>, u64) {
    let (mut pairs, mut alone) = (Vec::with_capacity(a.frames.len()), 0);
    let (mut one, mut other) = (a.frames.iter().peekable(), b.frames.iter().peekable());
    let number = |f: &&FrameSeen| f.field.wrapping_add_signed(fields.number_offset);
    while let (Some(p), Some(q)) = (one.peek(), other.peek()) {
        let order = number(p).cmp(&q.field);
        match order {
            std::cmp::Ordering::Equal => pairs.push(FramePair { a: **p, b: **q }),
            _ => alone += 1,
        }
        if order.is_le() {
            one.next();
        }
        if order.is_ge() {
            other.next();
        }
    }
    let left = one.count() + other.count();
    (pairs, alone + left as u64)
}

/// Displacement of a body, µm in the world: of an instrument's tip; of the eye's wall, as rotation vector
/// times radius.
pub fn displacement_um(body: usize, a: &BodySeen, b: &BodySeen) -> Vector3<f64> {
    match body {
        EYE => rotation_mrad(a, b) * EYE_WALL_MM,
        _ => (Vector3::from(b.position_mm) - Vector3::from(a.position_mm)) * 1e3,
    }
}

/// Rotation from `a` to `b` in the world as a vector, mrad.
fn rotation_mrad(a: &BodySeen, b: &BodySeen) -> Vector3<f64> {
    if a.rotation_wxyz == b.rotation_wxyz {
        return Vector3::zeros();
    }
    let [p, q] = [a, b].map(|body| {
        let [w, x, y, z] = body.rotation_wxyz;
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    });
    (q * p.inverse()).scaled_axis() * 1e3
}

/// True where both recordings measured the body.
pub fn both_measured(pair: &FramePair, body: usize) -> bool {
    let measured = |b: &BodySeen| b.validity == Validity::Measured as u32;
    measured(&pair.a.bodies[body]) && measured(&pair.b.bodies[body])
}

/// Figures of all bodies.
pub fn compare(pairs: &[FramePair], alone: u64, start_ns: u64, period_ns: u64) -> PoseFigures {
    PoseFigures {
        frames_compared: pairs.len() as u64,
        identical: pairs.iter().filter(|p| p.a.digest == p.b.digest).count() as u64,
        frames_missing: alone,
        bodies: (0..BODIES).map(|body| compare_body(pairs, body, start_ns, period_ns)).collect(),
    }
}

fn compare_body(pairs: &[FramePair], body: usize, start_ns: u64, period_ns: u64) -> BodyFigures {
    // Frames that lie farther apart are of two stretches.
    let stretch_ns = period_ns + period_ns / 2;
    let (mut um, mut mrad, mut stretches) = (Vec::new(), Vec::new(), vec![Vec::new()]);
    let mut figures = BodyFigures { body: BODY_NAMES[body], ..BodyFigures::default() };
    let mut last_ns = None;
    for pair in pairs {
        let validities = [&pair.a, &pair.b].map(|f| f.bodies[body].validity == Validity::Measured as u32);
        figures.measured_by_one += u64::from(validities[0] != validities[1]);
        if !both_measured(pair, body) {
            continue;
        }
        let (p, q) = (&pair.a.bodies[body], &pair.b.bodies[body]);
        let moved = displacement_um(body, p, q);
        if last_ns.is_some_and(|last| pair.a.exposed_ns.abs_diff(last) > stretch_ns) {
            stretches.push(Vec::new());
        }
        last_ns = Some(pair.a.exposed_ns);
        stretches.last_mut().expect("one is begun").push(moved);
        if um.is_empty() || moved.norm() > figures.max_um {
            figures.max_um = moved.norm();
            figures.max_at_s = difference(start_ns, pair.a.exposed_ns) as f64 * 1e-9;
            figures.max_field = pair.a.field;
        }
        um.push(moved.norm());
        mrad.push(rotation_mrad(p, q).norm());
    }
    figures.frames = um.len() as u64;
    (figures.rms_um, figures.p99_um, _) = summary(&mut um);
    (figures.rms_mrad, figures.p99_mrad, figures.max_mrad) = summary(&mut mrad);
    if figures.max_um > 0.0 {
        figures.bands_um = band_rms(&stretches, 1e9 / period_ns as f64);
    }
    figures
}

/// Root mean square, 99th percentile and maximum.
fn summary(values: &mut [f64]) -> (f64, f64, f64) {
    values.sort_unstable_by(f64::total_cmp);
    let Some(max) = values.last().copied() else { return (0.0, 0.0, 0.0) };
    let mean = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
    let p99 = values[((values.len() as f64 * 0.99).ceil() as usize).clamp(1, values.len()) - 1];
    (mean.sqrt(), p99, max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_of_sorted_values() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let (rms, p99, max) = summary(&mut values);
        assert_eq!((p99, max), (99.0, 100.0));
        assert!((rms - 3383.5_f64.sqrt()).abs() < 1e-9, "{rms}");
        assert_eq!(summary(&mut []), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_turn_of_the_eye_moves_its_wall() {
        let still = BodySeen { position_mm: [0.0; 3], rotation_wxyz: [1.0, 0.0, 0.0, 0.0], validity: 2 };
        let half = 0.5e-3_f64;
        let turned = BodySeen { rotation_wxyz: [half.cos(), half.sin(), 0.0, 0.0], ..still };
        let moved = displacement_um(EYE, &still, &turned);
        assert!((moved - Vector3::new(12.0, 0.0, 0.0)).norm() < 1e-6, "{moved}");
    }
}
