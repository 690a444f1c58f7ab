//! Planted defects: pairs of recordings of one motion, of which the second has a known defect, drawn from a
//! seed, and what `vitreo diff` says of it.
//!
//! | defect | size | planted in |
//! |---|---|---|
//! | a camera turned | 0.1–1° | blobs, or rig |
//! | a marker moved | 0.05–0.3 mm | blobs, or rig |
//! | two colours exchanged | | blobs |
//! | two cameras exchanged | | blobs |
//! | a camera's stamps off | 1–10 ms | stamps |
//! | a camera that exposes late | 2–10 ms | blobs |
//! | a camera's focal length, or the whole rig, scaled | 0.5–3 % | blobs, or rig |
//! | a camera lost | | fields |
//! | the membrane's springs | +5 % | scene |
//! | a constant of the tracker | ×0.5–2 | settings |
//! | a camera-field or a handle state lost | one | fields, handles |
//! | none: other noise, another motion | | blobs |

mod pair;

pub use pair::{Pair, pair};

use nalgebra::Vector3;
use protocol::blobs::Colour;
use protocol::poses::BODY_NAMES;
use protocol::random::Random;
use replay::diff::causes::{Cause, Confidence, Finding};
use rig::Rig;
use tracker::tuning::TUNABLE;

/// Relative error of a size that still counts as right.
const SIZE: f64 = 0.2;
/// Constants of the tracker that are planted: those that make a difference in any recording.
const CONSTANTS: [&str; 5] =
    ["sigma_x_px", "tremor_learning_s", "voluntary_tau_s", "eye_acceleration_rad_s2", "voluntary_learning_s"];

/// A defect.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum Defect {
    CameraTurned {
        camera: u32,
        turn_rad: Vector3<f64>,
        in_rig: bool,
    },
    MarkerMoved {
        body: usize,
        marker: usize,
        by_mm: Vector3<f64>,
        in_rig: bool,
    },
    ColoursSwapped {
        colours: [Colour; 2],
    },
    CamerasSwapped {
        cameras: [u32; 2],
    },
    StampsOff {
        camera: u32,
        by_ms: f64,
    },
    ExposedLate {
        camera: u32,
        by_ms: f64,
    },
    Focal {
        camera: u32,
        factor: f64,
    },
    RigScaled {
        factor: f64,
    },
    CameraLost {
        camera: u32,
        from_s: f64,
    },
    Springs {
        factor: f64,
    },
    TrackerConstant {
        key: &'static str,
        value: f64,
    },
    FieldLost {
        camera: u32,
        field: u64,
    },
    HandleLost {
        seq: u64,
    },
    /// None: the same motion with other noise.
    OtherNoise,
    /// None: hands and eye move otherwise.
    OtherMotion,
}

/// Kinds that are drawn one after the other.
pub const KINDS: u64 = 17;

impl Defect {
    /// Of a seed: kinds follow each other, everything else is drawn.
    pub fn draw(seed: u64, rig: &Rig) -> Self {
        let random = &mut Random::new(seed, 7);
        let camera = rig.cameras[random.below(rig.cameras.len())].id;
        let sign = if random.once_in(2) { -1.0 } else { 1.0 };
        match seed % KINDS {
            n @ (0 | 1) => {
                let angle = random.between(0.1, 1.0).to_radians();
                Defect::CameraTurned { camera, turn_rad: random.vector().normalize() * angle, in_rig: n == 1 }
            }
            n @ (2 | 3) => {
                let body = random.below(BODY_NAMES.len());
                let markers = rig.body(BODY_NAMES[body]).map_or(1, |body| body.markers.len());
                let by_mm = random.vector().normalize() * random.between(0.05, 0.3);
                Defect::MarkerMoved { body, marker: random.below(markers), by_mm, in_rig: n == 3 }
            }
            4 => Defect::ColoursSwapped {
                colours: random.one_of(&[
                    [Colour::Red, Colour::Green],
                    [Colour::Red, Colour::Blue],
                    [Colour::Green, Colour::Blue],
                    [Colour::Yellow, Colour::Cyan],
                ]),
            },
            5 => Defect::CamerasSwapped { cameras: random.one_of(&[[0, 1], [0, 2], [1, 2]]) },
            6 => Defect::StampsOff { camera, by_ms: sign * random.between(1.0, 10.0) },
            7 | 8 => Defect::ExposedLate { camera, by_ms: sign * random.between(2.0, 10.0) },
            9 => Defect::Focal { camera, factor: 1.0 + sign * random.between(0.005, 0.03) },
            10 => Defect::RigScaled { factor: 1.0 + sign * random.between(0.005, 0.03) },
            11 => Defect::CameraLost { camera, from_s: random.between(1.0, 4.0) },
            12 => Defect::Springs { factor: 1.05 },
            13 => {
                let key = random.one_of(&CONSTANTS);
                let default = TUNABLE.iter().find(|row| row.key == key).map_or(1.0, |row| row.default);
                Defect::TrackerConstant { key, value: default * random.one_of(&[0.6, 0.8, 1.25, 2.0]) }
            }
            14 => Defect::OtherNoise,
            15 => Defect::OtherMotion,
            _ if random.once_in(2) => Defect::FieldLost { camera, field: 50 + random.below(200) as u64 },
            _ => Defect::HandleLost { seq: 100 + random.below(300) as u64 },
        }
    }

    /// Whether a cause names this defect, with its size.
    pub fn is_named_by(&self, cause: &Cause) -> bool {
        let near = |found: f64, planted: f64| (found - planted).abs() <= SIZE * planted.abs();
        match (self, cause) {
            (
                Defect::CameraTurned { camera, turn_rad, .. },
                Cause::CameraMoved { camera: found, turn_deg, .. },
            ) => camera == found && near(*turn_deg, turn_rad.norm().to_degrees()),
            (
                Defect::MarkerMoved { body, marker, by_mm, .. },
                Cause::MarkerMoved { body: name, marker: found, by_mm: by },
            ) => {
                BODY_NAMES[*body] == *name
                    && marker == found
                    && (Vector3::from(*by) - by_mm).norm() < 0.25 * by_mm.norm()
            }
            (Defect::ColoursSwapped { colours }, Cause::ColoursSwapped { colours: found, .. }) => {
                found == colours || *found == [colours[1], colours[0]]
            }
            (Defect::CamerasSwapped { cameras }, Cause::CamerasSwapped { cameras: found }) => {
                cameras == found
            }
            (Defect::StampsOff { camera, by_ms }, Cause::ClockShifted { camera: found, by_ms: by }) => {
                camera == found && near(*by, *by_ms)
            }
            // Exposures that are later than the stamps say: the stamps are early.
            (Defect::ExposedLate { camera, by_ms }, Cause::ClockShifted { camera: found, by_ms: by }) => {
                camera == found && near(*by, -by_ms)
            }
            (Defect::Focal { camera, factor }, Cause::Scale { camera: Some(found), factor: by }) => {
                camera == found && near(by - 1.0, factor - 1.0)
            }
            (Defect::RigScaled { factor }, Cause::Scale { camera: None, factor: by }) => {
                near(by - 1.0, factor - 1.0)
            }
            (
                Defect::CameraLost { camera, from_s },
                Cause::CameraLost { camera: found, from_s: from, .. },
            ) => camera == found && (from - from_s).abs() < 0.1,
            (Defect::Springs { .. }, Cause::KeyChanged { key, .. }) => key == "membrane.stiffness_un_per_mm",
            (Defect::TrackerConstant { key, .. }, Cause::KeyChanged { key: found, .. }) => {
                *found == format!("tracker.{key}")
            }
            (Defect::FieldLost { camera, field }, Cause::InputMissing { what, count: 1, .. }) => {
                *what == format!("field {field} of camera {camera}")
            }
            (Defect::HandleLost { seq }, Cause::InputMissing { what, count: 1, .. }) => {
                what.starts_with(&format!("handle state {seq} "))
            }
            (Defect::OtherNoise, Cause::BlobNoise { .. })
            | (Defect::OtherMotion, Cause::OtherMotion { .. }) => true,
            _ => false,
        }
    }

    /// Whether there is none: such pairs can only be said to be noise or another motion, never with confidence.
    pub fn is_none(&self) -> bool {
        matches!(self, Defect::OtherNoise | Defect::OtherMotion)
    }
}

/// What became of a planted defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Named, and nothing else with confidence.
    Right,
    /// Among several that were said to be possible.
    Among,
    /// Not found; nothing wrong was said with confidence.
    Missed,
    /// Something else was said with confidence.
    Wrong,
}

impl Verdict {
    /// Of what was found.
    pub fn of(defect: &Defect, found: &[Finding]) -> Self {
        let sure = |finding: &&Finding| finding.confidence >= Confidence::Likely;
        let named = |finding: &&Finding| defect.is_named_by(&finding.cause);
        if found.iter().any(|finding| sure(&finding) && !named(&finding)) {
            return Verdict::Wrong;
        }
        match (found.iter().any(|f| sure(&f) && named(&f)), found.iter().any(|f| named(&f))) {
            (true, _) => Verdict::Right,
            (false, true) if defect.is_none() && found.len() == 1 => Verdict::Right,
            (false, true) => Verdict::Among,
            (false, false) => Verdict::Missed,
        }
    }
}

/// A defect, what was found of it, and the judgement.
#[derive(Debug)]
pub struct Outcome {
    /// Seed of the pair.
    pub seed: u64,
    /// What was planted.
    pub defect: Defect,
    /// What was found.
    pub found: Vec<Finding>,
    /// The judgement.
    pub verdict: Verdict,
}

/// Plants the defect of a seed and looks for its cause.
///
/// # Errors
/// Where a recording cannot be written or read.
pub fn run(seed: u64) -> anyhow::Result<Outcome> {
    let rig = Rig::load_or_shipped(None)?;
    let defect = Defect::draw(seed, &rig);
    let Pair { folder: _folder, a, b } = pair(seed, &defect, &rig)?;
    let [a, b] = replay::diff::read(&a, &b, false)?;
    let compared = replay::diff::comparison::Comparison::of(&a, &b, 0.0);
    anyhow::ensure!(!compared.same, "{defect:?}: both recordings are the same");
    let verdict = Verdict::of(&defect, &compared.causes);
    Ok(Outcome { seed, defect, found: compared.causes, verdict })
}
