//! Counts of frames as cameras on a network number them. Pure.
//!
//! GigE Vision numbers frames from 1 to 65535 and begins again at 1; its extended numbers, and those of USB3 Vision,
//! have 64 bits and never end. A frame whose packets were waited for may come after a later one.

/// Numbers of a short count before it begins again.
const SHORT: u64 = 65_535;
/// Consecutive frames older than the newest after which the count is taken to have been reset.
const RESET_AFTER: u32 = 8;

/// The frames of one camera since it was opened.
#[derive(Debug, Clone, Copy, Default)]
pub struct Frames {
    newest: Option<u64>,
    count: u32,
    /// Frames in a row that were older than the newest.
    older: u32,
}

impl Frames {
    /// The number of a frame in a count that goes up by one for each, and by more where some were lost. One that
    /// comes after a later one has the later one's.
    pub fn sequence(&mut self, id: u64) -> u32 {
        let step = match self.newest {
            None => Some(1),
            Some(before) if before.max(id) <= SHORT => {
                Some((id + SHORT - before) % SHORT).filter(|step| *step <= SHORT / 2)
            }
            Some(before) => id.checked_sub(before).filter(|step| *step <= u64::from(u32::MAX / 2)),
        };
        self.older = if step.is_some() { 0 } else { self.older + 1 };
        let step = step.or((self.older >= RESET_AFTER).then_some(1));
        if let Some(step) = step {
            (self.newest, self.older) = (Some(id), 0);
            self.count = self.count.wrapping_add(step as u32);
        }
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(ids: &[u64]) -> Vec<u32> {
        let mut frames = Frames::default();
        let all: Vec<u32> = ids.iter().map(|id| frames.sequence(*id)).collect();
        all.windows(2).map(|pair| pair[1].wrapping_sub(pair[0])).collect()
    }

    #[test]
    fn short_counts_go_on_beyond_their_end() {
        assert_eq!(steps(&[65_534, 65_535, 1, 2, 5]), [1, 1, 1, 3]);
        assert_eq!(steps(&[65_530, 3]), [8]);
    }

    #[test]
    fn long_counts_have_no_end() {
        assert_eq!(steps(&[65_535, 65_536, 65_540]), [1, 4]);
        assert_eq!(steps(&[1 << 40, (1 << 40) + 3]), [3]);
        assert_eq!(steps(&[0, u64::MAX, 1]), [0, 1], "no camera loses that many");
    }

    #[test]
    fn what_comes_after_a_later_one_loses_nothing() {
        assert_eq!(steps(&[7, 9, 8, 10]), [2, 0, 1]);
        assert_eq!(steps(&[2, 65_535, 3]), [0, 1]);
    }

    #[test]
    fn a_count_that_has_begun_anew_is_followed_after_a_while() {
        let reset: Vec<u64> = std::iter::once(9_000).chain(1..=12).collect();
        assert_eq!(steps(&reset), [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1]);
    }
}
