//! Frame records that wait for the display's presentation feedback. Pure: times are arguments.

use crate::present::feedback::Answer;
use protocol::frames::{DISPLAY_ESTIMATED, DISPLAY_REPORTED, FrameRecord};
use protocol::time::Nanos;
use std::collections::VecDeque;

/// Timeout of the presentation feedback, ns. Hidden windows and suspended displays send none.
const AT_MOST_NS: u64 = 250_000_000;
/// Number of frames in a row without feedback, before any feedback has arrived, after which feedback is
/// considered unsupported.
const SILENT_FRAMES: u32 = 30;

struct Waiting {
    record: FrameRecord,
    /// The feedback, if it has arrived; the inner `None` means that the picture was never shown.
    answer: Option<Option<Nanos>>,
    until: Nanos,
}

/// Waiting records in the order of their frames.
#[derive(Default)]
pub struct Unanswered {
    waiting: VecDeque<Waiting>,
    /// Number of frames in a row without feedback.
    silent: u32,
    answered: bool,
}

impl Unanswered {
    /// True while feedback may arrive.
    pub fn expects(&self) -> bool {
        self.answered || self.silent < SILENT_FRAMES
    }

    /// Adds a record with an estimated `displayed`. `asked`: feedback was requested from the display.
    pub fn push(&mut self, record: FrameRecord, asked: bool, now: Nanos) {
        let until = if asked && self.expects() { now + AT_MOST_NS } else { now };
        self.waiting.push_back(Waiting { record, answer: None, until });
    }

    /// Adds feedback. Returns by how much later than estimated the picture was shown, ns.
    pub fn answer(&mut self, answer: Answer) -> Option<i64> {
        (self.answered, self.silent) = (true, 0);
        let waiting = self.waiting.iter_mut().find(|w| w.record.frame == answer.frame)?;
        waiting.answer = Some(answer.displayed);
        answer.displayed.map(|at| at.cast_signed() - waiting.record.displayed.cast_signed())
    }

    /// Removes and returns the next record with feedback, or whose timeout has passed at `now`.
    pub fn next(&mut self, now: Nanos) -> Option<FrameRecord> {
        let Waiting { mut record, answer, .. } =
            self.waiting.pop_front_if(|w| w.answer.is_some() || w.until <= now)?;
        if answer.is_none() {
            self.silent = self.silent.saturating_add(1);
        }
        // A picture cannot be shown before it is drawn; earlier times are ignored.
        if let Some(displayed) = answer.flatten().filter(|at| *at >= record.drawn) {
            record.displayed = displayed;
            record.flags = record.flags & !DISPLAY_ESTIMATED | DISPLAY_REPORTED;
        }
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    const MS: u64 = 1_000_000;

    fn record(frame: u64) -> FrameRecord {
        let drawn = 20 * MS * frame;
        FrameRecord {
            frame,
            drawn,
            displayed: drawn + 5 * MS,
            flags: DISPLAY_ESTIMATED,
            ..FrameRecord::zeroed()
        }
    }

    #[test]
    fn records_go_out_in_order_with_the_displays_word() {
        let mut waiting = Unanswered::default();
        (1..=3).for_each(|frame| waiting.push(record(frame), true, 20 * MS * frame));
        assert_eq!(waiting.answer(Answer { frame: 2, displayed: Some(47 * MS) }), Some(2 * MS as i64));
        assert_eq!(waiting.next(60 * MS), None, "the first has no answer yet");
        assert_eq!(waiting.answer(Answer { frame: 1, displayed: None }), None);
        let first = waiting.next(60 * MS).unwrap();
        assert_eq!((first.displayed, first.flags), (25 * MS, DISPLAY_ESTIMATED), "it was never shown");
        let second = waiting.next(60 * MS).unwrap();
        assert_eq!((second.displayed, second.flags), (47 * MS, DISPLAY_REPORTED));
        assert_eq!(waiting.next(60 * MS + AT_MOST_NS - 1), None);
        assert_eq!(waiting.next(60 * MS + AT_MOST_NS), Some(record(3)), "not waited for any longer");
        assert_eq!(waiting.answer(Answer { frame: 3, displayed: Some(70 * MS) }), None, "too late");
    }

    #[test]
    fn an_instant_before_the_picture_was_drawn_is_not_believed() {
        let mut waiting = Unanswered::default();
        waiting.push(record(1), true, 20 * MS);
        waiting.answer(Answer { frame: 1, displayed: Some(20 * MS - 1) });
        assert_eq!(waiting.next(0), Some(record(1)));
    }

    #[test]
    fn a_display_that_never_answers_is_not_waited_for() {
        let mut waiting = Unanswered::default();
        for frame in 0..u64::from(SILENT_FRAMES) {
            waiting.push(record(frame), true, 0);
            assert_eq!(waiting.next(AT_MOST_NS - 1), None);
            assert!(waiting.expects() && waiting.next(AT_MOST_NS).is_some());
        }
        assert!(!waiting.expects());
        waiting.push(record(99), true, 0);
        assert_eq!(waiting.next(0), Some(record(99)));
    }
}
