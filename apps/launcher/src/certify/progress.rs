//! How far a stream is, for whoever waits for it: half an hour without a word looks like a program that hangs. Pure.

/// Lines of a whole stream.
const LINES: u64 = 10;

/// What was said.
#[derive(Debug)]
pub struct Progress {
    triples: u64,
    said: u64,
}

impl Progress {
    /// Of a stream of so many triples.
    pub fn of(triples: u64) -> Self {
        Progress { triples: triples.max(1), said: 0 }
    }

    /// A line each tenth of the stream, but none at its end.
    pub fn line(&mut self, sent: u64) -> Option<String> {
        let tenth = LINES * sent / self.triples;
        if tenth <= self.said || tenth >= LINES {
            return None;
        }
        self.said = tenth;
        Some(format!("{} of {} triples sent", sent, self.triples))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_tenth_is_said_once_and_the_end_is_not() {
        let mut progress = Progress::of(2_000);
        let said: Vec<_> = (0..=2_000).filter_map(|sent| progress.line(sent)).collect();
        assert_eq!(said.len(), 9, "{said:?}");
        assert_eq!((&*said[0], &*said[8]), ("200 of 2000 triples sent", "1800 of 2000 triples sent"));
        let mut seldom = Progress::of(2_000);
        assert_eq!(
            [0, 150, 999, 1_000, 2_000].map(|sent| seldom.line(sent).is_some()),
            [false, false, true, true, false]
        );
        assert_eq!(Progress::of(0).line(0), None);
    }
}
