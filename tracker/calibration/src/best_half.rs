//! Which half of some points fits one projection best, although many of the others are wrong.
//!
//! Least trimmed squares (Rousseeuw & Van Driessen 2006): projections through minimal sets of points drawn at random;
//! the best of them are fitted again and again to the half of the points that they leave the smallest errors.

use crate::draws::Draws;
use crate::linear::{homography, oriented_projection, plane_of};
use crate::target_problem::Correspondence;
use nalgebra::{Isometry3, Matrix3, Matrix3x4, Vector2};

/// Projections that are drawn. With 40 % of wrong points, one in 21 sets of six has none of them.
const DRAWS: usize = 1000;
/// The drawn projections that are fitted again.
const KEPT: usize = 8;
/// Most fits of each.
const FITS: usize = 10;
/// Points that fix a projection, and a homography.
const MINIMAL: (usize, usize) = (6, 4);
/// A list of fewer points is not searched for wrong ones: half of it would hardly fix a projection.
pub const FEWEST: usize = 2 * MINIMAL.0;

/// A camera of no particular lens.
#[derive(Debug, Clone)]
enum Projection {
    /// Points in space.
    Space(Matrix3x4<f64>),
    /// Points of a plane; `world_from_plane`.
    Plane(Matrix3<f64>, Isometry3<f64>),
}

impl Projection {
    /// Squared distance of a sample from where it should be; infinite behind the camera.
    fn squared(&self, sample: &Correspondence) -> f64 {
        let image = match self {
            Projection::Space(p) => p * sample.point.coords.push(1.0),
            Projection::Plane(h, plane) => {
                h * plane.inverse_transform_point(&sample.point).coords.xy().push(1.0)
            }
        };
        let in_front = image.z > 0.0 || matches!(self, Projection::Plane(..));
        let squared = (image.xy() / image.z - sample.pixel).norm_squared();
        if in_front && squared.is_finite() { squared } else { f64::INFINITY }
    }
}

/// The half of some points that fits one projection best.
#[derive(Debug, Clone)]
pub struct BestHalf {
    /// Their indices, ascending.
    pub points: Vec<usize>,
    /// Root mean square error of these, px.
    pub rms_px: f64,
    /// Errors of all points, px.
    pub errors_px: Vec<f64>,
}

/// The best halves for right-handed and for left-handed positions of the points; each `None` if no projection of that
/// kind was drawn. In pictures of little perspective, both can fit.
pub fn best_halves(samples: &[Correspondence]) -> [Option<BestHalf>; 2] {
    match plane_of(samples) {
        Ok(plane) if samples.len() >= FEWEST => halves_of(samples, plane.as_ref()),
        _ => [None, None],
    }
}

/// The best half of points of a plane, of which there are at least four; `None` if no four of them show it.
pub fn best_half_of_plane(samples: &[Correspondence], world_from_plane: &Isometry3<f64>) -> Option<BestHalf> {
    let [half, _] = halves_of(samples, Some(world_from_plane));
    half
}

fn halves_of(samples: &[Correspondence], plane: Option<&Isometry3<f64>>) -> [Option<BestHalf>; 2] {
    let mut draws = Draws::new(samples.len() as u64);
    let mut drawn: [Vec<(f64, Projection)>; 2] = Default::default();
    for _ in 0..DRAWS {
        let minimal: Vec<Correspondence> = match plane {
            None => draws.distinct::<{ MINIMAL.0 }>(samples.len()).map(|i| samples[i]).into(),
            Some(_) => draws.distinct::<{ MINIMAL.1 }>(samples.len()).map(|i| samples[i]).into(),
        };
        if let Some((projection, is_mirrored)) = through(&minimal, plane) {
            let cost = half_of(&projection, samples).1;
            keep(&mut drawn[usize::from(is_mirrored)], cost, projection);
        }
    }
    let [right, left] = drawn;
    [(right, false), (left, true)].map(|(kept, is_mirrored)| {
        let fit = |projection| fitted(projection, is_mirrored, samples, plane);
        kept.into_iter().map(|(_, p)| fit(p)).min_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
    })
}

/// The projection of points, and whether it mirrors them; `None` if they do not determine one.
fn through(points: &[Correspondence], plane: Option<&Isometry3<f64>>) -> Option<(Projection, bool)> {
    let Some(plane) = plane else {
        let p = oriented_projection(points).ok()?;
        return Some((Projection::Space(p), p.fixed_view::<3, 3>(0, 0).determinant() < 0.0));
    };
    let flat = |s: &Correspondence| (plane.inverse_transform_point(&s.point).coords.xy(), s.pixel);
    let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = points.iter().map(flat).collect();
    Some((Projection::Plane(homography(&pairs).ok()?, *plane), false))
}

/// Puts a projection among the best ones.
fn keep(best: &mut Vec<(f64, Projection)>, cost: f64, projection: Projection) {
    if best.len() == KEPT && cost >= best[KEPT - 1].0 {
        return;
    }
    let at = best.partition_point(|(other, _)| *other <= cost);
    best.insert(at, (cost, projection));
    best.truncate(KEPT);
}

/// The half of the points with the smallest errors, and the sum of their squares.
fn half_of(projection: &Projection, samples: &[Correspondence]) -> (Vec<usize>, f64) {
    let squared: Vec<f64> = samples.iter().map(|s| projection.squared(s)).collect();
    let mut order: Vec<usize> = (0..samples.len()).collect();
    let half = samples.len().div_ceil(2);
    order.select_nth_unstable_by(half - 1, |&a, &b| squared[a].total_cmp(&squared[b]));
    order.truncate(half);
    order.sort_unstable();
    let cost = order.iter().map(|&i| squared[i]).sum();
    (order, cost)
}

/// A projection fitted to its half until that stays the same.
fn fitted(
    mut projection: Projection,
    is_mirrored: bool,
    samples: &[Correspondence],
    plane: Option<&Isometry3<f64>>,
) -> BestHalf {
    let (mut points, mut cost) = half_of(&projection, samples);
    for _ in 0..FITS {
        let own: Vec<Correspondence> = points.iter().map(|&i| samples[i]).collect();
        let Some((next, mirrors)) = through(&own, plane) else { break };
        let (next_points, next_cost) = half_of(&next, samples);
        if mirrors != is_mirrored || next_cost >= cost {
            break;
        }
        (projection, points, cost) = (next, next_points, next_cost);
    }
    let rms_px = (cost / points.len() as f64).sqrt();
    let errors_px = samples.iter().map(|s| projection.squared(s).sqrt()).collect();
    BestHalf { points, rms_px, errors_px }
}
