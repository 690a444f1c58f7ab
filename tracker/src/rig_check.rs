//! Checks a rig for defects that make tracking impossible.

use crate::rig_model::{Marker, RigModel};
use nalgebra::{Matrix3, Point3, Vector3};
use protocol::limits::BODIES;
use protocol::poses::{BODY_NAMES, EYE};
use rig::Rig;
use rig::camera::Camera;

/// Least angle between the views of the two cameras that are farthest apart, seen from the eye, degrees; below it
/// depth is not observable. Rotations that are all transposed bring all cameras to one place.
const LEAST_ANGLE_DEGREES: f64 = 10.0;
/// Farthest that a camera stands, mm: there a marker is smaller than a pixel even with a long lens.
pub const FARTHEST_CAMERA_MM: f64 = 10_000.0;
/// A body whose markers all lie nearer to its origin is in metres, mm.
const IN_METRES_MM: f64 = 0.5;
/// Least lever of the roll, mm: at 0.05 px of noise and 19 px/mm the roll has a standard deviation
/// of 30 mrad.
const SHORTEST_ROLL_LEVER_MM: f64 = 0.1;
/// Least distance of two markers of one body, mm.
const CLOSEST_MARKERS_MM: f64 = 0.05;

/// A defect of a rig.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigDefect {
    /// A camera does not see the workspace.
    #[error(
        "camera {camera} sees nothing: no point of the workspace of radius {radius_mm} mm about the eye's centre is in its picture"
    )]
    Blind {
        /// Camera id.
        camera: u32,
        /// Radius of the workspace.
        radius_mm: f64,
    },
    /// A camera is where only tips are.
    #[error(
        "camera {camera} is {distance_mm:.2} mm from the eye's centre, inside the workspace of tips: t is in mm, and \
         leads from the world to the camera"
    )]
    CameraInside {
        /// Camera id.
        camera: u32,
        /// From the eye's centre.
        distance_mm: f64,
    },
    /// A camera is farther away than any that sees markers.
    #[error(
        "camera {camera} is {distance_mm:.0} mm from the eye's centre, at most {FARTHEST_CAMERA_MM} are expected: t is in \
         mm, and leads from the world to the camera"
    )]
    CameraFar {
        /// Camera id.
        camera: u32,
        /// From the eye's centre.
        distance_mm: f64,
    },
    /// Two cameras have one pose.
    #[error("cameras {first} and {second} have the same R and t: two cameras cannot be in one place")]
    CameraTwice {
        /// Camera id of one.
        first: u32,
        /// Camera id of the other.
        second: u32,
    },
    /// All cameras look from the same side.
    #[error(
        "all cameras look from the same side, within {degrees:.1} degrees: depth cannot be measured. R is \
         the rotation from \
         the world to the camera, by rows"
    )]
    OneView {
        /// Between the two that are farthest apart.
        degrees: f64,
    },
    /// The markers of a body are in metres.
    #[error(
        "all markers of {body} are within {reach_mm} mm of its origin: expected positions in mm, these look like metres"
    )]
    InMetres {
        /// Name of the body.
        body: &'static str,
        /// Largest coordinate.
        reach_mm: f64,
    },
    /// The markers of a body are collinear.
    #[error(
        "the markers of {body} lie in a line (within {lever_mm:.3} mm): its rotation about that line, the \
         roll, is not determined; \
         at least one marker must stand {SHORTEST_ROLL_LEVER_MM} mm off"
    )]
    Collinear {
        /// Name of the body.
        body: &'static str,
        /// Distance of the farthest marker from the line.
        lever_mm: f64,
    },
    /// Two markers of a body have the same id.
    #[error("{body} has two markers with id {id}")]
    MarkerTwice {
        /// Name of the body.
        body: &'static str,
        /// The id.
        id: u32,
    },
    /// Two markers of a body have the same position.
    #[error("markers {first} and {second} of {body} are in one place: they cannot be distinguished")]
    SamePlace {
        /// Name of the body.
        body: &'static str,
        /// Index of one.
        first: usize,
        /// Index of the other.
        second: usize,
    },
    /// A body has several trocars.
    #[error("{body} has {count} trocars; a shaft passes one")]
    TrocarTwice {
        /// Name of the body.
        body: &'static str,
        /// How many.
        count: usize,
    },
    /// A trocar is inside of the eye.
    #[error(
        "the trocar of {body} is {distance_mm:.2} mm from the eye's centre, inside the workspace of tips: no shaft can pass it"
    )]
    TrocarInside {
        /// Name of the body.
        body: &'static str,
        /// From the eye's centre.
        distance_mm: f64,
    },
}

/// Checks a rig.
///
/// # Errors
/// The first defect found.
pub fn check(rig: &Rig) -> Result<(), RigDefect> {
    let model = RigModel::new(rig);
    check_cameras(rig, &model)?;
    for body in 0..BODIES {
        check_markers(rig, &model, body)?;
        check_trocar(rig, body)?;
    }
    Ok(())
}

fn check_cameras(rig: &Rig, model: &RigModel) -> Result<(), RigDefect> {
    let radius_mm = rig.workspace.tip_radius;
    let cameras = || model.cameras.iter().flatten();
    for camera in cameras() {
        let distance_mm = camera.centre_in_world().coords.norm();
        if distance_mm <= radius_mm {
            return Err(RigDefect::CameraInside { camera: camera.id, distance_mm });
        }
        if distance_mm > FARTHEST_CAMERA_MM {
            return Err(RigDefect::CameraFar { camera: camera.id, distance_mm });
        }
        if !sees_workspace(camera, radius_mm) {
            return Err(RigDefect::Blind { camera: camera.id, radius_mm });
        }
    }
    let degrees = |a: &Camera, b: &Camera| {
        let [a, b] = [a, b].map(|camera| camera.centre_in_world().coords);
        let cosine = a.dot(&b) / (a.norm() * b.norm());
        libm::acos(cosine.clamp(-1.0, 1.0)).to_degrees()
    };
    let widest = cameras().flat_map(|a| cameras().map(move |b| degrees(a, b))).fold(0.0, f64::max);
    if widest < LEAST_ANGLE_DEGREES {
        return Err(RigDefect::OneView { degrees: widest });
    }
    for (i, second) in cameras().enumerate() {
        if let Some(first) = cameras().take(i).find(|first| is_in_place_of(first, second)) {
            return Err(RigDefect::CameraTwice { first: first.id, second: second.id });
        }
    }
    Ok(())
}

/// True of a camera that was copied: calibrated poses differ in some digit.
fn is_in_place_of(a: &Camera, b: &Camera) -> bool {
    a.camera_from_world == b.camera_from_world && a.translation_mm == b.translation_mm
}

/// True if any point of a grid through the workspace is in the frame.
fn sees_workspace(camera: &Camera, radius_mm: f64) -> bool {
    let steps = || (-2..=2).map(|i| f64::from(i) * 0.5 * radius_mm);
    let [w, h] = camera.size_px.map(f64::from);
    let mut points = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| (x, y, z))));
    points.any(|(x, y, z)| {
        let pixel = camera.project(&Point3::new(x, y, z));
        pixel.is_some_and(|p| (0.0..w).contains(&p.x) && (0.0..h).contains(&p.y))
    })
}

fn check_markers(rig: &Rig, model: &RigModel, body: usize) -> Result<(), RigDefect> {
    let name = BODY_NAMES[body];
    let markers = &model.bodies[body].markers;
    let ids: Vec<u32> = rig.body(name).map(|b| b.markers.iter().map(|m| m.id).collect()).unwrap_or_default();
    if let Some((_, id)) = ids.iter().enumerate().find(|(i, id)| ids[..*i].contains(id)) {
        return Err(RigDefect::MarkerTwice { body: name, id: *id });
    }
    let reach_mm = markers.iter().map(|m| m.position.coords.amax()).fold(0.0, f64::max);
    if reach_mm < IN_METRES_MM {
        return Err(RigDefect::InMetres { body: name, reach_mm });
    }
    for (second, m) in markers.iter().enumerate() {
        let same = |o: &Marker| (o.position - m.position).norm() < CLOSEST_MARKERS_MM;
        if let Some(first) = markers[..second].iter().position(same) {
            return Err(RigDefect::SamePlace { body: name, first, second });
        }
    }
    let lever_mm = roll_lever(markers.iter().map(|m| m.position));
    if lever_mm < SHORTEST_ROLL_LEVER_MM {
        return Err(RigDefect::Collinear { body: name, lever_mm });
    }
    Ok(())
}

/// Root of the sum of squared distances from the best line: the scatter without its largest
/// eigenvalue.
fn roll_lever(points: impl Iterator<Item = Point3<f64>> + Clone) -> f64 {
    let count = points.clone().count() as f64;
    let centre = points.clone().fold(Vector3::zeros(), |sum, p| sum + p.coords) / count;
    let scatter = points.fold(Matrix3::zeros(), |sum: Matrix3<f64>, p| {
        let d = p.coords - centre;
        sum + d * d.transpose()
    });
    let along = scatter.symmetric_eigenvalues();
    libm::sqrt((scatter.trace() - along.max()).max(0.0))
}

fn check_trocar(rig: &Rig, body: usize) -> Result<(), RigDefect> {
    let name = BODY_NAMES[body];
    let count = rig.trocars.iter().filter(|t| t.body == name).count();
    if count > 1 {
        return Err(RigDefect::TrocarTwice { body: name, count });
    }
    if let Some(trocar) = rig.trocar(name).filter(|_| body != EYE) {
        let distance_mm = Vector3::from(trocar.p_eye).norm();
        if distance_mm < 0.5 * rig.workspace.tip_radius {
            return Err(RigDefect::TrocarInside { body: name, distance_mm });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn broken(change: impl FnOnce(&mut Rig)) -> String {
        let mut rig = Rig::load_or_shipped(None).unwrap();
        check(&rig).expect("the shipped rig works");
        change(&mut rig);
        check(&rig).unwrap_err().to_string()
    }

    #[test]
    fn every_defect_is_named() {
        let turned = broken(|rig| {
            for row in &mut rig.cameras[1].rotation[1..] {
                *row = row.map(|v| -v);
            }
            rig.cameras[1].t = rig.cameras[1].t.map(|v| -v);
        });
        assert!(turned.contains("camera 1 sees nothing"), "{turned}");
        let together = broken(|rig| {
            for i in 1..rig.cameras.len() {
                (rig.cameras[i].rotation, rig.cameras[i].t) = (rig.cameras[0].rotation, rig.cameras[0].t);
            }
        });
        assert!(together.contains("from the same side, within 0.0 degrees"), "{together}");
        let transposed = broken(|rig| {
            for camera in &mut rig.cameras {
                let rows = camera.rotation;
                camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| rows[j][i]));
            }
        });
        assert!(transposed.contains("from the same side"), "{transposed}");
        let in_metres = broken(|rig| rig.cameras.iter_mut().for_each(|c| c.t = c.t.map(|t| t / 1000.0)));
        assert!(in_metres.contains("camera 0 is 0.08 mm from"), "{in_metres}");
        let in_um = broken(|rig| rig.cameras[2].t = rig.cameras[2].t.map(|t| t * 1000.0));
        assert!(in_um.contains("camera 2 is 80000 mm from") && in_um.contains("t is in mm"), "{in_um}");
        let copied = broken(|rig| {
            let again = rig.cameras[1].clone();
            rig.cameras.push(rig::RigCamera { id: 3, ..again });
        });
        assert!(copied.contains("cameras 1 and 3 have the same R and t"), "{copied}");
        let small =
            broken(|rig| rig.bodies[0].markers.iter_mut().for_each(|m| m.p = m.p.map(|v| v / 1000.0)));
        assert!(small.contains("all markers of inst0 are within"), "{small}");
        let straight = broken(|rig| {
            for (i, marker) in rig.bodies[0].markers.iter_mut().enumerate() {
                marker.p = [0.0, 0.0, 1.0 + 2.0 * i as f64];
            }
        });
        assert!(straight.contains("inst0") && straight.contains("roll"), "{straight}");
        let twice = broken(|rig| rig.bodies[1].markers[2].id = rig.bodies[1].markers[0].id);
        assert!(twice.contains("inst1") && twice.contains("two markers with id"), "{twice}");
        let same = broken(|rig| rig.bodies[2].markers[3].p = rig.bodies[2].markers[1].p);
        assert!(same.contains("markers 1 and 3 of eye"), "{same}");
        let trocars = broken(|rig| rig.trocars.push(rig.trocars[0].clone()));
        assert!(trocars.contains("2 trocars"), "{trocars}");
        let inside = broken(|rig| rig.trocars[1].p_eye = [0.0, 0.1, 0.2]);
        assert!(inside.contains("trocar of inst1"), "{inside}");
    }
}
