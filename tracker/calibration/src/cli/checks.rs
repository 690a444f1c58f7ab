//! What is wrong with what a target's points say: points outside of the picture, points that are others' (reflections,
//! wrong dots), boards that were tilted to one side only, and cameras that are no better than those that were there.

use crate::halves::HeldOut;
use crate::lens::{LENS_NAMES, lens_of};
use crate::linear::plane_of;
use crate::report::Report;
use crate::target_problem::{Calibrated, TargetView, camera_pose, robust_sigma};
use anyhow::{Result, ensure};
use nalgebra::{Matrix2, Vector2, Vector3};
use rig::Rig;
use rig::camera::Camera;

/// A point so far from where it should be is another one: standard deviations, and px.
const ASTRAY: (f64, f64) = (8.0, 3.0);
/// Boards whose normals spread less than this, as sines, about their mean were tilted to one side.
const ONE_SIDED: f64 = 0.1;
/// Boards whose normals spread less than this in every direction, as sines, lie in parallel planes.
const PARALLEL: f64 = 0.05;
/// Focal lengths less sure than the first are worth a word, than the second are refused, %.
const DOUBT: [f64; 2] = [1.0, 5.0];
/// The same for the lens over the whole picture, px.
const DOUBT_PX: [f64; 2] = [0.8, 5.0];
/// What to do about it.
const TILT: &str = "tilt the board by 20° to 45°, to another side in each view";

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
    let held = found.left_out.iter().map(|&(camera, term)| {
        let id = found.scene.cameras[camera].id;
        format!("camera {id}: its points do not determine {}, which is held at 0", LENS_NAMES[term])
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

/// How well boards were held for the lenses.
#[derive(Debug, Default)]
pub struct Determined {
    /// What a person should do better.
    pub notes: Vec<String>,
    /// Why a lens is not determined.
    pub refusals: Vec<String>,
}

/// Looks at how boards were held for each lens: names those that lie in parallel planes or are tilted to one side only, and
/// lenses that are hardly known.
pub fn determined(found: &Calibrated, sheets: &[TargetView]) -> Determined {
    let mut all = Determined::default();
    (0..found.scene.cameras.len()).for_each(|c| all.add(found, sheets, c));
    all
}

impl Determined {
    /// Looks at one camera's lens.
    fn add(&mut self, found: &Calibrated, sheets: &[TargetView], c: usize) {
        let camera = &found.scene.cameras[c];
        let (id, [fx, fy, ..]) = (camera.id, lens_of(camera));
        let focal = 100.0 * (found.sigmas[c][0] / fx).abs().max((found.sigmas[c][1] / fy).abs());
        let doubt_px = found.doubt_px[c];
        let [least, most] = tilts(found, sheets, c).unwrap_or([f64::INFINITY; 2]);
        if most < PARALLEL {
            self.refusals.push(format!(
                "camera {id}: expected boards tilted differently, found all in parallel planes, which do not determine a \
                 lens: {TILT}"
            ));
        } else if focal.is_nan() || focal > DOUBT[1] {
            self.refusals.push(format!(
                "camera {id}: the views do not fix the focal length, which is known to {focal:.0} % only: {TILT}"
            ));
        } else if doubt_px > DOUBT_PX[1] {
            self.refusals.push(format!(
                "camera {id}: the views do not determine the lens, whose image points are uncertain by {doubt_px:.1} px over \
                 the picture: {TILT}, and fill the picture with them"
            ));
        } else if least < ONE_SIDED || focal > DOUBT[0] {
            self.notes.push(format!(
                "camera {id}: all boards are tilted about one axis or to one side; the focal length is known to {focal:.2} %: \
                 tilt them to other sides, too"
            ));
        } else if doubt_px > DOUBT_PX[0] {
            self.notes.push(format!(
                "camera {id}: image points of the lens are uncertain by {doubt_px:.2} px over the picture: use more views, \
                 which fill it"
            ));
        }
    }
}

/// Smallest and largest spread of the normals of a camera's boards, as sines; `None` if a target in space was seen, which
/// needs no tilt.
fn tilts(found: &Calibrated, sheets: &[TargetView], camera: usize) -> Option<[f64; 2]> {
    let to_camera = camera_pose(&found.scene.cameras[camera]);
    let mut normals = Vec::new();
    for sheet in sheets.iter().filter(|s| s.camera == camera) {
        let plane = plane_of(&sheet.samples).ok()??;
        let normal =
            to_camera.rotation * found.scene.views[sheet.view].rotation * plane.rotation * Vector3::z();
        // The side of a plane is arbitrary; boards are seen from the front.
        normals.push((if normal.z < 0.0 { -normal } else { normal }).xy());
    }
    let n = normals.len() as f64;
    let mean = normals.iter().sum::<Vector2<f64>>() / n;
    let spread = normals.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix2<f64>>() / n;
    let eigen = spread.symmetric_eigenvalues();
    Some([eigen.min(), eigen.max()].map(|v| v.max(0.0).sqrt()))
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
            report.notes.push("not compared with the rig: halves of what was seen are too little".into());
            return None;
        }
        Err(NotCompared::TooFewViews) => {
            return Some("expected views of which some can be held out, to compare with the rig as given, found too few".into());
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
