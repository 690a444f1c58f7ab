//! The beginning of a withdrawal: an instrument is pulled out of its trocar along the shaft, and nothing announces it.
//!
//! A filter that expects the movement of a hand explains the first blobs of a pull as tremor. Until it no longer can,
//! its tip lags behind, and the acceleration that is made up for the lag then carries it too far. So the innovations
//! are compared with those of a pull: a constant jerk along the shaft (a movement of least jerk begins so) from one of
//! the last instants on. How far the state would be off by now for a jerk of 1 follows the transitions, and shrinks
//! with every update as the error of the state does. Regressing the innovations on it gives the jerk and its
//! likelihood ratio; where that is large, the state is corrected by as much, and its covariance by what remains
//! unknown (Willsky and Jones 1976, A Generalized Likelihood Ratio Approach to the Detection and Estimation of Jumps
//! in Linear Systems).

use super::insertion::Insertion;
use super::transition::StateTransition;
use super::{Columns, InstrumentFilter, N, ROLL, Row, pose_part};
use crate::checkpoint::{Done, Loader, Saver};
use crate::constants as k;
use crate::motion_models::VOLUNTARY;
use crate::pose_math::{Matrix6, Vector6};
use nalgebra::Vector3;

/// Instants at which a pull may have begun.
const ONSETS: usize = 6;

/// The innovations beside those of a pull that began at each of the last instants.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Onsets {
    /// How far the state is off for a jerk of 1 mm/s³, a column for each.
    off: [[f64; ONSETS]; N],
    /// Time since each, s.
    age_s: [f64; ONSETS],
    /// Score of the jerk: sum of the products of innovations and what a jerk of 1 makes of them, weighted.
    score: [f64; ONSETS],
    /// Information on the jerk, s⁶/mm².
    information: [f64; ONSETS],
}

/// A pull that has begun.
pub(super) struct Pull {
    /// How far the state is off for a jerk of 1 mm/s³.
    off: Row,
    /// Along the shaft, outwards, mm/s³.
    jerk: f64,
    /// Of the jerk.
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
            off: [[0.0; ONSETS]; N],
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
        self.off.iter_mut().for_each(|row| row[oldest] = 0.0);
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
        insertion.iter().for_each(|i| i.apply(0, &mut self.off));
        step.apply(&mut self.off);
        insertion.iter().for_each(|i| i.apply(1, &mut self.off));
        for (onset, age_s) in self.age_s.iter_mut().enumerate() {
            let (before, after) = (of_jerk(*age_s), of_jerk(*age_s + dt));
            for (i, (row, after)) in step.voluntary.iter().zip(after).enumerate() {
                let moved: f64 = row.iter().zip(&before).map(|(f, x)| f * x).sum();
                for (n, axis) in axis.iter().enumerate() {
                    self.off[3 * i + n][onset] += axis * (after - moved);
                }
            }
            *age_s += dt;
        }
    }

    /// Takes in an update. `of_pose` gives the part of a column of the covariance that is the pose's. The pull that the
    /// innovations show, if they do.
    pub fn take_in(&mut self, update: &Innovation<'_>, of_pose: impl Fn(&Row) -> Vector6) -> Option<Pull> {
        let (mut likeliest, mut most) = (None, k::ONSET_RATIO);
        for onset in 0..ONSETS {
            let mut off: Row = std::array::from_fn(|r| self.off[r][onset]);
            // With the innovation S = shrink, of which a jerk of 1 makes shrink·prior⁻¹·of_pose(off).
            let weights = update.prior_inverse * of_pose(&off);
            self.score[onset] += weights.dot(update.delta);
            self.information[onset] += weights.dot(&(update.shrink * weights));
            for (column, weight) in update.weighted.iter().zip(weights.iter()) {
                off.iter_mut().zip(column).for_each(|(off, w)| *off -= w * weight);
            }
            self.off.iter_mut().zip(&off).for_each(|(row, off)| row[onset] = *off);
            let variance =
                1.0 / (self.information[onset] + 1.0 / (k::ONSET_JERK_MM_S3 * k::ONSET_JERK_MM_S3));
            let (jerk, ratio) =
                (self.score[onset] * variance, self.score[onset] * self.score[onset] * variance);
            // A hand guides a tip in any direction; only outwards it pulls.
            if jerk > 0.0 && ratio > most {
                off[ROLL..].fill(0.0);
                (likeliest, most) = (Some(Pull { off, jerk, variance }), ratio);
            }
        }
        likeliest
    }

    /// Writes them.
    pub fn save(&self, out: &mut Saver<'_>) -> Done {
        let Onsets { off, age_s, score, information } = self;
        out.numbers(off.iter().flatten().chain(age_s).chain(score).chain(information))
    }

    /// Takes over what was saved.
    pub fn load(&mut self, from: &mut Loader<'_>) -> Done {
        let Onsets { off, age_s, score, information } = self;
        from.numbers(off.iter_mut().flatten().chain(age_s).chain(score).chain(information))
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
    /// Compares an update with those of a pull.
    pub(super) fn find_pull(&mut self, update: &Innovation<'_>) -> Option<Pull> {
        if !self.pivot.tracked {
            return None;
        }
        let (axis, lever) = self.shaft();
        self.onsets.take_in(update, |column| {
            let (tip, turn) = pose_part(column, &axis, lever);
            Vector6::new(tip.x, tip.y, tip.z, turn.x, turn.y, turn.z)
        })
    }

    /// Corrects the movement for a pull: its state, and what is expected of the acceleration along the shaft. The roll
    /// stays as it is measured.
    pub(super) fn follow_pull(&mut self, pull: &Pull) {
        let Pull { off, jerk, variance } = pull;
        self.shift(&off.map(|off| off * jerk));
        for (row, r) in self.covariance.iter_mut().zip(off) {
            row.iter_mut().zip(off).for_each(|(p, c)| *p += r * c * variance);
        }
        let reached = (jerk * k::ONSET_RISE_S).powi(2).min(k::VOLUNTARY_RANGE_MM2_S4.1);
        self.voluntary_variance.along = self.voluntary_variance.along.max(reached);
        self.onsets = Onsets::new();
    }
}

#[cfg(test)]
mod tests;
