//! Removes tissue. A torn spring takes its triangles with it; what then belongs to no triangle goes
//! too: springs without a triangle, nodes without a triangle. The mesh is consistent after every
//! call.

use super::mesh::{NONE, SheetMesh};
use super::solver::Solver;
use crate::sheet::state::SheetState;
use protocol::scene::{NODE_DEAD, NODE_FREE};

/// Tears a spring; `true` if it was alive.
pub fn tear_spring(mesh: &SheetMesh, state: &mut SheetState, spring: usize) -> bool {
    if state.spring_alive[spring] == 0 {
        return false;
    }
    for triangle in mesh.spring_triangles[spring] {
        if triangle != NONE {
            remove_triangle(mesh, state, triangle as usize);
        }
    }
    state.spring_alive[spring] = 0;
    true
}

/// Removes a triangle, with the springs and nodes that belong to no other.
pub fn remove_triangle(mesh: &SheetMesh, state: &mut SheetState, triangle: usize) {
    if state.triangle_alive[triangle] == 0 {
        return;
    }
    state.triangle_alive[triangle] = 0;
    state.topology += 1;
    for &spring in &mesh.triangle_springs[triangle] {
        let sides = mesh.spring_triangles[spring as usize];
        if sides.iter().all(|&t| t == NONE || state.triangle_alive[t as usize] == 0) {
            state.spring_alive[spring as usize] = 0;
        }
    }
    for &node in &mesh.triangles[triangle] {
        let node = node as usize;
        if mesh.triangles_of(node).iter().all(|&t| state.triangle_alive[t as usize] == 0) {
            state.flag[node] = NODE_DEAD;
            state.velocity_mm_s.iter_mut().for_each(|v| v[node] = 0.0);
        }
    }
}

/// Removes every triangle around a node.
pub fn remove_node(mesh: &SheetMesh, state: &mut SheetState, node: usize) {
    for &triangle in mesh.triangles_of(node) {
        remove_triangle(mesh, state, triangle as usize);
    }
}

/// The paper's rule (section 4.5): at every free node whose acceleration passes the limit of
/// tearing, the spring that pulls hardest tears. Returns how many tore and where one of them was.
pub fn tear_by_acceleration(
    mesh: &SheetMesh,
    state: &mut SheetState,
    solver: &Solver,
    a_tear: f32,
) -> (u32, usize) {
    let (mut torn, mut place) = (0, 0);
    for node in 0..state.nodes() {
        if state.flag[node] != NODE_FREE || solver.acceleration2[node] <= a_tear * a_tear {
            continue;
        }
        let springs = mesh.triangles_of(node).iter().flat_map(|&t| mesh.triangle_springs[t as usize]);
        let mut hardest = None;
        for s in springs.map(|s| s as usize) {
            let mine = mesh.springs[s].contains(&(node as u32)) && state.spring_alive[s] != 0;
            if mine && hardest.is_none_or(|h: usize| solver.tension_un(s) > solver.tension_un(h)) {
                hardest = Some(s);
            }
        }
        if hardest.is_some_and(|s| tear_spring(mesh, state, s)) {
            (torn, place) = (torn + 1, node);
        }
    }
    (torn, place)
}

/// Tears every spring whose tension passes its limit.
pub fn tear_by_tension(mesh: &SheetMesh, state: &mut SheetState, solver: &Solver) -> (u32, usize) {
    let (mut torn, mut place) = (0, 0);
    for spring in 0..mesh.structural {
        if solver.over_tension(spring) && tear_spring(mesh, state, spring) {
            (torn, place) = (torn + 1, mesh.springs[spring][0] as usize);
        }
    }
    (torn, place)
}

/// Checks that springs, triangles and nodes fit together; the text names the first that does not.
///
/// # Errors
/// With the first that does not fit.
pub fn check_mesh(mesh: &SheetMesh, state: &SheetState) -> Result<(), String> {
    for (t, springs) in mesh.triangle_springs.iter().enumerate() {
        let whole = springs.iter().all(|&s| state.spring_alive[s as usize] != 0);
        let nodes = mesh.triangles[t].iter().all(|&n| state.flag[n as usize] != NODE_DEAD);
        if state.triangle_alive[t] != 0 && !(whole && nodes) {
            return Err(format!("triangle {t} has lost a spring or a node"));
        }
    }
    for (s, sides) in mesh.spring_triangles.iter().enumerate() {
        let carried = sides.iter().any(|&t| t != NONE && state.triangle_alive[t as usize] != 0);
        if (state.spring_alive[s] != 0) != carried {
            return Err(format!("spring {s} is alive without a triangle, or dead in one"));
        }
    }
    for node in 0..mesh.nodes() {
        let carried = mesh.triangles_of(node).iter().any(|&t| state.triangle_alive[t as usize] != 0);
        if (state.flag[node] != NODE_DEAD) != carried {
            return Err(format!("node {node} is alive without a triangle, or dead in one"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::material::Material;
    use super::*;
    use collision::instrument_image::{InstrumentImage, Volume};
    use collision::zcoll::Zcoll;
    use nalgebra::Isometry3;
    use proptest::prelude::*;
    use protocol::handles::Tool;
    use scene::SceneFile;
    use std::collections::BTreeSet;

    /// A grid of 8 × 8 squares of 0.5 mm that is jittered, cut along either diagonal, and lacks
    /// some triangles.
    fn irregular(jitter: &[[f32; 3]], diagonals: &[bool], holes: &[usize]) -> SheetMesh {
        let at = |i: usize| (i as f32 - 4.0) * 0.5;
        let moved = |i: usize| std::array::from_fn(|k| 0.4 * jitter[i][k] + [at(i % 9), at(i / 9), 0.0][k]);
        let positions: Vec<[f32; 3]> = (0..81).map(moved).collect();
        let mut triangles = Vec::new();
        for (square, &turned) in diagonals.iter().enumerate() {
            let a = (square / 8 * 9 + square % 8) as u32;
            let [b, c, d] = [a + 1, a + 10, a + 9];
            triangles.extend(if turned { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] });
        }
        let mut left = 0..triangles.len();
        triangles.retain(|_| left.next().is_some_and(|t| !holes.contains(&t)));
        // Nodes without a triangle are no part of a mesh.
        let used: Vec<u32> =
            triangles.iter().flatten().copied().collect::<BTreeSet<_>>().into_iter().collect();
        let name = |n: u32| used.binary_search(&n).unwrap() as u32;
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(name)).collect();
        let positions: Vec<[f32; 3]> = used.iter().map(|&n| positions[n as usize]).collect();
        SheetMesh::from_triangles(&positions, &triangles, &[]).unwrap()
    }

    fn living<'a>(mesh: &'a SheetMesh, state: &'a SheetState) -> impl Iterator<Item = [u32; 3]> + 'a {
        mesh.triangles.iter().zip(&state.triangle_alive).filter(|(_, alive)| **alive != 0).map(|(t, _)| *t)
    }

    fn peel() -> (SheetMesh, SheetState) {
        let mesh = SheetMesh::new(&SceneFile::load("peel").unwrap()).unwrap();
        let state = mesh.start();
        (mesh, state)
    }

    #[test]
    fn a_torn_spring_takes_its_two_triangles() {
        let (mesh, mut state) = peel();
        let inner = mesh.spring_triangles.iter().position(|t| t[1] != NONE).unwrap();
        assert!(tear_spring(&mesh, &mut state, inner));
        assert!(!tear_spring(&mesh, &mut state, inner), "only once");
        assert_eq!(state.triangle_alive.iter().filter(|&&a| a == 0).count(), 2);
        check_mesh(&mesh, &state).unwrap();
    }

    #[test]
    fn the_hardest_pulling_spring_of_an_overloaded_node_tears() {
        let mut scene = SceneFile::load("peel").unwrap();
        scene.membrane.as_mut().unwrap().tear_tension_n_per_m = 0.0;
        let (mesh, material) = (SheetMesh::new(&scene).unwrap(), Material::new(&scene));
        let (mut state, mut solver) = (mesh.start(), Solver::new(&mesh));
        solver.refresh(&mesh, &state, &material);
        let node = mesh.nodes() / 2;
        state.position_mm[0][node] -= 2.5;
        assert!(solver.accelerate(&mesh, &state, &material).over_acceleration);
        let mine = |s: &usize| mesh.springs[*s].contains(&(node as u32));
        let all = (0..mesh.structural).filter(mine);
        let hardest = all.max_by(|&a, &b| solver.tension_un(a).total_cmp(&solver.tension_un(b))).unwrap();
        tear_by_acceleration(&mesh, &mut state, &solver, material.a_tear);
        assert_eq!(state.spring_alive[hardest], 0);
        check_mesh(&mesh, &state).unwrap();
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_tears_leave_a_consistent_mesh(springs in prop::collection::vec(0usize..1545, 0..400)) {
            let (mesh, mut state) = peel();
            for s in springs {
                tear_spring(&mesh, &mut state, s);
            }
            prop_assert_eq!(check_mesh(&mesh, &state), Ok(()));
        }

        /// Irregular meshes with holes, torn at random by springs, triangles and nodes: what is
        /// alive is what the living triangles are made of, found again from their corners, and a
        /// collision view sees living triangles only.
        #[test]
        fn irregular_meshes_tear_consistently(
            jitter in prop::collection::vec(prop::array::uniform3(-0.3f32..0.3), 81),
            diagonals in prop::collection::vec(any::<bool>(), 64),
            holes in prop::collection::vec(0usize..128, 0..20),
            tears in prop::collection::vec((0u8..3, 0usize..1000), 1..60),
        ) {
            let mesh = irregular(&jitter, &diagonals, &holes);
            let mut state = mesh.start();
            let volume = Volume { half_mm: 2.0, near_mm: -1.0, depth_mm: 4.0, resolution: 64 };
            let mut zcoll = Zcoll::new(volume, &mesh.triangles, mesh.nodes()).unwrap();
            let mut image = InstrumentImage::new(Tool::LightPipe, 1.5, &volume);
            image.prepare(0.0, &volume);
            for (what, which) in tears {
                let topology = state.topology;
                match what {
                    0 => { tear_spring(&mesh, &mut state, which % mesh.structural); }
                    1 => remove_triangle(&mesh, &mut state, which % mesh.triangles.len()),
                    _ => remove_node(&mesh, &mut state, which % mesh.nodes()),
                }
                let alive: Vec<[u32; 3]> = living(&mesh, &state).collect();
                prop_assert_eq!(check_mesh(&mesh, &state), Ok(()));
                let edges: BTreeSet<[u32; 2]> = alive.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
                    .map(|[a, b]| [a.min(b), a.max(b)]).collect();
                let springs: BTreeSet<[u32; 2]> =
                    (0..mesh.structural).filter(|&s| state.spring_alive[s] != 0).map(|s| mesh.springs[s]).collect();
                prop_assert_eq!(springs, edges);
                let corners: BTreeSet<u32> = alive.iter().flatten().copied().collect();
                let nodes: BTreeSet<u32> =
                    (0..mesh.nodes() as u32).filter(|&n| state.flag[n as usize] != NODE_DEAD).collect();
                prop_assert_eq!(nodes, corners);
                let lost = alive.len() != mesh.triangles.len();
                prop_assert!(state.topology >= topology && (state.topology > 0) == lost);
                // From below: the whole sheet lies over the camera's tip.
                let pose = Isometry3::translation(0.0, 0.0, 0.5);
                zcoll.query(&image, &pose, &state.surface(&mesh, &state.triangle_alive));
                prop_assert!(zcoll.triangles().all(|(t, _)| state.triangle_alive[t] != 0));
                let under = |t: &&[u32; 3]| t.iter().all(|&n| state.position(n as usize).xy().norm() < 1.2);
                let central = alive.iter().filter(under).count();
                prop_assert!(zcoll.triangles().count() > 0 || central == 0);
            }
        }
    }
}
