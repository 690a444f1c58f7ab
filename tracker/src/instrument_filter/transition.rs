//! State transition of an instrument: the transitions of its motion models, applied to the rows of
//! a covariance or to the states.

use super::{N, PLAY, ROLL, ROLL_TREMOR, ROLL_TREMORS, TREMOR, VECTORS};
use crate::block_matrix::{combine_rows, combine_vectors};
use crate::constants as k;
use crate::motion_models::{Oscillator, Singer, VOLUNTARY, VoluntaryMotion};
use crate::tremor_bank::{Block, PAIRS, TremorBank};
use crate::tuning::Tuning;
use nalgebra::Vector3;

pub(super) const PLAY_MODEL: Oscillator = Oscillator { omega: k::PLAY_RAD_S, damping: k::PLAY_DAMPING };

pub(super) fn roll_model(tuning: &Tuning) -> Singer {
    Singer { sigma: tuning.turn_acceleration_rad_s2, tau_s: tuning.turn_acceleration_tau_s }
}

pub(super) fn roll_tremor_model(i: usize) -> Oscillator {
    Oscillator { omega: 2.0 * std::f64::consts::PI * k::ROLL_TREMOR_HZ[i], damping: k::ROLL_TREMOR_DAMPING }
}

/// Of an acceleration of variance 1.
pub(super) fn voluntary_model(tuning: &Tuning) -> VoluntaryMotion {
    VoluntaryMotion { sigma: 1.0, tau_s: tuning.voluntary_tau_s }
}

/// Transitions of all motion models over one time step.
pub(super) struct StateTransition {
    pub voluntary: [[f64; VOLUNTARY]; VOLUNTARY],
    pub tremor: [Block; PAIRS],
    pub play: [[f64; 2]; 2],
    pub roll: [[f64; 3]; 3],
    pub roll_tremor: [[[f64; 2]; 2]; ROLL_TREMORS],
}

impl StateTransition {
    /// Over `dt` seconds.
    pub fn new(dt: f64, tuning: &Tuning, bank: &TremorBank) -> Self {
        StateTransition {
            voluntary: voluntary_model(tuning).transition(dt),
            tremor: bank.transition(dt),
            play: PLAY_MODEL.transition(dt),
            roll: roll_model(tuning).transition(dt),
            roll_tremor: std::array::from_fn(|i| roll_tremor_model(i).transition(dt)),
        }
    }

    /// F·M, where `rows` are the rows of M, three for each vector.
    pub fn apply<const W: usize>(&self, rows: &mut [[f64; W]; N]) {
        for axis in 0..3 {
            combine_rows(rows, std::array::from_fn(|n| axis + 3 * n), &self.voluntary);
            for (i, f) in self.tremor.iter().enumerate() {
                let first = 3 * (TREMOR + 2 * i) + axis;
                combine_rows(rows, [first, first + 3], f);
            }
            combine_rows(rows, [3 * PLAY + axis, 3 * PLAY + 3 + axis], &self.play);
        }
        combine_rows(rows, [ROLL, ROLL + 1, ROLL + 2], &self.roll);
        for (i, f) in self.roll_tremor.iter().enumerate() {
            combine_rows(rows, [ROLL_TREMOR + 2 * i, ROLL_TREMOR + 2 * i + 1], f);
        }
    }

    /// Applies the transition to the vector states.
    pub fn apply_to_vectors(&self, vectors: &mut [Vector3<f64>; VECTORS]) {
        combine_vectors(&mut vectors[..TREMOR], &self.voluntary);
        for (i, f) in self.tremor.iter().enumerate() {
            combine_vectors(&mut vectors[TREMOR + 2 * i..TREMOR + 2 * i + 2], f);
        }
        combine_vectors(&mut vectors[PLAY..], &self.play);
    }
}
