//! Views that show the target in the same place as another one: they say nothing new, and would be held out beside
//! their twins.

use crate::target_problem::TargetView;
use std::collections::BTreeSet;

/// Views are the same if their points are apart by less than this, root mean square, px: more than noise, less than any
/// turn of a target that helps.
const SAME_PX: f64 = 2.0;
/// Share of the points of either view that the other must have.
const COMMON: f64 = 0.8;
/// Points of the target nearer than this are one, in its unit; lists round to 1e-6.
const SAME_POINT: f64 = 1e-6;

/// Takes out the repetitions of views, and says which.
pub fn take_out(sheets: &mut Vec<TargetView>) -> Vec<String> {
    let views: Vec<usize> = sheets.iter().map(|s| s.view).collect::<BTreeSet<_>>().into_iter().collect();
    // Each view that is kept, with its repetitions.
    let mut kept: Vec<(usize, Vec<usize>)> = Vec::new();
    for view in views {
        match kept.iter_mut().find(|(first, _)| is_same(sheets, *first, view)) {
            None => kept.push((view, Vec::new())),
            Some((_, again)) => again.push(view),
        }
    }
    let repeated = kept.iter().filter(|(_, again)| !again.is_empty());
    let note = |(first, again): &(usize, Vec<usize>)| {
        let names: Vec<&str> = again.iter().map(|&view| name(sheets, view)).collect();
        format!(
            "the target is in the same place as in {} in {}, which {} not used: move it between views",
            name(sheets, *first),
            names.join(", "),
            if names.len() == 1 { "is" } else { "are" }
        )
    };
    let notes = repeated.map(note).collect();
    sheets.retain(|s| kept.iter().any(|(first, _)| *first == s.view));
    number_anew(sheets);
    notes
}

/// Numbers views from 0 without gaps.
pub fn number_anew(sheets: &mut [TargetView]) {
    let views: BTreeSet<usize> = sheets.iter().map(|sheet| sheet.view).collect();
    let place = |view: usize| views.range(..view).count();
    sheets.iter_mut().for_each(|sheet| sheet.view = place(sheet.view));
}

/// Name of a view: that of its first picture or list.
pub fn name(sheets: &[TargetView], view: usize) -> &str {
    sheets.iter().find(|s| s.view == view).map_or("", |s| s.name.as_str())
}

/// True if the same cameras saw the target in the same place.
fn is_same(sheets: &[TargetView], first: usize, second: usize) -> bool {
    let of = |view: usize| sheets.iter().filter(move |s| s.view == view);
    let twin = |sheet: &TargetView| of(second).any(|s| s.camera == sheet.camera && is_same_place(sheet, s));
    of(first).count() == of(second).count() && of(first).all(twin)
}

fn is_same_place(a: &TargetView, b: &TargetView) -> bool {
    let apart = |sample: &crate::target_problem::Correspondence| {
        let twin = b.samples.iter().find(|s| (s.point - sample.point).norm() < SAME_POINT)?;
        Some((twin.pixel - sample.pixel).norm_squared())
    };
    let squares: Vec<f64> = a.samples.iter().filter_map(apart).collect();
    let common = squares.len() as f64;
    let enough = common > 0.0 && common >= COMMON * a.samples.len().max(b.samples.len()) as f64;
    enough && (squares.iter().sum::<f64>() / common).sqrt() < SAME_PX
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target_problem::Correspondence;
    use nalgebra::{Point3, Vector2};

    fn sheet(camera: usize, view: usize, shift: f64) -> TargetView {
        let sample = |i: i32| Correspondence {
            pixel: Vector2::new(f64::from(i) * 10.0 + shift, 100.0),
            point: Point3::new(f64::from(i), 0.0, 0.0),
        };
        TargetView { name: format!("v{view}"), camera, view, samples: (0..9).map(sample).collect() }
    }

    #[test]
    fn a_view_that_all_cameras_saw_before_counts_once_and_is_named() {
        let mut sheets = vec![sheet(0, 0, 0.0), sheet(0, 1, 0.4), sheet(0, 2, 20.0)];
        let notes = take_out(&mut sheets);
        assert_eq!(sheets.iter().map(|s| s.view).collect::<Vec<_>>(), [0, 1]);
        assert!(
            notes.len() == 1 && notes[0].contains("in the same place as in v0 in v1, which is not used"),
            "{notes:?}"
        );
        // Camera 1 moved: both views say something.
        let mut sheets = vec![sheet(0, 0, 0.0), sheet(1, 0, 0.0), sheet(0, 1, 0.0), sheet(1, 1, 9.0)];
        assert!(take_out(&mut sheets).is_empty() && sheets.len() == 4);
        // Another part of the target.
        let mut other = sheet(0, 1, 0.0);
        other.samples.drain(..4);
        assert!(take_out(&mut vec![sheet(0, 0, 0.0), other]).is_empty());
    }
}
