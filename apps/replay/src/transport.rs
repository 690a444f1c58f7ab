//! What the keys of a replay do: pure; keys in, orders out.

use protocol::inputs::Key;
use protocol::time::Nanos;
use protocol::transport::Move;

/// Slowest and fastest rate of a replay.
pub const RATES: [f64; 2] = [0.05, 64.0];

/// A place in a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// Seconds after its start.
    Time(f64),
    /// A field number.
    Field(u64),
    /// A step of the simulation.
    Step(u64),
}

impl Target {
    /// From what a person types: `12.5`, `f600`, `s550`.
    pub fn parse(text: &str) -> Option<Self> {
        let number = |digits: &str| digits.parse().ok();
        match (text.strip_prefix('f'), text.strip_prefix('s')) {
            (Some(field), _) => number(field).map(Target::Field),
            (_, Some(step)) => number(step).map(Target::Step),
            _ => text.parse().ok().filter(|s: &f64| s.is_finite() && *s >= 0.0).map(Target::Time),
        }
    }
}

/// What the player is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// By so many fields.
    Fields(i64),
    /// By so many steps of the simulation.
    Steps(i64),
    /// To the next event, or the one before.
    Event {
        /// Forward in time.
        forward: bool,
    },
    /// To a place.
    Seek(Target),
    /// To an instant of the recording, ns.
    SeekTo(Nanos),
    /// To its first step.
    Start,
    /// To its last step.
    End,
    /// Show or hide the help.
    Help,
    /// End.
    Quit,
}

/// How a replay is played, as far as keys change it.
#[derive(Debug, Clone)]
pub struct Transport {
    /// Goes on by itself.
    pub playing: bool,
    /// Time of the recording per time of the clock.
    pub rate: f64,
    /// Begins again at the end.
    pub looping: bool,
    /// The help is shown.
    pub help: bool,
    /// Instants of the recording, ns, in order.
    marks: Vec<Nanos>,
    /// What is being typed behind "go to".
    entry: Option<String>,
    /// What was typed and is no place.
    refused: Option<String>,
}

impl Transport {
    /// Playing or not, at a rate.
    pub fn new(playing: bool, rate: f64, looping: bool) -> Self {
        Transport { playing, rate, looping, help: false, marks: Vec::new(), entry: None, refused: None }
    }

    /// A key goes down while the player stands at `at`.
    pub fn press(&mut self, key: Key, at: Nanos) -> Option<Order> {
        self.refused = None;
        if self.entry.is_some() {
            return self.type_in(key);
        }
        match Move::of(key)? {
            Move::Play => self.playing = !self.playing,
            Move::FieldBack => return self.stop_at(Order::Fields(-1)),
            Move::FieldForward => return self.stop_at(Order::Fields(1)),
            Move::StepBack => return self.stop_at(Order::Steps(-1)),
            Move::StepForward => return self.stop_at(Order::Steps(1)),
            Move::EventBack => return self.stop_at(Order::Event { forward: false }),
            Move::EventForward => return self.stop_at(Order::Event { forward: true }),
            Move::Slower => self.rate = (self.rate / 2.0).max(RATES[0]),
            Move::Faster => self.rate = (self.rate * 2.0).min(RATES[1]),
            Move::Start => return Some(Order::Start),
            Move::End => return self.stop_at(Order::End),
            Move::GoTo => self.entry = Some(String::new()),
            Move::Mark => self.mark(at),
            Move::MarkBack => return self.mark_before(at).map(Order::SeekTo),
            Move::MarkForward => return self.mark_after(at).map(Order::SeekTo),
            Move::Loop => self.looping = !self.looping,
            Move::Help => {
                self.help = !self.help;
                return Some(Order::Help);
            }
            Move::Quit => return Some(Order::Quit),
        }
        None
    }

    fn stop_at(&mut self, order: Order) -> Option<Order> {
        self.playing = false;
        Some(order)
    }

    /// A key of the place to go to.
    fn type_in(&mut self, key: Key) -> Option<Order> {
        let typed = self.entry.as_mut()?;
        match key.name() {
            "enter" => {
                let typed = self.entry.take().unwrap_or_default();
                let target = Target::parse(&typed);
                self.refused = (target.is_none() && !typed.is_empty()).then_some(typed);
                return target.map(Order::Seek);
            }
            "escape" | "g" => self.entry = None,
            "backspace" => drop(typed.pop()),
            "period" => typed.push('.'),
            name if name.len() == 1 && typed.len() < 16 => typed.push_str(name),
            _ => {}
        }
        None
    }

    fn mark(&mut self, at: Nanos) {
        match self.marks.binary_search(&at) {
            Ok(there) => drop(self.marks.remove(there)),
            Err(place) => self.marks.insert(place, at),
        }
    }

    fn mark_before(&self, at: Nanos) -> Option<Nanos> {
        self.marks.iter().rfind(|mark| **mark < at).copied()
    }

    fn mark_after(&self, at: Nanos) -> Option<Nanos> {
        self.marks.iter().find(|mark| **mark > at).copied()
    }

    /// Where a replay that has come to `at` goes on instead: in a loop behind its last instant, which is a
    /// mark that it has just passed from `before`, or the `end` of the recording.
    pub fn wrap(&self, before: Nanos, at: Nanos, end: bool) -> Option<Order> {
        if !self.looping {
            return None;
        }
        let passed = self.marks.iter().find(|mark| before < **mark && **mark <= at);
        match passed.and_then(|mark| self.mark_before(*mark)) {
            Some(begin) => Some(Order::SeekTo(begin)),
            None if end => {
                let begin = (self.marks.len() > 1).then(|| self.mark_before(at)).flatten();
                Some(begin.map_or(Order::Start, Order::SeekTo))
            }
            None => None,
        }
    }

    /// What is being typed, or how the replay goes; for the line below the picture.
    pub fn text(&self) -> String {
        if let Some(typed) = &self.entry {
            return format!("go to {typed}_");
        }
        if let Some(refused) = &self.refused {
            return format!("'{refused}': expected seconds, f and a field, or s and a step");
        }
        let how = match (self.playing, self.rate == 1.0) {
            (true, _) => format!("x{}", self.rate),
            (false, true) => "paused".into(),
            (false, false) => format!("paused at x{}", self.rate),
        };
        let looping = if self.looping { ", loop" } else { "" };
        let marks = match self.marks.len() {
            0 => String::new(),
            1 => ", 1 mark".into(),
            n => format!(", {n} marks"),
        };
        format!("{how}{looping}{marks}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn press(transport: &mut Transport, names: &str, at: Nanos) -> Vec<Order> {
        let keys = names.split_whitespace().map(|name| Key::named(name).unwrap());
        keys.filter_map(|key| transport.press(key, at)).collect()
    }

    #[test]
    fn moves_stop_the_replay_and_rates_stay_in_their_range() {
        let mut t = Transport::new(true, 1.0, false);
        assert_eq!(press(&mut t, "right", 0), [Order::Fields(1)]);
        assert!(!t.playing && t.text() == "paused");
        assert_eq!(press(&mut t, "space up", 0), []);
        assert_eq!((t.playing, t.text().as_str()), (true, "x2"));
        press(&mut t, &"down ".repeat(20), 0);
        assert_eq!(t.rate, RATES[0]);
        press(&mut t, &"up ".repeat(20), 0);
        assert_eq!(t.rate, RATES[1]);
        assert_eq!(
            press(&mut t, "comma page-down home end h q y", 0),
            [
                Order::Steps(-1),
                Order::Event { forward: true },
                Order::Start,
                Order::End,
                Order::Help,
                Order::Quit
            ]
        );
    }

    #[test]
    fn a_place_is_typed() {
        let mut t = Transport::new(true, 1.0, false);
        assert_eq!(press(&mut t, "g 1 2 period 5 enter", 0), [Order::Seek(Target::Time(12.5))]);
        assert_eq!(press(&mut t, "g f 6 0 1 backspace enter", 0), [Order::Seek(Target::Field(60))]);
        assert_eq!(press(&mut t, "g s 7", 0), []);
        assert_eq!(t.text(), "go to s7_");
        assert_eq!(press(&mut t, "escape enter", 0), []);
        assert_eq!(press(&mut t, "g q enter", 0), []);
        assert!(t.text().contains("'q'") && t.text().contains("seconds"), "{}", t.text());
        assert_eq!(press(&mut t, "g enter", 0), []);
        assert_eq!(t.text(), "x1", "nothing typed is nothing wrong");
    }

    #[test]
    fn marks_are_set_reached_and_taken_away() {
        let mut t = Transport::new(false, 1.0, false);
        for at in [30, 10, 20] {
            press(&mut t, "m", at);
        }
        assert_eq!(t.text(), "paused, 3 marks");
        assert_eq!(press(&mut t, "n", 10), [Order::SeekTo(20)]);
        assert_eq!(press(&mut t, "b", 10), []);
        assert_eq!(press(&mut t, "b", 25), [Order::SeekTo(20)]);
        press(&mut t, "m", 20);
        assert_eq!(press(&mut t, "n", 10), [Order::SeekTo(30)]);
    }

    #[test]
    fn a_loop_begins_again_at_the_end_or_between_marks() {
        let mut t = Transport::new(true, 1.0, true);
        assert_eq!((t.wrap(1, 2, false), t.wrap(1, 2, true)), (None, Some(Order::Start)));
        press(&mut t, "m", 10);
        assert_eq!((t.wrap(5, 15, false), t.wrap(98, 99, true)), (None, Some(Order::Start)));
        press(&mut t, "m", 20);
        assert_eq!((t.wrap(5, 15, false), t.wrap(19, 20, false)), (None, Some(Order::SeekTo(10))));
        assert_eq!(t.wrap(98, 99, true), Some(Order::SeekTo(20)), "from the last mark to the end");
        t.looping = false;
        assert_eq!(t.wrap(19, 20, true), None);
    }

    proptest! {
        #[test]
        fn any_keys_leave_it_in_order(codes in prop::collection::vec(0usize..95, 0..200)) {
            let keys: Vec<Key> = Key::all().collect();
            let mut t = Transport::new(true, 1.0, false);
            for (i, code) in codes.into_iter().enumerate() {
                t.press(keys[code % keys.len()], i as u64 / 3);
                prop_assert!(RATES[0] <= t.rate && t.rate <= RATES[1]);
                prop_assert!(t.marks.is_sorted() && t.text().len() < 120);
            }
        }
    }
}
