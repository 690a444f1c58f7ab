//! Marks a picture that is held because no new scene arrives. Pure: times are arguments.

use crate::config::HELD_NS;
use protocol::time::Nanos;

/// Whether the scene is current.
#[derive(Debug, Default)]
pub struct Held {
    /// Time at which the newest scene arrived, ns; `None` before the first.
    came_ns: Option<Nanos>,
    /// True once the stream has ended.
    ended: bool,
    /// Age shown in the picture, tenths of a second; 0 without a mark.
    shown: u64,
}

impl Held {
    /// Records the arrival of a new scene.
    pub fn note_scene(&mut self, at: Nanos) {
        (self.came_ns, self.ended) = (Some(at), false);
    }

    /// Ends the stream; its last picture stays without a mark.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// Age of a held picture, ns; `None` while the picture is current.
    pub fn age_ns(&self, at: Nanos) -> Option<u64> {
        let age = at.saturating_sub(self.came_ns?);
        (age > HELD_NS && !self.ended).then_some(age)
    }

    /// True if the picture is marked as held.
    pub fn is_shown(&self) -> bool {
        self.shown > 0
    }

    /// Text of the mark for a picture drawn at `at`, if it differs from the last one; empty without a mark.
    pub fn new_mark(&mut self, at: Nanos, paused: bool) -> Option<String> {
        let tenths = self.age_ns(at).filter(|_| !paused).map_or(0, |age| age / 100_000_000);
        if std::mem::replace(&mut self.shown, tenths) == tenths {
            return None;
        }
        Some(if tenths == 0 {
            String::new()
        } else {
            format!("Picture held for {:.1} s", tenths as f64 * 0.1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_picture_without_new_scenes_is_marked_until_one_comes() {
        let mut held = Held::default();
        assert_eq!((held.age_ns(900 * MS), held.new_mark(900 * MS, false)), (None, None), "no scene yet");
        held.note_scene(1000 * MS);
        assert_eq!(held.new_mark(1250 * MS, false), None);
        assert_eq!(held.new_mark(2249 * MS, false).as_deref(), Some("Picture held for 1.2 s"));
        assert_eq!(held.new_mark(2260 * MS, false), None, "as it says already");
        assert_eq!(held.new_mark(2310 * MS, false).as_deref(), Some("Picture held for 1.3 s"));
        held.note_scene(2320 * MS);
        assert_eq!(held.new_mark(2330 * MS, false).as_deref(), Some(""));
    }

    #[test]
    fn a_pause_and_the_end_of_a_stream_are_no_matter() {
        let mut held = Held::default();
        held.note_scene(1000 * MS);
        assert_eq!(held.new_mark(3000 * MS, true), None);
        held.end();
        assert_eq!((held.age_ns(3000 * MS), held.new_mark(3000 * MS, false)), (None, None));
        held.note_scene(4000 * MS);
        assert!(held.age_ns(5000 * MS).is_some(), "it went on");
    }
}
