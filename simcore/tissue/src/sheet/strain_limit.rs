//! Strain limiting: a living structural spring longer than (1 + limit) l₀ at the end of a substep
//! is drawn together (after Provot 1995), at the level of velocities (Bridson, Fedkiw and Anderson
//! 2002).
//!
//! With d the vector between its ends now, u its direction at the begin of the substep and w the
//! mobilities (1 free, 0 held), the ends move by ∓ s w/(w_a + w_b) u, the velocities by that over
//! dt, where s > 0 is
//!
//! ```text
//! |d − s u| = (1 + limit) l₀    s = d·u − √((d·u)² − d² + (1 + limit)² l₀²), or d·u where there is no root
//! ```
//!
//! Where no velocity outlives a substep, places alone are corrected: a velocity that was made up
//! here would move the nodes once more in the next substep, and be damped as if it were real.
//!
//! Masses are equal, so the impulses are opposite; and because they act along the line that joined
//! the ends when the substep began, the semi-implicit step keeps linear *and* angular momentum to
//! rounding. l₀ is the rest length that a plastic spring has by now: held to its first one, a
//! spring that crept longer would push against the limit for ever. Springs follow in their order,
//! in sweeps: what a sweep does to its neighbours the next one mends.

use super::material::Material;
use super::mesh::SheetMesh;
use crate::constants::TINY_LENGTH2_MM2;
use crate::sheet::state::SheetState;
use nalgebra::Vector3;
use protocol::scene::NODE_FREE;

/// Limits strains of the sheet to the tissue's limit (0.1: a tenth of the rest length) with at most
/// `sweeps` sweeps, after a substep has just been made. Returns how many corrections it took.
pub fn limit_strain(mesh: &SheetMesh, state: &mut SheetState, material: &Material, sweeps: u32) -> u32 {
    let dt_s = material.keeps_velocity.then_some(material.dt_s);
    let mut corrected = 0;
    for _ in 0..sweeps {
        let before = corrected;
        for spring in 0..mesh.structural {
            let rest_mm = state.rest_mm.get(spring).copied().unwrap_or(mesh.rest_mm[spring]);
            let longest = rest_mm * (1.0 + material.strain_limit);
            corrected += u32::from(
                state.spring_alive[spring] != 0 && draw(state, mesh.springs[spring], longest, dt_s),
            );
        }
        if corrected == before {
            break;
        }
    }
    corrected
}

/// Draws the ends of a spring together if it is too long; `true` if it was. `dt_s`: over what time
/// velocities change, if they do.
fn draw(state: &mut SheetState, ends: [u32; 2], longest: f32, dt_s: Option<f32>) -> bool {
    let [a, b] = ends.map(|n| n as usize);
    let d = state.position(b) - state.position(a);
    let long2 = d.norm_squared();
    // Written so that a number that is not finite is left alone. The margin spares the last bits.
    let too_long = long2 > longest * longest * 1.000_01 && long2.is_finite();
    let mobile = [a, b].map(|n| if state.flag[n] == NODE_FREE { 1.0f32 } else { 0.0 });
    if !too_long || mobile == [0.0, 0.0] {
        return false;
    }
    let start = dt_s.map_or(d, |dt| d - (state.velocity(b) - state.velocity(a)) * dt);
    let u = start / (start.norm_squared() + TINY_LENGTH2_MM2).sqrt();
    let along = d.dot(&u);
    let root = along * along - long2 + longest * longest;
    let s = if root > 0.0 { along - root.sqrt() } else { along };
    let each = s / (mobile[0] + mobile[1]);
    shift(state, a, u * (each * mobile[0]), dt_s);
    shift(state, b, u * (-each * mobile[1]), dt_s);
    true
}

fn shift(state: &mut SheetState, node: usize, by: Vector3<f32>, dt_s: Option<f32>) {
    if state.flag[node] == NODE_FREE {
        state.set_position(node, state.position(node) + by);
        if let Some(dt_s) = dt_s {
            state.set_velocity(node, state.velocity(node) + by / dt_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::SceneFile;

    const DT: f32 = 1e-3;

    /// Tissue that stretches by at most so much.
    fn limited(strain_limit: f32) -> Material {
        let material = Material::new(&SceneFile::load("peel").unwrap());
        assert_eq!((material.dt_s, material.keeps_velocity), (DT, true));
        Material { strain_limit, ..material }
    }

    /// A free patch of 5 × 5 nodes.
    fn patch() -> (SheetMesh, SheetState) {
        let node = |r: u32, c: u32| r * 5 + c;
        let positions: Vec<[f32; 3]> =
            (0..25u16).map(|i| [f32::from(i % 5), f32::from(i / 5), 0.0]).collect();
        let mut triangles = Vec::new();
        for (r, c) in (0..4).flat_map(|r| (0..4).map(move |c| (r, c))) {
            triangles.push([node(r, c), node(r, c + 1), node(r + 1, c + 1)]);
            triangles.push([node(r, c), node(r + 1, c + 1), node(r + 1, c)]);
        }
        let mesh = SheetMesh::from_triangles(&positions, &triangles, &[]).unwrap();
        let state = mesh.start();
        (mesh, state)
    }

    /// Σ v and Σ x × v in double precision.
    fn momenta(state: &SheetState) -> [Vector3<f64>; 2] {
        let each = |n: usize| [state.position(n), state.velocity(n)].map(|p| p.map(f64::from));
        let zero = [Vector3::zeros(); 2];
        (0..state.nodes()).map(each).fold(zero, |[p, l], [x, v]| [p + v, l + x.cross(&v)])
    }

    fn longest_strain(mesh: &SheetMesh, state: &SheetState) -> f32 {
        let strain = |s: usize| {
            let [a, b] = mesh.springs[s].map(|n| state.position(n as usize));
            (b - a).norm() / mesh.rest_mm[s] - 1.0
        };
        (0..mesh.structural).map(strain).fold(0.0, f32::max)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn linear_and_angular_momentum_are_kept_to_rounding(kicks in prop::collection::vec(-400.0f32..400.0, 75)) {
            let (mesh, mut state) = patch();
            for n in 0..25 {
                let v = Vector3::new(kicks[3 * n], kicks[3 * n + 1], kicks[3 * n + 2]);
                state.set_velocity(n, v);
                state.set_position(n, state.position(n) + v * DT);
            }
            let before = momenta(&state);
            prop_assume!(longest_strain(&mesh, &state) > 0.05);
            prop_assert!(limit_strain(&mesh, &mut state, &limited(0.05), 8) > 0);
            let after = momenta(&state);
            // Velocities of some 400 mm/s in 25 nodes, 24 bits each.
            prop_assert!((after[0] - before[0]).norm() < 2e-2, "{:?} {:?}", before[0], after[0]);
            prop_assert!((after[1] - before[1]).norm() < 1e-1, "{:?} {:?}", before[1], after[1]);
        }
    }

    #[test]
    fn a_stretched_patch_comes_back_to_the_limit() {
        let (mesh, mut state) = patch();
        for n in 0..25 {
            let p = state.position(n);
            state.set_position(n, Vector3::new(p.x * 1.3, p.y, 0.0));
        }
        limit_strain(&mesh, &mut state, &limited(0.1), 200);
        assert!(longest_strain(&mesh, &state) < 0.101, "{}", longest_strain(&mesh, &state));
    }

    #[test]
    fn without_velocity_places_alone_are_corrected() {
        let (mesh, mut state) = patch();
        for n in 0..25 {
            state.set_position(n, state.position(n) * 1.3);
        }
        let material = Material { keeps_velocity: false, ..limited(0.1) };
        assert!(limit_strain(&mesh, &mut state, &material, 200) > 0);
        assert!(longest_strain(&mesh, &state) < 0.101, "{}", longest_strain(&mesh, &state));
        assert!((0..25).all(|n| state.velocity(n).norm() == 0.0), "nothing moves of itself");
    }

    #[test]
    fn what_crept_is_limited_by_the_length_it_has_now() {
        let (mesh, mut state) = patch();
        state.rest_mm = mesh.rest_mm.iter().map(|l| l * 1.3).collect();
        for n in 0..25 {
            state.set_position(n, state.position(n) * 1.3);
        }
        assert_eq!(limit_strain(&mesh, &mut state, &limited(0.1), 200), 0, "all springs are at rest");
    }

    #[test]
    fn held_dead_and_bad_nodes_are_left_alone() {
        let (mesh, mut state) = patch();
        let (held, bad) = (mesh.order[0] as usize, mesh.order[24] as usize);
        state.flag[held] = crate::sheet::state::NODE_PINNED;
        state.set_position(held, Vector3::new(-1.0, 0.0, 0.0));
        state.set_position(bad, Vector3::new(f32::NAN, 0.0, 0.0));
        limit_strain(&mesh, &mut state, &limited(0.1), 100);
        assert_eq!(state.position(held), Vector3::new(-1.0, 0.0, 0.0));
        let finite = |n: usize| state.position(n).iter().all(|c| c.is_finite());
        assert_eq!(
            (0..25).filter(|&n| !finite(n)).collect::<Vec<_>>(),
            [bad],
            "a bad number stays where it is"
        );
        let next = state.position(mesh.order[1] as usize);
        assert!((next - state.position(held)).norm() < 1.12, "the free end came after the held one");
    }
}
