//! The point about which a shaft turns, and how one takes over from another: an instrument that is taken out of its trocar or
//! put back turns freely near it, and so does one whose eye is not tracked.

use super::{InstrumentFilter, N, PAIRS, PLAY, Row, TREMOR, tip_of};
use crate::block_matrix::transpose;
use crate::constants as k;
use nalgebra::{Matrix3, Vector3};

/// The point that the shaft passes, and its play there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pivot {
    /// In the world, mm.
    pub position: Vector3<f64>,
    /// Standard deviation of the play, mm.
    pub sigma: f64,
    /// True if this is the trocar of a tracked eye.
    pub tracked: bool,
}

impl InstrumentFilter {
    /// True if no trocar is known that the shaft passes, or the tip is too near it.
    pub fn turns_freely(&self) -> bool {
        !self.pivot.tracked
    }

    /// The next pivot. Near it the lever is too short for a direction, and the shaft turns freely.
    pub(super) fn next_pivot(&mut self, pivot: Option<Pivot>) -> Pivot {
        let held = Pivot { sigma: k::FREE_PLAY_MM, tracked: false, ..self.pivot };
        let mut next = pivot.unwrap_or(held);
        let (tip, axis) = (tip_of(&self.vectors), self.axis());
        let is_near = axis.dot(&(next.position - tip)) < k::SHORTEST_LEVER_MM;
        if is_near {
            next = Pivot { position: tip + axis * k::FREE_PIVOT_MM, ..held };
        }
        if next.tracked != self.pivot.tracked {
            self.turn_about(next);
        } else if is_near {
            self.vectors[PLAY].fill(0.0);
        }
        next
    }

    /// Takes another pivot. The shaft stays where it is and goes on as it moves: its play at the pivot is that of its point
    /// nearest to it.
    fn turn_about(&mut self, pivot: Pivot) {
        let (tip, (axis, before)) = (tip_of(&self.vectors), self.shaft());
        let lever = axis.dot(&(pivot.position - tip));
        let (share, along) = (lever / before, axis * axis.transpose());
        let across = Matrix3::identity() - along;
        let velocity = self.velocity();
        self.vectors[PLAY + 1] = across * (velocity + (self.vectors[PLAY + 1] - velocity) * share);
        self.vectors[PLAY] = tip + axis * lever - pivot.position;
        // First of the rows, then of the columns.
        for _ in 0..2 {
            for r in 0..N {
                let [tip, velocity, play, rate] = self.tip_and_play(&self.covariance[r]);
                let moved = [tip + (play - tip) * share, velocity + (rate - velocity) * share];
                for (vector, moved) in moved.iter().enumerate() {
                    let at = 3 * (PLAY + vector);
                    self.covariance[r][at..at + 3].copy_from_slice((across * moved).as_slice());
                }
            }
            transpose(&mut self.covariance);
        }
        // Along the shaft a play is nothing that a pose shows.
        for (vector, sigma) in [(PLAY, pivot.sigma), (PLAY + 1, pivot.sigma * k::PLAY_RAD_S)] {
            for (r, c) in (0..9).map(|n| (n / 3, n % 3)) {
                self.covariance[3 * vector + r][3 * vector + c] += along[(r, c)] * sigma * sigma;
            }
        }
        self.pivot = pivot;
        self.renew_cross();
    }

    /// Tip, its velocity, play and its rate of a row of the covariance.
    pub(super) fn tip_and_play(&self, row: &Row) -> [Vector3<f64>; 4] {
        let vector = |i: usize| Vector3::new(row[3 * i], row[3 * i + 1], row[3 * i + 2]);
        let (mut tip, mut velocity) = (vector(0), vector(1));
        for pair in 0..PAIRS {
            let [real, imaginary] = self.bank.velocity(pair);
            let (first, second) = (vector(TREMOR + 2 * pair), vector(TREMOR + 2 * pair + 1));
            tip += first;
            velocity += first * real + second * imaginary;
        }
        [tip, velocity, vector(PLAY), vector(PLAY + 1)]
    }
}
