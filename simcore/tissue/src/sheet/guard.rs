//! The chokepoint for bad numbers. A node whose position, velocity or acceleration is not finite,
//! or beyond what an eye can hold ([`RUNAWAY_MM`], [`RUNAWAY_MM_S`]; so is its energy bounded), is
//! put back where it last was good and taken out with its triangles; the rest goes on.
//! Accelerations are looked at before they move anything, so that a bad number stays in one node
//! and does not run through the sheet with the next substeps.

use crate::constants::{RUNAWAY_MM, RUNAWAY_MM_S};
use crate::sheet::mesh::SheetMesh;
use crate::sheet::solver::Solver;
use crate::sheet::state::SheetState;
use crate::sheet::tearing;
use nalgebra::Vector3;

/// Positions at the end of the last good step.
#[derive(Debug, Clone)]
pub struct LastGood {
    position_mm: [Vec<f32>; 3],
    /// Those of the first copy, for a node that was bad already when a step began.
    first_mm: [Vec<f32>; 3],
}

impl LastGood {
    /// Takes a first copy.
    pub fn new(state: &SheetState) -> Self {
        LastGood { position_mm: state.position_mm.clone(), first_mm: state.position_mm.clone() }
    }

    /// Copies the positions, without allocating.
    pub fn remember(&mut self, state: &SheetState) {
        for (kept, now) in self.position_mm.iter_mut().zip(&state.position_mm) {
            kept.copy_from_slice(now);
        }
    }

    fn restore(&self, state: &mut SheetState, node: usize) {
        let square: f32 = self.position_mm.iter().map(|kept| kept[node] * kept[node]).sum();
        let good = if square <= RUNAWAY_MM * RUNAWAY_MM { &self.position_mm } else { &self.first_mm };
        for (kept, now) in good.iter().zip(&mut state.position_mm) {
            now[node] = kept[node];
        }
        state.set_velocity(node, Vector3::zeros());
    }
}

/// True if a node is where and as fast as something in an eye can be; never for what is not finite.
fn is_sane(state: &SheetState, node: usize) -> bool {
    let squares = |v: &[Vec<f32>; 3]| v.iter().map(|v| v[node] * v[node]).sum::<f32>();
    squares(&state.position_mm) <= RUNAWAY_MM * RUNAWAY_MM
        && squares(&state.velocity_mm_s) <= RUNAWAY_MM_S * RUNAWAY_MM_S
}

/// True if everything is finite and nothing has run away. Counting keeps the loop free of branches;
/// every comparison with what is not a number is false.
pub fn all_finite(state: &SheetState) -> bool {
    let n = state.nodes();
    let ([x, y, z], [u, v, w]) = (&state.position_mm, &state.velocity_mm_s);
    let [x, y, z, u, v, w] = [x, y, z, u, v, w].map(|list| &list[..n]);
    let mut sane = 0usize;
    for i in 0..n {
        let near = x[i] * x[i] + y[i] * y[i] + z[i] * z[i] <= RUNAWAY_MM * RUNAWAY_MM;
        let slow = u[i] * u[i] + v[i] * v[i] + w[i] * w[i] <= RUNAWAY_MM_S * RUNAWAY_MM_S;
        sane += usize::from(near & slow);
    }
    sane == n
}

/// Disables nodes with bad numbers of their own; calls `culprit` for each.
pub fn disable_bad_nodes(
    mesh: &SheetMesh,
    state: &mut SheetState,
    last_good: &LastGood,
    mut culprit: impl FnMut(usize),
) {
    for node in 0..state.nodes() {
        if !is_sane(state, node) {
            last_good.restore(state, node);
            tearing::remove_node(mesh, state, node);
            culprit(node);
        }
    }
}

/// Contains a substep with accelerations that are not finite: nodes with bad numbers of their own
/// are the culprits; only where there are none (their neighbours' forces overflowed) are the nodes
/// themselves disabled. Every node concerned sits this substep out.
pub fn contain(
    mesh: &SheetMesh,
    state: &mut SheetState,
    solver: &mut Solver,
    last_good: &LastGood,
    mut culprit: impl FnMut(usize),
) {
    let mut found = false;
    disable_bad_nodes(mesh, state, last_good, |node| {
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
            tearing::remove_node(mesh, state, node);
            culprit(node);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sheet::material::Material;
    use scene::SceneFile;

    #[test]
    fn one_bad_node_is_taken_out_and_the_rest_goes_on() {
        let scene = SceneFile::load("peel").unwrap();
        let (mesh, material) = (SheetMesh::new(&scene).unwrap(), Material::new(&scene));
        let (mut state, mut solver) = (mesh.start(), Solver::new(&mesh));
        solver.refresh(&mesh, &state, &material);
        let last_good = LastGood::new(&state);
        let node = mesh.nodes() / 2;
        let before = state.position(node);
        state.position_mm[1][node] = f32::NAN;
        assert!(!all_finite(&state));
        assert!(solver.accelerate(&mesh, &state, &material).not_finite);
        let mut culprits = Vec::new();
        contain(&mesh, &mut state, &mut solver, &last_good, |n| culprits.push(n));
        solver.refresh(&mesh, &state, &material);
        assert_eq!(culprits, [node]);
        assert_eq!(state.position(node), before);
        for _ in 0..50 {
            solver.integrate(&mut state, &material);
            assert!(!solver.accelerate(&mesh, &state, &material).not_finite);
        }
        assert!(all_finite(&state));
        assert_eq!(tearing::check_mesh(&mesh, &state), Ok(()));
        assert_eq!(state.triangle_alive.iter().filter(|&&a| a == 0).count(), 6);
    }

    #[test]
    fn any_bad_number_anywhere_costs_its_node_and_no_other() {
        let scene = SceneFile::load("peel").unwrap();
        let (mesh, material) = (SheetMesh::new(&scene).unwrap(), Material::new(&scene));
        let numbers = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e30, 1e20, 2.0 * RUNAWAY_MM_S];
        for (number, list) in numbers.into_iter().flat_map(|x| (0..6).map(move |list| (x, list))) {
            for node in [0, 1, mesh.nodes() / 2, mesh.nodes() - 1] {
                let (mut state, mut solver) = (mesh.start(), Solver::new(&mesh));
                let last_good = LastGood::new(&state);
                let lists = state.position_mm.iter_mut().chain(&mut state.velocity_mm_s);
                lists.into_iter().nth(list).unwrap()[node] = number;
                assert!(!all_finite(&state), "{number} in list {list} of node {node}");
                let mut culprits = Vec::new();
                disable_bad_nodes(&mesh, &mut state, &last_good, |n| culprits.push(n));
                assert_eq!(culprits, [node]);
                assert_eq!(state.flag[node], protocol::scene::NODE_DEAD);
                solver.refresh(&mesh, &state, &material);
                for _ in 0..5 {
                    assert!(!solver.accelerate(&mesh, &state, &material).not_finite);
                    solver.integrate(&mut state, &material);
                }
                assert!(all_finite(&state));
                assert_eq!(tearing::check_mesh(&mesh, &state), Ok(()));
            }
        }
    }
}
