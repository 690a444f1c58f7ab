//! Adaptive linear prediction of a tip by recursive least squares (RLS).
//!
//! With b_k the bends of the path (second differences of the tip from field to field), what the tip moves
//! over the next h fields beyond going straight on is predicted as Σ w_h,k·b_k over the last L bends, with
//! the same weights for the three axes: a steady movement goes on whatever the weights are. The weights
//! minimise the squared errors of past predictions, older fields counting less (Haykin, Adaptive Filter
//! Theory, RLS). Initial weights are the least-squares ones of a typical motion: voluntary movement, a flat
//! tremor between 6 and 14 Hz, noise. The gain depends on the bends alone, so one covariance of the
//! weights serves all horizons.
//!
//! It lasts as long as a session does: the covariance is kept in UD form (see [`crate::ud_covariance`]),
//! and its information never falls below a share of the typical motion's in any direction, so that a hand
//! at rest does not wind it up.

use crate::checkpoint::{Done, Loader, Saver};
use crate::ud_covariance::UdCovariance;
use nalgebra::{SMatrix, SVector, Vector3};
use std::sync::Arc;

/// Number of horizons: 1 to 4 fields, 20 to 80 ms.
pub const HORIZONS: usize = 4;

/// Forgetting factor per field.
const FORGETTING: f64 = 0.995;
/// Weight of the typical motion, in fields.
const PRIOR_FIELDS: f64 = 20.0;
/// Frequencies of the slow movements that are learnt beside what is seen, Hz.
const SWING_HZ: [f64; 2] = [0.5, 1.5];
/// Their number: two phases of each frequency.
const SWINGS: usize = 2 * SWING_HZ.len();
/// Least information in any direction, over that of the start: without excitation, forgetting alone would
/// wind the covariance up.
const INFORMATION_FLOOR: f64 = 1e-4;

/// Standard deviation of the voluntary acceleration of the typical motion, mm/s²: white noise through a critically
/// damped second-order lag.
const TYPICAL_VOLUNTARY_MM_S2: f64 = 15.0;
/// Time constant of that lag, s.
const TYPICAL_LAG_S: f64 = 0.3;
/// Standard deviation of its tremor per axis, mm.
const TYPICAL_TREMOR_MM: f64 = 0.02;
/// Standard deviation of the noise of a measured tip per axis, mm.
const TYPICAL_NOISE_MM: f64 = 0.003;
/// Band of its tremor, Hz.
const BAND_HZ: (f64, f64) = (6.0, 14.0);

/// Lags of an autocovariance; the longest predictor needs its bends, the horizons and 2.
const LAGS: usize = 44;

/// Adaptive weights of the last `L` bends.
#[derive(Debug, Clone, PartialEq)]
pub struct RlsPredictor<const L: usize> {
    learnt: Learnt<L>,
    /// Gains and bends of the last fields, newest first, until the displacements they predict are
    /// measured.
    pending: [PendingUpdate<L>; HORIZONS],
    /// What it starts with.
    typical: Arc<Learnt<L>>,
    /// A factor F of the information that is added every `L` fields, F·Fᵀ; a column a field.
    floor: Arc<SMatrix<f64, L, L>>,
    next_floor: usize,
    /// Movements that the tip may make at any time.
    swings: Option<Arc<[Swing<L>; SWINGS]>>,
    next_swing: usize,
}

/// The weights and their covariance, in units of the variance of what they leave unpredicted.
#[derive(Debug, Clone, PartialEq)]
struct Learnt<const L: usize> {
    covariance: UdCovariance<L>,
    weights: [SVector<f64, L>; HORIZONS],
}

/// A slow movement: its bends, and what it moves over 1, 2 … fields beyond going straight on.
#[derive(Debug, Clone, PartialEq)]
struct Swing<const L: usize> {
    bends: SVector<f64, L>,
    moved: [f64; HORIZONS],
}

impl<const L: usize> Swing<L> {
    fn new(n: usize, period_s: f64, mm_s2: f64) -> Self {
        let omega = 2.0 * std::f64::consts::PI * SWING_HZ[n / 2];
        let phase = if n.is_multiple_of(2) { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        let tip = |fields: f64| mm_s2 / (omega * omega) * libm::sin(omega * fields * period_s + phase);
        let bend = |k: usize, _| tip(-(k as f64)) - 2.0 * tip(-(k as f64) - 1.0) + tip(-(k as f64) - 2.0);
        let moved = |h: usize| {
            let h = (h + 1) as f64;
            tip(h) - tip(0.0) - h * (tip(0.0) - tip(-1.0))
        };
        Swing { bends: SVector::from_fn(bend), moved: std::array::from_fn(moved) }
    }
}

/// Gain and bends of a field, per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PendingUpdate<const L: usize> {
    gains: [SVector<f64, L>; 3],
    bends: [SVector<f64, L>; 3],
}

impl<const L: usize> PendingUpdate<L> {
    const NONE: Self = PendingUpdate { gains: [Self::ZERO; 3], bends: [Self::ZERO; 3] };
    const ZERO: SVector<f64, L> =
        SVector::<f64, L>::from_array_storage(nalgebra::ArrayStorage([[0.0; L]; 1]));
}

impl<const L: usize> RlsPredictor<L> {
    /// Starts with the weights of the typical motion, sampled every `period_s`. Beside what it sees it learns
    /// slow movements of an acceleration of `swing_mm_s2`; of 0, none.
    pub fn new(period_s: f64, swing_mm_s2: f64) -> Self {
        let covariance = typical_autocovariance(L + HORIZONS + 2, period_s);
        let c = |n: i64| covariance[n.unsigned_abs() as usize];
        // Covariance of tips weighted by `a` at their instants with tips weighted by `b`.
        let between = |a: &[(i64, f64)], b: &[(i64, f64)]| -> f64 {
            a.iter().flat_map(|(i, u)| b.iter().map(move |(j, v)| u * v * c(i - j))).sum()
        };
        let bend = |k: usize| {
            let k = k as i64;
            [(-k, 1.0), (-k - 1, -2.0), (-k - 2, 1.0)]
        };
        let correlation = SMatrix::<f64, L, L>::from_fn(|i, j| between(&bend(i), &bend(j)));
        // What the tip moves over h fields beyond going straight on.
        let ahead = |h: i64| {
            let beyond = [(h, 1.0), (0, -1.0 - h as f64), (-1, h as f64)];
            SVector::<f64, L>::from_fn(|k, _| between(&beyond, &bend(k)))
        };
        let cholesky = correlation.cholesky();
        let (root, inverse) =
            cholesky.map_or_else(|| (SMatrix::identity(), SMatrix::identity()), |c| (c.l(), c.inverse()));
        let covariance = UdCovariance::new(&(inverse / PRIOR_FIELDS));
        let typical = Learnt {
            covariance: covariance.unwrap_or_else(UdCovariance::identity),
            weights: std::array::from_fn(|h| inverse * ahead(h as i64 + 1)),
        };
        // In balance with forgetting: a share 1 - FORGETTING is lost every field.
        let share = INFORMATION_FLOOR * PRIOR_FIELDS * (1.0 - FORGETTING) * L as f64;
        RlsPredictor {
            learnt: typical.clone(),
            pending: [PendingUpdate::NONE; HORIZONS],
            typical: Arc::new(typical),
            floor: Arc::new(root * libm::sqrt(share)),
            next_floor: 0,
            swings: (swing_mm_s2 > 0.0)
                .then(|| Arc::new(std::array::from_fn(|n| Swing::new(n, period_s, swing_mm_s2)))),
            next_swing: 0,
        }
    }

    /// Updates the weights with a field: `moved` is what the tip moved over the last 1, 2 … fields beyond going
    /// straight on, where all of that was measured. [`RlsPredictor::observe`] follows, before the next field.
    pub fn learn(&mut self, moved: &[Option<Vector3<f64>>; HORIZONS]) {
        for (h, moved) in moved.iter().enumerate() {
            let Some(moved) = moved else { continue };
            let update = &self.pending[h];
            let weights = &mut self.learnt.weights[h];
            for ((moved, bends), gain) in moved.iter().zip(&update.bends).zip(&update.gains) {
                let error = moved - bends.dot(weights);
                *weights += gain * error;
            }
        }
    }

    /// Takes the last bends, newest first, into the covariance of the weights, and learns a movement that may come at
    /// any time. Without such movements it changes no weight.
    pub fn observe(&mut self, bends: &[Vector3<f64>; L]) {
        self.forget();
        let mut update = PendingUpdate::NONE;
        for (axis, (gain, kept)) in update.gains.iter_mut().zip(&mut update.bends).enumerate() {
            let seen = SVector::<f64, L>::from_iterator(bends.iter().map(|bend| bend[axis]));
            (*gain, *kept) = (self.learnt.covariance.observe(&seen), seen);
        }
        self.pending.rotate_right(1);
        self.pending[0] = update;
        self.swing();
    }

    /// Lets older fields count less, down to the floor: information I ← λ·I + f·fᵀ, with another column f
    /// of the floor's factor every field.
    fn forget(&mut self) {
        self.learnt.covariance.scale(1.0 / FORGETTING);
        self.learnt.covariance.observe(&self.floor.column(self.next_floor).into_owned());
        self.next_floor = (self.next_floor + 1) % L;
    }

    /// Trains on a synthetic slow movement as well, so that tremor, which is always present, does not dominate the
    /// weights.
    fn swing(&mut self) {
        let Some(swings) = &self.swings else { return };
        let Swing { bends, moved } = &swings[self.next_swing];
        let gain = self.learnt.covariance.observe(bends);
        for (weights, moved) in self.learnt.weights.iter_mut().zip(moved) {
            *weights += gain * (moved - bends.dot(weights));
        }
        self.next_swing = (self.next_swing + 1) % SWINGS;
    }

    /// Writes what it has learnt, and what waits to be learnt from.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let RlsPredictor { learnt, pending, next_floor, next_swing, typical: _, floor: _, swings: _ } = self;
        learnt.covariance.save(out)?;
        out.numbers(learnt.weights.iter().flatten())?;
        for PendingUpdate { gains, bends } in pending {
            out.numbers(gains.iter().chain(bends).flatten())?;
        }
        out.put(&[*next_floor as u64, *next_swing as u64])
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        self.learnt.covariance.load(from)?;
        from.numbers(self.learnt.weights.iter_mut().flatten())?;
        for PendingUpdate { gains, bends } in &mut self.pending {
            from.numbers(gains.iter_mut().chain(bends).flatten())?;
        }
        self.next_floor = from.below(L as u64)? as usize;
        self.next_swing = from.below(SWINGS as u64)? as usize;
        Ok(())
    }

    /// Drops the pending updates; the weights are kept.
    pub fn interrupt(&mut self) {
        self.pending = [PendingUpdate::NONE; HORIZONS];
    }

    /// Resets itself to the weights of the typical motion.
    pub fn restart(&mut self) {
        self.learnt.clone_from(&self.typical);
        self.interrupt();
    }

    /// True if everything that it has learnt is finite, and the covariance positive definite.
    pub fn is_valid(&self) -> bool {
        self.learnt.covariance.is_valid() && self.is_finite()
    }

    /// True if its weights are.
    pub fn is_finite(&self) -> bool {
        self.learnt.weights.iter().flatten().all(|w| w.is_finite())
    }

    /// What the tip will move over the next 1, 2 … fields beyond going straight on.
    pub fn predict(&self, bends: &[Vector3<f64>; L]) -> [Vector3<f64>; HORIZONS] {
        self.learnt.weights.map(|weights| {
            bends.iter().zip(weights.iter()).fold(Vector3::zeros(), |sum, (bend, w)| sum + bend * *w)
        })
    }
}

/// Autocovariance of the typical motion at lags of 0, 1 … `lags` fields, mm², up to a constant that
/// cancels in differences: ∫ S(f)·(cos 2πfτ − 1) df of its spectrum.
fn typical_autocovariance(lags: usize, period_s: f64) -> [f64; LAGS] {
    const STEP_HZ: f64 = 0.02;
    let (sigma, tau_s) = (TYPICAL_VOLUNTARY_MM_S2, TYPICAL_LAG_S);
    let (tremor, noise) = (TYPICAL_TREMOR_MM, TYPICAL_NOISE_MM);
    let mut covariance = [0.0; LAGS];
    for n in 1..1250 {
        let f = f64::from(n) * STEP_HZ;
        let w = 2.0 * std::f64::consts::PI * f;
        let lag = 1.0 + (w * tau_s) * (w * tau_s);
        let voluntary_psd = sigma * sigma * 4.0 * tau_s / (lag * lag) / (w * w * w * w);
        let tremor_psd =
            if f >= BAND_HZ.0 && f <= BAND_HZ.1 { tremor * tremor / (BAND_HZ.1 - BAND_HZ.0) } else { 0.0 };
        for (lag, value) in covariance.iter_mut().enumerate().take(lags) {
            *value += (voluntary_psd + tremor_psd) * STEP_HZ * (libm::cos(w * lag as f64 * period_s) - 1.0);
        }
    }
    covariance[0] += noise * noise;
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bends of a path at field `n`, and what it moves over the fields before or after it beyond going on.
    fn bends<const L: usize>(tip: impl Fn(i64) -> Vector3<f64>, n: i64) -> [Vector3<f64>; L] {
        std::array::from_fn(|k| {
            let k = k as i64;
            tip(n - k) - 2.0 * tip(n - k - 1) + tip(n - k - 2)
        })
    }

    fn beyond(tip: impl Fn(i64) -> Vector3<f64>, from: i64, fields: i64) -> Vector3<f64> {
        tip(from + fields) - tip(from) - (tip(from) - tip(from - 1)) * fields as f64
    }

    fn update<const L: usize>(
        predictor: &mut RlsPredictor<L>,
        tip: impl Fn(i64) -> Vector3<f64> + Copy,
        n: i64,
    ) {
        let moved = std::array::from_fn(|h| {
            let h = h as i64 + 1;
            Some(beyond(tip, n - h, h))
        });
        predictor.learn(&moved);
        predictor.observe(&bends(tip, n));
    }

    fn check<const L: usize>(predictor: &RlsPredictor<L>, tip: impl Fn(i64) -> Vector3<f64> + Copy, n: i64) {
        for (h, ahead) in predictor.predict(&bends(tip, n)).iter().enumerate() {
            let truth = beyond(tip, n, h as i64 + 1);
            assert!((ahead - truth).norm() < 1e-3, "{h}: {ahead} {truth}");
        }
    }

    fn sine(n: i64) -> Vector3<f64> {
        let t = n as f64 * 0.02;
        Vector3::new((58.0 * t).sin(), 0.7 * (58.0 * t).cos(), 0.3 * (58.0 * t + 1.0).sin()) * 0.05
    }

    #[test]
    fn a_sine_is_predicted_after_a_while() {
        let mut predictor = RlsPredictor::<8>::new(0.02, 0.0);
        (10..300).for_each(|n| update(&mut predictor, sine, n));
        check(&predictor, sine, 300);
    }

    #[test]
    fn an_hour_of_tremor_leaves_it_as_good() {
        let mut predictor = RlsPredictor::<36>::new(0.02, 0.0);
        (50..180_000).for_each(|n| update(&mut predictor, sine, n));
        check(&predictor, sine, 180_000);
    }

    #[test]
    fn a_hundred_thousand_fields_of_a_hand_leave_the_errors_as_they_were() {
        let mut predictor = RlsPredictor::<36>::new(0.02, 30.0);
        let hand = |n: i64| crate::adverse::hand(n as u64);
        let mut rms = Vec::new();
        let mut sum = 0.0;
        for n in 50..100_050 {
            let miss = predictor.predict(&bends(hand, n))[2] - beyond(hand, n, 3);
            sum += miss.norm_squared();
            update(&mut predictor, hand, n);
            if n % 2_000 == 0 {
                rms.push((sum / 2_000.0_f64).sqrt());
                sum = 0.0;
            }
        }
        assert!(rms[1..].iter().all(|r| *r < 1.1 * rms[1]), "{rms:?}");
    }

    #[test]
    fn a_movement_that_begins_is_predicted_though_only_tremor_was_seen() {
        let begins = |n: i64| {
            let t = (n - 400).max(0) as f64 * 0.02;
            sine(n) + Vector3::new(60.0 * t * t, 0.0, 0.0)
        };
        let miss_mm = |swing: f64| {
            let mut predictor = RlsPredictor::<8>::new(0.02, swing);
            (10..409).for_each(|n| update(&mut predictor, begins, n));
            (predictor.predict(&bends(begins, 410))[2] - beyond(begins, 410, 3)).norm()
        };
        let [with, without] = [100.0, 0.0].map(miss_mm);
        assert!(with < 0.06 && with < 0.5 * without, "{with} mm, without {without} mm");
    }

    #[test]
    fn no_excitation_winds_nothing_up() {
        let mut predictor = RlsPredictor::<8>::new(0.02, 0.0);
        let still = [Vector3::zeros(); 8];
        for _ in 0..20_000 {
            predictor.learn(&[Some(Vector3::zeros()); HORIZONS]);
            predictor.observe(&still);
        }
        assert!(predictor.is_valid());
        assert!(predictor.predict(&[Vector3::new(0.01, 0.0, 0.0); 8]).iter().all(|d| d.norm() < 0.4));
    }
}
