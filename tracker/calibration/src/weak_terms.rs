//! Which terms of a lens the views determine: the others are held at zero, because what they do where no point was seen
//! is arbitrary.

use crate::CalibrationError;
use crate::lens::{LENS, lens_of};
use crate::target_problem::{Calibrated, DISPENSABLE, with_weak_terms_held};

/// Uncertainties of a lens over its picture, px, and the standard deviations from 0 that a term needs to be kept beyond
/// each: terms of a lens that is known well do no harm, one that is hardly known is better off with few, and one that folds
/// the picture has too many.
const KEPT: [(f64, f64); 3] = [(f64::MAX, f64::INFINITY), (2.0, 4.0), (0.5, 2.0)];

/// Terms of a decentred lens, p1 and p2, and standard deviations up to which they are kept all the same.
const TANGENTIAL: [usize; 2] = [6, 7];
const SPARES_TANGENTIAL: f64 = 2.0;

/// The next term to hold at zero: one that hardly differs from it, if the lens is not known well over the picture.
pub fn next_to_hold(found: &Calibrated, camera: usize, free: &[bool; LENS]) -> Option<usize> {
    let (_, least) = KEPT.into_iter().find(|(doubt_px, _)| found.doubt_px[camera] > *doubt_px)?;
    let (values, sigmas) = (lens_of(&found.scene.cameras[camera]), &found.sigmas[camera]);
    // A decentred lens and its principal point look alike, and so does a turn of the camera: holding p1 and p2 moves both.
    // They grow with the square of the radius only, and do harm only in a lens that is hardly known.
    let spares = |term: usize| least <= SPARES_TANGENTIAL && TANGENTIAL.contains(&term);
    let is_weak = |term: usize| free[term] && !spares(term) && values[term].abs() < least * sigmas[term];
    DISPENSABLE.into_iter().find(|&term| is_weak(term))
}

/// Solves for one lens with the terms that the views determine; returns those that are held at zero.
///
/// # Errors
/// As [`with_weak_terms_held`].
pub fn with_known_terms(
    mut free: [bool; LENS],
    mut solved: impl FnMut([bool; LENS]) -> Result<Calibrated, CalibrationError>,
) -> Result<(Calibrated, Vec<usize>), CalibrationError> {
    let mut held = Vec::new();
    loop {
        let (found, more) = with_weak_terms_held(free, &mut solved)?;
        more.iter().for_each(|&term| free[term] = false);
        held.extend(more);
        let Some(term) = next_to_hold(&found, 0, &free) else { return Ok((found, held)) };
        free[term] = false;
        held.push(term);
    }
}
