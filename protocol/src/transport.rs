//! Keys of a replay, in a window or a terminal: one table for what they do and for the help.

use crate::bindings::shown;
use crate::inputs::Key;

/// What a key of a replay does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Move {
    Play,
    FieldBack,
    FieldForward,
    StepBack,
    StepForward,
    EventBack,
    EventForward,
    Slower,
    Faster,
    Start,
    End,
    GoTo,
    Mark,
    MarkBack,
    MarkForward,
    Loop,
    Help,
    Quit,
}

/// Every move with its keys and its meaning. Keys without letters first: the help names the first one.
pub const MOVES: &[(Move, &[&str], &str)] = &[
    (Move::Play, &["space", "p"], "play, pause"),
    (Move::FieldBack, &["left"], "a field back"),
    (Move::FieldForward, &["right"], "a field forward"),
    (Move::StepBack, &["comma"], "a step of the simulation back"),
    (Move::StepForward, &["period"], "a step of the simulation forward"),
    (Move::EventBack, &["page-up"], "to the previous event"),
    (Move::EventForward, &["page-down"], "to the next event"),
    (Move::Slower, &["down"], "half as fast"),
    (Move::Faster, &["up"], "twice as fast"),
    (Move::Start, &["home"], "to the start"),
    (Move::End, &["end"], "to the end"),
    (Move::GoTo, &["g"], "go to a time: 12.5, a field: f600, or a step: s550; then Enter"),
    (Move::Mark, &["m"], "set or remove a mark"),
    (Move::MarkBack, &["b"], "to the previous mark"),
    (Move::MarkForward, &["n"], "to the next mark"),
    (Move::Loop, &["o"], "loop the whole, or from the previous mark to the next"),
    (Move::Help, &["h", "f1"], "show or hide these keys"),
    (Move::Quit, &["q", "f10"], "end the program"),
];

impl Move {
    /// The move of a key, if it has one.
    pub fn of(key: Key) -> Option<Move> {
        MOVES.iter().find(|(_, keys, _)| keys.contains(&key.name())).map(|(what, ..)| *what)
    }
}

/// The table in rows: keys as people write them, and what they do.
pub fn rows() -> impl Iterator<Item = (String, &'static str)> {
    let written = |keys: &[&str]| keys.iter().map(|key| shown(key)).collect::<Vec<_>>().join(", ");
    MOVES.iter().map(move |(_, keys, text)| (written(keys), *text))
}

/// The help, a line each.
pub fn help() -> String {
    rows().map(|(keys, text)| format!("{keys}: {text}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_exists_and_means_one_thing() {
        let mut seen = 0u128;
        for (what, keys, _) in MOVES {
            for name in *keys {
                let key = Key::named(name).unwrap_or_else(|| panic!("no key {name}"));
                assert_eq!(seen & key.bit(), 0, "{name} means two things");
                seen |= key.bit();
                assert_eq!(Move::of(key), Some(*what));
            }
        }
        assert_eq!(Move::of(Key::named("y").unwrap()), None);
    }

    #[test]
    fn the_help_fits_the_picture() {
        assert!(help().lines().count() <= 30 && help().lines().all(|line| line.chars().count() <= 80));
    }

    #[test]
    fn the_documents_list_every_key() {
        let page = include_str!("../../docs/recording.md");
        for (keys, text) in rows() {
            assert!(page.contains(&format!("| {keys} | {text} |")), "docs/recording.md lacks {keys}: {text}");
        }
    }
}
