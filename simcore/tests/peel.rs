//! The peel force against Rivlin's and Kendall's formulas.

#[path = "../examples/validation/strip.rs"]
mod strip;

use std::f64::consts::{FRAC_PI_2, PI};
use strip::PeelTest;

/// Force over the formula, less one. The work per area must be Γ, and a little that the fold's snapping costs.
fn error(test: &PeelTest) -> f64 {
    let (found, expected) = (test.run(), test.kendall_un_per_mm());
    let error = found.force_un_per_mm / expected - 1.0;
    let (degrees, [low, high]) = (test.angle_rad.to_degrees(), found.range_un_per_mm);
    println!(
        "{degrees:.0}°, mesh {} mm: {:.1} µN/mm ({low:.0} to {high:.0}), expected {expected:.1}, {:+.1} %; work {:.1} µN/mm",
        test.spacing_mm,
        found.force_un_per_mm,
        100.0 * error,
        found.energy_un_per_mm
    );
    let work = found.energy_un_per_mm / test.energy_un_per_mm;
    assert!((0.98..1.08).contains(&work), "{work}");
    error
}

#[test]
fn peel_force_is_energy_times_width_at_a_right_angle_and_steeper() {
    for angle_rad in [FRAC_PI_2, 0.75 * PI] {
        let e = error(&PeelTest { angle_rad, ..PeelTest::default() });
        assert!(e.abs() < 0.05, "{e}");
    }
}

#[test]
fn peel_force_folded_back_is_half_of_it() {
    let folded = |spacing_mm, bending_un_mm| PeelTest {
        angle_rad: PI,
        lift_mm: 0.4,
        spacing_mm,
        bending_un_mm,
        rows: 5,
        step: 0.5,
        ..PeelTest::default()
    };
    let (coarse, fine) = (error(&folded(0.1, 10.0)), error(&folded(0.05, 10.0)));
    assert!(coarse.abs() < 0.05 && fine.abs() < 0.03, "{coarse} {fine}");
}

#[test]
fn peel_force_knows_neither_mesh_nor_step_nor_range_nor_speed() {
    let base = PeelTest::default();
    let coarse = PeelTest { spacing_mm: 0.2, rows: 5, ..base };
    let variants = [
        coarse,
        PeelTest { step: 0.35, ..base },
        PeelTest { range_mm: 0.3, ..base },
        PeelTest { speed_mm_s: 0.4, ..base },
    ];
    for test in variants {
        let e = error(&test);
        assert!(e.abs() < 0.05, "{e} {test:?}");
    }
}
