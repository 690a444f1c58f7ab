//! Markers that a camera sees whole, wherever near their predicted image: without the gate of the
//! tracker's association, behind which what was moved would not be seen.

use crate::constants as k;
use crate::observation::{FieldObservation, marker_covariance};
use crate::projection::{MarkerImage, PoseMatrix, project_marker};
use crate::rig_model::RigModel;
use nalgebra::{Matrix2, Vector2};
use protocol::camera::Camera;

/// A marker with the nearest blob that shows it whole.
#[derive(Debug, Clone, Copy)]
pub struct Sighting {
    /// Image of the marker as predicted.
    pub image: MarkerImage,
    /// Blob less image, px.
    pub offset: Vector2<f64>,
    /// Covariance of the blob, px².
    pub covariance: Matrix2<f64>,
}

/// The markers of a body at `pose` that are seen whole within `reach_px` of where they should be.
pub fn of_body<'a>(
    rig: &'a RigModel,
    body: usize,
    pose: &'a PoseMatrix,
    camera: &'a Camera,
    field: &'a FieldObservation,
    area_scale: f64,
    reach_px: f64,
) -> impl Iterator<Item = Sighting> + 'a {
    rig.bodies[body].markers.iter().filter_map(move |marker| {
        let image = project_marker(marker, pose, camera)?;
        let whole = field.blobs().iter().filter(|b| {
            b.colour == marker.colour
                && marker_covariance(b, &image, area_scale, k::AREA_RATIO) == Some(b.covariance)
        });
        let found =
            whole.map(|b| Sighting { image, offset: b.pixel - image.pixel, covariance: b.covariance });
        let nearest = found.min_by(|a, b| a.offset.norm_squared().total_cmp(&b.offset.norm_squared()))?;
        (nearest.offset.norm_squared() < reach_px * reach_px).then_some(nearest)
    })
}
