//! The catalogue: everything that is said to be the cause of something, in a recording alone or between two,
//! with its words and its remedy. Whoever names a cause takes it from here.
//!
//! Of one recording a cause says how cameras, markers or clocks are in truth against its rig; of two, how they are in
//! the second against the first.

use protocol::blobs::Colour;
use protocol::poses::BODY_NAMES;
use serde::Serialize;
use serde_json::Value;
use std::fmt;

/// A cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "cause")]
pub enum Cause {
    /// Fields of one camera carry the id of the other.
    CamerasSwapped {
        /// Their ids.
        cameras: [u32; 2],
    },
    /// Blobs of one colour carry the class of the other.
    ColoursSwapped {
        /// The classes.
        colours: [Colour; 2],
        /// In these cameras; of none: in all.
        cameras: Vec<u32>,
    },
    /// Two markers of a body have each other's place in the rig.
    MarkersSwapped {
        /// Body.
        body: &'static str,
        /// Places of the markers in the rig file, from 0 on.
        markers: [usize; 2],
    },
    /// Two markers of different bodies have each other's colour in the rig.
    MarkerColoursSwapped {
        /// The two bodies.
        bodies: [&'static str; 2],
        /// Places of the markers in the rig file, from 0 on, in the order of their bodies.
        markers: [usize; 2],
    },
    /// Fields say that they are of the even lines where they are of the odd ones.
    ParitySwapped {
        /// Camera concerned; `None` means all.
        camera: Option<u32>,
    },
    /// Two fields of a picture were exposed together, and carry stamps a field period apart: the camera
    /// is progressive.
    Progressive {
        /// Camera concerned; `None` means all.
        camera: Option<u32>,
    },
    /// Timestamps of a camera are late (positive) or early against the others'.
    ClockShifted {
        /// Camera id.
        camera: u32,
        /// Offset, ms.
        by_ms: f64,
    },
    /// The timestamps of a camera jitter: they are of the arrival of its pictures.
    TimestampsJitter {
        /// Camera id.
        camera: u32,
        /// Root mean square of the jitter, ms.
        rms_ms: f64,
    },
    /// Another scale.
    Scale {
        /// Of a camera's pictures (its focal length); `None`: of the distances between cameras.
        camera: Option<u32>,
        /// Factor: above 1 the pictures are larger, or the rig has the cameras too far apart.
        factor: f64,
    },
    /// A marker is displaced on its body.
    MarkerMoved {
        /// Body.
        body: &'static str,
        /// Place of the marker in the rig file, from 0 on.
        marker: usize,
        /// Shift in the body's frame, mm.
        by_mm: [f64; 3],
    },
    /// A camera's pose has changed.
    CameraMoved {
        /// Camera id.
        camera: u32,
        /// Angle of its turn, degrees.
        turn_deg: f64,
        /// Distance of the centres of projection, mm.
        shift_mm: f64,
    },
    /// The poses of two cameras have changed, each differently.
    CamerasMoved {
        /// Their ids.
        cameras: [u32; 2],
    },
    /// Several cameras or markers are displaced.
    Drifted,
    /// The lens of a camera is not the one of the rig.
    Lens {
        /// Camera id.
        camera: u32,
        /// Its focal length, as a multiple of the rig's.
        focal: f64,
        /// Shift of its principal point, px.
        centre_px: [f64; 2],
        /// By how much its first radial term of distortion is larger.
        k1: f64,
    },
    /// Pictures have another size than the rig says.
    PictureSize {
        /// Camera concerned; `None` means all.
        camera: Option<u32>,
        /// Their width and height, px.
        size_px: [u32; 2],
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
        /// Root mean square of what the blobs moved, each blob counting as 1 px at most, px; 0 where there are
        /// none.
        rms_px: f64,
    },
    /// Nothing that was recorded explains the difference.
    Unexplained {
        /// Where it begins.
        what: String,
    },
}

/// A part of a recording's provenance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// The rig file.
    Rig,
    /// The scene file.
    Scene,
    /// Configuration.
    Config,
    /// Random seeds.
    Seeds,
    /// Versions of programs and of their arithmetic.
    Versions,
}

impl Part {
    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Part::Rig => "rig",
            Part::Scene => "scene",
            Part::Config => "configuration",
            Part::Seeds => "seeds",
            Part::Versions => "versions",
        }
    }
}

impl Cause {
    /// A marker that was moved, by the index of its body.
    pub fn marker_moved(body: usize, marker: usize, by_mm: [f64; 3]) -> Self {
        Cause::MarkerMoved { body: BODY_NAMES[body], marker, by_mm }
    }

    /// True where it says that a camera is elsewhere, or that any may be.
    pub fn moves_camera(&self, id: u32) -> bool {
        match self {
            Cause::CameraMoved { camera, .. } => *camera == id,
            Cause::CamerasMoved { cameras } => cameras.contains(&id),
            Cause::Drifted => true,
            _ => false,
        }
    }

    /// True if it says something of a camera's place, lens, clock, pictures or colours, or that any may be elsewhere.
    pub fn concerns_camera(&self, id: u32) -> bool {
        match self {
            Cause::CamerasSwapped { cameras } => cameras.contains(&id),
            Cause::ColoursSwapped { cameras, .. } => cameras.contains(&id),
            Cause::ParitySwapped { camera }
            | Cause::Progressive { camera }
            | Cause::PictureSize { camera, .. }
            | Cause::Scale { camera, .. } => camera.is_none_or(|own| own == id),
            Cause::ClockShifted { camera, .. }
            | Cause::TimestampsJitter { camera, .. }
            | Cause::Lens { camera, .. } => *camera == id,
            other => other.moves_camera(id),
        }
    }

    /// Numbers that were estimated from the blobs.
    pub fn parameters(&self) -> usize {
        match self {
            Cause::ClockShifted { .. } | Cause::Scale { .. } => 1,
            Cause::MarkerMoved { .. } => 3,
            Cause::CameraMoved { .. } => 6,
            // With its camera's place.
            Cause::Lens { .. } => 11,
            Cause::CamerasMoved { .. } => 12,
            Cause::Drifted => 100,
            _ => 0,
        }
    }

    /// What helps; `None` where nothing is to be mended.
    pub fn remedy(&self) -> Option<&'static str> {
        Some(match self {
            Cause::CamerasSwapped { .. } => "exchange the two cables, or the ids in the rig file",
            Cause::ColoursSwapped { cameras, .. } if !cameras.is_empty() => {
                "use the other cameras' settings (white balance, order of its colour channels), or learn its colour classes again (vitreo colours)"
            }
            Cause::ColoursSwapped { .. } => {
                "learn the colour classes again (vitreo colours), or correct the markers' colours in the rig file"
            }
            Cause::MarkersSwapped { .. } | Cause::MarkerColoursSwapped { .. } => {
                "exchange the two markers' colours in the rig file"
            }
            Cause::ParitySwapped { .. } => "exchange even and odd fields in the camera's driver",
            Cause::Progressive { .. } => {
                "set the camera to interlaced pictures, or give both fields of a picture one exposure"
            }
            Cause::TimestampsJitter { .. } => {
                "let the driver use the camera's own timestamps of the exposure, not the time at which a picture arrives"
            }
            Cause::ClockShifted { .. } => "synchronise the camera, or correct the delay in its driver",
            Cause::Lens { .. } => {
                "calibrate that lens again (vitreo calibrate intrinsics), then the camera poses with it (vitreo calibrate \
                 dots or stereo)"
            }
            Cause::Scale { camera: Some(_), .. } => "calibrate its lens (vitreo calibrate intrinsics)",
            Cause::Scale { camera: None, .. } => {
                "calibrate the camera poses with the true size of the target (vitreo calibrate dots or stereo)"
            }
            Cause::MarkerMoved { .. } => "fasten it, or calibrate the markers again (vitreo calibrate waved)",
            Cause::PictureSize { .. } => {
                "set the camera to the rig file's picture size, or calibrate its lens at the new size (vitreo calibrate intrinsics)"
            }
            Cause::CamerasMoved { .. } => {
                "put them back, or calibrate again: vitreo calibrate waved after a small move, dots or stereo after a large one"
            }
            Cause::Drifted => "calibrate again: vitreo calibrate waved",
            Cause::CameraMoved { .. } => {
                "put it back, or calibrate again: vitreo calibrate waved after a small move, dots or stereo after a large one; \
                 intrinsics first if its lens was changed or focused again"
            }
            Cause::CameraLost { .. } => "check its cable and its driver",
            Cause::InputMissing { .. } => "record to a faster disk; vitreo check lists what is missing",
            _ => return None,
        })
    }
}

/// In words.
impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Cause::CamerasSwapped { cameras: [a, b] } => {
                write!(f, "the ids of cameras {a} and {b} are swapped")
            }
            Cause::ColoursSwapped { colours: [a, b], cameras } => {
                write!(f, "the colours {} and {} are swapped{}", a.name(), b.name(), in_cameras(cameras))
            }
            Cause::MarkersSwapped { body, markers: [a, b] } => {
                write!(f, "markers {a} and {b} of {body} are swapped")
            }
            Cause::MarkerColoursSwapped { bodies: [of_a, of_b], markers: [a, b] } => {
                write!(f, "the colours of marker {a} of {of_a} and marker {b} of {of_b} are swapped")
            }
            Cause::ParitySwapped { camera } => write!(f, "the parity of {} is swapped", of_camera(*camera)),
            Cause::Progressive { camera } => write!(
                f,
                "{}: two fields of a picture are exposed together (progressive)",
                of_camera(*camera)
            ),
            Cause::ClockShifted { camera, by_ms } => {
                let how = if *by_ms > 0.0 { "late" } else { "early" };
                write!(f, "the timestamps of camera {camera} are {:.2} ms {how}", by_ms.abs())
            }
            Cause::TimestampsJitter { camera, rms_ms } => {
                write!(
                    f,
                    "the timestamps of camera {camera} jitter by {rms_ms:.2} ms RMS, its exposures do not"
                )
            }
            Cause::Scale { camera: Some(camera), factor } => {
                write!(f, "pictures of camera {camera} are scaled by {factor:.5} (its focal length)")
            }
            Cause::Scale { camera: None, factor } => write!(
                f,
                "the distances between the cameras are {:.2} % too {} for the size of the bodies",
                100.0 * (factor - 1.0).abs(),
                if *factor > 1.0 { "large" } else { "small" }
            ),
            Cause::MarkerMoved { body, marker, by_mm } => {
                let ([x, y, z], mm) = (by_mm, norm(by_mm));
                write!(
                    f,
                    "marker {marker} of {body} was moved by {mm:.3} mm ({x:+.3}, {y:+.3}, {z:+.3} in its frame)"
                )
            }
            Cause::CameraMoved { camera, turn_deg, shift_mm } => {
                write!(f, "camera {camera} was moved: turned by {turn_deg:.3}°, shifted by {shift_mm:.3} mm")
            }
            Cause::CamerasMoved { cameras: [a, b] } => {
                write!(f, "cameras {a} and {b} were moved independently")
            }
            Cause::Lens { camera, focal, centre_px: [x, y], k1 } => write!(
                f,
                "the lens of camera {camera} is not that of the rig file: focal length {:+.2} %, principal point {x:+.1}, \
                 {y:+.1} px, k1 {k1:+.3}",
                100.0 * (focal - 1.0)
            ),
            Cause::Drifted => {
                f.write_str("several cameras or markers are displaced from their positions in the rig file")
            }
            Cause::PictureSize { camera, size_px: [width, height] } => {
                write!(
                    f,
                    "pictures of {} are {width} × {height} px large, unlike the rig's",
                    of_camera(*camera)
                )
            }
            between => write_difference(between, f),
        }
    }
}

/// Causes that only two recordings can show.
fn write_difference(cause: &Cause, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    match cause {
        Cause::KeyChanged { part, key, a, b } => {
            let value = |v: &Option<Value>| v.as_ref().map_or("absent".into(), Value::to_string);
            write!(f, "{} {key} changed: {} → {}", part.name(), value(a), value(b))
        }
        Cause::InputMissing { what, count, lacking } => {
            let more = if *count > 1 { format!(" (first of {count})") } else { String::new() };
            write!(f, "input missing in {lacking}: {what}{more}")
        }
        Cause::CameraLost { camera, from_s, lacking } => {
            write!(f, "camera {camera} lost in {lacking} from {from_s:.2} s on")
        }
        Cause::Shorter { lacking, fields } => {
            write!(f, "{lacking} is shorter, by {fields} camera-fields at its beginning or end")
        }
        Cause::OtherVersion { program, a, b } => write!(f, "other version of {program}: {a} → {b}"),
        Cause::BlobNoise { rms_px } => write!(f, "blobs differ by noise alone, {rms_px:.3} px RMS"),
        Cause::OtherMotion { rms_px: 0.0 } => f.write_str("hands or eye moved otherwise"),
        Cause::OtherMotion { rms_px } => {
            write!(f, "hands or eye moved otherwise: blobs differ by {rms_px:.2} px RMS")
        }
        Cause::Unexplained { what } => write!(f, "unexplained: {what}"),
        // The others have been written.
        _ => Ok(()),
    }
}

fn of_camera(camera: Option<u32>) -> String {
    camera.map_or("all cameras".into(), |id| format!("camera {id}"))
}

fn in_cameras(cameras: &[u32]) -> String {
    let ids: Vec<String> = cameras.iter().map(u32::to_string).collect();
    match &ids[..] {
        [] => String::new(),
        [one] => format!(" in camera {one}"),
        _ => format!(" in cameras {}", ids.join(", ")),
    }
}

fn norm(of: &[f64]) -> f64 {
    of.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
