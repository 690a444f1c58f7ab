//! Points of a board that are others' (reflections, mixed-up rows of a list), found before anything is calibrated: in each
//! view most points lie where a plane would be seen, and the others far from it.
//!
//! A least median of squares (Rousseeuw 1984) over planes through four points each, which up to half of the points may
//! disturb. Only points that no distortion of a lens explains are taken out; nearer ones are left to the robust loss.

use crate::draws::Draws;
use crate::linear::{homography, plane_of};
use crate::median;
use crate::target_problem::{Correspondence, TargetView};
use nalgebra::{Matrix3, Vector2};

/// Planes that are tried: with 40 % of wrong points one in eight has none.
const TRIALS: usize = 200;
/// A point so far off is another's: multiples of the median distance, and shares of the picture's width.
const ASTRAY: (f64, f64) = (8.0, 0.03);
/// A view whose median distance is beyond this share of the picture's width shows no plane.
const NO_PLANE: f64 = 0.05;
/// Fewest points of which some may be taken out: a plane has eight unknowns, two a point.
const FEWEST: usize = 8;

type Pair = (Vector2<f64>, Vector2<f64>);

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
    let pairs: Vec<Pair> =
        samples.iter().map(|s| (plane.inverse_transform_point(&s.point).coords.xy(), s.pixel)).collect();
    // Most views have no wrong point, and the plane through all of them shows it.
    let mut draws = Draws::new(pairs.len() as u64);
    let four = (0..TRIALS).map(|_| draws.distinct::<4>(pairs.len()).map(|i| pairs[i]));
    let of = |h: Matrix3<f64>| pairs.iter().map(|p| distance(&h, p)).collect::<Vec<f64>>();
    let tried = four.filter_map(|four| Some(of(homography(&four).ok()?)));
    let typical = |off: &[f64]| median(off.iter().copied()).unwrap_or(f64::INFINITY);
    let best = tried.min_by(|a, b| typical(a).total_cmp(&typical(b)))?;
    // Four points carry their own noise; the better half of all points gives a plane without most of it.
    let limit = typical(&best);
    let half: Vec<Pair> =
        pairs.iter().zip(&best).filter(|(_, off)| **off <= limit).map(|(p, _)| *p).collect();
    let refined = homography(&half).map(of).unwrap_or_else(|_| best.clone());
    Some(if typical(&refined) < limit { refined } else { best })
}

fn distance(h: &Matrix3<f64>, (plane, pixel): &Pair) -> f64 {
    let image = h * plane.push(1.0);
    let off = (image.xy() / image.z - pixel).norm();
    if off.is_finite() { off } else { f64::INFINITY }
}
