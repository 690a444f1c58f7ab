//! What is wrong with what a target's points say: points outside of the picture, points that are others' (reflections,
//! wrong dots), boards that were tilted to one side only, and a lens that is no better than the one that was there.

use crate::halves::{half, rms_with};
use crate::lens::{LENS_NAMES, lens_of};
use crate::target_problem::{
    Calibrated, FreeParameters, Robustness, TargetView, calibrate_lens, robust_sigma,
};
use anyhow::{Result, bail, ensure};
use nalgebra::{Matrix2, Vector2};
use rig::camera::Camera;

/// A point so far from where it should be is another one: standard deviations, and px.
const ASTRAY: (f64, f64) = (8.0, 3.0);
/// Boards whose normals spread less than this, as sines, about their mean were tilted to one side.
const ONE_SIDED: f64 = 0.1;
/// Focal lengths less sure than the first share are worth a word, than the second are refused.
const DOUBT: [f64; 2] = [0.01, 0.05];
/// Fewest views of which halves are made.
const FEWEST_OF_HALVES: usize = 6;

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

/// Looks at how boards were held for a lens: refuses one whose focal length is hardly known, and says where all boards
/// were tilted to one side.
pub fn held_well(found: &Calibrated) -> Result<Option<String>> {
    let [fx, fy, ..] = lens_of(&found.scene.cameras[0]);
    let doubt = (found.sigmas[0][0] / fx).abs().max((found.sigmas[0][1] / fy).abs());
    let percent = 100.0 * doubt;
    if !doubt.is_finite() || doubt > DOUBT[1] {
        bail!(
            "the views do not fix the focal length, which is known to {percent:.0} % only: tilt the board by 20° to 45°, to \
             another side in each"
        );
    }
    let normals: Vec<Vector2<f64>> =
        found.scene.views.iter().map(|v| (v.rotation * nalgebra::Vector3::z()).xy()).collect();
    let n = normals.len() as f64;
    let mean = normals.iter().sum::<Vector2<f64>>() / n;
    let spread = normals.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix2<f64>>() / n;
    let one_sided = spread.symmetric_eigenvalues().min().max(0.0).sqrt() < ONE_SIDED;
    Ok((one_sided || doubt > DOUBT[0]).then(|| {
        format!(
            "all boards are tilted about one axis or to one side; the focal length is known to {percent:.2} %: tilt them to \
             other sides, too"
        )
    }))
}

/// Refuses a lens that predicts views which took no part worse than the one that was there.
pub fn better_than(
    before: &Camera,
    sheets: &[TargetView],
    free: FreeParameters,
    loss: Robustness,
) -> Result<()> {
    if sheets.len() < FEWEST_OF_HALVES {
        return Ok(());
    }
    let judge = half(sheets, true);
    let learnt = calibrate_lens(before.id, before.size_px, &half(sheets, false), free, loss, &mut |_, _| {});
    let new_px = learnt.map_or(f64::INFINITY, |c| rms_with(&c.scene.cameras, &judge));
    let old_px = rms_with(std::slice::from_ref(before), &judge);
    ensure!(
        new_px <= old_px,
        "camera {}: the lens in the rig leaves {old_px:.3} px in every second view, one found from the others {new_px:.3} \
         px: nothing is written",
        before.id
    );
    Ok(())
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
