//! Rig files (`vitreo-rig-1`): cameras, marked bodies, trocars. JSON, unknown keys refused.

pub mod camera;
pub mod handles;
mod lengths;
mod plausible;
pub mod region;
pub mod sensor;

use camera::Camera;
use handles::RigHandle;
use nalgebra::{Matrix3, Vector2, Vector3};
use protocol::blobs::Colour;
use protocol::fields::PixelFormat;
use protocol::file::{MAX_SETTINGS_BYTES, looks_like, other_format, other_format_in, read_text};
use protocol::limits::MAX_CAMERAS;
use protocol::parse_error;
use sensor::{Scan, Shutter};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The one format this build reads and writes.
pub const FORMAT: &str = "vitreo-rig-1";

/// Why a rig file was refused.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file cannot be read.
    #[error("rig file {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// It is no rig file in JSON; the message has line and column.
    #[error("rig file {path}, {problem}")]
    Parse {
        /// The file.
        path: String,
        /// The parser's message, with line and column.
        problem: String,
    },
    /// It is a rig file but a value makes no sense.
    #[error("rig file {path}: {field}: expected {expected}, found {found}")]
    Value {
        /// The file.
        path: String,
        /// Where in the file.
        field: String,
        /// What would be right.
        expected: String,
        /// What is there.
        found: String,
    },
}

/// A key that is refused, what would be right, and what is there.
type Defect = (String, &'static str, String);

/// Why a text is no rig: another kind of file, another format, or the parser's own words.
fn refusal(text: &str, name: &str, source: serde_json::Error) -> RigError {
    let value = |field: &str, expected: &str, found: String| RigError::Value {
        path: name.into(),
        field: field.into(),
        expected: expected.into(),
        found,
    };
    if !text.trim_start().starts_with('{') {
        let expected = "a rig: one JSON object, which begins with {";
        return value("contents", expected, looks_like(text.as_bytes()).into());
    }
    match other_format_in(text, FORMAT) {
        Some(found) => value("format", FORMAT, found),
        None => RigError::Parse { path: name.into(), problem: parse_error::json(&source) },
    }
}

/// A rig file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// [`FORMAT`].
    pub format: String,
    /// `mm`.
    pub unit: String,
    /// Fields per second of the fastest camera, and so frames of the tracker; of every camera that says nothing else.
    pub field_hz: f64,
    /// Width and height of the frame of every camera, px; `None` where cameras differ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<[u32; 2]>,
    /// How the lines of a field lie in the frame, where all cameras have them alike: [`Scan::rule`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_rule: Option<String>,
    /// Time of one line, ns.
    pub line_ns: u64,
    /// Exposure, ns.
    pub exposure_ns: u64,
    /// Which lines a field has.
    #[serde(default, skip_serializing_if = "is_default")]
    pub scan: Scan,
    /// When they are exposed.
    #[serde(default, skip_serializing_if = "is_default")]
    pub shutter: Shutter,
    /// How pixels are given.
    #[serde(default, skip_serializing_if = "is_default")]
    pub pixel_format: PixelFormat,
    /// Cameras.
    pub cameras: Vec<RigCamera>,
    /// Bodies with markers: `inst0`, `inst1` and `eye`.
    pub bodies: Vec<RigBody>,
    /// Where the shafts pass the eye's wall.
    pub trocars: Vec<Trocar>,
    /// Opening through which the cameras look into the mechanical eye.
    pub eye_opening: EyeOpening,
    /// Where tips can be.
    pub workspace: Workspace,
    /// Encoders in the handles, where there are any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub handles: Vec<RigHandle>,
}

/// A camera; OpenCV conventions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct RigCamera {
    pub id: u32,
    pub width: u32,
    pub height: u32,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    /// [k1, k2, p1, p2, k3].
    pub dist: [f64; 5],
    /// Rotation camera-from-world, rows.
    #[serde(rename = "R")]
    pub rotation: [[f64; 3]; 3],
    /// Translation camera-from-world, mm.
    pub t: [f64; 3],
    /// Where it is slower than the rig's fastest: fields per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_hz: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line_ns: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_ns: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<Scan>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Shutter>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_format: Option<PixelFormat>,
}

/// True for what a file leaves out.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// What a body is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum BodyType {
    Instrument,
    Eye,
}

/// How a marker looks to a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkerKind {
    /// A ball; its image is centred on its centre.
    Sphere,
    /// A painted band around the shaft; its visible surface is centred π/4·r before the axis.
    Band,
}

/// A marker in the body's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigMarker {
    /// Number in the body.
    pub id: u32,
    /// Colour class.
    pub colour: Colour,
    /// How it looks.
    pub kind: MarkerKind,
    /// Position in the body frame, mm.
    pub p: [f64; 3],
    /// Radius, mm.
    pub r: f64,
}

/// A body with markers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigBody {
    /// `inst0`, `inst1` or `eye`.
    pub name: String,
    /// What it is.
    #[serde(rename = "type")]
    pub kind: BodyType,
    /// Radius of the shaft, mm (instruments).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft_r: Option<f64>,
    /// Length from tip to handle, mm (instruments).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<f64>,
    /// Outer radius, mm (eye).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// Markers.
    pub markers: Vec<RigMarker>,
}

/// Where a shaft passes the eye's wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trocar {
    /// Instrument.
    pub body: String,
    /// In the eye frame, mm.
    pub p_eye: [f64; 3],
    /// Play, mm (standard deviation).
    pub sigma: f64,
}

/// The round opening at the bottom of the mechanical eye.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EyeOpening {
    /// Height of its rim in the eye frame, mm.
    pub z: f64,
    /// mm.
    pub radius: f64,
}

/// Where tips can be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Workspace {
    /// Largest distance of a tip from the eye's centre, mm.
    pub tip_radius: f64,
}

/// The rig that runs when none is named.
const SHIPPED: &str = include_str!("../../../assets/rig.json");

impl Rig {
    /// The rig in `path`, or the shipped one.
    ///
    /// # Errors
    /// Where the file cannot be read, is no rig file, or a value makes no sense.
    pub fn load_or_shipped(path: Option<&Path>) -> Result<Self, RigError> {
        path.map_or_else(|| Self::parse(SHIPPED, "assets/rig.json"), Self::load)
    }

    /// Reads and checks a rig file.
    ///
    /// # Errors
    /// Where the file cannot be read, is no rig file, or a value makes no sense.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let name = path.display().to_string();
        let text = read_text(path, MAX_SETTINGS_BYTES)
            .map_err(|source| RigError::Read { path: name.clone(), source })?;
        Self::parse(&text, &name)
    }

    /// Parses and checks the text of a rig file; `name` is for error messages.
    ///
    /// # Errors
    /// Where the text is no rig file, or a value makes no sense.
    pub fn parse(text: &str, name: &str) -> Result<Self, RigError> {
        // Editors of some systems begin a text with a mark of its encoding.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let rig: Rig = serde_json::from_str(text).map_err(|source| refusal(text, name, source))?;
        rig.check(name)?;
        Ok(rig)
    }

    /// As JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("a rig has string keys only")
    }

    /// The body called `name`.
    pub fn body(&self, name: &str) -> Option<&RigBody> {
        self.bodies.iter().find(|b| b.name == name)
    }

    /// The trocar of the body called `name`.
    pub fn trocar(&self, name: &str) -> Option<&Trocar> {
        self.trocars.iter().find(|t| t.body == name)
    }

    /// The cameras, ready for computation, in the order of the file.
    pub fn cameras(&self) -> Vec<Camera> {
        self.cameras.iter().map(RigCamera::model).collect()
    }

    /// Time between two frames of the tracker, ns: that between two fields of the fastest camera. That of each
    /// camera is `period_ns` of its [`sensor::Sensor`].
    pub fn field_period_ns(&self) -> u64 {
        sensor::period_ns(self.field_hz)
    }

    fn check(&self, path: &str) -> Result<(), RigError> {
        let defect = self.defect().or_else(|| self.defect_of_cameras()).or_else(|| self.defect_of_fields());
        let defect = defect.or_else(|| self.defect_of_bodies()).or_else(|| self.defect_of_lenses());
        let defect = defect.or_else(|| self.defect_of_handles());
        let defect = defect.or_else(|| self.defect_of_colours());
        let Some((field, expected, found)) = defect else { return Ok(()) };
        Err(RigError::Value { path: path.into(), field, expected: expected.into(), found })
    }

    /// What is wrong with the keys of the file itself.
    fn defect(&self) -> Option<Defect> {
        let cameras = self.cameras.len();
        let checks = [
            (self.format == FORMAT, "format", FORMAT, other_format(&self.format, FORMAT).unwrap_or_default()),
            (self.unit == "mm", "unit", "mm", self.unit.clone()),
            ((25.0..=500.0).contains(&self.field_hz), "field_hz", "25 to 500", self.field_hz.to_string()),
            ((2..=MAX_CAMERAS).contains(&cameras), "cameras", "2 to 8 cameras", cameras.to_string()),
        ];
        let (_, field, expected, found) = checks.into_iter().find(|(holds, ..)| !holds)?;
        Some((field.into(), expected, found))
    }

    fn defect_of_cameras(&self) -> Option<Defect> {
        self.cameras.iter().enumerate().find_map(|(i, camera)| {
            let twice = self.cameras[..i].iter().any(|c| c.id == camera.id);
            if twice || camera.id as usize >= MAX_CAMERAS {
                return Some((format!("cameras[{i}].id"), "0 to 7, each once", camera.id.to_string()));
            }
            camera.defect().map(|(key, what, found)| (format!("cameras[{i}].{key}"), what, found))
        })
    }
}

impl RigCamera {
    /// Ready for computation.
    pub fn model(&self) -> Camera {
        Camera {
            id: self.id,
            size_px: [self.width, self.height],
            focal_px: Vector2::new(self.fx, self.fy),
            centre_px: Vector2::new(self.cx, self.cy),
            distortion: self.dist,
            camera_from_world: Matrix3::from_fn(|r, c| self.rotation[r][c]),
            translation_mm: Vector3::from(self.t),
        }
    }

    /// The key that is wrong, what would be right, and what is there.
    fn defect(&self) -> Option<(&'static str, &'static str, String)> {
        let numbers = [
            ("fx, fy", vec![self.fx, self.fy]),
            ("cx, cy", vec![self.cx, self.cy]),
            ("dist", self.dist.to_vec()),
            ("t", self.t.to_vec()),
        ];
        if let Some((key, values)) = numbers.iter().find(|(_, of)| !of.iter().all(|v| v.is_finite())) {
            return Some((key, "finite numbers", format!("{values:?}")));
        }
        let m = self.model();
        let off = (m.camera_from_world * m.camera_from_world.transpose() - Matrix3::identity()).norm();
        if off.is_nan() || off > 1e-6 {
            return Some(("R", "a rotation matrix", format!("R·Rᵀ off by {off:.2e}")));
        }
        let mirrors = m.camera_from_world.determinant() < 0.0;
        mirrors.then(|| {
            let expected = "a rotation between right-handed frames (x right, y down, z into the picture)";
            ("R", expected, "a mirrored R: its determinant is -1".into())
        })
    }
}

#[cfg(test)]
mod tests;
