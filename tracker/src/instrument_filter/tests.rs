//! Tests of the instrument filter: pivot, tremor, a trocar that becomes known.

use super::adaptation::Nis;
use super::*;
use crate::adverse::{Adverse, STEPS, Seen};
use crate::rig_model::RigModel;
use proptest::prelude::*;

pub(super) const FIELD_NS: u64 = 20_000_000;

pub(super) fn pivot() -> Pivot {
    Pivot { position: Vector3::new(7.8, 4.5, 7.9), sigma: 0.05, tracked: true }
}

/// The shaft through the pivot with the tip at `tip`.
pub(super) fn through(tip: Vector3<f64>) -> Isometry3<f64> {
    let axis = pivot().position - tip;
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
    Isometry3::from_parts(Translation3::from(tip), rotation)
}

fn model() -> BodyModel {
    RigModel::new(&rig::Rig::load_or_shipped(None).unwrap()).bodies[0].clone()
}

pub(super) fn filter(tip: Vector3<f64>) -> InstrumentFilter {
    InstrumentFilter::new(
        &through(tip),
        &(Matrix6::identity() * 1e-4),
        Some(pivot()),
        FIELD_NS,
        &model(),
        None,
    )
}

/// Measures a pose with the covariance `noise`.
pub(super) fn measure(f: &mut InstrumentFilter, pose: &Isometry3<f64>, noise: &Matrix6) -> bool {
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
    let [low, middle, high] = f.hand.tremor_variance;
    assert!(middle > 4.0 * low.max(high), "{:?}", f.hand.tremor_variance);
}

/// All that a filter says of the pose and its motion, and of their uncertainty.
fn said(f: &InstrumentFilter) -> Vec<f64> {
    let (pose, information) = (f.pose(), f.pose_covariance().try_inverse().unwrap());
    let columns: Vec<[f64; N]> = f.covariance.to_vec();
    let velocities = columns.iter().map(|row| f.tip_and_play(row)[1]).flat_map(|v| [v.x, v.y, v.z]);
    let numbers =
        pose.translation.vector.iter().chain(pose.rotation.coords.iter()).copied().collect::<Vec<_>>();
    let given =
        f.motion_given_pose(&information).motion(&f.motion(), &crate::pose_math::Vector6::repeat(1e-3));
    let motion = f.motion().into_iter().chain(given).flat_map(|v| [v.x, v.y, v.z]);
    numbers.into_iter().chain(motion).chain(f.pose_covariance().iter().copied()).chain(velocities).collect()
}

#[test]
fn another_pivot_changes_nothing_of_pose_motion_and_their_covariance() {
    // Taken out until it turns freely, and put back: at every change of its pivot, both ways.
    let tip = |t: f64| through(Vector3::new(1.0, 2.0, -4.0)).translation.vector.lerp(&pivot().position, t);
    let mut f = filter(tip(0.0));
    let (mut taken, mut along_mm) = (Vec::new(), Vec::new());
    for n in 1..200u64 {
        let out = 0.9 - (n as f64 / 100.0 - 1.0).abs() * 0.9;
        let mut other = f.clone();
        let _ = other.next_pivot(Some(pivot()));
        if other.pivot.tracked != f.pivot.tracked {
            let (before, after) = (said(&f), said(&other));
            let of_play = 3 * PLAY..3 * PLAY + 6;
            for (i, (a, b)) in before.iter().zip(&after).enumerate() {
                // The rows of the play itself are at another point.
                let row = i.checked_sub(before.len() - 3 * N).map(|i| i / 3);
                if row.is_none_or(|row| !of_play.contains(&row)) {
                    assert!((a - b).abs() < 1e-9 + 1e-6 * a.abs(), "{i}: {a} and {b}");
                }
            }
            taken.push(other.pivot.tracked);
            along_mm.push(other.axis().dot(&other.vectors[PLAY]));
        }
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        assert!(measure(&mut f, &through(tip(out)), &(Matrix6::identity() * 1e-6)));
    }
    assert_eq!(taken, [false, true]);
    assert!(along_mm.iter().all(|mm| mm.abs() < 1e-9), "{along_mm:?}");
    assert!(f.play() < 0.02, "{}", f.play());
}

#[test]
fn an_instrument_that_is_put_in_starts_afresh_and_one_whose_eye_is_found_again_does_not() {
    let inside = through(Vector3::new(1.0, 2.0, -4.0));
    let length = (pivot().position - inside.translation.vector).norm();
    for (lever, is_put_in) in [(5.0, true), (15.0, false)] {
        let tip = inside.translation.vector.lerp(&pivot().position, 1.0 - lever / length);
        let pose = through(tip);
        let mut f =
            InstrumentFilter::new(&pose, &(Matrix6::identity() * 1e-6), None, FIELD_NS, &model(), None);
        assert!(f.turns_freely());
        f.voluntary_variance = Directed::even(k::VOLUNTARY_RANGE_MM2_S4.1);
        f.predict(2 * FIELD_NS, Some(pivot()));
        assert!(!f.turns_freely());
        let ratio = f.voluntary_variance.across / k::VOLUNTARY_RANGE_MM2_S4.1;
        assert!(if is_put_in { ratio < 0.01 } else { ratio > 0.5 }, "lever {lever}: {ratio}");
        assert!((f.pose().translation.vector - tip).norm() < 1e-6, "{}", f.pose());
    }
}

#[test]
fn a_trocar_that_comes_into_sight_does_not_jerk_the_shaft() {
    let mut f = InstrumentFilter::new(
        &through(Vector3::zeros()),
        &(Matrix6::identity() * 1e-4),
        None,
        FIELD_NS,
        &model(),
        None,
    );
    let before = f.pose();
    f.predict(FIELD_NS + 1_000, Some(pivot()));
    assert!(box_minus(&f.pose(), &before).norm() < 1e-4);
}

#[test]
fn a_band_without_tremor_loses_its_variance() {
    let tip = |t: f64| Vector3::new(0.05 * (63.0 * t).sin(), 0.05 * (63.0 * t).cos(), -4.0);
    let mut f = filter(tip(0.0));
    let begun = [3e-4; 3];
    f.hand.tremor_variance = begun;
    for n in 1..100u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        measure(&mut f, &through(tip(n as f64 * 0.02)), &(Matrix6::identity() * 1e-5));
    }
    // After 2 s.
    assert!(f.hand.tremor_variance[0] < 0.05 * begun[0], "{:?} of {begun:?}", f.hand.tremor_variance);
}

#[test]
fn a_manoeuvre_reaches_the_acceleration_at_once() {
    let mut f = filter(Vector3::zeros());
    f.hand_known_ns = f.time_ns;
    f.voluntary_variance.across *= 0.5;
    let (before, voluntary) = (f.covariance, f.voluntary_variance);
    f.adapt_to_nis(Nis { all: 1000.0, of_tip: 900.0 }, 6.0);
    let raised = f.voluntary_variance.zip(voluntary, |after, before| after - before);
    assert!(raised.along > 8.0 * voluntary.along && raised.across > 8.0 * voluntary.across, "{raised:?}");
    let axis = f.rotation * Vector3::z();
    let across = axis.cross(&Vector3::x()).normalize();
    for (lag, ratio) in crate::motion_models::VoluntaryMotion::LAG_VARIANCES.iter().enumerate() {
        let at = 3 * (2 + lag);
        let added = nalgebra::Matrix3::from_fn(|r, c| f.covariance[at + r][at + c] - before[at + r][at + c]);
        for (direction, raised) in [(axis, raised.along), (across, raised.across)] {
            let (added, due) = (direction.dot(&(added * direction)), k::MANOEUVRE_SHARE * ratio * raised);
            assert!((added - due).abs() < 1e-9 * due, "lag {lag}: {added} instead of {due}");
        }
    }
    assert_eq!(f.covariance[0], before[0], "nothing else changes");
}

/// The voluntary movement is learnt along the shaft and across it apart.
#[test]
fn what_goes_along_the_shaft_is_no_movement_across_it() {
    let mut f = filter(Vector3::zeros());
    let axis = f.rotation * Vector3::z();
    for n in 1..=250u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        let t = n as f64 * 0.02;
        measure(&mut f, &through(axis * (0.5 * libm::sin(9.0 * t))), &(Matrix6::identity() * 1e-6));
    }
    let Directed { along, across } = f.voluntary_variance;
    assert!(along > 10.0 * across, "{along} and {across} mm²/s⁴");
}

#[test]
fn an_unknown_hand_may_tremble_in_every_band_and_a_known_one_manoeuvres() {
    let mut f = filter(Vector3::zeros());
    let (before, voluntary) = (f.hand.tremor_variance, f.voluntary_variance);
    let before_tip = f.pose_covariance();
    let manoeuvre = |of_tip| Nis { all: 1000.0, of_tip };
    f.adapt_to_nis(manoeuvre(900.0), 6.0);
    assert_eq!((f.voluntary_variance, f.hand.tremor_variance[1]), (voluntary, before[1]));
    for band in [0, 2] {
        // Half as wide as the main band.
        assert!(
            (f.hand.tremor_variance[band] / before[1] - 0.5).abs() < 1e-12,
            "{:?}",
            f.hand.tremor_variance
        );
    }
    let tip = f.pose_covariance();
    assert!((tip - before_tip).amax() < 1e-12, "the tip is as well known as before: {tip}");
    let rolled = f.voluntary_variance;
    f.adapt_to_nis(manoeuvre(100.0), 6.0);
    assert!(f.voluntary_variance.along > 2.0 * rolled.along, "a roll is no tremor");
    f.time_ns = f.hand_known_ns;
    let spread = f.hand.tremor_variance;
    f.adapt_to_nis(manoeuvre(900.0), 6.0);
    assert!(f.hand.tremor_variance == spread && f.voluntary_variance.along > 2.0 * voluntary.along);
}

/// Its shaft turns about the trocar: the nearer the tip is to it, the less it trembles.
#[test]
fn the_tremor_is_as_large_as_the_lever() {
    let towards = pivot().position.normalize();
    let lever = pivot().position.norm();
    let mut f = filter(Vector3::zeros());
    let begun = f.hand.tremor_variance;
    assert!((f.hand.lever_mm - lever).abs() < 1e-9);
    // Half-way out, found there again, put back, and lost and found where no trocar is known.
    let scaled = |f: &InstrumentFilter| f.hand.tremor_variance[1] / begun[1];
    let out = through(0.5 * lever * towards);
    let of = |hand, pivot, pose: &Isometry3<f64>| {
        InstrumentFilter::new(pose, &(Matrix6::identity() * 1e-4), pivot, FIELD_NS, &model(), Some(hand))
    };
    f = of(f.hand(), Some(pivot()), &out);
    assert!((scaled(&f) - 0.25).abs() < 1e-9, "{}", scaled(&f));
    f = of(f.hand(), None, &through(Vector3::zeros()));
    assert!((scaled(&f) - 0.25).abs() < 1e-9, "{}", scaled(&f));
    f = of(f.hand(), Some(pivot()), &through(Vector3::zeros()));
    assert!((scaled(&f) - 1.0).abs() < 1e-9, "{}", scaled(&f));
    // In flight, field by field.
    f.hand.tremor_variance = begun;
    for n in 1..=25u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        f.hand.tremor_variance[1] = begun[1] * libm::pow(f.hand.lever_mm / lever, 2.0);
        measure(&mut f, &through(0.02 * n as f64 * lever * towards), &(Matrix6::identity() * 1e-8));
    }
    f.scale_tremor();
    assert!((scaled(&f) - 0.25).abs() < 0.01, "{}", scaled(&f));
}

#[test]
fn an_instrument_is_found_as_well_as_its_pose_is_known() {
    let pose = Matrix6::from_diagonal(&nalgebra::Vector6::new(1e-4, 2e-4, 3e-4, 1e-5, 1e-5, 1e-5));
    let f = InstrumentFilter::new(&through(Vector3::zeros()), &pose, Some(pivot()), FIELD_NS, &model(), None);
    for axis in 0..3 {
        let found = f.pose_covariance()[(axis, axis)];
        assert!((found - pose[(axis, axis)]).abs() < 1e-12, "axis {axis}: {found}");
        assert!(f.covariance[axis][axis] > 2e-3, "the voluntary movement is known but for the tremor");
    }
    assert_sound(&f, "an instrument just found");
}

/// Covariance of a measurement: one camera does not see the depth.
fn noise_of(seen: Seen) -> Matrix6 {
    let mut noise = Matrix6::identity() * 1e-5;
    if seen == Seen::OneCamera {
        noise[(2, 2)] = 1e4;
    }
    noise
}

fn assert_sound(f: &InstrumentFilter, what: &str) {
    let p = &f.covariance;
    for (r, row) in p.iter().enumerate() {
        assert!(row[r] >= 0.0 && row[r] < 1e12, "{what}: variance {r} is {}", row[r]);
        assert!(row.iter().enumerate().all(|(c, v)| *v == p[c][r]), "{what}: row {r} is not symmetric");
    }
    assert!(f.pose_covariance().cholesky().is_some(), "{what}: {}", f.pose_covariance());
    assert!(f.vectors.iter().all(|v| v.norm() < 1e6), "{what}: {:?}", f.vectors);
    let adapted = f.hand.tremor_variance.iter().chain(&f.hand.roll_tremor_variance);
    let voluntary = [&f.voluntary_variance.along, &f.voluntary_variance.across];
    assert!(
        adapted.chain(voluntary).chain([&f.nis_ratio, &f.hand.lever_mm]).all(|v| *v >= 0.0 && v.is_finite())
    );
    assert!(f.onsets.is_sound(), "{what}: {:?}", f.onsets);
}

/// Every adverse movement, an hour of each: 10⁶ steps.
#[test]
fn an_hour_of_adverse_movements_leaves_it_sound() {
    for movement in Adverse::ALL {
        let depth = Vector3::new(0.0, 0.0, -4.0);
        let mut f = filter(movement.at(0).0 + depth);
        let (mut seen_ns, mut begun) = (0, 1);
        for n in 1..STEPS {
            let (tip, seen) = movement.at(n);
            // A track ends where nothing is seen for long, and begins again where the body is seen.
            let lost = FIELD_NS * n - seen_ns > FIELD_NS * 50;
            if seen != Seen::Nothing {
                seen_ns = FIELD_NS * n;
            }
            if lost {
                if seen != Seen::Nothing {
                    f = filter(tip + depth);
                    f.time_ns = FIELD_NS * (n + 1);
                    begun += 1;
                }
                continue;
            }
            f.predict(FIELD_NS * (n + 1), (n % 50 != 0).then(pivot));
            if seen != Seen::Nothing {
                measure(&mut f, &through(tip + depth), &noise_of(seen));
            }
            // Looking at the whole matrix costs more than the step.
            if n.is_multiple_of(61) || n + 100 > STEPS {
                assert_sound(&f, &format!("{movement:?}, step {n}"));
            }
        }
        println!("{movement:?}: {STEPS} steps, begun {begun} times");
    }
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

#[test]
fn the_motion_follows_the_pose_as_an_update_has_it() {
    let tip = |t: f64| Vector3::new(20.0 * t, -10.0 * t + 0.05 * (63.0 * t).sin(), -4.0);
    let mut f = filter(tip(0.0));
    for n in 1..20u64 {
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        measure(&mut f, &through(tip(n as f64 * 0.02)), &(Matrix6::identity() * 1e-6));
    }
    f.predict(FIELD_NS * 21, Some(pivot()));
    for axis in 0..6 {
        let mut f = f.clone();
        let prior = f.pose_covariance().try_inverse().unwrap();
        let (given, before) = (f.motion_given_pose(&prior), f.motion());
        let mut off = crate::pose_math::Vector6::zeros();
        off[axis] = 1e-5;
        let expected = given.motion(&before, &off);
        // A turn takes the shaft along, about which it turns: of second order.
        let second = if axis < 3 { 1e-6 } else { 3e-5 * before[1].norm() + 1e-6 };
        let covariance = f.pose_covariance() * 0.5;
        assert!(f.update(&crate::pose_math::box_plus(&f.pose(), &off), &covariance, &prior));
        for ((after, expected), before) in f.motion().iter().zip(&expected).zip(&before) {
            let change = (expected - before).norm();
            assert!(
                (after - expected).norm() < 0.02 * change + second,
                "{axis}: {after}, {expected}, {before}"
            );
        }
        // A row of the picture that the axis moves by a pixel a millimetre: what remains is less than all.
        let mut then = nalgebra::SMatrix::<f64, 2, 6>::zeros();
        then[(0, axis)] = 1.0;
        let rest = given.spread(&then, 0.01)[(0, 0)];
        assert!(rest > 0.0 && rest < 1.0, "{axis}: {rest}");
    }
}

#[test]
fn an_instrument_that_is_found_again_is_in_the_hand_that_held_it() {
    let mut held = filter(Vector3::zeros());
    for n in 1..600u64 {
        held.predict(FIELD_NS * (n + 1), Some(pivot()));
        let tip = Vector3::new(0.1 * libm::sin(62.8 * n as f64 * 0.02), 0.0, 0.0);
        assert!(measure(&mut held, &through(tip), &(Matrix6::identity() * 1e-6)));
    }
    let of = |hand| {
        let pose = through(Vector3::zeros());
        InstrumentFilter::new(&pose, &(Matrix6::identity() * 1e-4), Some(pivot()), FIELD_NS, &model(), hand)
    };
    let (known, unknown) = (of(Some(held.hand())), of(None));
    let [low, middle, high] = known.hand.tremor_variance;
    assert!(middle > 4.0 * low.max(high), "{:?}", known.hand);
    let displaced = |f: &InstrumentFilter| f.covariance[3 * TREMOR][3 * TREMOR];
    assert!(displaced(&known) != displaced(&unknown));
    // It is put in along its shaft.
    let axis = known.rotation * Vector3::z();
    let speed = |d: &Vector3<f64>| {
        let block = nalgebra::Matrix3::<f64>::from_fn(|r, c| known.covariance[3 + r][3 + c]);
        libm::sqrt(d.dot(&(block * d)))
    };
    let across = axis.cross(&Vector3::x()).normalize();
    assert!((speed(&axis) - k::START_SPEED_MM_S).abs() < 1e-9);
    assert!((speed(&across) - k::START_SPEED_ACROSS_MM_S).abs() < 1e-9);
}

impl InstrumentFilter {
    /// Takes itself to be surer: all its variances are multiplied by a factor.
    pub(crate) fn be_surer(&mut self, factor: f64) {
        self.covariance.iter_mut().flatten().for_each(|v| *v *= factor);
        self.renew_cross();
    }
}
