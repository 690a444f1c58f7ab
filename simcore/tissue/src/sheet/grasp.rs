//! Forceps: closing jaws bind the nodes near the tip, opening jaws let them go, and a grip that is
//! pulled too hard slips (paper, section 3.3.1). Bound nodes live in the instrument's frame: they
//! follow the tip, no deeper than the choroid, and the force of the tissue on them is what the jaws
//! feel.

use super::body::SheetBody;
use super::state::{HeldNode, SheetState};
use crate::constants::{MAX_HELD, SUBSTEP_S};
use nalgebra::{Isometry3, Point3, Vector3};
use protocol::handles::Tool;
use protocol::scene::{NODE_BOUND, NODE_DEAD, NODE_FREE};
use scene::ContactScene;

/// What the jaws' movement means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grasp {
    /// They closed so far that they grab.
    Closed,
    /// They opened so far that they let go.
    Opened,
}

/// The jaws moved from `before_rad` to `now_rad`.
pub fn grasp(before_rad: f64, now_rad: f64, scene: &ContactScene) -> Option<Grasp> {
    let closing = before_rad >= scene.grab_below_rad && now_rad < scene.grab_below_rad;
    let opening = now_rad > scene.release_above_rad;
    match (closing, opening) {
        (true, _) => Some(Grasp::Closed),
        (_, true) => Some(Grasp::Opened),
        _ => None,
    }
}

/// True for tools with jaws.
pub fn has_jaws(tool: u32) -> bool {
    tool == Tool::Forceps as u32
}

/// Binds the free nodes within `reach_mm` of the tip of an instrument; returns how many it holds
/// now.
fn bind(
    sheet: &mut SheetState,
    instrument: usize,
    eye_from_instrument: &Isometry3<f64>,
    reach_mm: f64,
) -> usize {
    let tip = eye_from_instrument.translation.vector;
    for node in 0..sheet.nodes() {
        let p = sheet.position(node).map(f64::from);
        let free = sheet.flag[node] == NODE_FREE && sheet.held[instrument].len() < MAX_HELD;
        if !free || (p - tip).norm_squared() > reach_mm * reach_mm {
            continue;
        }
        let at = eye_from_instrument.inverse_transform_point(&Point3::from(p));
        let at_in_instrument_mm = at.coords.map(|c| c as f32).into();
        sheet.held[instrument].push(HeldNode { node: node as u32, at_in_instrument_mm });
        sheet.flag[node] = NODE_BOUND + instrument as u32;
    }
    sheet.held[instrument].len()
}

/// Lets every node that an instrument holds go, at rest and before the choroid of radius
/// `radius_mm`; returns how many.
fn release(sheet: &mut SheetState, instrument: usize, radius_mm: f32) -> usize {
    let count = sheet.held[instrument].len();
    for k in 0..count {
        let node = sheet.held[instrument][k].node as usize;
        if sheet.flag[node] != NODE_DEAD {
            let p = sheet.position(node);
            if p.norm() > radius_mm {
                sheet.set_position(node, p * (radius_mm / p.norm()));
            }
            sheet.flag[node] = NODE_FREE;
            sheet.set_velocity(node, Vector3::zeros());
        }
    }
    sheet.held[instrument].clear();
    count
}

/// Moves what an instrument holds with it, no deeper than the choroid of radius `radius_mm`; its
/// velocity is what that makes of it over a substep.
fn carry(sheet: &mut SheetState, instrument: usize, eye_from_instrument: &Isometry3<f64>, radius_mm: f32) {
    let radius_mm = f64::from(radius_mm);
    for k in 0..sheet.held[instrument].len() {
        let held = sheet.held[instrument][k];
        let node = held.node as usize;
        let p = (eye_from_instrument * Point3::from(held.at_in_instrument_mm.map(f64::from))).coords;
        let length = p.norm();
        let p = if length > radius_mm { p * (radius_mm / length) } else { p };
        let v = (p - sheet.position(node).map(f64::from)) / SUBSTEP_S;
        sheet.set_position(node, p.map(|c| c as f32));
        sheet.set_velocity(node, v.map(|c| c as f32));
    }
}

/// Forgets held nodes that were torn away; `true` if any was.
pub(super) fn drop_dead(held: &mut Vec<HeldNode>, flag: &[u32]) -> bool {
    let before = held.len();
    held.retain(|h| flag[h.node as usize] != NODE_DEAD);
    held.len() < before
}

impl SheetBody {
    /// Moves what instrument `i` holds with it.
    pub fn carry(&self, state: &mut SheetState, i: usize, eye_from_instrument: &Isometry3<f64>) {
        carry(state, i, eye_from_instrument, self.material.radius_mm);
    }

    /// Binds the free nodes within `reach_mm` of the tip of instrument `i`; returns how many it
    /// holds now.
    pub fn grab(
        &mut self,
        state: &mut SheetState,
        i: usize,
        eye_from_instrument: &Isometry3<f64>,
        reach_mm: f64,
    ) -> usize {
        let held = bind(state, i, eye_from_instrument, reach_mm);
        if held > 0 {
            self.refresh(state);
        }
        held
    }

    /// Lets go of everything that instrument `i` holds; returns how many nodes that was.
    pub fn let_go(&mut self, state: &mut SheetState, i: usize) -> usize {
        let released = release(state, i, self.material.radius_mm);
        if released > 0 {
            self.refresh(state);
        }
        released
    }

    /// Force of the tissue on what instrument `i` holds, µN.
    pub fn pull_un(&self, state: &SheetState, i: usize) -> f64 {
        let force = |n: u32| Vector3::from(self.solver.force_un.each_ref().map(|f| f64::from(f[n as usize])));
        state.held[i].iter().map(|h| force(h.node)).fold(Vector3::zeros(), |sum, f| sum + f).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::SheetMesh;
    use super::*;
    use scene::SceneFile;

    #[test]
    fn jaws_grab_only_while_closing() {
        let scene = SceneFile::load("peel").unwrap().contact;
        let (below, above) = (scene.grab_below_rad, scene.release_above_rad);
        assert_eq!(grasp(above, below - 0.01, &scene), Some(Grasp::Closed));
        assert_eq!(grasp(below - 0.01, below - 0.02, &scene), None);
        assert_eq!(grasp(0.0, below + 0.01, &scene), None);
        assert_eq!(grasp(below, above + 0.01, &scene), Some(Grasp::Opened));
    }

    #[test]
    fn bound_nodes_follow_the_tip_and_are_free_again() {
        let scene = SceneFile::load("peel").unwrap();
        let mut sheet = SheetMesh::new(&scene).unwrap().start();
        let pose = Isometry3::translation(0.0, 0.0, -10.9);
        let count = bind(&mut sheet, 0, &pose, 0.45);
        assert!(count > 3, "{count}");
        let node = sheet.held[0][0].node as usize;
        let before = sheet.position(node);
        carry(&mut sheet, 0, &Isometry3::translation(0.0, 0.1, -10.9), 11.5);
        let moved = sheet.position(node) - before;
        assert!((moved - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-5);
        assert!((sheet.velocity(node).y - 100.0).abs() < 0.01);
        carry(&mut sheet, 0, &Isometry3::translation(0.0, 0.0, -12.9), 11.5);
        assert!(sheet.held[0].iter().all(|h| sheet.position(h.node as usize).norm() <= 11.500_01));
        assert_eq!(release(&mut sheet, 0, 11.5), count);
        assert!(sheet.flag.iter().all(|&f| f < NODE_BOUND) && sheet.held[0].is_empty());
    }
}
