//! Field numbers that only go up, whatever a writer counts.

use protocol::limits::MAX_CAMERAS;

/// A count that goes up by more at once is a new one: half an hour at 50 Hz.
const LONGEST_GAP: u64 = 100_000;
/// A count that begins higher leaves no room to go up.
const HIGHEST: u64 = 1 << 62;

/// Numbers of the fields as they are published. While a writer counts up they are its own; where its count
/// begins again they go on from the highest, for all cameras alike.
#[derive(Debug, Clone, Default)]
pub struct FieldNumbers {
    last: [Option<u64>; MAX_CAMERAS],
    /// What is added to a writer's count.
    base: u64,
}

impl FieldNumbers {
    /// The number of a camera's next field, which its writer gave number `seq`.
    pub fn next(&mut self, camera: usize, seq: u64) -> u64 {
        let mut number = seq.wrapping_add(self.base);
        let camera = camera.min(MAX_CAMERAS - 1);
        let highest = self.last.iter().flatten().max().copied();
        let goes_on = self.last[camera].is_none_or(|last| number > last)
            && highest.is_none_or(|highest| number.saturating_sub(highest) <= LONGEST_GAP);
        if !goes_on || number > HIGHEST {
            number = highest.map_or(0, |highest| highest + 1);
            self.base = number.wrapping_sub(seq);
        }
        self.last[camera] = Some(number);
        number
    }
}
