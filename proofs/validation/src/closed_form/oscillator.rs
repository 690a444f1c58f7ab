//! One mass on one spring: what each integrator of the explicit core does to a harmonic oscillator.

use super::case::{Case, Chart, Depth, Outcome, Series, number};
use super::modes::frequency;
use super::net::{Link, Net, NetSpec};
use serde_json::Value;

/// The case.
pub const CASE: Case =
    Case { name: "oscillator", title: "Integrators on an oscillator", ours: "explicit core", run };

/// Mass, g.
const MASS: f64 = 0.5;
/// Amplitude, mm, on a spring of 1 mm.
const AMPLITUDE: f64 = 0.01;

/// Displacements (mm) and velocities (mm/s) after each of `steps` substeps.
fn swing(omega: f64, dt: f64, explicit: bool, fluid: f64, damping: f64, steps: usize) -> Vec<[f64; 2]> {
    let mut net = Net::new(&NetSpec {
        nodes: vec![[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        links: vec![Link { ends: [0, 1], stiffness: omega * omega * MASS, rest: 1.0 }],
        pinned: vec![0],
        mass_g: MASS,
        fluid_per_s: fluid,
        damping,
        ..NetSpec::default()
    });
    net.put(1, [AMPLITUDE, 0.0, 0.0]);
    (net.tissue.dt_s, net.tissue.explicit) = (dt as f32, explicit);
    let node = net.node(1);
    let mut found = vec![[AMPLITUDE, 0.0]];
    for _ in 0..steps {
        net.march();
        found.push([net.at(1)[0], f64::from(net.state.velocity(node).x)]);
    }
    found
}

fn run(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("integrators_on_harmonic_oscillator/{key}"));
    let (omega, h) = (of("omega"), of("h"));
    let mut outcome = Outcome::default().refined_by("substep, s");
    let mut one = |quantity: &str, key: &str, ours: f64, resolution: String, allowed: f64| {
        let series = Series { quantity: quantity.into(), reference: of(key), found: vec![[h, ours]] };
        outcome.add(series, resolution, allowed);
    };

    let explicit = swing(omega, h, true, 0.0, 0.0, 20);
    let energy = |[x, v]: [f64; 2]| v * v + omega * omega * x * x;
    let growth = libm::pow(energy(explicit[20]) / energy(explicit[0]), 1.0 / 20.0);
    one(
        "explicit: energy growth a step",
        "explicit_euler_energy_growth_per_step",
        growth,
        "20 steps".into(),
        1e-4,
    );

    let symplectic = swing(omega, h, false, 0.0, 0.0, 400);
    let x: Vec<f64> = symplectic.iter().map(|s| s[0]).collect();
    let found = frequency(&x, f64::from(h as f32));
    one("semi-implicit: frequency, rad/s", "symplectic_euler_frequency", found, "400 steps".into(), 1e-4);

    let limit = stability_limit(omega);
    let key = "symplectic_euler_stability_limit_h";
    one("semi-implicit: largest stable step, s", key, limit, "1,000 steps".into(), 0.005);

    for (name, fluid, damping) in
        [("damped by the fluid", 6.0, 0.0), ("damped along the spring", 0.0, 6.0 * MASS)]
    {
        let (series, chart) = damped(name, omega, [fluid, damping], depth);
        let finest = series.found.last().map_or(f64::NAN, |f| f[0]);
        outcome.add(series, format!("step {finest:.4} s"), 0.01);
        outcome.solution = chart;
    }
    outcome
}

/// Bisects for the step over which 1,000 steps run away.
fn stability_limit(omega: f64) -> f64 {
    let (mut low, mut high) = (1.0 / omega, 4.0 / omega);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        let last = swing(omega, middle, false, 0.0, 0.0, 1000)[1000];
        let bounded = last[0].abs() < 20.0 * AMPLITUDE;
        (low, high) = if bounded { (middle, high) } else { (low, middle) };
    }
    low
}

/// exp(−g t)(cos w t + g/w sin w t) with w² = ω² − g², g = 3: its value where t = 0.43 s.
fn damped(name: &str, omega: f64, [fluid, damping]: [f64; 2], depth: Depth) -> (Series, Chart) {
    let g = 3.0;
    let w = libm::sqrt(omega * omega - g * g);
    let exact = |t: f64| AMPLITUDE * libm::exp(-g * t) * (libm::cos(w * t) + g / w * libm::sin(w * t));
    let end = 0.43;
    let mut series = Series::new(format!("{name}: place after 0.43 s, mm"), exact(end));
    let mut chart = Chart::new("time, s", "displacement, mm");
    chart.line(
        "reference",
        (0..=200).map(|i| [end * f64::from(i) / 200.0, exact(end * f64::from(i) / 200.0)]).collect(),
    );
    for steps in depth.of(&[500usize, 1000, 2000, 4000], 3) {
        let dt = end / steps as f64;
        let found = swing(omega, dt, false, fluid, damping, steps);
        series.found.push([dt, found[steps][0]]);
        if steps == 500 {
            let sparse = found.iter().enumerate().step_by(10);
            chart.marks("ours, step 1 ms", sparse.map(|(i, s)| [dt * i as f64, s[0]]).collect());
        }
    }
    (series, chart)
}
