//! Blobs of two recordings, matched field by field: how far each moved, which marker it is of, where that
//! marker is and how it moves. What a cause predicts of this is in [`super::models`].

use super::inputs::{FieldPair, difference};
use super::side::{BlobSeen, FieldSeen, FrameSeen, Side};
use nalgebra::{DMatrix, Isometry3, Matrix3, Point3, Vector2, Vector3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use rig::camera::Camera;

/// Field pairs that are compared for each camera; more add nothing new.
const FIELDS: usize = 400;
/// Field pairs by which the common shift of a camera's blobs is found.
const VOTING_FIELDS: usize = 60;
/// Largest common shift, px: a turn by more than 2°.
const LARGEST_SHIFT_PX: f64 = 60.0;
/// Bin of that vote, px.
const BIN_PX: f64 = 4.0;
/// Largest distance of a matched blob from the common shift, px.
const REACH_PX: f64 = 12.0;
/// Largest distance of a blob from the projection of its marker, px.
const MARKER_REACH_PX: f64 = 5.0;
/// The unit of time of a blob's motion, s.
pub const MOTION_UNIT_S: f64 = 0.02;
/// Largest distance of a blob from itself one field before or behind, px.
const STEP_REACH_PX: f64 = 25.0;

/// Marker of a body of the rig, both by their places in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MarkerId {
    /// Index of the body.
    pub body: usize,
    /// Index of the marker.
    pub marker: usize,
}

/// A blob in both recordings.
#[derive(Debug, Clone)]
pub struct BlobPair {
    /// Camera id.
    pub camera: u32,
    /// Centre in the first recording, px of the frame.
    pub a_px: Vector2<f64>,
    /// How far it is moved in the second, px.
    pub moved_px: Vector2<f64>,
    /// Its marker; none where poses do not determine it.
    pub marker: Option<MarkerId>,
    /// The marker in the world, mm; on the blob's ray, as far as the eye, where it is not known.
    pub p_in_world: Point3<f64>,
    /// Rotation of the marker's body.
    pub world_from_body: Matrix3<f64>,
    /// Coefficients of its motion by time in units of [`MOTION_UNIT_S`], from the first power on, px.
    pub motion: [Vector2<f64>; 4],
    /// How much later the second recording says that it was exposed, both clocks beginning alike, s.
    pub stamped_later_s: f64,
}

impl BlobPair {
    /// Where its own motion leads it in a time, px from here.
    pub fn moved_after(&self, time_s: f64) -> Vector2<f64> {
        let units = time_s / MOTION_UNIT_S;
        // Horner's rule.
        self.motion.iter().rev().fold(Vector2::zeros(), |sum, coefficient| (sum + coefficient) * units)
    }
}

/// Blobs of a camera.
#[derive(Debug, Default)]
pub struct Matched {
    /// Those with a partner.
    pub pairs: Vec<BlobPair>,
    /// Blobs of the first recording in the fields looked at.
    pub looked_at: usize,
}

/// What the matching needs to know of the first recording.
pub struct Matcher<'a> {
    a: &'a Side,
    b: &'a Side,
    rig: &'a Rig,
    /// A blob of the second recording that is of the first colour counts as of the second.
    recoloured: Vec<(u32, u32)>,
    /// How far the second clock is ahead, ns.
    ahead_ns: i64,
}

impl<'a> Matcher<'a> {
    /// For two recordings. `recoloured`: colours of the second recording, and what they are in the first;
    /// `ahead_ns`: how far the second clock is ahead.
    pub fn new(a: &'a Side, b: &'a Side, rig: &'a Rig, recoloured: Vec<(u32, u32)>, ahead_ns: i64) -> Self {
        Matcher { a, b, rig, recoloured, ahead_ns }
    }

    fn colour_of(&self, blob: &BlobSeen) -> u32 {
        self.recoloured.iter().find(|(from, _)| *from == blob.colour).map_or(blob.colour, |(_, to)| *to)
    }

    /// Matches the blobs of a camera in these pairs of fields.
    pub fn matched(&self, camera: &Camera, pairs: &[FieldPair]) -> Matched {
        let mut matched = Matched::default();
        let shift = self.common_shift(&evenly(pairs, VOTING_FIELDS));
        for pair in evenly(pairs, FIELDS) {
            let seen = self.a.blobs_of(&pair.a);
            matched.looked_at += seen.len();
            let markers = self.markers(camera, pair.a.exposed_ns);
            let around = self.around(&pair.a);
            let later_ns = difference(pair.a.exposed_ns, pair.b.exposed_ns).wrapping_sub(self.ahead_ns);
            let stamped_later_s = later_ns as f64 * 1e-9;
            for blob in seen {
                let Some(moved_px) = self.partner(blob, &pair.a, &pair.b, shift) else { continue };
                let Some(motion) = around.motion(blob) else { continue };
                let (marker, p_in_world, world_from_body) = place(camera, blob, &markers);
                let a_px = Vector2::from(blob.at_px);
                matched.pairs.push(BlobPair {
                    camera: camera.id,
                    a_px,
                    moved_px,
                    marker,
                    p_in_world,
                    world_from_body,
                    motion,
                    stamped_later_s,
                });
            }
        }
        matched
    }

    /// The shift that most pairs of blobs of one colour have in common, px.
    fn common_shift(&self, pairs: &[FieldPair]) -> Vector2<f64> {
        let bins = (2.0 * LARGEST_SHIFT_PX / BIN_PX) as usize + 1;
        let mut votes = vec![0u32; bins * bins];
        let bin = |shift: f64| ((shift + LARGEST_SHIFT_PX) / BIN_PX).round() as usize;
        for pair in pairs {
            for p in self.a.blobs_of(&pair.a) {
                for q in self.b.blobs_of(&pair.b).iter().filter(|q| self.colour_of(q) == p.colour) {
                    let shift = Vector2::from(q.at_px) - Vector2::from(p.at_px);
                    if shift.amax() <= LARGEST_SHIFT_PX {
                        votes[bin(shift.y) * bins + bin(shift.x)] += 1;
                    }
                }
            }
        }
        // Of equal ones the nearest to none.
        let shift_of = |at: usize| {
            Vector2::new((at % bins) as f64, (at / bins) as f64) * BIN_PX - Vector2::repeat(LARGEST_SHIFT_PX)
        };
        let key = |at: &usize| (votes[*at], std::cmp::Reverse(shift_of(*at).norm() as u64));
        (0..votes.len()).max_by_key(key).map_or(Vector2::zeros(), shift_of)
    }

    /// How far a blob is moved in the second recording: to the blob that is nearest to where the common
    /// shift puts it, where the converse holds too.
    fn partner(
        &self,
        blob: &BlobSeen,
        a: &FieldSeen,
        b: &FieldSeen,
        shift: Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let at = |blob: &BlobSeen| Vector2::from(blob.at_px);
        let nearest = |to: Vector2<f64>, among: &mut dyn Iterator<Item = Vector2<f64>>| {
            among.min_by(|p, q| (p - to).norm().total_cmp(&(q - to).norm()))
        };
        let others = self.b.blobs_of(b).iter().filter(|q| self.colour_of(q) == blob.colour);
        let other = nearest(at(blob) + shift, &mut others.map(at))?;
        let back = self.a.blobs_of(a).iter().filter(|p| p.colour == blob.colour);
        let is_mutual = nearest(other - shift, &mut back.map(at))? == at(blob);
        let moved = other - at(blob);
        (is_mutual && (moved - shift).norm() <= REACH_PX).then_some(moved)
    }

    /// The markers at an instant by the poses of the first recording, with their images.
    fn markers(&self, camera: &Camera, at_ns: u64) -> Vec<MarkerSeen> {
        let frames = &self.a.frames;
        let after = frames.partition_point(|f| f.exposed_ns < at_ns);
        let within_ns = 2 * self.rig.field_period_ns();
        let near = |at: usize| frames.get(at).filter(|f| f.exposed_ns.abs_diff(at_ns) <= within_ns);
        let (Some(late), early) = (near(after).or(near(after.wrapping_sub(1))), near(after.wrapping_sub(1)))
        else {
            return Vec::new();
        };
        let early = early.unwrap_or(late);
        (0..BODIES)
            .filter_map(|body| Some((body, pose_at(body, early, late, at_ns)?)))
            .flat_map(|(body, pose)| self.markers_of(camera, body, &pose))
            .collect()
    }

    fn markers_of(&self, camera: &Camera, body: usize, pose: &Isometry3<f64>) -> Vec<MarkerSeen> {
        let Some(own) = self.rig.body(BODY_NAMES[body]) else { return Vec::new() };
        let seen = |(marker, m): (usize, &rig::RigMarker)| {
            let p_in_world = pose * Point3::from(Vector3::from(m.p));
            Some(MarkerSeen {
                id: MarkerId { body, marker },
                colour: m.colour as u32,
                image_px: camera.project(&p_in_world)?,
                p_in_world,
                world_from_body: *pose.rotation.to_rotation_matrix().matrix(),
            })
        };
        own.markers.iter().enumerate().filter_map(seen).collect()
    }

    /// The fields of the same camera around a field, where they follow each other.
    fn around(&self, field: &FieldSeen) -> Around<'_> {
        let (own, period_s) = (self.a.fields_of(field.camera), self.rig.field_period_ns() as f64 * 1e-9);
        let at = own.partition_point(|f| f.field < field.field) as i64;
        let neighbour = |offset: i64| {
            let other = own.get(usize::try_from(at + offset).ok()?)?;
            let after_s = difference(field.exposed_ns, other.exposed_ns) as f64 * 1e-9;
            let in_order = after_s * offset as f64 > 0.0;
            let near = after_s.abs() < (offset.unsigned_abs() as f64 + 0.5) * period_s;
            (in_order && near).then(|| (self.a.blobs_of(other), after_s))
        };
        Around([-1, 1, -2, 2].map(neighbour))
    }
}

/// Image of a marker.
struct MarkerSeen {
    id: MarkerId,
    colour: u32,
    image_px: Vector2<f64>,
    p_in_world: Point3<f64>,
    world_from_body: Matrix3<f64>,
}

/// Blobs of the fields around one, the nearest two first, and how long after it these were exposed, s.
struct Around<'a>([Option<(&'a [BlobSeen], f64)>; 4]);

impl Around<'_> {
    /// The motion of a blob: the polynomial through its places in these fields and in its own, by its
    /// coefficients by time in units of [`MOTION_UNIT_S`], from the first power on. Two places around it are the
    /// least; a parabola alone would take a tremor of 10 Hz for a quarter slower than it is.
    fn motion(&self, blob: &BlobSeen) -> Option<[Vector2<f64>; 4]> {
        let here = Vector2::from(blob.at_px);
        let step = |(blobs, after_s): (&[BlobSeen], f64), reach_px: f64| {
            let own = blobs.iter().filter(|b| b.colour == blob.colour).map(|b| Vector2::from(b.at_px) - here);
            let nearest = own.min_by(|p, q| p.norm().total_cmp(&q.norm()));
            nearest.filter(|step| step.norm() < reach_px).map(|step| (after_s / MOTION_UNIT_S, step))
        };
        let [before, behind, far_before, far_behind] = self.0;
        let mut points = vec![step(before?, STEP_REACH_PX)?, step(behind?, STEP_REACH_PX)?];
        if let (Some(before), Some(behind)) = (far_before, far_behind) {
            points.extend(
                step(before, 2.0 * STEP_REACH_PX)
                    .zip(step(behind, 2.0 * STEP_REACH_PX))
                    .map(|(p, q)| [p, q])
                    .into_iter()
                    .flatten(),
            );
        }
        let count = points.len();
        let powers = DMatrix::from_fn(count, count, |row, column| points[row].0.powi(column as i32 + 1));
        let places = DMatrix::from_fn(count, 2, |row, axis| points[row].1[axis]);
        let solved = powers.lu().solve(&places)?;
        Some(std::array::from_fn(|power| {
            if power < count {
                Vector2::new(solved[(power, 0)], solved[(power, 1)])
            } else {
                Vector2::zeros()
            }
        }))
    }
}

/// Pose of a body between two frames; none where one of them did not measure it.
fn pose_at(body: usize, early: &FrameSeen, late: &FrameSeen, at_ns: u64) -> Option<Isometry3<f64>> {
    let pose = |frame: &FrameSeen| {
        let seen = &frame.bodies[body];
        let pose = Pose { position_mm: seen.position_mm, rotation_wxyz: seen.rotation_wxyz };
        (seen.validity == Validity::Measured as u32).then(|| pose.isometry())
    };
    let (from, to) = (pose(early)?, pose(late)?);
    let span = late.exposed_ns.saturating_sub(early.exposed_ns);
    if span == 0 {
        return Some(from);
    }
    let share = (at_ns.saturating_sub(early.exposed_ns) as f64 / span as f64).clamp(0.0, 1.0);
    from.try_lerp_slerp(&to, share, 1e-9)
}

/// Marker and place of a blob.
fn place(
    camera: &Camera,
    blob: &BlobSeen,
    markers: &[MarkerSeen],
) -> (Option<MarkerId>, Point3<f64>, Matrix3<f64>) {
    let at = Vector2::from(blob.at_px);
    let own =
        markers.iter().filter(|m| m.colour == blob.colour && (m.image_px - at).norm() < MARKER_REACH_PX);
    let nearest = own.min_by(|m, n| (m.image_px - at).norm().total_cmp(&(n.image_px - at).norm()));
    match nearest {
        Some(marker) => (Some(marker.id), marker.p_in_world, marker.world_from_body),
        None => {
            let ray = camera.ray_in_world(at).unwrap_or(Vector3::z());
            let p = camera.centre_in_world() + ray * camera.translation_mm.norm();
            (None, p, Matrix3::identity())
        }
    }
}

/// So many of them at most, spread evenly.
pub fn evenly<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let count = all.len().min(most);
    (0..count).map(|n| all[n * all.len() / count].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_spread_evenly() {
        let all: Vec<usize> = (0..10).collect();
        assert_eq!(evenly(&all, 4), [0, 2, 5, 7]);
        assert_eq!((evenly(&all, 20), evenly(&all[..0], 3)), (all.clone(), vec![]));
    }

    #[test]
    fn the_motion_of_a_blob_leads_through_its_places() {
        let at =
            |t: f64| BlobSeen { at_px: [3.0 * t + 2.0 * t * t - t * t * t, 7.0], area_px: 1.0, colour: 1 };
        let times = [-1.5, 1.0, -2.0, 2.2];
        let blobs = times.map(|t| [at(t)]);
        let seen = |n: usize| Some((&blobs[n][..], times[n] * MOTION_UNIT_S));
        let motion = Around([seen(0), seen(1), seen(2), seen(3)]).motion(&at(0.0)).unwrap();
        for (found, expected) in motion.iter().zip([3.0, 2.0, -1.0, 0.0]) {
            assert!((found - Vector2::new(expected, 0.0)).norm() < 1e-9, "{found}");
        }
        let parabola = Around([seen(0), seen(1), None, seen(3)]).motion(&at(0.0)).unwrap();
        assert_eq!(parabola[2], Vector2::zeros());
        assert!(Around([None, seen(1), seen(2), seen(3)]).motion(&at(0.0)).is_none());
    }
}
