//! Forceps: closing jaws bind the nodes near the tip, opening jaws let them go, and a grip that is pulled
//! too hard slips (paper, section 3.3.1). Bound nodes live in the instrument's frame: they follow the tip
//! exactly, and the springs' force on them is what the jaws feel.

use crate::constants::MAX_HELD;
use crate::membrane::solver::Solver;
use crate::state::{HeldNode, MembraneState};
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

/// Binds the free nodes within reach of the tip; returns how many are held now.
pub fn bind(
    held: &mut Vec<HeldNode>,
    index: usize,
    membrane: &mut MembraneState,
    eye_from_instrument: &Isometry3<f64>,
    reach_mm: f64,
) -> usize {
    let tip = eye_from_instrument.translation.vector;
    for node in 0..membrane.nodes() {
        let p = membrane.position(node).map(f64::from);
        let free = membrane.flag[node] == NODE_FREE && held.len() < MAX_HELD;
        if !free || (p - tip).norm_squared() > reach_mm * reach_mm {
            continue;
        }
        let at = eye_from_instrument.inverse_transform_point(&Point3::from(p));
        held.push(HeldNode { node: node as u32, at_in_instrument_mm: at.coords.map(|c| c as f32).into() });
        membrane.flag[node] = NODE_BOUND + index as u32;
    }
    held.len()
}

/// Lets every node go, at rest and before the retina of radius `radius_mm`; returns how many were held.
pub fn release(held: &mut Vec<HeldNode>, membrane: &mut MembraneState, radius_mm: f32) -> usize {
    let count = held.len();
    for node in held.drain(..) {
        let node = node.node as usize;
        if membrane.flag[node] != NODE_DEAD {
            let p = membrane.position(node);
            if p.norm() > radius_mm {
                membrane.set_position(node, p * (radius_mm / p.norm()));
            }
            membrane.flag[node] = NODE_FREE;
            membrane.set_velocity(node, Vector3::zeros());
        }
    }
    count
}

/// Carries the held nodes with the instrument; their velocity is what that makes of it.
pub fn carry(
    held: &[HeldNode],
    membrane: &mut MembraneState,
    eye_from_instrument: &Isometry3<f64>,
    dt_s: f64,
) {
    for held in held {
        let node = held.node as usize;
        let at = Point3::from(held.at_in_instrument_mm.map(f64::from));
        let p = (eye_from_instrument * at).coords;
        let v = (p - membrane.position(node).map(f64::from)) / dt_s;
        membrane.set_position(node, p.map(|c| c as f32));
        membrane.set_velocity(node, v.map(|c| c as f32));
    }
}

/// Sum of the springs' forces on the held nodes, µN.
pub fn pull_un(held: &[HeldNode], solver: &Solver) -> f64 {
    let mut sum = Vector3::<f64>::zeros();
    for held in held {
        sum += Vector3::from(solver.force_un.each_ref().map(|f| f64::from(f[held.node as usize])));
    }
    sum.norm()
}

/// Forgets held nodes that were torn away; `true` if any was.
pub fn drop_dead(held: &mut Vec<HeldNode>, membrane: &MembraneState) -> bool {
    let before = held.len();
    held.retain(|h| membrane.flag[h.node as usize] != NODE_DEAD);
    held.len() < before
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::sheet::Sheet;
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
        let mut membrane = Sheet::new(&scene).unwrap().start();
        let mut held = Vec::new();
        let pose = Isometry3::translation(0.0, 0.0, -10.9);
        let count = bind(&mut held, 0, &mut membrane, &pose, 0.45);
        assert!(count > 3, "{count}");
        let node = held[0].node as usize;
        let before = membrane.position(node);
        carry(&held, &mut membrane, &Isometry3::translation(0.0, 0.1, -10.9), 1e-3);
        let moved = membrane.position(node) - before;
        assert!((moved - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-5);
        assert!((membrane.velocity(node).y - 100.0).abs() < 0.01);
        assert_eq!(release(&mut held, &mut membrane, 11.5), count);
        assert!(membrane.flag.iter().all(|&f| f < NODE_BOUND) && held.is_empty());
    }
}
