//! Ticks: what is slow is done once in [`TICK_NS`] of the time that passes in the eye, whatever the
//! cameras' rate. At 50 Hz a step is a tick, at 200 Hz every fourth one ends with one, at 25 Hz each has
//! two. What has come together since the last tick is part of the state.
//!
//! [`TICK_NS`]: protocol::limits::TICK_NS

use crate::constants::{TICK_EARLY_SUBSTEPS, TICK_SUBSTEPS};
use crate::state::InstrumentState;
use nalgebra::Isometry3;
use protocol::limits::INSTRUMENTS;
use serde::{Deserialize, Serialize};

/// Ticks that are done when so many substeps are.
pub fn ticks_at(substeps: u64) -> u64 {
    (substeps + TICK_EARLY_SUBSTEPS) / TICK_SUBSTEPS
}

/// Whether what is done every so many ticks is done between two numbers of ticks.
pub fn reaches(every: u64, [before, after]: [u64; 2]) -> bool {
    after / every > before / every
}

/// What has come together since the last tick. After a tick nothing has, and it follows from the rest of
/// the state; only else it is hashed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct TickState {
    /// `eye_from_instrument` at the last tick, or where the instrument appeared after it: from there it
    /// drags the gel.
    pub from: [Isometry3<f64>; INSTRUMENTS],
    /// Ports that drew at the vitreous.
    pub open: [Option<OpenPort>; INSTRUMENTS],
    /// Force at the membrane's rim, µN.
    pub rim_un: Peak,
    /// Pull of the membrane's bonds at the retina, Pa.
    pub pull_pa: Peak,
    /// How far they lift it, mm.
    pub lift_mm: Peak,
    /// Flow of each needle's injection, mm³/s.
    pub flow_mm3_s: [Peak; INSTRUMENTS],
}

/// A port that drew at the vitreous.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OpenPort {
    /// Substeps in which it was open.
    pub substeps: u32,
    /// `eye_from_instrument` in the last of them.
    pub eye_from_instrument: Isometry3<f64>,
    /// Suction at the port in it, Pa.
    pub suction_pa: f64,
}

/// The largest of the values since the last tick: what has been warned of may be warned of again when
/// it has stayed below for a whole tick.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Peak(f64);

impl Peak {
    /// Takes a step's value in. When a tick `ends`, returns the largest since the last one and
    /// resets.
    pub fn note(&mut self, value: f64, ends: bool) -> Option<f64> {
        if value > self.0 {
            self.0 = value;
        }
        ends.then(|| std::mem::take(&mut self.0))
    }
}

impl TickState {
    /// Right after a tick.
    pub fn at_tick(instruments: &[InstrumentState; INSTRUMENTS]) -> Self {
        TickState { from: instruments.each_ref().map(|i| i.eye_from_instrument), ..TickState::default() }
    }

    /// True if its numbers can be: for checkpoints.
    pub fn is_sound(&self) -> bool {
        let peaks = [&self.rim_un, &self.pull_pa, &self.lift_mm].into_iter().chain(&self.flow_mm3_s);
        let mut open = self.open.iter().flatten();
        let poses = self.from.iter().chain(open.clone().map(|o| &o.eye_from_instrument));
        let rigid = |p: &Isometry3<f64>| protocol::geometry::Pose::from_isometry(p).is_valid();
        let drawn = |o: &OpenPort| o.suction_pa >= 0.0 && u64::from(o.substeps) <= TICK_SUBSTEPS;
        open.all(|o| o.suction_pa.is_finite() && drawn(o))
            && peaks.into_iter().all(|p| p.0.is_finite())
            && poses.into_iter().all(rigid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Ticks of each step.
    fn of_steps(steps_ms: &[u64]) -> Vec<u64> {
        let mut substeps = 0;
        let of_step = |ms: &u64| {
            let before = ticks_at(substeps);
            substeps += ms;
            ticks_at(substeps) - before
        };
        steps_ms.iter().map(of_step).collect()
    }

    #[test]
    fn a_field_of_50_hz_is_a_tick_four_of_200_share_one_and_25_hz_has_two() {
        for (ms, expected) in [(20, [1, 1, 1, 1]), (5, [0, 0, 0, 1]), (10, [0, 1, 0, 1]), (40, [2, 2, 2, 2])]
        {
            assert_eq!(of_steps(&[ms; 4]), expected, "{ms} ms");
        }
    }

    #[test]
    fn instants_that_tremble_have_a_tick_a_field() {
        assert_eq!(of_steps(&[20, 19, 21, 19, 20, 21, 20, 19, 19, 21, 21]), [1; 11]);
    }

    #[test]
    fn a_peak_is_of_the_whole_tick() {
        let mut peak = Peak::default();
        let told = [(3.0, false), (9.0, false), (1.0, true), (2.0, true)].map(|(v, ends)| peak.note(v, ends));
        assert_eq!(told, [None, None, Some(9.0), Some(2.0)]);
    }

    proptest! {
        /// Whatever the steps, ticks keep to the time, and none has to do more than a pause allows.
        #[test]
        fn ticks_keep_to_the_time(steps in prop::collection::vec(0u64..=200, 0..300)) {
            let (ticks, substeps) = (of_steps(&steps), steps.iter().sum::<u64>());
            let done = ticks.iter().sum::<u64>();
            prop_assert!((done * TICK_SUBSTEPS).abs_diff(substeps) < TICK_SUBSTEPS);
            prop_assert!(ticks.iter().all(|n| *n <= 11));
            let mut at = 0;
            let looks = ticks.iter().filter(|n| { at += **n; reaches(4, [at - **n, at]) }).count() as u64;
            prop_assert!(looks <= done / 4 && looks >= done / 15);
        }
    }
}
