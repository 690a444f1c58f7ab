//! Scene files: what is in the eye and, if wanted, the script of a surgeon who works on it. TOML
//! that a person edits; unknown keys are refused. Shipped scenes are built in and found by name.

mod adhesion;
mod bodies;
mod elements;
mod membrane;
mod mesh;
pub mod module;
mod optics;
mod retina;
mod script;
mod task;
mod tools;
mod vitreous;

pub use adhesion::{AdhesionScene, CurlScene, PatchScene};
pub use bodies::{BodiesScene, BodyScene, BodyShape, MAX_BODIES};
pub use elements::{ElementsLaw, ElementsScene};
pub use membrane::{MembraneIntegrator, MembraneScene};
pub use mesh::{MeshScene, Pinned, parse_obj};
pub use optics::OpticsScene;
pub use retina::{RetinaOperation, RetinaScene};
pub use script::{GoalCheck, PedalKey, Retarget, Retry, SAME_INSTANT_S, ScriptKey, ScriptScene};
pub use task::{CORE_MM, GelZone, Goal, GoalOrder, MAX_GOALS, MAX_PATH, PERIPHERY_FROM_Z_MM, TaskScene};
pub use tools::{NeedleScene, VitrectorScene};
pub use vitreous::{
    GelScene, RelaxationScene, SuctionScene, VitreousAdhesionScene, VitreousScene, ZoneScene,
};

use protocol::file::{MAX_TABLE_BYTES, other_format, other_format_in, read_text};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use protocol::parse_error;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::Path;

/// The one format this build reads.
pub const FORMAT: &str = "vitreo-scene-1";

/// The scene that runs when none is named.
pub const DEFAULT_SCENE: &str = "peel";

/// Shipped scenes: name and text.
pub const SHIPPED: &[(&str, &str)] = &[
    ("peel", include_str!("../../../assets/scenes/peel.toml")),
    ("vitrectomy", include_str!("../../../assets/scenes/vitrectomy.toml")),
    ("erm", include_str!("../../../assets/scenes/erm.toml")),
    ("bodies", include_str!("../../../assets/scenes/bodies.toml")),
    ("lift", include_str!("../../../assets/scenes/lift.toml")),
    ("trim", include_str!("../../../assets/scenes/trim.toml")),
    ("relocation", include_str!("../../../assets/scenes/relocation.toml")),
    ("translocation", include_str!("../../../assets/scenes/translocation.toml")),
];

/// Why a scene was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Neither a file nor a shipped scene.
    #[error("scene {name}: no such file, and no shipped scene of that name (shipped: {shipped})")]
    Missing {
        /// What was asked for.
        name: String,
        /// What there is.
        shipped: String,
    },
    /// The file cannot be read.
    #[error("scene file {name}: {source}")]
    Read {
        /// The file.
        name: String,
        /// Why.
        source: std::io::Error,
    },
    /// Not a scene in TOML; the message has the line.
    #[error("scene file {name}, {problem}")]
    Parse {
        /// The file.
        name: String,
        /// Why, with the line.
        problem: String,
    },
    /// A value makes no sense.
    #[error("scene file {name}: {field}: expected {expected}, found {found}")]
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
}

impl SceneError {
    /// No shipped scene has that name. A path of no file is a failure, like every other missing file, and so is
    /// a defective scene.
    pub fn is_wrong_use(&self) -> bool {
        matches!(self, SceneError::Missing { name, .. } if !is_path(name))
    }
}

/// True if a name can only be that of a file or folder: it has a separator or an extension.
fn is_path(name: &str) -> bool {
    name.contains(std::path::is_separator) || Path::new(name).extension().is_some()
}

/// A key that is refused, what it should hold, and what it holds.
type Defect = (String, String, String);

/// A value as a scene file has it, for messages.
fn shown(value: &impl Serialize) -> String {
    toml::Value::try_from(value).map_or_else(|problem| problem.to_string(), |value| value.to_string())
}

/// Refuses a key.
fn refuse(field: impl Into<String>, expected: impl Into<String>, found: impl ToString) -> Option<Defect> {
    Some((field.into(), expected.into(), found.to_string()))
}

/// A key with its value, and the lowest and highest value allowed.
type Range = (&'static str, f64, f64, f64);

/// A scene: an eye, whatever lies in it (each subject a table of its own that may be
/// absent), and perhaps a script.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// [`FORMAT`].
    pub format: String,
    /// One line for people.
    pub title: String,
    /// The eye.
    pub eye: EyeScene,
    /// The epiretinal membrane; a scene may do without.
    pub membrane: Option<MembraneScene>,
    /// Rigid bodies to push, pick up and place.
    pub bodies: Option<BodiesScene>,
    /// The whole retina as tissue; without it the retina is a sphere that nothing lifts.
    pub retina: Option<RetinaScene>,
    /// The vitreous body; a scene may do without.
    pub vitreous: Option<VitreousScene>,
    /// What the vitrector can do, if other than usual.
    pub vitrector: Option<VitrectorScene>,
    /// What the needle can do, if other than usual.
    pub needle: Option<NeedleScene>,
    /// What the trainee is asked to do; a scene may be there to look at only.
    pub task: Option<TaskScene>,
    /// How instruments act on tissue and retina.
    pub contact: ContactScene,
    /// The microscope at the start.
    pub microscope: MicroscopeScene,
    /// Its lens, inverter and steps, if other than usual.
    pub optics: Option<OpticsScene>,
    /// The two instruments, in the order of the rig.
    pub instruments: Vec<InstrumentScene>,
    /// What the scripted surgeon does; without it the instruments rest.
    pub script: Option<ScriptScene>,
}

/// Left or right eye: decides where the optic disc lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Side {
    Left,
    Right,
}

/// The eye.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EyeScene {
    /// Which eye.
    pub side: Side,
    /// Inner radius of the retina, mm.
    pub retina_radius_mm: f64,
}

/// How instruments act.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactScene {
    /// Clearance of a tip from the retina that counts as grazing, mm.
    pub graze_mm: f64,
    /// Clearance that counts as touching, mm.
    pub touch_mm: f64,
    /// Half width and depth of the collision volume at a tip, mm.
    pub volume_mm: [f64; 2],
    /// Resolution of the collision images.
    pub resolution: u32,
    /// Jaw opening under which closing jaws grab, rad.
    pub grab_below_rad: f64,
    /// Jaw opening over which opening jaws let go, rad.
    pub release_above_rad: f64,
    /// Distance from the tip within which nodes are grabbed, mm.
    pub grab_reach_mm: f64,
    /// Force at which the grip slips, µN.
    pub grip_un: f64,
    /// Friction of instruments on the membrane (Coulomb): sideways drag as a share of the push.
    #[serde(default, skip_serializing_if = "is_default")]
    pub friction: f64,
}

impl ContactScene {
    /// What is wrong beyond the ranges.
    fn defect(&self) -> Option<Defect> {
        if !(8..=256).contains(&self.resolution) {
            return refuse("contact.resolution", "8 to 256", self.resolution);
        }
        if self.grab_below_rad > self.release_above_rad {
            let found = format!("{} > {}", self.grab_below_rad, self.release_above_rad);
            return refuse("contact.grab_below_rad", "at most release_above_rad", found);
        }
        None
    }
}

/// True for what a file may leave out.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// The microscope at the start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MicroscopeScene {
    /// Point looked at, world frame, mm.
    pub target_in_world_mm: [f64; 3],
    /// mm.
    pub working_distance_mm: f64,
    /// mm.
    pub stereo_base_mm: f64,
    /// Diameter of the field of view, mm.
    pub field_mm: f64,
}

/// An instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InstrumentScene {
    /// What it is.
    pub tool: Tool,
    /// Outer radius of the shaft, mm.
    pub shaft_radius_mm: f64,
}

impl SceneFile {
    /// Loads a scene by file name, or a shipped one by its name.
    ///
    /// # Errors
    /// If there is no such scene or it is refused.
    pub fn load(name: &str) -> Result<Self, SceneError> {
        let path = Path::new(name);
        if path.is_file() {
            let text = read_text(path, MAX_TABLE_BYTES)
                .map_err(|source| SceneError::Read { name: name.into(), source })?;
            let mut scene = Self::read(&text, name)?;
            if let Some(mesh) = scene.membrane.as_mut().and_then(|m| m.mesh.as_mut()) {
                mesh.resolve(name)?;
            }
            scene.check(name)?;
            return Ok(scene);
        }
        let shipped = SHIPPED.iter().find(|(n, _)| *n == name);
        let (_, text) = shipped.ok_or_else(|| SceneError::Missing {
            name: name.into(),
            shipped: SHIPPED.iter().map(|(n, _)| *n).collect::<Vec<_>>().join(", "),
        })?;
        Self::parse(text, name)
    }

    /// Parses and checks the text of a scene; `name` is for error messages.
    ///
    /// # Errors
    /// If a key is unknown, missing or out of its range; the error names it.
    pub fn parse(text: &str, name: &str) -> Result<Self, SceneError> {
        let scene = Self::read(text, name)?;
        scene.check(name)?;
        Ok(scene)
    }

    fn read(text: &str, name: &str) -> Result<Self, SceneError> {
        toml::from_str(text).map_err(|source| match other_format_in(text, FORMAT) {
            Some(found) => SceneError::Value {
                name: name.into(),
                field: "format".into(),
                expected: FORMAT.into(),
                found,
            },
            None => SceneError::Parse { name: name.into(), problem: parse_error::toml(text, &source) },
        })
    }

    /// The script; instruments at rest where the scene has none.
    pub fn script_or_rest(&self) -> Cow<'_, ScriptScene> {
        self.script.as_ref().map_or_else(|| Cow::Owned(ScriptScene::at_rest()), Cow::Borrowed)
    }

    /// The scene without its script: what a simulation of it depends on.
    pub fn without_script(&self) -> Self {
        SceneFile { script: None, ..self.clone() }
    }

    /// As TOML, for recordings.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a scene is plain tables")
    }

    fn check(&self, name: &str) -> Result<(), SceneError> {
        let value =
            |(field, expected, found)| SceneError::Value { name: name.into(), field, expected, found };
        self.defect().map(value).map_or(Ok(()), Err)
    }

    /// The first key that makes no sense.
    fn defect(&self) -> Option<Defect> {
        if let Some(found) = other_format(&self.format, FORMAT) {
            return refuse("format", FORMAT, found);
        }
        if self.instruments.len() != INSTRUMENTS {
            return refuse("instruments", "two of them", self.instruments.len());
        }
        let outside = |(_, value, low, high): &Range| !(low..=high).contains(&value);
        if let Some((field, value, low, high)) = self.ranges().into_iter().find(outside) {
            return refuse(field, format!("{low} to {high}"), value);
        }
        let radius_mm = self.eye.retina_radius_mm;
        let bodies = self.bodies.as_ref().map_or(0, |b| b.body.len());
        let goals = self.task.as_ref().map_or(0, |t| t.goals.len());
        let of_membrane = self.membrane.as_ref().and_then(|m| m.defect(radius_mm));
        of_membrane
            .or_else(|| self.bodies.as_ref()?.defect(radius_mm))
            .or_else(|| self.optics.as_ref()?.defect(&self.microscope))
            .or_else(|| self.vitreous.as_ref()?.defect(radius_mm))
            .or_else(|| self.task.as_ref()?.defect(radius_mm, bodies))
            .or_else(|| self.contact.defect())
            .or_else(|| self.script.as_ref()?.defect(goals, bodies))
    }

    /// Every plain number with its allowed range, both ends included.
    fn ranges(&self) -> Vec<Range> {
        let (c, v) = (&self.contact, &self.microscope);
        let mut ranges = vec![
            ("eye.retina_radius_mm", self.eye.retina_radius_mm, 5.0, 20.0),
            ("contact.graze_mm", c.graze_mm, 0.0, 5.0),
            ("contact.touch_mm", c.touch_mm, 0.0, c.graze_mm),
            ("contact.volume_mm[0]", c.volume_mm[0], 0.1, 5.0),
            ("contact.volume_mm[1]", c.volume_mm[1], 0.1, 10.0),
            ("contact.grab_below_rad", c.grab_below_rad, 0.0, 3.2),
            ("contact.release_above_rad", c.release_above_rad, 0.0, 3.2),
            ("contact.grab_reach_mm", c.grab_reach_mm, 0.0, 5.0),
            ("contact.grip_un", c.grip_un, 0.0, 1e9),
            ("contact.friction", c.friction, 0.0, 2.0),
            ("microscope.working_distance_mm", v.working_distance_mm, 50.0, 1000.0),
            ("microscope.stereo_base_mm", v.stereo_base_mm, 0.0, 100.0),
            ("microscope.field_mm", v.field_mm, 1.0, 60.0),
            ("microscope.target_in_world_mm[0]", v.target_in_world_mm[0], -50.0, 50.0),
            ("microscope.target_in_world_mm[1]", v.target_in_world_mm[1], -50.0, 50.0),
            ("microscope.target_in_world_mm[2]", v.target_in_world_mm[2], -50.0, 50.0),
        ];
        for (field, instrument) in ["instruments[0].shaft_radius_mm", "instruments[1].shaft_radius_mm"]
            .into_iter()
            .zip(&self.instruments)
        {
            ranges.push((field, instrument.shaft_radius_mm, 0.05, 1.0));
        }
        ranges.extend(self.membrane.iter().flat_map(|m| m.ranges()));
        ranges.extend(self.optics.iter().flat_map(|o| o.ranges()));
        ranges.extend(self.bodies.iter().flat_map(|b| b.ranges()));
        ranges.extend(self.retina.iter().flat_map(|r| r.ranges()));
        ranges.extend(self.vitreous.iter().flat_map(|v| v.ranges()));
        ranges.extend(self.vitrector.iter().flat_map(|v| v.ranges()));
        ranges.extend(self.task.iter().flat_map(|t| t.ranges()));
        ranges.extend(self.script.iter().flat_map(|s| s.ranges()));
        ranges.extend(self.needle.iter().flat_map(|n| n.ranges()));
        ranges
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_scenes_are_valid_and_round_trip() {
        for (name, _) in SHIPPED {
            let scene = SceneFile::load(name).unwrap();
            assert_eq!(scene, SceneFile::parse(&scene.to_toml(), "again").unwrap());
        }
    }

    #[test]
    fn demo_membrane_has_the_size_of_the_paper() {
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let [w, h] = scene.membrane.unwrap().squares;
        assert_eq!(2 * w * h, 1000, "triangles");
    }

    #[test]
    fn a_scene_does_without_a_membrane_and_without_a_script() {
        let mut scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        (scene.membrane, scene.script) = (None, None);
        assert_eq!(*scene.script_or_rest(), ScriptScene::at_rest());
        assert_eq!(ScriptScene::at_rest().defect(0, 0), None);
        assert_eq!(scene, SceneFile::parse(&scene.to_toml(), "again").unwrap());
    }

    #[test]
    fn a_newer_format_is_named_before_its_keys() {
        let newer = "format = \"vitreo-scene-2\"\nheadline = \"of the future\"\n";
        let error = SceneFile::parse(newer, "s.toml").unwrap_err().to_string();
        let expected = "format: expected vitreo-scene-1, found vitreo-scene-2, the format of a newer vitreo";
        assert!(error.contains("s.toml") && error.contains(expected), "{error}");
        let other = SHIPPED[0].1.replacen("vitreo-scene-1", "vitreo-scene-0", 1);
        let error = SceneFile::parse(&other, "s.toml").unwrap_err().to_string();
        assert!(error.contains("format: expected vitreo-scene-1, found 'vitreo-scene-0'"), "{error}");
    }

    /// Texts of `value` with one of its numbers in turn not a number, and where that stands.
    fn without_a_number(value: &toml::Value) -> Vec<(String, toml::Value)> {
        let inner = |key: String, child: &toml::Value, put: &dyn Fn(toml::Value) -> toml::Value| {
            let changed = without_a_number(child).into_iter();
            changed.map(|(at, c)| (format!("{key}.{at}"), put(c))).collect::<Vec<_>>()
        };
        match value {
            toml::Value::Float(_) => vec![(String::new(), toml::Value::Float(f64::NAN))],
            toml::Value::Array(all) => (0..all.len())
                .flat_map(|i| {
                    inner(i.to_string(), &all[i], &|changed| {
                        let mut copy = all.clone();
                        copy[i] = changed;
                        toml::Value::Array(copy)
                    })
                })
                .collect(),
            toml::Value::Table(table) => table
                .iter()
                .flat_map(|(key, child)| {
                    inner(key.clone(), child, &|changed| {
                        let mut copy = table.clone();
                        copy.insert(key.clone(), changed);
                        toml::Value::Table(copy)
                    })
                })
                .collect(),
            _ => vec![],
        }
    }

    #[test]
    fn every_number_has_its_range() {
        for (name, text) in SHIPPED {
            let table = toml::Value::Table(text.parse().unwrap());
            for (at, changed) in without_a_number(&table) {
                let changed = toml::to_string(&changed).unwrap();
                assert!(SceneFile::parse(&changed, name).is_err(), "{name}: {at} may be anything");
            }
        }
    }

    #[test]
    fn defects_are_named() {
        let text = SHIPPED[0].1;
        assert!(SceneFile::load("nowhere").unwrap_err().to_string().contains("shipped: peel, "));
        let unknown = format!("{text}\n[membrain]\nx = 1\n");
        assert!(SceneFile::parse(&unknown, "s.toml").unwrap_err().to_string().contains("membrain"));
        let broken = text.replacen("p_tear = ", "p_tear = nan #", 1);
        assert!(SceneFile::parse(&broken, "s.toml").unwrap_err().to_string().contains("membrane.p_tear"));
        let pressed =
            format!("{text}\n[[script.pedal]]\nat_s = 1.0\nmode = \"aspirate\"\naxes = [0.0, 1.5]\n");
        assert!(SceneFile::parse(&pressed, "s.toml").unwrap_err().to_string().contains("script.pedal[0]"));
        let pump = format!("{text}\n[vitrector]\ncuts_per_min = 90000\n");
        assert!(
            SceneFile::parse(&pump, "s.toml").unwrap_err().to_string().contains("vitrector.cuts_per_min")
        );
    }
}
