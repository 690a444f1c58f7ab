//! What the next step must know of a sheet of tissue.

use crate::membrane::sheet::Sheet;
use collision::surface::Surface;
use nalgebra::Vector3;
use protocol::limits::INSTRUMENTS;
use protocol::scene::{NODE_BOUND, NODE_DEAD, NODE_FREE};
use serde::{Deserialize, Serialize};

/// Node flag: fixed to the retina (drawn like a free node).
pub const NODE_PINNED: u32 = 2;

/// A node in the jaws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeldNode {
    /// Node of the membrane.
    pub node: u32,
    /// Where, in the instrument's frame, mm.
    pub at_in_instrument_mm: [f32; 3],
}

/// The membrane: arrays over nodes (x, y and z apart), springs and triangles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MembraneState {
    /// Positions in the eye frame, mm.
    #[serde(with = "crate::pod_serde::lists")]
    pub position_mm: [Vec<f32>; 3],
    /// Velocities in the eye frame, mm/s.
    #[serde(with = "crate::pod_serde::lists")]
    pub velocity_mm_s: [Vec<f32>; 3],
    /// `NODE_FREE`, `NODE_DEAD`, [`NODE_PINNED`] or `NODE_BOUND` + instrument.
    #[serde(with = "crate::pod_serde::list")]
    pub flag: Vec<u32>,
    /// Rest lengths of the springs where they creep, mm; empty where the tissue is elastic.
    #[serde(with = "crate::pod_serde::list")]
    pub rest_mm: Vec<f32>,
    /// 1 for a living structural spring.
    #[serde(with = "crate::pod_serde::list")]
    pub spring_alive: Vec<u8>,
    /// 1 for a living triangle.
    #[serde(with = "crate::pod_serde::list")]
    pub triangle_alive: Vec<u8>,
    /// Counts the changes of triangles.
    pub topology: u64,
    /// The warning about the force on the rim is out.
    pub rim_warned: bool,
}

impl MembraneState {
    /// As the collision queries see it.
    pub fn surface<'a>(&'a self, sheet: &'a Sheet) -> Surface<'a> {
        let position_mm = self.position_mm.each_ref().map(Vec::as_slice);
        Surface { position_mm, triangles: &sheet.triangles, alive: &self.triangle_alive }
    }

    /// Position of a node, eye frame, mm.
    pub fn position(&self, node: usize) -> Vector3<f32> {
        let [x, y, z] = &self.position_mm;
        Vector3::new(x[node], y[node], z[node])
    }

    /// Moves a node to `p`, eye frame, mm.
    pub fn set_position(&mut self, node: usize, p: Vector3<f32>) {
        for (axis, values) in self.position_mm.iter_mut().enumerate() {
            values[node] = p[axis];
        }
    }

    /// Velocity of a node, eye frame, mm/s.
    pub fn velocity(&self, node: usize) -> Vector3<f32> {
        let [x, y, z] = &self.velocity_mm_s;
        Vector3::new(x[node], y[node], z[node])
    }

    /// Sets the velocity of a node, eye frame, mm/s.
    pub fn set_velocity(&mut self, node: usize, v: Vector3<f32>) {
        for (axis, values) in self.velocity_mm_s.iter_mut().enumerate() {
            values[node] = v[axis];
        }
    }

    /// True if the box around the living nodes comes within `reach_mm` of `point`, axis by axis.
    pub fn is_near(&self, point: &Vector3<f64>, reach_mm: f64) -> bool {
        let living = |axis: usize| {
            let places = self.position_mm[axis].iter().zip(&self.flag);
            places.filter(|(_, flag)| **flag != NODE_DEAD).map(|(&p, _)| f64::from(p))
        };
        (0..3).all(|axis| {
            let at = point[axis];
            living(axis).any(|p| p < at + reach_mm) && living(axis).any(|p| p > at - reach_mm)
        })
    }

    /// Nodes.
    pub fn nodes(&self) -> usize {
        self.flag.len()
    }
}

/// True for the flag of a node that an instrument holds.
pub fn is_bound(flag: u32) -> bool {
    (NODE_BOUND..NODE_BOUND + INSTRUMENTS as u32).contains(&flag)
}

/// True for a flag that a state may hold.
pub fn is_known_flag(flag: u32) -> bool {
    matches!(flag, NODE_FREE | NODE_DEAD | NODE_PINNED) || is_bound(flag)
}

/// An account of removed membrane, in whole numbers so that it balances exactly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Removed {
    /// Area at rest, µm².
    pub area_um2: u64,
    /// Triangles.
    pub triangles: u64,
    /// Cuts that took something.
    pub cuts: u64,
}

impl Removed {
    /// Area, mm².
    pub fn area_mm2(&self) -> f64 {
        self.area_um2 as f64 * 1e-6
    }

    /// Volume of a membrane of this thickness, mm³ (µl).
    pub fn volume_mm3(&self, thickness_mm: f64) -> f64 {
        self.area_mm2() * thickness_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    #[test]
    fn membrane_far_away_is_not_near() {
        let membrane = Sheet::new(&SceneFile::load("peel").unwrap()).unwrap().start();
        assert!(membrane.is_near(&Vector3::new(0.0, 0.0, -10.0), 1.6));
        assert!(!membrane.is_near(&Vector3::new(0.0, 0.0, -5.0), 1.6));
    }

    #[test]
    fn an_area_of_membrane_is_a_volume_by_its_thickness() {
        let removed = Removed { area_um2: 2_500_000, ..Removed::default() };
        assert_eq!((removed.area_mm2(), removed.volume_mm3(0.02)), (2.5, 0.05));
    }
}
