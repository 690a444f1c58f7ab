//! The filter of an instrument: one Kalman filter of the voluntary movement of its tip, the tremor
//! added to it, the play of the shaft in the trocar and the roll.
//!
//! The shaft passes the trocar, so a moving tip turns the shaft: with the tip p, the pivot Q = T +
//! m (T the trocar as the eye carries it, m the play) and L = |Q − p|, the axis is d = (Q − p)/L,
//! and a small change turns the body by δθ = d × (δm − δp)/L + d·δρ (ρ the roll). One camera that
//! sees the shaft therefore observes the depth of the tip along its own line of sight.
//!
//! States, each a vector in the world: the voluntary movement (x, v, a and its lags); the tremor in
//! bands from 6 to 14 Hz, whose displacements add up (each adapts its variance to its own state, as
//! expectation–maximisation does; see [`crate::tremor_bank`]); the play (m, m'). Then the roll (ρ, ρ', ρ''), a Singer model,
//! with a small bank of its own. A measurement is a pose with its covariance *after* the prior went
//! in (see `fit`); the rest of the state follows by its regression on the pose.

mod adaptation;
mod directed;
mod insertion;
mod motion;
mod onset;
mod pivot;
mod saved;
mod start;
mod transition;

use crate::block_matrix::{self, add_block, product, transpose};
use crate::constants as k;
use crate::pose_math::{Matrix6, box_minus, exp};
use crate::rig_model::BodyModel;
use crate::tremor_bank::{self, PAIRS, TremorBank};
use crate::tuning::Tuning;
use adaptation::Nis;
use directed::{Directed, add_noise_of};
use insertion::Insertion;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use onset::{Innovation, Onsets};
pub use pivot::Pivot;
pub use start::Hand;
use transition::{PLAY_MODEL, StateTransition, roll_model, roll_tremor_model, voluntary_model};

/// Number of vector states: voluntary movement, tremor, play.
const VECTORS: usize = PLAY + 2;
const TREMOR: usize = crate::motion_models::VOLUNTARY;
const PLAY: usize = TREMOR + 2 * PAIRS;
/// First row of the roll in the covariance.
const ROLL: usize = 3 * VECTORS;
const ROLL_TREMOR: usize = ROLL + 3;
const ROLL_TREMORS: usize = k::ROLL_TREMOR_HZ.len();
const N: usize = ROLL_TREMOR + 2 * ROLL_TREMORS;

type Row = block_matrix::Row<N>;
type Columns = block_matrix::Columns<N>;

/// State of an instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct InstrumentFilter {
    vectors: [Vector3<f64>; VECTORS],
    roll_rate: f64,
    roll_acceleration: f64,
    roll_tremor: [[f64; 2]; ROLL_TREMORS],
    rotation: UnitQuaternion<f64>,
    pivot: Pivot,
    hand: Hand,
    /// Variance of the voluntary acceleration, mm²/s⁴.
    voluntary_variance: Directed,
    /// Running ratio of the NIS to its expectation.
    nis_ratio: f64,
    onsets: Onsets,
    covariance: [Row; N],
    /// P·Hᵀ, covariance of the whole state with the pose, and the pose's own: many ask for them, between changes of
    /// the state that are few ([`InstrumentFilter::renew_cross`]).
    cross: Columns,
    pose_covariance: Matrix6,
    /// Instant of the state, ns.
    pub time_ns: u64,
    tuning: Tuning,
    bank: TremorBank,
    /// Gain of the running ratio.
    nis_gain: f64,
    /// Instant from which the hand counts as known, ns.
    hand_known_ns: u64,
}

impl InstrumentFilter {
    /// An instrument just acquired at `pose`; `hand` is what was learnt before it was lost, if it was tracked before. Without
    /// a pivot the shaft turns about a free point.
    pub fn new(
        pose: &Isometry3<f64>,
        pose_covariance: &Matrix6,
        pivot: Option<Pivot>,
        time_ns: u64,
        model: &BodyModel,
        hand: Option<Hand>,
    ) -> Self {
        let tuning = model.tuning;
        let axis = pose.rotation * Vector3::z();
        let tip = pose.translation.vector;
        let free = Pivot { position: tip + axis * k::FREE_PIVOT_MM, sigma: k::FREE_PLAY_MM, tracked: false };
        let pivot = pivot.filter(|p| axis.dot(&(p.position - tip)) > k::SHORTEST_LEVER_MM).unwrap_or(free);
        let to_pivot = pivot.position - tip;
        let lever = axis.dot(&to_pivot);
        let mut filter = InstrumentFilter {
            vectors: [Vector3::zeros(); VECTORS],
            roll_rate: 0.0,
            roll_acceleration: 0.0,
            roll_tremor: [[0.0; 2]; ROLL_TREMORS],
            rotation: pose.rotation,
            pivot,
            hand: hand.unwrap_or_default(),
            voluntary_variance: Directed::even(tuning.voluntary_mm_s2 * tuning.voluntary_mm_s2),
            nis_ratio: 1.0,
            onsets: Onsets::new(),
            covariance: [[0.0; N]; N],
            cross: [[0.0; N]; 6],
            pose_covariance: Matrix6::zeros(),
            time_ns,
            tuning,
            bank: TremorBank::new(tuning.tremor_ripple_db),
            nis_gain: model.at_rate.nis_ratio_gain,
            hand_known_ns: time_ns.saturating_add(if hand.is_some() { 0 } else { k::UNKNOWN_HAND_NS }),
        };
        filter.vectors[0] = tip;
        filter.vectors[PLAY] = axis * lever - to_pivot;
        filter.scale_tremor();
        filter.start_covariance(pose_covariance, &axis, lever, hand.is_some());
        filter.renew_cross();
        filter
    }

    /// `world_from_body`.
    pub fn pose(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(tip_of(&self.vectors)), self.rotation)
    }

    /// Velocity of the tip, tremor included, mm/s, and angular velocity, rad/s; world.
    pub fn motion(&self) -> [Vector3<f64>; 2] {
        let velocity = self.velocity();
        let (axis, lever) = self.shaft();
        let turning = axis.cross(&(self.vectors[PLAY + 1] - velocity)) / lever;
        let rolling = self.roll_tremor.iter().fold(self.roll_rate, |sum, x| sum + x[1]);
        let turning = turning + axis * rolling;
        [velocity, turning]
    }

    fn velocity(&self) -> Vector3<f64> {
        let pairs = self.vectors[TREMOR..PLAY].chunks_exact(2).enumerate();
        pairs.fold(self.vectors[1], |sum, (pair, z)| {
            let [real, imaginary] = self.bank.velocity(pair);
            sum + z[0] * real + z[1] * imaginary
        })
    }

    /// Distance of the shaft from its trocar, mm; 0 where the trocar is unknown.
    pub fn play(&self) -> f64 {
        if self.pivot.tracked { self.vectors[PLAY].norm() } else { 0.0 }
    }

    /// Direction of the shaft, from the tip on.
    fn axis(&self) -> Vector3<f64> {
        self.rotation * Vector3::z()
    }

    /// Direction from tip to pivot, and their distance, mm.
    fn shaft(&self) -> (Vector3<f64>, f64) {
        let to_pivot = self.pivot.position + self.vectors[PLAY] - tip_of(&self.vectors);
        let lever = to_pivot.norm().max(k::SHORTEST_LEVER_MM);
        (self.axis(), lever)
    }

    /// The predicted pose `dt` seconds after (or before) the state's instant.
    pub fn pose_after(&self, dt: f64) -> Isometry3<f64> {
        let mut ahead = (self.vectors, self.rotation, self.roll_tremor);
        if dt != 0.0 {
            let step = StateTransition::new(dt, &self.tuning, &self.bank);
            ahead = self.propagated(&step, self.insertion(&step, &self.pivot).as_ref(), &self.pivot);
        }
        Isometry3::from_parts(Translation3::from(tip_of(&ahead.0)), ahead.1)
    }

    fn propagated(
        &self,
        step: &StateTransition,
        insertion: Option<&Insertion>,
        pivot: &Pivot,
    ) -> ([Vector3<f64>; VECTORS], UnitQuaternion<f64>, [[f64; 2]; ROLL_TREMORS]) {
        let mut vectors = self.vectors;
        insertion.iter().for_each(|i| i.apply_to_vectors(0, &mut vectors));
        step.apply_to_vectors(&mut vectors);
        insertion.iter().for_each(|i| i.apply_to_vectors(1, &mut vectors));
        let axis = self.axis();
        let mut roll = self.roll_rate * step.roll[0][1] + self.roll_acceleration * step.roll[0][2];
        let mut tremor = self.roll_tremor;
        for (x, f) in tremor.iter_mut().zip(&step.roll_tremor) {
            let now = x[0];
            *x = [f[0][0] * x[0] + f[0][1] * x[1], f[1][0] * x[0] + f[1][1] * x[1]];
            roll += x[0] - now;
        }
        let rotation = aligned(exp(axis * roll) * self.rotation, &vectors, pivot);
        (vectors, rotation, tremor)
    }

    /// Predicts the state at `time_ns`, where the trocar is at `pivot`; an earlier instant changes
    /// nothing. Without a pivot the last one is kept with more play.
    pub fn predict(&mut self, time_ns: u64, pivot: Option<Pivot>) {
        let whole_ns = time_ns.saturating_sub(self.time_ns);
        if whole_ns == 0 {
            return;
        }
        self.adapt_variances(whole_ns as f64 * 1e-9);
        let steps = whole_ns.div_ceil(k::LONGEST_STEP_NS);
        let dt = whole_ns as f64 * 1e-9 / steps as f64;
        let step = StateTransition::new(dt, &self.tuning, &self.bank);
        let was_free = !self.pivot.tracked;
        let target = self.next_pivot(pivot);
        if was_free {
            self.onsets = Onsets::new();
        }
        if was_free && target.tracked {
            self.start_inside();
        }
        for i in 1..=steps {
            if i == steps {
                self.pivot = target;
            }
            self.scale_tremor();
            let insertion = self.insertion(&step, &self.pivot);
            if target.tracked {
                let axis = self.axis();
                self.onsets.propagate(&step, insertion.as_ref(), &axis, dt);
            }
            (self.vectors, self.rotation, self.roll_tremor) =
                self.propagated(&step, insertion.as_ref(), &self.pivot);
            self.roll_rate += self.roll_acceleration * step.roll[1][2];
            self.roll_acceleration *= step.roll[2][2];
            self.predict_covariance(&step, insertion.as_ref(), dt);
        }
        self.mirror();
        self.renew_cross();
        self.time_ns = time_ns;
    }

    /// P ← F·P·Fᵀ + Q.
    fn predict_covariance(&mut self, step: &StateTransition, insertion: Option<&Insertion>, dt: f64) {
        // Rows, then columns.
        for _ in 0..2 {
            insertion.iter().for_each(|i| i.apply(0, &mut self.covariance));
            step.apply(&mut self.covariance);
            insertion.iter().for_each(|i| i.apply(1, &mut self.covariance));
            transpose(&mut self.covariance);
        }
        self.add_noise(step, dt);
    }

    fn add_noise(&mut self, step: &StateTransition, dt: f64) {
        let acceleration = self.voluntary_variance.covariance(&self.axis());
        let play = PLAY_MODEL.noise(&step.play, self.pivot.sigma * self.pivot.sigma);
        let p = &mut self.covariance;
        for axis in 0..3 {
            add_block(p, [3 * PLAY + axis, 3 * PLAY + 3 + axis], &play);
        }
        add_noise_of(p, &acceleration, &voluntary_model(&self.tuning).noise(dt));
        add_block(p, [ROLL, ROLL + 1, ROLL + 2], &roll_model(&self.tuning).noise(dt));
        for (i, f) in step.roll_tremor.iter().enumerate() {
            let first = ROLL_TREMOR + 2 * i;
            add_block(
                p,
                [first, first + 1],
                &roll_tremor_model(i).noise(f, self.hand.roll_tremor_variance[i]),
            );
        }
        self.add_tremor(self.hand.tremor_variance, |bank, i, j| bank.noise(&step.tremor, i, j));
    }

    /// Adds to the covariance of the tremor's states, for each two pole pairs of a band, what `of` gives for a
    /// band of variance 1, times the variance of the band.
    fn add_tremor(
        &mut self,
        variances: [f64; tremor_bank::BANDS],
        of: impl Fn(&TremorBank, usize, usize) -> tremor_bank::Block,
    ) {
        for (range, variance) in tremor_bank::ranges().zip(variances) {
            for i in range.clone() {
                for j in range.clone() {
                    let block = of(&self.bank, i, j).map(|row| row.map(|v| v * variance));
                    for axis in 0..3 {
                        for (r, row) in block.iter().enumerate() {
                            for (c, v) in row.iter().enumerate() {
                                let (at_r, at_c) = (TREMOR + 2 * i + r, TREMOR + 2 * j + c);
                                self.covariance[3 * at_r + axis][3 * at_c + axis] += v;
                            }
                        }
                    }
                }
            }
        }
    }

    /// Computes what the state and its covariance say of the pose; after every change of them.
    fn renew_cross(&mut self) {
        let (axis, lever) = self.shaft();
        for (r, row) in self.covariance.iter().enumerate() {
            let (tip, turn) = pose_part(row, &axis, lever);
            for i in 0..3 {
                self.cross[i][r] = tip[i];
                self.cross[3 + i][r] = turn[i];
            }
        }
        let mut pose = Matrix6::zeros();
        for (c, column) in self.cross.iter().enumerate() {
            let (tip, turn) = pose_part(column, &axis, lever);
            for i in 0..3 {
                pose[(i, c)] = tip[i];
                pose[(3 + i, c)] = turn[i];
            }
        }
        self.pose_covariance = (pose + pose.transpose()) * 0.5;
    }

    /// What it has learnt of the hand.
    pub fn hand(&self) -> Hand {
        self.hand
    }

    /// Covariance of the pose.
    pub fn pose_covariance(&self) -> Matrix6 {
        self.pose_covariance
    }

    /// Updates the state with the pose of maximum posterior and its covariance. `prior_inverse` is
    /// the inverse of [`InstrumentFilter::pose_covariance`]. False, with nothing changed, where the
    /// result would not be finite.
    pub fn update(
        &mut self,
        posterior: &Isometry3<f64>,
        covariance: &Matrix6,
        prior_inverse: &Matrix6,
    ) -> bool {
        let delta = box_minus(posterior, &self.pose());
        let (tip, tip_prior) = (delta.fixed_rows::<3>(0), self.pose_covariance.fixed_view::<3, 3>(0, 0));
        let of_tip = tip_prior.cholesky().map_or(0.0, |prior| tip.dot(&prior.solve(&tip)));
        let gain = product(&self.cross, prior_inverse);
        let shrink = self.pose_covariance - covariance;
        let weighted = product(&gain, &shrink);
        let mut change = [0.0; N];
        let mut left: Row = std::array::from_fn(|r| self.covariance[r][r]);
        for ((gain, weighted), delta) in gain.iter().zip(&weighted).zip(delta.iter()) {
            for r in 0..N {
                change[r] += gain[r] * delta;
                left[r] -= gain[r] * weighted[r];
            }
        }
        // Also false where something is not a number.
        if !(change.iter().all(|v| v.is_finite()) && left.iter().all(|v| *v >= 0.0)) {
            return false;
        }
        let innovation = Innovation { delta: &delta, prior_inverse, shrink: &shrink, weighted: &weighted };
        let withdrawal = self.find_withdrawal(&innovation);
        self.shrink(&gain, &weighted);
        self.shift(&change);
        if let Some(withdrawal) = &withdrawal {
            self.follow_withdrawal(withdrawal);
        }
        self.rotation = aligned(posterior.rotation, &self.vectors, &self.pivot);
        self.renew_cross();
        if withdrawal.is_some() {
            return true;
        }
        let nis = Nis { all: delta.dot(&(prior_inverse * delta)), of_tip };
        self.adapt_to_nis(nis, (prior_inverse * shrink).trace());
        true
    }

    /// Adds a change to the state but for the roll's angle, which is the rotation's.
    fn shift(&mut self, change: &Row) {
        for (vector, change) in self.vectors.iter_mut().zip(change.chunks_exact(3)) {
            *vector += Vector3::from_column_slice(change);
        }
        self.roll_rate += change[ROLL + 1];
        self.roll_acceleration += change[ROLL + 2];
        for (x, change) in self.roll_tremor.iter_mut().flatten().zip(&change[ROLL_TREMOR..]) {
            *x += change;
        }
    }

    /// P ← P − (gain·shrink)·gainᵀ: the lower triangle, then mirrored.
    #[expect(clippy::needless_range_loop, reason = "rows and columns are one matrix")]
    fn shrink(&mut self, gain: &Columns, weighted: &Columns) {
        let [a, b, c, d, e, f] = gain;
        for r in 0..N {
            let w: [f64; 6] = std::array::from_fn(|i| weighted[i][r]);
            let row = &mut self.covariance[r];
            for q in 0..=r {
                row[q] -= w[0] * a[q] + w[1] * b[q] + w[2] * c[q] + w[3] * d[q] + w[4] * e[q] + w[5] * f[q];
            }
        }
        self.mirror();
    }

    /// Copies the lower triangle of the covariance into the upper one: what rounding makes of the two
    /// differs.
    fn mirror(&mut self) {
        for r in 1..N {
            for q in 0..r {
                self.covariance[q][r] = self.covariance[r][q];
            }
        }
    }

    /// Inflates the covariance of the tip's movement: the blobs are beside their markers, so the
    /// instrument manoeuvres.
    pub fn inflate_covariance(&mut self) {
        for (vector, sigma) in k::INFLATION.into_iter().enumerate() {
            for axis in 3 * vector..3 * vector + 3 {
                self.covariance[axis][axis] += sigma * sigma;
            }
        }
        self.renew_cross();
        self.voluntary_variance = Directed::even(k::VOLUNTARY_RANGE_MM2_S4.1);
    }

    /// Inflates the covariance of the roll and its rate: the roll is `turn_rad` from its
    /// prediction, after `since_s` seconds without an observation.
    pub fn inflate_roll_covariance(&mut self, turn_rad: f64, since_s: f64) {
        let dt = since_s.clamp(k::ROLL_MANOEUVRE_S.0, k::ROLL_MANOEUVRE_S.1);
        let push = [0.5 * dt * dt, dt, 1.0].map(|g| g * k::ROLL_MANOEUVRE_RAD_S2);
        for r in 0..3 {
            for c in 0..3 {
                self.covariance[ROLL + r][ROLL + c] += push[r] * push[c];
            }
        }
        // The acceleration stays uncertain; an angle that it does not explain says nothing of the
        // rate.
        self.covariance[ROLL + 2][ROLL + 2] += push[2] * push[2];
        let rest = (turn_rad.abs() - 2.0 * push[0]).max(0.0);
        self.covariance[ROLL][ROLL] += rest * rest;
        self.renew_cross();
    }

    /// Damps the rate of a roll that has not been observed for long, over `dt` seconds.
    pub fn damp_roll(&mut self, dt: f64) {
        let kept = libm::exp(-dt / k::ROLL_DAMPING_S);
        self.roll_rate *= kept;
        self.roll_acceleration *= kept;
    }
}

fn tip_of(vectors: &[Vector3<f64>; VECTORS]) -> Vector3<f64> {
    vectors[TREMOR..PLAY].iter().step_by(2).fold(vectors[0], |sum, v| sum + v)
}

/// Tip and rotation of a column (or row) of the covariance.
fn pose_part(row: &Row, axis: &Vector3<f64>, lever: f64) -> (Vector3<f64>, Vector3<f64>) {
    let vector = |i: usize| Vector3::new(row[3 * i], row[3 * i + 1], row[3 * i + 2]);
    let mut tip = vector(0);
    for i in 0..PAIRS {
        tip += vector(TREMOR + 2 * i);
    }
    let roll = (0..ROLL_TREMORS).fold(row[ROLL], |sum, i| sum + row[ROLL_TREMOR + 2 * i]);
    let turn = axis.cross(&(vector(PLAY) - tip)) / lever + axis * roll;
    (tip, turn)
}

/// `rotation`, turned by the least angle that brings the shaft through its pivot.
fn aligned(
    rotation: UnitQuaternion<f64>,
    vectors: &[Vector3<f64>; VECTORS],
    pivot: &Pivot,
) -> UnitQuaternion<f64> {
    let to_pivot = pivot.position + vectors[PLAY] - tip_of(vectors);
    let distance = to_pivot.norm();
    if distance < 0.5 * k::SHORTEST_LEVER_MM {
        return rotation;
    }
    // The half-way quaternion (1 + a·b, a × b) is exact where the angle is small.
    let (axis, target) = (rotation * Vector3::z(), to_pivot / distance);
    let across = axis.cross(&target);
    let turn = Quaternion::new(1.0 + axis.dot(&target), across.x, across.y, across.z);
    UnitQuaternion::new_normalize(turn * rotation.into_inner())
}

#[cfg(test)]
mod tests;
