//! A record that repeats is written at most once a second, with how often it came.

use std::collections::HashMap;
use std::time::{Duration, Instant};
use tracing::Level;

/// Shortest time between two lines of the same record.
const PERIOD: Duration = Duration::from_secs(1);
/// Records remembered; beyond that the oldest are forgotten.
const MOST: usize = 64;

/// Records written lately, by message; the fields of a record, such as a field number, may
/// differ.
#[derive(Debug, Default)]
pub struct Repeats(HashMap<String, Written>);

#[derive(Debug, Clone, Copy)]
struct Written {
    at: Instant,
    level: Level,
    /// How often it came since and was not written.
    held_back: u64,
}

impl Repeats {
    /// Decides about a record that comes at `now`: `None` where it was written less than a second ago,
    /// otherwise how many of its kind were held back since.
    pub fn admit(&mut self, record: &str, level: Level, now: Instant) -> Option<u64> {
        if let Some(written) = self.0.get_mut(record) {
            if now.saturating_duration_since(written.at) < PERIOD {
                written.held_back += 1;
                return None;
            }
            let held_back = written.held_back;
            *written = Written { at: now, level, held_back: 0 };
            return Some(held_back);
        }
        if self.0.len() >= MOST {
            let oldest = self.0.iter().min_by_key(|(_, w)| w.at).map(|(record, _)| record.clone());
            self.0.remove(&oldest.unwrap_or_default());
        }
        self.0.insert(record.to_owned(), Written { at: now, level, held_back: 0 });
        Some(0)
    }

    /// Records that were held back and did not come again for a second, with how often: their last lines.
    pub fn overdue(&mut self, now: Instant) -> Vec<(String, Level, u64)> {
        let due = |w: &Written| w.held_back > 0 && now.saturating_duration_since(w.at) >= PERIOD;
        let last = |(record, w): (&String, &Written)| (record.clone(), w.level, w.held_back);
        let overdue: Vec<_> = self.0.iter().filter(|(_, w)| due(w)).map(last).collect();
        for (record, ..) in &overdue {
            self.0.remove(record);
        }
        overdue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_record_comes_once_a_second_with_its_count() {
        let (mut repeats, start) = (Repeats::default(), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        assert_eq!(repeats.admit("a", Level::WARN, at(0)), Some(0));
        for n in 1..50 {
            assert_eq!(repeats.admit("a", Level::WARN, at(20 * n)), None);
        }
        assert_eq!(repeats.admit("b", Level::INFO, at(500)), Some(0));
        assert_eq!(repeats.admit("a", Level::WARN, at(1_000)), Some(49));
        assert_eq!(repeats.admit("a", Level::WARN, at(1_020)), None);
        assert_eq!(repeats.overdue(at(1_900)), []);
        assert_eq!(repeats.overdue(at(2_100)), [("a".to_owned(), Level::WARN, 1)]);
        assert_eq!(repeats.overdue(at(2_100)), []);
    }

    #[test]
    fn it_remembers_a_bounded_number() {
        let (mut repeats, start) = (Repeats::default(), Instant::now());
        for n in 0..1_000u64 {
            assert_eq!(repeats.admit(&n.to_string(), Level::INFO, start + Duration::from_millis(n)), Some(0));
        }
        assert_eq!(repeats.0.len(), MOST);
    }
}
