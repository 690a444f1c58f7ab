//! Faults of timing: dropped and late fields, clocks that drift apart.

use super::{Faults, Kind};

/// A camera's own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Period that the clock is meant to have, ns.
    pub period_ns: u64,
    /// Error of the period, parts per thousand million.
    pub ppb: i64,
    /// First exposure after the start, ns.
    pub phase_ns: u64,
}

impl Clock {
    /// Middle of the exposure of field `number`, ns after the start.
    pub fn exposed_ns(&self, number: u64) -> u64 {
        let meant = u128::from(number) * u128::from(self.period_ns);
        let error = meant as i128 * i128::from(self.ppb) / 1_000_000_000;
        (meant as i128 + error + i128::from(self.phase_ns)).clamp(0, i128::from(u64::MAX)) as u64
    }
}

impl Faults {
    /// The clock of a camera; all are the same unless they drift.
    pub fn clock(&self, camera: u32) -> Clock {
        let genlocked = Clock { period_ns: self.period_ns, ppb: 0, phase_ns: 0 };
        match &self.spec.clock_drift {
            Some(drift) if self.concerns(Kind::ClockDrift, camera) => {
                let throw = self.dice.throw(Kind::ClockDrift, camera, 0);
                Clock {
                    ppb: (drift.ppm * 1000.0 * (2.0 * throw.uniform(0) - 1.0)) as i64,
                    phase_ns: (drift.phase_ms * 1e6 * throw.uniform(1)) as u64,
                    ..genlocked
                }
            }
            _ => genlocked,
        }
    }

    /// True if the field never leaves.
    pub fn dropped(&self, camera: u32, field: u64) -> bool {
        let Some(dropped) = &self.spec.dropped else { return false };
        let unlucky = || self.dice.throw(Kind::Dropped, camera, field).uniform(0) < dropped.rate;
        self.concerns(Kind::Dropped, camera) && unlucky()
    }

    /// By how much the field's blobs are late, ns.
    pub fn delay_ns(&self, camera: u32, field: u64) -> u64 {
        let Some(late) = &self.spec.late else { return 0 };
        let throw = self.dice.throw(Kind::Late, camera, field);
        if self.concerns(Kind::Late, camera) && throw.uniform(0) < late.rate {
            (late.delay_ms * 1e6 * throw.uniform(1)) as u64
        } else {
            0
        }
    }
}
