//! What a camera saw, ready for computation: blobs in pixels of the frame with their variances.

use crate::constants as k;
use crate::model::{Marker, RigModel};
use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, Point3, Unit, Vector2, Vector3};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, BlobField, DEFAULT_VARIANCE_PX2};
use protocol::camera::Camera;
use protocol::limits::MAX_BLOBS;

/// One blob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Centre in the frame, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the centre, px².
    pub covariance: Matrix2<f64>,
    /// Area, px of the field.
    pub area_px: f64,
    /// Width of its box, px.
    pub width_px: f64,
    /// Colour on the wire.
    pub colour: u32,
    /// Bits `BLOB_…`.
    pub flags: u32,
}

/// One camera-field.
#[derive(Debug, Clone)]
pub struct View {
    /// Camera id.
    pub camera: usize,
    /// Middle of the exposure; 0 where this camera has not spoken.
    pub exposed_ns: u64,
    /// Blobs.
    pub sights: [Sight; MAX_BLOBS],
    /// Blobs in use.
    pub count: usize,
    /// Bit per blob that a body took.
    pub taken: u64,
}

/// A 64-bit mask holds every blob of a field.
const _: () = assert!(MAX_BLOBS <= 64);

impl View {
    /// A camera that has not spoken.
    pub fn empty(camera: usize) -> Self {
        let sight = Sight {
            pixel: Vector2::zeros(),
            covariance: Matrix2::identity(),
            area_px: 0.0,
            width_px: 0.0,
            colour: 0,
            flags: 0,
        };
        View { camera, exposed_ns: 0, sights: [sight; MAX_BLOBS], count: 0, taken: 0 }
    }

    /// Takes a field over; blobs with numbers that make no sense or far outside of the frame are
    /// left away; returns how many.
    pub fn fill(&mut self, field: &BlobField, camera: &Camera) -> u32 {
        self.exposed_ns = field.exposed_ns;
        self.count = 0;
        self.taken = 0;
        for blob in field.blobs() {
            if let Some(sight) = sight_of(blob, field, camera) {
                self.sights[self.count] = sight;
                self.count += 1;
            }
        }
        field.blobs().len() as u32 - self.count as u32
    }

    /// The blobs.
    pub fn sights(&self) -> &[Sight] {
        &self.sights[..self.count]
    }

    /// True if no body took the blob.
    pub fn is_free(&self, blob: usize) -> bool {
        self.taken & (1 << blob) == 0
    }

    /// A body takes the blob.
    pub fn take(&mut self, blob: usize) {
        self.taken |= 1 << blob;
    }
}

/// Blobs may stand out of the frame by so much, px; their centre is then extrapolated.
const BORDER_PX: f64 = 8.0;

fn sight_of(blob: &Blob, field: &BlobField, camera: &Camera) -> Option<Sight> {
    let pixel = Vector2::new(blob.x_px, field.y_frame_px(blob));
    let [w, h] = camera.size_px.map(f64::from);
    let inside =
        (-BORDER_PX..w + BORDER_PX).contains(&pixel.x) && (-BORDER_PX..h + BORDER_PX).contains(&pixel.y);
    let sized = blob.area_px > 0.0 && blob.area_px.is_finite() && blob.width_px.is_finite();
    if !(inside && sized) {
        return None;
    }
    Some(Sight {
        pixel,
        covariance: covariance_of(blob),
        area_px: blob.area_px,
        width_px: blob.width_px,
        colour: blob.colour,
        flags: blob.flags,
    })
}

/// The stream's covariance within sane bounds, or the usual one where it tells none.
fn covariance_of(blob: &Blob) -> Matrix2<f64> {
    let told = [blob.var_x_px2, blob.var_y_px2, blob.cov_xy_px2];
    let (low, high) = k::VARIANCE_RANGE_PX2;
    if told == [DEFAULT_VARIANCE_PX2, DEFAULT_VARIANCE_PX2, 0.0] || !told.iter().all(|v| v.is_finite()) {
        let area = blob.area_px.clamp(k::SIGMA_AREA_PX.0, k::SIGMA_AREA_PX.1);
        return Matrix2::from_diagonal(&Vector2::new(k::SIGMA_X_PX, k::SIGMA_Y_PX).map(|s| s * s / area));
    }
    let (xx, yy) = (told[0].clamp(low, high), told[1].clamp(low, high));
    let limit = 0.95 * libm::sqrt(xx * yy);
    let xy = told[2].clamp(-limit, limit);
    Matrix2::new(xx, xy, xy, yy)
}

/// A marker as a camera should see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Image {
    /// Centre, px of the frame.
    pub pixel: Vector2<f64>,
    /// Jacobian of the centre by the point in the world, px/mm.
    pub jacobian: Matrix2x3<f64>,
    /// The seen centre in the world, mm.
    pub point: Point3<f64>,
    /// Radius across, px.
    pub radius_px: f64,
    /// Area, px of the field.
    pub area_px: f64,
}

/// Share of the radius by which the visible half of a band lies before the shaft's axis: the mean
/// of cos over a half circle seen from the side.
const BAND_SHIFT: f64 = std::f64::consts::FRAC_PI_4;

/// A point nearer than this cannot be in focus, mm.
const MIN_DEPTH_MM: f64 = 1.0;

/// A pose with its rotation as a matrix, for many points at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Rotation `world_from_body`.
    pub rotation: Matrix3<f64>,
    /// The body's origin in the world, mm.
    pub origin: Point3<f64>,
}

impl From<&Isometry3<f64>> for Placed {
    fn from(world_from_body: &Isometry3<f64>) -> Self {
        Placed {
            rotation: *world_from_body.rotation.to_rotation_matrix().matrix(),
            origin: Point3::from(world_from_body.translation.vector),
        }
    }
}

/// The image of a marker of a body that is `placed` in the world; `None` behind the camera.
pub fn image_of(marker: &Marker, placed: &Placed, camera: &Camera) -> Option<Image> {
    let mut point = placed.origin + placed.rotation * marker.position.coords;
    if marker.band {
        let axis: Vector3<f64> = placed.rotation.column(2).into();
        let towards = camera.centre_in_world() - point;
        let across = towards - axis * towards.dot(&axis);
        if let Some(across) = Unit::try_new(across, 1e-9) {
            point += across.into_inner() * (BAND_SHIFT * marker.radius);
        }
    }
    let p = camera.in_camera(&point);
    let depth = p.z;
    if depth <= MIN_DEPTH_MM {
        return None;
    }
    // Project and differentiate at once: the distortion is the dear part.
    let n = Vector2::new(p.x / depth, p.y / depth);
    let (distorted, slope) = camera.distort(n);
    let perspective = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / depth;
    let jacobian = Matrix2::from_diagonal(&camera.focal_px) * slope * perspective * camera.camera_from_world;
    let pixel = camera.focal_px.component_mul(&distorted) + camera.centre_px;
    let radii = camera.focal_px * (marker.radius / depth);
    Some(Image {
        pixel,
        jacobian,
        point,
        radius_px: radii.x,
        area_px: 0.5 * std::f64::consts::PI * radii.x * radii.y,
    })
}

/// True if a marker of a body that is `placed` in the world is in the picture of at least two of the
/// `cameras` (a set of ids).
pub fn seen_by_two(rig: &RigModel, marker: &Marker, placed: &Placed, cameras: u32) -> bool {
    let inside = |camera: &&Camera| {
        let [w, h] = camera.size_px.map(f64::from);
        let image = image_of(marker, placed, camera);
        image.is_some_and(|i| (0.0..w).contains(&i.pixel.x) && (0.0..h).contains(&i.pixel.y))
    };
    let asked = rig.cameras.iter().flatten().filter(|c| cameras & (1 << c.id) != 0);
    asked.filter(inside).count() >= 2
}

/// Covariance of a blob taken for a marker: the blob's own, and more where its size tells that it
/// is hidden in part or merged. `None` where it cannot be this marker.
pub fn covariance_as(
    sight: &Sight,
    image: &Image,
    area_scale: f64,
    ratio_range: (f64, f64),
) -> Option<Matrix2<f64>> {
    let ratio = sight.area_px / (image.area_px * area_scale);
    if ratio < ratio_range.0 || ratio > ratio_range.1 {
        return None;
    }
    let lost = (libm::log(ratio).abs() - k::AREA_TOLERANCE).max(0.0);
    let wide = sight.width_px / (2.0 * image.radius_px * libm::sqrt(area_scale)) - 1.0;
    let grown = (wide - 0.04 - 1.2 / sight.width_px.max(1.0)).max(0.0);
    let spoilt = f64::from(u8::from(sight.flags & (BLOB_MERGED | BLOB_CLIPPED) != 0));
    let shift = image.radius_px * (k::AREA_SHIFT * lost + grown + 0.5 * spoilt);
    Some(sight.covariance + Matrix2::identity() * (shift * shift))
}

/// True if a blob is not so doubtful, by its size, that it might be anywhere on its marker.
pub fn tells_place(covariance: &Matrix2<f64>) -> bool {
    covariance.trace() < 2.0 * k::ROLL_TOLD_PX * k::ROLL_TOLD_PX
}

/// The camera of a view.
pub fn camera_of<'a>(rig: &'a RigModel, view: &View) -> Option<&'a Camera> {
    rig.cameras[view.camera].as_ref()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protocol::rig::Rig;

    proptest! {
        #[test]
        fn images_agree_with_the_camera_model(p in prop::array::uniform3(-12.0..12.0f64)) {
            let rig = RigModel::new(&Rig::load_or_shipped(None).unwrap());
            let marker = Marker { position: Point3::origin(), radius: 0.5, colour: 1, band: false };
            for camera in rig.cameras.iter().flatten() {
                let point = Point3::from(Vector3::from(p));
                let placed = Placed { rotation: Matrix3::identity(), origin: point };
                let image = image_of(&marker, &placed, camera).unwrap();
                prop_assert!((image.pixel - camera.project(&point).unwrap()).norm() < 1e-9);
                prop_assert!((image.jacobian - camera.projection_jacobian(&point).unwrap()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn a_band_is_seen_before_its_axis() {
        let rig = RigModel::new(&Rig::load_or_shipped(None).unwrap());
        let camera = rig.cameras[0].as_ref().unwrap();
        let marker = Marker { position: Point3::new(0.0, 0.0, 2.0), radius: 0.4, colour: 1, band: true };
        let image = image_of(&marker, &Placed::from(&Isometry3::identity()), camera).unwrap();
        let before = image.point - Point3::new(0.0, 0.0, 2.0);
        assert!(before.z.abs() < 1e-12 && (before.norm() - 0.1 * std::f64::consts::PI).abs() < 1e-12);
        assert!(before.dot(&(camera.centre_in_world() - Point3::new(0.0, 0.0, 2.0))) > 0.0);
    }

    #[test]
    fn a_shrunk_or_grown_blob_is_doubted() {
        let image = Image {
            pixel: Vector2::zeros(),
            jacobian: Matrix2x3::zeros(),
            point: Point3::origin(),
            radius_px: 10.0,
            area_px: 170.0,
        };
        let mut sight = Sight {
            pixel: Vector2::zeros(),
            covariance: Matrix2::identity() * 0.0025,
            area_px: 170.0,
            width_px: 20.0,
            colour: 1,
            flags: 0,
        };
        let sigma =
            |sight: &Sight| covariance_as(sight, &image, 1.0, k::AREA_RATIO).map(|c| c[(0, 0)].sqrt());
        assert_eq!(sigma(&sight), Some(0.05));
        sight.area_px = 85.0;
        assert!(sigma(&sight).unwrap() > 2.0, "half hidden");
        sight.area_px = 600.0;
        assert_eq!(sigma(&sight), None, "another thing");
        (sight.area_px, sight.flags) = (170.0, BLOB_MERGED);
        assert!(sigma(&sight).unwrap() > 2.0, "two in one");
    }
}
