//! Hencky's clamped circular membrane as a regular triangular lattice of springs, which is a sheet
//! with ν = 1/3 and E t = 2 k/√3. Where the circle cuts a spring, the spring ends on it and is
//! stiffer as it is shorter.

use super::case::{BALANCE, Case, Chart, Depth, Outcome, Series};
use super::hencky::Truth;
use super::net::{Link, Net, NetSpec};
use serde_json::Value;
use std::collections::BTreeMap;

/// The case.
pub const CASE: Case = Case {
    name: "hencky-springs",
    title: "Hencky's membrane as a lattice of springs",
    ours: "quasi-static springs",
    run,
};

/// k, µN/mm.
const STIFFNESS: f64 = 1000.0;
/// p a/(E t).
const LOAD: f64 = 1e-4;
/// A lattice point nearer to the circle than this share of the spacing lies on it.
const SNAP: f64 = 0.25;

fn run(reference: &Value, depth: Depth) -> Outcome {
    // Between the tabulated 0.3 and 0.4 the same differential equation is solved for 1/3.
    let truth = Truth::new(1.0 / 3.0);
    truth.agrees_with(reference);
    let young = 2.0 / libm::sqrt(3.0) * STIFFNESS;
    let mut height = Series::new("height of the middle / radius", truth.height * libm::cbrt(LOAD));
    let mut tension = Series::new("tension of the middle, uN/mm", truth.tension(young, LOAD));
    let mut outcome = Outcome::default().refined_by("spacing / radius");
    outcome.solution = Chart::new("distance from the middle / radius", "height / radius");
    outcome.solution.line("reference", truth.profile(LOAD));
    let mut finest = 0;
    for rings in depth.of(&[8u32, 12, 16, 24, 32], 3) {
        let (mut spec, middle) = lattice(rings);
        let spacing = 1.0 / f64::from(rings);
        let pressure = LOAD * young;
        let flat = spec.nodes.clone();
        spec.mass_g = 1e-6;
        let mut net = Net::new(&spec);
        let free = flat.len() - spec.pinned.len();
        for (n, p) in flat.iter().enumerate().take(free) {
            net.pull(n, [0.0, 0.0, pressure * spacing * spacing * 0.75f64.sqrt()]);
            let rise = height.reference * (1.0 - p[0] * p[0] - p[1] * p[1]);
            net.put(n, [p[0], p[1], rise]);
        }
        let left = net.balance(&BALANCE);
        assert!(left < 1e-6, "{rings} rings do not balance: {left}");
        height.found.push([spacing, net.at(middle)[2]]);
        tension.found.push([spacing, middle_tension(&net, &spec, middle) * 3f64.sqrt() / spacing]);
        let mut profile: Vec<[f64; 2]> = (0..free)
            .map(|n| net.at(n))
            .filter(|p| p[1].abs() < 0.1 * spacing)
            .map(|p| [p[0].abs(), p[2]])
            .collect();
        profile.sort_by(|a, b| a[0].total_cmp(&b[0]));
        outcome.solution.curves.truncate(1);
        outcome.solution.marks("ours", profile);
        finest = rings;
    }
    outcome.add(height, format!("{finest} springs a radius"), 0.01);
    outcome.add(tension, format!("{finest} springs a radius"), 0.02);
    outcome
}

/// Mean tension of the springs at the middle, µN.
fn middle_tension(net: &Net, spec: &NetSpec, middle: usize) -> f64 {
    let mine: Vec<&Link> = spec.links.iter().filter(|l| l.ends.contains(&(middle as u32))).collect();
    let pull = |l: &&Link| {
        let [a, b] = l.ends.map(|n| nalgebra::Vector3::from(net.at(n as usize)));
        l.stiffness * ((a - b).norm() - l.rest)
    };
    mine.iter().map(pull).sum::<f64>() / mine.len() as f64
}

/// The lattice with `rings` springs along a radius of 1 mm, free nodes first; and its middle node.
fn lattice(rings: u32) -> (NetSpec, usize) {
    let h = 1.0 / f64::from(rings);
    let reach = rings as i32 + 1;
    let at =
        |i: i32, j: i32| [h * (f64::from(i) + 0.5 * f64::from(j)), h * 0.75f64.sqrt() * f64::from(j), 0.0];
    let inside = |p: [f64; 3]| libm::hypot(p[0], p[1]) < 1.0 - SNAP * h;
    let mut spec = NetSpec::default();
    let mut number = BTreeMap::new();
    for (i, j) in (-2 * reach..=2 * reach).flat_map(|j| (-2 * reach..=2 * reach).map(move |i| (i, j))) {
        if inside(at(i, j)) {
            number.insert((i, j), spec.nodes.len() as u32);
            spec.nodes.push(at(i, j));
        }
    }
    let middle = number[&(0, 0)] as usize;
    let around = [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)];
    for (&(i, j), &a) in &number {
        let neighbour = |k: usize| (i + around[k % 6].0, j + around[k % 6].1);
        for k in 0..6 {
            match number.get(&neighbour(k)) {
                Some(&b) if a < b => spec.links.push(Link { ends: [a, b], stiffness: STIFFNESS, rest: h }),
                Some(_) => {}
                None => {
                    let (i, j) = neighbour(k);
                    cut(&mut spec, a, at(i, j), h);
                }
            }
            if let (Some(&b), Some(&c)) = (number.get(&neighbour(k)), number.get(&neighbour(k + 1))) {
                // Each triangle once: from its lowest node.
                if a < b && a < c {
                    spec.triangles.push([a, b, c]);
                }
            }
        }
    }
    (spec, middle)
}

/// A spring from node `a` towards `outside`, ended by a pinned node on the circle.
fn cut(spec: &mut NetSpec, a: u32, outside: [f64; 3], h: f64) {
    let p = spec.nodes[a as usize];
    let d = [(outside[0] - p[0]) / h, (outside[1] - p[1]) / h];
    let along = p[0] * d[0] + p[1] * d[1];
    let rest = -along + libm::sqrt(along * along + 1.0 - p[0] * p[0] - p[1] * p[1]);
    let end = spec.nodes.len() as u32;
    spec.nodes.push([p[0] + rest * d[0], p[1] + rest * d[1], 0.0]);
    spec.pinned.push(end);
    spec.links.push(Link { ends: [a, end], stiffness: STIFFNESS * h / rest, rest });
}
