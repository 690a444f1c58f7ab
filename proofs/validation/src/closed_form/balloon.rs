//! Closed and clamped membranes under pressure: a neo-Hookean balloon, and a taut film that becomes
//! a spherical cap.

use super::case::{BALANCE, Case, Chart, Depth, Outcome, Series, number, value};
use super::mesh::{disc, is_rim, sphere};
use serde_json::Value;
use std::f64::consts::PI;
use tissue::elements::integrator::{Integrator, Rule, forces_un};
use tissue::elements::law::PlaneLaw;
use tissue::elements::load::Pressure;
use tissue::elements::triangle::Triangles;
use tissue::elements::{Both, Nodes};

/// A balloon blown up through its limit point.
pub const BALLOON: Case = Case {
    name: "balloon",
    title: "Neo-Hookean balloon",
    ours: "membrane elements, quasi-static",
    run: balloon,
};

/// A bleb.
pub const CAP: Case = Case {
    name: "spherical-cap",
    title: "Taut membrane blown up to a spherical cap",
    ours: "membrane elements, quasi-static",
    run: cap,
};

fn balloon(reference: &Value, depth: Depth) -> Outcome {
    let table = value(reference, "neo_hookean_balloon/p_over_2mu_t0_over_r0");
    let table: Vec<(f64, f64)> = table.as_object().map_or(Vec::new(), |t| {
        t.iter().map(|(l, p)| (l.parse().expect("a stretch"), p.as_f64().expect("a pressure"))).collect()
    });
    let mut outcome = Outcome::default().refined_by("edge / radius");
    outcome.solution = Chart::new("stretch", "pressure / (2 mu t / r)");
    let closed = |l: f64| [l, 1.0 / l - libm::pow(l, -7.0)];
    outcome.solution.line("reference", (0..=100).map(|i| closed(1.0 + 0.011 * f64::from(i))).collect());
    let mut finest = Vec::new();
    for &(stretch, pressure) in &table {
        let mut series = Series::new(format!("pressure at stretch {stretch:.3}"), pressure);
        // Before, at and past the limit point the meshes are refined; elsewhere one will do.
        let reported = [1.1, 1.3830875542684884, 2.0].contains(&stretch);
        for times in if reported { depth.of(&[1u32, 2, 3], 2) } else { vec![2] } {
            series.found.push([1.05 / f64::from(1 << times), blow(times, stretch, pressure)]);
        }
        finest.push([stretch, series.found.last().map_or(f64::NAN, |f| f[1])]);
        let faces = 20 << (2 * series.found.len());
        if reported {
            outcome.add(series, format!("{faces} triangles"), 0.01);
        }
    }
    outcome.solution.marks("ours", finest);
    outcome
}

/// Pressure over 2 µ t/r₀ of a sphere that holds stretch³ times its volume; `guess` is about the
/// answer. The volume is prescribed: past the limit point no constant pressure is stable.
fn blow(times: u32, stretch: f64, guess: f64) -> f64 {
    let shear = 100.0;
    let (rest, triangles) = sphere(times);
    let elements =
        Triangles::new(&rest, &triangles, PlaneLaw::NeoHookean { shear_un_per_mm: shear }).expect("a mesh");
    let mut pressure = Pressure::new(triangles, 0.0);
    pressure.bulk_pa_per_mm3 = 20.0 * shear;
    let target = pressure.volume_mm3(&rest) * stretch * stretch * stretch;
    pressure.volume_mm3 = target + guess * 2.0 * shear / pressure.bulk_pa_per_mm3;
    let mut nodes = Nodes::at_rest(rest.iter().map(|x| x * stretch).collect(), 1e-3);
    let mut both = Both(elements, pressure);
    let mut integrator = Integrator::default();
    // The penalty gives way by p/bulk; a few corrections of the prescribed volume make the held one
    // exact.
    for _ in 0..3 {
        integrator.step(&mut nodes, &mut both, Rule::QuasiStatic, &BALANCE, [1.0, 0.0]);
        both.1.volume_mm3 += target - both.1.volume_mm3(&nodes.x_mm);
    }
    integrator.step(&mut nodes, &mut both, Rule::QuasiStatic, &BALANCE, [1.0, 0.0]);
    both.1.now_pa(&nodes.x_mm) / (2.0 * shear)
}

fn cap(reference: &Value, depth: Depth) -> Outcome {
    let of = |key: &str| number(reference, &format!("spherical_cap/example/{key}"));
    let (c, h, radius) = (of("c"), of("h"), of("R"));
    let tension = 40.0;
    let angle = 2.0 * libm::atan(h / c);
    let mut height = Series::new("height, mm", h);
    let mut volume = Series::new("volume, mm3", of("V"));
    let mut area = Series::new("area, mm2", PI * (c * c + h * h));
    let mut pull = Series::new("inward pull on the rim, uN/mm", tension * libm::cos(angle));
    let mut outcome = Outcome::default().refined_by("ring / radius");
    let mut finest = 0;
    for rings in depth.of(&[6u32, 12, 24, 48], 2) {
        let (nodes, both) = bleb(c, rings, tension, 2.0 * tension / radius);
        let size = 1.0 / f64::from(rings);
        height.found.push([size, nodes.x_mm[0].z]);
        volume.found.push([size, both.1.volume_mm3(&nodes.x_mm)]);
        let now: f64 = super::mesh::areas(&nodes.x_mm, &both.1.triangles).iter().sum();
        area.found.push([size, now]);
        let mut force = Vec::new();
        forces_un(&nodes, &both, &mut force);
        let rim = (0..nodes.x_mm.len()).filter(|&n| is_rim(n, rings));
        let inward: f64 = rim.map(|n| -force[n].dot(&nodes.x_mm[n]) / c).sum();
        pull.found.push([size, inward / (2.0 * PI * c)]);
        outcome.solution = Chart::new("distance from the middle, mm", "height, mm");
        let round = |r: f64| [r, libm::sqrt(radius * radius - r * r) - radius + h];
        outcome.solution.line("reference", (0..=50).map(|i| round(c * f64::from(i) / 50.0)).collect());
        let spoke = |ring: u32| if ring == 0 { 0 } else { 1 + 3 * ring as usize * (ring as usize - 1) };
        let spokes = (0..=rings).map(|r| nodes.x_mm[spoke(r)]);
        outcome.solution.marks("ours", spokes.map(|x| [x.x, x.z]).collect());
        finest = rings;
    }
    for series in [height, volume, area, pull] {
        outcome.add(series, format!("{finest} rings"), 0.02);
    }
    outcome
}

/// A disc of radius `c`, taut with `tension`, under `pressure` from below.
fn bleb(c: f64, rings: u32, tension: f64, pressure: f64) -> (Nodes, Both<Triangles, Pressure>) {
    let (flat, triangles) = disc(c, rings);
    let law = PlaneLaw::Taut { tension_un_per_mm: tension };
    let elements = Triangles::new(&flat, &triangles, law).expect("a mesh");
    let mut nodes = Nodes::at_rest(flat, 1e-3);
    (0..nodes.held.len()).for_each(|n| nodes.held[n] = is_rim(n, rings));
    let mut both = Both(elements, Pressure::new(triangles, pressure));
    let mut integrator = Integrator::default();
    let settings = BALANCE;
    let effort = integrator.step(&mut nodes, &mut both, Rule::QuasiStatic, &settings, [1.0, 0.0]);
    assert!(effort.residual < 1e-6, "{rings} rings do not balance: {effort:?}");
    (nodes, both)
}
