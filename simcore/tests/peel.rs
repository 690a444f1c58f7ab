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
fn peel_force_folded_back_comes_nearer_with_finer_meshes() {
    for deg in [165.0f64, 172.0] {
        for speed in [0.1, 0.2] { for range_mm in [0.2, 0.4] {
            error(&PeelTest { angle_rad: deg.to_radians(), speed_mm_s: speed, range_mm, rows: 5, ..PeelTest::default() });
        } }
    }
    let folded = |spacing_mm, rows| PeelTest { angle_rad: PI, spacing_mm, rows, ..PeelTest::default() };
    let (coarse, fine) = (error(&folded(0.1, 7)), error(&folded(0.05, 7)));
    assert!(fine.abs() < 0.05 && fine.abs() < coarse.abs(), "{coarse} {fine}");
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
fn a_free_strip_rolls_to_the_radius_asked_for() {
    for radius_mm in [1.0, 2.0] {
        let found = rolled_radius_mm(radius_mm);
        println!("{radius_mm} {found}");
    }
}

/// Lays a free strip of 4 mm flat, waits until it has rolled up, and measures the circle through its middle line.
fn rolled_radius_mm(radius_mm: f64) -> f64 {
    let strip = PeelTest {
        spacing_mm: 0.15,
        rows: 11,
        stiffness_un_per_mm: 2000.0,
        step: 0.5,
        ..PeelTest::default()
    };
    let columns = 29;
    let (positions, triangles) = lattice(strip.spacing_mm, strip.rows, columns);
    let sheet = Sheet::from_triangles(&positions, &triangles, &[]).unwrap();
    let curl = Curl::new(&sheet, &CurlScene { stiffness_un_mm: 0.5, radius_mm });
    let mut tissue = strip.tissue();
    tissue.fluid_per_s = 1.5;
    let (mut membrane, mut solver) = (sheet.start(), Solver::new(&sheet));
    solver.refresh(&sheet, &membrane, &tissue);
    let at = |c: u32, m: &simcore::state::MembraneState| {
        m.position(sheet.order[(11 * columns + c) as usize] as usize).map(f64::from)
    };
    for step in 0..(60.0 / tissue.dt_s) as u64 {
        solver.clear_outer();
        curl.bend(&membrane, None, &mut solver.outer_un);
        if step == 0 {
            // Inner forces only: nothing moves or turns the strip as a whole.
            let force: Vec<f32> = solver.outer_un.iter().map(|f| f.iter().sum::<f32>().abs()).collect();
            assert!(force.iter().all(|f| *f < 1e-3), "{force:?}");
        }
        solver.accelerate(&sheet, &membrane, &tissue);
        solver.integrate(&mut membrane, &tissue);
        if step % 1000 == 0 {
            println!("{step} {}", circle(at(7, &membrane), at(14, &membrane), at(21, &membrane)));
        }
    }
    let [a, b, c] = [7, 14, 21].map(|c| at(c, &membrane));
    assert!(a.z + c.z > 2.0 * b.z, "the hollow faces the side of the normals");
    circle(a, b, c)
}

/// Radius of the circle through three points: a b c/(4 area).
fn circle(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>) -> f64 {
    let doubled = (b - a).cross(&(c - a)).norm();
    (b - a).norm() * (c - b).norm() * (a - c).norm() / (2.0 * doubled)
}
