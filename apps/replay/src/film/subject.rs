//! What is filmed: a module as a scripted surgeon does it, or a recording as it was.

use super::{SceneShown, recorded, scripted};
use crate::resimulate::{scene_of, tell_of_film};
use anyhow::{Context, bail};
use outputs::exit::WrongUse;
use recording::Recording;
use rig::Rig;
use scene::SceneFile;
use settings::commands::{FilmArgs, SpanArgs};
use std::ops::ControlFlow;
use std::path::Path;

/// Fields of the simulation from one picture of a module to the next.
const FIELDS_PER_PICTURE: u64 = 2;
/// Tier of a module's pictures, and of a recording's.
const TIERS: [u32; 2] = [1, 0];
/// Longest film of a module, s.
const LONGEST_S: f64 = 120.0;
/// Seed of a module's film.
const SEED: u64 = 1;
/// Surgeon of a module's film.
const SURGEON: &str = "expert";

/// What is filmed.
pub struct Subject {
    /// Its scene.
    pub scene: SceneFile,
    /// Its rig.
    pub rig: Rig,
    /// Length at most, s.
    length_s: f64,
    /// Which of the two it is.
    kind: Kind,
}

enum Kind {
    /// A module, composed for a surgeon whose tremor is of this seed.
    Module { seed: u64, asked_s: f64 },
    /// A part of a recording.
    Recording(Box<Recording>, SpanArgs),
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
        if args.span != SpanArgs::default() {
            bail!(WrongUse(format!(
                "--from, --until: apply to recordings; {} is a module (--length limits its film)",
                args.subject
            )));
        }
        let module = surgeon::load(&args.subject)?;
        let level = args.level.unwrap_or(module.levels());
        let (seed, surgeon) = (args.seed.unwrap_or(SEED), args.surgeon.as_deref().unwrap_or(SURGEON));
        let scene = surgeon::compose(&module, level, &surgeon::skill::named(surgeon)?, seed)?;
        let asked_s = args.length.unwrap_or(LONGEST_S);
        let length_s = asked_s.min(surgeon::longest_s(&scene));
        Ok(Subject {
            scene,
            rig: Rig::load_or_shipped(None)?,
            length_s,
            kind: Kind::Module { seed, asked_s },
        })
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
            bail!(WrongUse(format!("{option}: applies to films of modules; {shown} is a recording")));
        }
        let recording = Recording::open(file)?;
        let provenance = recording.provenance();
        args.span.check(recording.path(), || recording.exposed_s())?;
        let rig = Rig::parse(&provenance.rig_json, "of the recording")?;
        let (scene, length_s) = (scene_of(&recording)?, args.span.length_s(recording.exposed_s()));
        Ok(Subject { scene, rig, length_s, kind: Kind::Recording(Box::new(recording), args.span) })
    }

    /// Tier of its pictures.
    pub fn tier(&self) -> u32 {
        TIERS[usize::from(matches!(self.kind, Kind::Recording(..)))]
    }

    /// Gives its scenes to `show`, until that has enough; the exit code.
    ///
    /// # Errors
    /// Where it cannot be simulated.
    pub fn play(
        &self,
        show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<u8> {
        match &self.kind {
            Kind::Module { seed, asked_s } => {
                scripted::play(&self.scene, Some(*seed), FIELDS_PER_PICTURE, Some(*asked_s), show)
                    .context("the simulation")?;
                Ok(0)
            }
            Kind::Recording(recording, part) => {
                Ok(tell_of_film(recording.path(), &recorded::play(recording, &self.rig, *part, show)?))
            }
        }
    }

    /// Length at most, s.
    pub fn longest_s(&self) -> f64 {
        self.length_s
    }

    /// How much of it a film of `shown_s` seconds is.
    pub fn share(&self, shown_s: f64) -> &'static str {
        match &self.kind {
            Kind::Module { asked_s, .. } if shown_s + 0.1 < *asked_s => "the whole of it",
            Kind::Module { .. } => "reached --length",
            Kind::Recording(..) => "drawn again from the recording",
        }
    }
}
