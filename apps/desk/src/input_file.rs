//! Files of inputs, played in place of a user: for tests and demonstrations. A line is an instant
//! (s) and an input.
//!
//! ```text
//! # seconds   what
//! 0.5         move 120 -30     # px to the right and down
//! +0.2        wheel 3          # 0.2 s after the line before
//! 2.0         press mouse-left
//! 2.5         release mouse-left
//! 3.0         tap tab
//! 3.5         axis left-x 0.5
//! 9.0         end
//! ```

use protocol::bindings::Action;
use protocol::control::Command;
use protocol::file::read_text;
use protocol::inputs::{Axis, Input, Key};
use std::path::Path;

/// Longest file, bytes: as many lines as one may have, forty letters each.
const MAX_INPUT_BYTES: u64 = 4 << 20;
/// Most lines of a file.
const MAX_LINES: usize = 100_000;
/// Latest instant of a line, s.
const LATEST_S: f64 = 86_400.0;
/// Time after the last line at which a file without a line `end` ends, s.
const AFTER_S: f64 = 1.0;
/// Inputs that a line can hold.
const WORDS: &str =
    "press KEY, release KEY, tap KEY, move RIGHT DOWN, wheel NOTCHES, axis NAME PLACE, let-go or end";

/// Why a file of inputs was refused.
#[derive(Debug, thiserror::Error)]
pub enum InputFileError {
    /// It cannot be read.
    #[error("file of inputs {file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line is refused.
    #[error("file of inputs {file}, line {line}: expected {expected}, found {found}")]
    Line {
        /// The file.
        file: String,
        /// From 1 on.
        line: usize,
        /// What would be right.
        expected: String,
        /// What is there.
        found: String,
    },
}

/// A checked file.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// Instants, s, rising, with their inputs.
    steps: Vec<(f64, Input)>,
    end_s: f64,
}

impl Inputs {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read or a line is refused.
    pub fn load(path: &Path) -> Result<Self, InputFileError> {
        let file = path.display().to_string();
        let text = read_text(path, MAX_INPUT_BYTES)
            .map_err(|source| InputFileError::Read { file: file.clone(), source })?;
        Self::parse(&text, &file)
    }

    /// Reads a text; `file` is its name for messages.
    ///
    /// # Errors
    /// If a line is refused; the error names it and what was expected.
    pub fn parse(text: &str, file: &str) -> Result<Self, InputFileError> {
        let (mut steps, mut last_s, mut end_s) = (Vec::new(), 0.0, None);
        for (index, line) in text.lines().enumerate() {
            let refuse = |expected: &str, found: &str| InputFileError::Line {
                file: file.into(),
                line: index + 1,
                expected: expected.into(),
                found: if found.is_empty() { "nothing".into() } else { format!("'{found}'") },
            };
            if index >= MAX_LINES {
                return Err(refuse(&format!("at most {MAX_LINES} lines"), "more"));
            }
            let words: Vec<&str> = line.split('#').next().unwrap_or("").split_whitespace().collect();
            let Some((at, what)) = words.split_first() else { continue };
            if end_s.is_some() {
                return Err(refuse("nothing after end", at));
            }
            let at_s = instant(at, last_s).map_err(|expected| refuse(&expected, at))?;
            last_s = at_s;
            if what == ["end"] {
                end_s = Some(at_s);
                continue;
            }
            let done = inputs(what).map_err(|(expected, found)| refuse(&expected, &found))?;
            steps.extend(done.into_iter().flatten().map(|input| (at_s, input)));
        }
        Ok(Inputs { steps, end_s: end_s.unwrap_or(last_s + AFTER_S) })
    }
}

/// The instant of a line, s, not before `last_s`; or what was expected.
fn instant(word: &str, last_s: f64) -> Result<f64, String> {
    let (number, from) = word.strip_prefix('+').map_or((word, 0.0), |later| (later, last_s));
    let at_s = number.parse::<f64>().map(|s| s + from).unwrap_or(f64::NAN);
    if (last_s..=LATEST_S).contains(&at_s) {
        return Ok(at_s);
    }
    Err(format!("seconds from {last_s} (the line before) to {LATEST_S}, or +SECONDS after it"))
}

/// The inputs of a line; or what was expected and what was found.
fn inputs(words: &[&str]) -> Result<[Option<Input>; 2], (String, String)> {
    let key = |name: &str| {
        Key::named(name).ok_or_else(|| {
            let known: Vec<&str> = Key::all().filter(|k| Action::of(*k).is_some()).map(Key::name).collect();
            (format!("a key: {}", known.join(", ")), name.to_owned())
        })
    };
    let number = |word: &str| {
        let value = word.parse::<f64>().ok().filter(|v| v.abs() <= 10_000.0);
        value.ok_or_else(|| ("a number from −10000 to 10000".to_owned(), word.to_owned()))
    };
    Ok(match words {
        ["press", name] => [Some(Input::Press(key(name)?)), None],
        ["release", name] => [Some(Input::Release(key(name)?)), None],
        ["tap", name] => [Some(Input::Press(key(name)?)), Some(Input::Release(key(name)?))],
        ["move", right, down] => [Some(Input::Move([number(right)?, number(down)?])), None],
        ["wheel", notches] => [Some(Input::Wheel(number(notches)?)), None],
        ["axis", name, place] => {
            let axis = Axis::named(name)
                .ok_or_else(|| ("left-x, left-y, right-x or right-y".to_owned(), (*name).to_owned()))?;
            let place = number(place)?;
            if place.abs() > 1.0 {
                return Err(("a place from −1 to 1".into(), place.to_string()));
            }
            [Some(Input::Axis(axis, place)), None]
        }
        ["let-go"] => [Some(Input::LetGo), None],
        _ => return Err((WORDS.into(), words.join(" "))),
    })
}

/// Plays a file. Its clock stops while a request of the file (pause, restart, next) waits to be
/// served, so that later inputs come after it on any machine.
#[derive(Debug, Clone)]
pub struct Player {
    inputs: Inputs,
    at_s: f64,
    next: usize,
    /// The request it waits for, and how much longer, s.
    waits: Option<(Action, f64)>,
}

/// Longest wait for a request to be served, s.
const MAX_WAIT_S: f64 = 20.0;

impl Player {
    /// At the beginning.
    pub fn new(inputs: Inputs) -> Self {
        Player { inputs, at_s: 0.0, next: 0, waits: None }
    }

    /// Advances by `dt_s`; `done` gets the inputs until then.
    pub fn advance(&mut self, dt_s: f64, mut done: impl FnMut(Input)) {
        if let Some((_, left_s)) = &mut self.waits {
            *left_s -= dt_s;
            if *left_s <= 0.0 {
                self.waits = None;
            }
            return;
        }
        self.at_s += dt_s;
        while let Some((at_s, input)) = self.inputs.steps.get(self.next).copied() {
            // Half a microsecond: sums of times are not exact.
            if at_s > self.at_s + 5e-7 || self.waits.is_some() {
                return;
            }
            self.next += 1;
            done(input);
            if let Input::Press(key) = input {
                let course = [Action::Pause, Action::Help, Action::Restart, Action::Next];
                let action = Action::of(key).filter(|a| course.contains(a));
                self.waits = action.map(|a| (a, MAX_WAIT_S));
            }
        }
    }

    /// Takes a command in that the launcher gave and the desk executed. A restart is served when
    /// everything starts again.
    pub fn served(&mut self, command: Command) {
        let over = match self.waits {
            Some((Action::Pause | Action::Help, _)) => matches!(command, Command::Pause | Command::Start),
            _ => command == Command::Start,
        };
        if over {
            self.waits = None;
        }
    }

    /// True once the file is over.
    pub fn is_over(&self) -> bool {
        self.next == self.inputs.steps.len() && self.at_s >= self.inputs.end_s && self.waits.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(name: &str) -> Key {
        Key::named(name).unwrap()
    }

    #[test]
    fn a_file_is_played_in_time() {
        let text = "# a comment\n0.1 press a # with another\n\n+0.1 release a\n0.2 move 3 -4\n0.5 tap tab\n0.6 end\n";
        let mut player = Player::new(Inputs::parse(text, "t").unwrap());
        let mut seen = Vec::new();
        for field in 1..=31 {
            player.advance(0.02, |input| seen.push((field, input)));
            assert_eq!(player.is_over(), field >= 30);
        }
        let tab = key("tab");
        let expected = [
            (5, Input::Press(key("a"))),
            (10, Input::Release(key("a"))),
            (10, Input::Move([3.0, -4.0])),
            (25, Input::Press(tab)),
            (25, Input::Release(tab)),
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn the_clock_waits_for_a_request_to_be_served() {
        let inputs = Inputs::parse("0.1 tap f5\n+0.1 move 1 0", "t").unwrap();
        let mut player = Player::new(inputs);
        let mut count = 0;
        (0..500).for_each(|_| player.advance(0.02, |_| count += 1));
        assert_eq!(count, 1, "the press and nothing after it");
        for command in [Command::Pause, Command::Reset] {
            player.served(command);
            player.advance(0.02, |_| count += 1);
        }
        assert_eq!(count, 1, "it starts again, but nothing moves yet");
        player.served(Command::Start);
        player.advance(0.02, |_| count += 1);
        assert_eq!(count, 2, "the release follows at once");
        (0..5).for_each(|_| player.advance(0.02, |_| count += 1));
        assert_eq!(count, 3);
        let mut alone = Player::new(Inputs::parse("0 tap p\n1 move 1 0", "t").unwrap());
        let mut moved = false;
        (0..1200).for_each(|_| alone.advance(0.02, |input| moved |= matches!(input, Input::Move(_))));
        assert!(moved && alone.is_over(), "without a server it continues in the end");
    }

    #[test]
    fn what_is_wrong_is_told_with_file_and_line() {
        let problem = |text: &str| Inputs::parse(text, "moves.txt").unwrap_err().to_string();
        let wrong = problem("0 tap tab\n1 press any-key\n");
        for word in ["moves.txt", "line 2", "'any-key'", "mouse-left", "f5"] {
            assert!(wrong.contains(word), "{word}: {wrong}");
        }
        assert!(problem("2 wheel 1\n1 wheel 1").contains("line 2: expected seconds from 2"));
        assert!(problem("x wheel 1").contains("'x'"));
        assert!(problem("1 wheel").contains("press KEY"));
        assert!(problem("1 wheel nan").contains("a number"));
        assert!(problem("1 axis left-x 3").contains("−1 to 1"));
        assert!(problem("1 axis left 1").contains("left-x"));
        assert!(problem("1 end\n2 wheel 1").contains("nothing after end"));
        let missing = Inputs::load(Path::new("/nowhere/moves.txt")).unwrap_err().to_string();
        assert!(missing.contains("/nowhere/moves.txt"), "{missing}");
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[ -~\n]{0,200}") {
            if let Ok(inputs) = Inputs::parse(&text, "t") {
                prop_assert!(inputs.steps.windows(2).all(|w| w[0].0 <= w[1].0) && inputs.end_s.is_finite());
            }
        }
    }
}
