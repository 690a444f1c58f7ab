//! Comparison with reference pictures: mean structural similarity of luma (SSIM, Wang et al. 2004,
//! windows of 8×8 at every fourth place), and the mean difference of colour.

use crate::governor::{Shading, TIERS, Tier};
use crate::readback::Picture;

/// Size of a channel of a reference picture, px.
pub const REFERENCE_PX: [u32; 2] = [160, 128];

const WINDOW: u32 = 8;

fn luma(p: [u8; 3]) -> f64 {
    0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])
}

/// Mean structural similarity of two pictures of the same size; 1 for equal ones.
pub fn similarity(a: &Picture, b: &Picture) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in (0..=a.height_px - WINDOW).step_by(4) {
        for x in (0..=a.width_px - WINDOW).step_by(4) {
            sum += window_similarity(a, b, x, y);
            count += 1.0;
        }
    }
    sum / count
}

fn window_similarity(a: &Picture, b: &Picture, x: u32, y: u32) -> f64 {
    let n = f64::from(WINDOW * WINDOW);
    let pairs: Vec<[f64; 2]> = (0..WINDOW * WINDOW)
        .map(|i| (x + i % WINDOW, y + i / WINDOW))
        .map(|(x, y)| [luma(a.rgb(x, y)), luma(b.rgb(x, y))])
        .collect();
    let mean = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    let (ma, mb) = (mean(&|p| p[0]), mean(&|p| p[1]));
    let (va, vb) = (mean(&|p| (p[0] - ma).powi(2)), mean(&|p| (p[1] - mb).powi(2)));
    let both = mean(&|p| (p[0] - ma) * (p[1] - mb));
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    (2.0 * ma * mb + c1) * (2.0 * both + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
}

/// Mean absolute difference of the colours of two pictures of the same size, of 255.
pub fn colour_difference(a: &Picture, b: &Picture) -> f64 {
    let sum: u64 = a.rgba.iter().zip(&b.rgba).map(|(x, y)| u64::from(x.abs_diff(*y))).sum();
    sum as f64 / (0.75 * a.rgba.len() as f64)
}

/// The smallest tier with this shading that is at least twice as wide as a reference picture.
///
/// # Panics
/// If there is none.
pub fn reference_tier(shading: Shading) -> usize {
    let fits = |t: &Tier| t.shading == shading && t.width_px >= 2 * REFERENCE_PX[0];
    TIERS.iter().rposition(fits).expect("a tier of each shading")
}

/// `picture` at the size of a reference picture.
pub fn reference_sized(picture: &Picture) -> Picture {
    reduced(picture, 2 * REFERENCE_PX[0])
}

/// `picture` at `width_px` and the height that goes with it, each pixel the mean of a square block.
/// A rest at the right and lower border is cut off.
pub fn reduced(picture: &Picture, width_px: u32) -> Picture {
    let n = (picture.width_px / width_px).max(1);
    let height_px = picture.height_px / n;
    let mut rgba = Vec::new();
    for (y, x) in (0..height_px).flat_map(|y| (0..width_px).map(move |x| (y, x))) {
        for c in 0..4 {
            let at = |i: u32| (((y * n + i / n) * picture.width_px + x * n + i % n) * 4 + c) as usize;
            let sum: u32 = (0..n * n).map(|i| u32::from(picture.rgba[at(i)])).sum();
            rgba.push(((sum + n * n / 2) / (n * n)) as u8);
        }
    }
    Picture { width_px, height_px, rgba }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checks(shift: u32) -> Picture {
        let pixel = |i: u32| if ((i % 32 + shift) / 4 + i / 32 / 4).is_multiple_of(2) { 200 } else { 60 };
        Picture {
            width_px: 32,
            height_px: 32,
            rgba: (0..1024).flat_map(|i| [pixel(i), 90, 60, 255]).collect(),
        }
    }

    #[test]
    fn the_same_is_alike_and_a_shift_is_not() {
        assert!((similarity(&checks(0), &checks(0)) - 1.0).abs() < 1e-12);
        assert!(similarity(&checks(0), &checks(1)) < 0.8 && similarity(&checks(0), &checks(4)) < 0.0);
        assert_eq!(colour_difference(&checks(0), &checks(0)), 0.0);
        assert!((colour_difference(&checks(0), &checks(4)) - 140.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn reduced_pictures_keep_the_mean() {
        let small = reduced(&checks(0), 4);
        assert_eq!((small.width_px, small.height_px, small.rgb(1, 1)), (4, 4, [130, 90, 60]));
    }
}
