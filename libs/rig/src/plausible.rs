//! What a rig file says and cannot be: times that do not fit, another picture than the cameras', a lens that is none.
//!
//! Each is a mistake that would otherwise show only as poses that are wrong or missing. Where the cameras stand is not
//! looked at here: a calibration writes rigs whose world is a camera or a board, not the eye.

use super::{Defect, Rig, RigCamera};

/// The one rule of how a field's lines lie in the frame.
pub(super) const FIELD_RULE: &str = "y_frame = 2*y_field + parity";
/// Shortest exposure, ns: below it no marker is bright enough.
const SHORTEST_EXPOSURE_NS: u64 = 1_000;
/// Focal lengths in widths of the picture: from a view of 136 degrees to one of half a degree.
const FOCAL_WIDTHS: [f64; 2] = [0.2, 100.0];
/// Height of a pixel over its width, and its inverse, at most. Lines of PAL cameras give 1.09.
const PIXEL_RATIO: f64 = 4.0;

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

    /// The first lens that is none.
    pub(super) fn defect_of_lenses(&self) -> Option<Defect> {
        self.cameras.iter().enumerate().find_map(|(i, camera)| {
            let (what, expected, found) = camera.defect_of_lens()?;
            Some((format!("cameras[{i}].{what}"), expected, found))
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
    fn lenses_that_cannot_be_are_refused() {
        assert!(refused(|r| r.cameras[1].fx = 8.0).starts_with("cameras[1].fx"));
        assert!(refused(|r| r.cameras[1].fy = 9e3).starts_with("cameras[1].fy"));
        assert!(refused(|r| r.cameras[0].cx = -3.0).starts_with("cameras[0].cx"));
    }
}
