//! How a real pedal and real handles did, for the report of a run. Their process keeps it as a file of JSON
//! in the instance's directory, once a second and when it ends.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the file in the instance's directory: a list of [`ControlFigures`].
pub const CONTROLS_FILE: &str = "controls.json";

/// How one device did.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlFigures {
    /// `pedal` or `handles`.
    pub control: String,
    /// Where it is.
    pub source: String,
    /// Events, reports or samples taken in.
    pub taken: u64,
    /// Messages sent of it.
    pub sent: u64,
    /// How often it was opened.
    pub openings: u64,
    /// What could not be used, by what was wrong with it.
    pub bad: BTreeMap<String, u64>,
    /// Lines that did not arrive, by their numbers.
    pub missing: u64,
    /// How often what was wrong with it, by kind.
    pub troubles: BTreeMap<String, u64>,
    /// What is wrong at the end, in words; empty where nothing is.
    pub trouble: String,
}

impl ControlFigures {
    /// One line for a person.
    pub fn line(&self) -> String {
        let mut line =
            format!("{} ({}): {} taken in, {} sent", self.control, self.source, self.taken, self.sent);
        let counted = |counts: &BTreeMap<String, u64>| {
            counts.iter().map(|(what, n)| format!("{what} {n} ×")).collect::<Vec<_>>().join(", ")
        };
        if self.missing > 0 {
            line += &format!(", {} lines missing", self.missing);
        }
        for counts in [&self.bad, &self.troubles].into_iter().filter(|counts| !counts.is_empty()) {
            line += &format!("; {}", counted(counts));
        }
        if !self.trouble.is_empty() {
            line += &format!("; at the end: {}", self.trouble);
        }
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_names_what_was_wrong_and_what_still_is() {
        let (control, source) = ("handles".to_owned(), "serial:s".to_owned());
        let sound =
            ControlFigures { control, source, taken: 9, sent: 4, openings: 1, ..ControlFigures::default() };
        assert_eq!(sound.line(), "handles (serial:s): 9 taken in, 4 sent");
        let bad = BTreeMap::from([("wrong checksum".to_owned(), 2)]);
        let troubles = BTreeMap::from([("gone".to_owned(), 3), ("silent".to_owned(), 1)]);
        let line = ControlFigures { bad, missing: 7, troubles, trouble: "is gone".into(), ..sound }.line();
        let expected =
            "4 sent, 7 lines missing; wrong checksum 2 ×; gone 3 ×, silent 1 ×; at the end: is gone";
        assert!(line.ends_with(expected), "{line}");
    }
}
