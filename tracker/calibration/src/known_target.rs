//! Which dot of a picture is which of a target whose dots are known: from a few that a person
//! picked, by predicting where the others must be, ever more exactly.

use crate::dots::Dot;
use crate::linear::{camera_from_dots, plane_of};
use crate::target_problem::Correspondence;
use crate::{CalibrationError, degenerate, disagreement, median};
use nalgebra::{Matrix4, Matrix4x2, Point3, Vector2, Vector4};
use rig::camera::Camera;

/// A dot may lie so far from where it is predicted, as a share of the distance between dots.
const GATE: f64 = 0.3;
/// Rounds with a camera without perspective, then with one.
const ROUNDS: (usize, usize) = (3, 4);
/// A dot that fits worse than so many times the median is a speck beside the true one.
const SPECK: f64 = 6.0;
/// Fewest dots that count as a target found.
const FEWEST: usize = 12;
/// Least share of the dots within the picture that must be recognised: fewer are chance pairs of a wrong view.
const LEAST_SHARE: f64 = 0.75;
/// A dot of the picture looks like those recognised if its area is within this factor of their median.
const ALIKE: f64 = 1.5;

/// Pairs the dots of a picture with those of a target (mm), beginning with `picked` ones, of which
/// four or more that do not lie in a plane are needed.
///
/// # Errors
/// Picked dots that do not determine the view, or too few dots that lie where they are predicted.
pub fn match_dots(
    size_px: [u32; 2],
    dots: &[Dot],
    target: &[Point3<f64>],
    picked: &[Correspondence],
) -> Result<Vec<Correspondence>, CalibrationError> {
    if picked.len() < 4 || plane_of(picked)?.is_some() {
        let n = picked.len();
        let problem = format!("{n} dots were picked; four or more are needed that do not lie in one plane");
        return Err(degenerate(problem));
    }
    let mut samples = picked.to_vec();
    for _ in 0..ROUNDS.0 {
        let flat = affine(&samples).ok_or_else(|| degenerate("the picked dots do not determine the view"))?;
        samples = paired(dots, target, &|p| Some(flat.tr_mul(&p.to_homogeneous())), samples);
    }
    let mut in_view = 0;
    for _ in 0..ROUNDS.1 {
        if samples.len() < FEWEST {
            let (n, dots) = (samples.len(), dots.len());
            let problem =
                format!("{n} of the target's dots were recognised among {dots}; check the picked ones");
            return Err(degenerate(problem));
        }
        let camera =
            camera_from_dots(0, size_px, &samples).map_err(|problem| unfit(samples.len(), &problem))?;
        samples = paired(dots, target, &|p| camera.project(p), samples);
        in_view = target.iter().filter(|p| is_in_view(&camera, p)).count();
    }
    let (found, expected) = (samples.len(), in_view.max(alike(dots, &samples).min(target.len())));
    if (found as f64) < LEAST_SHARE * expected as f64 {
        return Err(disagreement(format!(
            "{found} of the target's dots were recognised, expected most of the {expected} that are in the picture; check \
             the picked ones: are they of this picture?"
        )));
    }
    Ok(samples)
}

/// The refusal of dots that were recognised but show no camera.
fn unfit(recognised: usize, problem: &CalibrationError) -> CalibrationError {
    let why = match problem {
        CalibrationError::LeftHanded => "fit a mirrored target only (or X, Y, Z are left-handed)".into(),
        CalibrationError::Geometry(problem) => problem.clone(),
        problem => problem.to_string(),
    };
    disagreement(format!(
        "{recognised} of the target's dots were recognised, but {why}; check the picked ones: are they of this picture?"
    ))
}

/// How many dots of a picture look like those that were recognised. A camera of a wrong view would show few of the
/// target's dots, so that what it should show is no measure.
fn alike(dots: &[Dot], recognised: &[Correspondence]) -> usize {
    let area = |s: &Correspondence| dots.iter().find(|dot| dot.at == s.pixel).map(|dot| dot.area_px);
    let Some(typical) = median(recognised.iter().filter_map(area)) else { return 0 };
    dots.iter().filter(|dot| (1.0 / ALIKE..=ALIKE).contains(&(dot.area_px / typical))).count()
}

/// True if a camera shows a point within its picture.
fn is_in_view(camera: &Camera, point: &Point3<f64>) -> bool {
    let inside = |at: Vector2<f64>| (0..2).all(|a| (0.0..f64::from(camera.size_px[a])).contains(&at[a]));
    camera.project(point).is_some_and(inside)
}

/// Pixels as an affine function of (X, Y, Z, 1): a camera far away.
fn affine(samples: &[Correspondence]) -> Option<Matrix4x2<f64>> {
    let (mut m, mut r) = (Matrix4::zeros(), Matrix4x2::zeros());
    for sample in samples {
        let p: Vector4<f64> = sample.point.to_homogeneous();
        m += p * p.transpose();
        r += p * sample.pixel.transpose();
    }
    Some(m.try_inverse()? * r)
}

/// The target's dots with the picture's dots nearest to where they are predicted; `before` where
/// nothing pairs.
fn paired(
    dots: &[Dot],
    target: &[Point3<f64>],
    predict: &dyn Fn(&Point3<f64>) -> Option<Vector2<f64>>,
    before: Vec<Correspondence>,
) -> Vec<Correspondence> {
    let predicted: Vec<(Point3<f64>, Vector2<f64>)> =
        target.iter().filter_map(|p| Some((*p, predict(p)?))).collect();
    let apart = |i: usize| {
        let others = predicted.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, o)| (o.1 - predicted[i].1).norm()).fold(f64::MAX, f64::min)
    };
    let pair = |i: usize| {
        let at = predicted[i].1;
        let nearest = dots.iter().min_by(|a, b| (a.at - at).norm().total_cmp(&(b.at - at).norm()))?;
        let off = (nearest.at - at).norm();
        (off < GATE * apart(i)).then_some((off, Correspondence { pixel: nearest.at, point: predicted[i].0 }))
    };
    let pairs: Vec<(f64, Correspondence)> = (0..predicted.len()).filter_map(pair).collect();
    let Some(median) = median(pairs.iter().map(|p| p.0)) else { return before };
    let good: Vec<Correspondence> = pairs.iter().filter(|p| p.0 <= SPECK * median).map(|p| p.1).collect();
    if good.len() >= 4 { good } else { before }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::pinhole_camera;
    use nalgebra::{Rotation3, Vector3};

    fn scene() -> (Camera, Vec<Point3<f64>>, Vec<Dot>) {
        let mut camera =
            pinhole_camera(0, [1280, 1024], Vector2::new(5000.0, 5000.0), Vector2::new(640.0, 512.0));
        camera.camera_from_world = Rotation3::new(Vector3::new(0.1, -0.2, 0.05)).into_inner();
        camera.translation_mm = Vector3::new(-30.0, -30.0, 450.0);
        let point = |i: usize| {
            let (c, r) = ((i % 20) as f64, (i / 20) as f64);
            Point3::new(3.0 * c, 3.0 * r, -6.0 * ((i % 20) / 5 % 3) as f64)
        };
        let target: Vec<_> = (0..400).map(point).collect();
        let seen = target.iter().enumerate().filter(|(i, _)| i % 17 != 3);
        let mut dots: Vec<Dot> =
            seen.map(|(_, p)| Dot { at: camera.project(p).unwrap(), area_px: 30.0 }).collect();
        // Specks between the dots.
        dots.extend(
            (0..40)
                .map(|i| Dot { at: Vector2::new(31.0 * f64::from(i), 400.0 + f64::from(i)), area_px: 9.0 }),
        );
        (camera, target, dots)
    }

    fn picked(camera: &Camera, target: &[Point3<f64>], which: &[usize]) -> Vec<Correspondence> {
        let near = |i: &usize| {
            let off = Vector2::new((*i as f64).sin(), (*i as f64).cos());
            Correspondence { pixel: camera.project(&target[*i]).unwrap() + off, point: target[*i] }
        };
        which.iter().map(near).collect()
    }

    #[test]
    fn a_few_picked_dots_find_all_others() {
        let (camera, target, dots) = scene();
        let found =
            match_dots([1280, 1024], &dots, &target, &picked(&camera, &target, &[0, 19, 389, 380, 210]))
                .unwrap();
        assert!(found.len() >= 370, "{}", found.len());
        let off = |s: &Correspondence| (camera.project(&s.point).unwrap() - s.pixel).norm();
        assert!(found.iter().all(|s| off(s) < 3.0));
        assert!(found.iter().filter(|s| off(s) < 1e-9).count() >= 370);
    }

    #[test]
    fn picks_of_another_view_are_refused() {
        let (camera, target, dots) = scene();
        for turn in [Vector3::new(0.0, 0.5, 0.0), Vector3::new(0.4, -0.2, 0.1), Vector3::new(0.0, 0.0, 0.06)]
        {
            let mut other = camera.clone();
            other.camera_from_world = Rotation3::new(turn).into_inner() * camera.camera_from_world;
            let middle = Vector3::new(28.5, 28.5, -6.0);
            other.translation_mm += (camera.camera_from_world - other.camera_from_world) * middle;
            let picks = picked(&other, &target, &[0, 19, 389, 380, 210]);
            let told = match_dots([1280, 1024], &dots, &target, &picks).unwrap_err().to_string();
            assert!(told.contains("check the picked ones"), "{turn}: {told}");
        }
    }

    #[test]
    fn too_few_or_flat_picks_are_refused() {
        let (camera, target, dots) = scene();
        let told = |which: &[usize]| {
            let found = match_dots([1280, 1024], &dots, &target, &picked(&camera, &target, which));
            found.map(|f| format!("found {}", f.len())).unwrap_or_else(|e| e.to_string())
        };
        assert!(told(&[0, 19, 389]).contains("3 dots were picked"));
        assert!(told(&[0, 4, 380, 384, 200]).contains("one plane"), "{}", told(&[0, 4, 380, 384, 200]));
        let none = match_dots([1280, 1024], &[], &target, &picked(&camera, &target, &[0, 19, 389, 210]));
        assert!(none.unwrap_err().to_string().contains("recognised among 0"));
    }
}
