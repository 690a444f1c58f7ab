//! What a rig file says of bodies, trocars and the eye and cannot be: lengths in another unit, a trocar on the side of
//! the cameras, keys of another kind of body.
//!
//! Ranges are wide, for large model eyes too, but a length in metres or micrometres is outside of every one.

use super::{BodyType, Defect, Rig, RigBody, RigMarker, Trocar};
use protocol::limits::MAX_MARKERS;
use protocol::poses::BODY_NAMES;

/// Radius of an eye, mm. That of an adult is 12.
const EYE_MM: Range = ([2.0, 100.0], "2 to 100 mm");
/// Radius of a shaft, mm. Of 23 to 27 gauge it is 0.32 to 0.2.
const SHAFT_MM: Range = ([0.05, 10.0], "0.05 to 10 mm");
/// From the tip of an instrument to its handle, mm.
const LENGTH_MM: Range = ([5.0, 1000.0], "5 to 1000 mm");
/// Radius of a marker, mm.
const MARKER_MM: Range = ([0.05, 20.0], "0.05 to 20 mm");
/// Play of a shaft in its trocar, mm; a calibration writes 0.001 at least.
const PLAY_MM: Range = ([0.001, 5.0], "0.001 to 5 mm");
/// Largest coordinate of a marker in its body's frame, mm.
const REACH_MM: f64 = 1e3;
/// Least radius of the opening and of the workspace, mm; at most they have that of the eye.
const LEAST_ROOM_MM: f64 = 1.0;
/// Largest distance of a trocar from the eye's centre, in radii of the eye. It is in the wall.
const FARTHEST_TROCAR: f64 = 2.0;

/// Least and largest value, and both in words.
type Range = ([f64; 2], &'static str);

/// A defect of `key` where its value is not in the range.
fn outside(key: String, value: f64, ([least, most], words): Range) -> Option<Defect> {
    (!(least..=most).contains(&value)).then(|| (key, words, value.to_string()))
}

impl Rig {
    /// What is wrong with the bodies, their trocars, and the room that they have.
    pub(super) fn defect_of_bodies(&self) -> Option<Defect> {
        let once = |name: &&str| self.bodies.iter().filter(|b| b.name == *name).count() == 1;
        if let Some(name) = BODY_NAMES.iter().find(|name| !once(name)) {
            let expected = "inst0, inst1 and eye, once each";
            return Some(("bodies".into(), expected, format!("{name} missing or repeated")));
        }
        if self.bodies.len() != BODY_NAMES.len() {
            let found = format!("{} bodies", self.bodies.len());
            return Some(("bodies".into(), "inst0, inst1 and eye", found));
        }
        let of_bodies = || self.bodies.iter().find_map(RigBody::defect);
        let of_trocars = || self.trocars.iter().enumerate().find_map(|(i, t)| self.defect_of_trocar(i, t));
        of_bodies().or_else(|| self.defect_of_room()).or_else(of_trocars)
    }

    /// Radius of the eye, mm; bodies are checked.
    fn eye_mm(&self) -> f64 {
        self.body("eye").and_then(|eye| eye.radius).unwrap_or(EYE_MM.0[1])
    }

    /// What is wrong with the opening and the workspace, which are within the eye.
    fn defect_of_room(&self) -> Option<Defect> {
        let (eye_mm, opening) = (self.eye_mm(), &self.eye_opening);
        let found = |mm: f64| format!("{mm}, where the eye has {eye_mm}");
        let radii =
            [("eye_opening.radius", opening.radius), ("workspace.tip_radius", self.workspace.tip_radius)];
        let wrong = radii.into_iter().find(|(_, mm)| !(LEAST_ROOM_MM..=eye_mm).contains(mm));
        if let Some((key, mm)) = wrong {
            return Some((key.into(), "1 mm to the radius of the eye", found(mm)));
        }
        let inside = opening.z.abs() < eye_mm;
        let expected = "mm, above or below the eye's centre by less than its radius";
        (!inside).then(|| ("eye_opening.z".into(), expected, found(opening.z)))
    }

    fn defect_of_trocar(&self, i: usize, trocar: &Trocar) -> Option<Defect> {
        let key = |of: &str| format!("trocars[{i}].{of}");
        if !trocar.body.starts_with("inst") || self.body(&trocar.body).is_none() {
            return Some((key("body"), "inst0 or inst1", trocar.body.clone()));
        }
        let [x, y, z] = trocar.p_eye;
        let (eye_mm, distance_mm) = (self.eye_mm(), x.hypot(y).hypot(z));
        let near = distance_mm <= FARTHEST_TROCAR * eye_mm;
        if !near {
            let found = format!("{distance_mm:.1} mm from the centre of an eye of radius {eye_mm}");
            return Some((key("p_eye"), "a point in the wall of the eye, mm", found));
        }
        if z <= self.eye_opening.z {
            let expected = "a point above the eye's opening: z points to the cornea, away from the cameras";
            return Some((
                key("p_eye"),
                expected,
                format!("z {z}, where the opening has {}", self.eye_opening.z),
            ));
        }
        outside(key("sigma"), trocar.sigma, PLAY_MM)
    }
}

impl RigBody {
    fn defect(&self) -> Option<Defect> {
        let key = |of: &str| format!("bodies.{}.{of}", self.name);
        let is_eye = self.kind == BodyType::Eye;
        if is_eye != (self.name == "eye") {
            let found = format!("{:?}", self.kind).to_lowercase();
            return Some((key("type"), "eye for the eye, instrument for the others", found));
        }
        if self.markers.len() < 3 || self.markers.len() > MAX_MARKERS {
            return Some((key("markers"), "3 to 16 markers", self.markers.len().to_string()));
        }
        let of_markers = (self.markers.iter().enumerate())
            .find_map(|(i, marker)| defect_of_marker(&key(&format!("markers[{i}]")), marker));
        let lengths = [
            ("shaft_r", self.shaft_r, !is_eye, SHAFT_MM),
            ("length", self.length, !is_eye, LENGTH_MM),
            ("radius", self.radius, is_eye, EYE_MM),
        ];
        let of_lengths = lengths.into_iter().find_map(|(of, value, has, range)| match (value, has) {
            (Some(value), true) => outside(key(of), value, range),
            (Some(value), false) => Some((key(of), "no such key of this kind of body", value.to_string())),
            (None, true) => Some((key(of), range.1, "nothing".into())),
            (None, false) => None,
        });
        of_markers.or(of_lengths).or_else(|| self.defect_of_shaft())
    }

    /// A marker of an instrument stands on its shaft: cameras see none on the handle, outside of the eye.
    fn defect_of_shaft(&self) -> Option<Defect> {
        let length = self.length?;
        let (i, marker) = self.markers.iter().enumerate().find(|(_, m)| m.p[2] > length)?;
        let found = format!("z {}, beyond the handle: the length of {} is {length}", marker.p[2], self.name);
        let key = format!("bodies.{}.markers[{i}].p", self.name);
        Some((key, "a place on the shaft, mm: z from the tip to at most the body's length", found))
    }
}

fn defect_of_marker(key: &str, marker: &RigMarker) -> Option<Defect> {
    let near = marker.p.iter().all(|c| c.abs() < REACH_MM);
    if !near {
        return Some((format!("{key}.p"), "mm, within 1000", format!("{:?}", marker.p)));
    }
    outside(format!("{key}.r"), marker.r, MARKER_MM)
}

#[cfg(test)]
mod tests {
    use crate::{Rig, RigError, SHIPPED};

    fn refused(change: impl FnOnce(&mut Rig)) -> (String, String) {
        let mut rig = Rig::parse(SHIPPED, "shipped").unwrap();
        change(&mut rig);
        match Rig::parse(&rig.to_json(), "r.json") {
            Err(RigError::Value { field, expected, found, .. }) => (field, format!("{expected}, {found}")),
            other => panic!("not refused: {other:?}"),
        }
    }

    /// Every length of a file, given in metres, in micrometres, or with the wrong sign.
    #[test]
    fn a_length_in_another_unit_is_refused_by_its_key() {
        type Length = (&'static str, fn(&mut Rig) -> &mut f64);
        let lengths: [Length; 8] = [
            ("bodies.inst0.shaft_r", |r| r.bodies[0].shaft_r.as_mut().unwrap()),
            ("bodies.inst1.length", |r| r.bodies[1].length.as_mut().unwrap()),
            ("bodies.eye.radius", |r| r.bodies[2].radius.as_mut().unwrap()),
            ("bodies.inst0.markers[2].r", |r| &mut r.bodies[0].markers[2].r),
            ("bodies.eye.markers[5].r", |r| &mut r.bodies[2].markers[5].r),
            ("trocars[1].sigma", |r| &mut r.trocars[1].sigma),
            ("eye_opening.radius", |r| &mut r.eye_opening.radius),
            ("workspace.tip_radius", |r| &mut r.workspace.tip_radius),
        ];
        for (key, of) in lengths {
            for factor in [1e-3, 1e3, -1.0, 0.0] {
                let (field, told) = refused(|rig| *of(rig) *= factor);
                assert_eq!(field, key, "times {factor}: {told}");
            }
        }
        assert_eq!(refused(|r| r.bodies[0].markers[1].p[2] = -1e3).0, "bodies.inst0.markers[1].p");
        let (field, told) = refused(|r| r.bodies[1].markers[2].p[2] = 61.0);
        assert!(field == "bodies.inst1.markers[2].p" && told.contains("beyond the handle"), "{field} {told}");
        assert!(told.ends_with("the length of inst1 is 60"), "{told}");
        assert_eq!(refused(|r| r.trocars[1].p_eye[2] *= 1e3).0, "trocars[1].p_eye");
        assert_eq!(refused(|r| r.eye_opening.z = 100.0).0, "eye_opening.z");
    }

    #[test]
    fn what_lies_on_the_wrong_side_or_is_of_another_body_is_refused() {
        let (field, told) = refused(|r| r.trocars[0].p_eye[2] *= -1.0);
        assert!(field == "trocars[0].p_eye" && told.contains("z points to the cornea"), "{field} {told}");
        assert_eq!(refused(|r| r.trocars[0].body = "eye".into()).0, "trocars[0].body");
        assert_eq!(refused(|r| r.bodies[2].shaft_r = Some(0.25)).0, "bodies.eye.shaft_r");
        assert_eq!(refused(|r| r.bodies[0].radius = Some(12.0)).0, "bodies.inst0.radius");
        let (field, told) = refused(|r| r.bodies[1].length = None);
        assert!(field == "bodies.inst1.length" && told == "5 to 1000 mm, nothing", "{field} {told}");
    }
}
