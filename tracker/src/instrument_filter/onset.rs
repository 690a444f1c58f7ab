//! The onset of a withdrawal: an instrument is pulled out of its trocar along the shaft, and nothing announces it.
//!
//! A filter that expects the movement of a hand explains the first blobs of a withdrawal as tremor. Until it no longer
//! can, its tip lags behind, and the acceleration that makes up for the lag then carries it too far. So the innovations
//! are compared with those of a constant jerk outwards along the shaft (a minimum-jerk movement begins so) from one of
//! the last instants on. The signature of an onset is how far the state is off by now for a jerk of 1: it follows the
//! transitions, and shrinks with every update as the error of the state does. Regressing the innovations on it gives
//! the jerk and its likelihood ratio. Where that is large, the state is corrected by as much, and what remains unknown
//! of the jerk is added to its covariance (Willsky and Jones 1976, A Generalized Likelihood Ratio Approach to the
//! Detection and Estimation of Jumps in Linear Systems).

use super::insertion::Insertion;
use super::transition::StateTransition;
use super::{Columns, InstrumentFilter, N, ROLL, Row, pose_part};
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::motion_models::VOLUNTARY;
use crate::pose_math::{Matrix6, Vector6};
use nalgebra::Vector3;

/// Instants at which a withdrawal may have begun.
const ONSETS: usize = 6;

/// The innovations, compared with those of a withdrawal that began at each of the last instants.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Onsets {
    /// How far the state is off for a jerk of 1 mm/s³, a column for each.
    signatures: [[f64; ONSETS]; N],
    /// Time since each, s.
    age_s: [f64; ONSETS],
    /// Derivative of the logarithm of the likelihood by the jerk, at none, s³/mm.
    score: [f64; ONSETS],
    /// Information on the jerk, s⁶/mm².
    information: [f64; ONSETS],
}

/// A withdrawal that has begun.
pub(super) struct Withdrawal {
    /// How far the state is off for a jerk of 1 mm/s³.
    signature: Row,
    /// Along the shaft, outwards, mm/s³.
    jerk: f64,
    /// Of the jerk, mm²/s⁶.
    variance: f64,
}

/// An update: the change of the pose, the inverse of its prior covariance, what it takes from that covariance, and the
/// gain times this.
pub(super) struct Innovation<'a> {
    pub delta: &'a Vector6,
    pub prior_inverse: &'a Matrix6,
    pub shrink: &'a Matrix6,
    pub weighted: &'a Columns,
}

impl Onsets {
    /// None has begun before now.
    pub fn new() -> Self {
        Onsets {
            signatures: [[0.0; ONSETS]; N],
            age_s: [0.0; ONSETS],
            score: [0.0; ONSETS],
            information: [0.0; ONSETS],
        }
    }

    /// Replaces the oldest by one that begins now, where the newest is no longer new.
    fn begin(&mut self) {
        let newest = self.age_s.iter().copied().fold(f64::MAX, f64::min);
        if newest < k::ONSET_SPACING_S {
            return;
        }
        let oldest = (0..ONSETS).max_by(|a, b| self.age_s[*a].total_cmp(&self.age_s[*b])).unwrap_or(0);
        self.signatures.iter_mut().for_each(|row| row[oldest] = 0.0);
        (self.age_s[oldest], self.score[oldest], self.information[oldest]) = (0.0, 0.0, 0.0);
    }

    /// Over a step of `dt` seconds of the filter, of a shaft in the direction `axis`.
    pub fn propagate(
        &mut self,
        step: &StateTransition,
        insertion: Option<&Insertion>,
        axis: &Vector3<f64>,
        dt: f64,
    ) {
        self.begin();
        insertion.iter().for_each(|i| i.apply(0, &mut self.signatures));
        step.apply(&mut self.signatures);
        insertion.iter().for_each(|i| i.apply(1, &mut self.signatures));
        for (onset, age_s) in self.age_s.iter_mut().enumerate() {
            let (before, after) = (of_jerk(*age_s), of_jerk(*age_s + dt));
            for (i, (row, after)) in step.voluntary.iter().zip(after).enumerate() {
                let moved: f64 = row.iter().zip(&before).map(|(f, x)| f * x).sum();
                for (n, axis) in axis.iter().enumerate() {
                    self.signatures[3 * i + n][onset] += axis * (after - moved);
                }
            }
            *age_s += dt;
        }
    }

    /// Takes in an update. `of_pose` gives the part of a column of the covariance that is the pose's. The withdrawal that
    /// the innovations show, if they do.
    pub fn take_in(
        &mut self,
        update: &Innovation<'_>,
        of_pose: impl Fn(&Row) -> Vector6,
    ) -> Option<Withdrawal> {
        let (mut likeliest, mut most) = (None, k::ONSET_RATIO);
        for onset in 0..ONSETS {
            let mut signature: Row = std::array::from_fn(|r| self.signatures[r][onset]);
            // Of this jerk the innovation is shrink·prior⁻¹·of_pose(signature), and its covariance is shrink.
            let weights = update.prior_inverse * of_pose(&signature);
            self.score[onset] += weights.dot(update.delta);
            self.information[onset] += weights.dot(&(update.shrink * weights));
            for (column, weight) in update.weighted.iter().zip(weights.iter()) {
                signature.iter_mut().zip(column).for_each(|(s, w)| *s -= w * weight);
            }
            self.signatures.iter_mut().zip(&signature).for_each(|(row, s)| row[onset] = *s);
            let variance =
                1.0 / (self.information[onset] + 1.0 / (k::ONSET_JERK_MM_S3 * k::ONSET_JERK_MM_S3));
            let (jerk, ratio) =
                (self.score[onset] * variance, self.score[onset] * self.score[onset] * variance);
            // A hand guides a tip in any direction; a withdrawal goes outwards.
            if jerk > 0.0 && ratio > most {
                signature[ROLL..].fill(0.0);
                (likeliest, most) = (Some(Withdrawal { signature, jerk, variance }), ratio);
            }
        }
        likeliest
    }

    /// Writes them.
    pub fn save(&self, out: &mut Saver<'_>) -> Done {
        let Onsets { signatures, age_s, score, information } = self;
        out.numbers(signatures.iter().flatten().chain(age_s).chain(score).chain(information))
    }

    /// Takes over what was saved.
    pub fn load(&mut self, from: &mut Loader<'_>) -> Done {
        let Onsets { signatures, age_s, score, information } = self;
        from.numbers(signatures.iter_mut().flatten().chain(age_s).chain(score).chain(information))
    }
}

/// Displacement, velocity, acceleration and lags `t` seconds after a jerk of 1 began. The first lag is what makes the
/// acceleration stay as it is by then; the others are unknown.
fn of_jerk(t: f64) -> [f64; VOLUNTARY] {
    let mut states = [0.0; VOLUNTARY];
    states[..4].copy_from_slice(&[t * t * t / 6.0, t * t / 2.0, t, t]);
    states
}

impl InstrumentFilter {
    /// Compares an update with those of a withdrawal.
    pub(super) fn find_withdrawal(&mut self, update: &Innovation<'_>) -> Option<Withdrawal> {
        if !self.pivot.tracked {
            return None;
        }
        let (axis, lever) = self.shaft();
        self.onsets.take_in(update, |column| {
            let (tip, turn) = pose_part(column, &axis, lever);
            Vector6::new(tip.x, tip.y, tip.z, turn.x, turn.y, turn.z)
        })
    }

    /// Corrects the movement for a withdrawal: its state, and what is expected of the acceleration along the shaft. The
    /// roll stays as it is measured.
    pub(super) fn follow_withdrawal(&mut self, withdrawal: &Withdrawal) {
        let Withdrawal { signature, jerk, variance } = withdrawal;
        self.shift(&signature.map(|s| s * jerk));
        for (row, r) in self.covariance.iter_mut().zip(signature) {
            row.iter_mut().zip(signature).for_each(|(p, c)| *p += r * c * variance);
        }
        let reached = (jerk * k::ONSET_RISE_S).powi(2).min(k::VOLUNTARY_RANGE_MM2_S4.1);
        self.voluntary_variance.along = self.voluntary_variance.along.max(reached);
        self.onsets = Onsets::new();
    }
}

#[cfg(test)]
mod tests;
