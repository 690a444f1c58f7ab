//! Rigid bodies of the abstract tasks: key `bodies`.

use super::{Defect, Range, refuse, shown};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Most bodies of a scene.
pub const MAX_BODIES: usize = 16;

/// Rigid bodies that lie on the retina and can be pushed, picked up and placed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodiesScene {
    /// What of gravity the fluid leaves, mm/s²; it acts towards −z of the world, away from the
    /// microscope.
    pub weight_mm_s2: f64,
    /// Damping of movement and rotation by the fluid, 1/s.
    pub damping_per_s: f64,
    /// The bodies, in the order of their numbers.
    pub body: Vec<BodyScene>,
}

/// A shape of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BodyShape {
    /// A ball; all half extents are its radius.
    Sphere,
    /// A box around the origin.
    Box,
    /// A round rod along z with round ends: the first two half extents are its radius, the third is
    /// half of its whole length.
    Capsule,
}

/// A body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyScene {
    /// What it is.
    pub shape: BodyShape,
    /// Half of its size along its x, y and z, mm.
    pub half_extents_mm: [f64; 3],
    /// Where its centre is at the start, eye frame, mm.
    pub position_in_eye_mm: [f64; 3],
    /// Mass, g.
    pub mass_g: f64,
    /// Friction: share of the pressing force that holds against sliding, between it and whatever it
    /// touches.
    pub friction: f64,
    /// Linear RGB and opacity.
    pub rgba: [f32; 4],
}

impl BodyScene {
    /// The axis along which the body is longest, in its own frame; the first of equals.
    pub fn longest_axis(&self) -> Vector3<f64> {
        let [x, y, z] = self.half_extents_mm;
        if x >= y && x >= z {
            Vector3::x()
        } else if y >= z {
            Vector3::y()
        } else {
            Vector3::z()
        }
    }
}

impl BodiesScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        let mut ranges = vec![
            ("bodies.weight_mm_s2", self.weight_mm_s2, 0.0, 1e5),
            ("bodies.damping_per_s", self.damping_per_s, 0.0, 1e4),
        ];
        for body in &self.body {
            let place = body.position_in_eye_mm;
            ranges.extend(body.half_extents_mm.map(|half| ("bodies.body.half_extents_mm", half, 0.05, 5.0)));
            ranges.extend(place.map(|c| ("bodies.body.position_in_eye_mm", c, -20.0, 20.0)));
            ranges.extend(body.rgba.map(|c| ("bodies.body.rgba", f64::from(c), 0.0, 1.0)));
            ranges.push(("bodies.body.mass_g", body.mass_g, 1e-6, 10.0));
            ranges.push(("bodies.body.friction", body.friction, 0.0, 2.0));
        }
        ranges
    }

    /// What is wrong beyond the ranges: key, what would be right, what is there.
    pub(super) fn defect(&self, retina_radius_mm: f64) -> Option<Defect> {
        if !(1..=MAX_BODIES).contains(&self.body.len()) {
            return refuse("bodies.body", format!("1 to {MAX_BODIES} bodies"), self.body.len());
        }
        for (i, body) in self.body.iter().enumerate() {
            let [x, y, z] = body.half_extents_mm;
            let right = match body.shape {
                BodyShape::Sphere => x == y && y == z,
                BodyShape::Capsule => x == y && z > x,
                BodyShape::Box => true,
            };
            if !right {
                let expected = "three equal ones for a sphere, two equal ones and a longer one for a capsule";
                let found = format!("{:?} of a {}, body {i}", body.half_extents_mm, shown(&body.shape));
                return refuse("bodies.body.half_extents_mm", expected, found);
            }
            let radius = if body.shape == BodyShape::Box { norm([x, y, z]) } else { z };
            let reach = norm(body.position_in_eye_mm) + radius;
            if reach > retina_radius_mm {
                let expected = format!("the whole body within {retina_radius_mm} mm of the eye's centre");
                let found = format!("{reach:.3} mm, body {i}");
                return refuse("bodies.body.position_in_eye_mm", expected, found);
            }
        }
        None
    }
}

fn norm([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use crate::SceneFile;

    #[test]
    fn defects_of_bodies_are_named() {
        let text = crate::SHIPPED.iter().find(|(name, _)| *name == "bodies").unwrap().1;
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            SceneFile::parse(&text.replacen(from, to, 1), "s.toml").unwrap_err().to_string()
        };
        assert!(refused("mass_g = ", "mass_g = -1 #").contains("bodies.body.mass_g"));
        assert!(refused("weight_mm_s2 = ", "weight_mm_s2 = nan #").contains("bodies.weight_mm_s2"));
        let ball = refused("half_extents_mm = [", "half_extents_mm = [0.05, 0.9, 0.05] #");
        assert!(ball.contains("equal ones for a sphere") && ball.contains("body 0"), "{ball}");
        let outside = refused("position_in_eye_mm = [", "position_in_eye_mm = [0, 0, -11.4] #");
        assert!(outside.contains("within 11.5 mm"), "{outside}");
        assert!(refused("shape = \"sphere\"", "shape = \"cone\"").contains("cone"));
    }
}
