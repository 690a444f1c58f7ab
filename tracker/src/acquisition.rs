//! Acquisition of a body without a prediction: triangulate all pairs of blobs of one colour whose
//! rays meet, find three points with the distances of three markers, align the body with them, and
//! score the pose by the blobs of all cameras.

use crate::constants as k;
use crate::fit::{BlobMatch, PoseFit, PoseProblem, TrocarInWorld, trocar_miss};
use crate::observation::{FieldObservation, camera_of, marker_covariance};
use crate::pose_math::Matrix6;
use crate::projection::{PoseMatrix, project_marker};
use crate::rig_model::{BodyModel, RigModel, Triple};
use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::limits::{MAX_BLOBS, MAX_CAMERAS};

/// A point triangulated from two blobs of one colour.
#[derive(Debug, Clone, Copy)]
struct TriangulatedPoint {
    position: Point3<f64>,
    colour: u32,
}

/// Input of a search.
pub struct AcquisitionInput<'a> {
    /// The rig.
    pub rig: &'a RigModel,
    /// Newest field of each camera.
    pub fields: &'a [FieldObservation; MAX_CAMERAS],
    /// Set of the cameras whose blobs the pose is fitted to.
    pub cameras: u32,
    /// Set of the cameras in which it is sought. Two cameras may see too few markers together and yet determine the pose
    /// of an instrument: one that was moved by a few pixels still shows about where its markers are.
    pub sought_in: u32,
    /// Instant of the pose, ns.
    pub time_ns: u64,
    /// The body's trocar, if the eye is tracked.
    pub trocar: Option<TrocarInWorld>,
    /// Running ratio of seen to expected blob areas, by camera.
    pub area_scales: &'a [f64; MAX_CAMERAS],
}

/// Searches for bodies; its memory is reused.
pub struct Acquisition {
    rays: Box<[[Option<Vector3<f64>>; MAX_BLOBS]; MAX_CAMERAS]>,
    points: Vec<TriangulatedPoint>,
    /// Blobs of the pose found last.
    pub matches: Vec<BlobMatch>,
}

impl Default for Acquisition {
    fn default() -> Self {
        Acquisition {
            rays: Box::new([[None; MAX_BLOBS]; MAX_CAMERAS]),
            points: Vec::with_capacity(k::ACQUISITION_POINTS),
            matches: Vec::with_capacity(crate::fit::MAX_MATCHES),
        }
    }
}

/// A copy of a tracker gets work space of its own, which grows when it is first used.
impl Clone for Acquisition {
    fn clone(&self) -> Self {
        Acquisition {
            rays: Box::new([[None; MAX_BLOBS]; MAX_CAMERAS]),
            points: Vec::new(),
            matches: Vec::new(),
        }
    }
}

impl AcquisitionInput<'_> {
    /// Recent fields of a set of cameras.
    fn recent(&self, cameras: u32) -> impl Iterator<Item = &FieldObservation> + Clone {
        self.fields.iter().filter(move |field| {
            cameras & (1 << field.camera) != 0
                && field.exposed_ns > 0
                && self.time_ns.abs_diff(field.exposed_ns) <= self.rig.at_rate.acquisition_ns
        })
    }
}

impl Acquisition {
    /// The pose of `body`, if enough unassigned blobs agree on one; these are then in `matches`.
    pub fn search(&mut self, input: &AcquisitionInput<'_>, body: &BodyModel) -> Option<PoseFit> {
        self.triangulate(input, body);
        let mut best: Option<(f64, Isometry3<f64>)> = None;
        let (mut trials, mut scored) = (0, 0);
        let recent = input.recent(input.sought_in).count();
        let convincing = k::ACQUISITION_SCORE * (recent * body.markers.len()) as f64;
        for triple in &body.triples {
            self.for_each_pose(body, triple, |pose| {
                trials += 1;
                let so_far = best.map_or(0.0, |(s, _)| s);
                if is_plausible(input, body, &pose) {
                    scored += 1;
                    let score = score(input, body, &pose, so_far);
                    if score > so_far {
                        best = Some((score, pose));
                    }
                }
                let convinced = best.is_some_and(|(s, _)| s >= convincing);
                trials < k::ACQUISITION_TRIALS && scored < k::ACQUISITION_SCORED && !convinced
            });
            if best.is_some_and(|(s, _)| s >= convincing) {
                break;
            }
        }
        self.refine(input, body, &best?.1)
    }

    fn triangulate(&mut self, input: &AcquisitionInput<'_>, body: &BodyModel) {
        self.points.clear();
        let wanted = |colour: u32| body.markers.iter().any(|m| m.colour == colour);
        for field in input.recent(input.sought_in) {
            let Some(camera) = camera_of(input.rig, field) else { continue };
            for (blob, seen) in field.blobs().iter().enumerate() {
                let use_it = field.is_unassigned(blob) && wanted(seen.colour);
                self.rays[field.camera][blob] = if use_it { camera.ray_in_world(seen.pixel) } else { None };
            }
        }
        let limit = input.rig.tip_radius + body.reach + 5.0;
        let mut fields = input.recent(input.sought_in);
        while let Some(a) = fields.next() {
            for b in fields.clone() {
                self.triangulate_pair(input, a, b, limit);
            }
        }
    }

    fn triangulate_pair(
        &mut self,
        input: &AcquisitionInput<'_>,
        a: &FieldObservation,
        b: &FieldObservation,
        limit: f64,
    ) {
        let (Some(camera_a), Some(camera_b)) = (camera_of(input.rig, a), camera_of(input.rig, b)) else {
            return;
        };
        let origins = [camera_a.centre_in_world(), camera_b.centre_in_world()];
        for (i, blob_a) in a.blobs().iter().enumerate() {
            let Some(ray_a) = self.rays[a.camera][i] else { continue };
            for (j, blob_b) in b.blobs().iter().enumerate() {
                let Some(ray_b) = self.rays[b.camera][j] else { continue };
                if blob_a.colour != blob_b.colour || self.points.len() >= k::ACQUISITION_POINTS {
                    continue;
                }
                if let Some((position, miss)) = nearest_point(&origins, &[ray_a, ray_b])
                    && miss < k::RAY_MISS_MM
                    && position.coords.norm() < limit
                {
                    self.points.push(TriangulatedPoint { position, colour: blob_a.colour });
                }
            }
        }
    }

    /// Calls `visit` with the pose of every three points that fit the triple, until it returns
    /// false.
    fn for_each_pose(
        &self,
        body: &BodyModel,
        triple: &Triple,
        mut visit: impl FnMut(Isometry3<f64>) -> bool,
    ) {
        let markers = triple.markers.map(|m| body.markers[m]);
        let fits = |a: &TriangulatedPoint, b: &TriangulatedPoint, distance: f64| {
            ((a.position - b.position).norm() - distance).abs() < k::MARKER_DISTANCE_MM
        };
        let of = |n: usize| self.points.iter().filter(move |p| p.colour == markers[n].colour);
        for a in of(0) {
            for b in of(1).filter(|b| fits(a, b, triple.distances[0])) {
                for c in of(2).filter(|c| fits(a, c, triple.distances[1]) && fits(b, c, triple.distances[2]))
                {
                    let from = markers.map(|m| m.position);
                    let to = [a.position, b.position, c.position];
                    let Some(pose) = pose_from_triples(&from, &to) else { continue };
                    if !visit(pose) {
                        return;
                    }
                }
            }
        }
    }

    /// Fits the hypothesis to all unassigned blobs near it.
    fn refine(
        &mut self,
        input: &AcquisitionInput<'_>,
        body: &BodyModel,
        pose: &Isometry3<f64>,
    ) -> Option<PoseFit> {
        let prior_sigma = if body.is_eye { k::EYE_CENTRE_MM } else { 2.0 };
        let mut prior_information = Matrix6::identity() * (1.0 / (0.3 * 0.3));
        prior_information.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(1.0 / (prior_sigma * prior_sigma));
        let mut start = *pose;
        if body.is_eye {
            start.translation.vector = Vector3::zeros();
        }
        let problem = PoseProblem {
            rig: input.rig,
            body,
            prior: start,
            prior_information,
            motion: [Vector3::zeros(); 2],
            given: None,
            trocar: input.trocar,
            variance_scale: k::ACQUISITION_VARIANCE,
        };
        self.collect(input, body, &start);
        let rough = problem.solve(&start, &mut self.matches)?;
        self.collect(input, body, &rough.pose);
        let fit = problem.solve(&rough.pose, &mut self.matches)?;
        let kept = || self.matches.iter().filter(|m| !m.outlier);
        let markers = kept().fold(0u32, |set, m| set | 1 << m.marker).count_ones();
        let cameras = kept().fold(0u32, |set, m| set | 1 << m.camera).count_ones();
        let shows_roll = kept().any(|m| body.is_eye || body.observes_roll(m.marker));
        let good =
            markers >= 3 && cameras >= 2 && fit.blobs >= 6 && fit.outliers * 3 <= fit.blobs && shows_roll;
        // The eye's centre is known: cameras that disagree do not fit it.
        let tolerance = if body.is_eye { 1.0 } else { k::ACQUISITION_VARIANCE };
        let close = fit.reduced_chi2().is_some_and(|c| c < input.rig.tuning.bad_fit * tolerance);
        (good && close && is_plausible(input, body, &fit.pose)).then_some(fit)
    }

    /// Collects the nearest unassigned blob of each marker in each camera.
    fn collect(&mut self, input: &AcquisitionInput<'_>, body: &BodyModel, pose: &Isometry3<f64>) {
        self.matches.clear();
        let pose = &PoseMatrix::from(pose);
        for field in input.recent(input.cameras) {
            let first = self.matches.len();
            for marker in 0..body.markers.len() {
                if let Some((_, m)) = nearest_blob(input, body, field, pose, marker)
                    && self.matches[first..].iter().all(|other| other.blob != m.blob)
                {
                    self.matches.push(m);
                }
            }
        }
    }
}

/// The point nearest to two rays, and the distance of the rays, mm.
fn nearest_point(origins: &[Point3<f64>; 2], rays: &[Vector3<f64>; 2]) -> Option<(Point3<f64>, f64)> {
    let between = origins[1] - origins[0];
    let cos = rays[0].dot(&rays[1]);
    let det = 1.0 - cos * cos;
    if det < 1e-9 {
        return None;
    }
    let (a, b) = (between.dot(&rays[0]), between.dot(&rays[1]));
    let (s, t) = ((a - b * cos) / det, (a * cos - b) / det);
    let (p, q) = (origins[0] + rays[0] * s, origins[1] + rays[1] * t);
    (s > 0.0 && t > 0.0).then(|| (nalgebra::center(&p, &q), (p - q).norm()))
}

/// The pose that aligns three points with three others by the frames of the two triangles (TRIAD)
/// and their centroids; an initial value for the fit.
fn pose_from_triples(from: &[Point3<f64>; 3], to: &[Point3<f64>; 3]) -> Option<Isometry3<f64>> {
    let frame = |p: &[Point3<f64>; 3]| {
        let x = (p[1] - p[0]).try_normalize(1e-6)?;
        let z = x.cross(&(p[2] - p[0])).try_normalize(1e-6)?;
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    let rotation = frame(to)? * frame(from)?.transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let centre = |p: &[Point3<f64>; 3]| (p[0].coords + p[1].coords + p[2].coords) / 3.0;
    Some(Isometry3::from_parts(Translation3::from(centre(to) - rotation * centre(from)), rotation))
}

/// True if a pose is possible: the eye at the origin, a tip within reach, a shaft through its
/// trocar.
fn is_plausible(input: &AcquisitionInput<'_>, body: &BodyModel, pose: &Isometry3<f64>) -> bool {
    let distance = pose.translation.vector.norm();
    if body.is_eye {
        return distance < 2.0 * k::MARKER_DISTANCE_MM;
    }
    let through = input.trocar.is_none_or(|t| trocar_miss(pose, &t.position).norm() < k::TROCAR_MISS_MM);
    through && distance < input.rig.tip_radius + 5.0
}

/// The unassigned blob nearest to a marker, with its score from 0 to 1.
fn nearest_blob(
    input: &AcquisitionInput<'_>,
    body: &BodyModel,
    field: &FieldObservation,
    pose: &PoseMatrix,
    marker: usize,
) -> Option<(f64, BlobMatch)> {
    let camera = camera_of(input.rig, field)?;
    let m = &body.markers[marker];
    let image = project_marker(m, pose, camera)?;
    let dt = input.time_ns.abs_diff(field.exposed_ns) as f64 * 1e-9;
    // An eye turns about its centre, and slower than hands move.
    let speed = if body.is_eye {
        k::START_EYE_TURN_RAD_S * m.position.coords.norm()
    } else {
        k::ACQUISITION_SPEED_MM_S
    };
    let px_per_s = speed * image.radius_px / m.radius;
    let drift = px_per_s * dt;
    let mut best: Option<(f64, BlobMatch)> = None;
    for (blob, seen) in field.blobs().iter().enumerate() {
        if seen.colour != m.colour || !field.is_unassigned(blob) {
            continue;
        }
        let fit = 1.0
            - (seen.pixel - image.pixel).norm_squared() / (k::ACQUISITION_GATE_PX * k::ACQUISITION_GATE_PX);
        if fit <= 0.0 || best.as_ref().is_some_and(|(f, _)| *f >= fit) {
            continue;
        }
        let scale = input.area_scales[field.camera];
        let Some(covariance) = marker_covariance(seen, &image, scale, k::ACQUISITION_AREA_RATIO) else {
            continue;
        };
        // How the body moves is not known: what it may have moved until the line was exposed, too.
        let late_px = input.rig.lines[field.camera].dt_s(0.0, seen.pixel.y).abs() * px_per_s;
        let drift = drift + late_px;
        let mut matched = BlobMatch::new(field, blob, marker, &image, covariance, 0.0);
        matched.covariance += Matrix2::identity() * (drift * drift);
        best = Some((fit, matched));
    }
    best
}

/// Sum of the scores of all markers in all cameras; 0 where that cannot exceed `to_beat`.
fn score(input: &AcquisitionInput<'_>, body: &BodyModel, pose: &Isometry3<f64>, to_beat: f64) -> f64 {
    let mut sum = 0.0;
    let pose = &PoseMatrix::from(pose);
    let fields = input.recent(input.sought_in);
    let mut left = (fields.clone().count() * body.markers.len()) as f64;
    for field in fields {
        for marker in 0..body.markers.len() {
            sum += nearest_blob(input, body, field, pose, marker).map_or(0.0, |(fit, _)| fit);
            left -= 1.0;
            if sum + left <= to_beat {
                return 0.0;
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn triples_are_aligned(
            p in prop::array::uniform3(-6.0..6.0f64), r in prop::array::uniform3(-3.0..3.0f64),
        ) {
            let truth = Isometry3::new(Vector3::from(p), Vector3::from(r));
            let from = [Point3::new(0.0, 0.0, 1.0), Point3::new(0.0, 0.0, 9.0), Point3::new(0.9, 0.0, 6.5)];
            let pose = pose_from_triples(&from, &from.map(|q| truth * q)).unwrap();
            prop_assert!(crate::pose_math::box_minus(&pose, &truth).norm() < 1e-6);
        }

        #[test]
        fn rays_to_one_point_meet_there(p in prop::array::uniform3(-6.0..6.0f64)) {
            let point = Point3::from(Vector3::from(p));
            let origins = [Point3::new(-50.0, 10.0, -60.0), Point3::new(50.0, 0.0, -60.0)];
            let rays = origins.map(|o| (point - o).normalize());
            let (found, miss) = nearest_point(&origins, &rays).unwrap();
            prop_assert!((found - point).norm() < 1e-9 && miss < 1e-9);
        }
    }
}
