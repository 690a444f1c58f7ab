//! Faults of timing: dropped fields, late fields, clock drift.

use super::{FaultInjector, FaultKind};

/// A camera's own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Nominal period, ns.
    pub period_ns: u64,
    /// Error of the period, parts per billion.
    pub ppb: i64,
    /// First exposure after the start, ns.
    pub phase_ns: u64,
}

impl Clock {
    /// Middle of the exposure of field `number`, ns after the start.
    pub fn exposed_ns(&self, number: u64) -> u64 {
        let nominal = u128::from(number) * u128::from(self.period_ns);
        let error = nominal as i128 * i128::from(self.ppb) / 1_000_000_000;
        (nominal as i128 + error + i128::from(self.phase_ns)).clamp(0, i128::from(u64::MAX)) as u64
    }
}

impl FaultInjector {
    /// Clock of a camera; all of one rate are equal (genlocked) without clock drift.
    pub fn clock(&self, camera: u32) -> Clock {
        let genlocked = Clock { period_ns: self.period_ns[camera as usize], ppb: 0, phase_ns: 0 };
        let kind = FaultKind::ClockDrift;
        let Some(drift) = self.of(&self.spec.clock_drift, kind, camera) else { return genlocked };
        let draw = self.sampler.draw(kind, camera, 0);
        Clock {
            ppb: (drift.ppm * 1000.0 * (2.0 * draw.uniform(0) - 1.0)) as i64,
            phase_ns: (drift.phase_ms * 1e6 * draw.uniform(1)) as u64,
            ..genlocked
        }
    }

    /// True if the field is dropped.
    pub fn dropped(&self, camera: u32, field: u64) -> bool {
        let kind = FaultKind::Dropped;
        let dropped = self.of(&self.spec.dropped, kind, camera);
        dropped.is_some_and(|d| self.sampler.draw(kind, camera, field).uniform(0) < d.rate)
    }

    /// Delay of the field, ns.
    pub fn delay_ns(&self, camera: u32, field: u64) -> u64 {
        let Some(late) = self.of(&self.spec.late, FaultKind::Late, camera) else { return 0 };
        let draw = self.sampler.draw(FaultKind::Late, camera, field);
        if draw.uniform(0) < late.rate { (late.delay_ms * 1e6 * draw.uniform(1)) as u64 } else { 0 }
    }
}
