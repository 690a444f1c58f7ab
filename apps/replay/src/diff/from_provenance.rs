//! Causes that stand in the provenance of two recordings: what of the rig was moved, which key of the
//! scene or of the settings has another value, which version differs.

use super::causes::{Cause, Confidence, Finding};
use super::provenance::{KeyDifference, Part};
use super::side::Side;
use nalgebra::{Matrix3, Rotation3};
use rig::{Rig, RigBody, RigCamera};

/// Keys of the configuration that a result depends on, by their beginning.
const SETTINGS: &str = "tracker.";
/// Relative difference of factors that count as one scale.
const SAME_SCALE: f64 = 1e-6;

/// Every cause that the keys name.
pub fn findings(a: &Side, b: &Side, keys: &[KeyDifference]) -> Vec<Finding> {
    let of_rig: Vec<&KeyDifference> = keys.iter().filter(|key| key.part == Part::Rig).collect();
    let mut found = match (&a.rig, &b.rig) {
        _ if of_rig.is_empty() => Vec::new(),
        (Some(p), Some(q)) => rig_findings(p, q, &of_rig),
        _ => of_rig.iter().map(|key| key_changed(key)).collect(),
    };
    let settings = |key: &&KeyDifference| key.part == Part::Config && key.key.starts_with(SETTINGS);
    found.extend(keys.iter().filter(|key| key.part == Part::Scene).map(key_changed));
    found.extend(keys.iter().filter(settings).map(key_changed));
    found
}

/// Versions that differ, of the arithmetic of tracker or simulation.
pub fn version(keys: &[KeyDifference], program: &str) -> Option<Cause> {
    let key = keys.iter().find(|key| key.part == Part::Versions && key.key == program)?;
    let value =
        |v: &Option<serde_json::Value>| v.as_ref().and_then(|v| v.as_str()).unwrap_or("none").to_owned();
    Some(Cause::OtherVersion { program: program.into(), a: value(&key.a), b: value(&key.b) })
}

fn key_changed(key: &KeyDifference) -> Finding {
    let KeyDifference { part, key, a, b } = key.clone();
    let evidence = format!("{} of both recordings", part.name());
    Finding::new(Cause::KeyChanged { part, key, a, b }, Confidence::Certain, evidence)
}

fn certain(cause: Cause, evidence: &str) -> Finding {
    Finding::new(cause, Confidence::Certain, evidence)
}

/// What was done to a rig. Keys that no cause of geometry covers are named as they are.
fn rig_findings(a: &Rig, b: &Rig, keys: &[&KeyDifference]) -> Vec<Finding> {
    if let Some(factor) = scale(a, b) {
        return vec![certain(
            Cause::Scale { camera: None, factor },
            "every length of the rigs has this ratio",
        )];
    }
    let mut found = Vec::new();
    let mut named = Vec::new();
    if let Some(cameras) = swapped_cameras(a, b) {
        named.extend(cameras.map(|id| format!("cameras.{id}.")));
        found.push(certain(Cause::CamerasSwapped { cameras }, "each has the other's entry in the rig"));
    } else {
        a.cameras.iter().for_each(|camera| compare_camera(camera, b, &mut found, &mut named));
    }
    for (index, name) in protocol::poses::BODY_NAMES.iter().enumerate() {
        if let (Some(p), Some(q)) = (a.body(name), b.body(name)) {
            compare_body(index, p, q, &mut found, &mut named);
        }
    }
    let is_named = |key: &&&KeyDifference| named.iter().any(|prefix| key.key.starts_with(prefix.as_str()));
    found.extend(keys.iter().filter(|key| !is_named(key)).map(|key| key_changed(key)));
    found
}

/// The one ratio of all translations of cameras, which stand and see as before.
fn scale(a: &Rig, b: &Rig) -> Option<f64> {
    let mut ratios = Vec::new();
    for camera in &a.cameras {
        let other = b.cameras.iter().find(|c| c.id == camera.id)?;
        if other.rotation != camera.rotation || [other.fx, other.fy] != [camera.fx, camera.fy] {
            return None;
        }
        let length = |c: &RigCamera| c.model().translation_mm.norm();
        ratios.push(length(other) / length(camera));
        let off = (other.model().translation_mm - camera.model().translation_mm * ratios[0]).norm();
        if off > SAME_SCALE * length(camera) {
            return None;
        }
    }
    let factor = *ratios.first()?;
    ((factor - 1.0).abs() > SAME_SCALE).then_some(factor)
}

/// Two cameras of which each has the other's entry.
fn swapped_cameras(a: &Rig, b: &Rig) -> Option<[u32; 2]> {
    let of = |rig: &Rig, id: u32| {
        rig.cameras.iter().find(|c| c.id == id).map(|c| RigCamera { id: 0, ..c.clone() })
    };
    let changed: Vec<u32> = a.cameras.iter().map(|c| c.id).filter(|id| of(a, *id) != of(b, *id)).collect();
    let [one, other] = changed[..] else { return None };
    (of(a, one) == of(b, other) && of(a, other) == of(b, one)).then_some([one, other])
}

fn compare_camera(a: &RigCamera, b: &Rig, found: &mut Vec<Finding>, named: &mut Vec<String>) {
    let Some(b) = b.cameras.iter().find(|c| c.id == a.id) else {
        named.push(format!("cameras.{}.", a.id));
        let lost = Cause::CameraLost { camera: a.id, from_s: 0.0, lacking: 'B' };
        return found.push(certain(lost, "the second rig has no such camera"));
    };
    let (p, q) = (a.model(), b.model());
    if (a.rotation, a.t) != (b.rotation, b.t) {
        let turn = Rotation3::from_matrix_unchecked(q.camera_from_world * p.camera_from_world.transpose());
        let (turn_deg, shift_mm) = (angle_deg(&turn), (q.centre_in_world() - p.centre_in_world()).norm());
        named.extend(["R", "t"].map(|key| format!("cameras.{}.{key}", a.id)));
        let moved = Cause::CameraMoved { camera: a.id, turn_deg, shift_mm };
        found.push(certain(moved, "R and t of the camera in both rigs"));
    }
    if let Some(lens) = other_lens(a, b) {
        named.extend(["fx", "fy", "cx", "cy", "dist"].map(|key| format!("cameras.{}.{key}", a.id)));
        found.push(certain(lens, "fx, fy, cx, cy and dist of the camera in both rigs"));
    }
}

/// Another lens in the second rig; `None` where nothing differs, or only what the cause does not name: terms of the
/// distortion beyond the first.
fn other_lens(a: &RigCamera, b: &RigCamera) -> Option<Cause> {
    let values = |c: &RigCamera| [c.fx, c.fy, c.cx, c.cy, c.dist[0]];
    (values(a) != values(b)).then(|| Cause::Lens {
        camera: a.id,
        focal: 0.5 * (b.fx / a.fx + b.fy / a.fy),
        centre_px: [b.cx - a.cx, b.cy - a.cy],
        k1: b.dist[0] - a.dist[0],
    })
}

/// Angle of a rotation, degrees; exact also where it is small.
fn angle_deg(turn: &Rotation3<f64>) -> f64 {
    let m: &Matrix3<f64> = turn.matrix();
    let sine =
        nalgebra::Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]).norm();
    sine.atan2(m.trace() - 1.0).to_degrees()
}

fn compare_body(body: usize, a: &RigBody, b: &RigBody, found: &mut Vec<Finding>, named: &mut Vec<String>) {
    if a.markers.len() != b.markers.len() {
        return;
    }
    let places: Vec<usize> = (0..a.markers.len()).filter(|i| a.markers[*i].p != b.markers[*i].p).collect();
    let key = |i: usize, key: &str| format!("bodies.{}.markers.{}.{key}", a.name, a.markers[i].id);
    match places[..] {
        [i, j] if a.markers[i].p == b.markers[j].p && a.markers[j].p == b.markers[i].p => {
            named.extend([key(i, "p"), key(j, "p")]);
            let swapped = Cause::MarkersSwapped { body: protocol::poses::BODY_NAMES[body], markers: [i, j] };
            found.push(certain(swapped, "each has the other's place in the rig"));
        }
        _ => {
            for marker in places {
                named.push(key(marker, "p"));
                let by_mm = std::array::from_fn(|k| b.markers[marker].p[k] - a.markers[marker].p[k]);
                let moved = Cause::marker_moved(body, marker, by_mm);
                found.push(certain(moved, "place of the marker in both rigs"));
            }
        }
    }
    let colours: Vec<usize> =
        (0..a.markers.len()).filter(|i| a.markers[*i].colour != b.markers[*i].colour).collect();
    if let Some(first) = colours.first() {
        let pair = [a.markers[*first].colour, b.markers[*first].colour];
        let swapped = |i: &usize| {
            let own = [a.markers[*i].colour, b.markers[*i].colour];
            own == pair || own == [pair[1], pair[0]]
        };
        if colours.iter().all(swapped) {
            named.extend(colours.iter().map(|i| key(*i, "colour")));
            let colours = pair;
            let exchanged = Cause::ColoursSwapped { colours, cameras: Vec::new() };
            if !found.iter().any(|f| matches!(&f.cause, Cause::ColoursSwapped { colours: [x, y], .. } if [*y, *x] == colours || [*x, *y] == colours)) {
                found.push(certain(exchanged, "colours of the markers in both rigs"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::provenance::{KeyDifference, compare};
    use super::*;
    use recording::Provenance;

    fn changed(change: impl Fn(&mut Rig)) -> Vec<Cause> {
        let shipped = Rig::load_or_shipped(None).unwrap();
        let mut rig = shipped.clone();
        change(&mut rig);
        let side = |rig: &Rig| {
            let provenance = Provenance { rig_json: rig.to_json(), ..Provenance::default() };
            Side::of_provenance(provenance)
        };
        let (a, b) = (side(&shipped), side(&rig));
        let keys: Vec<KeyDifference> = compare(&a, &b);
        findings(&a, &b, &keys).into_iter().map(|finding| finding.cause).collect()
    }

    #[test]
    fn what_was_done_to_a_rig_is_named() {
        assert!(changed(|_| ()).is_empty());
        let turned = changed(|rig| {
            let turn = Rotation3::from_euler_angles(0.0, 0.4f64.to_radians(), 0.0);
            let camera = &mut rig.cameras[1];
            let (r, t) = (
                turn * Rotation3::from_matrix_unchecked(camera.model().camera_from_world),
                turn * camera.model().translation_mm,
            );
            camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]));
            camera.t = t.into();
        });
        let [Cause::CameraMoved { camera: 1, turn_deg, shift_mm }] = turned[..] else { panic!("{turned:?}") };
        assert!((turn_deg - 0.4).abs() < 1e-9 && shift_mm < 1e-9, "{turned:?}");
        let moved = changed(|rig| rig.bodies[0].markers[3].p[1] += 0.1);
        assert!(matches!(moved[..], [Cause::MarkerMoved { body: "inst0", marker: 3, .. }]), "{moved:?}");
        let swapped = changed(|rig| rig.cameras.iter_mut().for_each(|c| c.id = [2, 1, 0][c.id as usize]));
        assert_eq!(swapped, [Cause::CamerasSwapped { cameras: [0, 2] }]);
        let scaled = changed(|rig| {
            let lengths = rig.cameras.iter_mut().flat_map(|c| &mut c.t);
            lengths
                .chain(rig.bodies.iter_mut().flat_map(|b| b.markers.iter_mut().flat_map(|m| &mut m.p)))
                .for_each(|v| *v *= 1.01);
        });
        let [Cause::Scale { camera: None, factor }] = scaled[..] else { panic!("{scaled:?}") };
        assert!((factor - 1.01).abs() < 1e-9);
        let other = changed(|rig| rig.workspace.tip_radius += 1.0);
        assert!(
            matches!(&other[..], [Cause::KeyChanged { key, .. }] if key == "workspace.tip_radius"),
            "{other:?}"
        );
    }

    #[test]
    fn another_lens_is_one_cause_with_its_values() {
        let lens = changed(|rig| {
            let camera = &mut rig.cameras[2];
            (camera.fx, camera.fy, camera.cx) = (1.02 * camera.fx, 1.02 * camera.fy, camera.cx + 3.0);
            (camera.dist[0], camera.dist[1]) = (camera.dist[0] - 0.05, camera.dist[1] + 0.01);
        });
        let [Cause::Lens { camera: 2, focal, centre_px, k1 }] = lens[..] else { panic!("{lens:?}") };
        assert!((focal - 1.02).abs() < 1e-9 && (k1 + 0.05).abs() < 1e-9, "{lens:?}");
        assert_eq!(centre_px, [3.0, 0.0]);
        let said = "the lens of camera 2 is not that of the rig file: focal length +2.00 %, principal point +3.0, +0.0 px";
        assert!(lens[0].to_string().starts_with(said), "{}", lens[0]);
        let distorted = changed(|rig| rig.cameras[0].dist[1] += 0.01);
        assert!(
            matches!(&distorted[..], [Cause::KeyChanged { key, .. }] if key == "cameras.0.dist"),
            "{distorted:?}"
        );
    }
}
