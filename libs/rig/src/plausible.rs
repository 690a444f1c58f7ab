//! What a rig file says and cannot be: times that do not fit, another picture than the cameras', a camera that
//! does not see the eye, metres in the place of millimetres.
//!
//! Each is a mistake that would otherwise show only as poses that are wrong or missing.

use super::{Defect, Rig, RigBody, RigCamera};
use nalgebra::Point3;

/// The one rule of how a field's lines lie in the frame.
pub(super) const FIELD_RULE: &str = "y_frame = 2*y_field + parity";
/// Shortest exposure, ns: below it no marker is bright enough.
const SHORTEST_EXPOSURE_NS: u64 = 1_000;
/// Focal lengths in widths of the picture: from a view of 136 degrees to one of half a degree.
const FOCAL_WIDTHS: [f64; 2] = [0.2, 100.0];
/// Height of a pixel over its width, and its inverse, at most. Lines of PAL cameras give 1.09.
const PIXEL_RATIO: f64 = 4.0;
/// Farthest camera, mm.
const FARTHEST_MM: f64 = 5_000.0;
/// Least angle between the views of the two cameras that are farthest apart, seen from the eye: below it they
/// give no depth, rad.
const LEAST_ANGLE_RAD: f64 = 0.17;
/// A body whose markers all lie nearer to its origin is in metres, mm.
const IN_METRES_MM: f64 = 0.5;

impl Rig {
    /// The first contradiction of times and sizes.
    pub(super) fn defect_of_fields(&self) -> Option<Defect> {
        if self.field_rule != FIELD_RULE {
            return Some(("field_rule".into(), "y_frame = 2*y_field + parity", self.field_rule.clone()));
        }
        let period = self.field_period_ns();
        let lines = u64::from(self.frame[1] / 2);
        let read_out = self.line_ns.saturating_mul(lines);
        if read_out > period {
            let found = format!("{lines} lines of {} ns in a period of {period} ns", self.line_ns);
            return Some(("line_ns".into(), "lines that are read out within the period of a field", found));
        }
        if !(SHORTEST_EXPOSURE_NS..=period).contains(&self.exposure_ns) {
            let found = format!("{} ns in a period of {period} ns", self.exposure_ns);
            return Some(("exposure_ns".into(), "at least 1000 ns and at most the period of a field", found));
        }
        let other = self.cameras.iter().position(|c| [c.width, c.height] != self.frame)?;
        let RigCamera { width, height, .. } = self.cameras[other];
        let [w, h] = self.frame;
        let found = format!("{width} × {height}, where frame says {w} × {h}");
        Some((
            format!("cameras[{other}].width, height"),
            "the size of frame, the same for all cameras",
            found,
        ))
    }

    /// The first camera that cannot see what it is there for.
    pub(super) fn defect_of_views(&self) -> Option<Defect> {
        for (i, camera) in self.cameras.iter().enumerate() {
            let named = |what: &str| format!("cameras[{i}].{what}");
            if let Some((what, expected, found)) = camera.defect_of_lens() {
                return Some((named(what), expected, found));
            }
            let model = camera.model();
            let mm = model.centre_in_world().coords.norm();
            if !(self.workspace.tip_radius..=FARTHEST_MM).contains(&mm) {
                let found = format!("{mm:.3} mm from the eye's centre");
                return Some((named("t"), "mm, from outside of the eye and at most 5 m away", found));
            }
            let seen = model.project(&Point3::origin());
            let inside =
                seen.is_some_and(|p| (0..2).all(|a| (0.0..f64::from(model.size_px[a])).contains(&p[a])));
            if !inside {
                let found =
                    seen.map_or("it behind the camera".into(), |p| format!("it at ({:.0}, {:.0})", p.x, p.y));
                return Some((named("R, t"), "the eye's centre (0, 0, 0) in the picture", found));
            }
        }
        let views: Vec<_> = self.cameras.iter().map(|c| c.model().centre_in_world().coords).collect();
        let pairs = views.iter().enumerate().flat_map(|(i, a)| views[..i].iter().map(|b| a.angle(b)));
        let widest = pairs.fold(0.0, f64::max);
        (widest < LEAST_ANGLE_RAD).then(|| {
            let found =
                format!("{:.1} degrees; R and t lead from the world to the camera", widest.to_degrees());
            ("cameras".into(), "views at least 10 degrees apart, else there is no depth", found)
        })
    }
}

impl RigCamera {
    fn defect_of_lens(&self) -> Option<(&'static str, &'static str, String)> {
        let width = f64::from(self.width);
        let [least, most] = FOCAL_WIDTHS.map(|n| n * width);
        if !(least..=most).contains(&self.fx) {
            return Some((
                "fx",
                "px, between a fifth of the picture's width and 100 of them",
                self.fx.to_string(),
            ));
        }
        let ratio = self.fy / self.fx;
        if !(1.0 / PIXEL_RATIO..=PIXEL_RATIO).contains(&ratio) {
            return Some(("fy", "px, between a quarter of fx and four of them", self.fy.to_string()));
        }
        let centre = [self.cx, self.cy];
        let size = [self.width, self.height].map(f64::from);
        let inside = (0..2).all(|a| (0.0..size[a]).contains(&centre[a]));
        (!inside).then(|| ("cx, cy", "px, within the picture", format!("{centre:?}")))
    }
}

impl RigBody {
    /// Markers that cannot be told apart or are in another unit.
    pub(super) fn defect_of_places(&self) -> Option<(&'static str, &'static str, String)> {
        let far = self.markers.iter().flat_map(|m| m.p).map(f64::abs).fold(0.0, f64::max);
        if far < IN_METRES_MM {
            return Some(("markers", "positions in mm", format!("all within {far} mm of the origin")));
        }
        let twin = |i: usize| self.markers[..i].iter().any(|other| other.p == self.markers[i].p);
        let marker = (0..self.markers.len()).find(|i| twin(*i))?;
        let found = format!("marker {} where another one is", self.markers[marker].id);
        Some(("markers", "places of their own", found))
    }
}

#[cfg(test)]
mod tests {
    use crate::{Rig, RigError, SHIPPED};

    fn refused(change: impl FnOnce(&mut Rig)) -> String {
        let mut rig = Rig::parse(SHIPPED, "shipped").unwrap();
        change(&mut rig);
        match Rig::parse(&rig.to_json(), "r.json") {
            Err(RigError::Value { field, expected, found, .. }) => format!("{field}: {expected}, {found}"),
            other => panic!("not refused: {other:?}"),
        }
    }

    #[test]
    fn times_that_do_not_fit_are_refused() {
        assert!(refused(|r| r.field_rule = "banana".into()).starts_with("field_rule"));
        assert!(refused(|r| r.field_hz = 200.0).starts_with("line_ns: lines that are read out"));
        assert!(refused(|r| r.line_ns = 1_000_000).contains("288 lines of 1000000 ns"));
        for ns in [0, 1_000_000_000] {
            assert!(refused(|r| r.exposure_ns = ns).starts_with("exposure_ns"), "{ns}");
        }
        assert!(refused(|r| r.frame = [640, 480]).starts_with("cameras[0].width"));
        assert!(refused(|r| r.cameras[2].height = 480).starts_with("cameras[2].width"));
    }

    #[test]
    fn cameras_that_cannot_see_the_eye_are_refused() {
        assert!(refused(|r| r.cameras[1].fx = 8.0).starts_with("cameras[1].fx"));
        assert!(refused(|r| r.cameras[1].fy = 9e3).starts_with("cameras[1].fy"));
        assert!(refused(|r| r.cameras[0].cx = -3.0).starts_with("cameras[0].cx"));
        let in_metres = refused(|r| r.cameras.iter_mut().for_each(|c| c.t = c.t.map(|t| t / 1000.0)));
        assert!(in_metres.starts_with("cameras[0].t: mm") && in_metres.contains("0.080 mm"), "{in_metres}");
        let aside = refused(|r| r.cameras[1].t[0] += 40.0);
        assert!(aside.starts_with("cameras[1].R, t") && aside.contains("it at ("), "{aside}");
        let behind = refused(|r| r.cameras[1].t[2] *= -1.0);
        assert!(behind.contains("behind the camera"), "{behind}");
    }

    #[test]
    fn rotations_that_are_transposed_are_refused() {
        let transposed = refused(|r| {
            for camera in &mut r.cameras {
                let rows = camera.rotation;
                camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| rows[j][i]));
            }
        });
        assert!(transposed.starts_with("cameras: views at least 10 degrees"), "{transposed}");
    }

    #[test]
    fn markers_in_metres_or_twice_in_one_place_are_refused() {
        let in_metres =
            refused(|r| r.bodies[0].markers.iter_mut().for_each(|m| m.p = m.p.map(|v| v / 1000.0)));
        assert!(in_metres.starts_with("bodies.inst0.markers: positions in mm"), "{in_metres}");
        let twins = refused(|r| r.bodies[1].markers[2].p = r.bodies[1].markers[0].p);
        assert!(twins.starts_with("bodies.inst1.markers: places of their own"), "{twins}");
    }
}
