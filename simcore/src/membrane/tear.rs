//! Removes tissue. A torn spring takes its triangles with it; what then belongs to no triangle goes
//! too: springs without a triangle, nodes without a triangle. The mesh is consistent after every call.

use super::sheet::{NONE, Sheet};
use super::solver::Solver;
use crate::state::MembraneState;
use protocol::scene::{NODE_DEAD, NODE_FREE};

/// Tears a spring; `true` if it was alive.
pub fn tear_spring(sheet: &Sheet, state: &mut MembraneState, spring: usize) -> bool {
    if state.spring_alive[spring] == 0 {
        return false;
    }
    for triangle in sheet.spring_triangles[spring] {
        if triangle != NONE {
            remove_triangle(sheet, state, triangle as usize);
        }
    }
    state.spring_alive[spring] = 0;
    true
}

/// Removes a triangle, with the springs and nodes that belong to no other.
pub fn remove_triangle(sheet: &Sheet, state: &mut MembraneState, triangle: usize) {
    if state.triangle_alive[triangle] == 0 {
        return;
    }
    state.triangle_alive[triangle] = 0;
    state.topology += 1;
    for &spring in &sheet.triangle_springs[triangle] {
        let sides = sheet.spring_triangles[spring as usize];
        if sides.iter().all(|&t| t == NONE || state.triangle_alive[t as usize] == 0) {
            state.spring_alive[spring as usize] = 0;
        }
    }
    for &node in &sheet.triangles[triangle] {
        let node = node as usize;
        if sheet.triangles_of(node).iter().all(|&t| state.triangle_alive[t as usize] == 0) {
            state.flag[node] = NODE_DEAD;
            state.velocity_mm_s.iter_mut().for_each(|v| v[node] = 0.0);
        }
    }
}

/// Removes every triangle around a node.
pub fn remove_node(sheet: &Sheet, state: &mut MembraneState, node: usize) {
    for &triangle in sheet.triangles_of(node) {
        remove_triangle(sheet, state, triangle as usize);
    }
}

/// The paper's rule (section 4.5): at every free node whose acceleration passes the limit of tearing, the
/// spring that pulls hardest tears. Returns how many tore and where one of them was.
pub fn tear_by_acceleration(
    sheet: &Sheet,
    state: &mut MembraneState,
    solver: &Solver,
    a_tear: f32,
) -> (u32, usize) {
    let (mut torn, mut place) = (0, 0);
    for node in 0..state.nodes() {
        if state.flag[node] != NODE_FREE || solver.acceleration2[node] <= a_tear * a_tear {
            continue;
        }
        let springs = sheet.triangles_of(node).iter().flat_map(|&t| sheet.triangle_springs[t as usize]);
        let mut hardest = None;
        for s in springs.map(|s| s as usize) {
            let mine = sheet.springs[s].contains(&(node as u32)) && state.spring_alive[s] != 0;
            if mine && hardest.is_none_or(|h: usize| solver.tension_un(s) > solver.tension_un(h)) {
                hardest = Some(s);
            }
        }
        if hardest.is_some_and(|s| tear_spring(sheet, state, s)) {
            (torn, place) = (torn + 1, node);
        }
    }
    (torn, place)
}

/// Tears every spring whose tension passes its limit.
pub fn tear_by_tension(sheet: &Sheet, state: &mut MembraneState, solver: &Solver) -> (u32, usize) {
    let (mut torn, mut place) = (0, 0);
    for spring in 0..sheet.structural {
        if solver.over_tension(spring) && tear_spring(sheet, state, spring) {
            (torn, place) = (torn + 1, sheet.springs[spring][0] as usize);
        }
    }
    (torn, place)
}

/// Checks that springs, triangles and nodes fit together; the text names the first that does not.
pub fn check_mesh(sheet: &Sheet, state: &MembraneState) -> Result<(), String> {
    for (t, springs) in sheet.triangle_springs.iter().enumerate() {
        let whole = springs.iter().all(|&s| state.spring_alive[s as usize] != 0);
        let nodes = sheet.triangles[t].iter().all(|&n| state.flag[n as usize] != NODE_DEAD);
        if state.triangle_alive[t] != 0 && !(whole && nodes) {
            return Err(format!("triangle {t} has lost a spring or a node"));
        }
    }
    for (s, sides) in sheet.spring_triangles.iter().enumerate() {
        let carried = sides.iter().any(|&t| t != NONE && state.triangle_alive[t as usize] != 0);
        if (state.spring_alive[s] != 0) != carried {
            return Err(format!("spring {s} is alive without a triangle, or dead in one"));
        }
    }
    for node in 0..sheet.nodes() {
        let carried = sheet.triangles_of(node).iter().any(|&t| state.triangle_alive[t as usize] != 0);
        if (state.flag[node] != NODE_DEAD) != carried {
            return Err(format!("node {node} is alive without a triangle, or dead in one"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tissue::Tissue;
    use super::*;
    use proptest::prelude::*;
    use protocol::scene_file::SceneFile;

    fn peel() -> (Sheet, MembraneState) {
        let sheet = Sheet::new(&SceneFile::load("peel").unwrap());
        let state = sheet.start();
        (sheet, state)
    }

    #[test]
    fn a_torn_spring_takes_its_two_triangles() {
        let (sheet, mut state) = peel();
        let inner = sheet.spring_triangles.iter().position(|t| t[1] != NONE).unwrap();
        assert!(tear_spring(&sheet, &mut state, inner));
        assert!(!tear_spring(&sheet, &mut state, inner), "only once");
        assert_eq!(state.triangle_alive.iter().filter(|&&a| a == 0).count(), 2);
        check_mesh(&sheet, &state).unwrap();
    }

    #[test]
    fn the_hardest_pulling_spring_of_an_overloaded_node_tears() {
        let mut scene = SceneFile::load("peel").unwrap();
        scene.membrane.as_mut().unwrap().tear_tension_n_per_m = 0.0;
        let (sheet, tissue) = (Sheet::new(&scene), Tissue::new(&scene));
        let (mut state, mut solver) = (sheet.start(), Solver::new(&sheet));
        solver.refresh(&sheet, &state, &tissue);
        let node = sheet.nodes() / 2;
        state.position_mm[0][node] -= 2.5;
        assert!(solver.accelerate(&sheet, &state, &tissue).over_acceleration);
        let mine = |s: &usize| sheet.springs[*s].contains(&(node as u32));
        let all = (0..sheet.structural).filter(mine);
        let hardest = all.max_by(|&a, &b| solver.tension_un(a).total_cmp(&solver.tension_un(b))).unwrap();
        tear_by_acceleration(&sheet, &mut state, &solver, tissue.a_tear);
        assert_eq!(state.spring_alive[hardest], 0);
        check_mesh(&sheet, &state).unwrap();
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_tears_leave_a_consistent_mesh(springs in prop::collection::vec(0usize..1545, 0..400)) {
            let (sheet, mut state) = peel();
            for s in springs {
                tear_spring(&sheet, &mut state, s);
            }
            prop_assert_eq!(check_mesh(&sheet, &state), Ok(()));
        }
    }
}
