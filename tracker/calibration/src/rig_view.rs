//! What the cameras of a rig see of the workspace, and how well an instrument's tip can be known at each place of it.
//!
//! A tip is put on a grid through the workspace, the shaft through its trocar, in a few turns about its axis. A marker
//! is seen by a camera whose picture has all of it, through the opening of the mechanical eye where it is above. The
//! expected accuracy is that of one frame alone: the Fisher information of the blobs' centres about the pose, with the
//! noise that the tracker takes for a blob of that area; what is known from the frames before makes it better. Hidden
//! markers and those that touch each other in a picture are not counted.

pub mod confused;
pub mod picture;

use nalgebra::{Isometry3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use rig::camera::Camera;
use serde::Serialize;
use tracker::constants::SIGMA_AREA_PX;
use tracker::projection::{MarkerImage, PoseMatrix, pose_jacobian, project_marker};
use tracker::rig_model::RigModel;

/// Steps of the grid from the centre of the workspace to its border.
const STEPS: i32 = 5;
/// Turns about the shaft that are tried at a place.
const ROLLS: usize = 6;
/// A camera that sees a smaller share of the workspace is reported.
const ENOUGH_SEEN: f64 = 0.8;
/// A share of places that fewer than two cameras see, or where the tip is worse than it should be, that is reported.
const REPORTED: f64 = 0.01;
/// How well a tip should be known, µm (standard deviation along the worst direction).
const SHOULD_UM: f64 = 25.0;

/// What is known of a tip at one place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Place {
    /// The tip, in the world, mm.
    pub tip_mm: [f64; 3],
    /// Set of the cameras that see most markers, by their order in the file.
    pub seen_by: u32,
    /// Standard deviation along the worst direction, µm; `None` where a frame does not determine the pose.
    pub sigma_um: Option<f64>,
}

/// What one camera sees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraView {
    /// Id in the rig.
    pub camera: u32,
    /// Share of the workspace in which it sees most markers of an instrument.
    pub sees: f64,
    /// From the centre of the eye, mm.
    pub distance_mm: f64,
    /// Scale at the centre of the eye, px/mm.
    pub px_per_mm: f64,
}

/// How well the tip of an instrument can be known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TipAccuracy {
    /// Its name.
    pub body: &'static str,
    /// Share of the workspace in which two cameras or more see most of its markers.
    pub seen_by_two: f64,
    /// Half of the places are better, µm.
    pub median_um: Option<f64>,
    /// All but a twentieth are better, µm.
    pub p95_um: Option<f64>,
    /// The worst of those that are determined, µm, and where, mm.
    pub worst: Option<(f64, [f64; 3])>,
    /// All places.
    #[serde(skip)]
    pub places: Vec<Place>,
}

impl TipAccuracy {
    /// Share of the workspace in which one frame gives the tip to worse than it should be known.
    fn inaccurate(&self) -> f64 {
        let bad = |p: &&Place| p.sigma_um.is_none_or(|um| um > SHOULD_UM);
        self.places.iter().filter(bad).count() as f64 / self.places.len().max(1) as f64
    }
}

/// A rig as its cameras see it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RigView {
    /// By the order of the file.
    pub cameras: Vec<CameraView>,
    /// Of both instruments.
    pub tips: Vec<TipAccuracy>,
    /// What is missing, in words.
    pub missing: Vec<String>,
}

/// Looks at places of a rig.
pub struct Viewer<'a> {
    rig: &'a Rig,
    model: RigModel,
    cameras: Vec<Camera>,
}

impl<'a> Viewer<'a> {
    /// Of a checked rig.
    pub fn new(rig: &'a Rig) -> Self {
        Viewer { rig, model: RigModel::new(rig), cameras: rig.cameras() }
    }

    /// What is known of the tip of an instrument at a place.
    pub fn place(&self, instrument: usize, tip: Point3<f64>) -> Place {
        let mut votes = vec![0usize; self.cameras.len()];
        let mut variance_um2 = Some(0.0);
        for roll in 0..ROLLS {
            let angle = std::f64::consts::TAU * roll as f64 / ROLLS as f64;
            let pose = PoseMatrix::from(&self.pose(instrument, tip, angle));
            let mut information = Matrix6::zeros();
            for (camera, votes) in self.cameras.iter().zip(&mut votes) {
                let (seen, of_camera) = self.seen(instrument, &pose, camera);
                *votes += usize::from(2 * seen > self.model.bodies[instrument].markers.len());
                information += of_camera;
            }
            variance_um2 = variance_um2.zip(worst_variance_um2(information)).map(|(sum, v)| sum + v);
        }
        let most = |(i, votes): (usize, &usize)| if 2 * votes > ROLLS { 1 << i } else { 0 };
        let seen_by = votes.iter().enumerate().map(most).sum();
        let sigma_um = variance_um2.map(|sum| f64::sqrt(sum / ROLLS as f64));
        Place { tip_mm: tip.coords.into(), seen_by, sigma_um }
    }

    /// The instrument with its tip there and its shaft through the trocar.
    fn pose(&self, instrument: usize, tip: Point3<f64>, roll: f64) -> Isometry3<f64> {
        let above = Vector3::new(0.0, 0.0, 2.0 * self.rig.workspace.tip_radius);
        let trocar = self.rig.trocar(BODY_NAMES[instrument]).map_or(above, |t| Vector3::from(t.p_eye));
        let axis = (trocar - tip.coords).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let along = Rotation3::rotation_between(&Vector3::z(), &axis)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let rotation = along * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
        Isometry3::from_parts(Translation3::from(tip.coords), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// How many markers a camera sees, and what they determine of the pose.
    fn seen(&self, instrument: usize, pose: &PoseMatrix, camera: &Camera) -> (usize, Matrix6<f64>) {
        let (mut count, mut information) = (0, Matrix6::zeros());
        for marker in &self.model.bodies[instrument].markers {
            let image = project_marker(marker, pose, camera).filter(|i| self.is_seen(i, camera));
            let Some(image) = image else { continue };
            let area = image.area_px.clamp(SIGMA_AREA_PX.0, SIGMA_AREA_PX.1);
            let tuning = &self.model.tuning;
            let weights = [tuning.sigma_x_px, tuning.sigma_y_px].map(|s| area / (s * s));
            let jacobian = pose_jacobian(&image, pose);
            for (row, weight) in jacobian.row_iter().zip(weights) {
                information += row.transpose() * row * weight;
            }
            count += 1;
        }
        (count, information)
    }

    /// True of a marker that is wholly in the picture, and not behind the wall of the eye.
    fn is_seen(&self, image: &MarkerImage, camera: &Camera) -> bool {
        let [w, h] = camera.size_px.map(f64::from);
        let r = image.radius_px;
        let inside = (r..w - r).contains(&image.pixel.x) && (r..h - r).contains(&image.pixel.y);
        let (eye, from) = (&self.rig.eye_opening, camera.centre_in_world());
        let up = image.point.z - from.z;
        if image.point.z <= eye.z || up <= 0.0 {
            return inside;
        }
        let passes = from + (image.point - from) * ((eye.z - from.z) / up);
        inside && passes.x.hypot(passes.y) <= eye.radius
    }

    /// What each camera sees, and how well each tip can be known.
    fn seen_of_all(&self) -> (Vec<CameraView>, Vec<TipAccuracy>) {
        let tips: Vec<_> = (0..INSTRUMENTS).map(|i| self.tip(i)).collect();
        let cameras = (0..self.cameras.len()).map(|i| self.camera(i, &tips)).collect();
        (cameras, tips)
    }

    /// How much is missing, as [`lack`].
    fn lack(&self) -> f64 {
        let (cameras, tips) = self.seen_of_all();
        lack(&cameras, &tips)
    }

    /// Everything.
    pub fn view(&self) -> RigView {
        let (cameras, tips) = self.seen_of_all();
        let mut missing = missing(&cameras, &tips);
        if !missing.is_empty() {
            missing.extend(confused::remedy(self.rig));
        }
        let bare = BODY_NAMES[..INSTRUMENTS].iter().filter(|name| self.rig.trocar(name).is_none());
        missing.extend(
            bare.map(|name| {
                format!("{name} has no trocar: its shaft is assumed to come from straight above")
            }),
        );
        RigView { cameras, tips, missing }
    }

    fn tip(&self, instrument: usize) -> TipAccuracy {
        let radius = self.rig.workspace.tip_radius;
        let places: Vec<_> = grid(radius).map(|tip| self.place(instrument, tip)).collect();
        let two = places.iter().filter(|p| p.seen_by.count_ones() >= 2).count();
        let mut known: Vec<_> = places.iter().filter_map(|p| Some((p.sigma_um?, p.tip_mm))).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |share: f64| known.get((known.len() as f64 * share) as usize).map(|k| k.0);
        TipAccuracy {
            body: BODY_NAMES[instrument],
            seen_by_two: two as f64 / places.len() as f64,
            median_um: at(0.5),
            p95_um: at(0.95),
            worst: known.last().copied(),
            places,
        }
    }

    fn camera(&self, i: usize, tips: &[TipAccuracy]) -> CameraView {
        let camera = &self.cameras[i];
        let all = || tips.iter().flat_map(|t| &t.places);
        let seen = all().filter(|p| p.seen_by & (1 << i) != 0).count();
        let depth_mm = camera.in_camera(&Point3::origin()).z;
        CameraView {
            camera: camera.id,
            sees: seen as f64 / all().count().max(1) as f64,
            distance_mm: camera.centre_in_world().coords.norm(),
            px_per_mm: camera.focal_px.x / depth_mm,
        }
    }
}

/// Points of the workspace.
fn grid(radius: f64) -> impl Iterator<Item = Point3<f64>> {
    let steps = move || (-STEPS..=STEPS).map(move |i| radius * f64::from(i) / f64::from(STEPS));
    let all =
        steps().flat_map(move |z| steps().flat_map(move |y| steps().map(move |x| Point3::new(x, y, z))));
    all.filter(move |p| p.coords.norm() <= radius)
}

/// Variance of the tip along its worst direction, µm²; `None` where the blobs leave the pose free.
fn worst_variance_um2(information: Matrix6<f64>) -> Option<f64> {
    let covariance = information.cholesky()?.inverse();
    let of_tip = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let worst = of_tip.symmetric_eigenvalues().max() * 1e6;
    // Beyond a millimetre the pose is free for all purposes.
    (worst.is_finite() && worst < 1e6).then_some(worst)
}

/// How much is missing: the shares that [`missing`] reports, added up; 0 where nothing is.
fn lack(cameras: &[CameraView], tips: &[TipAccuracy]) -> f64 {
    let blind = cameras.iter().map(|c| ENOUGH_SEEN - c.sees).filter(|share| *share > 0.0);
    let tips = tips.iter().flat_map(|tip| [1.0 - tip.seen_by_two, tip.inaccurate()]);
    blind.chain(tips.filter(|share| *share > REPORTED)).sum()
}

fn missing(cameras: &[CameraView], tips: &[TipAccuracy]) -> Vec<String> {
    let percent = |share: f64| (100.0 * share).round();
    let mut all: Vec<_> = cameras
        .iter()
        .filter(|c| c.sees < ENOUGH_SEEN)
        .map(|c| {
            let (id, sees) = (c.camera, percent(c.sees));
            format!("camera {id} sees {sees} % of the workspace: turn it, move it back, or take a wider lens")
        })
        .collect();
    for tip in tips {
        let (body, hidden) = (tip.body, 1.0 - tip.seen_by_two);
        if hidden > REPORTED {
            let hidden = percent(hidden);
            all.push(format!(
                "{body}: fewer than two cameras see its markers in {hidden} % of the workspace"
            ));
        }
        let bad = tip.inaccurate();
        if bad > REPORTED {
            let bad = percent(bad);
            all.push(format!(
                "{body}: one frame gives its tip to worse than {SHOULD_UM} µm in {bad} % of the workspace"
            ));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> Rig {
        Rig::load_or_shipped(None).unwrap()
    }

    #[test]
    fn the_shipped_rig_lacks_nothing() {
        let rig = shipped();
        let view = Viewer::new(&rig).view();
        assert!(view.missing.is_empty(), "{:?}", view.missing);
        for tip in &view.tips {
            let (median, p95) = (tip.median_um.unwrap(), tip.p95_um.unwrap());
            assert!(median > 0.5 && median <= p95 && p95 <= tip.worst.unwrap().0, "{tip:?}");
        }
        assert!((view.cameras[0].distance_mm - 80.0).abs() < 0.1 && view.cameras[0].px_per_mm > 15.0);
    }

    #[test]
    fn a_camera_that_looks_aside_is_named() {
        let mut rig = shipped();
        let turned = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.2);
        let model = rig.cameras[2].model();
        let rotation = turned.matrix() * model.camera_from_world;
        rig.cameras[2].rotation = std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)]));
        rig.cameras[2].t = (turned * model.translation_mm).into();
        let rig = Rig::parse(&rig.to_json(), "turned").unwrap();
        let view = Viewer::new(&rig).view();
        assert!(view.cameras[2].sees < 0.7 && view.cameras[0].sees > 0.85, "{:?}", view.cameras);
        assert!(view.missing[0].starts_with("camera 2 sees"), "{:?}", view.missing);
    }

    #[test]
    fn a_transposed_rotation_and_a_missing_trocar_are_named() {
        let mut rig = shipped();
        let rows = rig.cameras[1].rotation;
        rig.cameras[1].rotation = std::array::from_fn(|r| std::array::from_fn(|c| rows[c][r]));
        let missing = Viewer::new(&rig).view().missing;
        assert!(missing.last().unwrap().contains("if R of camera 1 were transposed"), "{missing:?}");
        let mut rig = shipped();
        rig.trocars.retain(|trocar| trocar.body == "inst0");
        let missing = Viewer::new(&rig).view().missing;
        assert!(missing.last().unwrap().starts_with("inst1 has no trocar"), "{missing:?}");
    }

    /// With one camera fewer there is less information at every place, and with none the pose is free.
    #[test]
    fn every_camera_adds_to_what_is_known() {
        let rig = shipped();
        let mut fewer = rig.clone();
        fewer.cameras.truncate(2);
        let [three, two] = [&rig, &fewer].map(Viewer::new);
        for tip in grid(6.0) {
            let [a, b] = [&three, &two].map(|viewer| viewer.place(0, tip));
            assert!(a.sigma_um.unwrap() < b.sigma_um.unwrap_or(f64::MAX), "{a:?} {b:?}");
        }
        assert_eq!(worst_variance_um2(Matrix6::zeros()), None);
        let sure = worst_variance_um2(Matrix6::from_diagonal_element(4.0)).unwrap();
        assert!((sure - 0.25e6).abs() < 1.0, "1/2 mm: {sure}");
    }

    /// The closed form of one direction: blobs of one camera give a distance across the line of sight to
    /// σ·depth/(focal·√n) or worse.
    #[test]
    fn the_accuracy_is_no_better_than_the_pixels_allow() {
        let rig = shipped();
        let viewer = Viewer::new(&rig);
        let place = viewer.place(1, Point3::origin());
        let tuning = &viewer.model.tuning;
        let area = SIGMA_AREA_PX.1;
        let blobs = (rig.cameras.len() * rig.bodies[1].markers.len()) as f64;
        let least = 1e3 * tuning.sigma_x_px / area.sqrt() / blobs.sqrt() / viewer.camera(0, &[]).px_per_mm;
        assert!(place.sigma_um.unwrap() > least && place.seen_by == 0b111, "{place:?}, {least}");
    }
}
