//! What the next step must know of a sheet of tissue.

use super::adhesion::AdhesionState;
use super::guard::all_finite;
use super::mesh::SheetMesh;
use super::tearing::check_mesh;
use crate::constants::MAX_HELD;
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
    /// Node of the sheet.
    pub node: u32,
    /// Place in the instrument's frame, mm.
    pub at_in_instrument_mm: [f32; 3],
}

/// A needle's hole in a sheet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pierced {
    /// The triangle.
    pub triangle: u32,
    /// Weights of its corners.
    pub weights: [f64; 3],
}

/// Contact of an instrument with a sheet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SheetContact {
    /// The last collision image had colliding pixels.
    pub in_contact: bool,
    /// The instrument came round an edge and is under the sheet: it pushes nothing, and its hook or
    /// jaws lift, until it is clear.
    pub under: bool,
    /// It has lifted tissue since it came under the sheet.
    pub hooked: bool,
    /// Where its needle has gone through the sheet.
    pub pierced: Option<Pierced>,
}

/// A sheet: arrays over nodes (x, y and z apart), springs and triangles; and what instruments do to
/// it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SheetState {
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
    /// Bonds to the retina, where the sheet has some.
    pub adhesion: Option<AdhesionState>,
    /// Nodes that the jaws of each instrument hold.
    pub held: [Vec<HeldNode>; INSTRUMENTS],
    /// Contact of each instrument.
    pub contact: [SheetContact; INSTRUMENTS],
    /// What vitrectors have taken of the sheet.
    pub removed: Removed,
}

impl SheetState {
    /// The triangles of `mesh` for which `alive` is 1, for collision queries.
    pub fn surface<'a>(&'a self, mesh: &'a SheetMesh, alive: &'a [u8]) -> Surface<'a> {
        let position_mm = self.position_mm.each_ref().map(Vec::as_slice);
        Surface { position_mm, triangles: &mesh.triangles, alive }
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

    /// Nodes.
    pub fn nodes(&self) -> usize {
        self.flag.len()
    }

    /// Gives the lists of held nodes their full capacity, so that no step allocates.
    pub fn reserve(&mut self) {
        self.held.iter_mut().for_each(|held| held.reserve_exact(MAX_HELD - held.len()));
    }

    /// Whether the state fits `mesh` and its numbers make sense.
    ///
    /// # Errors
    /// With the first thing that is wrong.
    pub fn check(&self, mesh: &SheetMesh) -> Result<(), &'static str> {
        let nodes = mesh.nodes();
        let lists = self.position_mm.iter().chain(&self.velocity_mm_s);
        let fits = lists.into_iter().all(|list| list.len() == nodes)
            && self.flag.len() == nodes
            && [0, mesh.springs.len()].contains(&self.rest_mm.len())
            && self.spring_alive.len() == mesh.structural
            && self.triangle_alive.len() == mesh.triangles.len();
        if !fits {
            return Err("it has another size than the scene's");
        }
        let lasting = self.rest_mm.iter().all(|&l| l.is_finite() && l > 0.0);
        if !lasting || !all_finite(self) || !self.flag.iter().all(|&f| is_known_flag(f)) {
            return Err("its numbers are out of range");
        }
        check_mesh(mesh, self).map_err(|_| "its springs, triangles and nodes do not fit together")?;
        self.check_held()?;
        let sound = |hole: &Pierced| {
            (hole.triangle as usize) < mesh.triangles.len()
                && hole.weights.iter().all(|w| (0.0..=1.0).contains(w))
        };
        if self.contact.iter().all(|c| c.pierced.as_ref().is_none_or(sound)) {
            Ok(())
        } else {
            Err("a needle's hole is not in it")
        }
    }

    /// Held nodes and bound nodes must be the same ones.
    fn check_held(&self) -> Result<(), &'static str> {
        let mine = |i: usize, h: &HeldNode| {
            let placed = h.at_in_instrument_mm.iter().all(|c| c.is_finite());
            placed && self.flag.get(h.node as usize) == Some(&(NODE_BOUND + i as u32))
        };
        let bound = self.flag.iter().filter(|&&f| is_bound(f)).count();
        let held: usize = self.held.iter().map(Vec::len).sum();
        let each = self.held.iter().enumerate();
        let fits = |i: usize, held: &Vec<HeldNode>| held.len() <= MAX_HELD && held.iter().all(|h| mine(i, h));
        if held == bound && each.into_iter().all(|(i, held)| fits(i, held)) {
            Ok(())
        } else {
            Err("a held node is not bound to its instrument")
        }
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

/// An account of removed tissue, in whole numbers so that it balances exactly.
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

    #[test]
    fn an_area_of_membrane_is_a_volume_by_its_thickness() {
        let removed = Removed { area_um2: 2_500_000, ..Removed::default() };
        assert_eq!((removed.area_mm2(), removed.volume_mm3(0.02)), (2.5, 0.05));
    }
}
