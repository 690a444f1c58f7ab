//! Tests of the solver: forces, motion, limits, and the same bits on every instruction set.

use super::*;
use scene::{MembraneIntegrator, MembraneScene, SceneFile};

fn peel(change: impl FnOnce(&mut MembraneScene)) -> (SheetMesh, SheetState, Solver, Material) {
    let mut scene = SceneFile::load("peel").unwrap();
    change(scene.membrane.as_mut().unwrap());
    let mesh = SheetMesh::new(&scene).unwrap();
    let state = mesh.start();
    let material = Material::new(&scene);
    let mut solver = Solver::new(&mesh);
    solver.refresh(&mesh, &state, &material);
    (mesh, state, solver, material)
}

fn centre(mesh: &SheetMesh) -> usize {
    mesh.nodes() / 2
}

#[test]
fn at_rest_nothing_moves() {
    let (mesh, mut state, mut solver, material) = peel(|_| {});
    let before = state.clone();
    for _ in 0..100 {
        assert_eq!(solver.accelerate(&mesh, &state, &material), Alarms::default());
        solver.integrate(&mut state, &material);
    }
    for i in 0..mesh.nodes() {
        assert!((state.position(i) - before.position(i)).norm() < 1e-4);
    }
}

#[test]
fn springs_obey_hooke_and_newtons_third_law() {
    let (mesh, mut state, mut solver, material) = peel(|m| m.bending_un_per_mm = 0.0);
    let node = centre(&mesh);
    state.position_mm[2][node] += 0.05;
    solver.accelerate(&mesh, &state, &material);
    let mut expected = nalgebra::Vector3::<f32>::zeros();
    for (s, ends) in mesh.springs[..mesh.structural].iter().enumerate() {
        if let Some(end) = ends.iter().position(|&n| n as usize == node) {
            let d = state.position(ends[1 - end] as usize) - state.position(node);
            expected += d.normalize() * 400.0 * (d.norm() - mesh.rest_mm[s]);
        }
    }
    let found = nalgebra::Vector3::from(solver.force_un.each_ref().map(|f| f[node]));
    assert!((found - expected).norm() < 2e-2, "{found} {expected}");
    for f in &solver.force_un {
        assert!(f.iter().sum::<f32>().abs() < 1e-2, "inner forces cancel");
    }
}

#[test]
fn a_pulled_sheet_comes_to_rest_in_both_modes() {
    for v_max in [300.0, 0.0] {
        let (mesh, mut state, mut solver, material) = peel(|m| m.v_max_mm_s = v_max);
        let node = centre(&mesh);
        state.position_mm[2][node] += 0.1;
        let mut energy = Vec::new();
        for _ in 0..3000 {
            solver.accelerate(&mesh, &state, &material);
            solver.integrate(&mut state, &material);
            let springs = 0..mesh.springs.len();
            energy.push(springs.map(|s| f64::from(solver.tension_un(s)).powi(2)).sum::<f64>());
        }
        assert!(energy[2999] < energy[0] * 1e-3, "{v_max}: {} {}", energy[0], energy[2999]);
    }
}

#[test]
fn limits_hold() {
    let (mesh, mut state, mut solver, material) = peel(|m| {
        m.a_max_mm_s2 = 1000.0;
        m.v_max_mm_s = 5.0;
    });
    let node = centre(&mesh);
    state.position_mm[2][node] += 0.2;
    let alarms = solver.accelerate(&mesh, &state, &material);
    assert!(alarms.over_acceleration && !alarms.not_finite);
    solver.integrate(&mut state, &material);
    assert!(state.velocity(node).norm() <= 1000.0 * 1e-3 * 1.001);
    state.set_velocity(node, nalgebra::Vector3::new(0.0, 0.0, 50.0));
    solver.accelerate(&mesh, &state, &material);
    solver.integrate(&mut state, &material);
    assert!(state.velocity(node).norm() <= 5.0 * 1.001);
}

#[test]
fn nodes_do_not_leave_the_eye() {
    let (mesh, mut state, mut solver, material) = peel(|_| {});
    let node = centre(&mesh);
    state.set_velocity(node, nalgebra::Vector3::new(0.0, 0.0, -300.0));
    for _ in 0..10 {
        solver.accelerate(&mesh, &state, &material);
        solver.integrate(&mut state, &material);
        assert!(state.position(node).norm() <= 11.5 + 1e-5);
    }
}

/// The sheet with every node moved a little, as `seed` says.
fn crumple(state: &mut SheetState, mut seed: u64) {
    for values in state.position_mm.iter_mut().chain(&mut state.velocity_mm_s) {
        for x in values {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            *x += ((seed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 0.1;
        }
    }
}

#[test]
fn leaving_pinned_blocks_out_changes_no_bit() {
    let (mesh, start, full, material) = peel(|_| {});
    // What is loose: nothing, one node, a strip, every second node, all.
    let loose: [&dyn Fn(usize) -> bool; 5] =
        [&|_| false, &|n| n == 40, &|n| (100..130).contains(&n), &|n| n % 2 == 0, &|_| true];
    let mut solvers = [full, Solver::new(&mesh).without_pinned()];
    for loose in loose {
        let mut states = [start.clone(), start.clone()];
        for (solver, state) in solvers.iter_mut().zip(&mut states) {
            let pinned = |n: usize| if loose(n) { NODE_FREE } else { crate::sheet::state::NODE_PINNED };
            state.flag.iter_mut().enumerate().for_each(|(n, flag)| *flag = pinned(n));
            crumple(state, 3);
            solver.refresh(&mesh, state, &material);
            for _ in 0..20 {
                solver.accelerate(&mesh, state, &material);
                solver.integrate(state, &material);
            }
        }
        assert!(states[0] == states[1]);
        let of_loose = |s: &[u32; 2]| s.iter().any(|&n| loose(n as usize));
        for (s, _) in mesh.springs[..mesh.structural].iter().enumerate().filter(|(_, ends)| of_loose(ends)) {
            assert_eq!(solvers[0].tension_un(s), solvers[1].tension_un(s));
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    for bending in [0.0, 4.0] {
        let runs: Vec<SheetState> = Isa::available()
            .into_iter()
            .map(|isa| {
                let (mesh, mut state, mut solver, material) = peel(|m| m.bending_un_per_mm = bending);
                solver.isa = isa;
                crumple(&mut state, 7);
                for _ in 0..100 {
                    solver.accelerate(&mesh, &state, &material);
                    solver.integrate(&mut state, &material);
                }
                state
            })
            .collect();
        assert!(runs.iter().all(|run| run == &runs[0]));
    }
}

#[test]
fn without_outer_forces_momentum_stays_to_rounding() {
    let (mesh, mut state, mut solver, material) = peel(|m| {
        (m.fluid_damping_per_s, m.a_max_mm_s2, m.v_max_mm_s) = (0.0, 1e12, 1e6);
    });
    let material = Material { radius_mm: 1e3, ..material };
    state.flag.fill(NODE_FREE);
    solver.refresh(&mesh, &state, &material);
    crumple(&mut state, 3);
    let sums = |state: &SheetState| {
        let mut linear = nalgebra::Vector3::<f64>::zeros();
        let mut angular = linear;
        for i in 0..state.nodes() {
            let (x, v) = (state.position(i).map(f64::from), state.velocity(i).map(f64::from));
            (linear, angular) = (linear + v, angular + x.cross(&v));
        }
        (linear, angular)
    };
    let before = sums(&state);
    let mut motion = 0.0;
    for _ in 0..500 {
        solver.accelerate(&mesh, &state, &material);
        solver.integrate(&mut state, &material);
        motion += (0..state.nodes()).map(|i| f64::from(state.velocity(i).norm())).sum::<f64>();
    }
    let after = sums(&state);
    // Every step rounds each velocity by 6e-8 of itself; lever arms are below 12 mm.
    let rounding = motion * 6e-8;
    assert!(motion > 1e4, "the mesh moves: {motion}");
    assert!((after.0 - before.0).norm() < rounding, "{} of {rounding}", (after.0 - before.0).norm());
    assert!((after.1 - before.1).norm() < 12.0 * rounding, "{}", (after.1 - before.1).norm());
}

/// One spring along x between a pinned and a free node, two triangles wide so that it is a mesh.
fn oscillator(change: impl FnOnce(&mut MembraneScene)) -> (SheetMesh, SheetState, Solver, Material) {
    let mut scene = SceneFile::load("peel").unwrap();
    let m = scene.membrane.as_mut().unwrap();
    (m.bending_un_per_mm, m.fluid_damping_per_s, m.spring_damping_un_s_per_mm) = (0.0, 0.0, 0.0);
    (m.stiffness_un_per_mm, m.node_mass_g, m.tear_tension_n_per_m) = (100.0, 0.01, 0.0);
    change(m);
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let mesh = SheetMesh::from_triangles(&corners, &[[0, 1, 2]], &[0, 2]).unwrap();
    let mesh = mesh.with_factors(&[1.0; 3], &[1.0; 3]).unwrap();
    let (state, material) = (mesh.start(), Material::new(&scene));
    let mut solver = Solver::new(&mesh);
    solver.refresh(&mesh, &state, &material);
    (mesh, state, solver, material)
}

#[test]
fn explicit_euler_moves_by_the_old_velocity_and_semi_implicit_by_the_new() {
    for integrator in [MembraneIntegrator::SemiImplicit, MembraneIntegrator::Explicit] {
        let (mesh, mut state, mut solver, material) = oscillator(|m| m.integrator = integrator);
        let node = mesh.order[1] as usize;
        state.set_velocity(node, nalgebra::Vector3::new(2.0, 0.0, 0.0));
        solver.outer_un[0][node] = 30.0;
        solver.accelerate(&mesh, &state, &material);
        solver.integrate(&mut state, &material);
        // a = F/m = 30/0.01 = 3,000 mm/s²; dt = 1 ms.
        let way = if integrator == MembraneIntegrator::Explicit { 2.0e-3 } else { 5.0e-3 };
        assert!((state.velocity(node).x - 5.0).abs() < 1e-4);
        assert!((state.position(node).x - 1.0 - way).abs() < 1e-6, "{integrator:?}");
    }
}

#[test]
fn the_oscillators_energy_follows_its_integrator() {
    // Semi-implicit Euler keeps energy within dt·ω/2 of its mean, explicit Euler multiplies it by 1
    // + dt²ω² a step.
    let energy = |integrator, steps: usize| {
        let (mesh, mut state, mut solver, material) = oscillator(|m| m.integrator = integrator);
        let node = mesh.order[1] as usize;
        state.position_mm[0][node] += 1e-3;
        for _ in 0..steps {
            solver.accelerate(&mesh, &state, &material);
            solver.integrate(&mut state, &material);
        }
        solver.accelerate(&mesh, &state, &material);
        let stored: f64 = (0..3).map(|s| f64::from(solver.tension_un(s)).powi(2) / 200.0).sum();
        stored + 0.005 * f64::from(state.velocity(node).norm_squared())
    };
    let (kept, fed) =
        (energy(MembraneIntegrator::SemiImplicit, 200), energy(MembraneIntegrator::Explicit, 200));
    let first = energy(MembraneIntegrator::SemiImplicit, 0);
    assert!((kept / first - 1.0).abs() < 0.12, "{kept} {first}");
    // ω² is between k/m for the spring in line and a little more for the one across.
    let growth = (fed / first).powf(1.0 / 200.0) - 1.0;
    assert!((0.009..0.018).contains(&growth), "{growth}");
}

#[test]
fn a_yielding_spring_stays_longer() {
    let (mesh, mut state, mut solver, material) = oscillator(|m| {
        (m.yield_strain, m.creep_per_s, m.fluid_damping_per_s) = (0.2, 5.0, 20.0);
    });
    assert!(material.is_plastic());
    state.rest_mm = mesh.rest_mm.clone();
    let node = mesh.order[1] as usize;
    let spring = mesh.springs.iter().position(|s| s.contains(&mesh.order[0]) && s.contains(&(node as u32)));
    let spring = spring.unwrap();
    state.flag[node] = crate::sheet::state::NODE_PINNED;
    state.position_mm[0][node] = 1.5;
    solver.refresh(&mesh, &state, &material);
    for _ in 0..2000 {
        solver.accelerate(&mesh, &state, &material);
        solver.creep(&mesh, &mut state, &material);
    }
    // Held at 1.5 mm it creeps until its strain is the yield: 1.5/l₀ − 1 = 0.2.
    assert!((state.rest_mm[spring] - 1.25).abs() < 1e-3, "{}", state.rest_mm[spring]);
    let rest = state.rest_mm.clone();
    state.position_mm[0][node] = 1.3;
    solver.accelerate(&mesh, &state, &material);
    solver.creep(&mesh, &mut state, &material);
    assert_eq!(state.rest_mm[spring], rest[spring], "below the yield it is elastic");
}
