//! Patch test: a block whose surface is displaced by u = G X must be strained by G everywhere,
//! whatever its tetrahedra.

use super::case::{BALANCE, Case, Chart, Depth, Outcome, Series, number, value};
use nalgebra::Matrix3;
use serde_json::Value;
use tissue::elements::integrator::{Integrator, Rule};
use tissue::elements::law::{Lame, SolidLaw};
use tissue::elements::solid::{EDGES, Solid, block, with_middles};
use tissue::elements::{Nodes, Point};

/// The case.
pub const CASE: Case = Case {
    name: "patch-test",
    title: "Patch test of tetrahedra",
    ours: "volume elements, quasi-static",
    run,
};

fn run(reference: &Value, _: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("fem_patch_test/{key}"));
    let lame = Lame::from_young(of("E"), of("nu"));
    let gradient = matrix(value(reference, "fem_patch_test/displacement_gradient"));
    let stress = matrix(value(reference, "fem_patch_test/stress"));
    let mut outcome = Outcome::default().refined_by("share of the displacement");
    outcome.solution = Chart::new("component of the stress (xx yy zz xy yz)", "Pa");
    let parts = |m: &Matrix3<f64>| {
        let all = [m.m11, m.m22, m.m33, m.m12, m.m23];
        all.iter().enumerate().map(|(i, s)| [i as f64 + 1.0, *s]).collect::<Vec<_>>()
    };
    outcome.solution.line("reference", parts(&stress));
    for (name, law, quadratic) in [
        ("4 nodes, co-rotational", SolidLaw::Corotational(lame), false),
        ("4 nodes, neo-Hookean", SolidLaw::NeoHookean(lame), false),
        ("10 nodes, co-rotational", SolidLaw::Corotational(lame), true),
    ] {
        // The stress of every sample is compared; the norm of the worst one is reported. Finite
        // strain adds a term of its own size, so the error falls with the displacement, down to
        // rounding.
        let mut series = Series::new(format!("{name}: stress, Pa"), stress.norm());
        for share in [1.0, 0.1, 0.01] {
            let found = if quadratic {
                stresses::<10>(law, &(gradient * share), share)
            } else {
                stresses::<4>(law, &(gradient * share), share)
            };
            let worst = found.iter().map(|s| (s - stress).norm()).fold(0.0, f64::max);
            series.found.push([share, stress.norm() + worst]);
            if share == 0.01 && !quadratic {
                outcome.solution.marks(name, parts(&found[0]));
            }
        }
        outcome.add(series, "worst of all elements", 0.001);
    }
    outcome
}

fn matrix(rows: &Value) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c].as_f64().expect("a matrix of numbers"))
}

/// Stress over `share` in every sample of a block whose inner nodes were moved at random.
fn stresses<const N: usize>(law: SolidLaw, gradient: &Matrix3<f64>, share: f64) -> Vec<Matrix3<f64>> {
    let (mut x, corners) = block([1.0, 1.0, 1.0], [3, 3, 3]);
    let on_surface = |x: &Point| x.iter().any(|c| !(1e-9..=1.0 - 1e-9).contains(c));
    let mut turn = 1.0;
    for x in x.iter_mut().filter(|x| !on_surface(x)) {
        turn *= -1.3;
        *x += Point::new(libm::sin(turn), libm::cos(2.0 * turn), libm::sin(3.0 * turn)) * 0.06;
    }
    let quadratic = with_middles(&mut x, &corners);
    let mut elements: Vec<[u32; N]> = Vec::new();
    for nodes in &quadratic {
        elements.push(std::array::from_fn(|i| nodes[i]));
    }
    if N == 4 {
        x.truncate(x.len() - edges(&quadratic));
    }
    let count = elements.len();
    let mut solid = Solid::new(&x, elements, law).expect("a mesh");
    let mut nodes = Nodes::at_rest(x.clone(), 1e-3);
    for (n, x) in x.iter().enumerate() {
        nodes.held[n] = on_surface(x);
        let to = x + gradient * x;
        nodes.x_mm[n] = if nodes.held[n] { to } else { *x };
    }
    let mut integrator = Integrator::default();
    for _ in 0..2 {
        integrator.step(&mut nodes, &mut solid, Rule::QuasiStatic, &BALANCE, [1.0, 0.0]);
    }
    (0..count).flat_map(|e| solid.stress_pa(e, &nodes.x_mm).collect::<Vec<_>>()).map(|s| s / share).collect()
}

/// Middle nodes of a quadratic mesh.
fn edges(quadratic: &[[u32; 10]]) -> usize {
    let middles: std::collections::BTreeSet<u32> =
        quadratic.iter().flat_map(|e| e[4..4 + EDGES.len()].iter().copied()).collect();
    middles.len()
}
