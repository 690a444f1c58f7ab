//! Planes of luma and chroma (4:2:0), of which films consist.

/// How red, green and blue become luma and chroma.
#[derive(Debug)]
pub struct Coefficients {
    /// Of luma and the two chromas, in 1/65536.
    rows: [[i32; 3]; 3],
    /// Luma of black.
    black: i32,
}

/// Full range, ITU-R BT.601, as in JPEG.
pub const JPEG: Coefficients = Coefficients {
    rows: [[19_595, 38_470, 7_471], [-11_059, -21_709, 32_768], [32_768, -27_439, -5_329]],
    black: 0,
};
/// Luma from 16 to 235 and chroma from 16 to 240, ITU-R BT.709: what players expect of video.
pub const VIDEO: Coefficients = Coefficients {
    rows: [[11_966, 40_254, 4_064], [-6_596, -22_189, 28_785], [28_785, -26_145, -2_640]],
    black: 16,
};

/// Y, Cb, Cr planes of a picture of `w` × `h` pixels, both even; chroma is the mean of four pixels.
pub fn to_planes(rgb: &[u8], w: usize, h: usize, by: &Coefficients, out: &mut Vec<u8>) {
    out.clear();
    let at = |x: usize, y: usize| [0, 1, 2].map(|c| i32::from(rgb[(y * w + x) * 3 + c]));
    let dot = |[r, g, b]: [i32; 3], k: [i32; 3], shift: u32, offset: i32| {
        let sum = k[0] * r + k[1] * g + k[2] * b + (1 << (shift - 1));
        ((sum >> shift) + offset).clamp(0, 255) as u8
    };
    for y in 0..h {
        out.extend((0..w).map(|x| dot(at(x, y), by.rows[0], 16, by.black)));
    }
    for k in [by.rows[1], by.rows[2]] {
        for y in (0..h).step_by(2) {
            out.extend((0..w).step_by(2).map(|x| {
                let four = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
                dot([0, 1, 2].map(|c| four.iter().map(|p| p[c]).sum()), k, 18, 128)
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primaries_have_their_published_values() {
        let mut out = Vec::new();
        let mut planes = |rgb: [u8; 3], by| {
            to_planes(&rgb.repeat(4), 2, 2, by, &mut out);
            out.clone()
        };
        // JFIF 1.02: red is (76, 85, 255), grey has no chroma.
        assert_eq!(planes([255, 0, 0], &JPEG), [76, 76, 76, 76, 85, 255]);
        assert_eq!(planes([100; 3], &JPEG), [100, 100, 100, 100, 128, 128]);
        // BT.709 of eight bits: red is (63, 102, 240), green (173, 42, 26), blue (32, 240, 118).
        assert_eq!(planes([255, 0, 0], &VIDEO), [63, 63, 63, 63, 102, 240]);
        assert_eq!(planes([0, 255, 0], &VIDEO), [173, 173, 173, 173, 42, 26]);
        assert_eq!(planes([0, 0, 255], &VIDEO), [32, 32, 32, 32, 240, 118]);
        assert_eq!(planes([255; 3], &VIDEO), [235, 235, 235, 235, 128, 128]);
        assert_eq!(planes([0; 3], &VIDEO), [16, 16, 16, 16, 128, 128]);
    }
}
