//! A covariance in UD form, for recursions that run for hours.
//!
//! P = U·D·Uᵀ with U unit upper triangular and D diagonal. An observation y = xᵀ·w + noise of variance 1
//! changes U and D (Bierman 1977, Factorization Methods for Discrete Sequential Estimation, ch. V): with
//! f = Uᵀ·x, v = D·f and the innovation variances a_j = 1 + f_0·v_0 + … + f_j·v_j,
//!
//! ```text
//! d_j  ←  d_j · a_(j−1) / a_j
//! U_ij ←  U_ij − b_i · f_j / a_(j−1),   b_i ← b_i + U_ij · v_j      (i < j, the former U_ij)
//! b_j  =  v_j;   gain = b / a_L
//! ```
//!
//! P is symmetric by construction, and positive definite as long as D is: every factor on a d_j lies
//! between 0 and 1, so rounding cannot change its sign. A matrix that is updated as P − gain·(P·x)ᵀ has
//! neither property, and forgetting amplifies what rounding breaks.

use crate::checkpoint::{Done, Loader, Saver, require};
use nalgebra::{SMatrix, SVector};

/// A covariance of `L` weights, as U and D.
#[derive(Debug, Clone, PartialEq)]
pub struct UdCovariance<const L: usize> {
    /// U; ones on the diagonal, zeros below it.
    upper: SMatrix<f64, L, L>,
    /// D.
    diagonal: SVector<f64, L>,
}

impl<const L: usize> UdCovariance<L> {
    /// The identity.
    pub fn identity() -> Self {
        UdCovariance { upper: SMatrix::identity(), diagonal: SVector::repeat(1.0) }
    }

    /// Factors a symmetric, positive definite matrix; `None` where it is not. Only the upper triangle is
    /// read.
    pub fn new(covariance: &SMatrix<f64, L, L>) -> Option<Self> {
        let mut rest = *covariance;
        let (mut upper, mut diagonal) = (SMatrix::identity(), SVector::zeros());
        for j in (0..L).rev() {
            let d = rest[(j, j)];
            if !(d > 0.0 && d.is_finite()) {
                return None;
            }
            diagonal[j] = d;
            for i in 0..j {
                upper[(i, j)] = rest[(i, j)] / d;
            }
            for c in 0..j {
                for r in 0..=c {
                    rest[(r, c)] -= upper[(r, j)] * d * upper[(c, j)];
                }
            }
        }
        Some(UdCovariance { upper, diagonal })
    }

    /// Multiplies the covariance by a positive factor.
    pub fn scale(&mut self, factor: f64) {
        self.diagonal *= factor;
    }

    /// Takes in an observation by `x` with a noise of variance 1; returns the gain P·x after it.
    pub fn observe(&mut self, x: &SVector<f64, L>) -> SVector<f64, L> {
        let mut gain = SVector::<f64, L>::zeros();
        let mut before = 1.0;
        for j in 0..L {
            let mut column = self.upper.column_mut(j);
            let mut f = x[j];
            for i in 0..j {
                f += column[i] * x[i];
            }
            let v = self.diagonal[j] * f;
            let after = before + f * v;
            self.diagonal[j] *= before / after;
            let factor = -f / before;
            for i in 0..j {
                let u = column[i];
                column[i] = u + gain[i] * factor;
                gain[i] += u * v;
            }
            gain[j] = v;
            before = after;
        }
        gain / before
    }

    /// Writes D, and U above its diagonal.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        out.numbers(&self.diagonal)?;
        (0..L).try_for_each(|j| out.numbers(self.upper.column(j).iter().take(j)))
    }

    /// Takes over what was saved.
    pub(crate) fn load(&mut self, from: &mut Loader<'_>) -> Done {
        from.numbers(&mut self.diagonal)?;
        require(self.is_valid(), "a predictor's covariance is not positive definite")?;
        (0..L).try_for_each(|j| from.numbers(self.upper.column_mut(j).iter_mut().take(j)))
    }

    /// True if it is finite and positive definite. What is not finite in U is so in D after the next
    /// observation.
    pub fn is_valid(&self) -> bool {
        self.diagonal.iter().all(|d| *d > 0.0 && d.is_finite())
    }

    /// The covariance, U·D·Uᵀ.
    #[cfg(test)]
    pub fn matrix(&self) -> SMatrix<f64, L, L> {
        self.upper * SMatrix::from_diagonal(&self.diagonal) * self.upper.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const N: usize = 5;
    type Matrix = SMatrix<f64, N, N>;

    fn positive(values: &[f64]) -> Matrix {
        let root = Matrix::from_column_slice(values);
        root * root.transpose() + Matrix::identity() * 1e-3
    }

    proptest! {
        /// Against the textbook's form, P − P·x·xᵀ·P / (1 + xᵀ·P·x).
        #[test]
        fn an_observation_is_that_of_the_textbook(
            values in prop::collection::vec(-2.0..2.0f64, N * N),
            x in prop::collection::vec(-3.0..3.0f64, N),
        ) {
            let (p, x) = (positive(&values), SVector::<f64, N>::from_column_slice(&x));
            let mut ud = UdCovariance::new(&p).expect("positive definite");
            prop_assert!((ud.matrix() - p).amax() < 1e-9);
            let projected = p * x;
            let gain = projected / (1.0 + x.dot(&projected));
            prop_assert!((ud.observe(&x) - gain).amax() < 1e-9);
            prop_assert!((ud.matrix() - (p - gain * projected.transpose())).amax() < 1e-8);
            prop_assert!(ud.is_valid());
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let mut p = Matrix::identity();
        p[(2, 2)] = -1.0;
        assert_eq!(UdCovariance::new(&p), None);
        p[(2, 2)] = f64::NAN;
        assert_eq!(UdCovariance::new(&p), None);
    }

    /// Forgetting for as long as made the plain form useless, over inputs of very different sizes.
    #[test]
    fn a_million_observations_leave_it_positive_definite() {
        let mut ud = UdCovariance::new(&Matrix::identity()).expect("positive definite");
        for n in 0..1_000_000u64 {
            let size = if n % 10_000 < 5_000 { 1e-4 } else { 1e3 };
            let unit = |i: usize| protocol::random::unit_interval(protocol::random::nth(i as u64, n)) - 0.5;
            ud.scale(1.0 / 0.995);
            ud.observe(&SVector::from_fn(|i, _| size * unit(i)));
            assert!(ud.is_valid(), "after {n}");
        }
    }
}
