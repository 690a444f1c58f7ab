//! Markers that a camera sees whole, wherever near their predicted image: without the gate of the
//! tracker's association, behind which what was moved would not be seen.

use super::evidence::BodyUpdate;
use crate::constants as k;
use crate::lines::BodyInField;
use crate::observation::{BlobObservation, FieldObservation, marker_covariance};
use crate::projection::MarkerImage;
use crate::rig_model::{Marker, RigModel};
use nalgebra::{Matrix2, Vector2};
use rig::camera::Camera;

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

/// The markers of a body, where it is in that field, that are seen whole within `reach_px` of where they should be.
pub fn of_body<'a>(
    rig: &'a RigModel,
    body: usize,
    placed: &'a BodyInField,
    camera: &'a Camera,
    field: &'a FieldObservation,
    area_scale: f64,
    reach_px: f64,
) -> impl Iterator<Item = Sighting> + 'a {
    rig.bodies[body].markers.iter().filter_map(move |marker| {
        let (image, _) = placed.image(marker, camera)?;
        nearest(marker, &image, field, area_scale, reach_px)
    })
}

/// The same for an update of a body: its matches, and for markers without one the nearest blob within
/// [`k::KNOCK_SLOW_REACH_PX`].
pub fn of_matches<'a>(
    rig: &'a RigModel,
    update: &'a BodyUpdate<'_>,
    placed: &'a BodyInField,
    camera: &'a Camera,
    field: &'a FieldObservation,
    area_scale: f64,
) -> impl Iterator<Item = Sighting> + 'a {
    rig.bodies[update.body].markers.iter().enumerate().filter_map(move |(index, marker)| {
        let (image, _) = placed.image(marker, camera)?;
        let matched = update.matches.iter().find(|m| m.camera == field.camera && m.marker == index);
        let Some(m) = matched else {
            return nearest(marker, &image, field, area_scale, k::KNOCK_SLOW_REACH_PX);
        };
        m.clean.then(|| Sighting { image, offset: m.pixel - image.pixel, covariance: m.covariance })
    })
}

/// The nearest blob that shows a marker whole.
fn nearest(
    marker: &Marker,
    image: &MarkerImage,
    field: &FieldObservation,
    area_scale: f64,
    reach_px: f64,
) -> Option<Sighting> {
    let near = |b: &&BlobObservation| {
        b.colour == marker.colour && (b.pixel - image.pixel).norm_squared() < reach_px * reach_px
    };
    let whole =
        |b: &&BlobObservation| marker_covariance(b, image, area_scale, k::AREA_RATIO) == Some(b.covariance);
    let found = field.blobs().iter().filter(near).filter(whole);
    let found =
        found.map(|b| Sighting { image: *image, offset: b.pixel - image.pixel, covariance: b.covariance });
    found.min_by(|a, b| a.offset.norm_squared().total_cmp(&b.offset.norm_squared()))
}
