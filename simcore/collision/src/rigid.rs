//! Instrument against the rigid bodies of abstract tasks (paper, section 3.3, case 3): a few convex
//! primitives each. parry3d decides (boxes first, then GJK and EPA); this module is the only place
//! that knows it. Numbers cross the border here: `f64` and mm outside, `f32` inside, always
//! relative to the body, so that nothing large is rounded. parry3d is built with
//! `enhanced-determinism`: the same bits on every processor.

use super::surface::CollisionError;
use super::tool_mesh::{Facet, ToolMesh};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use parry3d::bounding_volume::Aabb;
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::query;
use parry3d::shape::SharedShape;
use protocol::handles::{JAW_LENGTH_MM, Tool};
use std::fmt;

/// A convex body in its own frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub enum Convex {
    /// A ball around the origin.
    Ball {
        /// Radius.
        radius_mm: f64,
    },
    /// A box around the origin.
    Cuboid {
        /// Half of each side.
        half_mm: [f64; 3],
    },
    /// A round rod along z around the origin, with round ends.
    Capsule {
        /// Half of the distance of the ends' centres.
        half_mm: f64,
        /// Radius.
        radius_mm: f64,
    },
    /// The hull of points, four or more that lie in no plane.
    Hull(Vec<[f64; 3]>),
}

/// A convex part of something, ready for parry3d.
#[derive(Clone)]
struct Part {
    /// Body frame from part frame.
    pose: Isometry3<f64>,
    shape: SharedShape,
    /// In the part's own frame.
    bounds: Aabb,
}

impl fmt::Debug for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} at {}", self.shape.shape_type(), self.pose)
    }
}

/// Far above the rounding of a part's place, mm.
const CLEAR_MM: f64 = 1e-2;

fn vector(v: [f64; 3]) -> Vector {
    Vector::new(v[0] as f32, v[1] as f32, v[2] as f32)
}

fn back(v: Vector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

fn pose(p: &Isometry3<f64>) -> Pose {
    let q = p.rotation.quaternion().coords.map(|c| c as f32);
    Pose::from_parts(vector(p.translation.vector.into()), Rotation::from_xyzw(q.x, q.y, q.z, q.w).normalize())
}

impl Part {
    fn new(convex: &Convex, at: Isometry3<f64>) -> Result<Self, CollisionError> {
        let refuse = |size_mm: f64| Err(CollisionError::NoVolume { half_mm: size_mm, depth_mm: size_mm });
        let sizes: Vec<f64> = match convex {
            Convex::Ball { radius_mm } => vec![*radius_mm],
            Convex::Cuboid { half_mm } => half_mm.to_vec(),
            Convex::Capsule { half_mm, radius_mm } => vec![*half_mm, *radius_mm],
            Convex::Hull(points) => points.iter().flatten().map(|c| c.abs() + 1.0).collect(),
        };
        if let Some(&bad) = sizes.iter().find(|s| !(**s > 0.0 && s.is_finite())) {
            return refuse(bad);
        }
        let shape = match convex {
            Convex::Ball { radius_mm } => SharedShape::ball(*radius_mm as f32),
            Convex::Cuboid { half_mm } => {
                let [x, y, z] = half_mm.map(|c| c as f32);
                SharedShape::cuboid(x, y, z)
            }
            Convex::Capsule { half_mm, radius_mm } => {
                SharedShape::capsule_z(*half_mm as f32, *radius_mm as f32)
            }
            Convex::Hull(points) => {
                let points: Vec<Vector> = points.iter().map(|p| vector(*p)).collect();
                if !has_volume(&points) {
                    return refuse(0.0);
                }
                match SharedShape::convex_hull(&points) {
                    Some(shape) => shape,
                    None => return refuse(0.0),
                }
            }
        };
        Ok(Part { pose: at, bounds: shape.compute_local_aabb(), shape })
    }

    /// True if nothing of `other` can touch this part: the ball around its bounds is clear of this
    /// part's bounds.
    fn is_clear_of(&self, other: &Part, other_from_own: &Isometry3<f64>) -> bool {
        let centre = other_from_own.inverse_transform_point(&back(other.bounds.center()).into()).coords;
        let beyond = centre.sup(&back(self.bounds.mins)).inf(&back(self.bounds.maxs)) - centre;
        let reach = f64::from(other.bounds.half_extents().length()) + CLEAR_MM;
        beyond.norm_squared() > reach * reach
    }
}

/// Four of the points span a body: parry3d's hull does not say so itself.
fn has_volume(points: &[Vector]) -> bool {
    let Some(&first) = points.first() else { return false };
    let arms = || points.iter().map(|p| *p - first);
    let far = |a: Vector, b: Vector| if b.length_squared() > a.length_squared() { b } else { a };
    let along = arms().fold(Vector::ZERO, far);
    let normal = arms().map(|a| along.cross(a)).fold(Vector::ZERO, far);
    let height = arms().map(|a| a.dot(normal).abs()).fold(0.0, |m, h| if h > m { h } else { m });
    // Relative to the size: a millionth of it is flat.
    height > 1e-6 * along.length() * normal.length() && normal.length() > 0.0
}

/// A rigid body of convex parts.
#[derive(Debug, Clone)]
pub struct Compound {
    parts: Vec<Part>,
}

/// Where an instrument touches a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidContact {
    /// The instrument's part: 0 the shaft, 1 and 2 the jaws.
    pub instrument_part: usize,
    /// The body's part, in the order of [`Compound::new`].
    pub body_part: usize,
    /// Deepest point of the instrument, in the body's frame, mm.
    pub at_mm: Point3<f64>,
    /// Out of the body, in its frame: the way by which the instrument comes free.
    pub normal: Unit<Vector3<f64>>,
    /// How deep it is inside, mm; 0 at a touch.
    pub depth_mm: f64,
}

impl Compound {
    /// A body of convex parts, each with its pose in the body's frame.
    pub fn new(parts: &[(Convex, Isometry3<f64>)]) -> Result<Self, CollisionError> {
        if parts.is_empty() {
            return Err(CollisionError::Empty);
        }
        let parts: Result<Vec<Part>, CollisionError> =
            parts.iter().map(|(c, at)| Part::new(c, *at)).collect();
        Ok(Compound { parts: parts? })
    }

    /// An instrument: its shaft, and its jaws, closed.
    pub fn instrument(tool: Tool, radius_mm: f64, length_mm: f64) -> Result<Self, CollisionError> {
        let mesh = ToolMesh::new(tool, radius_mm, length_mm);
        let points = |facets: &[Facet], sign: f64| {
            Convex::Hull(facets.iter().flatten().map(|[x, y, z]| [x * sign, *y, *z]).collect())
        };
        let mut parts = vec![(points(&mesh.shaft, 1.0), Isometry3::identity())];
        if !mesh.jaw.is_empty() {
            // Around the pivot, about which they turn.
            let pivot = |facets: &[Facet]| -> Vec<Facet> {
                facets.iter().map(|f| f.map(|[x, y, z]| [x, y, z - JAW_LENGTH_MM])).collect()
            };
            let at = Isometry3::translation(0.0, 0.0, JAW_LENGTH_MM);
            parts.extend([1.0, -1.0].map(|sign| (points(&pivot(&mesh.jaw), sign), at)));
        }
        Self::new(&parts)
    }

    /// Opens the jaws of an instrument by the angle between them, rad.
    pub fn open_jaws(&mut self, jaw_rad: f64) {
        for (part, sign) in self.parts.iter_mut().skip(1).zip([-0.5, 0.5]) {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), jaw_rad * sign);
            part.pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, JAW_LENGTH_MM), turn);
        }
    }

    /// Contacts of an instrument with this body, deepest first in each pair of parts: at most one a
    /// pair. `body_from_instrument` must be finite; what is not touches nothing.
    pub fn contacts(
        &self,
        instrument: &Compound,
        body_from_instrument: &Isometry3<f64>,
        out: &mut Vec<RigidContact>,
    ) {
        out.clear();
        let finite = |v: &[f64]| v.iter().all(|c| c.is_finite());
        let (way, turn) = (&body_from_instrument.translation.vector, &body_from_instrument.rotation.coords);
        if !finite(way.as_slice()) || !finite(turn.as_slice()) {
            return;
        }
        for (i, tool) in instrument.parts.iter().enumerate() {
            let body_from_tool = body_from_instrument * tool.pose;
            for (j, part) in self.parts.iter().enumerate() {
                let part_from_tool = part.pose.inverse() * body_from_tool;
                if tool.is_clear_of(part, &part_from_tool) {
                    continue;
                }
                let found =
                    query::contact(&Pose::IDENTITY, &*part.shape, &pose(&part_from_tool), &*tool.shape, 0.0);
                // Every pair of these shapes is supported; one that is not would touch nothing.
                let Ok(Some(contact)) = found else { continue };
                // Centres that coincide have no direction: out along the instrument.
                let normal = Unit::try_new(back(contact.normal1), 1e-6).unwrap_or_else(Vector3::z_axis);
                out.push(RigidContact {
                    instrument_part: i,
                    body_part: j,
                    at_mm: part.pose * Point3::from(back(contact.point2)),
                    normal: part.pose.rotation * normal,
                    depth_mm: f64::from(-contact.dist).max(0.0),
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn touch(body: &Compound, tool: &Compound, at: &Isometry3<f64>) -> Vec<RigidContact> {
        let mut out = Vec::new();
        body.contacts(tool, at, &mut out);
        out
    }

    fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
        Isometry3::translation(x, y, z)
    }

    #[test]
    fn a_flat_tip_in_a_box_is_as_deep_as_it_is_below_the_top() {
        let body =
            Compound::new(&[(Convex::Cuboid { half_mm: [2.0, 2.0, 0.5] }, at(0.0, 0.0, -0.5))]).unwrap();
        let pipe = Compound::instrument(Tool::LightPipe, 0.25, 2.0).unwrap();
        let [contact] = touch(&body, &pipe, &at(0.3, -0.2, -0.07))[..] else { panic!("one contact") };
        assert!((contact.depth_mm - 0.07).abs() < 1e-5, "{contact:?}");
        assert!((contact.normal.into_inner() - Vector3::z()).norm() < 1e-4, "{contact:?}");
        assert!((contact.at_mm.z + 0.07).abs() < 1e-5, "{contact:?}");
        assert!(touch(&body, &pipe, &at(0.3, -0.2, 0.01)).is_empty());
    }

    #[test]
    fn jaws_open_beside_a_ball_that_closed_ones_would_hit() {
        let ball = Compound::new(&[(Convex::Ball { radius_mm: 0.1 }, at(0.0, 0.0, 0.0))]).unwrap();
        let mut forceps = Compound::instrument(Tool::Forceps, 0.25, 2.0).unwrap();
        let parts = |found: &[RigidContact]| found.iter().map(|c| c.instrument_part).collect::<Vec<_>>();
        assert_eq!(parts(&touch(&ball, &forceps, &at(0.0, 0.0, 0.0))), [1, 2]);
        forceps.open_jaws(0.6);
        assert_eq!(parts(&touch(&ball, &forceps, &at(0.0, 0.0, 0.0))), [] as [usize; 0]);
        // The inner side of the +x jaw is a line through the pivot; a ball nearer to the shaft is
        // between both.
        assert_eq!(parts(&touch(&ball, &forceps, &at(0.0, 0.0, -1.3))), [1, 2]);
    }

    #[test]
    fn what_has_no_volume_is_refused() {
        for convex in [
            Convex::Ball { radius_mm: 0.0 },
            Convex::Cuboid { half_mm: [1.0, f64::NAN, 1.0] },
            Convex::Capsule { half_mm: 1.0, radius_mm: -1.0 },
            Convex::Hull(vec![]),
            Convex::Hull(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]),
        ] {
            let refused = Compound::new(&[(convex.clone(), Isometry3::identity())]);
            assert!(matches!(refused, Err(CollisionError::NoVolume { .. })), "{convex:?}");
        }
        assert_eq!(Compound::new(&[]).unwrap_err(), CollisionError::Empty);
    }

    proptest! {
        /// A ball against a ball-ended rod: depth, normal and point have a closed form, wherever
        /// both lie.
        #[test]
        fn a_ball_and_a_rod_touch_as_geometry_says(
            x in -1.5f64..1.5, y in -1.5f64..1.5, z in -3.0f64..3.0, far in prop::array::uniform3(-12.0f64..12.0),
            angles in prop::array::uniform3(-3.0f64..3.0),
        ) {
            let (r_ball, r_rod, half) = (0.7, 0.4, 1.5);
            let ball = Compound::new(&[(Convex::Ball { radius_mm: r_ball }, at(far[0], far[1], far[2]))]).unwrap();
            let rod = Compound::new(&[(Convex::Capsule { half_mm: half, radius_mm: r_rod }, at(0.0, 0.0, 0.0))]).unwrap();
            // The ball's centre lies at (x, y, z) of the rod's frame.
            let turn = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
            let centre = Vector3::new(far[0], far[1], far[2]);
            let body_from_rod = Isometry3::from_parts(Translation3::from(centre - turn * Vector3::new(x, y, z)), turn);
            let nearest = Vector3::new(0.0, 0.0, z.clamp(-half, half));
            let arm = nearest - Vector3::new(x, y, z);
            let depth = r_ball + r_rod - arm.norm();
            prop_assume!(depth.abs() > 1e-4 && arm.norm() > 0.05);
            let found = touch(&ball, &rod, &body_from_rod);
            prop_assert_eq!(found.len(), usize::from(depth > 0.0));
            if let [contact] = found[..] {
                prop_assert!((contact.depth_mm - depth).abs() < 2e-4, "{:?} {}", contact, depth);
                prop_assert!((contact.normal.into_inner() - turn * arm.normalize()).norm() < 5e-3, "{:?}", contact);
            }
        }
    }
}
