//! Observations: the blobs of a camera-field in pixels of the frame, with their covariances.

use crate::checkpoint::{Done, Loader, Saver, require};
use crate::constants as k;
use crate::projection::MarkerImage;
use crate::rig_model::RigModel;
use crate::tuning::Tuning;
use nalgebra::{Matrix2, Vector2};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, BlobField, DEFAULT_VARIANCE_PX2};
use protocol::limits::MAX_BLOBS;
use rig::camera::Camera;

/// A blob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlobObservation {
    /// Centre in the frame, px.
    pub pixel: Vector2<f64>,
    /// Covariance of the centre, px².
    pub covariance: Matrix2<f64>,
    /// Area, px of a field of every second line.
    pub area_px: f64,
    /// Width of its box, px.
    pub width_px: f64,
    /// Colour, as in the message.
    pub colour: u32,
    /// Bits `BLOB_…`.
    pub flags: u32,
}

/// A camera-field.
#[derive(Debug, Clone)]
pub struct FieldObservation {
    /// Camera id.
    pub camera: usize,
    /// Middle of the exposure, ns; 0 before the first field of this camera.
    pub exposed_ns: u64,
    /// Blobs; the first `count` are valid.
    pub blobs: [BlobObservation; MAX_BLOBS],
    /// Number of valid blobs.
    pub count: usize,
    /// Set of the blobs assigned to a body.
    pub assigned: u64,
    /// Index of each valid blob in the message; only of the field that was taken over last.
    pub source: [u8; MAX_BLOBS],
}

/// A 64-bit mask holds every blob of a field.
const _: () = assert!(MAX_BLOBS <= 64);

impl FieldObservation {
    /// An observation without blobs, before the first field of a camera.
    pub fn empty(camera: usize) -> Self {
        let none = BlobObservation {
            pixel: Vector2::zeros(),
            covariance: Matrix2::identity(),
            area_px: 0.0,
            width_px: 0.0,
            colour: 0,
            flags: 0,
        };
        FieldObservation {
            camera,
            exposed_ns: 0,
            blobs: [none; MAX_BLOBS],
            count: 0,
            assigned: 0,
            source: [0; MAX_BLOBS],
        }
    }

    /// Takes over the blobs of a field. Returns how many were ignored: not finite, without size, or
    /// far outside of the frame.
    pub fn fill(&mut self, field: &BlobField, camera: &Camera, tuning: &Tuning) -> u32 {
        self.exposed_ns = field.exposed_ns;
        self.count = 0;
        self.assigned = 0;
        for (index, blob) in field.blobs().iter().enumerate() {
            if let Some(seen) = observe_blob(blob, field, camera, tuning) {
                self.blobs[self.count] = seen;
                self.source[self.count] = index as u8;
                self.count += 1;
            }
        }
        field.blobs().len() as u32 - self.count as u32
    }

    /// Writes the valid blobs.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let FieldObservation { camera: _, exposed_ns, blobs: _, count, assigned, source: _ } = self;
        out.put(&[*exposed_ns, *assigned, *count as u64])?;
        for BlobObservation { pixel, covariance, area_px, width_px, colour, flags } in self.blobs() {
            out.numbers(pixel.iter().chain(covariance).chain([area_px, width_px]))?;
            out.put(&[*colour, *flags])?;
        }
        Ok(())
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        self.exposed_ns = from.count()?;
        self.assigned = from.take()?;
        self.count = from.below(MAX_BLOBS as u64 + 1)? as usize;
        for blob in &mut self.blobs[..self.count] {
            let BlobObservation { pixel, covariance, area_px, width_px, colour, flags } = blob;
            from.numbers(pixel.iter_mut().chain(covariance).chain([&mut *area_px, width_px]))?;
            [*colour, *flags] = from.take()?;
            require(*area_px > 0.0, "a blob has no area")?;
        }
        Ok(())
    }

    /// The valid blobs.
    pub fn blobs(&self) -> &[BlobObservation] {
        &self.blobs[..self.count]
    }

    /// Index of each valid blob in the message, rising.
    pub fn sources(&self) -> &[u8] {
        &self.source[..self.count]
    }

    /// True if the blob is assigned to no body.
    pub fn is_unassigned(&self, blob: usize) -> bool {
        self.assigned & (1 << blob) == 0
    }

    /// Marks the blob as assigned to a body.
    pub fn assign(&mut self, blob: usize) {
        self.assigned |= 1 << blob;
    }
}

/// Largest distance of a blob from the frame, px; its centre is then extrapolated.
const BORDER_PX: f64 = 8.0;

fn observe_blob(blob: &Blob, field: &BlobField, camera: &Camera, tuning: &Tuning) -> Option<BlobObservation> {
    let pixel = Vector2::new(blob.x_px, field.y_frame_px(blob));
    let [w, h] = camera.size_px.map(f64::from);
    let inside =
        (-BORDER_PX..w + BORDER_PX).contains(&pixel.x) && (-BORDER_PX..h + BORDER_PX).contains(&pixel.y);
    // Sizes are those of a field of every second line, whatever the camera.
    let blob = &Blob { area_px: field.area_of_half_px(blob), ..*blob };
    let sized = blob.area_px > 0.0 && blob.area_px.is_finite() && blob.width_px.is_finite();
    if !(inside && sized) {
        return None;
    }
    Some(BlobObservation {
        pixel,
        covariance: covariance_of(blob, tuning),
        area_px: blob.area_px,
        width_px: blob.width_px,
        colour: blob.colour,
        flags: blob.flags,
    })
}

/// The stream's covariance, clamped; the default for the blob's area where the stream has none.
fn covariance_of(blob: &Blob, tuning: &Tuning) -> Matrix2<f64> {
    let given = [blob.var_x_px2, blob.var_y_px2, blob.cov_xy_px2];
    let (low, high) = k::VARIANCE_RANGE_PX2;
    if given == [DEFAULT_VARIANCE_PX2, DEFAULT_VARIANCE_PX2, 0.0] || !given.iter().all(|v| v.is_finite()) {
        let area = blob.area_px.clamp(k::SIGMA_AREA_PX.0, k::SIGMA_AREA_PX.1);
        return Matrix2::from_diagonal(
            &Vector2::new(tuning.sigma_x_px, tuning.sigma_y_px).map(|s| s * s / area),
        );
    }
    let (xx, yy) = (given[0].clamp(low, high), given[1].clamp(low, high));
    let limit = 0.95 * libm::sqrt(xx * yy);
    let xy = given[2].clamp(-limit, limit);
    Matrix2::new(xx, xy, xy, yy)
}

/// Covariance (px²) of a blob as the centre of a marker: that of the blob, inflated where its size
/// or flags show that the marker is partly hidden or merged with another. `None` where the ratio of
/// areas is outside of `ratio_range`.
pub fn marker_covariance(
    blob: &BlobObservation,
    image: &MarkerImage,
    area_scale: f64,
    ratio_range: (f64, f64),
) -> Option<Matrix2<f64>> {
    let ratio = blob.area_px / (image.area_px * area_scale);
    if ratio < ratio_range.0 || ratio > ratio_range.1 {
        return None;
    }
    let lost = (libm::log(ratio).abs() - k::AREA_TOLERANCE).max(0.0);
    let wide = blob.width_px / (2.0 * image.radius_px * libm::sqrt(area_scale)) - 1.0;
    let grown = (wide - 0.04 - 1.2 / blob.width_px.max(1.0)).max(0.0);
    let flagged = f64::from(u8::from(blob.flags & (BLOB_MERGED | BLOB_CLIPPED) != 0));
    let shift = image.radius_px * (k::AREA_SHIFT * lost + grown + 0.5 * flagged);
    Some(blob.covariance + Matrix2::identity() * (shift * shift))
}

/// True if a covariance from [`marker_covariance`] is small enough to observe a roll.
pub fn is_localised(covariance: &Matrix2<f64>) -> bool {
    covariance.trace() < 2.0 * k::ROLL_LOCALISED_PX * k::ROLL_LOCALISED_PX
}

/// The camera of a field.
pub fn camera_of<'a>(rig: &'a RigModel, field: &FieldObservation) -> Option<&'a Camera> {
    rig.cameras[field.camera].as_ref()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2x3, Point3};

    #[test]
    fn a_shrunk_or_grown_blob_has_a_larger_covariance() {
        let image = MarkerImage {
            pixel: Vector2::zeros(),
            jacobian: Matrix2x3::zeros(),
            point: Point3::origin(),
            radius_px: 10.0,
            area_px: 170.0,
        };
        let mut blob = BlobObservation {
            pixel: Vector2::zeros(),
            covariance: Matrix2::identity() * 0.0025,
            area_px: 170.0,
            width_px: 20.0,
            colour: 1,
            flags: 0,
        };
        let sigma = |blob: &BlobObservation| {
            marker_covariance(blob, &image, 1.0, k::AREA_RATIO).map(|c| c[(0, 0)].sqrt())
        };
        assert_eq!(sigma(&blob), Some(0.05));
        blob.area_px = 85.0;
        assert!(sigma(&blob).unwrap() > 2.0, "half hidden");
        blob.area_px = 600.0;
        assert_eq!(sigma(&blob), None, "another thing");
        (blob.area_px, blob.flags) = (170.0, BLOB_MERGED);
        assert!(sigma(&blob).unwrap() > 2.0, "two in one");
    }
}
