//! Small vibrations of springs under the explicit core (semi-implicit Euler).
//!
//! A net starts in the shape of a mode and keeps it. Its amplitude q then obeys q₊ + q₋ = 2 cos(ω
//! dt) q to the bit noise, for whatever ω the integrator gives it; least squares over all substeps
//! yield ω.

use super::case::{Case, Chart, Depth, Outcome, Series, number, numbers};
use super::net::{Link, Net, NetSpec};
use serde_json::Value;
use std::f64::consts::PI;

/// Ten masses between two walls, along the line.
pub const CHAIN: Case = Case {
    name: "chain-modes",
    title: "Modes of a chain of ten masses",
    ours: "explicit core, semi-implicit",
    run: chain,
};

/// Eight by eight masses in a taut grid, across its plane.
pub const GRID: Case = Case {
    name: "grid-modes",
    title: "Modes of a taut grid of 8 x 8 masses",
    ours: "explicit core, semi-implicit",
    run: grid,
};

/// Angular frequency of a harmonic series at instants `dt` apart, rad/s.
pub fn frequency(q: &[f64], dt: f64) -> f64 {
    let inner = q.windows(3).map(|w| w[1] * (w[0] + w[2])).sum::<f64>();
    let square = q.windows(3).map(|w| 2.0 * w[1] * w[1]).sum::<f64>();
    libm::acos(inner / square) / dt
}

/// Frequency of `net` when node n begins at its place plus `shape`(n) along `axis`, from `steps`
/// substeps.
fn ring(mut net: Net, shape: &[f64], axis: usize, dt: f64, steps: usize) -> f64 {
    let start: Vec<[f64; 3]> = (0..shape.len()).map(|n| net.at(n)).collect();
    for (n, s) in shape.iter().enumerate() {
        let mut p = start[n];
        p[axis] += s;
        net.put(n, p);
    }
    net.tissue.dt_s = dt as f32;
    let amplitude =
        |net: &Net| -> f64 { (0..shape.len()).map(|n| (net.at(n)[axis] - start[n][axis]) * shape[n]).sum() };
    let q: Vec<f64> = (0..steps)
        .map(|_| {
            net.march();
            amplitude(&net)
        })
        .collect();
    frequency(&q, f64::from(dt as f32))
}

fn chain(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("spring_chain_fixed_fixed/{key}"));
    let omega = numbers(reference, "spring_chain_fixed_fixed/omega_rad_s");
    let (n, k, m) = (of("n_masses") as usize, of("k"), of("m"));
    let net = || {
        let links = (0..=n as u32).map(|i| Link { ends: [i, i + 1], stiffness: k, rest: 1.0 });
        Net::new(&NetSpec {
            nodes: (0..=n + 1).map(|i| [i as f64 - 5.5, 0.0, 0.0]).collect(),
            links: links.collect(),
            pinned: vec![0, n as u32 + 1],
            mass_g: m,
            ..NetSpec::default()
        })
    };
    let shape = |j: usize| -> Vec<f64> {
        (0..=n + 1).map(|i| 0.1 * libm::sin(PI * (j * i) as f64 / (n + 1) as f64)).collect()
    };
    let mut outcome = Outcome::default().refined_by("substep x highest frequency");
    outcome.solution = Chart::new("mode", "angular frequency, rad/s");
    outcome.solution.line("reference", (1..=n).map(|j| [j as f64, omega[j - 1]]).collect());
    let steps = depth.of(&[0.4, 0.2, 0.1], 2);
    let mut all = Vec::new();
    for j in 1..=n {
        let mut series = Series::new(format!("mode {j}, rad/s"), omega[j - 1]);
        for &size in &steps {
            let dt = size / omega[n - 1];
            let count = (4.0 * 2.0 * PI / (omega[j - 1] * dt)) as usize;
            series.found.push([size, ring(net(), &shape(j), 0, dt, count)]);
        }
        all.push([j as f64, series.found.last().map_or(f64::NAN, |f| f[1])]);
        if [1, 5, 10].contains(&j) {
            outcome.add(
                series,
                format!("{} of the highest mode's 1/frequency", steps[steps.len() - 1]),
                0.01,
            );
        }
    }
    outcome.solution.marks("ours", all);
    outcome
}

fn grid(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("tensioned_grid_membrane/{key}"));
    let (n, tension, spacing, mass) =
        (of("n") as usize, of("tension_per_spring"), of("spacing"), of("node_mass"));
    let omega = numbers(reference, "tensioned_grid_membrane/lowest_omega");
    let side = n + 2;
    let mut outcome = Outcome::default().refined_by("substep x lowest frequency");
    outcome.solution = Chart::new("mode", "angular frequency, rad/s");
    outcome.solution.line("reference", omega.iter().enumerate().map(|(i, w)| [i as f64 + 1.0, *w]).collect());
    let mut all = Vec::new();
    // In the order of their frequencies; (1,2) and (2,1), (1,3) and (3,1) are pairs.
    for (i, [j, k]) in [[1, 1], [1, 2], [2, 1], [2, 2], [1, 3], [3, 1]].into_iter().enumerate() {
        let mut series = Series::new(format!("mode {j},{k}, rad/s"), omega[i]);
        // At 0.4 the highest of the grid's modes is no longer stable, and rounding feeds it.
        for size in depth.of(&[0.2, 0.1, 0.05], 2) {
            let dt = size / omega[0];
            let wave = |mode: usize, at: usize| libm::sin(PI * (mode * at) as f64 / (n + 1) as f64);
            let shape: Vec<f64> =
                (0..side * side).map(|node| 1e-4 * wave(j, node % side) * wave(k, node / side)).collect();
            let net = taut_grid(side, tension, spacing, mass);
            series.found.push([size, ring(net, &shape, 2, dt, (12.0 * PI / (omega[i] * dt)) as usize)]);
        }
        all.push([i as f64 + 1.0, series.found.last().map_or(f64::NAN, |f| f[1])]);
        let finest = series.found.last().map_or(f64::NAN, |f| f[0]);
        if [0, 1, 3].contains(&i) {
            outcome.add(series, format!("{finest} of the lowest mode's 1/frequency"), 0.01);
        }
    }
    outcome.solution.marks("ours", all);
    outcome
}

/// Rows and columns of springs of half their length, so taut with `tension`; diagonals without
/// stiffness.
fn taut_grid(side: usize, tension: f64, spacing: f64, mass_g: f64) -> Net {
    let node = |r: usize, c: usize| (r * side + c) as u32;
    let mut spec = NetSpec { mass_g, ..NetSpec::default() };
    for (r, c) in (0..side).flat_map(|r| (0..side).map(move |c| (r, c))) {
        spec.nodes.push([c as f64 * spacing, r as f64 * spacing, 0.0]);
        if r == 0 || c == 0 || r == side - 1 || c == side - 1 {
            spec.pinned.push(node(r, c));
        }
        let mut link = |to: u32| {
            let (rest, stiffness) = (0.5 * spacing, tension / (0.5 * spacing));
            spec.links.push(Link { ends: [node(r, c), to], stiffness, rest });
        };
        if c + 1 < side {
            link(node(r, c + 1));
        }
        if r + 1 < side {
            link(node(r + 1, c));
        }
        if c + 1 < side && r + 1 < side {
            spec.triangles.push([node(r, c), node(r, c + 1), node(r + 1, c + 1)]);
            spec.triangles.push([node(r, c), node(r + 1, c + 1), node(r + 1, c)]);
        }
    }
    Net::new(&spec)
}
