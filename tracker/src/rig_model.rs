//! The rig in the form that the tracker computes with: cameras by id, markers and trocar by body.

use crate::constants as k;
use crate::eye_filter::StartSigmas;
use crate::motion_models::Singer;
use crate::rate_constants::RateConstants;
use crate::tuning::Tuning;
use nalgebra::{Point3, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS, MAX_MARKERS};
use protocol::poses::{BODY_NAMES, EYE};
use rig::camera::Camera;
use rig::{MarkerKind, Rig, RigBody};

/// A marker of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// In the body frame, mm.
    pub position: Point3<f64>,
    /// Radius, mm.
    pub radius: f64,
    /// Colour, as in the message.
    pub colour: u32,
    /// True for a band around the shaft, false for a ball.
    pub band: bool,
}

/// The trocar of an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrocarModel {
    /// In the eye frame, mm.
    pub position_in_eye: Point3<f64>,
    /// Play (standard deviation), mm.
    pub sigma: f64,
}

/// Three markers that determine a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triple {
    /// Indices of the markers.
    pub markers: [usize; 3],
    /// Distances 0–1, 0–2, 1–2, mm.
    pub distances: [f64; 3],
}

/// A tracked body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyModel {
    /// Markers.
    pub markers: Vec<Marker>,
    /// Triples that are not in a line, the largest first.
    pub triples: Vec<Triple>,
    /// The trocar of an instrument; `None` for the eye.
    pub trocar: Option<TrocarModel>,
    /// True for the eye, whose centre is the origin.
    pub is_eye: bool,
    /// Farthest marker from the body's origin, mm.
    pub reach: f64,
    /// Radius of an instrument's shaft, mm; 0 of the eye.
    pub shaft_radius: f64,
    /// Motion models of position and rotation.
    pub motion: [Singer; 2],
    /// Initial standard deviations of the motion.
    pub start: StartSigmas,
    /// Constants that may be set.
    pub tuning: Tuning,
    /// Constants at the rate of the cameras.
    pub at_rate: RateConstants,
}

/// When a camera exposes the lines of its frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lines {
    /// By how much a line of the frame is later than the one above it, s; 0 of a global shutter.
    row_s: f64,
    /// Height of the frame, px.
    height_px: f64,
}

impl Lines {
    /// True if all lines are exposed at once.
    pub fn is_global(&self) -> bool {
        self.row_s == 0.0
    }

    /// How much later than the field's instant line `y_px` of the frame is exposed, s.
    pub fn delay_s(&self, y_px: f64) -> f64 {
        (y_px.clamp(0.0, self.height_px) - 0.5 * self.height_px) * self.row_s
    }

    /// The instant of a line, where that of the field is `dt_s`, s; with a global shutter the same to the bit.
    pub fn dt_s(&self, dt_s: f64, y_px: f64) -> f64 {
        if self.is_global() { dt_s } else { dt_s + self.delay_s(y_px) }
    }
}

/// Cameras and bodies of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigModel {
    /// By camera id.
    pub cameras: [Option<Camera>; MAX_CAMERAS],
    /// When their lines are exposed, by camera id.
    pub lines: [Lines; MAX_CAMERAS],
    /// `inst0`, `inst1`, eye.
    pub bodies: [BodyModel; BODIES],
    /// Radius of the workspace of tips about the eye's centre, mm.
    pub tip_radius: f64,
    /// True if the instruments have no colour in common.
    pub distinct_colours: bool,
    /// Constants that may be set.
    pub tuning: Tuning,
    /// Constants at the rate of the cameras.
    pub at_rate: RateConstants,
}

impl RigModel {
    /// The model of a checked rig.
    pub fn new(rig: &Rig) -> Self {
        Self::tuned(rig, &Tuning::default())
    }

    /// As [`RigModel::new`], with other constants.
    pub fn tuned(rig: &Rig, tuning: &Tuning) -> Self {
        let mut cameras = [const { None }; MAX_CAMERAS];
        for camera in rig.cameras() {
            let id = camera.id as usize;
            if id < MAX_CAMERAS {
                cameras[id] = Some(camera);
            }
        }
        let mut lines = [Lines::default(); MAX_CAMERAS];
        for sensor in rig.sensors() {
            if let Some(lines) = lines.get_mut(sensor.camera as usize) {
                let height_px = f64::from(sensor.size_px[1]);
                *lines = Lines { row_s: sensor.row_ns() * 1e-9, height_px };
            }
        }
        let at_rate = RateConstants::new(rig);
        let bodies = std::array::from_fn(|b| {
            let body = rig.body(BODY_NAMES[b]).expect("Rig::check has seen every body");
            let mut model = BodyModel::new(body, b == EYE, tuning, at_rate);
            let trocar = rig.trocar(BODY_NAMES[b]);
            model.trocar = trocar.map(|t| TrocarModel {
                position_in_eye: Point3::from(Vector3::from(t.p_eye)),
                sigma: t.sigma,
            });
            model
        });
        let distinct_colours = !share_colour(&bodies[0], &bodies[1]);
        let tip_radius = rig.workspace.tip_radius;
        RigModel { cameras, lines, bodies, tip_radius, distinct_colours, tuning: *tuning, at_rate }
    }
}

impl RigModel {
    /// True if a camera has a rolling shutter.
    pub fn rolls(&self) -> bool {
        self.lines.iter().any(|lines| !lines.is_global())
    }
}

/// True if two bodies have a colour in common.
fn share_colour(a: &BodyModel, b: &BodyModel) -> bool {
    a.markers.iter().any(|m| b.markers.iter().any(|n| n.colour == m.colour))
}

impl BodyModel {
    fn new(body: &RigBody, is_eye: bool, tuning: &Tuning, at_rate: RateConstants) -> Self {
        let markers: Vec<Marker> = body
            .markers
            .iter()
            .take(MAX_MARKERS)
            .map(|m| Marker {
                position: Point3::from(Vector3::from(m.p)),
                radius: m.r,
                colour: m.colour as u32,
                band: m.kind == MarkerKind::Band,
            })
            .collect();
        let turn = Singer { sigma: tuning.eye_acceleration_rad_s2, tau_s: tuning.eye_acceleration_tau_s };
        let start = [0.0, 0.0, k::START_EYE_TURN_RAD_S, turn.sigma];
        BodyModel {
            triples: triples(&markers),
            reach: markers.iter().map(|m| m.position.coords.norm()).fold(0.0, f64::max),
            markers,
            shaft_radius: body.shaft_r.filter(|_| !is_eye).unwrap_or(0.0),
            trocar: None,
            is_eye,
            motion: [Singer { sigma: 0.0, tau_s: turn.tau_s }, turn],
            start,
            tuning: *tuning,
            at_rate,
        }
    }

    /// True if a marker is far enough from the shaft to observe the roll.
    pub fn observes_roll(&self, marker: usize) -> bool {
        let beside = self.markers.get(marker).map_or(0.0, |m| m.position.coords.xy().norm());
        !self.is_eye && beside > k::ROLL_LEVER_MM
    }
}

/// All triples of markers whose triangle has a height over its longest side of at least 0.3 mm; the
/// roll of a flatter one is not determined.
fn triples(markers: &[Marker]) -> Vec<Triple> {
    let mut found = Vec::new();
    for i in 0..markers.len() {
        for j in i + 1..markers.len() {
            for l in j + 1..markers.len() {
                let p = [i, j, l].map(|m| markers[m].position);
                let distances = [(p[1] - p[0]).norm(), (p[2] - p[0]).norm(), (p[2] - p[1]).norm()];
                let doubled_area = (p[1] - p[0]).cross(&(p[2] - p[0])).norm();
                let longest = distances.into_iter().fold(0.0, f64::max);
                if doubled_area > 0.3 * longest {
                    found.push((doubled_area, Triple { markers: [i, j, l], distances }));
                }
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, triple)| triple).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_rig_has_poses_to_find() {
        let model = RigModel::new(&Rig::load_or_shipped(None).unwrap());
        assert_eq!(model.cameras.iter().flatten().count(), 3);
        assert!(model.distinct_colours);
        assert_eq!(model.bodies[0].triples.len(), 3, "three in a line and one beside it");
        assert_eq!(model.bodies[EYE].triples.len(), 20);
        assert!(model.bodies[0].trocar.is_some() && model.bodies[EYE].trocar.is_none());
    }
}
