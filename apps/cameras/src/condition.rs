//! Problems of a camera: reported in words the first time, counted afterwards. Pure.

use protocol::time::Nanos;
use std::collections::{BTreeMap, BTreeSet};

/// Most texts that are reported for one camera; further ones are only counted.
const TOLD: usize = 20;

/// A kind of trouble.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Nothing has come yet.
    Awaited,
    /// Its file is over.
    Over,
    /// What it brings cannot be used.
    Refused,
    /// Whoever wrote into its pipe has closed it.
    Closed,
    /// Its camera is not there any more.
    Unplugged,
    /// Its camera's stamps cannot be true.
    Stamps,
    /// It is open and brings nothing.
    Silent,
    /// It brings fields too late.
    Slow,
    /// It shows nothing but black.
    Black,
}

impl Kind {
    /// Name in counts.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Awaited => "awaited",
            Kind::Over => "over",
            Kind::Refused => "refused",
            Kind::Closed => "closed",
            Kind::Unplugged => "unplugged",
            Kind::Stamps => "stamps",
            Kind::Silent => "silent",
            Kind::Slow => "slow",
            Kind::Black => "black",
        }
    }
}

/// What is wrong, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble {
    /// Its kind.
    pub kind: Kind,
    /// In words that follow the camera's name.
    pub text: String,
}

/// A sentence to be reported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct News {
    /// It is about something wrong, not about its end.
    pub is_bad: bool,
    /// The sentence, with the camera's name.
    pub text: String,
}

/// How one camera stands.
#[derive(Debug, Clone)]
pub struct Condition {
    /// Its name in messages.
    name: String,
    present: Option<(Trouble, Nanos)>,
    /// The present problem was reported.
    is_told: bool,
    told: BTreeSet<String>,
    /// How often which kind began.
    pub counts: BTreeMap<Kind, u64>,
}

impl Condition {
    /// Of a camera of which nothing is known.
    pub fn new(name: String) -> Self {
        let (told, counts) = (BTreeSet::new(), BTreeMap::new());
        Condition { name, present: None, is_told: false, told, counts }
    }

    /// What is wrong now.
    pub fn trouble(&self) -> Option<&Trouble> {
        self.present.as_ref().map(|(trouble, _)| trouble)
    }

    /// Takes the problem at `now`, if there is one; returns what is to be reported.
    pub fn note(&mut self, trouble: Option<Trouble>, now: Nanos) -> Option<News> {
        if self.trouble() == trouble.as_ref() {
            return None;
        }
        let before = self.present.take();
        let Some(trouble) = trouble else {
            let (before, since) = before?;
            let seconds = now.saturating_sub(since) as f64 * 1e-9;
            let again = if before.kind == Kind::Awaited { "" } else { " again" };
            let text = format!("{} is available{again} after {seconds:.1} s", self.name);
            return std::mem::take(&mut self.is_told).then_some(News { is_bad: false, text });
        };
        let same = before.as_ref().filter(|(b, _)| b.kind == trouble.kind && b.text == trouble.text);
        let since = before.as_ref().map_or(now, |(_, since)| *since);
        if same.is_none() && before.as_ref().is_none_or(|(b, _)| b.kind != trouble.kind) {
            *self.counts.entry(trouble.kind).or_default() += 1;
        }
        let is_new = self.told.len() < TOLD && self.told.insert(trouble.text.clone());
        self.is_told |= is_new;
        let text = format!("{} {}", self.name, trouble.text);
        self.present = Some((trouble, since));
        is_new.then_some(News { is_bad: true, text })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trouble(kind: Kind, text: &str) -> Option<Trouble> {
        Some(Trouble { kind, text: text.into() })
    }

    #[test]
    fn trouble_is_told_once_and_then_counted() {
        let mut camera = Condition::new("camera 1".into());
        let told = |news: Option<News>| news.map(|n| n.text);
        assert_eq!(told(camera.note(None, 0)), None);
        let closed = || trouble(Kind::Closed, "is closed");
        assert_eq!(told(camera.note(closed(), 5)).as_deref(), Some("camera 1 is closed"));
        assert_eq!(told(camera.note(closed(), 6)), None);
        let back = told(camera.note(None, 2_500_000_005));
        assert_eq!(back.as_deref(), Some("camera 1 is available again after 2.5 s"));
        assert_eq!((told(camera.note(closed(), 7)), told(camera.note(None, 8))), (None, None));
        assert_eq!(camera.counts[&Kind::Closed], 2);
        assert!(camera.trouble().is_none());
    }

    #[test]
    fn one_trouble_after_another_is_one_absence() {
        let mut camera = Condition::new("camera 0".into());
        assert!(camera.note(trouble(Kind::Closed, "is closed"), 0).is_some_and(|n| n.is_bad));
        assert!(camera.note(trouble(Kind::Refused, "is 4×4"), 1_000_000_000).is_some());
        assert!(camera.note(trouble(Kind::Refused, "is 8×8"), 1_000_000_000).is_some());
        let back = camera.note(None, 3_000_000_000).unwrap();
        assert_eq!((back.is_bad, back.text.ends_with("after 3.0 s")), (false, true));
        assert_eq!(camera.counts[&Kind::Refused], 1);
    }

    #[test]
    fn a_source_with_ever_new_texts_is_told_so_many_times() {
        let mut camera = Condition::new("camera 0".into());
        let told = (0..100).filter(|i| camera.note(trouble(Kind::Refused, &format!("{i}")), 0).is_some());
        assert_eq!(told.count(), TOLD);
    }
}
