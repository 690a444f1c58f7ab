//! Counters that the compiler puts on every branch (LLVM's SanitizerCoverage, "inline 8-bit
//! counters": <https://clang.llvm.org/docs/SanitizerCoverage.html>), and what of them is new.
#![allow(unsafe_code)]

use std::sync::OnceLock;

/// Where the counters lie: address of the first, and how many.
static COUNTERS: OnceLock<(usize, usize)> = OnceLock::new();

/// Called by every instrumented object before `main`, with the bounds of all counters.
///
/// # Safety
/// Called by compiled code only, which passes the bounds of one array.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn __sanitizer_cov_8bit_counters_init(start: *mut u8, stop: *mut u8) {
    let _ = COUNTERS.set((start as usize, (stop as usize).saturating_sub(start as usize)));
}

fn counters() -> &'static mut [u8] {
    let (start, length) = COUNTERS.get().copied().unwrap_or((0, 0));
    if length == 0 {
        return &mut [];
    }
    // SAFETY: the compiler's own array, which lives as long as the program. Counting races with
    // nothing: the engine reads it on the thread that runs the target, and a lost count does no harm.
    unsafe { std::slice::from_raw_parts_mut(start as *mut u8, length) }
}

/// Which branches have been taken how often so far, in classes of counts.
#[derive(Debug, Default)]
pub struct Coverage {
    /// Classes seen, a bit each, by counter.
    seen: Vec<u8>,
    /// Counters that were ever above 0.
    branches: usize,
    /// Blocks of counters of which one was ever above 0: only those are looked at after every input.
    live: Vec<usize>,
    /// Inputs until all counters are looked at again.
    until_all: u32,
}

/// Counters of a block.
const BLOCK: usize = 256;
/// Counters that are looked at together.
const WORD: usize = 16;
/// All counters are looked at after so many inputs; an input that reaches a block for the first time
/// may be missed, the next one that does is not.
const ALL_EVERY: u32 = 64;

fn block(counters: &mut [u8], at: usize) -> &mut [u8] {
    let end = counters.len().min(at + BLOCK);
    &mut counters[at..end]
}

/// The class of a count, a bit: 1, 2, 3, 4–7, 8–15, 16–31, 32–127, more.
fn class(count: u8) -> u8 {
    match count {
        0 => 0,
        1 => 1,
        2 => 2,
        3 => 4,
        4..=7 => 8,
        8..=15 => 16,
        16..=31 => 32,
        32..=127 => 64,
        _ => 128,
    }
}

impl Coverage {
    /// Whether this program has counters.
    pub fn is_there() -> bool {
        !counters().is_empty()
    }

    /// Sets the counters to 0.
    pub fn begin(&self) {
        let counters = counters();
        if self.until_all == 0 {
            counters.fill(0);
        } else {
            self.live.iter().for_each(|&at| block(counters, at).fill(0));
        }
    }

    /// True if the counters hold what was not seen before; it is seen now.
    pub fn end(&mut self) -> bool {
        self.take(counters())
    }

    /// Lets the next input be judged by all counters.
    pub fn look_at_all(&mut self) {
        self.until_all = 0;
    }

    /// Branches taken so far.
    pub fn branches(&self) -> usize {
        self.branches
    }

    fn take(&mut self, counters: &mut [u8]) -> bool {
        self.seen.resize(counters.len(), 0);
        if self.until_all == 0 {
            self.until_all = ALL_EVERY;
            for at in (0..counters.len()).step_by(BLOCK) {
                if block(counters, at).iter().any(|c| *c > 0) && !self.live.contains(&at) {
                    self.live.push(at);
                }
            }
            return self.take_live(counters);
        }
        self.until_all -= 1;
        self.take_live(counters)
    }

    fn take_live(&mut self, counters: &mut [u8]) -> bool {
        let live = std::mem::take(&mut self.live);
        let new = live.iter().fold(false, |new, &at| new | self.note(at, block(counters, at)));
        self.live = live;
        new
    }

    fn note(&mut self, at: usize, counters: &[u8]) -> bool {
        let (words, rest) = counters.as_chunks::<WORD>();
        let mut new = self.note_each(at + WORD * words.len(), rest);
        for (i, word) in words.iter().enumerate() {
            // Most branches are not taken.
            if u128::from_ne_bytes(*word) != 0 {
                new |= self.note_each(at + WORD * i, word);
            }
        }
        new
    }

    fn note_each(&mut self, at: usize, counters: &[u8]) -> bool {
        let mut new = false;
        for (seen, &count) in self.seen[at..].iter_mut().zip(counters) {
            let class = class(count);
            if class & !*seen != 0 {
                self.branches += usize::from(*seen == 0);
                *seen |= class;
                new = true;
            }
        }
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_branch_is_new_once_in_each_class_of_counts() {
        let mut coverage = Coverage::default();
        let mut counters = [0; 70];
        assert!(!coverage.take(&mut counters));
        coverage.until_all = 0;
        counters[69] = 1;
        assert!(coverage.take(&mut counters) && !coverage.take(&mut counters));
        counters[69] = 5;
        assert!(coverage.take(&mut counters));
        counters[69] = 7;
        assert!(!coverage.take(&mut counters), "4 to 7 are one class");
        counters[3] = 255;
        assert!(coverage.take(&mut counters));
        assert_eq!(coverage.branches(), 2);
    }

    #[test]
    fn a_block_that_was_never_reached_is_found_before_long() {
        let mut coverage = Coverage::default();
        let mut counters = [0; 4 * BLOCK];
        counters[7] = 1;
        assert!(coverage.take(&mut counters));
        counters[3 * BLOCK] = 1;
        let found = (0..=ALL_EVERY).position(|_| coverage.take(&mut counters));
        assert!(found.is_some());
    }
}
