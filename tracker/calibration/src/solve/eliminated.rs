//! A block of the normal equations without its own unknowns.

use nalgebra::{DMatrix, DVector};

/// A block whose own unknowns, with H = L·Lᵀ, are eliminated.
///
/// It is one matrix with a column for each own unknown: L, below it (shared by own)·L⁻ᵀ, and in the last row the transposed
/// L⁻¹·(own gradient). So one loop factors and eliminates along contiguous columns that are as long as all unknowns, instead of
/// a short column for each shared one.
pub(super) struct Eliminated {
    columns: DMatrix<f64>,
}

impl Eliminated {
    /// Eliminates own unknowns with second derivatives `own` (H), `mixed` (shared by own), and `gradient`; `None` where H is not
    /// positive definite.
    pub(super) fn of(own: &DMatrix<f64>, mixed: &DMatrix<f64>, gradient: &DVector<f64>) -> Option<Self> {
        let (size, shared) = (own.nrows(), mixed.nrows());
        let mut columns = DMatrix::zeros(size + shared + 1, size);
        columns.rows_mut(0, size).copy_from(own);
        columns.rows_mut(size, shared).copy_from(mixed);
        columns.row_mut(size + shared).tr_copy_from(gradient);
        factor(&mut columns).then_some(Eliminated { columns })
    }

    /// Takes what the block says of the shared unknowns out of their system.
    pub(super) fn reduce(&self, schur: &mut DMatrix<f64>, right: &mut DVector<f64>) {
        let (own, shared) = self.sizes();
        let mixed = self.columns.rows(own, shared);
        schur.gemm(-1.0, &mixed, &mixed.transpose(), 1.0);
        right.gemv(1.0, &mixed, &self.columns.row(own + shared).transpose(), 1.0);
    }

    /// The own step that goes with one of the shared unknowns.
    pub(super) fn step(&self, of_shared: &DVector<f64>) -> DVector<f64> {
        let (own, shared) = self.sizes();
        let mut step = -self.columns.row(own + shared).transpose();
        step.gemv_tr(-1.0, &self.columns.rows(own, shared), of_shared, 1.0);
        self.columns.rows(0, own).tr_solve_lower_triangular_unchecked_mut(&mut step);
        step
    }

    /// Numbers of own and of shared unknowns.
    fn sizes(&self) -> (usize, usize) {
        let (rows, own) = self.columns.shape();
        (own, rows - own - 1)
    }
}

/// Cholesky's factorisation of the upper square, carried on into the rows below it; false where it is not positive definite.
fn factor(columns: &mut DMatrix<f64>) -> bool {
    let (rows, count) = columns.shape();
    let mut rest = columns.as_mut_slice();
    for done in 0..count {
        let (column, later) = rest.split_at_mut(rows);
        let column = &mut column[done..];
        let pivot = column[0];
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        let scale = pivot.sqrt();
        column.iter_mut().for_each(|value| *value /= scale);
        for (row, other) in (1..).zip(later.chunks_exact_mut(rows)) {
            let share = column[row];
            // Most are: bodies do not meet, and a path's control points only the next ones.
            if share == 0.0 {
                continue;
            }
            for (value, by) in other[done + row..].iter_mut().zip(&column[row..]) {
                *value -= share * by;
            }
        }
        rest = later;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::Eliminated;
    use nalgebra::{DMatrix, DVector};
    use protocol::random::Random;

    /// A block of random equations, the system of its shared unknowns, and the solution of both at once.
    #[test]
    fn what_elimination_solves_is_the_whole_system() {
        let mut random = Random::from_seed(5);
        let mut compared = 0;
        for (own, shared, groups) in [(0, 3, 1), (1, 1, 1), (6, 0, 1), (6, 20, 1), (18, 7, 1), (18, 7, 3)] {
            let all = own + shared;
            // Own unknowns of different groups meet in no equation, so that their products are zero.
            let stranger = |row: usize, column: usize| column < own && column % groups != row % groups;
            let equations = DMatrix::from_fn(groups * (all + 9), all, |row, column| {
                if stranger(row, column) { 0.0 } else { random.normal() }
            });
            let h = equations.tr_mul(&equations);
            let gradient = DVector::from_fn(all, |_, _| random.normal());
            let [o, s] = [gradient.rows(0, own).into_owned(), gradient.rows(own, shared).into_owned()];
            let mixed = h.view((own, 0), (shared, own)).into_owned();
            let block = Eliminated::of(&h.view((0, 0), (own, own)).into_owned(), &mixed, &o).unwrap();
            let mut schur = h.view((own, own), (shared, shared)).into_owned();
            let mut right = -s;
            block.reduce(&mut schur, &mut right);
            let of_shared = if shared == 0 { right } else { schur.lu().solve(&right).unwrap() };
            let of_own = block.step(&of_shared);
            let whole = h.lu().solve(&-gradient).unwrap();
            for (eliminated, expected) in of_own.iter().chain(&of_shared).zip(&whole) {
                assert!(
                    (eliminated - expected).abs() < 1e-9 * (1.0 + expected.abs()),
                    "{own}, {shared}, {groups}"
                );
                compared += 1;
            }
        }
        assert_eq!(compared, 87);
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        for (first, second) in [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (1.0, -1.0), (f64::NAN, 1.0)] {
            let own = DMatrix::from_diagonal(&DVector::from_vec(vec![first, second]));
            assert!(Eliminated::of(&own, &DMatrix::zeros(1, 2), &DVector::zeros(2)).is_none());
        }
    }
}
