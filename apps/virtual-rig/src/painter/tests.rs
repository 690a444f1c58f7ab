//! Tests of the painter: agreement with its image model, interlace, motion blur.

use super::*;
use nalgebra::{Matrix2, Vector2};
use protocol::blobs::Colour;
use protocol::fields::DARK;
use protocol::random::Random;

fn marker(x: f64, y: f64) -> MarkerImage {
    MarkerImage {
        body: 0,
        marker: 0,
        colour: Colour::Green,
        centre_px: Vector2::new(x, y),
        shape_px2: Matrix2::new(100.0, 5.0, 5.0, 110.0),
        depth_mm: 80.0,
    }
}

fn flat() -> ImageModel {
    ImageModel { gradient: [0.0; 2], ..ImageModel::default() }
}

/// Centroid of the luma above the background, px of the frame.
fn centre(picture: &FieldPicture, parity: f64, ground: f64) -> Vector2<f64> {
    let mut sum = nalgebra::Vector3::zeros();
    for y in 0..picture.height {
        for x in 0..picture.width {
            let above = f64::from(picture.luma[y * picture.width + x]) - ground;
            sum += nalgebra::Vector3::new(x as f64, 2.0 * y as f64 + parity, 1.0) * above;
        }
    }
    sum.xy() / sum.z
}

#[test]
fn background_is_dark_noise_that_changes() {
    let painter = Painter::with_model([720, 576], 5, flat());
    let mut picture = FieldPicture::new([720, 576]);
    painter.draw(&[], 0, 0, &mut picture);
    let first = picture.luma.clone();
    let mean = first.iter().map(|&v| f64::from(v)).sum::<f64>() / first.len() as f64;
    let variance = first.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / first.len() as f64;
    let expected = flat().luma_variance(mean) + 1.0 / 12.0;
    assert!((mean - f64::from(DARK)).abs() < 0.1, "{mean}");
    assert!((variance - expected).abs() < 0.15, "{variance}, expected {expected}");
    painter.draw(&[], 0, 2, &mut picture);
    assert_ne!(first, picture.luma);
    painter.draw(&[], 1, 0, &mut picture);
    assert_ne!(first, picture.luma, "cameras differ");
    painter.draw(&[], 0, 0, &mut picture);
    assert_eq!(first, picture.luma, "the same field looks the same");
}

#[test]
fn pixels_have_the_mean_and_the_variance_of_the_image_model() {
    let model = ImageModel::default();
    let painter = Painter::with_model([64, 64], 8, model);
    let mut picture = FieldPicture::new([64, 64]);
    let patch = Patch::from(marker(30.3, 31.1));
    let n = 2000;
    let mut sums = vec![[0.0; 2]; 64 * 32];
    for k in 0..n {
        // The same eighth of the carrier's round, so that the mean does not change.
        painter.paint(std::iter::once(patch), &Light::default(), 0, 8 * k, &mut picture);
        for (sum, &v) in sums.iter_mut().zip(&picture.luma) {
            let v = f64::from(v);
            *sum = [sum[0] + v, sum[1] + v * v];
        }
    }
    let (mut chi, mut ratio) = (0.0, 0.0);
    for (i, sum) in sums.iter().enumerate() {
        let mean = sum[0] / n as f64;
        let variance = sum[1] / n as f64 - mean * mean;
        let expected = model.mean_luma(&patch, 0, [64, 32], (i % 64) as f64, (i / 64) as f64);
        let spread = model.luma_variance(expected) + 1.0 / 12.0;
        chi += (mean - expected).powi(2) / (spread / n as f64);
        ratio += variance / spread;
        assert!((mean - expected).abs() < 0.4, "pixel {i}: {mean}, expected {expected}");
    }
    let pixels = sums.len() as f64;
    assert!((chi / pixels) < 1.6, "mean square of the means' errors over their variance: {}", chi / pixels);
    assert!((ratio / pixels - 1.0).abs() < 0.02, "variance over the model's: {}", ratio / pixels);
}

#[test]
fn covered_area_is_that_of_the_outline() {
    // Truth: the share of random points of each pixel, blurred by lens and movement, in the
    // ellipse.
    let model = ImageModel { side_shade: 0.0, rim_shade: 0.0, crosstalk: 0.0, ..flat() };
    let patch = Patch { smear_px: Vector2::new(2.5, 1.0), ..marker(31.0, 30.0).into() };
    let light = reference_luma();
    let mut random = Random::from_seed(9);
    let mut uniform = || random.uniform() - 0.5;
    let metric = patch.image.shape_px2.try_inverse().unwrap();
    for (x, y) in [(20.0, 15.0), (21.0, 15.0), (22.0, 12.0), (31.0, 10.0), (38.0, 18.0), (40.0, 14.0)] {
        let n = 40_000;
        let mut hits = 0;
        for _ in 0..n {
            // Twelve uniform numbers are as good as a Gaussian here.
            let mut gauss = || (0..12).map(|_| uniform()).sum::<f64>() * model.blur_px;
            let lens = Vector2::new(gauss(), gauss());
            let pixel = Vector2::new(uniform(), 2.0 * uniform());
            let at = Vector2::new(x, 2.0 * y) + lens + pixel - patch.smear_px * uniform();
            let d = at - patch.image.centre_px;
            hits += u32::from(d.dot(&(metric * d)) < 1.0);
        }
        let truth = f64::from(hits) / f64::from(n);
        let mean = model.mean_luma(&patch, 0, [64, 32], x, y);
        let share = (mean - model.background) / (light - model.background);
        assert!((share - truth).abs() < 0.025, "pixel {x}, {y}: {share}, expected {truth}");
    }
}

fn reference_luma() -> f64 {
    f64::from(Colour::Green.reference()[0])
}

#[test]
fn parity_decides_the_lines() {
    let painter = Painter::new([720, 576], 5);
    let mut picture = FieldPicture::new([720, 576]);
    for number in [4u64, 5] {
        let parity = (number & 1) as f64;
        painter.draw(&[marker(300.0, 200.0 + parity)], 0, number, &mut picture);
        let rows: Vec<usize> = (0..288).filter(|y| picture.luma[y * 720 + 300] > 90).collect();
        assert_eq!((rows[0] + rows[rows.len() - 1]) / 2, 100, "line (200 + parity − parity)/2");
    }
}

#[test]
fn woven_fields_of_a_moving_marker_comb() {
    let model = ImageModel { read_noise: 0.0, shot_noise: 0.0, side_shade: 0.0, ..flat() };
    let painter = Painter::with_model([64, 64], 1, model);
    let mut fields = [0, 1].map(|_| FieldPicture::new([64, 64]));
    // 200 px/s: 4 px from field to field, 0.8 px in an exposure.
    for (k, field) in fields.iter_mut().enumerate() {
        let patch = Patch { smear_px: Vector2::new(0.8, 0.0), ..marker(28.0 + 4.0 * k as f64, 31.0).into() };
        painter.paint(std::iter::once(patch), &Light::default(), 0, k as u64, field);
    }
    let at = [0, 1].map(|k| centre(&fields[k], k as f64, model.background));
    assert!((at[1].x - at[0].x - 4.0).abs() < 0.05, "each field shows its own instant: {at:?}");
    assert!((at[1].y - at[0].y).abs() < 0.05, "nothing moved up or down: {at:?}");
}

#[test]
fn movement_smears_and_does_not_shift() {
    let model = ImageModel { read_noise: 0.0, shot_noise: 0.0, side_shade: 0.0, crosstalk: 0.0, ..flat() };
    let painter = Painter::with_model([128, 64], 1, model);
    let mut picture = FieldPicture::new([128, 64]);
    let mut widths = Vec::new();
    for smear in [0.0, 0.9, 6.0, 20.0] {
        let patch = Patch { smear_px: Vector2::new(smear, 0.0), ..marker(60.0, 31.0).into() };
        painter.paint(std::iter::once(patch), &Light::default(), 0, 0, &mut picture);
        let at = centre(&picture, 0.0, model.background);
        assert!((at - Vector2::new(60.0, 31.0)).norm() < 0.05, "{smear}: {at}");
        widths.push(picture.luma[15 * 128..16 * 128].iter().filter(|&&v| v > 85).count());
    }
    assert!(widths[1] <= widths[0] + 1 && widths[3] <= 22, "half height stays: {widths:?}");
    let still = ImageModel { motion: false, ..model };
    let patch = Patch { smear_px: Vector2::new(20.0, 0.0), ..marker(60.0, 31.0).into() };
    let mean = |m: &ImageModel| m.mean_luma(&patch, 0, [128, 32], 60.0, 15.0);
    assert!(mean(&still) > mean(&model) - 1e-9);
}

#[test]
fn nearer_markers_hide_farther_ones() {
    let painter = Painter::new([64, 64], 1);
    let mut picture = FieldPicture::new([64, 64]);
    let red = MarkerImage { colour: Colour::Red, ..marker(30.0, 30.0) };
    painter.draw(&[red, marker(32.0, 30.0)], 0, 0, &mut picture);
    let (luma, _, chroma) = picture.line(15);
    assert!(f64::from(luma[31]) > 125.0 && chroma[15] < 100, "the green one is seen");
    let mut alone = FieldPicture::new([64, 64]);
    painter.draw(&[marker(32.0, 30.0)], 0, 0, &mut alone);
    assert_eq!(picture.line(15).0[38], alone.line(15).0[38], "where the red one does not reach");
}

#[test]
fn markers_at_and_beyond_every_border_do_not_panic() {
    let painter = Painter::new([64, 48], 5);
    let mut picture = FieldPicture::new([64, 48]);
    for x in -40..110 {
        for y in -40..90 {
            painter.draw(&[marker(f64::from(x), f64::from(y))], 0, 1, &mut picture);
        }
    }
    let many: Vec<_> = (0..100).map(|i| marker(f64::from(i % 60), 20.0)).collect();
    painter.draw(&many, 0, 1, &mut picture);
}
