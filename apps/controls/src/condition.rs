//! Problems of a device: reported in words the first time, counted afterwards. Pure.

use protocol::time::Nanos;
use std::collections::{BTreeMap, BTreeSet};

/// Most texts that are reported for one device; further ones are only counted.
const TOLD: usize = 20;
/// Time over which bad lines are counted, ns.
const WINDOW_NS: u64 = 1_000_000_000;
/// So many of them within that time are a trouble.
const MANY: u64 = 5;

/// A kind of trouble.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// It is not there, or cannot be opened or used.
    Absent,
    /// It was there and is gone.
    Gone,
    /// A recorded file is over.
    Over,
    /// It is open and sends nothing.
    Silent,
    /// Much of what it sends cannot be used.
    Garbled,
    /// Much of what it sends does not arrive.
    Gaps,
    /// A handle sends of which the rig says nothing.
    Uncalibrated,
}

impl Kind {
    /// Name in counts.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Absent => "absent",
            Kind::Gone => "gone",
            Kind::Over => "over",
            Kind::Silent => "silent",
            Kind::Garbled => "garbled",
            Kind::Gaps => "gaps",
            Kind::Uncalibrated => "uncalibrated",
        }
    }
}

/// What is wrong, in words that follow the device's name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble {
    /// Its kind.
    pub kind: Kind,
    /// In words.
    pub text: String,
}

impl Trouble {
    /// Of a kind, in words.
    pub fn new(kind: Kind, text: impl Into<String>) -> Self {
        Trouble { kind, text: text.into() }
    }
}

/// A sentence to be reported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct News {
    /// It is about something wrong, not about its end.
    pub is_bad: bool,
    /// The sentence, with the device's name.
    pub text: String,
}

/// How one device stands.
#[derive(Debug, Clone)]
pub struct Condition {
    name: String,
    present: Option<(Trouble, Nanos)>,
    /// The present problem was reported.
    is_told: bool,
    told: BTreeSet<String>,
    /// How often which kind began.
    pub counts: BTreeMap<Kind, u64>,
}

impl Condition {
    /// Of a device with which nothing is wrong.
    pub fn new(name: &str) -> Self {
        let (told, counts) = (BTreeSet::new(), BTreeMap::new());
        Condition { name: name.into(), present: None, is_told: false, told, counts }
    }

    /// What is wrong now.
    pub fn trouble(&self) -> Option<&Trouble> {
        self.present.as_ref().map(|(trouble, _)| trouble)
    }

    /// Its name and what is wrong now, as a sentence.
    pub fn sentence(&self) -> Option<String> {
        self.trouble().map(|trouble| format!("{} {}", self.name, trouble.text))
    }

    /// Takes the problem at `now`, if there is one; returns what is to be reported.
    pub fn note(&mut self, trouble: Option<Trouble>, now: Nanos) -> Option<News> {
        if self.trouble() == trouble.as_ref() {
            return None;
        }
        let before = self.present.take();
        let Some(trouble) = trouble else {
            let seconds = now.saturating_sub(before?.1) as f64 * 1e-9;
            let text = format!("{} works again after {seconds:.1} s", self.name);
            return std::mem::take(&mut self.is_told).then_some(News { is_bad: false, text });
        };
        if before.as_ref().is_none_or(|(before, _)| before.kind != trouble.kind) {
            *self.counts.entry(trouble.kind).or_default() += 1;
        }
        let since = before.map_or(now, |(_, since)| since);
        let is_new = self.told.len() < TOLD && self.told.insert(trouble.text.clone());
        self.is_told |= is_new;
        let text = format!("{} {}", self.name, trouble.text);
        self.present = Some((trouble, since));
        is_new.then_some(News { is_bad: true, text })
    }
}

/// Counts of something that happens now and then, and whether it is much of late.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rate {
    /// Since the beginning.
    pub total: u64,
    in_window: u64,
    window_ns: Nanos,
    is_much: bool,
}

impl Rate {
    /// Counts `more` at `now`.
    pub fn note(&mut self, more: u64, now: Nanos) {
        self.turn(now);
        self.total += more;
        self.in_window += more;
        self.is_much |= self.in_window >= MANY;
    }

    /// Whether it was much within the second before the present one, or is much in it.
    pub fn is_much(&mut self, now: Nanos) -> bool {
        self.turn(now);
        self.is_much
    }

    /// Begins another second where one is over.
    fn turn(&mut self, now: Nanos) {
        if now >= self.window_ns + WINDOW_NS {
            self.is_much = self.in_window >= MANY && now < self.window_ns + 2 * WINDOW_NS;
            (self.window_ns, self.in_window) = (now, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn trouble_is_told_once_and_then_counted() {
        let mut pedal = Condition::new("the pedal");
        let gone = || Some(Trouble::new(Kind::Gone, "is disconnected"));
        let told = |news: Option<News>| news.map(|n| n.text);
        assert_eq!(told(pedal.note(None, 0)), None);
        assert_eq!(told(pedal.note(gone(), 5)).as_deref(), Some("the pedal is disconnected"));
        assert_eq!(told(pedal.note(gone(), 6)), None);
        assert_eq!(pedal.sentence().as_deref(), Some("the pedal is disconnected"));
        let back = told(pedal.note(None, 5 + 5 * S / 2));
        assert_eq!(back.as_deref(), Some("the pedal works again after 2.5 s"));
        assert_eq!((told(pedal.note(gone(), 7)), told(pedal.note(None, 8))), (None, None));
        assert_eq!(pedal.counts[&Kind::Gone], 2);
        let many =
            (0..100).filter(|i| pedal.note(Some(Trouble::new(Kind::Absent, format!("{i}"))), 0).is_some());
        assert_eq!(many.count(), TOLD - 1);
    }

    #[test]
    fn a_few_are_counted_and_many_are_a_trouble_until_a_quiet_second() {
        let mut rate = Rate::default();
        rate.note(MANY - 1, 10 * S);
        assert!(!rate.is_much(10 * S));
        rate.note(1, 10 * S + 1);
        assert!(rate.is_much(10 * S + 2) && rate.is_much(11 * S));
        assert!(!rate.is_much(12 * S + 5), "a second without any");
        rate.note(MANY, 13 * S);
        assert!(!rate.is_much(100 * S), "long ago");
        assert_eq!(rate.total, 2 * MANY);
    }
}
