//! Recovery of a roll that differs from its prediction: the markers on the shaft determine the
//! shaft, so every marker beside it lies on a known ring, and each blob on that ring is a vote for
//! a roll.
//!
//! The gate of the association is about the ring's tangent: a marker turned by more than some 0.2
//! rad is outside of any gate. The roll would then be extrapolated for ever, while the markers on
//! the shaft fit well.

use crate::associate::{AssociationInput, PredictedBody};
use crate::constants as k;
use crate::fit::BlobMatch;
use crate::observation::{BlobObservation, FieldObservation, camera_of, is_localised, marker_covariance};
use crate::pose_math::{exp, propagated};
use crate::projection::{MarkerImage, PoseMatrix, pose_jacobian, project_marker};
use crate::rig_model::BodyModel;
use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use protocol::limits::BODIES;
use rig::camera::Camera;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Most votes; more are clutter.
const MAX_VOTES: usize = 32;

/// A blob on the ring of a marker.
#[derive(Debug, Clone, Copy, Default)]
struct RollVote {
    camera: usize,
    turn_rad: f64,
}

/// Roll of an instrument relative to its prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollChange {
    /// About the shaft, rad, −π to π.
    pub rad: f64,
    /// Number of cameras that agree on it.
    pub cameras: u32,
}

/// The roll on which more cameras agree than have a match of a marker beside the shaft; `None`
/// where there is none. `matches` are those of all bodies, `own` is the index of the body.
pub fn find(
    input: &AssociationInput<'_>,
    own: usize,
    predicted: &PredictedBody,
    matches: &[Vec<BlobMatch>; BODIES],
) -> Option<RollChange> {
    let body = &input.rig.bodies[own];
    let observes = |m: &&BlobMatch| !m.outlier && body.observes_roll(m.marker) && is_localised(&m.covariance);
    let found = matches[own].iter().filter(observes).fold(0u32, |set, m| set | 1 << m.camera);
    let rings = || {
        let fields = input.fields();
        let markers = (0..body.markers.len()).filter(|&m| body.observes_roll(m));
        fields.flat_map(move |field| {
            markers.clone().map(move |marker| MarkerRing { input, body, predicted, field, marker })
        })
    };
    let free =
        |ring: &MarkerRing<'_>, blob: usize| !is_taken(matches, own, ring.field.camera, ring.marker, blob);
    // Nothing to recover where every camera with a candidate has a match.
    if !rings().any(|r| found & (1 << r.field.camera) == 0 && r.blobs(|blob| free(&r, blob)).next().is_some())
    {
        return None;
    }
    let mut votes = [RollVote::default(); MAX_VOTES];
    let mut count = 0;
    for ring in rings() {
        ring.votes(
            |blob| free(&ring, blob),
            |vote| {
                if let Some(place) = votes.get_mut(count) {
                    *place = vote;
                    count += 1;
                }
            },
        );
    }
    let turn = agreed(&votes[..count])?;
    (turn.cameras > found.count_ones()).then_some(turn)
}

/// True if a blob is assigned to another marker.
fn is_taken(
    matches: &[Vec<BlobMatch>; BODIES],
    own: usize,
    camera: usize,
    marker: usize,
    blob: usize,
) -> bool {
    let by = |body: usize, m: &BlobMatch| {
        !m.outlier && m.camera == camera && m.blob == blob && !(body == own && m.marker == marker)
    };
    matches.iter().enumerate().any(|(body, list)| list.iter().any(|m| by(body, m)))
}

/// The change on which most cameras agree; of equals the smallest.
fn agreed(votes: &[RollVote]) -> Option<RollChange> {
    let apart = |a: f64, b: f64| {
        let d = a - b;
        d - libm::round(d / TAU) * TAU
    };
    let mut best: Option<RollChange> = None;
    for centre in votes {
        let near = |v: &&RollVote| apart(v.turn_rad, centre.turn_rad).abs() < k::ROLL_AGREES_RAD;
        let set = votes.iter().filter(near).fold(0u32, |set, v| set | 1 << v.camera);
        let (cameras, number) = (set.count_ones(), votes.iter().filter(near).count());
        let off: f64 = votes.iter().filter(near).map(|v| apart(v.turn_rad, centre.turn_rad)).sum();
        let turn = RollChange { rad: apart(centre.turn_rad + off / number as f64, 0.0), cameras };
        let better =
            |b: &RollChange| cameras > b.cameras || (cameras == b.cameras && turn.rad.abs() < b.rad.abs());
        if best.as_ref().is_none_or(better) {
            best = Some(turn);
        }
    }
    best
}

/// A marker beside the shaft of a body in one field, at any roll.
struct MarkerRing<'a> {
    input: &'a AssociationInput<'a>,
    body: &'a BodyModel,
    predicted: &'a PredictedBody,
    field: &'a FieldObservation,
    marker: usize,
}

impl MarkerRing<'_> {
    /// Unassigned blobs of the marker's colour.
    fn blobs(&self, free: impl Fn(usize) -> bool) -> impl Iterator<Item = &BlobObservation> {
        let colour = self.body.markers[self.marker].colour;
        let blobs = self.field.blobs().iter().enumerate();
        blobs.filter(move |(i, blob)| blob.colour == colour && free(*i)).map(|(_, blob)| blob)
    }

    /// Calls `vote` for every unassigned blob on the ring.
    fn votes(&self, free: impl Fn(usize) -> bool, mut vote: impl FnMut(RollVote)) {
        let Some(camera) = camera_of(self.input.rig, self.field) else { return };
        let PredictedBody { pose, motion, .. } = self.predicted;
        let lines = &self.input.rig.lines[self.field.camera];
        let at_line = |y_px: f64| propagated(pose, motion, lines.dt_s(self.input.dt_s(self.field), y_px));
        let Some((centre, frame)) = self.ellipse(camera, &at_line(0.5 * f64::from(camera.size_px[1]))) else {
            return;
        };
        for blob in self.blobs(free) {
            let on = frame * (blob.pixel - centre);
            if (on.norm() - 1.0).abs() > k::ROLL_RING {
                continue;
            }
            let guess = libm::atan2(on.y, on.x);
            if let Some(turn_rad) = self.refined(camera, &at_line(blob.pixel.y), blob, guess) {
                vote(RollVote { camera: self.field.camera, turn_rad });
            }
        }
    }

    /// Centre of the ring in the image, and the linear map that makes it a unit circle, to first
    /// order.
    fn ellipse(&self, camera: &Camera, pose: &Isometry3<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let at = |turn: f64| Some(self.image(camera, pose, turn)?.0.pixel);
        let [a, b, c] = [at(0.0)?, at(FRAC_PI_2)?, at(PI)?];
        let centre = (a + c) * 0.5;
        let (u, v) = (a - centre, b - centre);
        // Seen from the side, front and back are ambiguous.
        let round = (u.x * v.y - u.y * v.x).abs() / u.norm_squared().max(v.norm_squared());
        (round > k::ROLL_FLAT).then(|| Matrix2::from_columns(&[u, v]).try_inverse())?.map(|m| (centre, m))
    }

    fn image(
        &self,
        camera: &Camera,
        pose: &Isometry3<f64>,
        turn_rad: f64,
    ) -> Option<(MarkerImage, PoseMatrix, Vector3<f64>)> {
        let axis = pose.rotation * Vector3::z();
        let turned = Isometry3::from_parts(pose.translation, exp(axis * turn_rad) * pose.rotation);
        let placed = PoseMatrix::from(&turned);
        Some((project_marker(&self.body.markers[self.marker], &placed, camera)?, placed, axis))
    }

    /// The roll change at which the marker is nearest to a blob, refined from `guess`; `None` if
    /// the blob is not on the ring or not localised.
    fn refined(
        &self,
        camera: &Camera,
        pose: &Isometry3<f64>,
        blob: &BlobObservation,
        guess: f64,
    ) -> Option<f64> {
        let mut turn = guess;
        for _ in 0..3 {
            let (image, placed, axis) = self.image(camera, pose, turn)?;
            let tangent = image.jacobian * axis.cross(&(image.point - placed.origin));
            turn += tangent.dot(&(blob.pixel - image.pixel)) / tangent.norm_squared();
        }
        let (image, placed, _) = self.image(camera, pose, turn)?;
        let scale = self.input.area_scales[self.field.camera];
        let covariance = marker_covariance(blob, &image, scale, k::AREA_RATIO)?;
        let jacobian = pose_jacobian(&image, &placed);
        let spread = jacobian * self.predicted.covariance * jacobian.transpose();
        let inverse = (spread + covariance * self.predicted.variance_scale).try_inverse()?;
        let r = blob.pixel - image.pixel;
        (is_localised(&covariance) && r.dot(&(inverse * r)) < k::GATE && turn.is_finite()).then_some(turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_math::Matrix6;
    use crate::rig_model::RigModel;
    use bytemuck::Zeroable;
    use nalgebra::{Point3, Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use protocol::blobs::BlobField;
    use protocol::limits::MAX_CAMERAS;
    use rig::Rig;

    /// The marker beside the shaft of `inst0`, as the cameras see it.
    fn fields(rig: &Rig, pose: &Isometry3<f64>, cameras: u32) -> [FieldObservation; MAX_CAMERAS] {
        let mut fields = std::array::from_fn(FieldObservation::empty);
        let marker = &rig.bodies[0].markers[3];
        let point = pose * Point3::from(Vector3::from(marker.p));
        for camera in rig.cameras().iter().filter(|c| cameras & (1 << c.id) != 0) {
            let mut field = BlobField::zeroed();
            (field.camera, field.exposed_ns) = (camera.id, 20_000_000);
            field.push(camera.blob_of_ball(&point, marker.r, marker.colour, field.parity).unwrap());
            fields[camera.id as usize].fill(&field, camera, &crate::Tuning::default());
        }
        fields
    }

    fn found(
        rig: &Rig,
        fields: &[FieldObservation; MAX_CAMERAS],
        pose: Isometry3<f64>,
    ) -> Option<RollChange> {
        let model = RigModel::new(rig);
        let area_scales = [1.0; MAX_CAMERAS];
        let input = AssociationInput {
            rig: &model,
            fields,
            cameras: 0b111,
            time_ns: 20_000_000,
            area_scales: &area_scales,
        };
        let predicted = PredictedBody {
            pose,
            covariance: Matrix6::identity() * 1e-6,
            motion: [Vector3::zeros(); 2],
            given: None,
            variance_scale: 1.0,
        };
        find(&input, 0, &predicted, &Default::default())
    }

    fn through_trocar(rig: &Rig, tip: Vector3<f64>, roll: f64) -> Isometry3<f64> {
        let axis = Vector3::from(rig.trocar("inst0").unwrap().p_eye) - tip;
        let upright = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
        let rotation = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
        Isometry3::from_parts(Translation3::from(tip), rotation)
    }

    proptest! {
        #[test]
        fn any_change_is_found(
            x in -4.0..4.0f64, y in -4.0..4.0f64, z in -10.0..0.0f64, roll in -PI..PI, turn in -3.1..3.1f64,
        ) {
            let rig = Rig::load_or_shipped(None).unwrap();
            let [before, after] = [roll, roll + turn].map(|r| through_trocar(&rig, Vector3::new(x, y, z), r));
            let all = found(&rig, &fields(&rig, &after, 0b111), before).unwrap();
            // One of them may see the ring from the side.
            prop_assert!((all.rad - turn).abs() < 1e-4 && all.cameras >= 2, "{:?}", all);
            let alone = |c: u32| found(&rig, &fields(&rig, &after, 1 << c), before);
            let agree: Vec<RollChange> = (0..3).filter_map(alone).collect();
            prop_assert!(agree.len() == all.cameras as usize, "{:?}", agree);
            prop_assert!(agree.iter().all(|t| (t.rad - turn).abs() < 1e-4 && t.cameras == 1), "{:?}", agree);
        }

        #[test]
        fn a_blob_beside_the_ring_is_no_vote(turn in -3.1..3.1f64, off in 0.15..0.5f64) {
            let rig = Rig::load_or_shipped(None).unwrap();
            let [before, after] = [0.0, turn].map(|r| through_trocar(&rig, Vector3::new(1.0, 0.0, -9.0), r));
            let beside = after * Translation3::new(off, 0.0, 0.0);
            prop_assert_eq!(found(&rig, &fields(&rig, &beside, 0b111), before), None);
        }
    }

    #[test]
    fn most_cameras_decide_then_the_smaller_change() {
        let vote = |camera: usize, turn_rad: f64| RollVote { camera, turn_rad };
        let turn = agreed(&[vote(0, 0.2), vote(1, 2.0), vote(2, 2.02), vote(2, -1.0)]).unwrap();
        assert!(turn.cameras == 2 && (turn.rad - 2.01).abs() < 1e-12, "{turn:?}");
        assert_eq!(agreed(&[vote(0, 2.0), vote(1, -0.5)]), Some(RollChange { rad: -0.5, cameras: 1 }));
        let across = agreed(&[vote(0, PI - 0.01), vote(1, 0.01 - PI)]).unwrap();
        assert!(across.cameras == 2 && (across.rad.abs() - PI).abs() < 1e-9, "{across:?}");
        assert_eq!(agreed(&[vote(0, 1.0), vote(0, 1.01)]).unwrap().cameras, 1);
        assert_eq!(agreed(&[]), None);
    }
}
