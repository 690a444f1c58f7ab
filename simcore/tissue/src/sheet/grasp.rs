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

/// Forgets held nodes that were torn away; `true` if any was.
pub(super) fn drop_dead(held: &mut Vec<HeldNode>, flag: &[u32]) -> bool {
    let before = held.len();
    held.retain(|h| flag[h.node as usize] != NODE_DEAD);
    held.len() < before
}

impl SheetBody {
    /// Moves what instrument `i` holds with it, no deeper than the choroid; its velocity is what
    /// that makes of it over a substep.
    pub fn carry(&self, state: &mut SheetState, i: usize, eye_from_instrument: &Isometry3<f64>) {
        let radius_mm = f64::from(self.material.radius_mm);
        for k in 0..state.held[i].len() {
            let held = state.held[i][k];
            let node = held.node as usize;
            let p = (eye_from_instrument * Point3::from(held.at_in_instrument_mm.map(f64::from))).coords;
            let length = p.norm();
            let p = if length > radius_mm { p * (radius_mm / length) } else { p };
            let v = (p - state.position(node).map(f64::from)) / SUBSTEP_S;
            state.set_position(node, p.map(|c| c as f32));
            state.set_velocity(node, v.map(|c| c as f32));
        }
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
        let tip = eye_from_instrument.translation.vector;
        for node in 0..state.nodes() {
            let p = state.position(node).map(f64::from);
            let free = state.flag[node] == NODE_FREE && state.held[i].len() < MAX_HELD;
            if !free || (p - tip).norm_squared() > reach_mm * reach_mm {
                continue;
            }
            let at = eye_from_instrument.inverse_transform_point(&Point3::from(p));
            let at_in_instrument_mm = at.coords.map(|c| c as f32).into();
            state.held[i].push(HeldNode { node: node as u32, at_in_instrument_mm });
            state.flag[node] = NODE_BOUND + i as u32;
        }
        if !state.held[i].is_empty() {
            self.refresh(state);
        }
        state.held[i].len()
    }

    /// Lets go of every node that instrument `i` holds, at rest and before the choroid; returns how
    /// many.
    pub fn let_go(&mut self, state: &mut SheetState, i: usize) -> usize {
        let (count, radius_mm) = (state.held[i].len(), self.material.radius_mm);
        for k in 0..count {
            let node = state.held[i][k].node as usize;
            if state.flag[node] != NODE_DEAD {
                let p = state.position(node);
                if p.norm() > radius_mm {
                    state.set_position(node, p * (radius_mm / p.norm()));
                }
                state.flag[node] = NODE_FREE;
                state.set_velocity(node, Vector3::zeros());
            }
        }
        state.held[i].clear();
        if count > 0 {
            self.refresh(state);
        }
        count
    }

    /// Force of the tissue on what instrument `i` holds, µN.
    pub fn pull_un(&self, state: &SheetState, i: usize) -> f64 {
        let force = |n: u32| Vector3::from(self.solver.force_un.each_ref().map(|f| f64::from(f[n as usize])));
        state.held[i].iter().map(|h| force(h.node)).fold(Vector3::zeros(), |sum, f| sum + f).norm()
    }
}

#[cfg(test)]
mod tests {
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
        let mut body = SheetBody::membrane(&scene).unwrap().unwrap();
        let mut sheet = body.mesh.start();
        let pose = Isometry3::translation(0.0, 0.0, -10.9);
        let count = body.grab(&mut sheet, 0, &pose, 0.45);
        assert!(count > 3, "{count}");
        let node = sheet.held[0][0].node as usize;
        let before = sheet.position(node);
        body.carry(&mut sheet, 0, &Isometry3::translation(0.0, 0.1, -10.9));
        let moved = sheet.position(node) - before;
        assert!((moved - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-5);
        assert!((sheet.velocity(node).y - 100.0).abs() < 0.01);
        body.carry(&mut sheet, 0, &Isometry3::translation(0.0, 0.0, -12.9));
        assert!(sheet.held[0].iter().all(|h| sheet.position(h.node as usize).norm() <= 11.500_01));
        assert_eq!(body.let_go(&mut sheet, 0), count);
        assert!(sheet.flag.iter().all(|&f| f < NODE_BOUND) && sheet.held[0].is_empty());
    }
}
