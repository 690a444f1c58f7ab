//! Progress messages, one per tenth of the stream. Pure.

/// A stream is divided into this many parts; a message follows each part but the last.
const LINES: u64 = 10;

/// Progress of a stream.
#[derive(Debug)]
pub struct Progress {
    triples: u64,
    reported: u64,
}

impl Progress {
    /// Progress of a stream of `triples` triples.
    pub fn of(triples: u64) -> Self {
        Progress { triples: triples.max(1), reported: 0 }
    }

    /// The message for `sent` triples, if a tenth of the stream has been completed since the last message.
    /// None at the end of the stream.
    pub fn line(&mut self, sent: u64) -> Option<String> {
        let tenth = LINES * sent / self.triples;
        if tenth <= self.reported || tenth >= LINES {
            return None;
        }
        self.reported = tenth;
        Some(format!("{} of {} triples sent", sent, self.triples))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_tenth_is_said_once_and_the_end_is_not() {
        let mut progress = Progress::of(2_000);
        let reported: Vec<_> = (0..=2_000).filter_map(|sent| progress.line(sent)).collect();
        assert_eq!(reported.len(), 9, "{reported:?}");
        assert_eq!((&*reported[0], &*reported[8]), ("200 of 2000 triples sent", "1800 of 2000 triples sent"));
        let mut seldom = Progress::of(2_000);
        assert_eq!(
            [0, 150, 999, 1_000, 2_000].map(|sent| seldom.line(sent).is_some()),
            [false, false, true, true, false]
        );
        assert_eq!(Progress::of(0).line(0), None);
    }
}
