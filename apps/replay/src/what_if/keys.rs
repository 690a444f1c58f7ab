//! The keys that a what-if may set: constants of the tracker (`tracker.KEY`, [`tracker::tuning`]) and
//! numbers of the scene (`scene.KEY`, as they stand in the scene file and checked as there).

use anyhow::Context;
use outputs::exit::WrongUse;
use outputs::{print, println};
use recording::Provenance;
use scene::SceneFile;
use serde::Serialize;
use settings::commands::{Assignment, SettingsListArgs};
use std::fmt::Write;
use std::process::ExitCode;
use toml::{Table, Value};
use tracker::Tuning;
use tracker::tuning::{TUNABLE, TuningError};

/// What keys of the tracker begin with, also in the configuration of a recording.
pub const TRACKER: &str = "tracker.";
/// What keys of the scene begin with.
pub const SCENE: &str = "scene.";

/// A key that can be set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Settable {
    /// The key.
    pub key: String,
    /// Its unit; empty for a number without one.
    pub unit: String,
    /// Value of the tracker, or of the scene asked for.
    pub default: f64,
    /// Least and largest value; those of a scene are checked where it is read.
    pub range: Option<[f64; 2]>,
    /// What it is.
    pub meaning: String,
}

/// `vitreo settings`.
///
/// # Errors
/// Where the scene is refused.
pub fn run(args: &SettingsListArgs) -> anyhow::Result<ExitCode> {
    let scene = SceneFile::load(&args.scene)?;
    let all = settable(&scene);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        print!("{}", text(&all));
    }
    Ok(ExitCode::SUCCESS)
}

/// Every key that can be set, of the tracker and of a scene.
pub fn settable(scene: &SceneFile) -> Vec<Settable> {
    let of_tracker = TUNABLE.iter().map(|row| Settable {
        key: format!("{TRACKER}{}", row.key),
        unit: row.unit.into(),
        default: row.default,
        range: Some([row.low, row.high]),
        meaning: row.what.into(),
    });
    let of_scene = numbers(&document(scene)).into_iter().map(|(path, default)| Settable {
        key: format!("{SCENE}{path}"),
        unit: unit_of(&path).into(),
        default,
        range: None,
        meaning: "value in the scene file".into(),
    });
    of_tracker.chain(of_scene).collect()
}

/// Endings of a scene's keys, and the unit that they stand for.
const UNITS: [(&str, &str); 23] = [
    ("_mm", "mm"),
    ("_mm2", "mm²"),
    ("_mm3", "mm³"),
    ("_mm_s", "mm/s"),
    ("_mm_s2", "mm/s²"),
    ("_mm_s_per_kpa", "mm/(s·kPa)"),
    ("_ml", "ml"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_s", "s"),
    ("_ms", "ms"),
    ("_hz", "Hz"),
    ("_per_s", "1/s"),
    ("_per_min", "1/min"),
    ("_pa", "Pa"),
    ("_mmhg", "mmHg"),
    ("_g", "g"),
    ("_mg", "mg"),
    ("_un", "µN"),
    ("_un_per_mm", "µN/mm"),
    ("_un_s_per_mm", "µN·s/mm"),
    ("_n_per_m", "N/m"),
    ("_px", "px"),
];

/// The unit that a scene's key ends with: that of the longest ending.
fn unit_of(path: &str) -> &'static str {
    let endings = UNITS.iter().filter(|(ending, _)| path.ends_with(ending));
    endings.max_by_key(|(ending, _)| ending.len()).map_or("", |(_, unit)| unit)
}

fn text(all: &[Settable]) -> String {
    let mut out = String::new();
    for Settable { key, unit, default, range, meaning } in all {
        let range = range.map_or(String::new(), |[low, high]| format!("{low} to {high}"));
        // Writing into a string cannot fail.
        let _ = writeln!(out, "{key:<44} {default:>12} {unit:<8} {range:<16} {meaning}");
    }
    out
}

/// A scene as a document, with every key that it has.
fn document(scene: &SceneFile) -> Table {
    toml::from_str(&scene.to_toml()).expect("a scene is plain tables")
}

/// Paths and values of the numbers of a document, but for those of its script, which has been played.
fn numbers(document: &Table) -> Vec<(String, f64)> {
    fn collect(path: &str, value: &Value, found: &mut Vec<(String, f64)>) {
        match value {
            Value::Float(v) => found.push((path.into(), *v)),
            Value::Integer(v) => found.push((path.into(), *v as f64)),
            Value::Table(table) => {
                table.iter().for_each(|(key, v)| collect(&format!("{path}.{key}"), v, found))
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    let own = document.iter().filter(|(key, _)| *key != "script");
    own.for_each(|(key, value)| collect(key, value, &mut found));
    found
}

/// The constants of a tracker that made a recording.
///
/// # Errors
/// For a key or value that this build's tracker does not take.
pub fn tuning_of(provenance: &Provenance) -> anyhow::Result<Tuning> {
    let mut tuning = Tuning::default();
    for (key, value) in &provenance.config {
        let Some(name) = key.strip_prefix(TRACKER) else { continue };
        let value: f64 =
            value.parse().with_context(|| format!("{key} of the recording: expected a number"))?;
        tuning.set(name, value).context("configuration of the recording")?;
    }
    Ok(tuning)
}

/// Sets constants of the tracker and numbers of the scene.
///
/// # Errors
/// [`WrongUse`] for a key that there is not, with the nearest one, and for values that are refused.
pub fn assign(set: &[Assignment], tuning: &mut Tuning, scene: &mut SceneFile) -> anyhow::Result<()> {
    let mut edited = document(scene);
    let mut changed = false;
    for Assignment { key, value } in set {
        if let Some(name) = key.strip_prefix(TRACKER) {
            tuning.set(name, *value).map_err(|problem| match problem {
                TuningError::Unknown { .. } => unknown(key, scene),
                range => WrongUse(format!("--set {TRACKER}{range}")),
            })?;
        } else {
            let slot = key.strip_prefix(SCENE).and_then(|path| slot(&mut edited, path));
            let Some(slot) = slot else { return Err(unknown(key, scene).into()) };
            *slot = match slot {
                Value::Integer(_) if value.fract() == 0.0 => Value::Integer(*value as i64),
                Value::Integer(_) => {
                    anyhow::bail!(WrongUse(format!("--set {key}: expected a whole number, found {value}")))
                }
                _ => Value::Float(*value),
            };
            changed = true;
        }
    }
    if changed {
        let text = toml::to_string(&edited).context("the scene")?;
        *scene = SceneFile::parse(&text, "--set").map_err(|problem| WrongUse(problem.to_string()))?;
    }
    Ok(())
}

/// The number at a path.
fn slot<'t>(table: &'t mut Table, path: &str) -> Option<&'t mut Value> {
    match path.split_once('.') {
        Some(("script", _)) => None,
        Some((key, rest)) => table.get_mut(key)?.as_table_mut().and_then(|below| slot(below, rest)),
        None => table.get_mut(path).filter(|value| value.is_float() || value.is_integer()),
    }
}

fn unknown(key: &str, scene: &SceneFile) -> WrongUse {
    let all = settable(scene);
    let nearest = all.iter().min_by_key(|known| tracker::tuning::edits(&known.key, key));
    let nearest = nearest.map_or("", |known| known.key.as_str());
    WrongUse(format!("--set {key}: no such key; did you mean {nearest}? (vitreo settings lists all)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(key: &str, value: f64) -> Result<(Tuning, SceneFile), String> {
        let (mut tuning, mut scene) = (Tuning::default(), SceneFile::load("peel").unwrap());
        assign(&[Assignment { key: key.into(), value }], &mut tuning, &mut scene)
            .map_err(|e| format!("{e:#}"))?;
        Ok((tuning, scene))
    }

    #[test]
    fn the_longest_ending_of_a_key_is_its_unit() {
        for (ending, unit) in UNITS {
            assert_eq!(unit_of(&format!("tissue.value{ending}")), unit, "{ending}");
        }
        assert_eq!(unit_of("membrane.stiffness_un_per_mm"), "µN/mm");
        assert_eq!(unit_of("membrane.columns"), "");
    }

    #[test]
    fn every_listed_key_can_be_set_to_its_default_and_changes_nothing() {
        for name in ["peel", "vitrectomy", "relocation"] {
            let scene = SceneFile::load(name).unwrap();
            let all = settable(&scene);
            assert!(all.len() > TUNABLE.len() + 10, "{name}: {}", all.len());
            for Settable { key, default, .. } in all {
                let (mut tuning, mut own) = (Tuning::default(), scene.clone());
                assign(&[Assignment { key: key.clone(), value: default }], &mut tuning, &mut own).unwrap();
                assert_eq!((tuning, &own), (Tuning::default(), &scene), "{name}: {key}");
            }
        }
    }

    #[test]
    fn what_is_unknown_or_out_of_range_is_refused_by_name() {
        let spring =
            set("scene.membrane.stiffness_un_per_mm", 3.0).unwrap().1.membrane.unwrap().stiffness_un_per_mm;
        assert_eq!((spring, set("tracker.gate", 30.0).unwrap().0.gate), (3.0, 30.0));
        for (key, value, named) in [
            ("scene.membrane.stiffness", 1.0, "did you mean scene.membrane."),
            ("tracker.gatte", 1.0, "did you mean tracker.gate?"),
            ("spring", 1.0, "no such key"),
            ("scene.script.period_s", 1.0, "no such key"),
            ("tracker.gate", 0.0, "expected 1 to 1000"),
            ("scene.eye.retina_radius_mm", -1.0, "retina_radius_mm"),
        ] {
            let refused = set(key, value).unwrap_err();
            assert!(refused.contains(named), "{key}: {refused}");
        }
    }
}
