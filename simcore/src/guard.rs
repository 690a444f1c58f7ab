//! The chokepoint for bad numbers. A node whose position, velocity or acceleration is not finite is
//! put back where it last was good and taken out with its triangles; the rest goes on. Accelerations
//! are looked at before they move anything, so that a bad number stays in one node and does not
//! run through the sheet with the next substeps.

use crate::membrane::sheet::Sheet;
use crate::membrane::solver::Solver;
use crate::membrane::tear;
use crate::state::MembraneState;
use nalgebra::Vector3;

/// Positions at the end of the last good step.
#[derive(Debug, Clone)]
pub struct LastGood {
    position_mm: [Vec<f32>; 3],
}

impl LastGood {
    /// Takes a first copy.
    pub fn new(state: &MembraneState) -> Self {
        LastGood { position_mm: state.position_mm.clone() }
    }

    /// Copies the positions, without allocating.
    pub fn remember(&mut self, state: &MembraneState) {
        for (kept, now) in self.position_mm.iter_mut().zip(&state.position_mm) {
            kept.copy_from_slice(now);
        }
    }

    fn restore(&self, state: &mut MembraneState, node: usize) {
        for (kept, now) in self.position_mm.iter().zip(&mut state.position_mm) {
            now[node] = kept[node];
        }
        state.set_velocity(node, Vector3::zeros());
    }
}

/// True if a node's position and velocity are finite.
fn is_finite(state: &MembraneState, node: usize) -> bool {
    let all = state.position_mm.iter().chain(&state.velocity_mm_s);
    all.into_iter().all(|v| v[node].is_finite())
}

/// True if everything is finite; adding up keeps the loop free of branches (0·NaN is NaN).
pub fn all_finite(state: &MembraneState) -> bool {
    let all = state.position_mm.iter().chain(&state.velocity_mm_s);
    all.map(|v| v.iter().map(|x| x * 0.0).sum::<f32>()).sum::<f32>() == 0.0
}

/// Disables nodes with bad numbers of their own; calls `culprit` for each.
pub fn disable_bad_nodes(
    sheet: &Sheet,
    state: &mut MembraneState,
    last_good: &LastGood,
    mut culprit: impl FnMut(usize),
) {
    for node in 0..state.nodes() {
        if !is_finite(state, node) {
            last_good.restore(state, node);
            tear::remove_node(sheet, state, node);
            culprit(node);
        }
    }
}

/// Contains a substep with accelerations that are not finite: nodes with bad numbers of their own are the
/// culprits; only where there are none (their neighbours' forces overflowed) are the nodes themselves
/// disabled. Every node concerned sits this substep out.
pub fn contain(
    sheet: &Sheet,
    state: &mut MembraneState,
    solver: &mut Solver,
    last_good: &LastGood,
    mut culprit: impl FnMut(usize),
) {
    let mut found = false;
    disable_bad_nodes(sheet, state, last_good, |node| {
        found = true;
        culprit(node);
    });
    for node in 0..state.nodes() {
        if solver.acceleration2[node] <= f32::MAX {
            continue;
        }
        solver.hold_still(node);
        if !found {
            last_good.restore(state, node);
            tear::remove_node(sheet, state, node);
            culprit(node);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::tissue::Tissue;
    use protocol::scene_file::SceneFile;

    #[test]
    fn one_bad_node_is_taken_out_and_the_rest_goes_on() {
        let scene = SceneFile::load("peel").unwrap();
        let (sheet, tissue) = (Sheet::new(&scene), Tissue::new(&scene));
        let (mut state, mut solver) = (sheet.start(), Solver::new(&sheet));
        solver.refresh(&sheet, &state, &tissue);
        let last_good = LastGood::new(&state);
        let node = sheet.nodes() / 2;
        let before = state.position(node);
        state.position_mm[1][node] = f32::NAN;
        assert!(!all_finite(&state));
        assert!(solver.accelerate(&sheet, &state, &tissue).not_finite);
        let mut culprits = Vec::new();
        contain(&sheet, &mut state, &mut solver, &last_good, |n| culprits.push(n));
        solver.refresh(&sheet, &state, &tissue);
        assert_eq!(culprits, [node]);
        assert_eq!(state.position(node), before);
        for _ in 0..50 {
            solver.integrate(&mut state, &tissue);
            assert!(!solver.accelerate(&sheet, &state, &tissue).not_finite);
        }
        assert!(all_finite(&state));
        assert_eq!(tear::check_mesh(&sheet, &state), Ok(()));
        assert_eq!(state.triangle_alive.iter().filter(|&&a| a == 0).count(), 6);
    }
}
