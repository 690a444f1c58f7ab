//! `vitreo modules`: lists the training modules. Also composes the scene of `vitreo run --module`.

use crate::memory_file::MemoryFile;
use anyhow::bail;
use outputs::{print, println};
use scene::module::{Kind, Module, names};
use std::process::ExitCode;
use surgeon::skill::{SKILLS, Skill, named};

/// Arguments of `vitreo modules`.
#[derive(Debug, clap::Args)]
pub struct ModulesArgs {
    /// Print the scene of one level of this module, with the expert's script, as a run reads it.
    #[arg(long, value_name = "MODULE|FOLDER")]
    pub scene: Option<String>,
    /// Level of the module, from 1.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "scene")]
    pub level: u32,
    /// Print JSON.
    #[arg(long, conflicts_with = "scene")]
    pub json: bool,
}

/// Runs `vitreo modules`.
///
/// # Errors
/// If a module is unknown or its file is invalid.
pub fn run(args: &ModulesArgs) -> anyhow::Result<ExitCode> {
    if let Some(name) = &args.scene {
        let scene = surgeon::compose(&surgeon::load(name)?, args.level, &SKILLS[0], 1)?;
        print!("{}", scene.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    for name in names() {
        let module = surgeon::load(name)?;
        let kind = match module.file.kind {
            Kind::Abstract => "abstract",
            Kind::Operation => "operation",
        };
        let levels = module.levels();
        if args.json {
            let line = serde_json::json!({ "name": name, "kind": kind, "levels": levels, "title": module.file.title });
            println!("{line}");
        } else {
            println!(
                "{name:<14} {kind:<10} {levels} level{}  {}",
                if levels == 1 { " " } else { "s" },
                module.file.title
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// A module's scene at one level with a surgeon's script, in a file for the child processes that exists as
/// long as this value.
#[derive(Debug)]
pub struct Composed {
    file: MemoryFile,
    module: Module,
    surgeon: Skill,
    seed: u64,
    level: u32,
    /// Maximum length of the surgeon's attempt, s, with every repeatable step repeated.
    pub longest_s: f64,
}

impl Composed {
    /// Composes a level of a module with the script of a surgeon, drawn from a seed.
    ///
    /// # Errors
    /// If the module, its level or the surgeon is unknown, or the module file is invalid.
    pub fn new(module: &str, level: u32, surgeon: &str, seed: u64) -> anyhow::Result<Self> {
        let surgeon = named(surgeon)?;
        let (file, module) = (MemoryFile::new("")?, surgeon::load(module)?);
        let mut composed = Composed { file, module, surgeon, seed, level, longest_s: 0.0 };
        composed.write()?;
        Ok(composed)
    }

    fn write(&mut self) -> anyhow::Result<()> {
        let scene = surgeon::compose(&self.module, self.level, &self.surgeon, self.seed)?;
        self.file.replace(&scene.to_toml())?;
        self.longest_s = surgeon::longest_s(&scene);
        Ok(())
    }

    /// Replaces the contents of the file with the scene of the next level. Returns the number of that level.
    ///
    /// # Errors
    /// If this is the last level, or the scene cannot be composed or written.
    pub fn next_level(&mut self) -> anyhow::Result<u32> {
        if self.level >= self.module.levels() {
            bail!("level {} of {} is the last", self.level, self.module.name);
        }
        self.level += 1;
        self.write()?;
        Ok(self.level)
    }

    /// Path of the file.
    pub fn name(&self) -> String {
        self.file.name()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    #[test]
    fn the_next_level_takes_the_place_of_the_one_before_until_the_last() {
        let mut composed = Composed::new("navigation", 2, "expert", 1).unwrap();
        let level = |c: &Composed| SceneFile::load(&c.name()).unwrap().task.unwrap().level;
        assert_eq!(level(&composed), 2);
        assert_eq!((composed.next_level().unwrap(), level(&composed)), (3, 3));
        let problem = composed.next_level().unwrap_err().to_string();
        assert!(problem.contains("level 3 of navigation is the last"), "{problem}");
        assert_eq!(level(&composed), 3);
    }
}
