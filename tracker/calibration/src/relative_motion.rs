//! Whether cameras that saw a target together stood still relative to each other: if one moved between two views, no poses
//! fit all of them, although each camera by itself fits.

use crate::lens::LENS;
use crate::repeats;
use crate::solve::Loss;
use crate::target_problem::{
    Calibrated, FreeParameters, Residual, Robustness, TargetProblem, TargetView, calibrate, robust_sigma,
};
use std::collections::BTreeSet;

/// Residuals of all cameras together over those of each alone from which a movement is looked for, and from which there is
/// a contradiction even if no view is found at which it begins. Real boards and lenses stay below 1.3.
const TOGETHER: [f64; 2] = [2.0, 3.0];
/// What is left of the residuals, if the views before and after a movement are fitted apart.
const APART: f64 = 0.6;
/// Fewest views on either side of a movement.
const FEWEST: usize = 2;

/// Why the cameras did not stand still; `None` if they did.
pub fn contradiction(found: &Calibrated, sheets: &[TargetView]) -> Option<String> {
    let together = robust_sigma(&found.residuals);
    if found.alone_px <= 0.0 || together < TOGETHER[0] * found.alone_px {
        return None;
    }
    if let Some((view, apart)) =
        first_view_after(found, sheets).filter(|(_, apart)| *apart < APART * together)
    {
        return Some(format!(
            "the cameras moved relative to each other: expected one pose of each in all views, found another from view {} on \
             (one coordinate ± {together:.3} px; ± {apart:.3} px with the views before it and from it on apart)",
            repeats::name(sheets, view)
        ));
    }
    (together >= TOGETHER[1] * found.alone_px).then(|| {
        format!(
            "the cameras contradict each other: one coordinate ± {together:.3} px together, ± {:.3} px for each camera alone. \
             Did a camera move between views, or are views of the same name from different instants?",
            found.alone_px
        )
    })
}

/// The view that best divides all into two parts with camera poses of their own, and one coordinate's standard deviation
/// then, px.
fn first_view_after(found: &Calibrated, sheets: &[TargetView]) -> Option<(usize, f64)> {
    let views: Vec<usize> = sheets.iter().map(|s| s.view).collect::<BTreeSet<_>>().into_iter().collect();
    let last = views.len().checked_sub(FEWEST)?;
    let apart = |at: usize| {
        let part = |late: bool| {
            let own = sheets.iter().filter(|s| (s.view >= views[at]) == late).cloned().collect::<Vec<_>>();
            residuals_of(found, &own)
        };
        Some((views[at], [part(false)?, part(true)?].concat()))
    };
    let all = (FEWEST..=last).filter_map(apart);
    let cost = |residuals: &[Residual]| {
        let of = |r: &Residual| Loss::Huber(3.0).at(r.error.norm_squared() / found.alone_px.powi(2)).0;
        residuals.iter().map(of).sum::<f64>()
    };
    let best = all.min_by(|a, b| cost(&a.1).total_cmp(&cost(&b.1)))?;
    Some((best.0, robust_sigma(&best.1)))
}

/// Residuals of some views with camera poses of their own and the lenses that were found.
fn residuals_of(found: &Calibrated, sheets: &[TargetView]) -> Option<Vec<Residual>> {
    let seen = |c: usize| sheets.iter().any(|s| s.camera == c);
    let free = |c: usize| FreeParameters { lens: [false; LENS], place: c > 0 && seen(c) };
    let free = (0..found.scene.cameras.len()).map(free).collect();
    let problem = TargetProblem::new(sheets, free, false, found.scene.views.len());
    Some(calibrate(problem, found.scene.clone(), Robustness::Huber, &mut |_, _| {}).ok()?.residuals)
}
