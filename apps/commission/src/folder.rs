//! The folder of a rig that is taken into use: `rig.json`, `colours.toml`, `pictures/`, `report.html`, and
//! `commission.json`, which says what each step found.

use crate::page;
use anyhow::{Context, Result, anyhow, ensure};
use outputs::Outputs;
use protocol::file::{MAX_TABLE_BYTES, other_format, other_format_in, read_text};
use protocol::parse_error;
use rig::Rig;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Format key of `commission.json`.
const FORMAT: &str = "vitreo-commission-1";

/// The steps, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Step {
    /// What the cameras take for which colour.
    Colours,
    /// Lens of each camera.
    Lenses,
    /// Places of the cameras.
    Poses,
    /// Where the shafts pass, and where the eye turns about.
    Trocars,
    /// Whether all of it holds.
    Check,
}

impl Step {
    /// All of them.
    pub const ALL: [Step; 5] = [Step::Colours, Step::Lenses, Step::Poses, Step::Trocars, Step::Check];

    /// As it is typed.
    pub fn name(self) -> &'static str {
        match self {
            Step::Colours => "colours",
            Step::Lenses => "lenses",
            Step::Poses => "poses",
            Step::Trocars => "trocars",
            Step::Check => "check",
        }
    }

    /// What to do for it, as a command of the folder.
    pub fn how(self) -> &'static str {
        match self {
            Step::Colours => "colours --from cam0.png cam1.png cam2.png (all markers in view, held still)",
            Step::Lenses => {
                "lenses --board 9x6 --pitch 2.5 --from PICTURES (20 a camera, tilted differently)"
            }
            Step::Poses => {
                "poses --board 9x6 --pitch 2.5 --from PICTURES, or --from STREAM of waved instruments"
            }
            Step::Trocars => "trocars --from STREAM (a minute of tilted instruments and a turning eye)",
            Step::Check => "check --from STREAM (ten seconds of moving instruments)",
        }
    }
}

/// What a step found.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// What it was found from.
    pub from: Vec<String>,
    /// In one line.
    pub summary: String,
    /// True where what was there stays, since it is as good.
    pub kept: bool,
    /// Names and values with their units.
    pub figures: Vec<(String, String)>,
    /// What a person should know.
    pub notes: Vec<String>,
    /// What could be better, and how.
    pub advice: Vec<String>,
    /// Names in `pictures/`, and what they show.
    pub pictures: Vec<(String, String)>,
}

impl Record {
    /// Adds a figure.
    pub fn figure(&mut self, name: impl Into<String>, value: impl Into<String>) {
        self.figures.push((name.into(), value.into()));
    }
}

/// `commission.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    format: String,
    /// By step.
    pub steps: BTreeMap<Step, Record>,
}

impl Default for State {
    fn default() -> Self {
        State { format: FORMAT.into(), steps: BTreeMap::new() }
    }
}

impl State {
    /// Parses the text of a file; `file` is its name in messages.
    ///
    /// # Errors
    /// A text that is not JSON of this format, or names pictures elsewhere.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let state: State = serde_json::from_str(text).map_err(|e| match other_format_in(text, FORMAT) {
            Some(found) => anyhow!("{file}: format: expected {FORMAT:?}, found {found}"),
            None => anyhow!("{file}, {}", parse_error::json(&e)),
        })?;
        if let Some(found) = other_format(&state.format, FORMAT) {
            return Err(anyhow!("{file}: format: expected {FORMAT:?}, found {found}"));
        }
        for (name, _) in state.steps.values().flat_map(|record| &record.pictures) {
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
            ensure!(
                name.ends_with(".png") && name.chars().all(plain) && !name.starts_with('.'),
                "{file}: pictures: expected a name such as rig.png, found {name:?}"
            );
        }
        Ok(state)
    }

    /// The first step that is not done.
    pub fn next(&self) -> Option<Step> {
        Step::ALL.into_iter().find(|step| !self.steps.contains_key(step))
    }
}

/// What a step leaves.
#[derive(Debug, Default)]
pub struct Outcome {
    /// The rig, where it is another one.
    pub rig: Option<Rig>,
    /// The colours, where they are others.
    pub colours: Option<String>,
    /// Bytes of the pictures, by name, and what they show.
    pub pictures: Vec<(String, String, Vec<u8>)>,
    /// What was found.
    pub record: Record,
}

/// The folder.
pub struct Folder {
    path: PathBuf,
    /// What was done.
    pub state: State,
}

impl Folder {
    /// Opens a folder, or begins one that is empty or not there yet.
    ///
    /// # Errors
    /// A folder of something else, or a file that is not as expected.
    pub fn open(path: &Path) -> Result<Self> {
        let shown = path.display();
        ensure!(!path.exists() || path.is_dir(), "{shown}: expected a folder, found a file");
        let file = path.join("commission.json");
        if file.exists() {
            let name = file.display().to_string();
            let text = read_text(&file, MAX_TABLE_BYTES).map_err(|e| anyhow!("{name}: {e}"))?;
            return Ok(Folder { path: path.into(), state: State::parse(&text, &name)? });
        }
        for taken in ["rig.json", "colours.toml", "report.html", "pictures"] {
            ensure!(
                !path.join(taken).exists(),
                "{shown}: holds {taken} but no commission.json: expected a folder of vitreo commission, or a new \
                 one; --rig names a rig to begin with"
            );
        }
        Ok(Folder { path: path.into(), state: State::default() })
    }

    /// A file of the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The file of its colours, if the colours were learnt.
    pub fn colours(&self) -> Option<PathBuf> {
        Some(self.file("colours.toml")).filter(|file| file.exists())
    }

    /// As it is typed.
    pub fn shown(&self) -> String {
        self.path.display().to_string()
    }

    /// The rig as it is; at the beginning `begin`, or the shipped one.
    ///
    /// # Errors
    /// A rig that cannot be read, or a rig to begin with where there is one.
    pub fn rig(&self, begin: Option<&Path>) -> Result<Rig> {
        let own = self.file("rig.json");
        let is_own =
            |path: &Path| own.canonicalize().is_ok_and(|o| path.canonicalize().is_ok_and(|p| o == p));
        if !own.exists() {
            return Ok(Rig::load_or_shipped(begin)?);
        }
        if let Some(begin) = begin.filter(|path| !is_own(path)) {
            let (own, begin) = (own.display(), begin.display());
            return Err(anyhow!(
                "--rig {begin}: {own} exists already and is continued; use another folder to begin with \
                 another rig"
            ));
        }
        Ok(Rig::load(&own)?)
    }

    /// Refuses a step that is done already.
    ///
    /// # Errors
    /// Without `force`.
    pub fn claim(&self, step: Step, force: bool) -> Result<()> {
        let Some(record) = self.state.steps.get(&step).filter(|_| !force) else { return Ok(()) };
        let (name, summary) = (step.name(), &record.summary);
        Err(anyhow!("{name} was done already: {summary}; --force repeats it"))
    }

    /// Writes what a step leaves: pictures, rig and colours, then that it was done, then the page. The rig that was
    /// there stays as `rig-before-STEP.json`.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn take(&mut self, step: Step, outcome: Outcome) -> Result<()> {
        let mut outputs = Outputs::new(true);
        let Outcome { rig, colours, pictures, mut record } = outcome;
        for (name, caption, bytes) in pictures {
            outputs.write(&self.file("pictures").join(&name), bytes)?;
            record.pictures.push((name, caption));
        }
        if let Some(rig) = rig {
            let file = self.file("rig.json");
            if file.exists() {
                let before = Rig::load(&file)?;
                let kept = self.file(&format!("rig-before-{}.json", step.name()));
                Outputs::new(true).write(&kept, format!("{}\n", before.to_json()))?;
            }
            outputs.write(&file, format!("{}\n", rig.to_json()))?;
        }
        if let Some(colours) = colours {
            outputs.write(&self.file("colours.toml"), colours)?;
        }
        self.state.steps.insert(step, record);
        let text = serde_json::to_string_pretty(&self.state)?;
        outputs.write(&self.file("commission.json"), format!("{text}\n"))?;
        let page = page::of(&self.state, &|name| std::fs::read(self.file("pictures").join(name)).ok());
        outputs.write(&self.file("report.html"), page).context("report.html")
    }
}

#[cfg(test)]
mod tests;
