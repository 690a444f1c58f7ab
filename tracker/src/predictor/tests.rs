//! Tests of the prediction of a tip.

use super::*;
use crate::adverse::{Adverse, STEPS, Seen};
use bytemuck::Zeroable;
use protocol::geometry::{Pose, Validity};
use protocol::poses::BodyState;
use protocol::predict::predict_body;

/// RMS error of a prediction 55 ms ahead of a moving tip, µm.
fn rms_um(tip: impl Fn(f64) -> Vector3<f64>) -> f64 {
    let mut predictor = TipPredictor::default();
    let mut sum = 0.0;
    for k in 1..=300u64 {
        let t = k as f64 * 0.02;
        let mut body = BodyState::zeroed();
        body.world_from_body = Pose { position_mm: tip(t).into(), ..Pose::IDENTITY };
        body.validity = Validity::Measured as u32;
        predictor.observe(k * FIELD_PERIOD_NS, FIELD_PERIOD_NS, true, |dt| tip(t + dt));
        predictor.write_to(k * FIELD_PERIOD_NS, |dt| tip(t + dt.min(0.0)), &mut body.predictor);
        if k > 100 {
            let ahead = Vector3::from(predict_body(&body, 0.055).world_from_body.position_mm);
            sum += (ahead - tip(t + 0.055)).norm_squared();
        }
    }
    (sum / 200.0_f64).sqrt() * 1e3
}

#[test]
fn tremor_of_any_frequency_is_predicted() {
    for hz in [6.5, 7.5, 9.3, 11.8, 13.0] {
        let w = 2.0 * std::f64::consts::PI * hz;
        let tip = |t: f64| Vector3::new(0.08 * (w * t).sin(), 2.0 * t, 0.05 * (w * t).cos());
        let held_um = 0.094 * 1e3;
        assert!(rms_um(tip) < 0.06 * held_um, "{hz} Hz: {}", rms_um(tip));
    }
}

#[test]
fn a_still_tip_stays_and_a_steady_one_goes_on() {
    assert!(rms_um(|_| Vector3::new(1.0, 2.0, 3.0)) < 1e-3);
    assert!(rms_um(|t| Vector3::new(5.0 * t, -3.0 * t, 1.0)) < 1.0);
}

#[test]
fn a_gap_starts_a_new_sequence_and_keeps_the_weights() {
    let mut predictor = TipPredictor::default();
    let tip = |t: f64| Vector3::new(0.1 * (60.0 * t).sin(), 0.0, 0.0);
    for k in 1..60u64 {
        predictor.observe(k * FIELD_PERIOD_NS, FIELD_PERIOD_NS, true, |dt| tip(k as f64 * 0.02 + dt));
    }
    let learnt = predictor.short.clone();
    predictor.observe(5_000_000_000, FIELD_PERIOD_NS, true, |_| Vector3::new(7.0, 0.0, 0.0));
    assert!(predictor.ahead().is_none(), "nothing is known of the new movement yet");
    let step = [Vector3::new(0.01, 0.0, 0.0); SHORT];
    assert_eq!(predictor.short.predict(&step), learnt.predict(&step));
}

#[test]
fn a_missing_field_is_filled_in() {
    let tip = |t: f64| Vector3::new(3.0 * t, 0.0, 0.0);
    let mut predictor = TipPredictor::default();
    for k in (1..60u64).filter(|k| k % 7 != 0) {
        predictor.observe(k * FIELD_PERIOD_NS, FIELD_PERIOD_NS, true, |dt| tip(k as f64 * 0.02 + dt));
    }
    let bends: [Vector3<f64>; LONG] = predictor.bends();
    assert!(bends.iter().all(|s| s.x.abs() < 1e-12), "{bends:?}");
}

/// Every adverse movement for an hour: nothing is reset, weights stay bounded, and where everything is
/// seen the prediction is no worse in the end than it was.
fn endures(movement: Adverse) {
    let mut predictor = TipPredictor::default();
    let mut rms_um = [0.0; 2];
    for n in 0..STEPS {
        let (tip, seen) = movement.at(n);
        if let Some(ahead) = predictor.ahead() {
            assert!(ahead.iter().all(|tip| tip.norm() < 1e3), "{movement:?}, field {n}: {ahead:?}");
            let half = usize::from(n >= STEPS / 2);
            rms_um[half] += (ahead[0] - tip).norm_squared() * 1e6;
        }
        if seen == Seen::Nothing && movement == Adverse::Withdrawn {
            predictor.interrupt();
            continue;
        }
        let later = |dt: f64| movement.at((n as f64 + dt / 0.02).round() as u64).0;
        let exposed_ns = (n + 1) * FIELD_PERIOD_NS;
        predictor.observe(exposed_ns, FIELD_PERIOD_NS, seen != Seen::Nothing, |dt| later(dt.min(0.0)));
        assert!(!predictor.recover(), "{movement:?}: was reset at field {n}");
    }
    let [first, second] = rms_um.map(|sum| (sum / (STEPS / 2) as f64).sqrt());
    println!("{movement:?}: {first:.3} µm in the first half, {second:.3} µm in the second");
    assert!(second <= 1.05 * first + 1e-3, "{movement:?}: {first} µm, then {second} µm");
}

#[test]
fn rest_for_an_hour_leaves_it_as_it_was() {
    endures(Adverse::Rest);
    endures(Adverse::ConstantVelocity);
}

#[test]
fn jumps_for_an_hour_leave_it_as_it_was() {
    endures(Adverse::RestThenJump);
    endures(Adverse::OneCamera);
}

#[test]
fn gaps_for_an_hour_leave_it_as_it_was() {
    endures(Adverse::OneFieldInTen);
    endures(Adverse::Withdrawn);
}

#[test]
fn what_is_not_finite_begins_anew_and_predicts_again() {
    let mut predictor = TipPredictor::default();
    let observe = |predictor: &mut TipPredictor, n: u64, broken: bool| {
        let shift = if broken { f64::NAN } else { 0.0 };
        predictor.observe(n * FIELD_PERIOD_NS, FIELD_PERIOD_NS, true, |_| {
            Adverse::OneCamera.at(n).0.add_scalar(shift)
        });
    };
    (1..100).for_each(|n| observe(&mut predictor, n, false));
    assert!(!predictor.recover() && predictor.ahead().is_some());
    observe(&mut predictor, 100, true);
    assert!(predictor.recover() && predictor.ahead().is_none());
    (101..200).for_each(|n| observe(&mut predictor, n, false));
    assert!(!predictor.recover() && predictor.ahead().is_some());
}
