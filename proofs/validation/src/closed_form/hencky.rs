//! Hencky's problem: a circular membrane, clamped and flat without tension, under pressure.

use super::case::{BALANCE, Case, Chart, Depth, Outcome, Series, number};
use super::mesh::{areas, disc, is_rim};
use serde_json::Value;
use tissue::elements::integrator::{Integrator, Rule};
use tissue::elements::law::PlaneLaw;
use tissue::elements::triangle::Triangles;
use tissue::elements::{Nodes, Point};

/// The case.
pub const CASE: Case = Case {
    name: "hencky-elements",
    title: "Hencky's membrane of constant-strain triangles",
    ours: "membrane elements, quasi-static",
    run,
};

/// E t, µN/mm.
const YOUNG: f64 = 1000.0;
/// p a/(E t): Hencky's equations hold as this goes to 0; here they are off by 1e-4.
const LOAD: f64 = 1e-6;

/// The solution for any ν: with N = E t q^⅔ Y and w = a q^⅓ W, q = p a/(E t), r from 0 to 1,
/// Y″ = −3 Y′/r − 1/(8 Y²), Y′(0) = 0, (1 − ν) Y(1) + Y′(1) = 0, W′ = −r/(2 Y).
pub struct Truth {
    poisson: f64,
    /// W(0).
    pub height: f64,
    /// Y(0).
    middle: f64,
    /// W over r.
    profile: Vec<[f64; 2]>,
}

impl Truth {
    /// By Runge and Kutta, and bisection for Y(0).
    pub fn new(poisson: f64) -> Self {
        let edge = |start: f64| {
            let [y, slope] = shoot(start)[STEPS];
            (1.0 - poisson) * y + slope
        };
        let (mut low, mut high) = (0.3, 1.2);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            (low, high) = if edge(middle) < 0.0 { (middle, high) } else { (low, middle) };
        }
        let y = shoot(low);
        let h = 1.0 / STEPS as f64;
        let slope = |i: usize| h * i as f64 / (2.0 * y[i][0]);
        // Simpson's rule over two steps at a time, from the rim inwards.
        let (mut w, mut profile) = (0.0, vec![[1.0, 0.0]]);
        for i in (2..=STEPS).rev().step_by(2) {
            w += h / 3.0 * (slope(i) + 4.0 * slope(i - 1) + slope(i - 2));
            profile.push([h * (i - 2) as f64, w]);
        }
        Truth { poisson, height: w, middle: low, profile }
    }

    /// Tension of the middle, µN/mm.
    pub fn tension(&self, young: f64, load: f64) -> f64 {
        self.middle * young * libm::pow(load, 2.0 / 3.0)
    }

    /// Height over distance from the middle, both as shares of the radius.
    pub fn profile(&self, load: f64) -> Vec<[f64; 2]> {
        let scale = libm::cbrt(load);
        self.profile.iter().step_by(20).map(|[r, w]| [*r, w * scale]).collect()
    }

    /// Panics unless the tabulated solutions, found by someone else, agree with those found here.
    pub fn agrees_with(&self, reference: &Value) {
        for poisson in ["0.2", "0.3", "0.4", "0.49"] {
            let of = |key: &str| number(&reference["hencky_circular_membrane"]["by_poisson"][poisson], key);
            let own = Truth::new(poisson.parse().expect("a number"));
            assert!(
                (own.height / of("w0_coefficient") - 1.0).abs() < 1e-6,
                "{} {}",
                own.height,
                self.poisson
            );
            assert!((4.0 * own.middle / of("b0") - 1.0).abs() < 1e-6);
        }
    }
}

const STEPS: usize = 2000;

/// Y and Y′ from the middle to the rim.
fn shoot(start: f64) -> Vec<[f64; 2]> {
    let h = 1.0 / STEPS as f64;
    let change = |r: f64, [y, s]: [f64; 2]| {
        // The limit of 3 Y′/r in the middle is 3 Y″.
        let bend = if r > 0.0 { -3.0 * s / r - 0.125 / (y * y) } else { -0.03125 / (y * y) };
        [s, bend]
    };
    let add = |[y, s]: [f64; 2], [dy, ds]: [f64; 2], by: f64| [y + dy * by, s + ds * by];
    let mut all = vec![[start, 0.0]];
    for i in 0..STEPS {
        let (r, now) = (h * i as f64, all[i]);
        let k1 = change(r, now);
        let k2 = change(r + 0.5 * h, add(now, k1, 0.5 * h));
        let k3 = change(r + 0.5 * h, add(now, k2, 0.5 * h));
        let k4 = change(r + h, add(now, k3, h));
        all.push(add(add(now, add(k1, k4, 1.0), h / 6.0), add(k2, k3, 1.0), h / 3.0));
    }
    all
}

fn run(reference: &Value, depth: Depth) -> Outcome {
    let mut outcome = Outcome::default().refined_by("ring / radius");
    outcome.solution = Chart::new("distance from the middle / radius", "height / radius");
    for name in ["0.2", "0.3", "0.4", "0.49"] {
        let poisson: f64 = name.parse().expect("a number");
        let table = &reference["hencky_circular_membrane"]["by_poisson"][name];
        let (scale, tension_scale) = (libm::cbrt(LOAD), YOUNG * libm::pow(LOAD, 2.0 / 3.0));
        let mut height = Series::new(format!("height, nu {name}"), number(table, "w0_coefficient") * scale);
        let of = number(table, "b0") / 4.0 * tension_scale;
        let mut tension = Series::new(format!("tension of the middle, nu {name}, uN/mm"), of);
        let mut finest = 0;
        for rings in depth.of(&[6u32, 12, 24], 2) {
            let (nodes, triangles) = inflate(poisson, rings, height.reference);
            height.found.push([1.0 / f64::from(rings), nodes.x_mm[0].z]);
            let [first, second] = triangles.tensions_un_per_mm(0, &nodes.x_mm);
            tension.found.push([1.0 / f64::from(rings), 0.5 * (first + second)]);
            finest = rings;
            if name == "0.3" {
                let spoke =
                    |ring: u32| if ring == 0 { 0 } else { 1 + 3 * ring as usize * (ring as usize - 1) };
                let spokes = (0..=rings).map(|r| nodes.x_mm[spoke(r)]);
                outcome.solution.curves.clear();
                outcome.solution.line("reference, nu 0.3", Truth::new(0.3).profile(LOAD));
                outcome.solution.marks("ours", spokes.map(|x| [x.x, x.z]).collect());
            }
        }
        outcome.add(height, format!("{finest} rings"), 0.01);
        outcome.add(tension, format!("{finest} rings"), 0.02);
    }
    // The curves in between lie on these.
    outcome.refinement.curves.retain(|c| !c.name.contains("0.3") && !c.name.contains("0.4,"));
    outcome.refinement.curves.retain(|c| !c.name.ends_with("0.4"));
    outcome
}

/// A disc of radius 1 mm under the load, from a paraboloid of about the right height.
fn inflate(poisson: f64, rings: u32, height: f64) -> (Nodes, Triangles) {
    let (flat, triangles) = disc(1.0, rings);
    let law = PlaneLaw::StVenantKirchhoff { young_un_per_mm: YOUNG, poisson };
    let mut elements = Triangles::new(&flat, &triangles, law).expect("a mesh");
    let area = areas(&flat, &triangles);
    let lifted = flat.iter().map(|x| x + Point::new(0.0, 0.0, height * (1.0 - x.norm_squared())));
    let mut nodes = Nodes::at_rest(lifted.collect(), 1e-6);
    for (n, rim) in (0..flat.len()).map(|n| (n, is_rim(n, rings))) {
        nodes.held[n] = rim;
        nodes.outer_un[n].z = LOAD * YOUNG * area[n];
    }
    let mut integrator = Integrator::default();
    let settings = BALANCE;
    let effort = integrator.step(&mut nodes, &mut elements, Rule::QuasiStatic, &settings, [1.0, 0.0]);
    assert!(effort.residual < 1e-6, "{rings} rings, nu {poisson} do not balance: {effort:?}");
    (nodes, elements)
}
