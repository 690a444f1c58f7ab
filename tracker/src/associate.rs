//! Data association: which blob is which marker of a body whose pose is predicted. By colour, size
//! and Mahalanobis distance, nearest first, each blob and each marker once in a camera-field.

use crate::constants as k;
use crate::covers::Covers;
use crate::fit::{BlobMatch, MAX_MATCHES};
use crate::lines::MotionGivenPose;
use crate::observation::{FieldObservation, camera_of};
use crate::pose_math::Matrix6;
use crate::reading::{Expectation, Reading, View};
use crate::rig_model::RigModel;
use crate::tuning::Tuning;
use nalgebra::{Isometry3, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::poses::EYE;

/// Capacity for candidates; candidates beyond it are dropped.
const MAX_CANDIDATES: usize = 4096;
/// Size of the pool of associations: two of an update and the one of the previous update.
const ASSOCIATIONS: usize = 3;

/// A blob within the gate of a marker.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    /// Squared Mahalanobis distance, plus the logarithm of the covariance's growth.
    cost: f64,
    body: usize,
    matched: BlobMatch,
}

/// A blob of a marker's colour near the marker, but outside of its gate.
#[derive(Debug, Clone, Copy)]
struct NearMiss {
    body: usize,
    camera: usize,
    marker: usize,
    blob: usize,
}

/// Where a body is predicted to be.
#[derive(Debug, Clone, Copy)]
pub struct PredictedBody {
    /// `world_from_body` at the group's instant.
    pub pose: Isometry3<f64>,
    /// Covariance of the pose.
    pub covariance: Matrix6,
    /// Velocity (mm/s) and angular velocity (rad/s) in the world.
    pub motion: [Vector3<f64>; 2],
    /// What the pose says of it, where blobs of one field are of different instants.
    pub given: Option<MotionGivenPose>,
    /// Factor on the variances of all blobs.
    pub variance_scale: f64,
}

/// The camera-fields of one instant, and what is known of their cameras.
pub struct AssociationInput<'a> {
    /// The rig.
    pub rig: &'a RigModel,
    /// Newest field of each camera.
    pub fields: &'a [FieldObservation; MAX_CAMERAS],
    /// Set of the cameras whose field belongs to this instant.
    pub cameras: u32,
    /// The instant, ns.
    pub time_ns: u64,
    /// Running ratio of seen to expected blob areas, by camera.
    pub area_scales: &'a [f64; MAX_CAMERAS],
}

impl AssociationInput<'_> {
    /// The fields of this instant.
    pub fn fields(&self) -> impl Iterator<Item = &FieldObservation> {
        self.fields.iter().filter(|f| self.cameras & (1 << f.camera) != 0)
    }

    /// Exposure of a field less the instant, s.
    pub fn dt_s(&self, field: &FieldObservation) -> f64 {
        (field.exposed_ns as i64).wrapping_sub(self.time_ns as i64) as f64 * 1e-9
    }
}

/// Blobs assigned to markers.
#[derive(Debug, Clone)]
pub struct Association {
    /// Matches of each body, nearest first.
    pub matches: [Vec<BlobMatch>; BODIES],
    /// Unassigned blobs of each body near a marker that has no match, by camera.
    pub near_misses: [[u32; MAX_CAMERAS]; BODIES],
    /// True if every blob had one possible marker, and every marker one possible blob.
    pub unambiguous: bool,
}

impl Association {
    /// Number of blobs that lie beside the markers of a body.
    pub fn beside(&self, body: usize) -> u32 {
        self.near_misses[body].iter().sum()
    }

    /// True if most blobs of a body in all cameras, or in one, lie beside its markers. In one alone the motion may
    /// be across the line of sight of that camera only; left out, its blobs would leave the depth to the others.
    pub fn is_beside(&self, body: usize) -> bool {
        let most =
            |beside: u32, matched: usize| beside as usize >= k::MIN_NEAR_MISSES && beside as usize > matched;
        let matched =
            |body: usize, camera: usize| self.matches[body].iter().filter(|m| m.camera == camera).count();
        let in_camera =
            |body: usize, camera: usize| most(self.near_misses[body][camera], matched(body, camera));
        // Where the eye's blobs lie beside its markers too, it is the camera that moved.
        most(self.beside(body), self.matches[body].len())
            || (0..MAX_CAMERAS).any(|camera| in_camera(body, camera) && !in_camera(EYE, camera))
    }
}

impl Default for Association {
    fn default() -> Self {
        Association {
            matches: std::array::from_fn(|_| Vec::with_capacity(MAX_MATCHES)),
            near_misses: [[0; MAX_CAMERAS]; BODIES],
            unambiguous: true,
        }
    }
}

/// Associates blobs and markers; its memory is reused.
pub struct Associator {
    candidates: Vec<Candidate>,
    near: Vec<NearMiss>,
    covers: Covers,
    spare: Vec<Association>,
}

impl Default for Associator {
    fn default() -> Self {
        Associator {
            candidates: Vec::with_capacity(MAX_CANDIDATES),
            near: Vec::with_capacity(MAX_CANDIDATES),
            covers: Covers::with_capacity(),
            spare: (0..ASSOCIATIONS).map(|_| Association::default()).collect(),
        }
    }
}

/// A copy of a tracker gets work space of its own, which grows when it is first used.
impl Clone for Associator {
    fn clone(&self) -> Self {
        Associator { candidates: Vec::new(), near: Vec::new(), covers: Covers::default(), spare: Vec::new() }
    }
}

impl Associator {
    /// Assigns blobs to the markers of every body with a prediction.
    pub fn associate(
        &mut self,
        input: &AssociationInput<'_>,
        predicted: &[Option<PredictedBody>; BODIES],
    ) -> Association {
        self.candidates.clear();
        self.near.clear();
        for field in input.fields() {
            let Some(camera) = camera_of(input.rig, field) else { continue };
            self.covers.renew(input.rig, camera, predicted, input.dt_s(field));
            for body in 0..BODIES {
                self.gate(input, body, field, predicted);
            }
        }
        self.candidates.sort_unstable_by(|a, b| {
            let key = |c: &Candidate| (c.body, c.matched.camera, c.matched.marker, c.matched.blob);
            a.cost.total_cmp(&b.cost).then_with(|| key(a).cmp(&key(b)))
        });
        self.assign()
    }

    /// Takes an association back, so that its memory serves again.
    pub fn recycle(&mut self, association: Association) {
        self.spare.push(association);
    }

    /// Assigns the sorted candidates, nearest first.
    fn assign(&mut self) -> Association {
        let mut out = self.spare.pop().unwrap_or_default();
        for list in &mut out.matches {
            list.clear();
        }
        let mut blobs_used = [0u64; MAX_CAMERAS];
        let mut markers_used = [[0u32; MAX_CAMERAS]; BODIES];
        for c in &self.candidates {
            let m = &c.matched;
            let (blob, marker) = (1u64 << m.blob, 1u32 << m.marker);
            if blobs_used[m.camera] & blob == 0 && markers_used[c.body][m.camera] & marker == 0 {
                blobs_used[m.camera] |= blob;
                markers_used[c.body][m.camera] |= marker;
                out.matches[c.body].push(*m);
            }
        }
        out.near_misses = [[0; MAX_CAMERAS]; BODIES];
        for n in &self.near {
            let unmatched = markers_used[n.body][n.camera] & (1 << n.marker) == 0;
            if unmatched && blobs_used[n.camera] & (1 << n.blob) == 0 {
                out.near_misses[n.body][n.camera] += 1;
            }
        }
        out.unambiguous = out.matches.iter().map(Vec::len).sum::<usize>() == self.candidates.len();
        out
    }

    /// Collects the candidates and near misses of a body in one field.
    fn gate(
        &mut self,
        input: &AssociationInput<'_>,
        body: usize,
        field: &FieldObservation,
        predicted: &[Option<PredictedBody>; BODIES],
    ) {
        let Some(own) = &predicted[body] else { return };
        let (camera, area_scale) = (field.camera, input.area_scales[field.camera]);
        let Tuning { gate, gate_px, .. } = input.rig.tuning;
        let view = View { field, dt_s: input.dt_s(field), lines: &input.rig.lines[camera], area_scale };
        for disc in self.covers.markers(body) {
            let expected = Expectation::new(view, &self.covers, disc, own);
            let marker = disc.marker;
            for (blob, seen) in field.blobs().iter().enumerate() {
                let off_px2 = (seen.pixel - disc.image.pixel).norm_squared();
                if seen.colour != disc.colour || off_px2 > gate_px * gate_px {
                    continue;
                }
                let partner = self.covers.partner(disc, seen, area_scale);
                let both = partner.and_then(|partner| expected.with_partner(blob, partner, predicted));
                let both = both.filter(|reading| reading.distance2 < gate);
                let Some(reading) = both.or_else(|| expected.alone(blob)) else { continue };
                let Reading { matched, distance2, growth } = reading;
                if distance2 < gate && self.candidates.len() < MAX_CANDIDATES {
                    self.candidates.push(Candidate { cost: distance2 + growth, body, matched });
                } else if off_px2 < k::NEAR_PX * k::NEAR_PX && self.near.len() < MAX_CANDIDATES {
                    self.near.push(NearMiss { body, camera, marker, blob });
                }
            }
        }
    }
}
