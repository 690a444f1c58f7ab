//! Corners of a chessboard: points where two dark and two bright fields meet.
//!
//! There the picture is a saddle: the determinant of its second derivatives is negative and large.
//! A ring around the point distinguishes a chessboard's corner from other saddles: along it the brightness
//! changes side four times, and opposite sides are alike. The exact place is where all slopes
//! around point past it: Σ ∇I ∇Iᵀ (q − p) = 0 over a window (Förstner & Gülch 1987).

use crate::grey_image::GreyImage;
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{PI, TAU};

/// Smoothing before second derivatives are taken, px.
const SMOOTHING_PX: f64 = 1.5;
/// Saddles weaker than this share of the strongest are noise.
const MIN_RELATIVE_STRENGTH: f32 = 0.01;
/// Two corners are never this close, px.
const MIN_DISTANCE_PX: isize = 4;
/// Radii of the ring, px; one must fit into the squares.
const RINGS_PX: [f64; 2] = [6.0, 4.0];
/// Samples of a ring; a multiple of 4.
const RING: usize = 32;
/// Correlation of a ring with itself half a turn on, above which it is point symmetric.
const MIN_SYMMETRY: f64 = 0.6;
/// Most corners considered; more are texture.
const MAX_CORNERS: usize = 2000;
/// Half the window of the coarse refinement, px.
const COARSE_WINDOW: isize = 4;
/// A refinement that strays farther than this has found something else, in half windows.
const MAX_SHIFT: f64 = 0.7;

/// A corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Where, px.
    pub at: Vector2<f64>,
    /// Unit vectors along the two lines that cross here, image angles 0 to π. Turning on from the
    /// first (x towards y) one enters a bright field.
    pub lines: [Vector2<f64>; 2],
    /// Strength of the saddle, of any unit.
    pub strength: f32,
}

/// All corners of a picture, the strongest first.
pub fn find(picture: &GreyImage) -> Vec<Corner> {
    let smooth = picture.blurred(SMOOTHING_PX);
    let mut saddles = saddles(&smooth);
    saddles.sort_by(|a, b| b.1.total_cmp(&a.1));
    saddles.truncate(MAX_CORNERS);
    let mut found: Vec<Corner> = Vec::new();
    for (at, strength) in saddles {
        let Some(at) = refined(picture, at, COARSE_WINDOW) else { continue };
        let Some(lines) = RINGS_PX.iter().find_map(|&r| lines_through(&smooth, at, r)) else { continue };
        if found.iter().all(|c| (c.at - at).norm() > MIN_DISTANCE_PX as f64) {
            found.push(Corner { at, lines, strength });
        }
    }
    found
}

fn saddles(smooth: &GreyImage) -> Vec<(Vector2<f64>, f32)> {
    let (w, h) = (smooth.width as isize, smooth.height as isize);
    let strength = |x: isize, y: isize| {
        let v = |i: isize, j: isize| smooth.at(x + i, y + j);
        let xx = v(1, 0) - 2.0 * v(0, 0) + v(-1, 0);
        let yy = v(0, 1) - 2.0 * v(0, 0) + v(0, -1);
        let xy = (v(1, 1) - v(-1, 1) - v(1, -1) + v(-1, -1)) / 4.0;
        xy * xy - xx * yy
    };
    let map: Vec<f32> = (0..w * h).map(|i| strength(i % w, i / w)).collect();
    let strongest = map.iter().copied().fold(0.0, f32::max);
    let mut found = Vec::new();
    for y in MIN_DISTANCE_PX..h - MIN_DISTANCE_PX {
        for x in MIN_DISTANCE_PX..w - MIN_DISTANCE_PX {
            let s = map[(y * w + x) as usize];
            if s > 0.0 && s >= MIN_RELATIVE_STRENGTH * strongest && is_peak(&map, w, x, y, s) {
                found.push((Vector2::new(x as f64, y as f64), s));
            }
        }
    }
    found
}

/// True if nothing near is stronger; of equals the first counts.
fn is_peak(map: &[f32], w: isize, x: isize, y: isize, s: f32) -> bool {
    let around = -MIN_DISTANCE_PX..=MIN_DISTANCE_PX;
    around.clone().all(|j| {
        around.clone().all(|i| {
            let other = map[((y + j) * w + x + i) as usize];
            other < s || (other == s && (j, i) >= (0, 0))
        })
    })
}

/// Directions of the two lines that cross at `at`, from the brightness along a ring.
fn lines_through(smooth: &GreyImage, at: Vector2<f64>, radius: f64) -> Option<[Vector2<f64>; 2]> {
    if !smooth.holds(at, radius + 1.0) {
        return None;
    }
    let angle = |i: usize| TAU * i as f64 / RING as f64;
    let mut ring = [0.0; RING];
    for (i, value) in ring.iter_mut().enumerate() {
        *value = f64::from(smooth.between(at + Vector2::new(angle(i).cos(), angle(i).sin()) * radius));
    }
    // Between the extremes, not the mean: the four fields may be of different size.
    let (low, high) = ring.iter().fold((f64::MAX, f64::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    ring.iter_mut().for_each(|v| *v -= (low + high) / 2.0);
    let energy: f64 = ring.iter().map(|v| v * v).sum();
    let symmetry: f64 = (0..RING).map(|i| ring[i] * ring[(i + RING / 2) % RING]).sum();
    if energy <= 0.0 || symmetry < MIN_SYMMETRY * energy {
        return None;
    }
    let crossings: Vec<(f64, bool)> = (0..RING)
        .filter(|&i| (ring[i] < 0.0) != (ring[(i + 1) % RING] < 0.0))
        .map(|i| {
            let (a, b) = (ring[i], ring[(i + 1) % RING]);
            (angle(i) + TAU / RING as f64 * a / (a - b), b > a)
        })
        .collect();
    let [first, second, third, fourth] = crossings.try_into().ok()?;
    let along = |a: f64, b: f64| {
        // The line through both crossings; half a turn apart but for perspective.
        let middle = (a + b - PI) / 2.0;
        Vector2::new(middle.cos(), middle.sin())
    };
    let lines = [along(first.0, third.0), along(second.0, fourth.0)];
    let straight = ((third.0 - first.0) - PI).abs() < 0.6 && ((fourth.0 - second.0) - PI).abs() < 0.6;
    let wide = lines[0].perp(&lines[1]).abs() > 0.2;
    let ordered = if first.1 { lines } else { [lines[1], lines[0]] };
    (straight && wide).then_some(ordered)
}

/// Most steps of the refinement.
const MAX_ITERATIONS: usize = 30;
/// Step at which the refinement has converged, px.
const CONVERGED_PX: f64 = 1e-4;

/// The exact place of a corner near `start`, from slopes within ±`half` px; weights fall off
/// towards the border of the window, so that nothing jumps when a pixel leaves it. `None` where
/// there is none.
pub fn refined(picture: &GreyImage, start: Vector2<f64>, half: isize) -> Option<Vector2<f64>> {
    let mut at = start;
    let reach = half as f64;
    for _ in 0..MAX_ITERATIONS {
        if !picture.holds(at, reach + 1.0) {
            return None;
        }
        let (mut m, mut r) = (Matrix2::zeros(), Vector2::zeros());
        let (cx, cy) = (at.x.round() as isize, at.y.round() as isize);
        for y in cy - half..=cy + half {
            for x in cx - half..=cx + half {
                let from = Vector2::new(x as f64, y as f64) - at;
                let weight = (-2.0 * from.norm_squared() / (reach * reach)).exp();
                let slope = picture.slope(x, y);
                let product = slope * slope.transpose() * weight;
                m += product;
                r += product * from;
            }
        }
        // Both eigenvalues must stand out: along an edge one of them vanishes.
        let trace = m.trace();
        if trace <= 0.0 || m.determinant() < 1e-3 * trace * trace {
            return None;
        }
        let step = m.try_inverse()? * r;
        at += step;
        if (at - start).norm() > MAX_SHIFT * reach + 1.0 {
            return None;
        }
        if step.norm() < CONVERGED_PX {
            break;
        }
    }
    Some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four fields that meet at `at`, their borders along two directions, smoothed.
    fn cross(at: Vector2<f64>, angles: [f64; 2]) -> GreyImage {
        let side = |p: Vector2<f64>, angle: f64| (p - at).perp(&Vector2::new(angle.cos(), angle.sin())) > 0.0;
        let ray = |p: Vector2<f64>| if side(p, angles[0]) == side(p, angles[1]) { 40.0 } else { 200.0 };
        let pixel = |i: usize| {
            let p = Vector2::new((i % 64) as f64, (i / 64) as f64);
            let rays = (0..64).map(|k| {
                ray(p + Vector2::new(f64::from(k % 8), f64::from(k / 8)) / 8.0 - Vector2::repeat(0.4375))
            });
            (rays.sum::<f64>() / 64.0) as f32
        };
        GreyImage::new(64, 64, (0..64 * 64).map(pixel).collect()).blurred(0.8)
    }

    #[test]
    fn a_corner_is_found_with_its_lines_to_hundredths_of_a_pixel() {
        for (x, y, a, b) in [(31.3, 30.8, 0.2, 1.8), (28.9, 33.1, 0.6, 1.9), (32.5, 32.5, 1.2, 2.4)] {
            let truth = Vector2::new(x, y);
            let found = find(&cross(truth, [a, b]));
            assert_eq!(found.len(), 1, "{found:?}");
            let at = refined(&cross(truth, [a, b]), found[0].at, 8).unwrap();
            assert!((at - truth).norm() < 0.04, "{at} and {truth}");
            let along = |line: Vector2<f64>| {
                let parallel = |angle: f64| line.perp(&Vector2::new(angle.cos(), angle.sin())).abs();
                parallel(a).min(parallel(b))
            };
            assert!(found[0].lines.iter().all(|l| along(*l) < 0.15), "{found:?}");
        }
    }

    #[test]
    fn edges_spots_and_noise_are_no_corners() {
        let edge =
            GreyImage::new(64, 64, (0..64 * 64).map(|i| if i % 64 < 30 { 20.0 } else { 220.0 }).collect());
        assert!(find(&edge.blurred(0.8)).is_empty());
        assert_eq!(refined(&edge, Vector2::new(30.0, 30.0), 6), None);
        let spot =
            |i: usize| (-((i % 64) as f64 - 32.0).hypot((i / 64) as f64 - 32.0).powi(2) / 18.0).exp() as f32;
        assert!(find(&GreyImage::new(64, 64, (0..64 * 64).map(|i| 200.0 * spot(i)).collect())).is_empty());
        assert!(find(&GreyImage::new(64, 64, vec![7.0; 64 * 64])).is_empty());
    }
}
