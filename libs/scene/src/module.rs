//! Module files: `assets/modules/NAME/module.toml`, and the scene beside it (`scene.toml`) or a
//! shipped one.

use crate::{Goal, GoalOrder, SceneError, SceneFile, ScriptScene, TaskScene, is_path};
use protocol::file::{MAX_TABLE_BYTES, other_format, other_format_in, read_text};
use protocol::parse_error;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The one format this build reads.
pub const FORMAT: &str = "vitreo-module-1";
/// Shipped modules: name, module file, scene file where it has its own.
const SHIPPED: &[(&str, &str, Option<&str>)] = include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

/// Why a module was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModuleError {
    /// Neither a folder nor a shipped module.
    #[error("module {name}: no such folder, and no shipped module of that name (shipped: {shipped})")]
    Missing {
        /// What was asked for.
        name: String,
        /// What there is.
        shipped: String,
    },
    /// A file cannot be read.
    #[error("module file {name}: {source}")]
    Read {
        /// The file.
        name: String,
        /// Why.
        source: std::io::Error,
    },
    /// Not a module in TOML; the message has the line.
    #[error("module file {name}, {problem}")]
    Parse {
        /// The file.
        name: String,
        /// Why, with the line.
        problem: String,
    },
    /// A value makes no sense.
    #[error("module file {name}: {field}: expected {expected}, found {found}")]
    Value {
        /// The file.
        name: String,
        /// The key.
        field: String,
        /// What would be right.
        expected: String,
        /// What is there.
        found: String,
    },
    /// Its scene, or the scene that a level makes of it, is refused.
    #[error("module {name}: {source}")]
    Scene {
        /// The module.
        name: String,
        /// Why.
        source: SceneError,
    },
    /// There is no such level.
    #[error("module {name}: expected a level from 1 to {levels}, found {found}")]
    Level {
        /// The module.
        name: String,
        /// How many levels it has.
        levels: usize,
        /// What was asked for.
        found: u32,
    },
}

impl ModuleError {
    /// No shipped module has that name, or the module does not have that level. A path of no folder is a failure,
    /// like every other missing file, and so is a defective module. A scene that a module's file names is the
    /// file's defect.
    pub fn is_wrong_use(&self) -> bool {
        match self {
            ModuleError::Missing { name, .. } => !is_path(name),
            error => matches!(error, ModuleError::Level { .. }),
        }
    }
}

/// What a module trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A skill, without tissue.
    Abstract,
    /// An operation, or a part of one.
    Operation,
}

/// A module file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModuleFile {
    /// [`FORMAT`].
    pub format: String,
    /// One line for people.
    pub title: String,
    /// What it trains.
    pub kind: Kind,
    /// A shipped scene; without it the folder's `scene.toml`.
    pub scene: Option<String>,
    /// The plan of an operation, in the place of the scene's script.
    pub script: Option<ScriptScene>,
    /// What to read, a line each.
    pub instructions: Vec<String>,
    /// In which order goals count.
    #[serde(default)]
    pub order: GoalOrder,
    /// From the easiest on.
    pub level: Vec<LevelFile>,
}

/// A level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LevelFile {
    /// Time limit, s; without it three times the plan's time.
    pub limit_s: Option<f64>,
    /// Time that the plan needs until the last goal, s; without it the length of the plan.
    pub par_s: Option<f64>,
    /// A shipped scene in the place of the module's, and then the plan of that scene in the place
    /// of the module's.
    pub scene: Option<String>,
    /// Keys of the scene that are other in this level.
    pub changes: Option<toml::Table>,
    /// A plan of its own for an operation, in the place of both.
    pub script: Option<ScriptScene>,
    /// What to read, in the place of the module's instructions.
    pub instructions: Option<Vec<String>>,
    /// What to do.
    pub goals: Vec<Goal>,
}

/// A module, ready to be composed.
#[derive(Debug, Clone, PartialEq)]
pub struct Module {
    /// Name of its folder.
    pub name: String,
    /// Its file.
    pub file: ModuleFile,
    /// Its scene, without a task.
    pub scene: SceneFile,
}

/// Names of the shipped modules.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, ..)| *name)
}

/// Module file of a shipped module, and scene file where it has its own.
pub fn shipped(name: &str) -> Option<(&'static str, Option<&'static str>)> {
    SHIPPED.iter().find(|(n, ..)| *n == name).map(|(_, file, scene)| (*file, *scene))
}

impl Module {
    /// Loads a module by its folder, or a shipped one by its name.
    ///
    /// # Errors
    /// If there is no such module or it is refused.
    pub fn load(name: &str) -> Result<Self, ModuleError> {
        let folder = Path::new(name);
        let file = folder.join("module.toml");
        if file.is_file() || folder.is_dir() && shipped(name).is_none() {
            let text = read(&file)?;
            let scene = folder.join("scene.toml");
            let scene = if scene.is_file() { Some(read(&scene)?) } else { None };
            let short = folder.file_name().map_or(name.into(), |n| n.to_string_lossy().into_owned());
            return Self::parse(&short, &text, scene.as_deref());
        }
        let (text, scene) = shipped(name).ok_or_else(|| ModuleError::Missing {
            name: name.into(),
            shipped: names().collect::<Vec<_>>().join(", "),
        })?;
        Self::parse(name, text, scene)
    }

    /// Parses and checks a module.
    ///
    /// # Errors
    /// If a key is unknown, missing or out of its range; the error names it.
    pub fn parse(name: &str, text: &str, scene: Option<&str>) -> Result<Self, ModuleError> {
        let file: ModuleFile = toml::from_str(text).map_err(|source| {
            let of = |found| ModuleError::Value {
                name: name.into(),
                field: "format".into(),
                expected: FORMAT.into(),
                found,
            };
            let parse =
                || ModuleError::Parse { name: name.into(), problem: parse_error::toml(text, &source) };
            other_format_in(text, FORMAT).map_or_else(parse, of)
        })?;
        let refuse = |field: &str, expected: &str, found: String| {
            let (field, expected) = (field.to_owned(), expected.to_owned());
            Err(ModuleError::Value { name: name.into(), field, expected, found })
        };
        if let Some(found) = other_format(&file.format, FORMAT) {
            return refuse("format", FORMAT, found);
        }
        if file.level.is_empty() {
            return refuse("level", "at least one level", "none".into());
        }
        let of_scene = |source| ModuleError::Scene { name: name.into(), source };
        let scene = match (&file.scene, scene) {
            (Some(shipped), None) => SceneFile::load(shipped).map_err(of_scene)?,
            (None, Some(text)) => SceneFile::parse(text, &format!("{name}/scene.toml")).map_err(of_scene)?,
            (Some(_), Some(_)) => {
                return refuse("scene", "a shipped scene or a scene.toml, not both", "both".into());
            }
            (None, None) => {
                return refuse(
                    "scene",
                    "a shipped scene, or a scene.toml beside the module",
                    "neither".into(),
                );
            }
        };
        if scene.task.is_some() {
            return refuse("scene", "a scene without a task", "one with a task".into());
        }
        let has_script = file.script.is_some() || file.level.iter().any(|level| level.script.is_some());
        if file.kind == Kind::Abstract && has_script {
            return refuse(
                "script",
                "none: the plan of an abstract module is made from its goals",
                "a script".into(),
            );
        }
        let scene = SceneFile { script: file.script.clone().or_else(|| scene.script.clone()), ..scene };
        Ok(Module { name: name.into(), file, scene })
    }

    /// Levels.
    pub fn levels(&self) -> u32 {
        self.file.level.len() as u32
    }

    /// The scene of a level with its task; a plan's length and way are the surgeon's to fill in.
    ///
    /// # Errors
    /// [`ModuleError::Level`] where there is no such level, [`ModuleError::Scene`] where its goals
    /// or changes make no scene.
    pub fn level_scene(&self, number: u32) -> Result<SceneFile, ModuleError> {
        let level = self.level(number)?;
        let of_scene = |source| ModuleError::Scene { name: self.name.clone(), source };
        let own = level.scene.as_ref().map(|name| SceneFile::load(name)).transpose().map_err(of_scene)?;
        let mut scene = own.unwrap_or_else(|| self.scene.clone());
        scene.script = level.script.clone().or(scene.script);
        scene.task = Some(TaskScene {
            module: self.name.clone(),
            level: number,
            title: self.file.title.clone(),
            limit_s: 60.0,
            par_s: 20.0,
            par_mm: 0.0,
            order: self.file.order,
            instructions: level.instructions.as_ref().unwrap_or(&self.file.instructions).clone(),
            goals: level.goals.clone(),
        });
        let text = changed(scene.to_toml(), level.changes.as_ref());
        SceneFile::parse(&text, &format!("{} level {number}", self.name)).map_err(of_scene)
    }

    /// A level, from 1 on.
    ///
    /// # Errors
    /// [`ModuleError::Level`] where there is no such level.
    pub fn level(&self, number: u32) -> Result<&LevelFile, ModuleError> {
        let missing =
            || ModuleError::Level { name: self.name.clone(), levels: self.file.level.len(), found: number };
        number.checked_sub(1).and_then(|i| self.file.level.get(i as usize)).ok_or_else(missing)
    }
}

/// A scene with a level's changes.
fn changed(scene: String, changes: Option<&toml::Table>) -> String {
    let Some(changes) = changes else { return scene };
    let mut table: toml::Table = scene.parse().expect("a scene is TOML");
    merge(&mut table, changes);
    table.to_string()
}

/// Puts the keys of `changes` into `table`; tables into each other, everything else in the place of
/// what is there.
fn merge(table: &mut toml::Table, changes: &toml::Table) {
    for (key, change) in changes {
        match (table.get_mut(key), change) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) => merge(inner, changes),
            _ => _ = table.insert(key.clone(), change.clone()),
        }
    }
}

fn read(path: &Path) -> Result<String, ModuleError> {
    // A level's goals and scripts are long, a scene's mesh is longer.
    read_text(path, MAX_TABLE_BYTES)
        .map_err(|source| ModuleError::Read { name: path.display().to_string(), source })
}
