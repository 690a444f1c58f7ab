//! Point lists that are wrong as a whole: one list for two cameras, or lists of smaller pictures than given.

use super::short;
use crate::target_problem::{Correspondence, TargetView};
use anyhow::{Result, ensure};
use nalgebra::Vector2;
use std::collections::HashMap;
use std::path::PathBuf;

/// Image points of one dot nearer than this are one point, px: less than the noise of any two cameras.
const SAME_PX: f64 = 0.01;
/// Lists with more than this share of other points among their common dots are of two cameras.
const OTHERS: f64 = 0.1;
/// Fewest common dots that are compared: four points do not agree by chance.
const FEWEST: usize = 4;
/// Dots nearer than this are one, mm; lists round to 1e-6.
const SAME_DOT: f64 = 1e-6;
/// Points of all cameras within this share of both width and height may be those of smaller pictures. Points of
/// real rigs reach 0.8 of one of them at least.
const SMALLER: f64 = 0.6;

/// Image points by their dots.
type Points = HashMap<[i64; 3], Vector2<f64>>;

/// Refuses the same image points for two cameras, in any of their views. `files` are the lists of the cameras; empty if
/// the names of the views say where they come from.
pub fn expect_different(sheets: &[TargetView], files: &[PathBuf]) -> Result<()> {
    let points: Vec<Points> = sheets.iter().map(|sheet| points_of(&sheet.samples)).collect();
    let named = |sheet: &TargetView| match files.get(sheet.camera) {
        Some(file) => format!("{}{}", file.display(), sheet.name.strip_prefix(&short(file)).unwrap_or("")),
        None => sheet.name.clone(),
    };
    for (i, first) in sheets.iter().enumerate() {
        for (j, second) in sheets.iter().enumerate().skip(i + 1).filter(|(_, s)| s.camera != first.camera) {
            let same = same_points(&points[i], &points[j]);
            ensure!(
                same.is_none(),
                "cameras {} and {}: expected image points by each camera, found the same ones ({} dots) in {} and {}",
                first.camera,
                second.camera,
                same.unwrap_or_default(),
                named(first).trim_end(),
                named(second).trim_end()
            );
        }
    }
    Ok(())
}

/// The points that can be compared: many programs write (-1, -1) for a dot that was not seen.
fn points_of(samples: &[Correspondence]) -> Points {
    let seen = samples.iter().filter(|s| s.pixel.x >= 0.0 || s.pixel.y >= 0.0);
    let key = |s: &Correspondence| [s.point.x, s.point.y, s.point.z].map(|mm| (mm / SAME_DOT).round() as i64);
    seen.map(|s| (key(s), s.pixel)).collect()
}

/// How many dots are at the same points; `None` if these are two lists.
fn same_points(first: &Points, second: &Points) -> Option<usize> {
    // So many of the common dots may be elsewhere at most: most pairs of lists differ within a few dots.
    let most = OTHERS * first.len().min(second.len()) as f64;
    let (mut same, mut others) = (0, 0);
    for (dot, at) in first {
        let Some(other) = second.get(dot) else { continue };
        if (at - other).norm() <= SAME_PX {
            same += 1;
        } else {
            others += 1;
            if f64::from(others) > most {
                return None;
            }
        }
    }
    let common = same + others as usize;
    (common >= FEWEST && f64::from(others) <= OTHERS * common as f64).then_some(same)
}

/// The smallest pictures that hold all points of all cameras, if they are much smaller than `size`.
pub fn smaller_pictures(sheets: &[TargetView], size: [u32; 2]) -> Option<[u32; 2]> {
    let points = sheets.iter().flat_map(|sheet| &sheet.samples).map(|s| s.pixel);
    let most = points.reduce(|most, at| most.sup(&at))?;
    // A point in the last column lies before the picture's width.
    let needed = [most.x, most.y].map(|px| px.max(1.0).floor() as u32 + 1);
    let is_smaller = |(needed, all): (u32, u32)| f64::from(needed) <= SMALLER * f64::from(all);
    needed.into_iter().zip(size).all(is_smaller).then_some(needed)
}

/// Doubts `--size`, if much smaller pictures would hold all points.
pub fn doubt_of_size(sheets: &[TargetView], size: [u32; 2]) -> Option<String> {
    let ([x, y], [w, h]) = (smaller_pictures(sheets, size)?, size);
    Some(format!(
        "all points of all cameras lie within {x}×{y} px of a picture of {w}×{h} px: is --size right?"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// A list of twenty dots: where camera `of` sees them, `moved` of them elsewhere.
    fn list(camera: usize, of: f64, moved: usize) -> TargetView {
        let sample = |i: usize| {
            let off = if i < moved { 0.5 } else { 0.004 };
            let pixel = Vector2::new(10.0 * i as f64 + of + off, 300.0 - 7.0 * i as f64);
            Correspondence { pixel, point: Point3::new(i as f64, 2.0, 3.0) }
        };
        TargetView { name: format!("l{camera} a"), camera, view: 0, samples: (0..20).map(sample).collect() }
    }

    #[test]
    fn one_list_for_two_cameras_is_refused_by_its_names() {
        let files = ["x/l0", "y/l1", "z/l2"].map(PathBuf::from);
        let told = |moved| {
            let lists = [list(0, 0.0, 0), list(1, 30.0, 0), list(2, 30.0, moved)];
            expect_different(&lists, &files).map_err(|e| e.to_string())
        };
        let expected = "cameras 1 and 2: expected image points by each camera, found the same ones (18 dots) in y/l1 a \
                        and z/l2 a";
        assert_eq!(told(2).unwrap_err(), expected);
        assert!(told(3).is_ok(), "more than a tenth is elsewhere");
        // Views of one camera may be the same.
        assert!(expect_different(&[list(0, 0.0, 0), list(0, 0.0, 0)], &[]).is_ok());
        // Dots that no camera saw are not compared, nor are few.
        let mut unseen = [list(0, 0.0, 0), list(1, 0.0, 0)];
        unseen.iter_mut().flat_map(|l| &mut l.samples[3..]).for_each(|s| s.pixel = Vector2::new(-1.0, -1.0));
        assert!(expect_different(&unseen, &[]).is_ok());
    }

    #[test]
    fn lists_of_smaller_pictures_cast_doubt_on_the_size() {
        let lists = [list(0, 0.0, 0), list(1, 30.0, 0)];
        assert_eq!(smaller_pictures(&lists, [640, 640]), Some([221, 301]));
        assert_eq!(smaller_pictures(&lists, [640, 480]), None, "the height is filled");
        let told = doubt_of_size(&lists, [640, 640]).unwrap();
        assert!(told.contains("within 221×301 px of a picture of 640×640 px: is --size right?"), "{told}");
        assert_eq!(doubt_of_size(&[], [640, 640]), None);
    }
}
