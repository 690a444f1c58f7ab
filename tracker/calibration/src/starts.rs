//! Starts of a camera that sees dots in space, which end in different minima where the dots determine its lens badly.

use crate::linear;
use crate::solve::Loss;
use crate::target_problem::{Calibrated, Correspondence, robust_sigma, set_camera_pose};
use crate::{CalibrationError, lens::pinhole_camera};
use nalgebra::{Isometry3, Vector2};
use rig::camera::Camera;

/// Focal lengths of further starts, as multiples of the picture's width.
const FOCAL: [f64; 2] = [1.0, 3.0];
/// Two ends are one where centre and focal length agree to this, px, or to so many standard deviations.
const SAME: (f64, f64) = (0.5, 0.5);
/// A worse minimum is worth a word where its residuals are at most so many times those of the best.
const RIVAL: f64 = 1.2;

/// Cameras without distortion to begin with: the direct linear transform; its focal lengths with the centre in the
/// picture's middle; and others with the centre there.
///
/// # Errors
/// Dots of which no transform can be made.
pub fn starts(id: u32, size: [u32; 2], samples: &[Correspondence]) -> Result<Vec<Camera>, CalibrationError> {
    let linear = linear::camera_from_dots(id, size, samples)?;
    let middle = Vector2::new(f64::from(size[0]) - 1.0, f64::from(size[1]) - 1.0) / 2.0;
    let width = f64::from(size[0]);
    let focal = std::iter::once(linear.focal_px).chain(FOCAL.map(|f| Vector2::repeat(f * width)));
    let placed = |focal: Vector2<f64>| {
        let mut camera = pinhole_camera(id, size, focal, middle);
        let place: Isometry3<f64> = linear::target_in_camera(&camera, samples).ok()?;
        set_camera_pose(&mut camera, &place);
        Some(camera)
    };
    let others: Vec<Camera> = focal.filter_map(placed).collect();
    Ok(std::iter::once(linear).chain(others).collect())
}

/// The best of some ends, and a word on the next best that is another one.
///
/// # Errors
/// That of the first start, where none ends anywhere.
pub fn best(
    ends: impl Iterator<Item = Result<Calibrated, CalibrationError>>,
) -> Result<(Calibrated, Option<String>), CalibrationError> {
    let (mut found, mut first) = (Vec::new(), None);
    for end in ends {
        match end {
            Ok(end) => found.push(end),
            Err(problem) => first = first.or(Some(problem)),
        }
    }
    // Costs are comparable by one measure only: the smallest spread.
    let sigma = found.iter().map(|f| robust_sigma(&f.residuals)).fold(f64::INFINITY, f64::min);
    let cost = |end: &Calibrated| {
        let of = |r: &crate::target_problem::Residual| {
            Loss::Huber(3.0).at(r.error.norm_squared() / (sigma * sigma)).0
        };
        end.residuals.iter().map(of).sum::<f64>()
    };
    // A camera behind which dots lie has fewer residuals.
    let key = |end: &Calibrated| (std::cmp::Reverse(end.residuals.len()), cost(end));
    found.sort_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut found = found.into_iter();
    let Some(best) = found.next() else {
        return Err(first.unwrap_or_else(|| crate::degenerate("there is no start")));
    };
    let other = found.find(|end| end.rms_px <= RIVAL * best.rms_px && is_other(&best, end));
    let said = other.map(|other| said(&best, &other));
    Ok((best, said))
}

fn is_other(best: &Calibrated, end: &Calibrated) -> bool {
    let [a, b] = [best, end].map(|e| &e.scene.cameras[0]);
    let off = [a.focal_px - b.focal_px, a.centre_px - b.centre_px].map(|d| [d.x, d.y]).concat();
    off.iter().zip(&best.sigmas[0]).any(|(off, sigma)| off.abs() > SAME.0.max(SAME.1 * sigma))
}

fn said(best: &Calibrated, other: &Calibrated) -> String {
    let text = |end: &Calibrated| {
        let camera = &end.scene.cameras[0];
        let (f, c) = (camera.focal_px, camera.centre_px);
        format!(
            "fx {:.0}, fy {:.0}, cx {:.0}, cy {:.0} at an rms of {:.3} px",
            f.x, f.y, c.x, c.y, end.rms_px
        )
    };
    format!(
        "its dots fit two lenses: {}, which is kept, and {}; dots that fill more of the picture and of the depth would \
         decide",
        text(best),
        text(other)
    )
}
