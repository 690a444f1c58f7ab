//! The lines of a field in which a marker of a rig can appear.
//!
//! No marker comes below the region, wherever the instruments are in their workspace and however
//! the eye turns. The camera hardware holds its length in a register, set once from the rig, and
//! reads no line below: the blobs of a field leave when the region has passed, not at the end of
//! the field. A source of pixels need not send those lines.

use crate::camera::Camera;
use crate::{Rig, RigMarker};
use nalgebra::{Point3, Rotation3, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use std::f64::consts::{PI, TAU};

/// Largest turn of the mechanical eye about any axis, rad: its springs end there.
const MAX_TURN_RAD: f64 = 0.35;
/// Room for blur and for what lies between the points tried, field lines.
const MARGIN_LINES: f64 = 4.0;
/// Steps of the search around a circle; from pole to pole and from the centre outwards it takes
/// half.
const STEPS: usize = 24;

/// Lines from the top of a field of `camera` in which any marker of `rig` can appear: 1 to all.
pub fn lines(rig: &Rig, camera: &Camera) -> usize {
    let sensor = rig.sensor(camera.id);
    let (all, per_row) = (sensor.lines() as usize, f64::from(sensor.lines_per_row()));
    let mut lowest: f64 = 0.0;
    let mut look = |p: Point3<f64>, radius_mm: f64| {
        // Lines per mm at this distance, for the marker's own extent.
        let in_camera = camera.in_camera(&p);
        if in_camera.z > radius_mm {
            let radius_px = camera.focal_px.y * radius_mm / (in_camera.z - radius_mm);
            let y = camera.project(&p).map_or(0.0, |c| c.y + radius_px);
            lowest = lowest.max(y / per_row);
        }
    };
    for (i, name) in BODY_NAMES.iter().enumerate() {
        let markers = rig.body(name).map_or(&[][..], |b| &b.markers);
        if i < INSTRUMENTS {
            let trocar = rig.trocar(name).map(|t| Vector3::from(t.p_eye));
            let Some(trocar) = trocar else { return all };
            instrument(rig.workspace.tip_radius, trocar, markers, &mut look);
        } else {
            eye(markers, &mut look);
        }
    }
    ((lowest + MARGIN_LINES).ceil().max(1.0) as usize).min(all)
}

/// Points of the ball of unit radius: direction and distance.
fn ball() -> impl Iterator<Item = Vector3<f64>> {
    let half = STEPS / 2;
    (1..=half).flat_map(move |r| {
        (0..=half).flat_map(move |a| {
            (0..STEPS).map(move |b| {
                let (down, around) = (PI * a as f64 / half as f64, TAU * b as f64 / STEPS as f64);
                let (sin, cos) = (libm::sin(down), libm::cos(down));
                let unit = Vector3::new(sin * libm::cos(around), sin * libm::sin(around), cos);
                unit * (r as f64 / half as f64)
            })
        })
    })
}

/// The tip anywhere in its workspace, the shaft through the trocar, any roll. The eye's turn is in
/// it: it carries the trocar along, which turns shafts about the tip by less than the tip's own
/// room.
fn instrument(
    tip_radius: f64,
    trocar: Vector3<f64>,
    markers: &[RigMarker],
    look: &mut impl FnMut(Point3<f64>, f64),
) {
    let turns = [-MAX_TURN_RAD, 0.0, MAX_TURN_RAD];
    for tip in ball().map(|p| p * tip_radius) {
        for axis in [Vector3::x(), Vector3::y()] {
            for turn in turns {
                let trocar = Rotation3::new(axis * turn) * trocar;
                let Some(along) = (trocar - tip).try_normalize(1e-6) else { continue };
                for marker in markers {
                    let [x, y, z] = marker.p;
                    // The off-axis part can point anywhere across the shaft.
                    let aside = (x * x + y * y).sqrt();
                    look(Point3::from(tip + along * z), marker.r + aside);
                }
            }
        }
    }
}

/// The eye turned by as much as it can be.
fn eye(markers: &[RigMarker], look: &mut impl FnMut(Point3<f64>, f64)) {
    for turn in ball().map(|p| p * MAX_TURN_RAD) {
        let world_from_eye = Rotation3::new(turn);
        for marker in markers {
            look(world_from_eye * Point3::from(marker.p), marker.r);
        }
    }
}
