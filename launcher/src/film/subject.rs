//! What is filmed: a module as a scripted surgeon does it, or a recording as it was.

use super::FilmArgs;
use crate::exit::WrongUse;
use crate::memory_file::MemoryFile;
use crate::modules::Composed;
use anyhow::bail;
use protocol::rig::Rig;
use recording::{Recording, Source};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Fields of the simulation from one picture of a module to the next.
const FIELDS_PER_PICTURE: u32 = 2;
/// Tier of a module's pictures, and of a recording's.
const TIERS: [u32; 2] = [1, 0];
/// Longest film of a module, s.
const LONGEST_S: f64 = 120.0;
/// Seed of a module's film.
const SEED: u64 = 1;
/// Surgeon of a module's film.
const SURGEON: &str = "expert";

/// What is filmed.
pub enum Subject {
    /// A module, composed for a surgeon.
    Module {
        /// Its scene.
        composed: Box<Composed>,
        /// Seed of the tremor.
        seed: u64,
        /// Longest film, s.
        length_s: f64,
    },
    /// A recording.
    Recording {
        /// The file.
        file: PathBuf,
        /// Its scene, for the renderer.
        scene: MemoryFile,
        /// Its rig, for the renderer.
        rig: MemoryFile,
        /// Length of the part that is drawn, s.
        length_s: f64,
    },
}

impl Subject {
    /// What `args` name: a file is a recording, anything else a module.
    ///
    /// # Errors
    /// Where there is no such module, the recording cannot be drawn, or an option belongs to the
    /// other one.
    pub fn open(args: &FilmArgs) -> anyhow::Result<Self> {
        let path = Path::new(&args.subject);
        if path.is_file() || path.extension().is_some_and(|ending| ending == "mcap") {
            return Self::recording(args, path);
        }
        if args.span.from != 0.0 || args.span.until.is_some() {
            bail!(WrongUse(format!(
                "--from, --until: of a recording; {} is a module, --length ends it",
                args.subject
            )));
        }
        let level = args.level.map_or_else(|| Ok(surgeon::load(&args.subject)?.levels()), anyhow::Ok)?;
        let (seed, surgeon) = (args.seed.unwrap_or(SEED), args.surgeon.as_deref().unwrap_or(SURGEON));
        let composed = Box::new(Composed::new(&args.subject, level, surgeon, seed)?);
        Ok(Subject::Module { composed, seed, length_s: args.length.unwrap_or(LONGEST_S) })
    }

    fn recording(args: &FilmArgs, file: &Path) -> anyhow::Result<Self> {
        let of_modules = [
            ("--level", args.level.is_some()),
            ("--surgeon", args.surgeon.is_some()),
            ("--seed", args.seed.is_some()),
            ("--length", args.length.is_some()),
        ];
        if let Some((option, _)) = of_modules.iter().find(|(_, given)| *given) {
            let shown = file.display();
            bail!(WrongUse(format!("{option}: of a module; {shown} is a recording, --until ends it")));
        }
        let recording = Recording::open(file)?;
        let provenance = recording.provenance();
        if provenance.source == Source::Import {
            let file = file.display();
            bail!(
                "{file}: an imported stream holds blobs and no steps to be drawn: vitreo export {file} --blobs \
                 b.jsonl --rig rig.json, then vitreo run --blobs b.jsonl --rig rig.json --scene NAME --record r.mcap \
                 makes a recording that has them"
            );
        }
        args.span.check(recording.path(), || recording.exposed_s())?;
        Rig::parse(&provenance.rig_json, "of the recording")?;
        let [scene, rig] = [&provenance.scene_toml, &provenance.rig_json].map(|text| MemoryFile::new(text));
        Ok(Subject::Recording {
            file: file.into(),
            scene: scene?,
            rig: rig?,
            length_s: args.span.length_s(recording.exposed_s()),
        })
    }

    /// The quality tier where none is asked for.
    pub fn tier(&self) -> u32 {
        TIERS[usize::from(matches!(self, Subject::Recording { .. }))]
    }

    /// Tells `vitreo-replay` to write its scenes.
    pub fn for_simulation(&self, args: &FilmArgs, command: &mut Command) {
        match self {
            Subject::Module { composed, seed, length_s } => {
                let every = FIELDS_PER_PICTURE.to_string();
                command.args(["scenes", "--scene", &composed.name(), "--every", &every]);
                command.args(["--seed", &seed.to_string(), "--length", &length_s.to_string()]);
            }
            Subject::Recording { file, .. } => {
                command.args(["recorded-scenes", "--from", &args.span.from.to_string()]);
                if let Some(until) = args.span.until {
                    command.args(["--until", &until.to_string()]);
                }
                command.arg("--").arg(file);
            }
        }
    }

    /// Tells `vitreo-renderer film` what it draws.
    pub fn for_renderer(&self, args: &FilmArgs, command: &mut Command) {
        match self {
            Subject::Module { composed, .. } => command.args(["--scene", &composed.name()]),
            Subject::Recording { scene, rig, .. } => {
                command.args(["--scene", &scene.name(), "--rig", &rig.name()]);
                command.args(["--from", &args.span.from.to_string()])
            }
        };
    }

    /// Length at most, s.
    pub fn longest_s(&self) -> f64 {
        match self {
            Subject::Module { composed, length_s, .. } => length_s.min(composed.longest_s),
            Subject::Recording { length_s, .. } => *length_s,
        }
    }

    /// How much of it a film of `shown_s` seconds is.
    pub fn share(&self, shown_s: f64) -> &'static str {
        match self {
            Subject::Module { length_s, .. } if shown_s + 0.1 < *length_s => "the whole of it",
            Subject::Module { .. } => "as long as asked for",
            Subject::Recording { .. } => "drawn again from the recording",
        }
    }
}
