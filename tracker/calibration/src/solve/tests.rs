//! Tests of the solver: known answers, outliers, what cannot be solved.

use super::*;
use nalgebra::{Vector1, Vector2};
use proptest::prelude::*;

/// Lines y = slope·x + height: one slope for all (shared), a height each (own).
struct Lines {
    points: Vec<Vec<(f64, f64)>>,
    loss: Loss,
    /// Also a shared unknown that no equation knows of.
    idle: bool,
}

impl Problem for Lines {
    type State = (Vec<f64>, Vec<f64>);

    fn shared(&self) -> usize {
        1 + usize::from(self.idle)
    }
    fn name(&self, shared: usize) -> String {
        ["slope", "idle"][shared].into()
    }
    fn blocks(&self) -> usize {
        self.points.len()
    }
    fn own(&self, _: usize) -> usize {
        1
    }
    fn equations(&self, (slope, heights): &Self::State, block: usize, out: &mut NormalEquations) {
        for &(x, y) in &self.points[block] {
            let columns = [(Unknown::Shared(0), Vector1::new(x)), (Unknown::Own(0), Vector1::new(1.0))];
            out.add(&Vector1::new(slope[0] * x + heights[block] - y), &columns, self.loss);
        }
    }
    fn moved(&self, state: &Self::State, shared: &DVector<f64>, own: &[DVector<f64>]) -> Self::State {
        let slopes = state.0.iter().zip(shared).map(|(a, b)| a + b).collect();
        (slopes, state.1.iter().zip(own).map(|(a, b)| a + b[0]).collect())
    }
}

fn lines(points: Vec<Vec<(f64, f64)>>, loss: Loss) -> (Lines, (Vec<f64>, Vec<f64>)) {
    let start = (vec![0.0], vec![0.0; points.len()]);
    (Lines { points, loss, idle: false }, start)
}

proptest! {
    #[test]
    fn a_shared_slope_is_that_of_the_closed_form(ys in prop::collection::vec(prop::array::uniform5(-9.0..9.0f64), 1..6)) {
        // Within each line the mean drops out: slope = Σ (x − x̄)·y / Σ (x − x̄)².
        let points = ys.iter().map(|y| y.iter().enumerate().map(|(x, &y)| (x as f64, y)).collect()).collect();
        let (problem, start) = lines(points, Loss::Square);
        let found = solve(&problem, start, &mut |_, _| {}).unwrap();
        let above: f64 = ys.iter().flat_map(|y| y.iter().enumerate().map(|(x, y)| (x as f64 - 2.0) * y)).sum();
        let slope = above / (10.0 * ys.len() as f64);
        // Ended within 1e-7 standard deviations, of which there are some three to the unit.
        prop_assert!((found.state.0[0] - slope).abs() < 1e-6);
        prop_assert!((found.sigma(0).powi(2) * 10.0 * ys.len() as f64 - 1.0).abs() < 1e-9);
        prop_assert_eq!(found.freedom, 5 * ys.len() - ys.len() - 1);
    }
}

#[test]
fn losses_are_smooth_and_bend_where_they_should() {
    for loss in [Loss::Square, Loss::Huber(2.0), Loss::Cauchy(2.0)] {
        assert_eq!(loss.at(0.0), (0.0, 1.0));
        for s in [0.5, 3.9, 4.1, 100.0] {
            let slope = (loss.at(s + 1e-4).0 - loss.at(s - 1e-4).0) / 2e-4;
            assert!((slope - loss.at(s).1).abs() < 1e-4, "{loss:?} at {s}");
        }
    }
    assert!(Loss::Huber(2.0).at(100.0).1 > Loss::Cauchy(2.0).at(100.0).1);
}

#[test]
fn an_outlier_is_outvoted() {
    let mut points: Vec<(f64, f64)> = (0..20).map(|i| (f64::from(i), 3.0 * f64::from(i))).collect();
    points[19].1 += 500.0;
    let slope = |loss| {
        let (problem, start) = lines(vec![points.clone()], loss);
        solve(&problem, start, &mut |_, _| {}).unwrap().state.0[0]
    };
    assert!((slope(Loss::Square) - 3.0).abs() > 5.0);
    assert!((slope(Loss::Cauchy(1.0)) - 3.0).abs() < 0.05);
}

#[test]
fn what_the_data_leave_open_is_named() {
    let (problem, start) = lines(vec![vec![(2.0, 1.0), (2.0, 1.5), (2.0, 0.5)]], Loss::Square);
    let error = solve(&problem, start, &mut |_, _| {}).unwrap_err();
    assert!(error.to_string().contains("do not determine slope"), "{error}");
    let (mut problem, _) = lines(vec![vec![(1.0, 1.0), (2.0, 1.5), (3.0, 0.5)]], Loss::Square);
    problem.idle = true;
    let error = solve(&problem, (vec![0.0; 2], vec![0.0]), &mut |_, _| {}).unwrap_err();
    assert!(error.to_string().contains("do not determine idle"), "{error}");
    let (problem, start) = lines(vec![vec![(1.0, 1.0)]], Loss::Square);
    let error = solve(&problem, start, &mut |_, _| {}).unwrap_err();
    assert_eq!(error, SolveError::TooFew { equations: 1, unknowns: 2 });
}

#[test]
fn an_impossible_start_is_refused() {
    struct Nowhere;
    impl Problem for Nowhere {
        type State = ();
        fn shared(&self) -> usize {
            1
        }
        fn name(&self, _: usize) -> String {
            "x".into()
        }
        fn blocks(&self) -> usize {
            1
        }
        fn own(&self, _: usize) -> usize {
            0
        }
        fn equations(&self, _: &(), _: usize, out: &mut NormalEquations) {
            out.add(&Vector2::new(1.0, 1.0), &[(Unknown::Shared(0), Vector2::new(1.0, 0.0))], Loss::Square);
            out.refuse();
        }
        fn moved(&self, _: &(), _: &DVector<f64>, _: &[DVector<f64>]) {}
    }
    assert_eq!(solve(&Nowhere, (), &mut |_, _| {}).unwrap_err(), SolveError::Start);
}

/// The narrow valley y = x², along which x is hardly known to be 1, and noise of unit variance.
struct Valley {
    near_enough: f64,
}

impl Problem for Valley {
    type State = DVector<f64>;

    fn shared(&self) -> usize {
        2
    }
    fn name(&self, shared: usize) -> String {
        ["x", "y"][shared].into()
    }
    fn near_enough(&self) -> f64 {
        self.near_enough
    }
    fn blocks(&self) -> usize {
        1
    }
    fn own(&self, _: usize) -> usize {
        1
    }
    fn equations(&self, at: &DVector<f64>, _: usize, out: &mut NormalEquations) {
        let ([x, y], [by_x, by_y]) = ([at[0], at[1]], [Unknown::Shared(0), Unknown::Shared(1)]);
        let beside = 500.0 * (y - x * x);
        let columns = [(by_x, Vector1::new(-1e3 * x)), (by_y, Vector1::new(500.0))];
        out.add(&Vector1::new(beside), &columns, Loss::Square);
        out.add(&Vector1::new(0.3 * (x - 1.0)), &[(by_x, Vector1::new(0.3))], Loss::Square);
        for noise in [-1.0, 1.0].repeat(50) {
            out.add(&Vector1::new(noise), &[(Unknown::Own(0), Vector1::new(1.0))], Loss::Square);
        }
    }
    fn moved(&self, at: &DVector<f64>, shared: &DVector<f64>, _: &[DVector<f64>]) -> DVector<f64> {
        at + shared
    }
}

#[test]
fn a_valley_without_slope_is_followed_to_its_end_only_where_that_is_wanted() {
    let found = |near_enough| {
        let start = DVector::from_vec(vec![-2.0, 4.0]);
        solve(&Valley { near_enough }, start, &mut |_, _| {}).unwrap()
    };
    let (nearest, near) = (found(0.0), found(0.01));
    assert!((nearest.state[0] - 1.0).abs() < 1e-5, "{nearest:?}");
    assert!(near.iterations * 5 < nearest.iterations, "{} and {}", near.iterations, nearest.iterations);
    // What the end of the valley would take away is less than one such measurement is wrong by.
    assert!(near.cost - nearest.cost < 1.0 && near.cost >= nearest.cost, "{near:?}");
}
