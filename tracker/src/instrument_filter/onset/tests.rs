//! Tests of withdrawals: what they leave, when they are found, and that a guided hand is none.

use super::super::tests::{FIELD_NS, filter, measure, pivot, through};
use super::super::tip_of;
use super::*;
use crate::pose_math::exp;
use nalgebra::Isometry3;
use protocol::random::Random;
use std::f64::consts::TAU;

impl Onsets {
    /// False where something is not finite.
    pub fn is_sound(&self) -> bool {
        let Onsets { signatures, age_s, score, information } = self;
        signatures.iter().flatten().chain(age_s).chain(score).chain(information).all(|v| v.is_finite())
    }
}

const FIELD_S: f64 = 1e-9 * FIELD_NS as f64;
/// Way of a withdrawal, mm, and the time that it takes, s.
const WITHDRAWAL: (f64, f64) = (12.0, 0.9);
/// Field in which a withdrawal begins: the filter has learnt the hand.
const BEGIN: u64 = 250;
/// Standard deviations of a measured pose: mm and rad.
const NOISE: (f64, f64) = (0.008, 0.003);

/// A hand that is guided slowly and trembles, from a seed; the third is along the shaft.
struct Hand([Vec<[f64; 3]>; 3]);

impl Hand {
    fn of(seed: u64) -> Self {
        let random = &mut Random::new(seed, 0);
        Hand(std::array::from_fn(|_| {
            let wave = |low, high, mm: f64, random: &mut Random| {
                [mm, TAU * random.between(low, high), TAU * random.uniform()]
            };
            let guided: Vec<_> = (0..4).map(|_| wave(0.06, 0.45, 0.7, random)).collect();
            let tremor = (0..16).map(|_| wave(8.0, 12.0, 0.013, random));
            guided.into_iter().chain(tremor).collect()
        }))
    }

    /// Pose after `t_s`, withdrawn by `mm`.
    fn pose(&self, t_s: f64, mm: f64) -> Isometry3<f64> {
        let at = |n: usize| {
            self.0[n].iter().map(|[amplitude, rate, phase]| amplitude * libm::sin(rate * t_s + phase)).sum()
        };
        let tip = Vector3::new(at(0), at(1), at(2) - 4.0);
        through(tip + (pivot().position - tip).normalize() * mm)
    }
}

/// Displacement of a minimum-jerk movement, mm.
fn withdrawn(since_s: f64) -> f64 {
    let x = (since_s / WITHDRAWAL.1).clamp(0.0, 1.0);
    WITHDRAWAL.0 * x * x * x * (10.0 - x * (15.0 - 6.0 * x))
}

fn noisy(pose: &Isometry3<f64>, random: &mut Random) -> Isometry3<f64> {
    let mut pose = *pose;
    let mut normal = || Vector3::from_fn(|_, _| random.normal());
    pose.translation.vector += normal() * NOISE.0;
    pose.rotation = exp(normal() * NOISE.1) * pose.rotation;
    pose
}

fn noise() -> Matrix6 {
    let (tip, turn) = (NOISE.0 * NOISE.0, NOISE.1 * NOISE.1);
    Matrix6::from_diagonal(&Vector6::new(tip, tip, tip, turn, turn, turn))
}

/// What became of a hand: squared errors of the tip in the first 0.3 s of a withdrawal, µm², and fields in which
/// withdrawals were found.
#[derive(Default)]
struct Outcome {
    squares: Vec<f64>,
    found: Vec<u64>,
}

/// Measures the poses of a hand that is withdrawn `sign` times as far, with or without looking for withdrawals.
fn follow(seed: u64, fields: u64, sign: f64, looking: bool) -> Outcome {
    let (hand, random, mut outcome) = (Hand::of(seed), &mut Random::new(seed, 1), Outcome::default());
    let mut f = filter(hand.pose(0.0, 0.0).translation.vector);
    for n in 1..fields {
        let t_s = n as f64 * FIELD_S;
        let truth = hand.pose(t_s, sign * withdrawn(t_s - BEGIN as f64 * FIELD_S));
        f.predict(FIELD_NS * (n + 1), Some(pivot()));
        if !looking {
            f.onsets = Onsets::new();
        }
        assert!(measure(&mut f, &noisy(&truth, random), &noise()));
        if looking && f.onsets == Onsets::new() {
            outcome.found.push(n);
        }
        if (BEGIN..BEGIN + 15).contains(&n) {
            outcome
                .squares
                .push(1e6 * (f.pose().translation.vector - truth.translation.vector).norm_squared());
        }
    }
    outcome
}

/// Two filters that measure the same but for a withdrawal: the one that is withdrawn is off by the signature.
#[test]
fn a_state_is_off_by_what_updates_leave_of_a_withdrawal() {
    const JERK: f64 = 20.0;
    let (tip, outwards) =
        (Vector3::new(1.0, 0.5, -4.0), |tip: Vector3<f64>| (pivot().position - tip).normalize());
    let (mut still, mut moved) = (filter(tip), filter(tip));
    for f in [&mut still, &mut moved] {
        // What is learnt differs with what is measured.
        (f.tuning.voluntary_learning_s, f.tuning.tremor_learning_s) = (60.0, 60.0);
    }
    let mut compared = 0;
    for n in 1..=5u64 {
        let t = n as f64 * FIELD_S;
        let to = tip + outwards(tip) * (JERK * t * t * t / 6.0);
        for (f, tip) in [(&mut still, tip), (&mut moved, to)] {
            f.predict(FIELD_NS * (n + 1), Some(pivot()));
            assert!(measure(f, &through(tip), &noise()));
        }
        let true_tip = to - tip;
        let off = still.onsets.signatures.map(|row| row[0]);
        let expected = true_tip - (tip_of(&moved.vectors) - tip_of(&still.vectors));
        let (tip_off, _) = pose_part(&off, &outwards(tip), 1.0);
        assert!(
            (expected - tip_off * JERK).norm() < 0.02 * true_tip.norm(),
            "{n}: {expected} {}",
            tip_off * JERK
        );
        let velocity = outwards(tip) * (JERK * t * t / 2.0) - (moved.vectors[1] - still.vectors[1]);
        let velocity_off = Vector3::new(off[3], off[4], off[5]) * JERK;
        assert!((velocity - velocity_off).norm() < 0.02 * velocity.norm(), "{n}: {velocity} {velocity_off}");
        compared += 2;
    }
    assert_eq!(compared, 10);
}

#[test]
fn a_withdrawal_is_found_before_it_is_far() {
    let (mut with, mut without, mut late) = (vec![], vec![], 0);
    for seed in 1..=24 {
        let outcome = follow(seed, BEGIN + 20, 1.0, true);
        let first = outcome.found.iter().find(|n| **n >= BEGIN).map_or(u64::MAX, |n| n - BEGIN);
        late = late.max(first);
        with.extend(outcome.squares);
        without.extend(follow(seed, BEGIN + 20, 1.0, false).squares);
    }
    let rms = |squares: &[f64]| libm::sqrt(squares.iter().sum::<f64>() / squares.len() as f64);
    let (with, without) = (rms(&with), rms(&without));
    println!("first 0.3 s: {with:.1} µm, not looked for {without:.1}; found after at most {late} fields");
    assert!(late <= 9, "{late}");
    assert!(with < 0.75 * without, "{with} {without}");
}

/// Neither is a hand that is guided and trembles, nor one that puts its instrument further in.
#[test]
fn a_guided_hand_is_no_withdrawal() {
    let (fields, seeds) = (15_000, 4);
    let found: usize = (101..101 + seeds).map(|seed| follow(seed, fields, 0.0, true).found.len()).sum();
    println!("{found} withdrawals in {} fields without one", fields * seeds);
    assert!(found <= 6, "{found}");
    let further_in = (201..=216).filter(|seed| {
        let found = follow(*seed, BEGIN + 20, -0.3, true).found;
        found.iter().any(|n| (BEGIN..BEGIN + 8).contains(n))
    });
    assert_eq!(further_in.count(), 0);
}
