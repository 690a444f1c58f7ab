//! What the keys of the window of `vitreo inspect` do: pure; keys in, the frame that is shown out.

use crate::transport::Target;
use protocol::bindings::shown;
use protocol::inputs::Key;
use protocol::time::Nanos;

/// A second, ns.
const SECOND_NS: Nanos = 1_000_000_000;
/// Most characters of a place that is typed.
const TYPED: usize = 12;

/// What a key does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Move {
    Back,
    Forward,
    SecondBack,
    SecondForward,
    ConspicuousBack,
    ConspicuousForward,
    Start,
    End,
    GoTo,
    Play,
    Save,
    Help,
    Quit,
}

/// Every move with its keys and its meaning.
const MOVES: &[(Move, &[&str], &str)] = &[
    (Move::Back, &["left"], "a field back"),
    (Move::Forward, &["right"], "a field forward"),
    (Move::SecondBack, &["down"], "a second back"),
    (Move::SecondForward, &["up"], "a second forward"),
    (Move::ConspicuousBack, &["page-up"], "back to where a blob was rejected or a body not measured"),
    (Move::ConspicuousForward, &["page-down"], "on to the next such place"),
    (Move::Start, &["home"], "to the start"),
    (Move::End, &["end"], "to the end"),
    (Move::GoTo, &["g"], "go to a time: 12.5, or a field: f600; then Enter"),
    (Move::Play, &["space", "p"], "play, pause"),
    (Move::Save, &["s"], "save this picture as PNG in the folder you are in"),
    (Move::Help, &["h", "f1"], "show or hide these keys and what the signs mean"),
    (Move::Quit, &["q", "f10"], "end the program"),
];
/// Keys that choose a camera.
const CAMERAS: (&str, &str) = ("1 to 9", "this camera of the rig alone; 0: all");

/// The keys in rows, and what they do.
pub fn rows() -> impl Iterator<Item = (String, &'static str)> {
    let written = |keys: &[&str]| keys.iter().map(|key| shown(key)).collect::<Vec<_>>().join(", ");
    let moves = MOVES.iter().map(move |(_, keys, text)| (written(keys), *text));
    moves.chain([(CAMERAS.0.to_owned(), CAMERAS.1)])
}

/// A frame, as far as one looks for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameSummary {
    /// When it was exposed.
    pub exposed_ns: Nanos,
    /// Its field.
    pub field: u64,
    /// A blob was rejected, or a body not measured.
    pub conspicuous: bool,
}

/// What is to be done after a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Draw what is shown now.
    Draw,
    /// Write it to a file.
    Save,
    /// End.
    Quit,
}

/// Where the person is.
#[derive(Debug)]
pub struct Browser {
    frames: Vec<FrameSummary>,
    at: usize,
    cameras: usize,
    /// It goes on by itself.
    pub playing: bool,
    /// The only camera that is shown: its place in the rig.
    pub alone: Option<usize>,
    /// Keys are shown.
    pub help: bool,
    /// A place that is being typed.
    typed: Option<String>,
    /// What the last key could not do, or did.
    pub said: String,
}

impl Browser {
    /// At a frame, counted from 0, of those there are; of so many cameras.
    pub fn new(frames: Vec<FrameSummary>, at: usize, cameras: usize) -> Self {
        let at = at.min(frames.len().saturating_sub(1));
        Browser {
            frames,
            at,
            cameras,
            playing: false,
            alone: None,
            help: false,
            typed: None,
            said: String::new(),
        }
    }

    /// The frame that is shown, counted from 0.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Field of the frame that is shown.
    pub fn field(&self) -> u64 {
        self.frames.get(self.at).map_or(0, |m| m.field)
    }

    /// True where no frame comes after this one.
    pub fn is_at_end(&self) -> bool {
        self.at + 1 >= self.frames.len()
    }

    /// Time of a frame since the first, s.
    pub fn time_s(&self, number: usize) -> f64 {
        let ns = |n: usize| self.frames.get(n).map_or(0, |m| m.exposed_ns);
        ns(number).saturating_sub(ns(0)) as f64 * 1e-9
    }

    /// Where it stands, in words.
    pub fn line(&self) -> String {
        let field = |n: usize| self.frames.get(n).map_or(0, |m| m.field);
        let last = self.frames.len().saturating_sub(1);
        let playing = if self.playing { "   playing" } else { "" };
        let typed = self.typed.as_ref().map_or(String::new(), |typed| format!("   go to: {typed}_"));
        let (at_s, end_s) = (self.time_s(self.at), self.time_s(last));
        let fields = format!("field {} of {} to {}", field(self.at), field(0), field(last));
        let said = if self.said.is_empty() { String::new() } else { format!("   {}", self.said) };
        format!("{at_s:.2} of {end_s:.2} s   {fields}{playing}{typed}{said}   (h: keys)")
    }

    /// Goes to the frame that was exposed last at `s` after the first.
    pub fn go_to_time(&mut self, s: f64) {
        let start = self.frames.first().map_or(0, |m| m.exposed_ns);
        // Half a microsecond more, so that the time of a frame as it is written leads to it.
        let until = start.saturating_add((s.max(0.0) * 1e9) as Nanos + 500);
        self.at = self.frames.partition_point(|m| m.exposed_ns <= until).saturating_sub(1);
    }

    /// Takes a key.
    pub fn press(&mut self, key: Key) -> Order {
        self.said.clear();
        if self.typed.is_some() {
            self.type_on(key.name());
            return Order::Draw;
        }
        if let Ok(digit) = key.name().parse::<usize>() {
            self.choose(digit);
            return Order::Draw;
        }
        let found = MOVES.iter().find(|(_, keys, _)| keys.contains(&key.name()));
        let Some((what, ..)) = found else { return Order::Draw };
        if !matches!(what, Move::Play | Move::Help | Move::Save) {
            self.playing = false;
        }
        self.carry_out(*what)
    }

    fn carry_out(&mut self, what: Move) -> Order {
        let last = self.frames.len().saturating_sub(1);
        match what {
            Move::Back => self.at = self.at.saturating_sub(1),
            Move::Forward => self.at = (self.at + 1).min(last),
            Move::SecondBack => self.by_a_second(false),
            Move::SecondForward => self.by_a_second(true),
            Move::ConspicuousBack => self.go_to_conspicuous(false),
            Move::ConspicuousForward => self.go_to_conspicuous(true),
            Move::Start => self.at = 0,
            Move::End => self.at = last,
            Move::GoTo => self.typed = Some(String::new()),
            Move::Play => self.playing = !self.playing,
            Move::Help => self.help = !self.help,
            Move::Save => return Order::Save,
            Move::Quit => return Order::Quit,
        }
        Order::Draw
    }

    fn choose(&mut self, digit: usize) {
        self.alone = digit.checked_sub(1).filter(|n| *n < self.cameras);
        if digit > self.cameras {
            self.said = format!("the rig has {} cameras", self.cameras);
        }
    }

    fn by_a_second(&mut self, forward: bool) {
        let now = self.frames.get(self.at).map_or(0, |m| m.exposed_ns);
        let to = if forward { now.saturating_add(SECOND_NS) } else { now.saturating_sub(SECOND_NS) };
        let last = self.frames.len().saturating_sub(1);
        self.at = self.frames.partition_point(|m| m.exposed_ns < to).min(last);
    }

    /// To the next frame, or that before, where a conspicuous stretch begins.
    fn go_to_conspicuous(&mut self, forward: bool) {
        let begins = |n: &usize| {
            let is = |n: usize| self.frames[n].conspicuous;
            is(*n) && n.checked_sub(1).is_none_or(|before| !is(before))
        };
        let found = if forward {
            (self.at + 1..self.frames.len()).find(begins)
        } else {
            (0..self.at.min(self.frames.len())).rev().find(begins)
        };
        match found {
            Some(n) => self.at = n,
            None => self.said = format!("no {} such place", if forward { "further" } else { "earlier" }),
        }
    }

    /// Takes a key of a place that is typed.
    fn type_on(&mut self, name: &str) {
        let Some(typed) = &mut self.typed else { return };
        match name {
            "enter" => self.go_to_typed(),
            "escape" => self.typed = None,
            "backspace" => drop(typed.pop()),
            "period" if typed.len() < TYPED => typed.push('.'),
            _ if name.len() == 1 && typed.len() < TYPED => typed.push_str(name),
            _ => {}
        }
    }

    fn go_to_typed(&mut self) {
        let Some(typed) = self.typed.take() else { return };
        match Target::parse(&typed) {
            Some(Target::Time(s)) => self.go_to_time(s),
            Some(Target::Field(field)) => {
                let behind = self.frames.iter().position(|m| m.field >= field);
                self.at = behind.unwrap_or(self.frames.len().saturating_sub(1));
            }
            _ => self.said = format!("'{typed}' is neither a time, as 12.5, nor a field, as f600"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Ten seconds of fields from 100 on, of which some are conspicuous.
    fn browser() -> Browser {
        let mark = |n: u64| FrameSummary {
            exposed_ns: 5_000_000_000 + n * 20_000_000,
            field: 100 + n,
            conspicuous: (40..60).contains(&n) || n == 300,
        };
        Browser::new((0..500).map(mark).collect(), 0, 3)
    }

    fn press(browser: &mut Browser, keys: &str) -> Vec<Order> {
        keys.split(' ').map(|name| browser.press(Key::named(name).unwrap())).collect()
    }

    #[test]
    fn keys_lead_through_the_frames() {
        let mut b = browser();
        press(&mut b, "left right right up");
        assert_eq!(b.at(), 52);
        press(&mut b, "down page-down");
        assert_eq!(b.at(), 40);
        press(&mut b, "page-down");
        assert_eq!(b.at(), 300);
        press(&mut b, "page-down");
        assert_eq!((b.at(), b.said.as_str()), (300, "no further such place"));
        press(&mut b, "page-up");
        assert_eq!((b.at(), b.said.as_str()), (40, ""));
        press(&mut b, "end right up");
        assert_eq!(b.at(), 499);
        press(&mut b, "home left down");
        assert_eq!(b.at(), 0);
        assert_eq!(press(&mut b, "s h q"), [Order::Save, Order::Draw, Order::Quit]);
        assert!(b.help);
    }

    #[test]
    fn a_typed_place_is_gone_to() {
        let mut b = browser();
        press(&mut b, "g 4 period 0 2");
        assert!(b.line().contains("go to: 4.02_"), "{}", b.line());
        press(&mut b, "enter");
        assert_eq!((b.at(), b.alone), (201, None));
        press(&mut b, "g f 1 2 3 backspace 4 enter");
        assert_eq!(b.at(), 24);
        press(&mut b, "g f 9 9 9 9 enter");
        assert_eq!(b.at(), 499);
        press(&mut b, "g q 1 enter");
        assert!(b.said.contains("neither a time"), "{}", b.said);
        press(&mut b, "g 7 escape 2");
        assert_eq!((b.at(), b.alone), (499, Some(1)));
        press(&mut b, "4");
        assert_eq!((b.alone, b.said.as_str()), (None, "the rig has 3 cameras"));
    }

    #[test]
    fn the_documents_list_every_key() {
        let page = include_str!("../../../../docs/recording.md");
        for (keys, text) in rows() {
            assert!(page.contains(&format!("| {keys} | {text} |")), "docs/recording.md lacks {keys}: {text}");
        }
        let names = MOVES.iter().flat_map(|(_, keys, _)| *keys);
        assert!(names.clone().all(|name| Key::named(name).is_some()) && names.count() == 16);
    }

    proptest! {
        #[test]
        fn no_keys_lead_out_of_the_frames(
            keys in prop::collection::vec(0usize..95, 0..200), frames in 0u64..5, at in 0usize..9,
        ) {
            let mark = |n| FrameSummary { exposed_ns: n * 20_000_000, field: n, conspicuous: n % 2 == 1 };
            let mut b = Browser::new((0..frames).map(mark).collect(), at, 2);
            let all: Vec<Key> = Key::all().collect();
            for key in keys {
                b.press(all[key % all.len()]);
                prop_assert!(b.at() < (frames as usize).max(1) && !b.line().is_empty());
            }
        }
    }
}
