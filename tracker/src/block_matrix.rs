//! Operations on the covariance of a filter of fixed size, on plain arrays: rows are contiguous, so
//! the compiler vectorises them, and nothing is copied.

use crate::pose_math::Matrix6;
use nalgebra::Vector3;

/// A row of the covariance.
pub type Row<const N: usize> = [f64; N];
/// An N×6 matrix by columns.
pub type Columns<const N: usize> = [Row<N>; 6];

/// Replaces the rows `at` by their linear combinations `f`.
#[expect(clippy::needless_range_loop, reason = "rows and columns are one matrix")]
pub fn combine_rows<const M: usize, const W: usize, const N: usize>(
    rows: &mut [Row<W>; N],
    at: [usize; M],
    f: &[[f64; M]; M],
) {
    for column in 0..W {
        let old: [f64; M] = std::array::from_fn(|i| rows[at[i]][column]);
        for (r, &row) in at.iter().enumerate() {
            let mut sum = 0.0;
            for c in 0..M {
                sum += f[r][c] * old[c];
            }
            rows[row][column] = sum;
        }
    }
}

/// Replaces the vectors by their linear combinations `f`.
pub fn combine_vectors<const M: usize>(vectors: &mut [Vector3<f64>], f: &[[f64; M]; M]) {
    let old: [Vector3<f64>; M] = std::array::from_fn(|i| vectors[i]);
    for (out, row) in vectors.iter_mut().zip(f) {
        *out = row.iter().zip(&old).fold(Vector3::zeros(), |sum, (f, v)| sum + v * *f);
    }
}

/// `left`·`right`.
pub fn product<const N: usize>(left: &Columns<N>, right: &Matrix6) -> Columns<N> {
    let [a, b, c, d, e, f] = left;
    std::array::from_fn(|n| {
        let w: [f64; 6] = std::array::from_fn(|m| right[(m, n)]);
        std::array::from_fn(|r| {
            w[0] * a[r] + w[1] * b[r] + w[2] * c[r] + w[3] * d[r] + w[4] * e[r] + w[5] * f[r]
        })
    })
}

/// Transposes `p` in place.
#[expect(clippy::needless_range_loop, reason = "rows and columns are one matrix")]
pub fn transpose<const N: usize>(p: &mut [Row<N>; N]) {
    for r in 0..N {
        for c in 0..r {
            (p[r][c], p[c][r]) = (p[c][r], p[r][c]);
        }
    }
}

/// Adds `block` to the rows and columns `at`.
pub fn add_block<const M: usize, const N: usize>(p: &mut [Row<N>; N], at: [usize; M], block: &[[f64; M]; M]) {
    for (r, row) in at.into_iter().zip(block) {
        for (c, q) in at.into_iter().zip(row) {
            p[r][c] += q;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixing_rows_is_a_product_from_the_left() {
        let f = [[1.0, 2.0], [3.0, -1.0]];
        let mut rows = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
        combine_rows(&mut rows, [2, 0], &f);
        assert_eq!(rows, [[20.0, 22.0, 24.0], [4.0, 5.0, 6.0], [9.0, 12.0, 15.0]]);
        transpose(&mut rows);
        assert_eq!(rows[0], [20.0, 4.0, 9.0]);
        add_block(&mut rows, [0, 2], &f);
        assert_eq!((rows[0], rows[2]), ([21.0, 4.0, 11.0], [27.0, 6.0, 14.0]));
    }

    #[test]
    fn columns_are_multiplied_from_the_right() {
        let left: Columns<2> = std::array::from_fn(|c| [c as f64, 1.0]);
        let right = Matrix6::from_fn(|r, c| if (r + 1) % 6 == c { 2.0 } else { 0.0 });
        let expected: Columns<2> = std::array::from_fn(|c| [2.0 * ((c + 5) % 6) as f64, 2.0]);
        assert_eq!(product(&left, &right), expected);
    }
}
