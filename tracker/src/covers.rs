//! What lies before the markers in the picture of a camera: the shafts of other instruments, and nearer markers of another
//! colour.
//!
//! A marker that is hidden in part shows the centroid of the rest. Its area tells so only where a good part is gone: 2 %
//! of an area are within its noise, and shift the centroid by several standard deviations of a blob. The predicted
//! poses of all bodies show which markers are touched, and how deep.

use crate::associate::PredictedBody;
use crate::constants as k;
use crate::lines::BodyInField;
use crate::observation::BlobObservation;
use crate::projection::{MarkerImage, PoseMatrix, project_point};
use crate::rig_model::RigModel;
use nalgebra::Vector2;
use protocol::limits::{BODIES, MAX_MARKERS};
use rig::camera::Camera;

/// The markers of all predicted bodies in the picture of one camera-field, and what may hide them; its memory is reused.
#[derive(Debug, Default)]
pub struct Covers {
    shafts: Vec<Shaft>,
    discs: Vec<Disc>,
}

/// The part of a shaft that lies in the eye.
#[derive(Debug)]
struct Shaft {
    body: usize,
    tip: Vector2<f64>,
    along: Vector2<f64>,
    length: f64,
    /// Half widths at tip and end, px, and depths, mm.
    half: [f64; 2],
    depth: [f64; 2],
}

/// A marker.
#[derive(Debug)]
pub struct Disc {
    /// Its body.
    pub body: usize,
    /// Index of the marker.
    pub marker: usize,
    /// Its image.
    pub image: MarkerImage,
    /// Pose of the body when it is seen.
    pub pose: PoseMatrix,
    depth: f64,
    /// Its colour.
    pub colour: u32,
}

impl Covers {
    /// Nothing, with room for all bodies.
    pub fn with_capacity() -> Self {
        Covers { shafts: Vec::with_capacity(BODIES), discs: Vec::with_capacity(BODIES * MAX_MARKERS) }
    }

    /// Looks where the predicted bodies are `dt_s` seconds after the instant of the prediction.
    pub fn renew(
        &mut self,
        rig: &RigModel,
        camera: &Camera,
        predicted: &[Option<PredictedBody>; BODIES],
        dt_s: f64,
    ) {
        self.shafts.clear();
        self.discs.clear();
        for (body, predicted) in predicted.iter().enumerate() {
            let Some(predicted) = predicted else { continue };
            let placed = BodyInField::new(rig, camera.id as usize, &predicted.pose, &predicted.motion, dt_s);
            let model = &rig.bodies[body];
            for (marker, m) in model.markers.iter().enumerate() {
                let Some((image, pose)) = placed.image(m, camera) else { continue };
                let depth = camera.in_camera(&image.point).z;
                self.discs.push(Disc { body, marker, image, pose, depth, colour: m.colour });
            }
            if model.shaft_radius > 0.0 {
                self.shafts.extend(Shaft::new(body, model.shaft_radius, &placed, camera));
            }
        }
    }

    /// The markers of a body.
    pub fn markers(&self, body: usize) -> impl Iterator<Item = &Disc> {
        self.discs.iter().filter(move |d| d.body == body)
    }

    /// A marker of the same colour that is predicted to touch another, where the area of a blob is that of both together.
    pub fn partner(&self, of: &Disc, blob: &BlobObservation, area_scale: f64) -> Option<&Disc> {
        let (centre, radius) = (of.image.pixel, of.image.radius_px);
        let touches = |d: &&Disc| {
            let reach = k::TOUCHING * (d.image.radius_px + radius);
            d.colour == of.colour
                && (d.body, d.marker) != (of.body, of.marker)
                && (d.image.pixel - centre).norm_squared() < reach * reach
        };
        let is_both = |d: &&Disc| {
            let ratio = blob.area_px / ((d.image.area_px + of.image.area_px) * area_scale);
            libm::log(ratio).abs() < k::MERGED_AREA
        };
        self.discs.iter().filter(touches).find(is_both)
    }

    /// Share of a marker that is predicted to be hidden; 0 where nothing touches it.
    pub fn hidden_share(&self, of: &Disc) -> f64 {
        let (centre, radius) = (of.image.pixel, of.image.radius_px);
        let by_shafts = self.shafts.iter().filter(|s| s.body != of.body);
        let by_shafts = by_shafts.map(|s| s.depth_over(&centre, radius, of.depth));
        let by_discs = self.discs.iter().filter(|d| d.colour != of.colour && d.depth < of.depth);
        let by_discs = by_discs.map(|d| d.image.radius_px + radius - (d.image.pixel - centre).norm());
        let deepest = by_shafts.chain(by_discs).fold(0.0, f64::max);
        // What a straight edge cuts off at depth h (in radii) is 4√2/3π·h^1.5 of a disc.
        let depth = deepest / radius;
        (0.6 * depth * libm::sqrt(depth)).min(1.0)
    }
}

/// Standard deviation by which the blob of a marker may lie beside its centre, px, where a share of it is predicted to be
/// hidden: what is cut off lies near the rim. A blob without that loss of area is whole, and the prediction wrong.
pub fn shift_px(hidden: f64, blob: &BlobObservation, image: &MarkerImage, area_scale: f64) -> f64 {
    let lost = 1.0 - blob.area_px / (image.area_px * area_scale);
    let (share, tolerance) = k::COVERED_AREA;
    if lost < share * hidden - tolerance { 0.0 } else { image.radius_px * hidden.min(k::COVERED_SHIFT) }
}

impl Shaft {
    fn new(body: usize, radius: f64, placed: &BodyInField, camera: &Camera) -> Option<Self> {
        let pose = placed.pose_at(0.5 * f64::from(camera.size_px[1]));
        let end = pose.origin + pose.rotation.column(2) * k::SHAFT_IN_EYE_MM;
        let [tip, end] = [project_point(&pose.origin, camera)?, project_point(&end, camera)?];
        let between = end.pixel - tip.pixel;
        let depth = [tip.depth_mm, end.depth_mm];
        Some(Shaft {
            body,
            tip: tip.pixel,
            along: between.try_normalize(1e-6)?,
            length: between.norm(),
            half: depth.map(|depth| camera.focal_px.x * radius / depth),
            depth,
        })
    }

    /// How deep it reaches over a marker, px; not positive where it does not touch it or lies behind it.
    fn depth_over(&self, centre: &Vector2<f64>, radius: f64, depth: f64) -> f64 {
        let off = centre - self.tip;
        let along = off.dot(&self.along).clamp(0.0, self.length);
        let share = along / self.length;
        let mix = |[tip, end]: [f64; 2]| tip + (end - tip) * share;
        if mix(self.depth) >= depth {
            0.0
        } else {
            mix(self.half) + radius - (off - self.along * along).norm()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Matrix2x3, Point3};
    use proptest::prelude::*;

    /// A marker whose image is a circle of so many pixels about `pixel`.
    fn marker(pixel: Vector2<f64>, radius_px: f64, depth: f64, colour: u32) -> Disc {
        let point = Point3::origin();
        let image = MarkerImage { pixel, jacobian: Matrix2x3::zeros(), point, radius_px, area_px: 0.0 };
        let pose = PoseMatrix::from(&Isometry3::identity());
        Disc { body: 0, marker: 0, image, pose, depth, colour }
    }

    fn shaft(body: usize, tip: Vector2<f64>, angle: f64, half: f64, depth: f64) -> Shaft {
        let along = Vector2::new(libm::cos(angle), libm::sin(angle));
        Shaft { body, tip, along, length: 300.0, half: [half; 2], depth: [depth; 2] }
    }

    /// Distance of the centroid of what a cover leaves of a disc from its centre; `None` where nothing is left.
    fn shift_of_the_rest(radius: f64, hides: impl Fn(&Vector2<f64>) -> bool) -> Option<f64> {
        let (mut sum, mut seen) = (Vector2::zeros(), 0.0);
        for row in -60..=60 {
            for column in -60..=60 {
                let p = Vector2::new(f64::from(column), f64::from(row)) * (radius / 60.0);
                if p.norm() < radius && !hides(&p) {
                    (sum, seen) = (sum + p, seen + 1.0);
                }
            }
        }
        (seen > 200.0).then(|| (sum / seen).norm())
    }

    #[test]
    fn what_lies_behind_or_beside_or_is_its_own_hides_nothing() {
        let seen = marker(Vector2::new(300.0, 200.0), 8.0, 80.0, 1);
        let tip = Vector2::new(200.0, 203.0);
        let share = |shafts, discs| Covers { shafts, discs }.hidden_share(&seen);
        let disc = |colour, depth| vec![marker(Vector2::new(306.0, 200.0), 8.0, depth, colour)];
        assert!(share(vec![shaft(1, tip, 0.0, 3.0, 70.0)], vec![]) > 0.1);
        assert_eq!(share(vec![shaft(1, tip, 0.0, 3.0, 90.0)], vec![]), 0.0);
        assert_eq!(share(vec![shaft(0, tip, 0.0, 3.0, 70.0)], vec![]), 0.0);
        assert_eq!(share(vec![shaft(1, tip, 0.3, 3.0, 70.0)], vec![]), 0.0);
        assert!(share(vec![], disc(2, 70.0)) > 0.1);
        assert_eq!(share(vec![], disc(2, 90.0)), 0.0);
        assert_eq!(
            share(vec![], disc(1, 70.0)),
            0.0,
            "of one colour they are one blob, which its width shows"
        );
    }

    #[test]
    fn a_blob_of_two_that_touch_has_the_area_of_both_and_their_colour() {
        let at = |x: f64, colour, number| {
            let mut disc = marker(Vector2::new(300.0 + x, 200.0), 8.0, 80.0, colour);
            (disc.marker, disc.image.area_px) = (number, 100.0);
            disc
        };
        let (pixel, covariance) = (Vector2::new(308.0, 200.0), nalgebra::Matrix2::identity());
        let blob =
            |area_px| BlobObservation { pixel, covariance, area_px, width_px: 32.0, colour: 1, flags: 0 };
        let partner = |others: Vec<Disc>, area_px| {
            let of = at(0.0, 1, 0);
            let discs = others.into_iter().chain([at(0.0, 1, 0)]).collect();
            let covers = Covers { shafts: vec![], discs };
            covers.partner(&of, &blob(area_px), 1.1).map(|d| d.marker)
        };
        assert_eq!(partner(vec![at(17.0, 1, 3)], 2.2 * 101.0), Some(3));
        assert_eq!(partner(vec![at(17.0, 1, 3)], 1.1 * 100.0), None, "of one alone");
        assert_eq!(partner(vec![at(17.0, 2, 3)], 2.2 * 101.0), None, "of another colour");
        assert_eq!(partner(vec![at(19.0, 1, 3)], 2.2 * 101.0), None, "apart");
        assert_eq!(partner(vec![], 2.2 * 101.0), None, "not its own partner");
    }

    proptest! {
        #[test]
        fn what_remains_of_a_marker_lies_within_two_standard_deviations(
            offset in -14.0..14.0f64, half in 1.0..6.0f64, angle in 0.0..3.1f64, of_disc in any::<bool>(),
        ) {
            let (centre, radius) = (Vector2::new(300.0, 200.0), 8.0);
            let across = Vector2::new(-libm::sin(angle), libm::cos(angle));
            let along = Vector2::new(libm::cos(angle), libm::sin(angle));
            let at = across * offset;
            let mut covers = Covers::default();
            if of_disc {
                covers.discs.push(marker(centre + at, half, 70.0, 2));
            } else {
                covers.shafts.push(shaft(1, centre + at - along * 150.0, angle, half, 70.0));
            }
            let sigma = radius * covers.hidden_share(&marker(centre, radius, 80.0, 1)).min(k::COVERED_SHIFT);
            let hides = |p: &Vector2<f64>| {
                if of_disc { (p - at).norm() < half } else { (p - at).dot(&across).abs() < half }
            };
            let Some(shift) = shift_of_the_rest(radius, hides) else { return Ok(()) };
            // The sampled disc has an error of its own.
            prop_assert!(shift <= 2.0 * sigma + 0.01, "{} px, σ {}", shift, sigma);
        }
    }
}
