//! Counts of one camera's fields, and how late they were there. Pure.

use hdrhistogram::Histogram;
use protocol::deliveries::Delays;

/// Delays, and the longest.
#[derive(Debug, Clone)]
pub struct DelayCounts {
    /// From 1 µs to 1000 s, to three digits.
    counts: Histogram<u64>,
    longest_ns: u64,
}

impl Default for DelayCounts {
    fn default() -> Self {
        let counts = Histogram::new_with_bounds(1_000, 1_000_000_000_000, 3);
        DelayCounts { counts: counts.expect("the bounds are in order"), longest_ns: 0 }
    }
}

impl DelayCounts {
    /// Counts a delay, ns.
    pub fn note(&mut self, delay_ns: u64) {
        self.counts.saturating_record(delay_ns);
        self.longest_ns = self.longest_ns.max(delay_ns);
    }

    /// Their percentiles; zeros without any.
    pub fn delays(&self) -> Delays {
        let at_ms = |share| self.counts.value_at_quantile(share).min(self.longest_ns) as f64 * 1e-6;
        Delays { p50: at_ms(0.5), p99: at_ms(0.99), max: self.longest_ns as f64 * 1e-6 }
    }
}

/// What became of a camera's fields.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Put out.
    pub fields: u64,
    /// Left out for coming too late.
    pub late: u64,
    /// How often the source was opened and brought a picture.
    pub openings: u64,
    /// Number after the newest that was put out.
    pub after_newest: u64,
    /// Left out because their camera is faster than the rig says.
    pub surplus: u64,
    /// Frames that the driver lost or delivered damaged.
    pub lost: u64,
    /// Delays of those that were put out.
    pub delays: DelayCounts,
    /// How far the camera's stamps were from its pace.
    pub jitter: DelayCounts,
}

impl Tally {
    /// Counts a field that is put out.
    pub fn put_out(&mut self, number: u64, delay_ns: u64) {
        self.fields += 1;
        self.after_newest = number + 1;
        self.delays.note(delay_ns);
    }

    /// Numbers up to `next` for which nothing was put out.
    pub fn missing(&self, next: u64) -> u64 {
        next.max(self.after_newest).saturating_sub(self.fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_delays() {
        let mut counts = DelayCounts::default();
        assert_eq!(counts.delays(), Delays::default());
        (0..98).for_each(|_| counts.note(120_000));
        counts.note(5_030_000);
        counts.note(9_000_000_000);
        let Delays { p50, p99, max } = counts.delays();
        assert!((p50 - 0.12).abs() < 1e-3 && (p99 - 5.03).abs() < 1e-2 && (max - 9_000.0).abs() < 1e-9);
    }

    #[test]
    fn what_was_not_put_out_is_missing() {
        let mut tally = Tally::default();
        assert_eq!(tally.missing(0), 0);
        tally.put_out(0, 0);
        tally.put_out(4, 0);
        assert_eq!((tally.missing(5), tally.missing(9), tally.fields), (3, 7, 2));
    }
}
