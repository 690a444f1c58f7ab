//! Projects the markers of a rig into a camera's picture, without noise: the ideal that pixels,
//! blobs and tests are measured against.

use nalgebra::{Isometry3, Matrix2, Point3, Vector2, Vector3};
use protocol::blobs::Colour;
use protocol::limits::{BODIES, MAX_MARKERS};
use protocol::poses::BODY_NAMES;
use rig::camera::Camera;
use rig::{MarkerKind, Rig, RigMarker};
use surgeon::motion::Motion;

/// Tangent of the angle off the axis beyond which the lens model folds back on itself.
const MAX_TANGENT: f64 = 0.7;
/// The visible half of a painted band has its centre this share of the radius before the axis.
const BAND_CENTRE: f64 = std::f64::consts::FRAC_PI_4;

/// A marker as a camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerImage {
    /// Body of the rig: 0 and 1 the instruments, 2 the eye.
    pub body: usize,
    /// Number of the marker in its body.
    pub marker: u32,
    /// Colour class.
    pub colour: Colour,
    /// Centre, px of the frame.
    pub centre_px: Vector2<f64>,
    /// Shape of the outline, px² of the frame: `dᵀ·shape⁻¹·d = 1` on the outline.
    pub shape_px2: Matrix2<f64>,
    /// Distance along the camera's axis, mm.
    pub depth_mm: f64,
}

impl MarkerImage {
    /// Half width and half height of the outline, px of the frame.
    pub fn half_size_px(&self) -> Vector2<f64> {
        Vector2::new(self.shape_px2.m11.sqrt(), self.shape_px2.m22.sqrt())
    }

    /// True if the centre is on the sensor.
    pub fn is_in_frame(&self, camera: &Camera) -> bool {
        let [w, h] = camera.size_px.map(|n| f64::from(n) - 1.0);
        (0.0..=w).contains(&self.centre_px.x) && (0.0..=h).contains(&self.centre_px.y)
    }
}

/// The markers of a rig.
#[derive(Debug, Clone)]
pub struct Markers {
    /// In the order of [`BODY_NAMES`].
    bodies: [Vec<RigMarker>; BODIES],
}

impl Markers {
    /// From a checked rig.
    pub fn of(rig: &Rig) -> Self {
        let markers = |i: usize| rig.body(BODY_NAMES[i]).map_or_else(Vec::new, |b| b.markers.clone());
        Markers { bodies: std::array::from_fn(markers) }
    }

    /// An empty list with room for every marker.
    pub fn list() -> Vec<MarkerImage> {
        Vec::with_capacity(BODIES * MAX_MARKERS)
    }

    /// Fills `images` with every marker of which a part may be in the picture, farthest first.
    pub fn project(&self, camera: &Camera, motion: &Motion, images: &mut Vec<MarkerImage>) {
        images.clear();
        for (body, (markers, pose)) in self.bodies.iter().zip(motion.world_from_body()).enumerate() {
            for marker in markers {
                images.extend(image_of(camera, &pose, marker, body));
            }
        }
        images.sort_unstable_by(|a, b| b.depth_mm.total_cmp(&a.depth_mm));
    }

    /// Movement of a marker's centre from one instant to another, px of the frame; nothing if it
    /// cannot be seen at both.
    pub fn moved_px(&self, camera: &Camera, seen: &MarkerImage, from: &Motion, to: &Motion) -> Vector2<f64> {
        let marker = self.bodies[seen.body].iter().find(|m| m.id == seen.marker);
        let at = |motion: &Motion| {
            image_of(camera, &motion.world_from_body()[seen.body], marker?, seen.body).map(|i| i.centre_px)
        };
        at(to).zip(at(from)).map_or_else(Vector2::zeros, |(to, from)| to - from)
    }
}

/// Image of one marker; `None` where it is behind the camera or outside the picture.
fn image_of(
    camera: &Camera,
    world_from_body: &Isometry3<f64>,
    marker: &RigMarker,
    body: usize,
) -> Option<MarkerImage> {
    let on_axis = world_from_body * Point3::from(marker.p);
    let centre = match marker.kind {
        MarkerKind::Sphere => on_axis,
        MarkerKind::Band => band_centre(camera, world_from_body, on_axis, marker.r),
    };
    let in_camera = camera.in_camera(&centre);
    if in_camera.z <= 1e-6 || in_camera.xy().norm() > MAX_TANGENT * in_camera.z {
        return None;
    }
    // First order in radius over distance: the outline of a small ball is the image of its
    // cross-section, stretched away from the optical axis as perspective does.
    let jacobian = camera.projection_jacobian(&centre)?;
    let image = MarkerImage {
        body,
        marker: marker.id,
        colour: marker.colour,
        centre_px: camera.project(&centre)?,
        shape_px2: jacobian * jacobian.transpose() * (marker.r * marker.r),
        depth_mm: in_camera.z,
    };
    let (half, [w, h]) = (image.half_size_px(), camera.size_px.map(f64::from));
    let c = image.centre_px;
    let visible = c.x > -half.x && c.x < w + half.x && c.y > -half.y && c.y < h + half.y;
    visible.then_some(image)
}

/// Middle of the visible surface of a painted band, in the world.
fn band_centre(
    camera: &Camera,
    world_from_body: &Isometry3<f64>,
    on_axis: Point3<f64>,
    radius_mm: f64,
) -> Point3<f64> {
    let shaft = world_from_body.rotation * Vector3::z();
    let to_camera = camera.centre_in_world() - on_axis;
    let across = to_camera - shaft * shaft.dot(&to_camera);
    on_axis + across.try_normalize(1e-9).unwrap_or_default() * (BAND_CENTRE * radius_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use proptest::prelude::*;
    use scene::{DEFAULT_SCENE, SceneFile};
    use surgeon::motion::MotionSource;

    fn rig() -> Rig {
        Rig::load_or_shipped(None).unwrap()
    }

    /// Point nearest to all rays, least squares.
    fn triangulate(rays: &[(Point3<f64>, Vector3<f64>)]) -> Point3<f64> {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (origin, direction) in rays {
            let across = Matrix3::identity() - direction * direction.transpose();
            a += across;
            b += across * origin.coords;
        }
        Point3::from(a.try_inverse().unwrap() * b)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn triangulated_images_give_the_markers_back(t_ns in 0u64..16_000_000_000) {
            let rig = rig();
            let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
            let motion = MotionSource::new(&scene, &rig, None, 3).at(t_ns);
            let markers = Markers::of(&rig);
            let mut seen = Markers::list();
            let mut all = Vec::new();
            for camera in rig.cameras() {
                markers.project(&camera, &motion, &mut seen);
                all.extend(seen.iter().map(|m| {
                    let ray = camera.ray_in_world(m.centre_px).unwrap();
                    (m.body, m.marker, camera.centre_in_world(), ray)
                }));
            }
            let mut checked = 0;
            for (b, pose) in motion.world_from_body().iter().enumerate() {
                for marker in &rig.body(BODY_NAMES[b]).unwrap().markers {
                    let own = all.iter().filter(|(body, id, ..)| (*body, *id) == (b, marker.id));
                    let rays: Vec<_> = own.map(|&(_, _, origin, ray)| (origin, ray)).collect();
                    if rays.len() >= 2 {
                        let truth = pose * Point3::from(marker.p);
                        prop_assert!((triangulate(&rays) - truth).norm() < 1e-8);
                        checked += 1;
                    }
                }
            }
            prop_assert!(checked >= 12, "{checked} of 14 markers in two cameras");
        }
    }

    #[test]
    fn outline_is_the_shadow_of_the_ball() {
        let rig = rig();
        let camera = &rig.cameras()[0];
        let pose = Isometry3::translation(3.0, -2.0, -5.0);
        let marker = &rig.bodies[0].markers[0];
        let image = image_of(camera, &pose, marker, 0).unwrap();
        let centre = pose * Point3::from(marker.p);
        // Farthest image point of the ball's surface in +x, found by search.
        let mut right: f64 = 0.0;
        for i in 0..200 {
            for j in 0..100 {
                let (a, b) = (f64::from(i) * 0.0314, f64::from(j) * 0.0314);
                let n = Vector3::new(libm::sin(b) * libm::cos(a), libm::sin(b) * libm::sin(a), libm::cos(b));
                right = right.max(camera.project(&(centre + n * marker.r)).unwrap().x - image.centre_px.x);
            }
        }
        assert!((right - image.half_size_px().x).abs() < 0.1, "{right} {}", image.half_size_px().x);
    }

    #[test]
    fn points_behind_and_beside_the_camera_are_not_seen() {
        let rig = rig();
        let camera = &rig.cameras()[0];
        let towards = |mm: f64, aside: f64| {
            let axis = camera.camera_from_world.transpose() * Vector3::new(aside, 0.0, mm);
            Isometry3::from_parts((camera.centre_in_world().coords + axis).into(), Default::default())
        };
        let marker = &rig.bodies[0].markers[0];
        assert!(image_of(camera, &towards(80.0, 0.0), marker, 0).is_some());
        assert!(image_of(camera, &towards(-80.0, 0.0), marker, 0).is_none());
        assert!(image_of(camera, &towards(80.0, 400.0), marker, 0).is_none());
    }

    #[test]
    fn band_lies_before_its_axis() {
        let rig = rig();
        let camera = &rig.cameras()[0];
        let pose = Isometry3::identity();
        let centre = band_centre(camera, &pose, Point3::origin(), 0.4);
        assert!((centre.coords.norm() - 0.4 * BAND_CENTRE).abs() < 1e-12 && centre.z.abs() < 1e-12);
        assert!((camera.centre_in_world() - centre).norm() < camera.centre_in_world().coords.norm());
    }
}
