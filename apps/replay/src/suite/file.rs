//! Suite files: cases, and what is expected of each. TOML; unknown keys are refused.

use protocol::budget::Stage;
use protocol::events::EventKind;
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::parse_error;
use protocol::poses::BODY_NAMES;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use training::score::table::Category;

/// A suite.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// Its cases, in the order of the file.
    pub case: Vec<Case>,
}

/// A case: a recording, a blob stream or a module, and what is expected of it.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Case {
    /// What it is called in the outcome.
    pub name: String,
    /// A recording; files are named from the folder of the suite.
    pub recording: Option<PathBuf>,
    /// A blob stream, with its rig and its truth.
    pub stream: Option<PathBuf>,
    /// The rig of the stream.
    pub rig: Option<PathBuf>,
    /// Where tips were, in the columns of docs/blob-stream.md.
    pub truth: Option<PathBuf>,
    /// A module, which a scripted surgeon does now.
    pub module: Option<String>,
    /// Its level [default: 1].
    pub level: Option<u32>,
    /// Who does it [default: expert].
    pub surgeon: Option<String>,
    /// Seed of the attempt [default: 1].
    pub seed: Option<u64>,
    /// The recording comes out to the bit [default: true].
    pub verify: Option<bool>,
    /// Least share of frames in which each body was tracked, 0 to 1.
    pub tracked: Option<f64>,
    /// How often an event is raised, by its name.
    pub events: BTreeMap<String, Range<u64>>,
    /// Points of the score, by category or `total`.
    pub score: BTreeMap<String, Range<f64>>,
    /// Largest RMS of a tip's distance from its truth, µm, by instrument.
    pub tips_um: BTreeMap<String, f64>,
    /// Largest 99th percentile of a stage's latency in the recorded run, ms.
    pub latency_ms: BTreeMap<Stage, f64>,
}

/// What a number is expected to be: itself, or between two.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Range<T> {
    /// This.
    Exactly(T),
    /// At least the first and at most the second.
    Between([T; 2]),
}

impl<T: PartialOrd + Copy> Range<T> {
    /// The smallest and the largest.
    pub fn limits(self) -> [T; 2] {
        match self {
            Range::Exactly(value) => [value; 2],
            Range::Between(limits) => limits,
        }
    }

    /// Whether a number is within it.
    pub fn holds(self, value: T) -> bool {
        let [least, most] = self.limits();
        least <= value && value <= most
    }
}

/// Why a suite file was refused.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// It cannot be read, or is no TOML of a suite.
    #[error("suite {file}: {problem}")]
    File {
        /// The file.
        file: String,
        /// What is wrong, with the line where the parser knows it.
        problem: String,
    },
    /// A case makes no sense.
    #[error("suite {file}: case '{case}': {key}: expected {expected}")]
    Case {
        /// The file.
        file: String,
        /// The case.
        case: String,
        /// The key.
        key: String,
        /// What would be right.
        expected: &'static str,
    },
}

impl Suite {
    /// Reads a suite.
    ///
    /// # Errors
    /// Where the file cannot be read, or is refused.
    pub fn load(path: &Path) -> Result<Self, SuiteError> {
        let file = path.display().to_string();
        let text = read_text(path, MAX_SETTINGS_BYTES)
            .map_err(|problem| SuiteError::File { file: file.clone(), problem: problem.to_string() })?;
        Self::parse(&text, &file)
    }

    /// Parses a suite; `file` is for messages.
    ///
    /// # Errors
    /// Where it is no TOML, has an unknown key, or a case makes no sense.
    pub fn parse(text: &str, file: &str) -> Result<Self, SuiteError> {
        let refused = |problem: String| SuiteError::File { file: file.into(), problem };
        let suite: Suite =
            toml::from_str(text).map_err(|problem| refused(parse_error::toml(text, &problem)))?;
        if suite.case.is_empty() {
            return Err(refused("expected [[case]], found none".into()));
        }
        for (number, case) in suite.case.iter().enumerate() {
            let twice = suite.case[..number].iter().any(|other| other.name == case.name);
            let defect =
                if twice { Some(("name".into(), "another name than before")) } else { case.defect() };
            if let Some((key, expected)) = defect {
                let case = if case.name.is_empty() { format!("{}", number + 1) } else { case.name.clone() };
                return Err(SuiteError::Case { file: file.into(), case, key, expected });
            }
        }
        Ok(suite)
    }
}

impl Case {
    /// The first key that makes no sense, and what would be right.
    fn defect(&self) -> Option<(String, &'static str)> {
        let of_streams = self.rig.is_some() || self.truth.is_some() || !self.tips_um.is_empty();
        let of_modules = self.level.is_some() || self.surgeon.is_some() || self.seed.is_some();
        let kinds = [self.recording.is_some(), self.stream.is_some(), self.module.is_some()];
        let is_stream = self.stream.is_some();
        let expects_nothing = self.events.is_empty()
            && self.score.is_empty()
            && self.latency_ms.is_empty()
            && self.tips_um.is_empty()
            && self.tracked.is_none()
            && !(self.recording.is_some() && self.verify != Some(false));
        let keys = [
            (self.name.is_empty(), "name", "a name"),
            (
                kinds.iter().filter(|given| **given).count() != 1,
                "recording",
                "one of recording, stream and module",
            ),
            (is_stream && self.rig.is_none(), "rig", "the rig of the stream"),
            (!is_stream && of_streams, "rig, truth, tips_um", "none: they are of a stream"),
            (!self.tips_um.is_empty() && self.truth.is_none(), "truth", "the truth for tips_um"),
            (is_stream && !self.score.is_empty(), "score", "none: a stream is no attempt"),
            (self.module.is_none() && of_modules, "level, surgeon, seed", "none: they are of a module"),
            (
                self.module.is_some() && self.tracked.is_some(),
                "tracked",
                "none: a module is done without cameras",
            ),
            (
                self.recording.is_none() && !self.latency_ms.is_empty(),
                "latency_ms",
                "none: latencies are those of a recorded run",
            ),
            (self.recording.is_none() && self.verify.is_some(), "verify", "none: it is of a recording"),
            (
                self.tracked.is_some_and(|share| !(0.0..=1.0).contains(&share)),
                "tracked",
                "a share from 0 to 1",
            ),
            (expects_nothing, "events", "something that is expected"),
        ];
        let found = keys.into_iter().find(|(wrong, ..)| *wrong);
        found.map(|(_, key, expected)| (key.into(), expected)).or_else(|| self.entry_defect())
    }

    /// The same, of the entries of its tables.
    fn entry_defect(&self) -> Option<(String, &'static str)> {
        let known = |name: &str| name == "total" || Category::ALL.iter().any(|c| c.key() == name);
        for (name, range) in &self.score {
            let [least, most] = range.limits();
            let wrong = [
                (!known(name), "total, target, efficiency, instruments, microscope or tissue"),
                (!(least <= most && least.is_finite() && most.is_finite()), "the smaller number first"),
            ];
            if let Some((_, expected)) = wrong.into_iter().find(|(wrong, _)| *wrong) {
                return Some((format!("score.{name}"), expected));
            }
        }
        for (name, range) in &self.events {
            if EventKind::from_name(name).is_none() {
                return Some((format!("events.{name}"), "an event of docs/modules.md"));
            }
            if range.limits()[0] > range.limits()[1] {
                return Some((format!("events.{name}"), "the smaller number first"));
            }
        }
        for (name, most) in &self.tips_um {
            if !(BODY_NAMES[..2].contains(&name.as_str()) && most.is_finite() && *most > 0.0) {
                return Some((format!("tips_um.{name}"), "inst0 or inst1, and µm above 0"));
            }
        }
        let latency = self.latency_ms.iter().find(|(_, most)| !(most.is_finite() && **most > 0.0));
        latency.map(|(stage, _)| (format!("latency_ms.{}", stage.name()), "ms above 0"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_a_suite_says_is_read() {
        let text = r#"
            [[case]]
            name = "golden"
            recording = "golden.mcap"
            tracked = 0.9
            events = { "task.started" = 1, "retina.bleb_filled" = [0, 3] }
            latency_ms = { tracking = 1.0, whole-system = 65 }
            [[case]]
            name = "peeling"
            module = "peeling"
            score = { total = [90.0, 100.0] }
        "#;
        let suite = Suite::parse(text, "a.toml").unwrap();
        let [golden, peeling] = &suite.case[..] else { panic!("two cases") };
        assert_eq!((golden.tracked, golden.latency_ms[&Stage::WholeSystem]), (Some(0.9), 65.0));
        let counts: Vec<_> = golden.events.values().map(|range| range.limits()).collect();
        assert!(counts.contains(&[1, 1]) && counts.contains(&[0, 3]), "{counts:?}");
        assert!(peeling.score["total"].holds(95.0) && !peeling.score["total"].holds(89.9));
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        let refused =
            |case: &str| Suite::parse(&format!("[[case]]\n{case}"), "a.toml").unwrap_err().to_string();
        for (case, told) in [
            ("recording = \"a\"", "case '1': name"),
            ("name = \"a\"", "one of recording, stream and module"),
            ("name = \"a\"\nrecording = \"a\"\nmodule = \"b\"", "one of"),
            ("name = \"a\"\nstream = \"a\"\ntracked = 1", "rig"),
            ("name = \"a\"\nrecording = \"a\"\nverify = false", "something that is expected"),
            ("name = \"a\"\nmodule = \"a\"\nscore = { total = [9, 1] }", "score.total: expected the smaller"),
            ("name = \"a\"\nmodule = \"a\"\nscore = { style = 3 }", "score.style"),
            ("name = \"a\"\nmodule = \"a\"\nevents = { \"a.b\" = 3 }", "a.b"),
            ("name = \"a\"\nmodule = \"a\"\ntracked = 1", "without cameras"),
            ("name = \"a\"\nrecording = \"a\"\ntracked = 2", "0 to 1"),
            ("name = \"a\"\nrecording = \"a\"\nlatency_ms = { tracking = 0 }", "latency_ms.tracking"),
            ("name = \"a\"\nrecording = \"a\"\nlatency_ms = { walking = 1 }", "walking"),
            ("name = \"a\"\nrecording = \"a\"\n[[case]]\nname = \"a\"\nrecording = \"a\"", "another name"),
            ("name = \"a\"\nrecording = \"a\"\ncolour = 1", "colour"),
        ] {
            let error = refused(case);
            assert!(error.contains(told) && error.contains("a.toml"), "{case}: {error}");
        }
        assert!(Suite::parse("", "a.toml").unwrap_err().to_string().contains("case"));
        assert!(Suite::parse("case = []", "a.toml").unwrap_err().to_string().contains("[[case]]"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "([\\[\\]a-z_.=\"0-9 {},\n-]|\\[\\[case\\]\\]\n|name = ){0,120}") {
            let _ = Suite::parse(&text, "a.toml");
        }
    }
}
