//! Composes a module, a level and a surgeon's attempt into one scene file, which every process
//! reads.

use crate::plan;
use crate::skill::{EXPERT, Skill};
use scene::SceneFile;
use scene::module::{Kind, Module, ModuleError};

/// Time limit of an attempt as a multiple of the plan's duration, for levels without one.
const LIMIT_PARS: f64 = 3.0;

/// Loads a module by its folder, or a shipped one by its name. Every level is composed once, so
/// that a module that loads can be played.
///
/// # Errors
/// As [`Module::load`], and where a level cannot be composed.
pub fn load(name: &str) -> Result<Module, ModuleError> {
    let module = Module::load(name)?;
    check(&module)?;
    Ok(module)
}

fn check(module: &Module) -> Result<(), ModuleError> {
    (1..=module.levels()).try_for_each(|level| compose(module, level, &EXPERT, 0).map(|_| ()))
}

/// The scene of a level, with its task, and with the script of a surgeon's attempt drawn from a
/// seed.
///
/// # Errors
/// [`ModuleError::Level`] where there is no such level, [`ModuleError::Scene`] where its scene is
/// refused.
pub fn compose(module: &Module, level: u32, skill: &Skill, seed: u64) -> Result<SceneFile, ModuleError> {
    let scene = module.level_scene(level)?;
    let file = module.level(level)?;
    let mut task = scene.task.clone().expect("a level has a task");
    let script = match module.file.kind {
        Kind::Abstract => plan::of_goals(&scene, &task),
        Kind::Operation => scene.script.clone().ok_or_else(|| ModuleError::Value {
            name: module.name.clone(),
            field: "script".into(),
            expected: "one in the level, the module or the scene of an operation".into(),
            found: format!("none for level {level}"),
        })?,
    };
    task.par_s = file.par_s.unwrap_or(script.period_s);
    task.par_mm = plan::path_mm(&script.keys);
    task.limit_s = file.limit_s.unwrap_or(LIMIT_PARS * task.par_s);
    let script = Some(skill.perform(&script, scene.eye.retina_radius_mm, seed));
    let composed = SceneFile { title: module.file.title.clone(), task: Some(task), script, ..scene };
    SceneFile::parse(&composed.to_toml(), &format!("{} level {level}", module.name))
        .map_err(|source| ModuleError::Scene { name: module.name.clone(), source })
}

/// Longest attempt that a scene's script can become, s: everything that can be done again is.
pub fn longest_s(scene: &SceneFile) -> f64 {
    let script = scene.script_or_rest();
    let again = script.goal_checks.iter().map(|l| (l.at_s - l.from_s) * l.retries.len() as f64);
    script.period_s + again.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skill::SKILLS;
    use scene::module::{names, shipped};

    #[test]
    fn every_shipped_module_can_be_played_by_every_surgeon() {
        for name in names() {
            let module = load(name).unwrap_or_else(|e| panic!("{e}"));
            for level in 1..=module.levels() {
                for surgeon in SKILLS {
                    let scene = compose(&module, level, &surgeon, 7).unwrap_or_else(|e| panic!("{e}"));
                    let task = scene.task.unwrap();
                    assert_eq!((task.module.as_str(), task.level), (name, level));
                    assert!(task.limit_s > task.par_s && task.par_mm > 1.0, "{name}");
                    assert!(
                        task.instructions.iter().all(|line| line.len() <= 72 && line.chars().all(font::has)),
                        "{name}: lines fit the picture, and its font has their signs"
                    );
                }
            }
        }
    }

    #[test]
    fn a_level_changes_keys_of_its_scene_alone() {
        let [first, second] =
            [1, 2].map(|level| compose(&load("peeling").unwrap(), level, &EXPERT, 0).unwrap());
        let [first, second] = [first, second].map(|scene| scene.membrane.unwrap());
        assert_eq!((first.fluid_damping_per_s, second.fluid_damping_per_s), (2.0, 20.0));
        assert_eq!(second.node_mass_g, first.node_mass_g);
        let (text, scene) = shipped("peeling").unwrap();
        let wrong = text.replace("fluid_damping_per_s = 20.0", "fluid_damping_per_h = 20.0");
        let told = Module::parse("peeling", &wrong, scene).and_then(|m| check(&m)).unwrap_err().to_string();
        assert!(told.contains("peeling level 2") && told.contains("fluid_damping_per_h"), "{told}");
    }

    #[test]
    fn contradictions_are_refused_by_name_and_field() {
        let (text, scene) = shipped("navigation").unwrap();
        let parse = |text: &str, scene| {
            Module::parse("navigation", text, scene).and_then(|m| check(&m)).map_err(|e| e.to_string())
        };
        let problem = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            parse(&text.replacen(from, to, 1), scene).unwrap_err()
        };
        assert!(problem("vitreo-module-1", "vitreo-module-9").contains("format"));
        assert!(problem("kind = \"abstract\"", "kind = \"abstract\"\ncolour = 3").contains("colour"));
        assert!(problem("instrument = 0", "instrument = 4").contains("goals[0].instrument"));
        assert!(parse(text, None).unwrap_err().contains("neither"));
        let script = format!(
            "{text}\n[level.script]\nperiod_s = 9.0\ntremor_um = 40.0\ntremor_hz = 9.0\neye_turn_rad = [0.0, 0.0]\nkeys = []\n"
        );
        assert!(parse(&script, scene).unwrap_err().contains("script: expected none"));
        let module = load("navigation").unwrap();
        let missing = compose(&module, 99, &EXPERT, 0).unwrap_err().to_string();
        assert!(missing.contains("1 to") && missing.contains("99"), "{missing}");
        assert!(load("juggling").unwrap_err().to_string().contains("navigation"));
    }
}
