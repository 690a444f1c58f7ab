//! What a blob says where it is taken for a marker: as the image of that marker alone, or as that of it and of another of its
//! colour which touches it.

use crate::associate::PredictedBody;
use crate::constants as k;
use crate::covers::{Covers, Disc, shift_px};
use crate::fit::BlobMatch;
use crate::observation::{FieldObservation, marker_covariance};
use crate::projection::pose_jacobian;
use crate::rig_model::Lines;
use nalgebra::{Matrix2, SMatrix};
use protocol::limits::BODIES;

/// Derivative of an image by the pose.
type PoseJacobian = SMatrix<f64, 2, 6>;

/// A field, and what is known of its camera.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The field.
    pub field: &'a FieldObservation,
    /// Its exposure less the instant of the prediction, s.
    pub dt_s: f64,
    /// When its lines are exposed.
    pub lines: &'a Lines,
    /// Ratio of seen to expected blob areas.
    pub area_scale: f64,
}

/// A blob, taken for a marker.
pub struct Reading {
    /// The match.
    pub matched: BlobMatch,
    /// Squared Mahalanobis distance from the prediction.
    pub distance2: f64,
    /// To be added to it where blobs compete: a blob must not win because of its own uncertainty.
    pub growth: f64,
}

/// A marker as predicted in a field.
pub struct Expectation<'a> {
    view: View<'a>,
    disc: &'a Disc,
    predicted: &'a PredictedBody,
    jacobian: PoseJacobian,
    /// Covariance of the image, px².
    spread: Matrix2<f64>,
    /// Its part that a pose leaves open where blobs of a field are of different instants, px².
    unknown: Matrix2<f64>,
    /// Share of the marker that is hidden.
    hidden: f64,
}

impl<'a> Expectation<'a> {
    /// Of a marker of the predicted body.
    pub fn new(view: View<'a>, covers: &Covers, disc: &'a Disc, predicted: &'a PredictedBody) -> Self {
        let jacobian = pose_jacobian(&disc.image, &disc.pose);
        let at_s = view.lines.dt_s(view.dt_s, disc.image.pixel.y);
        let by_pose = predicted.given.map_or(jacobian, |given| given.jacobian(&jacobian, at_s));
        let unknown = predicted.given.map_or_else(Matrix2::zeros, |given| given.spread(&jacobian, at_s));
        let spread = by_pose * predicted.covariance * by_pose.transpose() + unknown;
        let hidden = covers.hidden_share(disc);
        Expectation { view, disc, predicted, jacobian, spread, unknown, hidden }
    }

    /// Blob number `blob` as the image of this marker; `None` where its size rules that out.
    pub fn alone(&self, blob: usize) -> Option<Reading> {
        let (seen, image) = (&self.view.field.blobs()[blob], &self.disc.image);
        let covariance = marker_covariance(seen, image, self.view.area_scale, k::AREA_RATIO)?;
        let shift_px = shift_px(self.hidden, seen, image, self.view.area_scale);
        let covariance = covariance + Matrix2::identity() * (shift_px * shift_px);
        let mut reading = self.reading(blob, covariance, |_| ())?;
        // `covariance` grows with a wrong size, and so does the logarithm of its determinant.
        reading.growth = libm::log((covariance.determinant() / seen.covariance.determinant()).max(1.0));
        Some(reading)
    }

    /// Blob number `blob` as one image of this marker and of `partner`: it shows the mean of their centres, weighted by area.
    /// The place of this marker follows from the partner's predicted offset, whose uncertainty is added; that of two markers of
    /// one body comes from its rotation alone. `None` where the partner's body is not predicted.
    pub fn with_partner(
        &self,
        blob: usize,
        partner: &Disc,
        predicted: &[Option<PredictedBody>; BODIES],
    ) -> Option<Reading> {
        let other = predicted[partner.body].as_ref()?;
        let share = partner.image.area_px / (partner.image.area_px + self.disc.image.area_px);
        let to_mean = (partner.image.pixel - self.disc.image.pixel) * share;
        let mut by = pose_jacobian(&partner.image, &partner.pose);
        let mut offset = Matrix2::zeros();
        if partner.body == self.disc.body {
            by -= self.jacobian;
        } else {
            offset += self.spread;
        }
        offset += by * other.covariance * by.transpose();
        // As a variance of a blob, to which the body's scale applies.
        offset *= share * share / self.predicted.variance_scale;
        let covariance = self.view.field.blobs()[blob].covariance + offset;
        self.reading(blob, covariance, |matched| {
            matched.pixel -= to_mean;
            matched.area_ratio *= 1.0 - share;
            matched.clean = false;
        })
    }

    /// The reading of a blob of that covariance, changed by `correct` before it is compared.
    fn reading(
        &self,
        blob: usize,
        covariance: Matrix2<f64>,
        correct: impl FnOnce(&mut BlobMatch),
    ) -> Option<Reading> {
        let View { field, dt_s, lines, .. } = self.view;
        let inverse = (self.spread + covariance * self.predicted.variance_scale).try_inverse()?;
        let at_s = lines.dt_s(dt_s, field.blobs()[blob].pixel.y);
        let mut matched = BlobMatch::new(field, blob, self.disc.marker, &self.disc.image, covariance, at_s);
        correct(&mut matched);
        let r = matched.pixel - self.disc.image.pixel;
        matched.covariance += self.unknown;
        Some(Reading { matched, distance2: r.dot(&(inverse * r)), growth: 0.0 })
    }
}
