//! Which transforms of another tracker are which body, and how well they are known: a file of TOML.

use nalgebra::Isometry3;
use protocol::file::{MAX_SETTINGS_BYTES, read_text};
use protocol::geometry::Pose;
use protocol::limits::BODIES;
use protocol::parse_error;
use protocol::poses::{BODY_NAMES, EYE};
use serde::Deserialize;
use std::ops::RangeInclusive;
use std::path::Path;

/// Standard deviations where the file says nothing: an optical tracker at arm's length, mm and rad.
const POSITION_NOISE_MM: f64 = 0.1;
const ROTATION_NOISE_RAD: f64 = 0.002;
/// Accelerations of a hand that are common, mm/s² and rad/s²: how fast a velocity may change.
const HAND_MM_S2: f64 = 100.0;
const HAND_RAD_S2: f64 = 5.0;
/// A noise that makes sense, mm or rad.
const NOISE: RangeInclusive<f64> = 1e-6..=100.0;
/// An acceleration that makes sense, mm/s² or rad/s².
const ACCELERATION: RangeInclusive<f64> = 1e-3..=1e6;

/// Why a map is refused.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// It is no TOML of this form; the text names line and key.
    #[error("{0}")]
    Form(String),
    /// A value cannot be.
    #[error("{key}: expected {expected}, found {found}")]
    Value {
        /// Name of the key.
        key: String,
        /// What would be right.
        expected: &'static str,
        /// What stands there.
        found: String,
    },
}

/// One body of the file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct BodyEntry {
    /// Name of the transform, tool to tracker.
    transform: String,
    /// The tip in the tool, as a pivot calibration finds it.
    #[serde(default)]
    tool_from_tip: Option<PoseEntry>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    #[serde(default)]
    position_mm: [f64; 3],
    #[serde(default = "no_rotation")]
    rotation_wxyz: [f64; 4],
}

fn no_rotation() -> [f64; 4] {
    Pose::IDENTITY.rotation_wxyz
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct MapFile {
    inst0: Option<BodyEntry>,
    inst1: Option<BodyEntry>,
    eye: Option<BodyEntry>,
    world_from_tracker: Option<PoseEntry>,
    position_noise_mm: Option<f64>,
    rotation_noise_rad: Option<f64>,
    acceleration_mm_s2: Option<f64>,
    acceleration_rad_s2: Option<f64>,
}

/// One body.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapped {
    /// Name of its transform.
    pub transform: String,
    /// The tip in the tool; of the eye no change.
    pub tool_from_tip: Isometry3<f64>,
}

/// Which transform is which body, and what is known of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    /// By body; `None` where the other tracker does not see it.
    pub bodies: [Option<Mapped>; BODIES],
    /// The tracker in the world: centre of the eye, axes of `docs/conventions.md`.
    pub world_from_tracker: Isometry3<f64>,
    /// Standard deviations of a position (mm) and of a rotation (rad), each axis.
    pub noise: [f64; 2],
    /// Accelerations that are common, mm/s² and rad/s².
    pub acceleration: [f64; 2],
}

impl Default for Map {
    /// The names that `vitreo bridge --igtl` sends.
    fn default() -> Self {
        let named = |transform: &str| {
            Some(Mapped { transform: transform.into(), tool_from_tip: Isometry3::identity() })
        };
        Map {
            bodies: [named("Instrument0ToWorld"), named("Instrument1ToWorld"), named("EyeToWorld")],
            world_from_tracker: Isometry3::identity(),
            noise: [POSITION_NOISE_MM, ROTATION_NOISE_RAD],
            acceleration: [HAND_MM_S2, HAND_RAD_S2],
        }
    }
}

impl Map {
    /// Loads a file.
    ///
    /// # Errors
    /// Where it cannot be read or makes no sense.
    pub fn load(path: &Path) -> Result<Self, MapError> {
        Self::read(&read_text(path, MAX_SETTINGS_BYTES)?)
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// Where it makes no sense.
    pub fn read(text: &str) -> Result<Self, MapError> {
        let file: MapFile = toml::from_str(text).map_err(|e| MapError::Form(parse_error::toml(text, &e)))?;
        let entries = [&file.inst0, &file.inst1, &file.eye];
        let mut map = Map { bodies: [None, None, None], ..Map::default() };
        for (i, entry) in entries.into_iter().enumerate() {
            map.bodies[i] = entry.as_ref().map(|entry| mapped(i, entry)).transpose()?;
        }
        if map.bodies[..EYE].iter().all(Option::is_none) {
            return Err(value("inst0, inst1", "the transform of one instrument or both", "none"));
        }
        let names: Vec<&str> = map.bodies.iter().flatten().map(|b| &*b.transform).collect();
        if let Some(twice) = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
            return Err(value("transform", "a different name for each body", twice.1));
        }
        if let Some(pose) = file.world_from_tracker {
            map.world_from_tracker = isometry("world_from_tracker", pose)?;
        }
        let given = [
            ("position_noise_mm", file.position_noise_mm, POSITION_NOISE_MM),
            ("rotation_noise_rad", file.rotation_noise_rad, ROTATION_NOISE_RAD),
        ];
        for (to, given) in map.noise.iter_mut().zip(given) {
            *to = number(given, NOISE, "1e-6 to 100")?;
        }
        let given = [
            ("acceleration_mm_s2", file.acceleration_mm_s2, HAND_MM_S2),
            ("acceleration_rad_s2", file.acceleration_rad_s2, HAND_RAD_S2),
        ];
        for (to, given) in map.acceleration.iter_mut().zip(given) {
            *to = number(given, ACCELERATION, "0.001 to 1e6")?;
        }
        Ok(map)
    }

    /// The body whose transform has this name.
    pub fn body(&self, transform: &str) -> Option<usize> {
        self.bodies.iter().position(|body| body.as_ref().is_some_and(|b| b.transform == transform))
    }
}

fn value(key: &str, expected: &'static str, found: &str) -> MapError {
    MapError::Value { key: key.into(), expected, found: found.into() }
}

/// A value with its key and default, if it is in range.
fn number(
    (key, given, default): (&str, Option<f64>, f64),
    range: RangeInclusive<f64>,
    expected: &'static str,
) -> Result<f64, MapError> {
    let number = given.unwrap_or(default);
    if range.contains(&number) { Ok(number) } else { Err(value(key, expected, &number.to_string())) }
}

fn mapped(body: usize, entry: &BodyEntry) -> Result<Mapped, MapError> {
    let key = |name: &str| format!("{}.{name}", BODY_NAMES[body]);
    if entry.transform.is_empty() || entry.transform.len() > 20 {
        return Err(value(&key("transform"), "1 to 20 bytes, the limit of OpenIGTLink", &entry.transform));
    }
    let tip = entry.tool_from_tip.map(|pose| isometry(&key("tool_from_tip"), pose)).transpose()?;
    Ok(Mapped { transform: entry.transform.clone(), tool_from_tip: tip.unwrap_or_else(Isometry3::identity) })
}

fn isometry(
    key: &str,
    PoseEntry { position_mm, rotation_wxyz }: PoseEntry,
) -> Result<Isometry3<f64>, MapError> {
    let pose = Pose { position_mm, rotation_wxyz };
    if pose.is_valid() {
        return Ok(pose.isometry());
    }
    let found = format!("position {position_mm:?}, rotation {rotation_wxyz:?}");
    Err(value(key, "finite lengths and a quaternion (w, x, y, z) of length 1", &found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_read_and_what_it_leaves_away_has_its_default() {
        let map = Map::read(
            "position_noise_mm = 0.25\n[inst0]\ntransform = \"StylusToTracker\"\n\
             tool_from_tip = { position_mm = [0.0, 0.0, -120.0] }\n[eye]\ntransform = \"EyeToTracker\"\n\
             [world_from_tracker]\nrotation_wxyz = [0.0, 1.0, 0.0, 0.0]\n",
        )
        .unwrap();
        assert_eq!(
            (map.body("StylusToTracker"), map.body("EyeToTracker"), map.body("x")),
            (Some(0), Some(2), None)
        );
        assert_eq!((map.noise, &map.bodies[1]), ([0.25, ROTATION_NOISE_RAD], &None));
        let tip = map.bodies[0].as_ref().unwrap().tool_from_tip;
        assert_eq!(tip.translation.vector.z, -120.0);
        assert!((map.world_from_tracker.rotation.angle() - std::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn slips_are_named() {
        let a = "[inst0]\ntransform = \"A\"\n";
        for (text, named) in [
            ("", "expected the transform of one instrument"),
            ("[eye]\ntransform = \"E\"\n", "expected the transform of one instrument"),
            ("[inst2]\ntransform = \"A\"\n", "unknown key inst2"),
            ("[inst0]\ntransform = \"\"\n", "inst0.transform: expected 1 to 20 bytes"),
            ("[inst0]\ntransform = \"ANameOfTwentyOneBytes\"\n", "inst0.transform"),
            (&format!("{a}[inst1]\ntransform = \"A\"\n"), "a different name for each body, found A"),
            (&format!("position_noise_mm = 0.0\n{a}"), "position_noise_mm: expected 1e-6 to 100, found 0"),
            (&format!("acceleration_mm_s2 = nan\n{a}"), "acceleration_mm_s2: expected 0.001 to 1e6"),
            (
                &format!("{a}[world_from_tracker]\nrotation_wxyz = [1.0, 1.0, 0.0, 0.0]\n"),
                "world_from_tracker",
            ),
            (&format!("{a}tool_from_tip = {{ position = [0, 0, 1] }}\n"), "unknown key position"),
        ] {
            let told = Map::read(text).unwrap_err().to_string();
            assert!(told.contains(named), "{text}: {told}");
        }
    }
}
