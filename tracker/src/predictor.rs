//! Prediction of an instrument's tip, in the form that `protocol::predict` evaluates at any
//! instant.
//!
//! The predictors work on a grid of 20 ms, whatever the rate of the cameras; the filter gives the tip at its points.
//!
//! Three adaptive linear predictors (see [`crate::rls_predictor`]) use the last 8, 24 and 36 bends of the
//! path: few adapt fast, many resolve several frequencies of a tremor. Their predictions of the tip at the
//! next four fields are mixed with the filter's own, with weights from their recent errors. A movement of
//! velocity, decaying acceleration and two oscillators interpolates these, the present tip and that of one
//! field before: with oscillators at 8 and 12 Hz it follows everything from 0 to 13 Hz within 4 %.

use crate::checkpoint::{Done, Loader, Saver};
use crate::rls_predictor::{HORIZONS, RlsPredictor};
use nalgebra::{SMatrix, Vector3};
use protocol::limits::{FIELD_PERIOD_NS, OSCILLATORS};
use protocol::poses::{Oscillator, Predictor};

/// Bends that the predictors use.
const SHORT: usize = 12;
const MIDDLE: usize = 24;
const LONG: usize = 36;
/// How many predictions are mixed; the filter's own is the last and uses none.
const PREDICTIONS: usize = 4;
const BENDS: [usize; PREDICTIONS] = [SHORT, MIDDLE, LONG, 0];
/// Acceleration of the slow movements that each predictor learns beside what it sees, mm/s². They cost
/// precision in tremor, for which the longer ones are; more than this costs it with real hands too.
const SWING_MM_S2: [f64; 3] = [30.0, 0.0, 0.0];
/// Gain of the running squared error of a prediction.
const FORGETTING: f64 = 0.1;
/// Squared error below which a predictor counts as exact, mm².
const NEGLIGIBLE_MM2: f64 = 1e-8;
/// A tip within this of the grid of fields shifts the grid, ns; genlocked cameras jitter less.
const JITTER_NS: u64 = 500_000;
/// Most missing fields that the filter fills in.
const MAX_FILL: u64 = 3;

/// Frequencies of the interpolating oscillators, Hz.
const OSCILLATORS_HZ: [f64; OSCILLATORS] = [8.0, 12.0];
/// Time constant of the interpolating acceleration, s.
const ACCELERATION_TAU_S: f64 = 0.3;
/// Nodes of the interpolation: one field before, and the horizons.
const NODES: usize = HORIZONS + 1;
/// Parameters of the interpolation: velocity, acceleration, two of each oscillator.
const PARAMETERS: usize = 2 + 2 * OSCILLATORS;
type Interpolation = SMatrix<f64, PARAMETERS, NODES>;
/// Ridge of the interpolation, mm²: small, so that the nodes are met.
const NODE_RIDGE: f64 = 1e-4;

/// The tip at a point of the grid of fields.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Sample {
    tip: Vector3<f64>,
    measured: bool,
}

/// Samples after which a predictor that uses so many bends is mixed in: its errors are known then.
const fn proven_after(bends: usize) -> usize {
    bends + 2 + HORIZONS
}

/// Predicts the tip of one instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct TipPredictor {
    short: RlsPredictor<SHORT>,
    middle: RlsPredictor<MIDDLE>,
    long: RlsPredictor<LONG>,
    /// Running squared errors of the predictions, by horizon, mm².
    errors: [[f64; PREDICTIONS]; HORIZONS],
    /// Predicted tips of the last fields, newest first.
    predictions: [[[Vector3<f64>; PREDICTIONS]; HORIZONS]; HORIZONS],
    /// Newest first.
    samples: [Sample; LONG + 2],
    count: usize,
    /// Instant of the newest sample, ns.
    time_ns: u64,
    /// The middle and the long predictor have learnt from the newest sample, but their covariances have not. No
    /// prediction before the next sample depends on those.
    owed: [bool; 2],
    /// The interpolation where the newest sample is at the frame's instant.
    on_grid: Interpolation,
}

impl Default for TipPredictor {
    fn default() -> Self {
        let period_s = FIELD_PERIOD_NS as f64 * 1e-9;
        TipPredictor {
            short: RlsPredictor::new(period_s, SWING_MM_S2[0]),
            middle: RlsPredictor::new(period_s, SWING_MM_S2[1]),
            long: RlsPredictor::new(period_s, SWING_MM_S2[2]),
            errors: [[NEGLIGIBLE_MM2; PREDICTIONS]; HORIZONS],
            predictions: [[[Vector3::zeros(); PREDICTIONS]; HORIZONS]; HORIZONS],
            samples: [Sample::default(); LONG + 2],
            count: 0,
            time_ns: 0,
            owed: [false; 2],
            on_grid: interpolation(&node_times(0.0)),
        }
    }
}

impl TipPredictor {
    /// Writes all but the interpolation, which is always the same. Nothing is owed.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let TipPredictor { short, middle, long, errors, predictions, samples, .. } = self;
        let TipPredictor { count, time_ns, on_grid: _, .. } = self;
        short.save(out)?;
        middle.save(out)?;
        long.save(out)?;
        out.numbers(errors.iter().flatten())?;
        out.numbers(predictions.iter().flatten().flatten().flatten())?;
        for Sample { tip, measured } in samples {
            out.numbers(tip)?;
            out.put(measured)?;
        }
        out.put(&[*count as u64, *time_ns])
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        self.short.load(from)?;
        self.middle.load(from)?;
        self.long.load(from)?;
        from.numbers(self.errors.iter_mut().flatten())?;
        from.numbers(self.predictions.iter_mut().flatten().flatten().flatten())?;
        for Sample { tip, measured } in &mut self.samples {
            from.numbers(tip)?;
            *measured = from.take()?;
        }
        self.count = from.below(proven_after(LONG) as u64 + 2)? as usize;
        self.time_ns = from.count()?;
        Ok(())
    }

    /// Starts a new sequence after a loss or a jump; the weights are kept.
    pub fn interrupt(&mut self) {
        self.count = 0;
        self.short.interrupt();
        self.middle.interrupt();
        self.long.interrupt();
    }

    /// Takes the newest sample into the covariances of the middle and the long predictor, where that is not yet done.
    /// True if one of them was no longer a covariance, and all were reset.
    pub fn follow_up(&mut self) -> bool {
        let [middle, long] = std::mem::take(&mut self.owed);
        if middle {
            self.middle.observe(&self.bends());
        }
        if long {
            self.long.observe(&self.bends());
        }
        let valid = (!middle || self.middle.is_valid()) && (!long || self.long.is_valid());
        if !valid {
            self.begin_anew();
        }
        !valid
    }

    /// Resets itself if something that it has learnt is not finite: a prediction can always be made from
    /// the filter alone, so nothing is withheld for its sake. True if it did.
    pub fn recover(&mut self) -> bool {
        let learnt = self.short.is_valid() && self.middle.is_finite() && self.long.is_finite();
        let errors = self.errors.iter().flatten().all(|e| e.is_finite());
        let tips = self.predictions.iter().flatten().flatten().chain(self.samples.iter().map(|s| &s.tip));
        let valid = learnt && errors && tips.flat_map(|tip| tip.iter()).all(|v| v.is_finite());
        if !valid {
            // As its counts stand after any sample.
            self.follow_up();
            self.begin_anew();
        }
        !valid
    }

    #[cold]
    fn begin_anew(&mut self) {
        self.short.restart();
        self.middle.restart();
        self.long.restart();
        self.errors = [[NEGLIGIBLE_MM2; PREDICTIONS]; HORIZONS];
        self.predictions = [[[Vector3::zeros(); PREDICTIONS]; HORIZONS]; HORIZONS];
        self.samples = [Sample::default(); LONG + 2];
        self.count = 0;
    }

    /// Steps of the grid from its newest sample to a frame of cameras of that period: to the nearest point of the
    /// grid, or, where frames are closer than its points, to the last that they have passed.
    fn steps_to(&self, exposed_ns: u64, period_ns: u64) -> u64 {
        let since_ns = exposed_ns.saturating_sub(self.time_ns);
        if period_ns < FIELD_PERIOD_NS {
            return (since_ns + JITTER_NS) / FIELD_PERIOD_NS;
        }
        libm::round(since_ns as f64 / FIELD_PERIOD_NS as f64) as u64
    }

    /// Adds the tip at `exposed_ns`, a frame of cameras of that period; `tip_after` returns the tip at instants
    /// relative to that, s. True if it was taken: one between two points of the grid is not.
    pub fn observe(
        &mut self,
        exposed_ns: u64,
        period_ns: u64,
        measured: bool,
        tip_after: impl Fn(f64) -> Vector3<f64>,
    ) -> bool {
        let fields = self.steps_to(exposed_ns, period_ns);
        if self.count > 0 && fields == 0 && exposed_ns >= self.time_ns {
            return false;
        }
        if self.count == 0 && !measured {
            return false;
        }
        if self.count == 0 || exposed_ns <= self.time_ns || fields > MAX_FILL {
            self.interrupt();
            self.time_ns = exposed_ns.saturating_sub(FIELD_PERIOD_NS);
        }
        for left in (0..fields.clamp(1, MAX_FILL)).rev() {
            self.time_ns += FIELD_PERIOD_NS;
            if left == 0 && self.time_ns.abs_diff(exposed_ns) < JITTER_NS {
                self.time_ns = exposed_ns;
            }
            let dt = self.time_ns.wrapping_sub(exposed_ns) as i64 as f64 * 1e-9;
            let filtered =
                std::array::from_fn(|h| tip_after(dt + (h + 1) as f64 * FIELD_PERIOD_NS as f64 * 1e-9));
            self.push(Sample { tip: tip_after(dt), measured: measured && left == 0 }, filtered);
        }
        true
    }

    fn push(&mut self, sample: Sample, filtered: [Vector3<f64>; HORIZONS]) {
        self.follow_up();
        self.samples.rotate_right(1);
        self.samples[0] = sample;
        self.count = (self.count + 1).min(proven_after(LONG) + 1);
        let moved = std::array::from_fn(|h| {
            let [then, before] = [self.samples[h + 1], self.samples[h + 2]];
            let all = sample.measured && then.measured && before.measured && self.count > h + 2;
            all.then(|| sample.tip - then.tip - (then.tip - before.tip) * (h + 1) as f64)
        });
        if self.count > SHORT + 1 {
            self.update_errors(&sample);
            self.short.learn(&moved);
            self.short.observe(&self.bends());
        }
        self.owed = [MIDDLE, LONG].map(|bends| self.count > bends + 1);
        if self.owed[0] {
            self.middle.learn(&moved);
        }
        if self.owed[1] {
            self.long.learn(&moved);
        }
        self.predictions.rotate_right(1);
        self.predictions[0] = self.predict(&filtered);
    }

    /// Updates the running errors with the predictions for this field.
    fn update_errors(&mut self, sample: &Sample) {
        if !sample.measured {
            return;
        }
        for h in 0..HORIZONS {
            for (k, bends) in BENDS.iter().enumerate() {
                // A mean at first, so that the start is forgotten.
                let seen = self.count.saturating_sub(bends + h + 2);
                if seen > 0 {
                    let missed = (sample.tip - self.predictions[h][h][k]).norm_squared();
                    self.errors[h][k] += (missed - self.errors[h][k]) * FORGETTING.max(1.0 / seen as f64);
                }
            }
        }
    }

    fn bends<const L: usize>(&self) -> [Vector3<f64>; L] {
        let step = |k: usize| self.samples[k].tip - self.samples[k + 1].tip;
        std::array::from_fn(|k| step(k) - step(k + 1))
    }

    fn predict(&self, filtered: &[Vector3<f64>; HORIZONS]) -> [[Vector3<f64>; PREDICTIONS]; HORIZONS] {
        let tip = self.samples[0].tip;
        let (short, middle) = (self.short.predict(&self.bends()), self.middle.predict(&self.bends()));
        let long = self.long.predict(&self.bends());
        let step = tip - self.samples[1].tip;
        std::array::from_fn(|h| {
            let straight = tip + step * (h + 1) as f64;
            [straight + short[h], straight + middle[h], straight + long[h], filtered[h]]
        })
    }

    /// The tips at the next four fields; `None` until there are enough samples.
    fn ahead(&self) -> Option<[Vector3<f64>; HORIZONS]> {
        if self.count <= proven_after(SHORT) {
            return None;
        }
        Some(std::array::from_fn(|h| {
            let mut weights = self.errors[h].map(|e| {
                // The square: who errs half as much weighs 16 times as much.
                let precision = NEGLIGIBLE_MM2 / e.max(NEGLIGIBLE_MM2);
                precision * precision
            });
            for (weight, _) in weights
                .iter_mut()
                .zip(BENDS)
                .filter(|(_, bends)| *bends > 0 && self.count <= proven_after(*bends))
            {
                *weight = 0.0;
            }
            let sum: f64 = weights.iter().sum();
            let mix = self.predictions[0][h].iter().zip(weights);
            mix.fold(Vector3::zeros(), |mean, (tip, weight)| mean + tip * (weight / sum))
        }))
    }

    /// Writes the prediction into `predictor`, for a frame of `exposed_ns`; `tip_after` returns the
    /// filter's tip, which is used alone until there are enough samples.
    pub fn write_to(
        &self,
        exposed_ns: u64,
        tip_after: impl Fn(f64) -> Vector3<f64>,
        predictor: &mut Predictor,
    ) {
        let period = FIELD_PERIOD_NS as f64 * 1e-9;
        let mut offset = self.time_ns.wrapping_sub(exposed_ns) as i64 as f64 * 1e-9;
        let adaptive = self.ahead().filter(|_| offset.abs() < period);
        if adaptive.is_none() {
            offset = 0.0;
        }
        let now = tip_after(0.0);
        let times = node_times(offset);
        let ahead = adaptive.unwrap_or_else(|| std::array::from_fn(|h| tip_after(times[h + 1])));
        let before = if adaptive.is_some() { self.samples[1].tip } else { tip_after(times[0]) };
        let nodes: [Vector3<f64>; NODES] =
            std::array::from_fn(|n| if n == 0 { before } else { ahead[n - 1] } - now);
        let fit = if offset == 0.0 { self.on_grid } else { interpolation(&times) };
        write(&fit, &nodes, predictor);
    }
}

/// Instants of the nodes relative to the frame, s.
fn node_times(offset: f64) -> [f64; NODES] {
    let period = FIELD_PERIOD_NS as f64 * 1e-9;
    std::array::from_fn(|n| offset + period * if n == 0 { -1.0 } else { n as f64 })
}

/// The linear map from tips at `times` (s) to the parameters of least norm of a movement through
/// them.
fn interpolation(times: &[f64; NODES]) -> Interpolation {
    // Typical sizes of the parameters, mm/s and so on, relative to each other.
    let sizes: [f64; PARAMETERS] = [100.0, 1000.0, 1.0, 60.0, 1.0, 60.0];
    let basis = SMatrix::<f64, NODES, PARAMETERS>::from_fn(|n, p| sizes[p] * basis(times[n], p));
    let system = basis * basis.transpose() + SMatrix::<f64, NODES, NODES>::identity() * NODE_RIDGE;
    let inverse = system.cholesky().map_or_else(SMatrix::zeros, |s| s.inverse());
    let map = basis.transpose() * inverse;
    Interpolation::from_fn(|p, n| sizes[p] * map[(p, n)])
}

fn write(fit: &Interpolation, nodes: &[Vector3<f64>; NODES], predictor: &mut Predictor) {
    let parameter = |p: usize| -> [f64; 3] {
        nodes.iter().enumerate().fold(Vector3::zeros(), |sum, (n, node)| sum + node * fit[(p, n)]).into()
    };
    predictor.velocity_mm_s = parameter(0);
    predictor.acceleration_mm_s2 = parameter(1);
    predictor.acceleration_tau_s = ACCELERATION_TAU_S;
    for (i, slot) in predictor.oscillators.iter_mut().enumerate() {
        *slot = Oscillator {
            omega_rad_s: omega(i),
            damping: 0.0,
            position_mm: parameter(2 + 2 * i),
            velocity_mm_s: parameter(3 + 2 * i),
        };
    }
}

fn omega(oscillator: usize) -> f64 {
    2.0 * std::f64::consts::PI * OSCILLATORS_HZ[oscillator]
}

/// Displacement by a unit of parameter `p` after `t` seconds, as in `protocol::predict`.
fn basis(t: f64, p: usize) -> f64 {
    let tau = ACCELERATION_TAU_S;
    match p {
        0 => t,
        1 => tau * (t - tau * (1.0 - libm::exp(-t / tau))),
        _ if p.is_multiple_of(2) => libm::cos(omega(p / 2 - 1) * t) - 1.0,
        _ => libm::sin(omega(p / 2 - 1) * t) / omega(p / 2 - 1),
    }
}

#[cfg(test)]
mod tests;
