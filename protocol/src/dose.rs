//! Cells of the retina for the dose of light, the same for simulation and picture.
//!
//! A square grid over Lambert's azimuthal equal-area map about the posterior pole (−z): every cell
//! has the same area. In the map the direction at the angle θ from the pole lies at the radius
//! 2 sin(θ/2); the grid reaches to [`REACH_RAD`], which is the ora serrata (23 mm from
//! the fovea). Cells whose centre lies farther than that have no place on the retina.

use std::f64::consts::FRAC_1_SQRT_2;

/// Cells along an edge of the grid.
pub const ALONG: usize = 32;
/// Cells in all, rows from eye −y to +y, in a row from −x to +x.
pub const CELLS: usize = ALONG * ALONG;
/// Angle from the pole to the middle of the grid's edge, rad.
pub const REACH_RAD: f64 = 2.0;

/// Radius of the map at [`REACH_RAD`], of the unit sphere: 2 sin(1).
pub const REACH: f64 = 1.682_941_969_615_793;

/// Half angle of a light pipe's cone, rad. Light pipes spread 50 to 80 degrees in all.
pub const BEAM_OUTER_RAD: f64 = 0.82;
/// Half angle up to which its beam has the full intensity, rad.
pub const BEAM_INNER_RAD: f64 = 0.30;

/// Share of the full intensity in a direction off the beam's axis: a smooth step of the cosine of
/// the angle between them.
pub fn beam_share(cosine: f64) -> f64 {
    let (outer, inner) = (libm::cos(BEAM_OUTER_RAD), libm::cos(BEAM_INNER_RAD));
    let s = ((cosine - outer) / (inner - outer)).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// Direction of a cell's centre from the eye's centre (unit, eye frame); `None` beyond the reach.
pub fn direction(cell: usize) -> Option<[f64; 3]> {
    let along = |i: usize| ((i as f64 + 0.5) / ALONG as f64 * 2.0 - 1.0) * REACH;
    let (x, y) = (along(cell % ALONG), along(cell / ALONG));
    let square = x * x + y * y;
    if cell >= CELLS || square > REACH * REACH {
        return None;
    }
    // cos θ is 1 - ρ²/2, and sin θ / ρ is √(1 - ρ²/4).
    let wide = libm::sqrt(1.0 - 0.25 * square);
    Some([x * wide, y * wide, 0.5 * square - 1.0])
}

/// The cell of a direction from the eye's centre (any length, eye frame); `None` beyond the reach
/// or for a vector without direction.
pub fn cell_of(direction: [f64; 3]) -> Option<usize> {
    let [x, y, z] = direction;
    let length = libm::sqrt(x * x + y * y + z * z);
    // ρ / sin θ is 1 / cos(θ/2), and cos²(θ/2) is (1 - z) / 2.
    let half = libm::sqrt(1.0 - z / length) * FRAC_1_SQRT_2;
    let at = [x, y].map(|c| c / (length * half));
    // No number fails as well.
    let inside = at[0] * at[0] + at[1] * at[1] <= REACH * REACH;
    if !inside {
        return None;
    }
    let [i, j] = at.map(|c| (((c / REACH + 1.0) * 0.5 * ALONG as f64) as usize).min(ALONG - 1));
    Some(j * ALONG + i)
}

/// Area of a cell on a retina of this radius, mm².
pub fn cell_mm2(retina_radius_mm: f64) -> f64 {
    let edge = 2.0 * REACH / ALONG as f64 * retina_radius_mm;
    edge * edge
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn centres_lie_in_their_cells_on_the_unit_sphere() {
        assert!((REACH - 2.0 * (0.5 * REACH_RAD).sin()).abs() < 1e-15);
        let mut there = 0;
        for cell in 0..CELLS {
            let Some(d) = direction(cell) else { continue };
            there += 1;
            assert!((d.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-12);
            assert_eq!(cell_of(d), Some(cell));
            assert_eq!(cell_of(d.map(|c| c * 11.5)), Some(cell));
        }
        // A round map in its square.
        assert!((f64::from(there) / CELLS as f64 - 0.785).abs() < 0.02, "{there}");
    }

    #[test]
    fn all_cells_together_have_the_area_of_the_cap() {
        let there = (0..CELLS).filter(|&c| direction(c).is_some()).count() as f64;
        let cap = 2.0 * std::f64::consts::PI * 11.5 * 11.5 * (1.0 - REACH_RAD.cos());
        assert!((there * cell_mm2(11.5) / cap - 1.0).abs() < 0.02);
    }

    #[test]
    fn what_is_no_place_on_the_retina_has_no_cell() {
        for d in [[0.0, 0.0, 1.0], [0.0; 3], [f64::NAN, 0.0, -1.0], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(cell_of(d), None, "{d:?}");
        }
        assert_eq!(direction(CELLS), None);
        assert_eq!(direction(0), None, "a corner");
    }

    proptest! {
        #[test]
        fn a_place_is_nearest_to_its_own_cell_or_a_neighbour(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..0.3f64) {
            prop_assume!(x * x + y * y + z * z > 1e-3);
            let Some(cell) = cell_of([x, y, z]) else { return Ok(()) };
            let length = (x * x + y * y + z * z).sqrt();
            if let Some(d) = direction(cell) {
                // Half a cell's diagonal, stretched by 1 / cos(θ/2) at most, and a tenth for
                // curvature.
                let apart = (d[0] - x / length).hypot(d[1] - y / length).hypot(d[2] - z / length);
                let half = REACH / ALONG as f64 * std::f64::consts::SQRT_2;
                prop_assert!(apart < 1.1 * half / (0.5 * REACH_RAD).cos(), "{apart}");
            }
        }
    }
}
