//! Which blob is which marker of a body whose pose is predicted: by colour, size and distance,
//! nearest first, each blob and each marker once in a camera-field.

use crate::constants as k;
use crate::filter::Matrix6;
use crate::fit::{Match, carried, pose_jacobian};
use crate::model::RigModel;
use crate::sight::{Placed, View, camera_of, covariance_as, image_of};
use nalgebra::{Isometry3, Vector3};
use protocol::limits::{BODIES, MAX_CAMERAS};

/// Room for candidates; beyond it the farthest would be clutter.
const MAX_CANDIDATES: usize = 4096;

/// A blob that may be a marker.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    distance2: f64,
    body: usize,
    matched: Match,
}

/// Where a body should be.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Pose at the group's instant.
    pub pose: Isometry3<f64>,
    /// Covariance of the pose.
    pub covariance: Matrix6,
    /// Velocity and angular velocity.
    pub motion: [Vector3<f64>; 2],
    /// Factor on all variances of blobs.
    pub variance_scale: f64,
}

/// The camera-fields of one instant.
pub struct Group<'a> {
    /// The rig.
    pub rig: &'a RigModel,
    /// Newest view of each camera.
    pub views: &'a [View; MAX_CAMERAS],
    /// Set of the cameras whose view belongs to this instant.
    pub cameras: u32,
    /// The instant.
    pub base_ns: u64,
    /// The cameras' area scales.
    pub area_scales: &'a [f64; MAX_CAMERAS],
}

/// Finds matches; keeps its memory between calls.
pub struct Associator {
    candidates: Vec<Candidate>,
    /// Blobs of a marker's colour near it that are not it, by body, camera, marker and blob.
    near: Vec<(usize, usize, usize, usize)>,
    /// Markers of each body that nobody was taken for while something of their colour was near.
    pub strays: [u32; BODIES],
    blobs_used: [u64; MAX_CAMERAS],
    markers_used: [[u32; MAX_CAMERAS]; BODIES],
}

impl Default for Associator {
    fn default() -> Self {
        Associator {
            candidates: Vec::with_capacity(MAX_CANDIDATES),
            near: Vec::with_capacity(MAX_CANDIDATES),
            strays: [0; BODIES],
            blobs_used: [0; MAX_CAMERAS],
            markers_used: [[0; MAX_CAMERAS]; BODIES],
        }
    }
}

impl Associator {
    /// Fills `matches` of every body that is expected somewhere. True if there was no choice: every
    /// blob could be one marker only, and every marker one blob.
    pub fn associate(
        &mut self,
        group: &Group<'_>,
        expected: &[Option<Expected>; BODIES],
        matches: &mut [Vec<Match>; BODIES],
    ) -> bool {
        self.candidates.clear();
        self.near.clear();
        self.blobs_used = [0; MAX_CAMERAS];
        self.markers_used = [[0; MAX_CAMERAS]; BODIES];
        for (body, expected) in expected.iter().enumerate() {
            let Some(expected) = expected else { continue };
            for view in group.views.iter().filter(|v| group.cameras & (1 << v.camera) != 0) {
                self.collect(group, body, view, expected);
            }
        }
        self.candidates.sort_unstable_by(|a, b| {
            let key = |c: &Candidate| (c.body, c.matched.camera, c.matched.marker, c.matched.blob);
            a.distance2.total_cmp(&b.distance2).then_with(|| key(a).cmp(&key(b)))
        });
        for list in matches.iter_mut() {
            list.clear();
        }
        for c in &self.candidates {
            let m = &c.matched;
            let (blob, marker) = (1u64 << m.blob, 1u32 << m.marker);
            let free =
                self.blobs_used[m.camera] & blob == 0 && self.markers_used[c.body][m.camera] & marker == 0;
            if free {
                self.blobs_used[m.camera] |= blob;
                self.markers_used[c.body][m.camera] |= marker;
                matches[c.body].push(*m);
            }
        }
        self.strays = [0; BODIES];
        for &(body, camera, marker, blob) in &self.near {
            let unmatched = self.markers_used[body][camera] & (1 << marker) == 0;
            if unmatched && self.blobs_used[camera] & (1 << blob) == 0 {
                self.strays[body] += 1;
            }
        }
        matches.iter().map(Vec::len).sum::<usize>() == self.candidates.len()
    }

    fn collect(&mut self, group: &Group<'_>, body: usize, view: &View, expected: &Expected) {
        let Some(camera) = camera_of(group.rig, view) else { return };
        let area_scale = group.area_scales[view.camera];
        let dt_s = (view.exposed_ns as i64).wrapping_sub(group.base_ns as i64) as f64 * 1e-9;
        let pose = Placed::from(&carried(&expected.pose, &expected.motion, dt_s));
        for (marker, m) in group.rig.bodies[body].markers.iter().enumerate() {
            let Some(image) = image_of(m, &pose, camera) else { continue };
            let jacobian = pose_jacobian(&image, &pose);
            let predicted = jacobian * expected.covariance * jacobian.transpose();
            for (blob, sight) in view.sights().iter().enumerate() {
                let r = sight.pixel - image.pixel;
                if sight.colour != m.colour || r.norm_squared() > k::GATE_PX * k::GATE_PX {
                    continue;
                }
                let Some(covariance) = covariance_as(sight, &image, area_scale, k::AREA_RATIO) else {
                    continue;
                };
                let Some(inverse) = (predicted + covariance * expected.variance_scale).try_inverse() else {
                    continue;
                };
                let distance2 = r.dot(&(inverse * r));
                // `covariance` grows with a wrong size; the logarithm of its determinant keeps such
                // a blob from winning because of its own doubt.
                let doubt = libm::log((covariance.determinant() / sight.covariance.determinant()).max(1.0));
                if distance2 < k::GATE && self.candidates.len() < MAX_CANDIDATES {
                    let area_ratio = sight.area_px / image.area_px;
                    let pixel = sight.pixel;
                    let camera = view.camera;
                    let clean = covariance == sight.covariance;
                    let out = false;
                    let matched =
                        Match { camera, blob, marker, pixel, covariance, dt_s, area_ratio, clean, out };
                    self.candidates.push(Candidate { distance2: distance2 + doubt, body, matched });
                } else if r.norm_squared() < k::NEAR_PX * k::NEAR_PX && self.near.len() < MAX_CANDIDATES {
                    self.near.push((body, view.camera, marker, blob));
                }
            }
        }
    }
}
