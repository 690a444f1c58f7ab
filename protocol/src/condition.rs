//! Condition of an input device, such as a camera or a pedal: each problem is reported in words the first time, and
//! counted afterwards. Pure: time is an argument.

use crate::time::Nanos;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of different texts that are reported for one device; further ones are only counted.
const MOST_REPORTED: usize = 20;

/// Kind of a problem.
pub trait ProblemKind: Copy + Ord {
    /// Name in counts.
    fn name(self) -> &'static str;

    /// Words that follow the device's name when the problem is over, such as "works again".
    fn over(self) -> &'static str;
}

/// A problem in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble<K> {
    /// Its kind.
    pub kind: K,
    /// Words that follow the device's name, such as "is disconnected".
    pub text: String,
}

impl<K> Trouble<K> {
    /// Of a kind, in words.
    pub fn new(kind: K, text: impl Into<String>) -> Self {
        Trouble { kind, text: text.into() }
    }
}

/// A sentence to be reported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct News {
    /// True for a problem, false for its end.
    pub is_bad: bool,
    /// The sentence, with the device's name.
    pub text: String,
}

/// Present problem of one device, and its former ones.
#[derive(Debug, Clone)]
pub struct Condition<K> {
    /// Name of the device in messages.
    name: String,
    /// With the instant at which the device ceased to work, ns.
    present: Option<(Trouble<K>, Nanos)>,
    /// A text of the present absence was reported, and so will its end be.
    is_reported: bool,
    reported: BTreeSet<String>,
    /// How often each kind began.
    counts: BTreeMap<K, u64>,
}

impl<K: ProblemKind> Condition<K> {
    /// Of a device without a problem so far.
    pub fn new(name: impl Into<String>) -> Self {
        let (reported, counts) = (BTreeSet::new(), BTreeMap::new());
        Condition { name: name.into(), present: None, is_reported: false, reported, counts }
    }

    /// The present problem.
    pub fn trouble(&self) -> Option<&Trouble<K>> {
        self.present.as_ref().map(|(trouble, _)| trouble)
    }

    /// Words of the present problem; empty without one.
    pub fn text(&self) -> &str {
        self.trouble().map_or("", |trouble| &trouble.text)
    }

    /// The device's name and its present problem, as a sentence.
    pub fn sentence(&self) -> Option<String> {
        self.trouble().map(|trouble| format!("{} {}", self.name, trouble.text))
    }

    /// How often each kind of problem began.
    pub fn counts(&self) -> impl Iterator<Item = (K, u64)> + '_ {
        self.counts.iter().map(|(kind, count)| (*kind, *count))
    }

    /// Replaces the present problem by the one at `now`, if any; returns what is to be reported. Problems that follow
    /// each other without a gap count as one absence of the device.
    pub fn note(&mut self, trouble: Option<Trouble<K>>, now: Nanos) -> Option<News> {
        if self.trouble() == trouble.as_ref() {
            return None;
        }
        let before = self.present.take();
        let Some(trouble) = trouble else {
            let (before, since) = before?;
            let seconds = now.saturating_sub(since) as f64 * 1e-9;
            let text = format!("{} {} after {seconds:.1} s", self.name, before.kind.over());
            return std::mem::take(&mut self.is_reported).then_some(News { is_bad: false, text });
        };
        if before.as_ref().is_none_or(|(before, _)| before.kind != trouble.kind) {
            *self.counts.entry(trouble.kind).or_default() += 1;
        }
        let since = before.map_or(now, |(_, since)| since);
        let is_new = self.reported.len() < MOST_REPORTED && self.reported.insert(trouble.text.clone());
        self.is_reported |= is_new;
        let text = format!("{} {}", self.name, trouble.text);
        self.present = Some((trouble, since));
        is_new.then_some(News { is_bad: true, text })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    enum Kind {
        Closed,
        Refused,
    }

    impl ProblemKind for Kind {
        fn name(self) -> &'static str {
            ["closed", "refused"][self as usize]
        }

        fn over(self) -> &'static str {
            ["is open again", "is accepted again"][self as usize]
        }
    }

    fn trouble(kind: Kind, text: &str) -> Option<Trouble<Kind>> {
        Some(Trouble::new(kind, text))
    }

    fn text(news: Option<News>) -> Option<String> {
        news.map(|news| news.text)
    }

    #[test]
    fn a_problem_is_reported_once_and_then_counted() {
        let mut camera = Condition::new("camera 1");
        assert_eq!(camera.note(None, 0), None);
        let closed = || trouble(Kind::Closed, "is closed");
        assert_eq!(text(camera.note(closed(), 5)).as_deref(), Some("camera 1 is closed"));
        assert_eq!(camera.note(closed(), 6), None);
        assert_eq!(camera.sentence().as_deref(), Some("camera 1 is closed"));
        let back = text(camera.note(None, 5 + 5 * S / 2));
        assert_eq!(back.as_deref(), Some("camera 1 is open again after 2.5 s"));
        assert_eq!((camera.note(closed(), 7), camera.note(None, 8)), (None, None));
        assert_eq!(camera.counts().collect::<Vec<_>>(), [(Kind::Closed, 2)]);
        assert_eq!((camera.trouble(), camera.text()), (None, ""));
    }

    #[test]
    fn one_problem_after_another_is_one_absence() {
        let mut camera = Condition::new("camera 0");
        assert!(camera.note(trouble(Kind::Closed, "is closed"), 0).is_some_and(|news| news.is_bad));
        assert!(camera.note(trouble(Kind::Refused, "is 4×4"), S).is_some());
        assert!(camera.note(trouble(Kind::Refused, "is 8×8"), S).is_some());
        let back = camera.note(None, 3 * S).unwrap();
        assert_eq!((back.is_bad, &*back.text), (false, "camera 0 is accepted again after 3.0 s"));
        assert_eq!(camera.counts().collect::<Vec<_>>(), [(Kind::Closed, 1), (Kind::Refused, 1)]);
    }

    #[test]
    fn of_ever_new_texts_only_the_first_are_reported() {
        let mut camera = Condition::new("camera 0");
        let reported =
            (0..100).filter(|i| camera.note(trouble(Kind::Refused, &i.to_string()), 0).is_some()).count();
        assert_eq!(reported, MOST_REPORTED);
    }
}
