//! Why bodies leave residuals or are not tracked: the catalogue of causes, and their judge.
//!
//! A cause is judged by its remedy. Of each cause the judge undoes what it would have done, to the rig or
//! to the blobs, tracks a stretch of the recorded blobs again, and measures what is left in the pictures.
//! Continuous parameters (a shift of stamps, a scale, where a camera or marker stands) are estimated first.
//! A cause explains the residuals where its remedy brings them down to what the best remedy does; where
//! several do, all are named, those with the fewest parameters first: none is favoured without evidence.
//! Progressive pictures are recognised by how blobs move.
//! What no remedy explains has an unknown cause. Pure: the tracker is run on the recorded blobs without its
//! estimation of drift, which would hide a part of it.

mod judge;
mod measure;
mod places;
mod progressive;
mod remedy;
mod search;

pub use judge::{Explanation, Judgement, Verdict, judge};

use protocol::blobs::Colour;
use protocol::poses::BODY_NAMES;
use serde::Serialize;
use std::fmt;

/// What can be wrong between cameras, markers and rig file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "cause")]
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
    },
    /// Fields say that they are of the even lines where they are of the odd ones.
    ParitySwapped {
        /// Of this camera; `None`: of all.
        camera: Option<u32>,
    },
    /// Two fields of a picture were exposed together, and carry stamps a field period apart: the camera
    /// is progressive.
    Progressive {
        /// This camera; `None`: all.
        camera: Option<u32>,
    },
    /// Time stamps of a camera are late (positive) or early against the others'.
    StampsShifted {
        /// The camera.
        camera: u32,
        /// By so much, ms.
        late_ms: f64,
    },
    /// The places of cameras are too far apart (above 1) or too near for the size of the bodies.
    Scale {
        /// Distance in the rig file over the true one.
        factor: f64,
    },
    /// A marker is not where the rig file has it.
    MarkerMoved {
        /// Index of the body.
        body: usize,
        /// Index of the marker in the body.
        marker: usize,
        /// Its place less that of the rig file, mm, in the body.
        shift_mm: [f64; 3],
    },
    /// A camera is not where the rig file has it.
    CameraMoved {
        /// The camera.
        camera: u32,
        /// Angle of its turn, rad.
        turn_rad: f64,
        /// Distance of its centre from that of the rig file, mm.
        shift_mm: f64,
    },
}

impl Cause {
    /// Numbers that were estimated from the blobs.
    pub fn parameters(&self) -> usize {
        match self {
            Cause::CamerasSwapped { .. } | Cause::ColoursSwapped { .. } => 0,
            Cause::ParitySwapped { .. } | Cause::Progressive { .. } => 0,
            Cause::StampsShifted { .. } | Cause::Scale { .. } => 1,
            Cause::MarkerMoved { .. } => 3,
            Cause::CameraMoved { .. } => 6,
        }
    }
}

/// In words, as the end of "… explains it" and "… or …".
impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let of = |camera: &Option<u32>| camera.map_or("all cameras".into(), |id| format!("camera {id}"));
        match self {
            Cause::CamerasSwapped { cameras: [a, b] } => {
                write!(f, "the ids of cameras {a} and {b} are swapped")
            }
            Cause::ColoursSwapped { colours: [a, b] } => {
                write!(f, "the colours {} and {} are swapped", a.name(), b.name())
            }
            Cause::ParitySwapped { camera } => write!(f, "the parity of {} is swapped", of(camera)),
            Cause::Progressive { camera } => {
                write!(f, "{}: two fields of a picture are exposed together (progressive)", of(camera))
            }
            Cause::StampsShifted { camera, late_ms } => {
                let how = if *late_ms > 0.0 { "late" } else { "early" };
                write!(f, "the time stamps of camera {camera} are {:.1} ms {how}", late_ms.abs())
            }
            Cause::Scale { factor } => write!(
                f,
                "the rig's scale is wrong: distances between cameras are {factor:.3} times those that fit the bodies"
            ),
            Cause::MarkerMoved { body, marker, shift_mm } => {
                let mm = shift_mm.iter().map(|v| v * v).sum::<f64>().sqrt();
                write!(
                    f,
                    "marker {marker} of {} is {mm:.2} mm from its place in the rig file",
                    BODY_NAMES[*body]
                )
            }
            Cause::CameraMoved { camera, turn_rad, shift_mm } => {
                write!(f, "camera {camera} was moved, by {:.2} mrad and {shift_mm:.2} mm", 1e3 * turn_rad)
            }
        }
    }
}
