//! The newest spans of a process. Pure: the instants are arguments.

use super::Span;
use bytemuck::Zeroable;

/// Spans in the order in which they ended. Where there is no more room the oldest one goes.
#[derive(Debug)]
pub(super) struct Ring {
    spans: Box<[Span]>,
    /// Where the next one goes.
    next: usize,
    /// All that ever were.
    recorded: u64,
}

impl Ring {
    /// Room for `capacity` spans, at least one. Every page of it is touched now: none comes in the loop.
    pub(super) fn new(capacity: usize) -> Self {
        let empty = Span { start_ns: 1, ..Span::zeroed() };
        Ring { spans: vec![empty; capacity.max(1)].into_boxed_slice(), next: 0, recorded: 0 }
    }

    /// Adds one.
    #[inline]
    pub(super) fn push(&mut self, span: Span) {
        self.spans[self.next] = span;
        self.next = if self.next + 1 == self.spans.len() { 0 } else { self.next + 1 };
        self.recorded += 1;
    }

    /// All that ever were added.
    pub(super) fn recorded(&self) -> u64 {
        self.recorded
    }

    /// Those that are left, the oldest first, in two pieces.
    pub(super) fn pieces(&self) -> [&[Span]; 2] {
        let (newer, older) = self.spans.split_at(self.next);
        if self.recorded < self.spans.len() as u64 { [newer, &[]] } else { [older, newer] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbered(field: u64) -> Span {
        Span { start_ns: field, field, ..Span::zeroed() }
    }

    proptest! {
        #[test]
        fn the_newest_are_left_in_their_order(capacity in 0usize..40, count in 0u64..200) {
            let mut ring = Ring::new(capacity);
            (0..count).for_each(|field| ring.push(numbered(field)));
            let left: Vec<u64> = ring.pieces().concat().iter().map(|span| span.field).collect();
            let first = count.saturating_sub(capacity.max(1) as u64);
            prop_assert_eq!(left, (first..count).collect::<Vec<_>>());
            prop_assert_eq!(ring.recorded(), count);
        }
    }
}
