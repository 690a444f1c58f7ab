//! Finding a roll that went another way than foreseen: the shaft is known from the markers on it, so
//! that every marker beside it lies on a known ring, and each blob on that ring tells a roll.
//!
//! The gate of the association follows the ring's tangent, the ring does not: beyond some 0.2 rad a
//! marker is outside of it, however wide it is. Then the roll would be carried on by its old rate for
//! ever, while the markers on the shaft fit well.

use crate::associate::{Expected, Group};
use crate::constants as k;
use crate::filter::exp;
use crate::fit::{Match, carried, pose_jacobian};
use crate::model::BodyModel;
use crate::sight::{Image, Placed, Sight, View, camera_of, covariance_as, image_of, tells_place};
use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use protocol::camera::Camera;
use protocol::limits::BODIES;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Blobs considered; more are clutter.
const MAX_VOTES: usize = 32;

/// A blob on the ring of a marker.
#[derive(Debug, Clone, Copy, Default)]
struct Vote {
    camera: usize,
    turn_rad: f64,
}

/// How an instrument is rolled against where it was thought to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// About the shaft, rad, −π to π.
    pub rad: f64,
    /// Cameras that agree on it.
    pub cameras: u32,
}

/// The roll on which more cameras agree than have found a marker beside the shaft where it was expected;
/// `None` where there is no such. `matches` are those of all bodies, `own` is the body's number.
pub fn find(
    group: &Group<'_>,
    own: usize,
    expected: &Expected,
    matches: &[Vec<Match>; BODIES],
) -> Option<Turn> {
    let body = &group.rig.bodies[own];
    let tells = |m: &&Match| !m.out && body.tells_roll(m.marker) && tells_place(&m.covariance);
    let found = matches[own].iter().filter(tells).fold(0u32, |set, m| set | 1 << m.camera);
    let rings = || {
        let views = group.views.iter().filter(|v| group.cameras & (1 << v.camera) != 0);
        let markers = (0..body.markers.len()).filter(|&m| body.tells_roll(m));
        views.flat_map(move |view| {
            markers.clone().map(move |marker| Ring { group, body, expected, view, marker })
        })
    };
    let free = |ring: &Ring<'_>, blob: usize| !is_taken(matches, own, ring.view.camera, ring.marker, blob);
    // Nothing to find where all that could tell the roll already does.
    if !rings().any(|r| found & (1 << r.view.camera) == 0 && r.blobs(|blob| free(&r, blob)).next().is_some())
    {
        return None;
    }
    let mut votes = [Vote::default(); MAX_VOTES];
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

/// True if a blob was taken for another marker.
fn is_taken(matches: &[Vec<Match>; BODIES], own: usize, camera: usize, marker: usize, blob: usize) -> bool {
    let by = |body: usize, m: &Match| {
        !m.out && m.camera == camera && m.blob == blob && !(body == own && m.marker == marker)
    };
    matches.iter().enumerate().any(|(body, list)| list.iter().any(|m| by(body, m)))
}

/// The turn on which most cameras agree; of equals the smallest.
fn agreed(votes: &[Vote]) -> Option<Turn> {
    let apart = |a: f64, b: f64| {
        let d = a - b;
        d - libm::round(d / TAU) * TAU
    };
    let mut best: Option<Turn> = None;
    for centre in votes {
        let near = |v: &&Vote| apart(v.turn_rad, centre.turn_rad).abs() < k::ROLL_AGREES_RAD;
        let set = votes.iter().filter(near).fold(0u32, |set, v| set | 1 << v.camera);
        let (cameras, number) = (set.count_ones(), votes.iter().filter(near).count());
        let off: f64 = votes.iter().filter(near).map(|v| apart(v.turn_rad, centre.turn_rad)).sum();
        let turn = Turn { rad: apart(centre.turn_rad + off / number as f64, 0.0), cameras };
        let better = |b: &Turn| cameras > b.cameras || (cameras == b.cameras && turn.rad.abs() < b.rad.abs());
        if best.as_ref().is_none_or(better) {
            best = Some(turn);
        }
    }
    best
}

/// A marker beside the shaft of a body in one view, at any roll.
struct Ring<'a> {
    group: &'a Group<'a>,
    body: &'a BodyModel,
    expected: &'a Expected,
    view: &'a View,
    marker: usize,
}

impl Ring<'_> {
    /// Free blobs of the marker's colour.
    fn blobs(&self, free: impl Fn(usize) -> bool) -> impl Iterator<Item = &Sight> {
        let colour = self.body.markers[self.marker].colour;
        let sights = self.view.sights().iter().enumerate();
        sights.filter(move |(blob, sight)| sight.colour == colour && free(*blob)).map(|(_, sight)| sight)
    }

    /// Tells every blob that is on the ring, if it is free.
    fn votes(&self, free: impl Fn(usize) -> bool, mut tell: impl FnMut(Vote)) {
        let Some(camera) = camera_of(self.group.rig, self.view) else { return };
        let dt_s = (self.view.exposed_ns as i64).wrapping_sub(self.group.base_ns as i64) as f64 * 1e-9;
        let pose = carried(&self.expected.pose, &self.expected.motion, dt_s);
        let Some((centre, frame)) = self.ellipse(camera, &pose) else { return };
        for sight in self.blobs(free) {
            let on = frame * (sight.pixel - centre);
            if (on.norm() - 1.0).abs() > k::ROLL_RING {
                continue;
            }
            let guess = libm::atan2(on.y, on.x);
            if let Some(turn_rad) = self.refined(camera, &pose, sight, guess) {
                tell(Vote { camera: self.view.camera, turn_rad });
            }
        }
    }

    /// Centre of the ring in the picture, and what makes a circle of it: to first order.
    fn ellipse(&self, camera: &Camera, pose: &Isometry3<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let at = |turn: f64| Some(self.image(camera, pose, turn)?.0.pixel);
        let [a, b, c] = [at(0.0)?, at(FRAC_PI_2)?, at(PI)?];
        let centre = (a + c) * 0.5;
        let (u, v) = (a - centre, b - centre);
        // From the side front and back cannot be told apart.
        let round = (u.x * v.y - u.y * v.x).abs() / u.norm_squared().max(v.norm_squared());
        (round > k::ROLL_FLAT).then(|| Matrix2::from_columns(&[u, v]).try_inverse())?.map(|m| (centre, m))
    }

    fn image(
        &self,
        camera: &Camera,
        pose: &Isometry3<f64>,
        turn_rad: f64,
    ) -> Option<(Image, Placed, Vector3<f64>)> {
        let axis = pose.rotation * Vector3::z();
        let turned = Isometry3::from_parts(pose.translation, exp(axis * turn_rad) * pose.rotation);
        let placed = Placed::from(&turned);
        Some((image_of(&self.body.markers[self.marker], &placed, camera)?, placed, axis))
    }

    /// The turn at which a blob is nearest to the marker, from one nearby; `None` if it is not on the
    /// ring, or its size does not tell its place.
    fn refined(&self, camera: &Camera, pose: &Isometry3<f64>, sight: &Sight, guess: f64) -> Option<f64> {
        let mut turn = guess;
        for _ in 0..3 {
            let (image, placed, axis) = self.image(camera, pose, turn)?;
            let tangent = image.jacobian * axis.cross(&(image.point - placed.origin));
            turn += tangent.dot(&(sight.pixel - image.pixel)) / tangent.norm_squared();
        }
        let (image, placed, _) = self.image(camera, pose, turn)?;
        let scale = self.group.area_scales[self.view.camera];
        let covariance = covariance_as(sight, &image, scale, k::AREA_RATIO)?;
        let jacobian = pose_jacobian(&image, &placed);
        let predicted = jacobian * self.expected.covariance * jacobian.transpose();
        let inverse = (predicted + covariance * self.expected.variance_scale).try_inverse()?;
        let r = sight.pixel - image.pixel;
        (tells_place(&covariance) && r.dot(&(inverse * r)) < k::GATE && turn.is_finite()).then_some(turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::Matrix6;
    use crate::model::RigModel;
    use bytemuck::Zeroable;
    use nalgebra::{Point3, Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use protocol::blobs::{Blob, BlobField};
    use protocol::limits::MAX_CAMERAS;
    use protocol::rig::Rig;

    /// The marker beside the shaft of `inst0`, as the cameras see it.
    fn views(rig: &Rig, pose: &Isometry3<f64>, cameras: u32) -> [View; MAX_CAMERAS] {
        let mut views = std::array::from_fn(View::empty);
        let marker = &rig.bodies[0].markers[3];
        let point = pose * Point3::from(Vector3::from(marker.p));
        for camera in rig.cameras().iter().filter(|c| cameras & (1 << c.id) != 0) {
            let mut field = BlobField::zeroed();
            (field.camera, field.exposed_ns) = (camera.id, 20_000_000);
            field.push(Blob::of_ball(camera, &point, marker.r, marker.colour, field.parity).unwrap());
            views[camera.id as usize].fill(&field, camera);
        }
        views
    }

    fn found(rig: &Rig, views: &[View; MAX_CAMERAS], pose: Isometry3<f64>) -> Option<Turn> {
        let model = RigModel::new(rig);
        let area_scales = [1.0; MAX_CAMERAS];
        let group =
            Group { rig: &model, views, cameras: 0b111, base_ns: 20_000_000, area_scales: &area_scales };
        let expected = Expected {
            pose,
            covariance: Matrix6::identity() * 1e-6,
            motion: [Vector3::zeros(); 2],
            variance_scale: 1.0,
        };
        find(&group, 0, &expected, &Default::default())
    }

    fn through_trocar(rig: &Rig, tip: Vector3<f64>, roll: f64) -> Isometry3<f64> {
        let axis = Vector3::from(rig.trocar("inst0").unwrap().p_eye) - tip;
        let upright = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
        let rotation = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
        Isometry3::from_parts(Translation3::from(tip), rotation)
    }

    proptest! {
        #[test]
        fn any_turn_is_found(
            x in -4.0..4.0f64, y in -4.0..4.0f64, z in -10.0..0.0f64, roll in -PI..PI, turn in -3.1..3.1f64,
        ) {
            let rig = Rig::load_or_shipped(None).unwrap();
            let [before, after] = [roll, roll + turn].map(|r| through_trocar(&rig, Vector3::new(x, y, z), r));
            let all = found(&rig, &views(&rig, &after, 0b111), before).unwrap();
            // One of them may see the ring from the side.
            prop_assert!((all.rad - turn).abs() < 1e-4 && all.cameras >= 2, "{:?}", all);
            let alone = |c: u32| found(&rig, &views(&rig, &after, 1 << c), before);
            let agree: Vec<Turn> = (0..3).filter_map(alone).collect();
            prop_assert!(agree.len() == all.cameras as usize, "{:?}", agree);
            prop_assert!(agree.iter().all(|t| (t.rad - turn).abs() < 1e-4 && t.cameras == 1), "{:?}", agree);
        }

        #[test]
        fn a_blob_beside_the_ring_tells_nothing(turn in -3.1..3.1f64, off in 0.15..0.5f64) {
            let rig = Rig::load_or_shipped(None).unwrap();
            let [before, after] = [0.0, turn].map(|r| through_trocar(&rig, Vector3::new(1.0, 0.0, -9.0), r));
            let beside = after * Translation3::new(off, 0.0, 0.0);
            prop_assert_eq!(found(&rig, &views(&rig, &beside, 0b111), before), None);
        }
    }

    #[test]
    fn most_cameras_decide_then_the_smaller_turn() {
        let vote = |camera: usize, turn_rad: f64| Vote { camera, turn_rad };
        let turn = agreed(&[vote(0, 0.2), vote(1, 2.0), vote(2, 2.02), vote(2, -1.0)]).unwrap();
        assert!(turn.cameras == 2 && (turn.rad - 2.01).abs() < 1e-12, "{turn:?}");
        assert_eq!(agreed(&[vote(0, 2.0), vote(1, -0.5)]), Some(Turn { rad: -0.5, cameras: 1 }));
        let across = agreed(&[vote(0, PI - 0.01), vote(1, 0.01 - PI)]).unwrap();
        assert!(across.cameras == 2 && (across.rad.abs() - PI).abs() < 1e-9, "{across:?}");
        assert_eq!(agreed(&[vote(0, 1.0), vote(0, 1.01)]).unwrap().cameras, 1);
        assert_eq!(agreed(&[]), None);
    }
}
