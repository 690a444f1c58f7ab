//! Central moments of a component in fixed point.

use super::sums::Sums;

/// Fraction bits of lengths, areas and moments.
pub const BITS: u32 = 16;
/// One in this fixed point.
pub const ONE: i128 = 1 << BITS;

/// Moments of a component about its centre, divided by Σ w. Lengths are in columns and lines, all
/// numbers in units of 2⁻¹⁶.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moments {
    /// Centre: column, line.
    pub centre: [i128; 2],
    /// Mean of x², x·y, y² about it.
    pub second: [i128; 3],
    /// Mean of x³, x²·y, x·y², y³ about it.
    pub third: [i128; 4],
}

impl Moments {
    /// The moments of a component; `None` without weight.
    ///
    /// The sums are shifted, exactly, to the whole pixel beside the centre before anything is
    /// divided: the third moment about the corner of the field is millions of times as large as
    /// about the centre.
    pub fn of(sums: &Sums) -> Option<Moments> {
        let w = i128::from(sums.w);
        if w == 0 {
            return None;
        }
        let [x, y, xx, xy, yy] = [sums.wx, sums.wy, sums.wxx, sums.wxy, sums.wyy].map(i128::from);
        let [xxx, xxy, xyy, yyy] = [sums.wxxx, sums.wxxy, sums.wxyy, sums.wyyy].map(|s| s as i128);
        let [a, b] = [x / w, y / w];
        let third = [
            xxx - 3 * a * xx + 3 * a * a * x - a * a * a * w,
            xxy - b * xx - 2 * a * xy + 2 * a * b * x + a * a * y - a * a * b * w,
            xyy - a * yy - 2 * b * xy + 2 * a * b * y + b * b * x - a * b * b * w,
            yyy - 3 * b * yy + 3 * b * b * y - b * b * b * w,
        ];
        let second = [xx - 2 * a * x + a * a * w, xy - a * y - b * x + a * b * w, yy - 2 * b * y + b * b * w];
        let mean = |sum: i128| (sum << BITS) / w;
        let [p, q] = [mean(x - a * w), mean(y - b * w)];
        let [xx, xy, yy] = second.map(mean);
        let [xxx, xxy, xyy, yyy] = third.map(mean);
        // The remaining distance to the centre is less than a pixel.
        Some(Moments {
            centre: [(a << BITS) + p, (b << BITS) + q],
            second: [xx - times(p, p), xy - times(p, q), yy - times(q, q)],
            third: [
                xxx - 3 * times(p, xx) + 2 * times(p, times(p, p)),
                xxy - times(q, xx) - 2 * times(p, xy) + 2 * times(q, times(p, p)),
                xyy - times(p, yy) - 2 * times(q, xy) + 2 * times(p, times(q, q)),
                yyy - 3 * times(q, yy) + 2 * times(q, times(q, q)),
            ],
        })
    }
}

/// A product of two numbers in units of 2⁻¹⁶.
pub fn times(a: i128, b: i128) -> i128 {
    (a * b) >> BITS
}

/// A quotient of two numbers in units of 2⁻¹⁶; 0 for a divisor of 0.
pub fn over(a: i128, b: i128) -> i128 {
    if b == 0 { 0 } else { (a << BITS) / b }
}

/// The square root of a number in units of 2⁻¹⁶; 0 for a negative one.
pub fn root(a: i128) -> i128 {
    ((a.max(0) as u128) << BITS).isqrt() as i128
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sums_of(pixels: &[(u16, u16, u8)]) -> Sums {
        let mut sums = Sums::default();
        for &(x, y, w) in pixels {
            sums.weigh(&[0], &[w], x, y, None);
        }
        sums
    }

    proptest! {
        #[test]
        fn moments_are_those_of_the_definition(
            at in (0u16..8100, 0u16..8100),
            pixels in prop::collection::vec((0u16..80, 0u16..40, 1u8..=64), 1..60),
        ) {
            let pixels: Vec<_> = pixels.into_iter().map(|(x, y, w)| (at.0 + x, at.1 + y, w)).collect();
            let found = Moments::of(&sums_of(&pixels)).unwrap();
            let sum = |f: &dyn Fn(f64, f64) -> f64| {
                pixels.iter().map(|&(x, y, w)| f64::from(w) * f(f64::from(x), f64::from(y))).sum::<f64>()
            };
            let w = sum(&|_, _| 1.0);
            let (cx, cy) = (sum(&|x, _| x) / w, sum(&|_, y| y) / w);
            let about = |i: i32, j: i32| sum(&|x, y| (x - cx).powi(i) * (y - cy).powi(j)) / w;
            let expected =
                [cx, cy, about(2, 0), about(1, 1), about(0, 2), about(3, 0), about(2, 1), about(1, 2), about(0, 3)];
            let [xx, xy, yy] = found.second;
            let [xxx, xxy, xyy, yyy] = found.third;
            let found = [found.centre[0], found.centre[1], xx, xy, yy, xxx, xxy, xyy, yyy];
            for (found, expected) in found.iter().zip(expected) {
                let found = *found as f64 / ONE as f64;
                prop_assert!((found - expected).abs() < 0.2 + expected.abs() * 1e-4, "{} {}", found, expected);
            }
        }
    }

    #[test]
    fn sums_without_weight_have_no_moments() {
        assert_eq!(Moments::of(&Sums::default()), None);
        assert_eq!((over(3, 0), root(-5), root(9 << 16)), (0, 0, 3 << 16));
    }
}
