//! Round dots in pictures: connected regions that stand out from what surrounds them, their centres
//! by weighted moments.
//!
//! The centre of a dot's image is not the image of its centre when the board is tilted; the
//! difference is about r²·tan(tilt)/(4·distance), in mm, and below a tenth of a pixel where dots
//! are a few pixels wide.

use crate::grey_image::GreyImage;
use crate::grid::Node;
use nalgebra::{Matrix2, Vector2};

/// A dot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dot {
    /// Centre, px.
    pub at: Vector2<f64>,
    /// Pixels of its region.
    pub area_px: f64,
}

/// Least difference of a dot from its surroundings, as a share of the picture's contrast.
const MIN_CONTRAST: f32 = 0.06;
/// The same in standard deviations of the noise; the larger of both holds.
const MIN_SIGMAS: f32 = 4.0;
/// Smoothing against noise before that is judged, px.
const SMOOTHING_PX: f64 = 0.8;
/// Shares of the pixels between which the contrast is measured.
const CONTRAST: [f64; 2] = [0.005, 0.995];
/// Smallest area of the smoothed dot, px: below that of a dot of 2 px diameter, above a hot pixel's
/// in most noise.
const MIN_AREA_PX: f64 = 4.0;
/// Below this area a dot is all rim and its brightness itself is the weight, px.
const SMALL_AREA_PX: f64 = 26.0;
/// Share of a small dot's brightness that noise of the ground may reach and that has no weight.
const FLOOR: f32 = 0.1;
/// Area over that of the ellipse of equal moments of so few pixels, which make a rough outline.
const SMALL_FILL_RATIO: std::ops::Range<f64> = 0.7..1.3;
/// Largest area as a share of the picture.
const MAX_AREA_SHARE: f64 = 0.02;
/// Longest over shortest axis of a tilted dot.
const MAX_AXIS_RATIO: f64 = 3.0;
/// Area over that of the ellipse of equal moments: 1 for an ellipse.
const FILL_RATIO: std::ops::Range<f64> = 0.8..1.2;
/// Surroundings: smoothing of the background as a share of the picture's width.
const BACKGROUND: f64 = 1.0 / 40.0;
/// Shares of a dot's brightness between which the weight of a pixel rises from 0 to 1.
const RAMP: [f32; 2] = [0.25, 0.75];
/// So far beyond its region a dot's rim is weighed, px.
const RIM: isize = 2;

/// All dots of a picture, dark ones on bright ground or the reverse.
pub fn find(picture: &GreyImage, dark: bool) -> Vec<Dot> {
    let [low, high] = picture.quantiles(CONTRAST);
    let ground = picture.ground((picture.width as f64 * BACKGROUND).max(4.0));
    let smooth = picture.blurred(SMOOTHING_PX);
    let sign = if dark { -1.0 } else { 1.0 };
    let (w, h) = (picture.width as isize, picture.height as isize);
    let out: Vec<f32> =
        (0..w * h).map(|i| sign * (smooth.at(i % w, i / w) - ground.at(i % w, i / w))).collect();
    let threshold = (MIN_CONTRAST * (high - low)).max(MIN_SIGMAS * noise_of(&out));
    let mut inside: Vec<bool> = out.iter().map(|v| *v > threshold).collect();
    let mut dots = Vec::new();
    for start in 0..inside.len() {
        if inside[start] {
            let region = flood(&mut inside, w, h, start as isize);
            dots.extend(dot(picture, &region, sign));
        }
    }
    dots
}

/// Standard deviation from the median deviation, which dots do not move as long as they cover less
/// than half of the picture.
fn noise_of(out: &[f32]) -> f32 {
    let mut sizes: Vec<f32> = out.iter().map(|v| v.abs()).collect();
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
    *median / 0.6745
}

/// Takes a connected region out of the map.
fn flood(inside: &mut [bool], w: isize, h: isize, start: isize) -> Vec<(isize, isize)> {
    let (mut region, mut stack) = (Vec::new(), vec![start]);
    inside[start as usize] = false;
    while let Some(i) = stack.pop() {
        let (x, y) = (i % w, i / w);
        region.push((x, y));
        for (nx, ny) in [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)] {
            let n = ny * w + nx;
            if nx >= 0 && ny >= 0 && nx < w && ny < h && inside[n as usize] {
                inside[n as usize] = false;
                stack.push(n);
            }
        }
    }
    region
}

/// The dot of a region, if it is one.
fn dot(picture: &GreyImage, region: &[(isize, isize)], sign: f32) -> Option<Dot> {
    let area = region.len() as f64;
    if area < MIN_AREA_PX || area > MAX_AREA_SHARE * (picture.width * picture.height) as f64 {
        return None;
    }
    let mean = region.iter().map(|&(x, y)| Vector2::new(x as f64, y as f64)).sum::<Vector2<f64>>() / area;
    let spread = region.iter().map(|&(x, y)| Vector2::new(x as f64, y as f64) - mean);
    // A pixel is a square, not a point: 1/12 px² along each axis.
    let spread = spread.map(|d| d * d.transpose()).sum::<Matrix2<f64>>() / area + Matrix2::identity() / 12.0;
    let axes = spread.symmetric_eigenvalues();
    let (short, long) = (axes.min().sqrt(), axes.max().sqrt());
    // An ellipse of semi-axes 2s and 2l has the variances s² and l².
    let fill = area / (4.0 * std::f64::consts::PI * short * long);
    let allowed = if area < SMALL_AREA_PX { SMALL_FILL_RATIO } else { FILL_RATIO };
    if long > MAX_AXIS_RATIO * short || !allowed.contains(&fill) {
        return None;
    }
    let reach = 2.0 * long + RIM as f64 + 1.0;
    picture.holds(mean, reach).then(|| Dot { at: centre(picture, region, sign), area_px: area })
}

/// Centre by weights that rise from the rim's brightness to that of the dot's body and stay there:
/// a glint inside, or noise outside, does not pull. A dot of few pixels has no body that could
/// saturate: there the brightness above the ground is the weight.
fn centre(picture: &GreyImage, region: &[(isize, isize)], sign: f32) -> Vector2<f64> {
    let bounds = |of: fn(&(isize, isize)) -> isize| {
        let all = region.iter().map(of);
        (all.clone().min().unwrap_or(0) - RIM, all.max().unwrap_or(0) + RIM)
    };
    let ((x0, x1), (y0, y1)) = (bounds(|p| p.0), bounds(|p| p.1));
    let mut rim: Vec<f32> = (x0..=x1)
        .flat_map(|x| [(x, y0), (x, y1)])
        .chain((y0..=y1).flat_map(|y| [(x0, y), (x1, y)]))
        .map(|(x, y)| sign * picture.at(x, y))
        .collect();
    rim.sort_by(f32::total_cmp);
    let ground = rim[rim.len() / 2];
    let mut inner: Vec<f32> = region.iter().map(|&(x, y)| sign * picture.at(x, y)).collect();
    inner.sort_by(f32::total_cmp);
    let body = inner[inner.len() / 2];
    let (mut sum, mut at) = (0.0, Vector2::zeros());
    for y in y0..=y1 {
        for x in x0..=x1 {
            let share = (sign * picture.at(x, y) - ground) / (body - ground).max(1e-6);
            let weight = match (region.len() as f64) < SMALL_AREA_PX {
                true => f64::from((share - FLOOR).max(0.0)),
                false => f64::from(((share - RAMP[0]) / (RAMP[1] - RAMP[0])).clamp(0.0, 1.0)),
            };
            sum += weight;
            at += Vector2::new(x as f64, y as f64) * weight;
        }
    }
    at / sum.max(1e-9)
}

/// Dots with the directions to their nearest neighbours, which are those of a grid; dots in the
/// middle of the picture's dots first, since a grid grows best from its inside.
pub fn nodes(dots: &[Dot]) -> Vec<Node> {
    let middle = dots.iter().map(|d| d.at).sum::<Vector2<f64>>() / dots.len().max(1) as f64;
    let mut nodes: Vec<Node> = dots.iter().filter_map(|dot| node(dot, dots)).collect();
    nodes.sort_by(|a, b| (a.at - middle).norm().total_cmp(&(b.at - middle).norm()));
    nodes
}

fn node(dot: &Dot, dots: &[Dot]) -> Option<Node> {
    let mut ways: Vec<Vector2<f64>> = dots.iter().map(|d| d.at - dot.at).filter(|d| d.norm() > 0.0).collect();
    ways.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
    let first = ways.first()?.normalize();
    let across = |w: &&Vector2<f64>| w.normalize().perp(&first).abs() > 0.5;
    let second = ways.iter().take(8).find(across)?.normalize();
    Some(Node { at: dot.at, lines: [first, second] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_is_found_on_an_uneven_ground() {
        let (truth, radius) = (Vector2::new(40.3, 52.7), 3.5);
        let pixel = |i: usize| {
            let (x, y) = ((i % 120) as f64, (i / 120) as f64);
            let inside = (0..64).filter(|k| {
                let p =
                    Vector2::new(x + f64::from(k % 8) / 8.0 - 0.4375, y + f64::from(k / 8) / 8.0 - 0.4375);
                (p - truth).norm() < radius
            });
            (60.0 + x / 3.0 + 90.0 * inside.count() as f64 / 64.0) as f32
        };
        let picture = GreyImage::new(120, 100, (0..120 * 100).map(pixel).collect()).blurred(0.7);
        let found = find(&picture, false);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].at - truth).norm() < 0.05, "{found:?}");
        assert!(find(&picture, true).is_empty());
    }

    #[test]
    fn dots_of_2_to_4_px_are_found_to_a_tenth_of_a_pixel() {
        for radius in [1.0, 1.5, 2.0] {
            for dark in [false, true] {
                let (sign, truth) = (if dark { -1.0 } else { 1.0 }, |k: usize| {
                    let (column, row) = ((k % 6) as f64, (k / 6) as f64);
                    Vector2::new(22.0 + 15.13 * column, 20.0 + 15.37 * row + 0.21 * column)
                });
                let pixel = |i: usize| {
                    let (x, y) = ((i % 120) as f64, (i / 120) as f64);
                    let ray = |s: usize| {
                        let [u, v] = [s % 8, s / 8].map(|s| s as f64 / 8.0 - 0.4375);
                        (0..24).any(|k| (Vector2::new(x + u, y + v) - truth(k)).norm() < radius)
                    };
                    let inside = (0..64).filter(|s| ray(*s)).count() as f64 / 64.0;
                    // Some grey levels of noise that no seed has to be named for.
                    let noise = ((i * 7919 + i / 120 * 104_729) % 23) as f64 / 4.0 - 2.75;
                    (120.0 + sign * 90.0 * inside + noise) as f32
                };
                let picture = GreyImage::new(120, 100, (0..120 * 100).map(pixel).collect());
                let found = find(&picture, dark);
                assert_eq!(found.len(), 24, "radius {radius}, dark {dark}");
                let off = |k: usize| found.iter().map(|d| (d.at - truth(k)).norm()).fold(f64::MAX, f64::min);
                let rms = ((0..24).map(|k| off(k).powi(2)).sum::<f64>() / 24.0).sqrt();
                println!("radius {radius} px, dark {dark}: rms {rms:.3} px");
                assert!(rms < 0.1, "radius {radius}, dark {dark}: {rms:.3} px");
            }
        }
    }

    #[test]
    fn bars_and_noise_are_no_dots() {
        let bar = |i: usize| {
            if (40..44).contains(&(i % 120)) && (20..80).contains(&(i / 120)) { 200.0 } else { 50.0 }
        };
        assert!(find(&GreyImage::new(120, 100, (0..12_000).map(bar).collect()), false).is_empty());
        assert!(find(&GreyImage::new(120, 100, vec![50.0; 12_000]), false).is_empty());
    }

    #[test]
    fn real_dots_are_where_others_found_them() {
        let Some(folder) = skips::data("cameras/myptv/Calibration") else { return };
        for camera in 1..=3 {
            let picture = GreyImage::load(&folder.join(format!("cal{camera}.png"))).unwrap();
            let found = find(&picture, false);
            let views = crate::point_lists::load(&folder.join(format!("cam{camera}_cal_points"))).unwrap();
            let nearest = |p: &Vector2<f64>| found.iter().map(|d| (d.at - p).norm()).fold(f64::MAX, f64::min);
            let off: Vec<f64> = views[0].samples.iter().map(|s| nearest(&s.pixel)).collect();
            let near = off.iter().filter(|d| **d < 1.5).count();
            assert!(near * 100 >= 98 * off.len(), "camera {camera}: {near} of {}", off.len());
            let squares: f64 = off.iter().filter(|d| **d < 1.5).map(|d| d * d).sum();
            let rms = (squares / near as f64).sqrt();
            println!("camera {camera}: {near} of {} dots, rms {rms:.3} px from MyPTV's", off.len());
            assert!(rms < 0.5, "camera {camera}: {rms} px");
        }
    }
}
