//! Colour conversion before the extraction: RGB and full-range samples to the studio range of ITU-R
//! BT.601.
//!
//! Fixed point of 16 bits, as a hardware multiplier would do it: a coefficient has 17 bits with its
//! sign, a product with an 8-bit sample 25, the sum of three with offset and rounding 27. Results
//! need no clamp: the coefficients of luma add up to 219/255 and those of a chroma to zero.

/// Fraction bits.
const POINT: u32 = 16;
/// 65.481, 128.553 and 24.966 (BT.601, 8 bits) over 255, in 2⁻¹⁶.
const LUMA: [i32; 3] = [16_829, 33_039, 6_416];
/// −37.797, −74.203 and 112 over 255, in 2⁻¹⁶; rounded so that grey has no chroma.
const BLUE: [i32; 3] = [-9_714, -19_070, 28_784];
/// 112, −93.786 and −18.214 over 255, in 2⁻¹⁶.
const RED: [i32; 3] = [28_784, -24_103, -4_681];
/// Luma of black in the studio range.
pub const BLACK: u8 = 16;
/// Luma of white in the studio range.
pub const WHITE: u8 = 235;
/// Chroma of grey.
pub const GREY: u8 = 128;

const _: () = assert!(LUMA[0] + LUMA[1] + LUMA[2] == (219 * (1 << POINT) + 127) / 255);
const _: () = assert!(BLUE[0] + BLUE[1] + BLUE[2] == 0 && RED[0] + RED[1] + RED[2] == 0);

const fn dot(rgb: [u8; 3], k: [i32; 3], offset: u8) -> u8 {
    let sum = k[0] * rgb[0] as i32 + k[1] * rgb[1] as i32 + k[2] * rgb[2] as i32;
    (((sum + (1 << (POINT - 1))) >> POINT) + offset as i32) as u8
}

/// Y, Cb, Cr (16–235, 16–240) of an RGB sample (0–255).
pub const fn ycc_of_rgb(rgb: [u8; 3]) -> [u8; 3] {
    [dot(rgb, LUMA, BLACK), dot(rgb, BLUE, GREY), dot(rgb, RED, GREY)]
}

/// RGB (0–255) of a studio-range sample, for display; colours out of range are clamped.
pub fn rgb_of_ycc([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    // 255/219; 1.402, 0.344136, 0.714136 and 1.772 (BT.601) times 255/224; in 2⁻¹⁶.
    let y = (i64::from(y) - i64::from(BLACK)) * 76_309;
    let [cb, cr] = [cb, cr].map(|c| i64::from(c) - i64::from(GREY));
    let sums = [y + 104_597 * cr, y - 25_675 * cb - 53_279 * cr, y + 132_202 * cb];
    sums.map(|s| ((s + (1 << (POINT - 1))) >> POINT).clamp(0, 255) as u8)
}

/// Luma in the studio range of a full-range sample.
pub const fn luma_of_full(sample: u8) -> u8 {
    ((sample as u32 * 219 + 127) / 255) as u8 + BLACK
}

/// Chroma in the studio range of a full-range sample.
pub const fn chroma_of_full(sample: u8) -> u8 {
    // Halves are rounded away from grey on either side, so that opposite colours stay opposite.
    let from_grey = sample as i32 - GREY as i32;
    let scaled = (2 * 224 * from_grey + if from_grey < 0 { -255 } else { 255 }) / (2 * 255);
    (GREY as i32 + scaled) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn colour_bars_have_their_published_values() {
        // 100 % bars of ITU-R BT.601 in 8 bits, as EBU Tech. 3325 and test generators list them.
        let bars = [
            ([255, 255, 255], [235, 128, 128]),
            ([255, 255, 0], [210, 16, 146]),
            ([0, 255, 255], [170, 166, 16]),
            ([0, 255, 0], [145, 54, 34]),
            ([255, 0, 255], [106, 202, 222]),
            ([255, 0, 0], [81, 90, 240]),
            ([0, 0, 255], [41, 240, 110]),
            ([0, 0, 0], [16, 128, 128]),
        ];
        for (rgb, ycc) in bars {
            assert_eq!(ycc_of_rgb(rgb), ycc, "{rgb:?}");
            let back = rgb_of_ycc(ycc);
            assert!(back.iter().zip(rgb).all(|(a, b)| a.abs_diff(b) <= 2), "{rgb:?} comes back as {back:?}");
        }
        assert_eq!([0, 128, 255].map(luma_of_full), [16, 126, 235]);
        assert_eq!([0, 1, 128, 255].map(chroma_of_full), [16, 16, 128, 240]);
    }

    proptest! {
        #[test]
        fn fixed_point_is_within_half_a_level_of_the_formula(rgb in any::<[u8; 3]>()) {
            let exact = |k: [f64; 3], offset: f64| {
                offset + k.iter().zip(rgb).map(|(k, v)| k * f64::from(v) / 255.0).sum::<f64>()
            };
            let expected = [
                exact([65.481, 128.553, 24.966], 16.0),
                exact([-37.797, -74.203, 112.0], 128.0),
                exact([112.0, -93.786, -18.214], 128.0),
            ];
            for (found, expected) in ycc_of_rgb(rgb).into_iter().zip(expected) {
                prop_assert!((f64::from(found) - expected).abs() < 0.51, "{} for {}", found, expected);
            }
        }
    }
}
