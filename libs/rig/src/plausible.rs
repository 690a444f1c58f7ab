//! What a rig file says and cannot be: times that do not fit, another picture than the cameras', a lens that is none.
//!
//! Each is a mistake that would otherwise show only as poses that are wrong or missing. Where the cameras stand is not
//! looked at here: a calibration writes rigs whose world is a camera or a board, not the eye.

use super::sensor::{Scan, Sensor};
use super::{Defect, Rig, RigCamera};
use nalgebra::Vector2;
use protocol::blobs::Colour;

/// Fewest fields a second of a camera.
const SLOWEST_HZ: f64 = 25.0;
/// Shortest exposure, ns: below it no marker is bright enough.
const SHORTEST_EXPOSURE_NS: u64 = 1_000;
/// Longest line, ns: nothing that looks at a moving eye is slower.
const LONGEST_LINE_NS: u64 = 10_000_000;
/// Pixels that a sensor reads out in a nanosecond, at most: ten times the fastest that look at an eye. A line in
/// microseconds is shorter.
const PIXELS_PER_NS: u64 = 10;
/// Least and largest width and height of a frame, px.
const SIZES_PX: [[u32; 2]; 2] = [[16, 1920], [16, 1200]];
/// Focal lengths in widths of the picture: from a view of 136 degrees to one of half a degree.
const FOCAL_WIDTHS: [f64; 2] = [0.2, 100.0];
/// How far beyond the picture its principal point may lie, in widths and heights of it: lenses that were shifted or tilted, and
/// those of long focal lengths, whose principal point is hardly determined.
const SHIFTED: f64 = 1.0;
/// Where a lens may move a point of the picture to, in widths of the picture.
const BENT_WIDTHS: f64 = 0.5;
/// Steps from the middle of the picture to its border, in each of which a lens must not fold it.
const STEPS: u32 = 256;
/// Share of the way from the centre to the border within which a lens must not fold. Fitted lenses of good cameras do
/// beyond it, in the corners, where no picture of a board reached.
const FLAT: f64 = 0.8;
/// So much farther than a straight lens has the border, a barrel's may be.
const BARREL: f64 = 4.0;
/// Height of a pixel over its width, and its inverse, at most. Lines of PAL cameras give 1.09.
const PIXEL_RATIO: f64 = 4.0;

impl Rig {
    /// The first contradiction of times and sizes.
    pub(super) fn defect_of_fields(&self) -> Option<Defect> {
        let sensors = self.sensors();
        let of_each = (self.cameras.iter().zip(&sensors).enumerate()).find_map(|(i, (camera, sensor))| {
            let named = |key: &str, own: bool| if own { format!("cameras[{i}].{key}") } else { key.into() };
            self.defect_of_size(i, camera)
                .or_else(|| self.defect_of_rate(i, camera))
                .or_else(|| self.defect_of_times(camera, sensor, named))
                .or_else(|| defect_of_mosaic(camera, sensor, named))
        });
        self.defect_of_rule(&sensors).or(of_each).or_else(|| self.defect_of_frames())
    }

    /// The rule says again what `scan` says; for cameras that differ it cannot.
    fn defect_of_rule(&self, sensors: &[Sensor]) -> Option<Defect> {
        let (rule, field) = (self.field_rule.as_ref()?, "field_rule".to_owned());
        if ![Scan::Interlaced, Scan::Progressive].iter().any(|scan| scan.rule() == rule) {
            let expected =
                "\"y_frame = 2*y_field + parity\" (interlaced) or \"y_frame = y_field\" (progressive)";
            return Some((field, expected, rule.clone()));
        }
        let other = sensors.iter().find(|s| s.scan.rule() != rule)?;
        let found = format!("{rule}, where camera {} is {}", other.camera, other.scan.name());
        Some((field, "the rule of all cameras' scan, or none", found))
    }

    fn defect_of_size(&self, i: usize, camera: &RigCamera) -> Option<Defect> {
        let RigCamera { width, height, .. } = *camera;
        if let Some([w, h]) = self.frame.filter(|frame| *frame != [width, height]) {
            let found = format!("{width} × {height}, where frame says {w} × {h}");
            let expected = "the size given in frame, or no frame if the cameras differ";
            return Some((format!("cameras[{i}].width, height"), expected, found));
        }
        let fits = [width, height].iter().zip(SIZES_PX).all(|(n, [least, most])| (least..=most).contains(n));
        let found = format!("{width} × {height}");
        let expected = "a frame of 16 to 1920 × 16 to 1200 px";
        (!fits).then(|| (format!("cameras[{i}].width, height"), expected, found))
    }

    fn defect_of_rate(&self, i: usize, camera: &RigCamera) -> Option<Defect> {
        let hz = camera.field_hz.filter(|hz| !(SLOWEST_HZ..=self.field_hz).contains(hz))?;
        let expected = "25 to the rig's field_hz, which is the rate of its fastest camera";
        Some((
            format!("cameras[{i}].field_hz"),
            expected,
            format!("{hz}, where the rig has {}", self.field_hz),
        ))
    }

    /// Frames come at the rate of the fastest camera: one must have it.
    fn defect_of_frames(&self) -> Option<Defect> {
        let fastest = self.cameras.iter().map(|c| c.field_hz.unwrap_or(self.field_hz)).fold(0.0, f64::max);
        let expected = "the rate of the fastest camera, at which frames are tracked";
        let found = format!("{}, where the fastest camera has {fastest}", self.field_hz);
        (fastest < self.field_hz).then(|| ("field_hz".into(), expected, found))
    }

    fn defect_of_times(
        &self,
        camera: &RigCamera,
        sensor: &Sensor,
        named: impl Fn(&str, bool) -> String,
    ) -> Option<Defect> {
        let (period, line_ns) = (sensor.period_ns, sensor.line_ns);
        let key = || named("line_ns", camera.line_ns.is_some());
        if !(1..=LONGEST_LINE_NS).contains(&line_ns) {
            return Some((key(), "1 to 10000000 ns from line to line", line_ns.to_string()));
        }
        if line_ns < u64::from(camera.width).div_ceil(PIXELS_PER_NS) {
            let found = format!("{line_ns} ns for a line of {} px", camera.width);
            return Some((key(), "ns from line to line, at least 1 for 10 px of a line", found));
        }
        if sensor.lines_ns() > period {
            let found = format!("{} lines of {line_ns} ns in a period of {period} ns", sensor.lines());
            return Some((key(), "lines that are read out within the period of a field", found));
        }
        let fits = (SHORTEST_EXPOSURE_NS..=period).contains(&sensor.exposure_ns);
        let key = named("exposure_ns", camera.exposure_ns.is_some());
        let found = format!("{} ns in a period of {period} ns", sensor.exposure_ns);
        (!fits).then_some((key, "at least 1000 ns and at most the period of a field", found))
    }

    /// Without colours, coloured markers cannot be distinguished.
    pub(super) fn defect_of_colours(&self) -> Option<Defect> {
        let blind = self.sensors().into_iter().find(|s| !s.format.has_colour())?;
        let coloured = |body: &super::RigBody| {
            body.markers
                .iter()
                .find(|m| m.colour != Colour::White)
                .map(|m| (body.name.clone(), m.colour.name()))
        };
        let (body, colour) = self.bodies.iter().find_map(coloured)?;
        let found = format!("a {colour} marker on {body}, where camera {} gives Y8", blind.camera);
        Some(("bodies".into(), "white markers alone where a camera gives Y8, which has no colours", found))
    }

    /// The first lens that is none.
    pub(super) fn defect_of_lenses(&self) -> Option<Defect> {
        self.cameras.iter().enumerate().find_map(|(i, camera)| {
            let (what, expected, found) = camera.defect_of_lens()?;
            Some((format!("cameras[{i}].{what}"), expected, found))
        })
    }
}

/// A mosaic of filters needs whole frames and whole pairs of pixels.
fn defect_of_mosaic(
    camera: &RigCamera,
    sensor: &Sensor,
    named: impl Fn(&str, bool) -> String,
) -> Option<Defect> {
    sensor.format.first_red()?;
    let (key, name) = (named("pixel_format", camera.pixel_format.is_some()), sensor.format.name());
    if sensor.scan == Scan::Interlaced {
        let expected =
            "YUYV, Y8 or RGB8 of an interlaced camera: a mosaic needs all lines (scan progressive)";
        return Some((key, expected, name.into()));
    }
    let [w, h] = sensor.size_px;
    let odd = w % 2 + h % 2 > 0;
    odd.then(|| (key, "a mosaic on a frame of an even size", format!("{name} on {w} × {h}")))
}

impl RigCamera {
    fn defect_of_lens(&self) -> Option<(&'static str, &'static str, String)> {
        let width = f64::from(self.width);
        let [least, most] = FOCAL_WIDTHS.map(|n| n * width);
        if !(least..=most).contains(&self.fx) {
            return Some(("fx", "0.2 to 100 times the picture's width, in px", self.fx.to_string()));
        }
        let ratio = self.fy / self.fx;
        if !(1.0 / PIXEL_RATIO..=PIXEL_RATIO).contains(&ratio) {
            return Some(("fy", "px, between a quarter of fx and four of them", self.fy.to_string()));
        }
        let centre = [self.cx, self.cy];
        let size = [self.width, self.height].map(f64::from);
        let near = (0..2).all(|a| (-SHIFTED * size[a]..(1.0 + SHIFTED) * size[a]).contains(&centre[a]));
        if !near {
            let expected = "px, within the picture or beyond it by at most its width or height";
            return Some(("cx, cy", expected, format!("{centre:?}")));
        }
        self.defect_of_distortion().map(|(expected, found)| ("dist", expected, found))
    }

    /// What would be right and what is there, if the distortion moves points too far or folds the picture.
    pub fn defect_of_distortion(&self) -> Option<(&'static str, String)> {
        let bent_px = self.bent_px();
        if bent_px > BENT_WIDTHS * f64::from(self.width) {
            let expected = "k1, k2, p1, p2, k3 that move no point of the picture by more than half its width";
            return Some((expected, format!("{:?}, which move one by {bent_px:.0} px", self.dist)));
        }
        let [x, y] = self.fold()?;
        let expected = "k1, k2, p1, p2, k3 of a lens that does not fold the picture";
        let found = format!("{:?}, which show two directions at one pixel near ({x:.0}, {y:.0})", self.dist);
        Some((expected, found))
    }

    /// Corners and middles of the sides of the picture, px.
    fn border(&self) -> impl Iterator<Item = Vector2<f64>> {
        let size = [self.width, self.height].map(f64::from);
        let places = || [0.0, 0.5, 1.0].into_iter();
        places().flat_map(move |x| places().map(move |y| Vector2::new(x * size[0], y * size[1])))
    }

    /// Where in the picture the lens turns back, px: outwards from there, directions are shown a second time.
    fn fold(&self) -> Option<[f64; 2]> {
        let (camera, size) = (self.model(), [self.width, self.height].map(f64::from));
        let first = |pixel: Vector2<f64>| {
            let border = (pixel - camera.centre_px).component_div(&camera.focal_px);
            let mut was_inside = false;
            for step in 1..=STEPS {
                let (bent, slope) = camera.distort(border * (BARREL * f64::from(step) / f64::from(STEPS)));
                let at = camera.focal_px.component_mul(&bent) + camera.centre_px;
                // A principal point beyond the picture is outside of it at first.
                let inside = (0..2).all(|a| (0.0..=size[a]).contains(&at[a]));
                if was_inside && !inside {
                    return None;
                }
                was_inside |= inside;
                if slope.determinant() <= 0.0 {
                    let is_inside = (at - camera.centre_px).norm() < FLAT * (pixel - camera.centre_px).norm();
                    return is_inside.then_some([at.x, at.y]);
                }
            }
            None
        };
        self.border().find_map(first)
    }

    /// How far the distortion moves a corner or the middle of a side of the picture, px.
    fn bent_px(&self) -> f64 {
        let camera = self.model();
        let moved = |pixel: Vector2<f64>| {
            let straight = (pixel - camera.centre_px).component_div(&camera.focal_px);
            (camera.pixel_from_normalised(straight) - pixel).norm()
        };
        // Numbers beyond what can be added up are far away, too.
        self.border().map(moved).fold(0.0, |most, px| if px.is_nan() { f64::INFINITY } else { px.max(most) })
    }
}

#[cfg(test)]
mod tests {
    use crate::sensor::Scan;
    use crate::{Rig, RigError, SHIPPED};
    use protocol::blobs::Colour;
    use protocol::fields::PixelFormat;

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
        let banana = refused(|r| r.field_rule = Some("banana".into()));
        assert!(banana.starts_with("field_rule: \"y_frame = 2*y_field + parity\""), "{banana}");
        assert!(refused(|r| r.field_hz = 200.0).starts_with("line_ns: lines that are read out"));
        assert!(refused(|r| r.line_ns = 1_000_000).contains("288 lines of 1000000 ns"));
        assert!(refused(|r| r.line_ns = 0).starts_with("line_ns: 1 to"));
        let in_us = refused(|r| r.line_ns = 64);
        assert!(in_us.starts_with("line_ns: ns from line") && in_us.contains("720 px"), "{in_us}");
        for ns in [0, 999, 20_000_001, 1_000_000_000] {
            assert!(refused(|r| r.exposure_ns = ns).starts_with("exposure_ns"), "{ns}");
        }
        for hz in [24.0, 501.0, -50.0] {
            assert!(refused(|r| r.field_hz = hz).starts_with("field_hz: 25 to 500"), "{hz}");
        }
        let slow = refused(|r| r.cameras[1].line_ns = Some(70_000));
        assert!(slow.starts_with("cameras[1].line_ns: lines that are read out"), "{slow}");
        assert!(refused(|r| r.cameras[2].exposure_ns = Some(0)).starts_with("cameras[2].exposure_ns"));
        for hz in [24.0, 100.0, f64::MAX] {
            let other = refused(|r| r.cameras[2].field_hz = Some(hz));
            assert!(other.starts_with("cameras[2].field_hz") && other.contains("fastest camera"), "{other}");
        }
        let none = refused(|r| r.cameras.iter_mut().for_each(|c| c.field_hz = Some(25.0)));
        assert!(none.starts_with("field_hz: the rate of the fastest") && none.ends_with("has 25"), "{none}");
        let slower = refused(|r| {
            (r.cameras[2].field_hz, r.cameras[2].line_ns) = (Some(25.0), Some(140_000));
        });
        assert!(slower.starts_with("cameras[2].line_ns") && slower.contains("40000000 ns"), "{slower}");
    }

    #[test]
    fn whole_frames_take_twice_the_time_of_fields() {
        let whole = refused(|r| (r.scan, r.field_rule) = (Scan::Progressive, None));
        assert!(whole.contains("576 lines of 64000 ns"), "{whole}");
        let rule = refused(|r| (r.scan, r.line_ns) = (Scan::Progressive, 30_000));
        assert!(rule.starts_with("field_rule") && rule.contains("camera 0 is progressive"), "{rule}");
        let one = refused(|r| (r.cameras[1].scan, r.line_ns) = (Some(Scan::Progressive), 30_000));
        assert!(one.contains("camera 1 is progressive"), "{one}");
    }

    #[test]
    fn other_sizes_than_the_rigs_are_refused() {
        assert!(refused(|r| r.frame = Some([640, 480])).starts_with("cameras[0].width"));
        assert!(refused(|r| r.cameras[2].height = 480).starts_with("cameras[2].width"));
        for [w, h] in [[1922, 576], [720, 1202], [8, 576], [720, 15]] {
            let found = refused(|r| {
                r.frame = None;
                (r.cameras[1].width, r.cameras[1].height) = (w, h);
            });
            assert!(found.starts_with("cameras[1].width, height: a frame of 16 to 1920"), "{found}");
        }
    }

    #[test]
    fn formats_that_cannot_be_are_refused() {
        let grey = refused(|r| r.cameras[1].pixel_format = Some(PixelFormat::Y8));
        assert!(grey.contains("a red marker on inst0, where camera 1 gives Y8"), "{grey}");
        let mosaic = refused(|r| r.pixel_format = PixelFormat::BayerRg8);
        assert!(mosaic.starts_with("pixel_format: YUYV, Y8 or RGB8"), "{mosaic}");
        let odd = refused(|r| {
            (r.scan, r.field_rule, r.frame, r.line_ns) = (Scan::Progressive, None, None, 30_000);
            (r.cameras[2].height, r.cameras[2].pixel_format) = (575, Some(PixelFormat::BayerGb8));
        });
        assert!(odd.starts_with("cameras[2].pixel_format") && odd.contains("720 × 575"), "{odd}");
        let mut rig = Rig::parse(SHIPPED, "shipped").unwrap();
        rig.pixel_format = PixelFormat::Y8;
        rig.bodies.iter_mut().flat_map(|b| &mut b.markers).for_each(|m| m.colour = Colour::White);
        assert!(Rig::parse(&rig.to_json(), "white").is_ok());
    }

    #[test]
    fn words_that_are_unknown_are_refused_with_those_that_are_known() {
        for (from, to, named) in [
            ("\"line_ns\": 64000", "\"line_ns\": 64000, \"scan\": \"zigzag\"", "interlaced or progressive"),
            ("\"line_ns\": 64000", "\"line_ns\": 64000, \"shutter\": \"none\"", "global or rolling"),
            ("\"line_ns\": 64000", "\"line_ns\": 64000, \"pixel_format\": \"Bayer8\"", "BayerGB8"),
            (
                "\"fy\": 1748.148148148148",
                "\"fy\": 1748.148148148148, \"pixel_format\": \"NV12\"",
                "BayerRG8",
            ),
            ("\"fy\": 1748.148148148148", "\"fy\": 1748.148148148148, \"gain\": 3", "gain"),
        ] {
            let text = SHIPPED.replacen(from, to, 1);
            assert_ne!(text, SHIPPED, "{from}");
            let told = Rig::parse(&text, "r.json").unwrap_err().to_string();
            assert!(told.contains("r.json") && told.contains(named), "{told}");
        }
    }

    #[test]
    fn rotations_that_are_none_are_refused() {
        let scaled = refused(|r| r.cameras[1].rotation[0] = r.cameras[1].rotation[0].map(|v| 1.1 * v));
        assert!(scaled.starts_with("cameras[1].R: a rotation matrix"), "{scaled}");
        let mirrored = refused(|r| r.cameras[1].rotation[2] = r.cameras[1].rotation[2].map(|v| -v));
        assert!(mirrored.contains("right-handed") && mirrored.contains("mirrored"), "{mirrored}");
    }

    #[test]
    fn principal_points_beyond_the_picture_are_right() {
        let mut rig = Rig::parse(SHIPPED, "shipped").unwrap();
        for (cx, cy) in [(-316.0, 613.0), (1423.4, 760.3), (-700.0, -500.0)] {
            (rig.cameras[1].fx, rig.cameras[1].fy, rig.cameras[1].dist) =
                (6600.0, 6600.0, [-0.25, 0.1, 0.0, 0.0, 0.0]);
            (rig.cameras[1].cx, rig.cameras[1].cy) = (cx, cy);
            Rig::parse(&rig.to_json(), "shifted").unwrap();
        }
        // A lens that folds the picture is one from beyond it, too.
        let folded = refused(|r| {
            (r.cameras[1].cx, r.cameras[1].dist) = (-400.0, [-2.0, 0.0, 0.0, 0.0, 0.0]);
        });
        assert!(folded.starts_with("cameras[1].dist"), "{folded}");
    }

    #[test]
    fn lenses_that_cannot_be_are_refused() {
        assert!(refused(|r| r.cameras[1].fx = 8.0).starts_with("cameras[1].fx"));
        assert!(refused(|r| r.cameras[1].fy = 9e3).starts_with("cameras[1].fy"));
        for (cx, cy) in [(-721.0, 280.0), (1441.0, 280.0), (360.0, -577.0), (360.0, 1153.0)] {
            let far = refused(|r| (r.cameras[0].cx, r.cameras[0].cy) = (cx, cy));
            assert!(far.starts_with("cameras[0].cx"), "{far}");
        }
        assert!(refused(|r| r.cameras[2].fx = -1600.0).starts_with("cameras[2].fx"));
        for (term, value) in [(0, 50.0), (1, -200.0), (2, 5.0), (3, -5.0), (4, 1e300)] {
            let bent = refused(|r| r.cameras[1].dist[term] = value);
            assert!(bent.starts_with("cameras[1].dist: k1, k2, p1, p2, k3"), "{term}: {bent}");
        }
        // Moves no corner by half a width, but is at its farthest within the picture.
        let folded = refused(|r| r.cameras[1].dist = [-5.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(
            folded.contains("does not fold the picture, [-5.0, 0.0, 0.0, 0.0, 0.0], which show two"),
            "{folded}"
        );
    }
}
