//! What is wrong with what a target's points say: points outside of the picture, points that are others' (reflections,
//! wrong dots), and cameras that are no better than those that were there.

use crate::halves::HeldOut;
use crate::lens::LENS_NAMES;
use crate::report::Report;
use crate::target_problem::{Calibrated, TargetView, robust_sigma};
use crate::words;
use anyhow::{Result, ensure};
use nalgebra::Vector2;
use rig::Rig;
use rig::camera::Camera;

/// A point so far from where it should be is another one: standard deviations, and px.
const ASTRAY: (f64, f64) = (8.0, 3.0);

/// Refuses points outside of their cameras' pictures; `from` says where the sizes come from.
pub fn inside(sheets: &[TargetView], sizes_px: &[[u32; 2]], from: &str) -> Result<()> {
    let mut wrong = Vec::new();
    for sheet in sheets {
        let Some(&[w, h]) = sizes_px.get(sheet.camera) else { continue };
        let is_out = |p: &Vector2<f64>| {
            let beyond = |v: f64, n: u32| !(-1.0..=f64::from(n)).contains(&v);
            beyond(p.x, w) || beyond(p.y, h)
        };
        let out: Vec<Vector2<f64>> = sheet.samples.iter().map(|s| s.pixel).filter(is_out).collect();
        if let Some(first) = out.first() {
            wrong.push(format!(
                "camera {} ({}): {} of {} points lie outside of the {w}×{h} px of {from}, the first at {:.0}, {:.0}",
                sheet.camera,
                sheet.name,
                out.len(),
                sheet.samples.len(),
                first.x,
                first.y
            ));
        }
    }
    ensure!(wrong.is_empty(), "{}: are they of another camera, or is the size wrong?", wrong.join("; "));
    Ok(())
}

/// What a person should know of a calibration: terms that are held, points that are others'.
pub fn remarks(found: &Calibrated, sheets: &[TargetView]) -> Vec<String> {
    let held = found.left_out.iter().map(|&(camera, term)| (found.scene.cameras[camera].id, term));
    let held = words::grouped(held).into_iter().map(|(ids, term)| {
        let whose = if ids.len() == 1 { "its" } else { "their" };
        format!(
            "{}: {whose} points do not determine {}, which is held at 0",
            words::cameras(&ids),
            LENS_NAMES[term]
        )
    });
    let sigma = robust_sigma(&found.residuals);
    let limit = ASTRAY.1.max(ASTRAY.0 * sigma);
    let astray = sheets.iter().enumerate().filter_map(|(s, sheet)| {
        let own = found.residuals.iter().filter(|r| r.sheet == s);
        let far: Vec<_> = own.filter(|r| r.error.norm() > limit).collect();
        let worst = far.iter().max_by(|a, b| a.error.norm().total_cmp(&b.error.norm()))?;
        Some(format!(
            "{}: {} of {} points lie elsewhere than their dots or corners, the worst at {:.0}, {:.0} by \
             {:.1} px: are they reflections, or other dots? Their weight is reduced",
            sheet.name,
            far.len(),
            sheet.samples.len(),
            worst.pixel.x,
            worst.pixel.y,
            worst.error.norm()
        ))
    });
    held.chain(found.remarks.iter().cloned()).chain(astray).collect()
}

/// Adds to a report how well the lenses are known.
pub fn add_doubts(found: &Calibrated, report: &mut Report) {
    for (camera, &doubt_px) in found.scene.cameras.iter().zip(&found.doubt_px).filter(|(_, px)| **px > 0.0) {
        let name = format!("camera {}: deviation of the lens over the picture", camera.id);
        report.figure(name, doubt_px, "px");
    }
}

/// Why a calibration is not compared with a rig.
#[derive(Debug)]
pub enum NotCompared {
    /// The rig is only a template.
    OtherCameras,
    /// Views are too few to hold some out.
    TooFewViews,
    /// Dots are.
    TooFewDots,
}

/// What the cameras of `rig` and those by one half of what was seen leave of the other half; `None`, and why, where they
/// cannot be compared.
pub fn beside(
    rig: &Rig,
    sizes_px: &[[u32; 2]],
    compared: impl FnOnce(&[Camera]) -> Result<HeldOut, NotCompared>,
) -> Result<HeldOut, NotCompared> {
    let before = rig.cameras();
    let sizes: Vec<[u32; 2]> = before.iter().map(|c| c.size_px).collect();
    if sizes != sizes_px {
        return Err(NotCompared::OtherCameras);
    }
    compared(&before)
}

/// Adds to a report what is left of held-out points; returns why nothing is written where the rig predicts them better.
pub fn judged(held_out: Option<Result<HeldOut, NotCompared>>, report: &mut Report) -> Option<String> {
    let held_out = match held_out? {
        Ok(held_out) => held_out,
        Err(NotCompared::OtherCameras) => {
            report.notes.push("not compared with the rig, whose cameras differ in number or size".into());
            return None;
        }
        Err(NotCompared::TooFewDots) => {
            report.notes.push("not compared with the rig: too few views to hold out half of them".into());
            return None;
        }
        Err(NotCompared::TooFewViews) => {
            return Some("too few views to compare with the given rig on held-out views".into());
        }
    };
    let HeldOut { before_px, after_px, .. } = held_out;
    if before_px.is_infinite() {
        report
            .notes
            .push("not compared with the rig: its cameras do not see the held-out points at all".into());
        return None;
    }
    report.figure("residual of held-out points, rig as given", before_px, "px");
    report.figure("residual of held-out points, calibrated", after_px, "px");
    held_out.is_worse().then(|| {
        format!(
            "the rig as given predicts held-out points {}: residual {before_px:.3} px, calibrated {after_px:.3} px",
            if after_px < before_px { "about as well, and views are few" } else { "better" }
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target_problem::Correspondence;
    use nalgebra::Point3;

    #[test]
    fn points_outside_of_the_picture_are_named_with_their_camera() {
        let sheet = |camera, x| TargetView {
            name: format!("list{camera}"),
            camera,
            view: 0,
            samples: vec![Correspondence { pixel: Vector2::new(x, 10.0), point: Point3::origin() }],
        };
        assert!(inside(&[sheet(0, 719.4)], &[[720, 576]], "the rig").is_ok());
        let told =
            inside(&[sheet(0, 5.0), sheet(1, 900.0)], &[[720, 576]; 2], "--size").unwrap_err().to_string();
        let expected =
            "camera 1 (list1): 1 of 1 points lie outside of the 720×576 px of --size, the first at 900, 10";
        assert!(told.contains(expected), "{told}");
        assert!(inside(&[sheet(0, f64::NAN)], &[[720, 576]], "--size").is_err());
    }
}
