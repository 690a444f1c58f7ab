//! The catalogue of causes for which two recordings differ, and how sure a finding is.

use super::blobs::MarkerId;
use super::inputs::difference;
use super::provenance::Part;
use protocol::blobs::Colour;
use protocol::poses::BODY_NAMES;
use serde::Serialize;
use serde_json::Value;

/// Why two recordings differ. What is said is of the second recording, as seen from the first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "cause")]
pub enum Cause {
    /// A camera stands otherwise.
    CameraMoved {
        /// Camera id.
        camera: u32,
        /// Angle, degrees.
        turn_deg: f64,
        /// Distance of the centres of projection, mm.
        shift_mm: f64,
    },
    /// A marker sits elsewhere on its body.
    MarkerMoved {
        /// Body.
        body: &'static str,
        /// Place of the marker in the rig file, from 0 on.
        marker: usize,
        /// Shift in the body's frame, mm.
        by_mm: [f64; 3],
    },
    /// A setting, or a number of rig or scene, has another value.
    KeyChanged {
        /// Where.
        part: Part,
        /// Which.
        key: String,
        /// Value in the first recording.
        a: Option<Value>,
        /// Value in the second.
        b: Option<Value>,
    },
    /// Inputs are in one recording only.
    InputMissing {
        /// Which: a camera-field, a handle or a pedal state.
        what: String,
        /// How many of the kind.
        count: u64,
        /// `A` or `B`, which lacks them.
        lacking: char,
    },
    /// A camera sends nothing, from some instant on.
    CameraLost {
        /// Camera id.
        camera: u32,
        /// From when on, s from the start.
        from_s: f64,
        /// `A` or `B`, which lacks it.
        lacking: char,
    },
    /// A recording begins later or ends earlier than the other.
    Shorter {
        /// `A` or `B`, the shorter one.
        lacking: char,
        /// Camera-fields that only the other has, before its beginning or behind its end.
        fields: u64,
    },
    /// The clock of a camera is off.
    ClockShifted {
        /// Camera id.
        camera: u32,
        /// Its stamps are late by this, ms.
        by_ms: f64,
    },
    /// Two colours are exchanged.
    ColoursSwapped {
        /// The colours.
        colours: [&'static str; 2],
        /// In these cameras.
        cameras: Vec<u32>,
    },
    /// Two cameras are exchanged.
    CamerasSwapped {
        /// Their ids.
        cameras: [u32; 2],
    },
    /// Two markers of a body are exchanged in the rig.
    MarkersSwapped {
        /// Body.
        body: &'static str,
        /// Places of the markers in the rig file, from 0 on.
        markers: [usize; 2],
    },
    /// Another scale.
    Scale {
        /// Of a camera's pictures (its focal length), or of all.
        camera: Option<u32>,
        /// Factor.
        factor: f64,
    },
    /// Another version of the arithmetic.
    OtherVersion {
        /// What of.
        program: String,
        /// Version of the first recording.
        a: String,
        /// Version of the second.
        b: String,
    },
    /// The blobs differ without a pattern, by little: noise of the cameras.
    BlobNoise {
        /// Root mean square, px.
        rms_px: f64,
    },
    /// The blobs differ, and no single change of the rig explains it: hands or eye moved otherwise.
    OtherMotion {
        /// Root mean square of what the blobs moved, each blob counting as 1 px at most, px; 0 where there are none.
        rms_px: f64,
    },
    /// Nothing that was recorded explains the difference.
    Unexplained {
        /// Where it begins.
        what: String,
    },
}

/// How sure a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Confidence {
    /// One of several that explain it as well.
    Possible,
    /// It explains what was measured down to the noise, and nothing else of the catalogue does.
    Likely,
    /// It was read, not inferred.
    Certain,
}

/// A cause with what it rests on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The cause.
    #[serde(flatten)]
    pub cause: Cause,
    /// How sure.
    pub confidence: Confidence,
    /// What it rests on.
    pub evidence: String,
}

impl Finding {
    /// A finding.
    pub fn new(cause: Cause, confidence: Confidence, evidence: impl Into<String>) -> Self {
        Finding { cause, confidence, evidence: evidence.into() }
    }

    /// In one line.
    pub fn text(&self) -> String {
        let sure = match self.confidence {
            Confidence::Possible => "possible",
            Confidence::Likely => "likely",
            Confidence::Certain => "certain",
        };
        format!("{} ({sure}: {})", self.cause.text(), self.evidence)
    }
}

impl Cause {
    /// A marker that was moved.
    pub fn marker_moved(id: MarkerId, by_mm: [f64; 3]) -> Self {
        Cause::MarkerMoved { body: BODY_NAMES[id.body], marker: id.marker, by_mm }
    }

    /// In words.
    pub fn text(&self) -> String {
        let value = |v: &Option<Value>| v.as_ref().map_or("absent".into(), Value::to_string);
        match self {
            Cause::CameraMoved { camera, turn_deg, shift_mm } => {
                format!("camera {camera} moved: turned by {turn_deg:.3}°, shifted by {shift_mm:.3} mm")
            }
            Cause::MarkerMoved { body, marker, by_mm } => {
                let [x, y, z] = by_mm;
                let length = by_mm.iter().map(|v| v * v).sum::<f64>().sqrt();
                format!(
                    "marker {marker} of {body} moved by {length:.3} mm ({x:+.3}, {y:+.3}, {z:+.3} in its frame)"
                )
            }
            Cause::KeyChanged { part, key, a, b } => {
                format!("{} {key} changed: {} → {}", part.name(), value(a), value(b))
            }
            Cause::InputMissing { what, count, lacking } => {
                format!(
                    "input missing in {lacking}: {what}{}",
                    if *count > 1 { format!(" (first of {count})") } else { String::new() }
                )
            }
            Cause::CameraLost { camera, from_s, lacking } => {
                format!("camera {camera} lost in {lacking} from {from_s:.2} s on")
            }
            Cause::Shorter { lacking, fields } => {
                format!("{lacking} is shorter, by {fields} camera-fields at its beginning or end")
            }
            Cause::ClockShifted { camera, by_ms } => {
                format!("clock of camera {camera} off by {by_ms:+.2} ms")
            }
            Cause::ColoursSwapped { colours: [a, b], cameras } => {
                format!("colours {a} and {b} exchanged in cameras {cameras:?}")
            }
            Cause::CamerasSwapped { cameras: [a, b] } => format!("cameras {a} and {b} exchanged"),
            Cause::MarkersSwapped { body, markers: [a, b] } => {
                format!("markers {a} and {b} of {body} exchanged")
            }
            Cause::Scale { camera: Some(camera), factor } => {
                format!("pictures of camera {camera} scaled by {factor:.5} (its focal length)")
            }
            Cause::Scale { camera: None, factor } => format!("everything scaled by {factor:.5}"),
            Cause::OtherVersion { program, a, b } => format!("other version of {program}: {a} → {b}"),
            Cause::BlobNoise { rms_px } => format!("blobs differ by noise alone, {rms_px:.3} px RMS"),
            Cause::OtherMotion { rms_px: 0.0 } => "hands or eye moved otherwise".into(),
            Cause::OtherMotion { rms_px } => {
                format!("hands or eye moved otherwise: blobs differ by {rms_px:.2} px RMS")
            }
            Cause::Unexplained { what } => format!("unexplained: {what}"),
        }
    }
}

/// Name of a colour on the wire.
pub fn colour_name(code: u32) -> &'static str {
    Colour::from_wire(code).map_or("unknown", Colour::name)
}

/// Seconds from one instant to another.
pub fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    difference(from_ns, to_ns) as f64 * 1e-9
}
