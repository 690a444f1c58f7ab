//! Whether the cameras of a rig agree: how far the blobs of one lie from the lines on which another
//! sees them (epipolar lines, Hartley and Zisserman, *Multiple View Geometry*, 2nd edition, 9.2).
//!
//! Needs no pose, so that it names the camera that was moved where nothing can be tracked any more.
//! One that was turned along the lines of another still agrees with that one; then none is named.

use nalgebra::Vector2;
use protocol::blobs::BlobField;
use rig::Rig;
use rig::camera::Camera;
use std::collections::BTreeMap;

/// Fields of two cameras further apart than this do not see the same instant, ns: a tip at 50 mm/s
/// moves by 0.05 mm, 1 px.
const SAME_INSTANT_NS: u64 = 1_000_000;
/// Share of the distances that lie below the one that counts: blobs that only one camera sees find
/// no partner, and lie anywhere.
const QUANTILE: f64 = 0.3;
/// Distances of a pair that are enough to judge it.
const ENOUGH: usize = 40;
/// Distances kept of a pair.
const KEPT: usize = 400;
/// Distance at which cameras disagree, px. Of a rig that holds it is 0.03, of one with a camera that
/// is off by a pixel 0.7.
const DISAGREE_PX: f64 = 0.3;

/// Compares the cameras of a rig.
#[derive(Debug)]
pub struct Agreement {
    cameras: BTreeMap<u32, Camera>,
    /// Half length of the piece of a line that is looked at, mm.
    reach_mm: f64,
    /// The newest field of each camera.
    newest: BTreeMap<u32, BlobField>,
    /// Distances by pair, px.
    distances: BTreeMap<(u32, u32), Vec<f64>>,
}

/// A camera that agrees with no other, while the others agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dissenter {
    /// Its id.
    pub camera: u32,
    /// How far its blobs lie from where the others see them, px.
    pub off_px: f64,
}

impl Agreement {
    /// Of the cameras of a rig.
    pub fn new(rig: &Rig) -> Self {
        Agreement {
            cameras: rig.cameras().into_iter().map(|c| (c.id, c)).collect(),
            reach_mm: 2.0 * rig.workspace.tip_radius,
            newest: BTreeMap::new(),
            distances: BTreeMap::new(),
        }
    }

    /// Takes a field.
    pub fn note(&mut self, field: &BlobField) {
        for (other_id, other) in &self.newest {
            let apart = field.exposed_ns.abs_diff(other.exposed_ns);
            let (Some(own), Some(its)) = (self.cameras.get(&field.camera), self.cameras.get(other_id)) else {
                continue;
            };
            if *other_id == field.camera || apart > SAME_INSTANT_NS {
                continue;
            }
            let pair = (field.camera.min(*other_id), field.camera.max(*other_id));
            let kept = self.distances.entry(pair).or_default();
            for blob in field.blobs() {
                let pixel = Vector2::new(blob.x_px, field.y_frame_px(blob));
                let same_colour = other.blobs().iter().filter(|b| b.colour == blob.colour);
                let line = Line::seen(own, pixel, its, self.reach_mm);
                let apart = same_colour
                    .map(|b| line.and_then(|l| l.distance(b.x_px, other.y_frame_px(b))).unwrap_or(f64::MAX));
                if let Some(nearest) = apart.min_by(f64::total_cmp).filter(|_| kept.len() < KEPT) {
                    kept.push(nearest);
                }
            }
        }
        self.newest.insert(field.camera, *field);
    }

    /// The distance that counts, px, of every pair that was seen often enough.
    pub fn pairs(&mut self) -> BTreeMap<(u32, u32), f64> {
        let judged = self.distances.iter_mut().filter(|(_, d)| d.len() >= ENOUGH);
        judged
            .map(|(pair, distances)| {
                distances.sort_by(f64::total_cmp);
                (*pair, distances[(distances.len() as f64 * QUANTILE) as usize])
            })
            .collect()
    }

    /// The camera that agrees with no other while two others agree. Then forgets what it has seen.
    pub fn judge(&mut self) -> Option<Dissenter> {
        let pairs = self.pairs();
        self.distances.clear();
        let agrees = |px: f64| px < DISAGREE_PX;
        let alone = |camera: u32| {
            let own = || pairs.iter().filter(move |((a, b), _)| *a == camera || *b == camera);
            let others = pairs.iter().any(|((a, b), px)| *a != camera && *b != camera && agrees(*px));
            (others && own().count() > 1 && own().all(|(_, px)| !agrees(*px)))
                .then(|| own().map(|(_, px)| *px).fold(f64::MAX, f64::min))
        };
        self.cameras.keys().find_map(|&camera| Some(Dissenter { camera, off_px: alone(camera)? }))
    }
}

/// The line on which a camera sees a ray, in its picture without distortion, px: with it the line
/// would be a curve.
#[derive(Debug, Clone, Copy)]
struct Line<'a> {
    camera: &'a Camera,
    from: Vector2<f64>,
    along: Vector2<f64>,
}

impl<'a> Line<'a> {
    /// What camera `to` sees of the ray through a pixel of camera `from`.
    fn seen(from: &Camera, pixel: Vector2<f64>, to: &'a Camera, reach_mm: f64) -> Option<Self> {
        let (centre, ray) = (from.centre_in_world(), from.ray_in_world(pixel)?);
        // The point of the ray that is nearest to the world's origin, which is the eye's centre.
        let nearest = -centre.coords.dot(&ray);
        let at = |along_mm: f64| {
            let p = to.in_camera(&(centre + ray * along_mm));
            (p.z > 1e-6).then(|| to.focal_px.component_mul(&Vector2::new(p.x / p.z, p.y / p.z)))
        };
        let (near, far) = (at(nearest - reach_mm)?, at(nearest + reach_mm)?);
        Some(Line { camera: to, from: near, along: (far - near).try_normalize(1e-9)? })
    }

    /// Distance of a pixel from it, px.
    fn distance(&self, x: f64, y: f64) -> Option<f64> {
        let n = self.camera.normalised_from_pixel(Vector2::new(x, y))?;
        let off = self.camera.focal_px.component_mul(&n) - self.from;
        Some((off.x * self.along.y - off.y * self.along.x).abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use nalgebra::Point3;
    use protocol::blobs::Blob;

    /// Fields of points of the workspace, as the rig's cameras see them; that of camera `moved` is
    /// shifted.
    fn seen(rig: &Rig, moved: u32, shift_px: [f64; 2]) -> Agreement {
        let mut agreement = Agreement::new(rig);
        for n in 0..40u32 {
            for camera in rig.cameras() {
                let mut field =
                    BlobField { camera: camera.id, exposed_ns: 1_000_000_000, ..BlobField::zeroed() };
                for k in 0..4u32 {
                    let angle = f64::from(n * 7 + k * 31);
                    let p =
                        Point3::new(8.0 * angle.sin(), 8.0 * (1.3 * angle).cos(), 6.0 * (0.7 * angle).sin());
                    let pixel = camera.project(&p).unwrap();
                    let [dx, dy] = if camera.id == moved { shift_px } else { [0.0; 2] };
                    let row = pixel.y + dy;
                    let mut blob = Blob { x_px: pixel.x + dx, colour: k + 1, ..Blob::zeroed() };
                    // Rows of the frame as rows of the field.
                    let at = |y| field.y_frame_px(&Blob { y_field_px: y, ..blob });
                    let (zero, one) = (at(0.0), at(1.0));
                    blob.y_field_px = (row - zero) / (one - zero);
                    field.push(blob);
                }
                agreement.note(&field);
            }
        }
        agreement
    }

    #[test]
    fn a_camera_that_was_moved_is_named_and_a_good_rig_is_not_blamed() {
        let rig = Rig::load_or_shipped(None).unwrap();
        assert_eq!(seen(&rig, 0, [0.0; 2]).judge(), None);
        assert!(seen(&rig, 0, [0.0; 2]).pairs().values().all(|px| *px < 0.01));
        for camera in rig.cameras() {
            let found = seen(&rig, camera.id, [2.0, 0.0]).judge().expect("a dissenter");
            assert!(found.camera == camera.id && found.off_px > 0.3, "{found:?}");
        }
    }
}
