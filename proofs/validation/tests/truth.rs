//! The tissue solvers against closed forms and independent solutions, at resolutions that take
//! seconds. The cases are those of the example `validation`, which goes on to finer ones and draws
//! them.

use validation::closed_form::case::{self, Case, Depth};
use validation::closed_form::{balloon, beam, bleb, chain, hencky, lattice, modes, oscillator, patch, peel};

/// Runs a case at coarse resolutions: errors within `share` of the reference, and falling with
/// refinement.
fn check(case: &Case, share: f64) {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/analytic/reference.json");
    let reference = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let outcome = (case.run)(&reference, Depth::Quick);
    assert!(!outcome.rows.is_empty());
    for row in &outcome.rows {
        let (name, quantity) = (case.name, &row.quantity);
        let found =
            format!("{name}, {quantity}: {} instead of {}, order {:?}", row.ours, row.reference, row.order);
        assert!(row.error() < share.max(row.allowed), "{found}");
        // What is exact to rounding at any resolution has no order left to show.
        assert!(row.error() < 2e-3 || row.order.is_none_or(|o| o > 0.5), "{found}");
    }
}

#[test]
fn every_case_has_a_name_of_its_own() {
    let mut names: Vec<&str> = case::ALL.iter().map(|c| c.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), case::ALL.len());
    assert!(case::ALL.iter().all(|c| !c.title.is_empty() && !c.ours.is_empty()));
}

#[test]
fn chains_hang_as_they_should() {
    check(&chain::LINKS, 0.0);
    check(&chain::CATENARY, 0.02);
}

#[test]
fn springs_ring_at_their_frequencies() {
    check(&modes::CHAIN, 0.01);
    check(&modes::GRID, 0.02);
}

#[test]
fn integrators_do_to_an_oscillator_what_their_theory_says() {
    check(&oscillator::CASE, 0.02);
}

#[test]
fn a_lattice_of_springs_is_henckys_membrane() {
    check(&lattice::CASE, 0.02);
}

#[test]
fn membrane_elements_are_henckys_membrane() {
    check(&hencky::CASE, 0.02);
}

#[test]
fn a_balloon_has_its_limit_point() {
    check(&balloon::BALLOON, 0.03);
}

#[test]
fn a_taut_film_becomes_a_spherical_cap() {
    check(&balloon::CAP, 0.02);
}

#[test]
fn tetrahedra_pass_the_patch_test() {
    check(&patch::CASE, 0.0);
}

#[test]
fn a_beam_bends_and_rings_as_it_should() {
    check(&beam::CASE, 0.03);
}

#[test]
fn a_strip_peels_at_rivlins_and_kendalls_force() {
    check(&peel::CASE, 0.08);
}

#[test]
fn a_bleb_of_the_retina_is_a_cap_under_laplaces_pressure() {
    check(&bleb::CASE, 0.05);
}
