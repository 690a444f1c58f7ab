//! Points of a board that are others' (reflections, mixed-up rows of a list), found before anything is calibrated: in each
//! view most points lie where a plane would be seen, and the others far from it.
//!
//! The half of the points that fits one plane best ([`crate::best_half`]) shows where the others should be. Only points
//! that no distortion of a lens explains are taken out; nearer ones are left to the robust loss.

use crate::best_half::best_half_of_plane;
use crate::linear::plane_of;
use crate::median;
use crate::target_problem::{Correspondence, TargetView};

/// A point so far off is another's: multiples of the median distance, and shares of the picture's width.
const ASTRAY: (f64, f64) = (8.0, 0.03);
/// A view whose median distance is beyond this share of the picture's width shows no plane.
const NO_PLANE: f64 = 0.05;
/// Fewest points of which some may be taken out: a plane has eight unknowns, two a point.
const FEWEST: usize = 8;

/// Takes wrong points out of views of a plane, and says how many of which; views without a plane are taken out entirely.
pub fn take_out(sheets: &mut Vec<TargetView>, sizes_px: &[[u32; 2]]) -> Vec<String> {
    let mut notes = Vec::new();
    sheets.retain_mut(|sheet| {
        let width = sizes_px.get(sheet.camera).map_or(1.0, |size| f64::from(size[0]));
        let Some(off) = distances(&sheet.samples) else { return true };
        let typical = median(off.iter().copied()).unwrap_or(0.0);
        let n = sheet.samples.len();
        if typical > NO_PLANE * width {
            notes.push(format!(
                "{} skipped: expected the points of a flat target, found half of {n} points {typical:.0} px or more from \
                 where a plane would be seen: are they of another view?",
                sheet.name
            ));
            return false;
        }
        let limit = (ASTRAY.0 * typical).max(ASTRAY.1 * width);
        let wrong: Vec<usize> = (0..n).filter(|&i| off[i] > limit).collect();
        if let Some(&worst) = wrong.iter().max_by(|&&a, &&b| off[a].total_cmp(&off[b])) {
            let at = sheet.samples[worst].pixel;
            notes.push(format!(
                "{}: {} of {n} points are wrong and not used, the worst at {:.0}, {:.0} by {:.0} px: are they \
                 reflections, or other corners?",
                sheet.name,
                wrong.len(),
                at.x,
                at.y,
                off[worst]
            ));
            let mut index = 0..n;
            sheet.samples.retain(|_| index.next().is_some_and(|i| off[i] <= limit));
        }
        true
    });
    notes
}

/// Distance of each point from where the best plane has it, px; `None` for targets in space and for few points.
fn distances(samples: &[Correspondence]) -> Option<Vec<f64>> {
    if samples.len() < FEWEST {
        return None;
    }
    let plane = plane_of(samples).ok()??;
    best_half_of_plane(samples, &plane).map(|half| half.errors_px)
}
