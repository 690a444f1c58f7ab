//! Calibration on lists of dots of which some are wrong: reflections, other dots, mistyped positions. The points that
//! agree on one camera are found first; the others are left out and named.

use crate::best_half::{BestHalf, FEWEST, best_halves};
use crate::fixed_dots::{CameraPrior, OneCamera, together};
use crate::lens::LENS;
use crate::multi_camera::Progress;
use crate::target_problem::{Calibrated, Correspondence, Robustness, TargetView, robust_sigma};
use crate::{CalibrationError, disagreement};

/// A point this far from where it should be is another one: standard deviations, with a least value in px and a
/// largest one as a share of the picture's width.
const ASTRAY: (f64, f64, f64) = (8.0, 3.0, 0.01);
/// Distance from the best half's projection within which a lens may move a point, as a share of the picture's width.
/// If there are farther points, a start from all points would be wrong.
const FAR: f64 = 0.03;
/// Error of the best half, as a share of the picture's width, from which no half of the points shows one camera.
const HOPELESS: f64 = 0.05;
/// Values of a lens with which the half is first extended: focal lengths, centre and k1. Higher terms extrapolate badly.
const FIRST_TERMS: usize = 5;
/// Most calibrations until the points that agree stay the same.
const ROUNDS: usize = 8;
/// Share of the points that must agree with a camera with another lens before the lens is blamed.
const OTHER_LENS: f64 = 0.9;
/// The mirrored world fits better if so much smaller residuals, or so many more points, speak for it.
const MIRRORED: (f64, f64) = (0.7, 1.1);

/// A point that was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrongPoint {
    /// Index of the list.
    pub sheet: usize,
    /// Index in the list.
    pub sample: usize,
    /// Distance from where it should be, px; infinite behind the camera.
    pub off_px: f64,
}

/// A calibration by the points that agree.
#[derive(Debug, Clone)]
pub struct Agreeing {
    /// The calibration.
    pub found: Calibrated,
    /// The lists with the points that agree.
    pub sheets: Vec<TargetView>,
    /// The others.
    pub wrong: Vec<WrongPoint>,
}

/// Calibrates cameras as [`crate::fixed_dots::calibrate_on_dots`] does, without points that contradict the others of
/// their list. Each camera has one list.
///
/// # Errors
/// As there; lists of which fewer than half of the points agree on one camera, or do so in a mirrored world only.
pub fn calibrate_agreeing(
    before: &[CameraPrior],
    sheets: &[TargetView],
    free: [bool; LENS],
    robustness: Robustness,
    progress: &mut Progress<'_>,
) -> Result<Agreeing, CalibrationError> {
    let (mut all, mut wrong, mut kept) = (Vec::new(), Vec::new(), Vec::new());
    for (index, before) in before.iter().enumerate() {
        let camera = OneCamera { index, before, free, robustness };
        let at = sheets.iter().position(|sheet| sheet.camera == index);
        let samples = at.map_or(&[][..], |at| sheets[at].samples.as_slice());
        let found = agreeing(&camera, samples, progress)
            .map_err(|problem| other_lens(&camera, samples, progress).unwrap_or(problem));
        if let (Ok(found), Some(at)) = (&found, at) {
            wrong.extend(found.wrong(at, samples));
            kept.push(TargetView { samples: chosen(samples, &found.points), ..sheets[at].clone() });
        }
        all.push(found.map(|found| found.calibrated));
    }
    let sheets_of_errors = if kept.len() == all.len() { &kept } else { sheets };
    Ok(Agreeing { found: together(all, sheets_of_errors)?, sheets: kept, wrong })
}

/// A camera, and the points of its list that agree on it.
struct Found {
    calibrated: Calibrated,
    points: Vec<usize>,
}

impl Found {
    fn wrong(&self, sheet: usize, samples: &[Correspondence]) -> Vec<WrongPoint> {
        let errors = errors_px(&self.calibrated, samples).into_iter().enumerate();
        let left_out = errors.filter(|(sample, _)| self.points.binary_search(sample).is_err());
        left_out.map(|(sample, off_px)| WrongPoint { sheet, sample, off_px }).collect()
    }

    /// True if this one, of the mirrored world, fits better than `other`.
    fn is_rather(&self, other: &Result<Found, CalibrationError>, points: usize) -> bool {
        let (smaller, more) = MIRRORED;
        let n = self.points.len() as f64;
        let is_better = match other {
            Err(_) => true,
            Ok(other) => {
                let others = other.points.len() as f64;
                let has_smaller = self.calibrated.rms_px < smaller * other.calibrated.rms_px;
                n > more * others || (has_smaller && more * n > others)
            }
        };
        is_better && 2.0 * n >= points as f64
    }
}

fn chosen(samples: &[Correspondence], points: &[usize]) -> Vec<Correspondence> {
    points.iter().map(|&i| samples[i]).collect()
}

/// Distances of samples from where a calibrated camera shows them, px; infinite behind it.
fn errors_px(found: &Calibrated, samples: &[Correspondence]) -> Vec<f64> {
    let camera = &found.scene.cameras[0];
    let error =
        |s: &Correspondence| camera.project(&s.point).map_or(f64::INFINITY, |at| (at - s.pixel).norm());
    samples.iter().map(error).collect()
}

/// Points and halves of a list without distortion, as far as it is known.
fn halves(camera: &OneCamera<'_>, samples: &[Correspondence]) -> [Option<BestHalf>; 2] {
    let CameraPrior::Lens(lens) = camera.before else { return best_halves(samples) };
    let straight = |(i, s): (usize, &Correspondence)| {
        let pixel = lens.normalised_from_pixel(s.pixel)?.component_mul(&lens.focal_px) + lens.centre_px;
        Some((i, Correspondence { pixel, ..*s }))
    };
    let (index, straight): (Vec<usize>, Vec<Correspondence>) =
        samples.iter().enumerate().filter_map(straight).unzip();
    best_halves(&straight).map(|half| {
        let BestHalf { points, rms_px, errors_px } = half?;
        let mut of_all = vec![f64::INFINITY; samples.len()];
        index.iter().zip(errors_px).for_each(|(&i, error)| of_all[i] = error);
        Some(BestHalf { points: points.iter().map(|&i| index[i]).collect(), rms_px, errors_px: of_all })
    })
}

/// Calibrates one camera by the points of its list that agree.
fn agreeing(
    camera: &OneCamera<'_>,
    samples: &[Correspondence],
    progress: &mut Progress<'_>,
) -> Result<Found, CalibrationError> {
    let [right, left] = halves(camera, samples);
    let width = camera.width();
    let is_near = |half: &BestHalf| half.errors_px.iter().all(|e| *e <= FAR * width);
    let none = right.is_none() && left.is_none();
    let mut plain = None;
    // Points that all lie near are first taken as right: that is what a list usually is.
    if none || right.iter().chain(&left).any(is_near) {
        let found = camera.solved(samples, progress);
        let calm = |found: &Calibrated| errors_px(found, samples).iter().all(|e| *e <= ASTRAY.1);
        if none || found.as_ref().is_ok_and(calm) {
            let points = (0..samples.len()).collect();
            return Ok(Found { calibrated: camera.fitting(found?)?, points });
        }
        plain = Some(found);
    }
    let [right, left] = [(right, false), (left, true)]
        .map(|(half, is_mirrored)| grown(camera, samples, half, is_mirrored, progress));
    match (right, left) {
        (right, Ok(left)) if left.is_rather(&right, samples.len()) => Err(CalibrationError::LeftHanded),
        (Ok(found), _) => Ok(Found { calibrated: camera.fitting(found.calibrated)?, ..found }),
        (Err(problem), _) => match plain {
            Some(Ok(found)) if camera.fitting(found.clone()).is_ok() => {
                Ok(Found { calibrated: camera.fitting(found)?, points: (0..samples.len()).collect() })
            }
            _ => Err(problem),
        },
    }
}

/// The error of a camera whose points fit no place of it with the given lens, but fit a camera with another lens: the points
/// are those of the dots then. `None` if they do not, or if no lens was given.
fn other_lens(
    camera: &OneCamera<'_>,
    samples: &[Correspondence],
    progress: &mut Progress<'_>,
) -> Option<CalibrationError> {
    let CameraPrior::Lens(lens) = camera.before else { return None };
    let [w, h] = lens.size_px;
    let before = CameraPrior::Size([w, h]);
    let found = agreeing(&OneCamera { before: &before, ..*camera }, samples, progress).ok()?;
    let agree = found.points.len();
    if (agree as f64) < OTHER_LENS * samples.len() as f64 {
        return None;
    }
    let other = &found.calibrated.scene.cameras[0];
    Some(disagreement(format!(
        "the lens or the picture size ({w}×{h} px) that the rig has for it does not fit its image points: {agree} of {} \
         agree with a focal length of {:.0} px instead of {:.0} px and the centre at ({:.0}, {:.0}) px instead of ({:.0}, \
         {:.0}) px, to {:.2} px rms. Expected the rig of this camera, or --size WIDTHxHEIGHT, to find the lens too",
        samples.len(),
        other.focal_px.x,
        lens.focal_px.x,
        other.centre_px.x,
        other.centre_px.y,
        lens.centre_px.x,
        lens.centre_px.y,
        found.calibrated.rms_px
    )))
}

/// The error of a list of which `agree` points agree.
fn too_few(agree: usize, samples: usize) -> CalibrationError {
    disagreement(format!(
        "{agree} of {samples} points agree with one camera, expected half of them or more: its image points are not \
         those of its dots"
    ))
}

/// Extends the half that agrees best to all points that do, and calibrates the camera by these.
fn grown(
    camera: &OneCamera<'_>,
    samples: &[Correspondence],
    half: Option<BestHalf>,
    is_mirrored: bool,
    progress: &mut Progress<'_>,
) -> Result<Found, CalibrationError> {
    let Some(half) = half else { return Err(too_few(0, samples.len())) };
    let width = camera.width();
    if half.rms_px > HOPELESS * width {
        let agree = half.errors_px.iter().filter(|e| **e <= ASTRAY.2 * width).count();
        return Err(too_few(agree, samples.len()));
    }
    let mirrored = |s: &Correspondence| {
        let mut s = *s;
        s.point.z *= if is_mirrored { -1.0 } else { 1.0 };
        s
    };
    let samples: Vec<Correspondence> = samples.iter().map(mirrored).collect();
    let first = std::array::from_fn(|term| camera.free[term] && term < FIRST_TERMS);
    let mut points = half.points;
    settled(&OneCamera { free: first, ..*camera }, &samples, &mut points, progress)?;
    // The half was found without any distortion. Of a true list, first terms explain it; the others explain any list.
    if 2 * points.len() < samples.len() {
        return Err(too_few(points.len(), samples.len()));
    }
    let calibrated = settled(camera, &samples, &mut points, progress)?;
    if 2 * points.len() < samples.len() {
        return Err(too_few(points.len(), samples.len()));
    }
    Ok(Found { calibrated, points })
}

/// Calibrates by `points` and takes those that agree with the result, until these stay the same.
fn settled(
    camera: &OneCamera<'_>,
    samples: &[Correspondence],
    points: &mut Vec<usize>,
    progress: &mut Progress<'_>,
) -> Result<Calibrated, CalibrationError> {
    let mut found = camera.solved(&chosen(samples, points), progress)?;
    for _ in 0..ROUNDS {
        let (times, least, most) = ASTRAY;
        let gate = (times * robust_sigma(&found.residuals)).min(most * camera.width()).max(least);
        let errors = errors_px(&found, samples);
        let next: Vec<usize> = (0..samples.len()).filter(|&i| errors[i] <= gate).collect();
        if next == *points {
            break;
        }
        if next.len() < FEWEST {
            return Err(too_few(next.len(), samples.len()));
        }
        *points = next;
        found = camera.solved(&chosen(samples, points), progress)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
