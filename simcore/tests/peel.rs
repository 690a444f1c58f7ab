//! The peel force against Rivlin's and Kendall's formulas, and what a free strip rolls up to.

#[path = "../examples/validation/strip.rs"]
mod strip;

use nalgebra::Vector3;
use protocol::scene_file::CurlScene;
use simcore::membrane::curl::Curl;
use simcore::membrane::sheet::Sheet;
use simcore::membrane::solver::Solver;
use std::f64::consts::{FRAC_PI_2, PI};
use strip::{PeelTest, lattice};

/// Force over the formula, less one; says what was measured.
fn error(test: &PeelTest) -> f64 {
    let (found, expected) = (test.run(), test.kendall_un_per_mm());
    let error = found.force_un_per_mm / expected - 1.0;
    println!(
        "{:.0}°, {} mm: {found:?}, expected {expected:.1}, {:+.1} %",
        test.angle_rad.to_degrees(),
        test.spacing_mm,
        100.0 * error
    );
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

#[test]
fn a_free_sheet_rolls_to_the_radius_asked_for() {
    for radius_mm in [1.0, 2.0] {
        let [along_x, along_y] = curvatures_of_a_free_sheet(radius_mm);
        let found = 1.0 / (along_x + along_y);
        println!("asked for {radius_mm} mm, found {found} mm; curvatures {along_x} and {along_y} 1/mm");
        assert!((found / radius_mm - 1.0).abs() < 0.05, "{found}");
    }
}

/// Lays a free sheet of 4.2 by 2.9 mm flat, waits until it has rolled up one way or the other, and measures two
/// curvatures of its middle at right angles, 1/mm: their sum is that of the roll, whichever way it goes.
fn curvatures_of_a_free_sheet(radius_mm: f64) -> [f64; 2] {
    let strip = PeelTest {
        spacing_mm: 0.15,
        rows: 23,
        stiffness_un_per_mm: 2000.0,
        step: 0.5,
        ..PeelTest::default()
    };
    let columns = 29;
    let (positions, triangles) = lattice(strip.spacing_mm, strip.rows, columns);
    let sheet = Sheet::from_triangles(&positions, &triangles, &[]).unwrap();
    let curl = Curl::new(&sheet, &CurlScene { stiffness_un_mm: 5.0, radius_mm });
    let mut tissue = strip.tissue();
    tissue.fluid_per_s = 1.5;
    let (mut membrane, mut solver) = (sheet.start(), Solver::new(&sheet));
    solver.refresh(&sheet, &membrane, &tissue);
    for step in 0..(20.0 / tissue.dt_s) as u64 {
        solver.clear_outer();
        curl.bend(&membrane, None, &mut solver.outer_un);
        if step == 0 {
            let sums = solver.outer_un.each_ref().map(|f| f.iter().sum::<f32>().abs());
            assert!(sums.iter().all(|s| *s < 1e-3), "inner forces cancel: {sums:?}");
        }
        solver.accelerate(&sheet, &membrane, &tissue);
        solver.integrate(&mut membrane, &tissue);
    }
    let at =
        |r: u32, c: u32| membrane.position(sheet.order[(r * columns + c) as usize] as usize).map(f64::from);
    let normal = (at(11, 15) - at(11, 13)).cross(&(at(13, 14) - at(9, 14)));
    let lines = [[(11, 10), (11, 14), (11, 18)], [(7, 14), (11, 14), (15, 14)]];
    lines.map(|line| {
        let [a, b, c] = line.map(|(row, column)| at(row, column));
        let hollow = (a + c - b * 2.0).dot(&normal);
        hollow.signum() / circle(a, b, c)
    })
}

/// Radius of the circle through three points: a b c/(4 area).
fn circle(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>) -> f64 {
    let doubled = (b - a).cross(&(c - a)).norm();
    (b - a).norm() * (c - b).norm() * (a - c).norm() / (2.0 * doubled)
}
