//! Robust least squares with many small unknowns and few large ones: Levenberg–Marquardt on the
//! normal equations, with the Schur complement.
//!
//! Every calibration here has *shared* unknowns (lenses, places of cameras, markers), of which
//! there are tens, and *blocks* of own unknowns (the pose of the board in one picture, the poses of
//! the bodies at one instant), of which there may be hundreds and which meet only through the
//! shared ones. Eliminating each block first leaves a small dense system; the cost is linear in the
//! blocks (Triggs et al., Bundle Adjustment – A Modern Synthesis, 2000, section 6).
//!
//! Minimised is Σ ρ(|r|²) over all equations, r whitened to unit variance, ρ a [`Loss`].

mod eliminated;

use eliminated::Eliminated;
use nalgebra::{DMatrix, DVector, SVector};

/// A bound on time, not a criterion: a sane problem needs 5 to 30 iterations, a valley some 300.
pub const MAX_STEPS: usize = 5000;
/// Distance to the minimum at which it is reached, in standard deviations of the estimate along the
/// worst direction: √(gᵀ H⁻¹ g) over the noise (the Newton decrement), which no unit and no
/// correlation of the unknowns moves.
const DISTANCE_TOLERANCE: f64 = 1e-7;
/// Relative decrease of the cost at which rounding begins.
const COST_TOLERANCE: f64 = 1e-14;
/// Where a solution need not be as near as can be ([`Problem::near_enough`]), it also ends in a curved valley without slope,
/// along which many steps would only move what the data leave open: after so many steps in a row,
const FLAT_STEPS: usize = 3;
/// each of which lessened the cost by less than this many times the noise,
const FLAT_GAIN: f64 = 0.05;
/// and at most so many standard deviations away from the minimum.
const FLAT_DISTANCE: f64 = 1.0;
/// First damping, and the bounds of it; beyond the upper one no step decreases the cost.
const DAMPING: (f64, f64, f64) = (1e-4, 1e-12, 1e12);
/// Damping grows where a step gains less than the first share of what was predicted and shrinks
/// where it gains more than the second; beyond the third the valley is flatter than predicted, and
/// longer steps are tried (Moré 1978).
const GAIN: (f64, f64, f64) = (0.25, 0.75, 1.3);
/// Longest step, as a multiple of the predicted one.
const LONGEST: f64 = 64.0;
/// Smallest eigenvalue of the information, scaled to a unit diagonal, at which the unknowns still
/// count as determined. Lenses correlate strongly (k1 with k2 and k3: about 1e-5); what the data
/// leave open altogether is at the level of rounding (1e-15 · number of equations).
const DETERMINED: f64 = 1e-11;

/// How much a large residual counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// ρ(s) = s: least squares.
    Square,
    /// ρ(s) = s below k², then 2k√s − k² (Huber 1964); k in standard deviations.
    Huber(f64),
    /// ρ(s) = k² ln(1 + s/k²): outliers lose nearly all weight; k in standard deviations.
    Cauchy(f64),
}

impl Loss {
    /// ρ(s) and its slope (the weight of the equation) for s = |r|².
    pub fn at(self, s: f64) -> (f64, f64) {
        match self {
            Loss::Square => (s, 1.0),
            Loss::Huber(k) if s <= k * k => (s, 1.0),
            Loss::Huber(k) => (2.0 * k * s.sqrt() - k * k, k / s.sqrt()),
            Loss::Cauchy(k) => (k * k * (s / (k * k)).ln_1p(), 1.0 / (1.0 + s / (k * k))),
        }
    }
}

/// An unknown that an equation depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// One of the shared unknowns.
    Shared(usize),
    /// One of the block's own.
    Own(usize),
}

/// Derivative of an equation's residual by one unknown.
pub type Column<const R: usize> = (Unknown, SVector<f64, R>);

/// A least-squares problem.
pub trait Problem {
    /// Values of all unknowns.
    type State: Clone;

    /// Number of shared unknowns.
    fn shared(&self) -> usize;
    /// Name of a shared unknown, for messages.
    fn name(&self, shared: usize) -> String;
    /// Distance to the minimum that is near enough, in standard deviations, where less than rounding allows is wanted.
    fn near_enough(&self) -> f64 {
        0.0
    }
    /// Most steps before the problem counts as one without a solution.
    fn most_steps(&self) -> usize {
        MAX_STEPS
    }
    /// Number of blocks.
    fn blocks(&self) -> usize;
    /// Number of own unknowns of a block.
    fn own(&self, block: usize) -> usize;
    /// Adds the equations of a block.
    fn equations(&self, state: &Self::State, block: usize, out: &mut NormalEquations);
    /// Adds equations in shared unknowns only (what was known before).
    fn prior(&self, _state: &Self::State, _out: &mut NormalEquations) {}
    /// The state after a step.
    fn moved(&self, state: &Self::State, shared: &DVector<f64>, own: &[DVector<f64>]) -> Self::State;
}

/// Normal equations of one block: Σ w·JᵀJ and Σ w·Jᵀr, split by shared (s) and own (o) unknowns.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    ss: DMatrix<f64>,
    so: DMatrix<f64>,
    oo: DMatrix<f64>,
    s: DVector<f64>,
    o: DVector<f64>,
    cost: f64,
    rows: usize,
    impossible: bool,
    cost_only: bool,
}

impl NormalEquations {
    fn new(shared: usize, own: usize, cost_only: bool) -> Self {
        let [s, o] = if cost_only { [0, 0] } else { [shared, own] };
        NormalEquations {
            ss: DMatrix::zeros(s, s),
            so: DMatrix::zeros(s, o),
            oo: DMatrix::zeros(o, o),
            s: DVector::zeros(s),
            o: DVector::zeros(o),
            cost: 0.0,
            rows: 0,
            impossible: false,
            cost_only,
        }
    }

    /// Adds one equation: a whitened residual and its derivatives.
    pub fn add<const R: usize>(&mut self, residual: &SVector<f64, R>, columns: &[Column<R>], loss: Loss) {
        let (cost, weight) = loss.at(residual.norm_squared());
        self.cost += cost;
        self.rows += R;
        if self.cost_only {
            return;
        }
        for (i, (a, slope_a)) in columns.iter().enumerate() {
            let pull = weight * slope_a.dot(residual);
            match *a {
                Unknown::Shared(a) => self.s[a] += pull,
                Unknown::Own(a) => self.o[a] += pull,
            }
            for (b, slope_b) in &columns[..=i] {
                self.add_product(*a, *b, weight * slope_a.dot(slope_b));
            }
        }
    }

    fn add_product(&mut self, a: Unknown, b: Unknown, product: f64) {
        match (a, b) {
            (Unknown::Shared(a), Unknown::Shared(b)) => {
                self.ss[(a, b)] += product;
                if a != b {
                    self.ss[(b, a)] += product;
                }
            }
            (Unknown::Own(a), Unknown::Own(b)) => {
                self.oo[(a, b)] += product;
                if a != b {
                    self.oo[(b, a)] += product;
                }
            }
            (Unknown::Shared(s), Unknown::Own(o)) | (Unknown::Own(o), Unknown::Shared(s)) => {
                self.so[(s, o)] += product;
            }
        }
    }

    /// True where only the cost is needed; derivatives are ignored.
    pub fn cost_only(&self) -> bool {
        self.cost_only
    }

    /// Marks the state as impossible (a point behind its camera), so the step to it is rejected.
    pub fn refuse(&mut self) {
        self.impossible = true;
    }

    fn cost(&self) -> f64 {
        if self.impossible { f64::INFINITY } else { self.cost }
    }
}

/// Why a problem has no solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// Fewer equations than unknowns.
    #[error("{equations} equations cannot determine {unknowns} unknowns")]
    TooFew {
        /// Rows.
        equations: usize,
        /// Shared and own.
        unknowns: usize,
    },
    /// The normal equations are singular.
    #[error("the data do not determine {unknown}: the views are too alike, or the geometry is degenerate")]
    Undetermined {
        /// The unknown that moves most along the direction that is open.
        unknown: String,
    },
    /// The initial value is impossible.
    #[error("the initial estimate puts points behind a camera")]
    Start,
    /// The iteration did not converge.
    #[error(
        "no convergence after {iterations} iterations (cost {cost:.4e}): the data hardly determine the \
         unknowns; add views that differ more, or leave terms out"
    )]
    Endless {
        /// Iterations made.
        iterations: usize,
        /// Cost where it stopped.
        cost: f64,
    },
}

/// The solution of a problem.
#[derive(Debug, Clone)]
pub struct Solution<S> {
    /// Values of all unknowns.
    pub state: S,
    /// Covariance of the shared unknowns for residuals of unit variance.
    pub covariance: DMatrix<f64>,
    /// Σ ρ.
    pub cost: f64,
    /// Equations less unknowns.
    pub freedom: usize,
    /// Iterations made.
    pub iterations: usize,
}

impl<S> Solution<S> {
    /// Standard deviation of the shared unknown `i` for residuals of unit variance.
    pub fn sigma(&self, i: usize) -> f64 {
        self.covariance[(i, i)].max(0.0).sqrt()
    }
}

/// Schur complement, right-hand side, the blocks.
type Reduced = (DMatrix<f64>, DVector<f64>, Vec<Eliminated>);

/// A step, and by how much it should lessen the cost.
struct Step {
    shared: DVector<f64>,
    own: Vec<DVector<f64>>,
    predicted: f64,
}

struct Assembled {
    common: NormalEquations,
    blocks: Vec<NormalEquations>,
}

impl Assembled {
    fn of<P: Problem>(problem: &P, state: &P::State) -> Self {
        let shared = problem.shared();
        let mut common = NormalEquations::new(shared, 0, false);
        problem.prior(state, &mut common);
        let blocks = (0..problem.blocks()).map(|b| {
            let mut equations = NormalEquations::new(shared, problem.own(b), false);
            problem.equations(state, b, &mut equations);
            equations
        });
        let mut blocks: Vec<NormalEquations> = blocks.collect();
        for block in &mut blocks {
            common.ss += &block.ss;
            common.s += &block.s;
            common.cost += block.cost;
            common.rows += block.rows;
            common.impossible |= block.impossible;
            // Only the sum is needed; hundreds of blocks would keep as many copies.
            block.ss = DMatrix::zeros(0, 0);
        }
        Assembled { common, blocks }
    }

    /// The step under damping: shared unknowns by the Schur complement, then each block's own.
    fn step(&self, damping: f64) -> Option<Step> {
        let (schur, right, eliminated) = self.reduced(damping)?;
        let shared = if schur.nrows() == 0 { right } else { schur.cholesky()?.solve(&right) };
        let own: Vec<DVector<f64>> = eliminated.iter().map(|block| block.step(&shared)).collect();
        // With (H + λD)·δ = −g the model gains −gᵀδ + λ·δᵀDδ.
        let gain = |equations: &DMatrix<f64>, gradient: &DVector<f64>, step: &DVector<f64>| {
            let along = step.iter().enumerate().map(|(i, s)| equations[(i, i)] * s * s).sum::<f64>();
            damping * along - gradient.dot(step)
        };
        let of_blocks = self.blocks.iter().zip(&own).map(|(b, step)| gain(&b.oo, &b.o, step));
        let predicted = of_blocks.sum::<f64>() + gain(&self.common.ss, &self.common.s, &shared);
        Some(Step { shared, own, predicted })
    }

    /// What the undamped step would gain: the square of the distance to the minimum in standard deviations, times the noise.
    fn left_to_gain(&self) -> Option<f64> {
        self.step(0.0).map(|step| step.predicted).filter(|gain| *gain >= 0.0)
    }

    /// Cost per degree of freedom.
    fn noise(&self, freedom: usize) -> f64 {
        self.common.cost / freedom.max(1) as f64
    }

    /// The system of the shared unknowns alone.
    fn reduced(&self, damping: f64) -> Option<Reduced> {
        let mut schur = damped(&self.common.ss, damping);
        let mut right = -&self.common.s;
        let mut eliminated = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let block = Eliminated::of(&damped(&block.oo, damping), &block.so, &block.o)?;
            block.reduce(&mut schur, &mut right);
            eliminated.push(block);
        }
        Some((schur, right, eliminated))
    }
}

/// Marquardt's damping: the diagonal grows by a share of itself, so that units do not matter.
fn damped(matrix: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut out = matrix.clone();
    for i in 0..out.nrows() {
        out[(i, i)] += damping * out[(i, i)] + f64::MIN_POSITIVE;
    }
    out
}

fn cost_of<P: Problem>(problem: &P, state: &P::State) -> f64 {
    let mut equations = NormalEquations::new(0, 0, true);
    problem.prior(state, &mut equations);
    for block in 0..problem.blocks() {
        problem.equations(state, block, &mut equations);
    }
    equations.cost()
}

/// Solves `problem` from `start`; `progress` is called with the iteration and the cost.
///
/// # Errors
/// Too few equations, parameters that the equations do not determine, or no convergence.
pub fn solve<P: Problem>(
    problem: &P,
    start: P::State,
    progress: &mut dyn FnMut(usize, f64),
) -> Result<Solution<P::State>, SolveError> {
    let (mut state, mut damping) = (start, DAMPING.0);
    let mut assembled = Assembled::of(problem, &state);
    if !assembled.common.cost().is_finite() {
        return Err(SolveError::Start);
    }
    let unknowns = problem.shared() + (0..problem.blocks()).map(|b| problem.own(b)).sum::<usize>();
    let equations = assembled.common.rows;
    if equations < unknowns {
        return Err(SolveError::TooFew { equations, unknowns });
    }
    let freedom = equations - unknowns;
    let near_enough = problem.near_enough();
    let mut flat = 0;
    for iteration in 0..problem.most_steps() {
        let cost = assembled.common.cost;
        progress(iteration, cost);
        let is_flat = near_enough > 0.0 && flat >= FLAT_STEPS;
        let near = if is_flat { FLAT_DISTANCE } else { DISTANCE_TOLERANCE.max(near_enough) };
        if assembled.left_to_gain().is_some_and(|gain| gain <= near.powi(2) * assembled.noise(freedom)) {
            return finish(problem, state, &assembled, freedom, iteration);
        }
        let Some(next) = descend(problem, &state, &assembled, &mut damping) else {
            return finish(problem, state, &assembled, freedom, iteration);
        };
        state = next;
        assembled = Assembled::of(problem, &state);
        let gained = cost - assembled.common.cost;
        flat = if gained < FLAT_GAIN * assembled.noise(freedom) { flat + 1 } else { 0 };
    }
    Err(SolveError::Endless { iterations: problem.most_steps(), cost: assembled.common.cost })
}

/// The next state that costs less; `None` where no step gains anything: at the minimum, to
/// rounding.
fn descend<P: Problem>(
    problem: &P,
    state: &P::State,
    assembled: &Assembled,
    damping: &mut f64,
) -> Option<P::State> {
    let cost = assembled.common.cost;
    while *damping < DAMPING.2 {
        if let Some(step) = assembled.step(*damping) {
            let next = problem.moved(state, &step.shared, &step.own);
            let gained = cost - cost_of(problem, &next);
            if gained.abs() <= COST_TOLERANCE * cost && step.predicted <= COST_TOLERANCE * cost {
                return None;
            }
            let share = gained / step.predicted;
            if share >= GAIN.2 {
                *damping = (*damping * 0.1).max(DAMPING.1);
                return Some(stretched(problem, state, &step, (next, cost - gained)));
            }
            match share {
                s if s > GAIN.1 => *damping = (*damping * 0.1).max(DAMPING.1),
                s if s < GAIN.0 || s.is_nan() => *damping *= 10.0,
                _ => {}
            }
            if gained > 0.0 {
                return Some(next);
            }
            continue;
        }
        *damping *= 10.0;
    }
    None
}

/// The best of ever longer steps, given the state and the cost after the plain one.
fn stretched<P: Problem>(
    problem: &P,
    state: &P::State,
    step: &Step,
    (mut best, mut least): (P::State, f64),
) -> P::State {
    let mut times = 2.0;
    while times <= LONGEST {
        let own: Vec<DVector<f64>> = step.own.iter().map(|o| o * times).collect();
        let next = problem.moved(state, &(&step.shared * times), &own);
        let cost = cost_of(problem, &next);
        if cost.is_nan() || cost >= least {
            break;
        }
        (best, least) = (next, cost);
        times *= 2.0;
    }
    best
}

fn finish<P: Problem>(
    problem: &P,
    state: P::State,
    assembled: &Assembled,
    freedom: usize,
    iterations: usize,
) -> Result<Solution<P::State>, SolveError> {
    let weak = |what: String| SolveError::Undetermined { unknown: what };
    let blocks_fixed = assembled.blocks.iter().all(|b| b.oo.nrows() == 0 || smallest(&b.oo).0 > DETERMINED);
    if !blocks_fixed {
        return Err(weak("the pose of a view".into()));
    }
    let (schur, ..) = assembled.reduced(0.0).ok_or_else(|| weak("the pose of a view".into()))?;
    if schur.nrows() == 0 {
        return Ok(Solution { state, covariance: schur, cost: assembled.common.cost, freedom, iterations });
    }
    // Scaled by what each unknown would be known if all others were: what elimination leaves of it.
    let full: Vec<f64> = assembled.common.ss.diagonal().iter().copied().collect();
    let (value, worst) = smallest_scaled(&schur, &full);
    if value < DETERMINED {
        return Err(weak(problem.name(worst)));
    }
    let covariance = schur.cholesky().ok_or_else(|| weak(problem.name(worst)))?.inverse();
    Ok(Solution { state, covariance, cost: assembled.common.cost, freedom, iterations })
}

fn smallest(matrix: &DMatrix<f64>) -> (f64, usize) {
    let diagonal: Vec<f64> = matrix.diagonal().iter().copied().collect();
    smallest_scaled(matrix, &diagonal)
}

/// Smallest eigenvalue of the matrix scaled by `diagonal`, and the unknown that moves most along
/// its vector.
fn smallest_scaled(matrix: &DMatrix<f64>, diagonal: &[f64]) -> (f64, usize) {
    if let Some(zero) = diagonal.iter().position(|d| *d <= 0.0 || d.is_nan()) {
        return (0.0, zero);
    }
    let scaled = matrix.map_with_location(|r, c, v| v / (diagonal[r] * diagonal[c]).sqrt());
    let eigen = scaled.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    (eigen.eigenvalues[least], eigen.eigenvectors.column(least).iamax())
}

#[cfg(test)]
mod tests;
