//! Tests of the instrument filter: pivot, tremor, a trocar that becomes known.

use super::*;
use proptest::prelude::*;

const FIELD_NS: u64 = 20_000_000;

fn pivot() -> Pivot {
    Pivot { position: Vector3::new(7.8, 4.5, 7.9), sigma: 0.05, tracked: true }
}

/// The shaft through the pivot with the tip at `tip`.
fn through(tip: Vector3<f64>) -> Isometry3<f64> {
    let axis = pivot().position - tip;
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
    Isometry3::from_parts(Translation3::from(tip), rotation)
}

fn filter(tip: Vector3<f64>) -> InstrumentFilter {
    InstrumentFilter::new(&through(tip), &(Matrix6::identity() * 1e-4), Some(pivot()), FIELD_NS)
}

/// Measures a pose with the covariance `noise`.
fn measure(f: &mut InstrumentFilter, pose: &Isometry3<f64>, noise: &Matrix6) -> bool {
    let prior = f.pose_covariance().try_inverse().unwrap();
    let information = noise.try_inverse().unwrap();
    let covariance = (prior + information).try_inverse().unwrap();
    let step = covariance * information * box_minus(pose, &f.pose());
    f.update(&crate::pose_math::box_plus(&f.pose(), &step), &covariance, &prior)
}

#[test]
fn a_moving_tip_turns_the_shaft_about_its_pivot() {
    let tip = |t: f64| Vector3::new(2.0 * t, -1.0 + t, -4.0);
    let mut f = filter(tip(0.0));
    for n in 1..40u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        assert!(measure(&mut f, &through(tip(n as f64 * 0.02)), &(Matrix6::identity() * 1e-6)));
    }
    let (ahead, truth) = (f.pose_after(0.1), through(tip(39.0 * 0.02 + 0.1)));
    let miss = crate::fit::trocar_miss(&ahead, &pivot().position.into());
    assert!((ahead.translation.vector - truth.translation.vector).norm() < 0.01);
    assert!(miss.norm() < 0.005, "{miss}");
    assert!(f.play() < 0.005);
}

#[test]
fn the_bank_learns_where_the_tremor_is() {
    let tip = |t: f64| Vector3::new(0.05 * (63.0 * t).sin(), 0.05 * (63.0 * t).cos(), -4.0);
    let mut f = filter(tip(0.0));
    for n in 1..150u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        measure(&mut f, &through(tip(n as f64 * 0.02)), &(Matrix6::identity() * 1e-6));
    }
    let [low, .., high] = f.tremor_variance;
    let most = f.tremor_variance.into_iter().fold(0.0, f64::max);
    assert!(f.tremor_variance[2] == most && most > 4.0 * low.max(high), "{:?}", f.tremor_variance);
}

#[test]
fn a_trocar_that_comes_into_sight_does_not_jerk_the_shaft() {
    let mut f =
        InstrumentFilter::new(&through(Vector3::zeros()), &(Matrix6::identity() * 1e-4), None, FIELD_NS);
    let before = f.pose();
    f.predict(FIELD_NS + 1_000, Some(pivot()));
    assert!(box_minus(&f.pose(), &before).norm() < 1e-4);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn covariance_stays_positive(steps in prop::collection::vec((1u64..150_000_000, 0.0..1.0f64), 1..30)) {
        let mut f = filter(Vector3::new(1.0, 2.0, -4.0));
        for (dt, sight) in steps {
            f.predict(f.time_ns + dt, (sight < 0.8).then(pivot));
            if sight < 0.1 {
                f.inflate_covariance();
            }
            let pose = f.pose();
            prop_assert!(measure(&mut f, &pose, &(Matrix6::identity() * (1e-6 + 1e-3 * sight))));
            prop_assert!(f.pose_covariance().cholesky().is_some());
            prop_assert!((0..N).all(|i| f.covariance[i][i] >= 0.0));
        }
    }
}
