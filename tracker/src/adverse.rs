//! Movements that recursive estimators find hard, for tests that run for as long as a session does.

use nalgebra::Vector3;
use protocol::random::{nth, unit_interval};

/// Steps of a test: an hour has 180,000 fields, and six movements of this length are 10⁶ steps.
pub const STEPS: u64 = 170_000;

/// One kind of movement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Adverse {
    /// Nothing moves, and nothing is noise: no excitation at all.
    Rest,
    /// Rest for 100 s, then a jump of 6 mm.
    RestThenJump,
    /// A constant velocity, without noise.
    ConstantVelocity,
    /// A hand that is measured in one field of ten.
    OneFieldInTen,
    /// A hand that only one camera sees.
    OneCamera,
    /// A hand for 20 s, then nothing for three minutes.
    Withdrawn,
}

/// What is seen in a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seen {
    /// Nothing.
    Nothing,
    /// The two directions across the line of sight of one camera.
    OneCamera,
    /// Everything.
    All,
}

impl Adverse {
    /// Every one.
    pub const ALL: [Adverse; 6] = [
        Adverse::Rest,
        Adverse::RestThenJump,
        Adverse::ConstantVelocity,
        Adverse::OneFieldInTen,
        Adverse::OneCamera,
        Adverse::Withdrawn,
    ];

    /// The tip at field `n`, mm, and what is seen of it.
    pub fn at(self, n: u64) -> (Vector3<f64>, Seen) {
        let hand = || hand(n);
        match self {
            Adverse::Rest => (Vector3::zeros(), Seen::All),
            Adverse::RestThenJump => (Vector3::new(6.0 * (n / 5_000 % 2) as f64, 0.0, 0.0), Seen::All),
            Adverse::ConstantVelocity => (Vector3::new(2e-5 * n as f64, 0.0, 1e-5 * n as f64), Seen::All),
            Adverse::OneFieldInTen => (hand(), if n.is_multiple_of(10) { Seen::All } else { Seen::Nothing }),
            Adverse::OneCamera => (hand(), Seen::OneCamera),
            Adverse::Withdrawn => (hand(), if n % 10_000 < 1_000 { Seen::All } else { Seen::Nothing }),
        }
    }
}

/// A hand at field `n`: a swing, a tremor of two frequencies, noise of measurement; mm.
pub fn hand(n: u64) -> Vector3<f64> {
    let t = n as f64 * 0.02;
    let noise = |axis: u64| (unit_interval(nth(axis, n)) - 0.5) * 0.006;
    let tremor = 0.02 * (52.0 * t).sin() + 0.015 * (71.3 * t).cos();
    Vector3::new(tremor + noise(0), 0.7 * tremor + noise(1), 3.0 * (1.1 * t).sin() + noise(2))
}
