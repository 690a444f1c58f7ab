//! Linear motion models of one coordinate, each with its transition over a time and the process
//! noise accumulated in it.
//!
//! - [`VoluntaryMotion`]: position, velocity, and an acceleration that is white noise through five
//!   lags in a row. Its spectrum falls as that of a voluntary movement does (as f⁻¹⁰ above 1/2πτ;
//!   Singer's falls as f⁻²). The tremor's is in [`crate::tremor_bank`].
//! - [`Oscillator`]: a stationary, damped oscillator driven by white noise: a line of the spectrum of
//!   the roll's tremor; with more damping, the play of a shaft in its trocar.
//! - [`Singer`]: an acceleration as white noise through a first-order lag (Singer 1970).

/// Singer model: x' = v, v' = a, a' = −a/τ + noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Singer {
    /// Standard deviation of the acceleration, mm/s² or rad/s².
    pub sigma: f64,
    /// Time constant, s.
    pub tau_s: f64,
}

impl Singer {
    /// Transition over `dt` seconds of (x, v, a).
    pub(crate) fn transition(&self, dt: f64) -> [[f64; 3]; 3] {
        let e = libm::exp(-dt / self.tau_s);
        let g = self.tau_s * (1.0 - e);
        [[1.0, dt, self.tau_s * (dt - g)], [0.0, 1.0, g], [0.0, 0.0, e]]
    }

    /// Covariance of the process noise over `dt`. Below τ/20 the leading terms are used, because
    /// the closed form cancels.
    pub(crate) fn noise(&self, dt: f64) -> [[f64; 3]; 3] {
        let [q11, q12, q13, q22, q23, q33] = self.noise_terms(dt);
        [[q11, q12, q13], [q12, q22, q23], [q13, q23, q33]]
    }

    fn noise_terms(&self, dt: f64) -> [f64; 6] {
        let (s2, b) = (self.sigma * self.sigma, 1.0 / self.tau_s);
        let t = b * dt;
        if t < 0.05 {
            let q = 2.0 * b * s2 * dt;
            let d2 = dt * dt;
            return [q * d2 * d2 / 20.0, q * d2 * dt / 8.0, q * d2 / 6.0, q * d2 / 3.0, q * dt / 2.0, q];
        }
        let (e1, e2) = (libm::exp(-t), libm::exp(-2.0 * t));
        let q11 = 1.0 - e2 + 2.0 * t + 2.0 * t * t * t / 3.0 - 2.0 * t * t - 4.0 * t * e1;
        let q12 = e2 + 1.0 - 2.0 * e1 + 2.0 * t * e1 - 2.0 * t + t * t;
        let q13 = 1.0 - e2 - 2.0 * t * e1;
        let q22 = 4.0 * e1 - 3.0 - e2 + 2.0 * t;
        let q23 = e2 + 1.0 - 2.0 * e1;
        let q33 = 1.0 - e2;
        let (b2, b3) = (b * b, b * b * b);
        [q11 * s2 / (b2 * b2), q12 * s2 / b3, q13 * s2 / b2, q22 * s2 / b2, q23 * s2 / b, q33 * s2]
    }
}

/// Lags of the voluntary acceleration.
pub const LAGS: usize = 5;
/// States of a voluntary movement: displacement, velocity, acceleration and what drives each lag.
pub const VOLUNTARY: usize = 2 + LAGS;

/// A voluntary movement: x' = v, v' = a, and a is white noise through first-order lags in a row: a' = (b − a)/τ, b' = (c −
/// b)/τ, and so on; the last is −e/τ + noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoluntaryMotion {
    /// Standard deviation of the acceleration, mm/s².
    pub sigma: f64,
    /// Time constant of each lag, s.
    pub tau_s: f64,
}

impl VoluntaryMotion {
    /// Variance of what leaves each lag over that of the acceleration, the first's, where the noise is stationary:
    /// ∫ dω/(1 + ω²τ²)ⁿ, which falls from n to n + 1 by (2n − 1)/2n.
    pub const LAG_VARIANCES: [f64; LAGS] = {
        let mut ratios = [1.0; LAGS];
        let mut lag = 1;
        while lag < LAGS {
            let n = (LAGS - lag) as f64;
            ratios[lag] = ratios[lag - 1] * 2.0 * n / (2.0 * n - 1.0);
            lag += 1;
        }
        ratios
    };

    /// Transition over `dt` seconds (either way) of the states; zero below the diagonal.
    pub fn transition(&self, dt: f64) -> [[f64; VOLUNTARY]; VOLUNTARY] {
        let (tau, s) = (self.tau_s, dt / self.tau_s);
        let mut lag = [libm::exp(-s); LAGS];
        for n in 1..LAGS {
            lag[n] = lag[n - 1] * s / n as f64;
        }
        let mut f = [[0.0; VOLUNTARY]; VOLUNTARY];
        (f[0][0], f[0][1], f[1][1]) = (1.0, dt, 1.0);
        // ∫ of the lags, and of that again.
        let (mut left, mut left_again) = (1.0, s);
        for n in 0..LAGS {
            left -= lag[n];
            left_again -= left;
            (f[1][2 + n], f[0][2 + n]) = (tau * left, tau * tau * left_again);
            for row in 0..LAGS - n {
                f[2 + row][2 + row + n] = lag[n];
            }
        }
        f
    }

    /// Covariance of the process noise over `dt`, to the leading order in dt/τ: white noise of density 2σ²/τ times the last of
    /// [`VoluntaryMotion::LAG_VARIANCES`] on the last lag, integrated. `dt` must be well below τ.
    pub fn noise(&self, dt: f64) -> [[f64; VOLUNTARY]; VOLUNTARY] {
        let q = 2.0 * Self::LAG_VARIANCES[LAGS - 1] * self.sigma * self.sigma / self.tau_s;
        // ∫ φᵢ·φⱼ with φ = (…, s³/6τ³, s²/2τ², s/τ, 1), of velocity and displacement without their 1/τ.
        let mut factor = [1.0; VOLUNTARY];
        for n in (0..VOLUNTARY - 1).rev() {
            let order = (VOLUNTARY - 1 - n) as f64;
            factor[n] = factor[n + 1] * order * if n < 2 { 1.0 } else { self.tau_s };
        }
        let mut powers = [dt; 2 * VOLUNTARY - 1];
        for n in 1..powers.len() {
            powers[n] = powers[n - 1] * dt;
        }
        std::array::from_fn(|r| {
            std::array::from_fn(|c| {
                let n = 2 * (VOLUNTARY - 1) - r - c;
                q * powers[n] / ((n + 1) as f64 * factor[r] * factor[c])
            })
        })
    }
}

/// Damped oscillator: x'' + 2ζωx' + ω²x = noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Oscillator {
    /// ω, rad/s.
    pub omega: f64,
    /// ζ, below 1.
    pub damping: f64,
}

impl Oscillator {
    /// Transition over `dt` seconds (either way) of (x, x').
    pub fn transition(&self, dt: f64) -> [[f64; 2]; 2] {
        let (w, z) = (self.omega, self.damping);
        let wd = w * libm::sqrt(1.0 - z * z);
        let (sin, cos, decay) = (libm::sin(wd * dt), libm::cos(wd * dt), libm::exp(-z * w * dt));
        let ratio = z * w / wd * sin;
        [[decay * (cos + ratio), decay * sin / wd], [-decay * sin * w * w / wd, decay * (cos - ratio)]]
    }

    /// Covariance of the process noise over the transition `f`, for a stationary displacement of
    /// variance `variance`: Σ − F·Σ·Fᵀ with Σ = diag(1, ω²)·variance.
    pub fn noise(&self, f: &[[f64; 2]; 2], variance: f64) -> [[f64; 2]; 2] {
        let w2 = self.omega * self.omega;
        let product = |r: usize, c: usize| f[r][0] * f[c][0] + w2 * f[r][1] * f[c][1];
        let cross = -variance * product(0, 1);
        [[variance * (1.0 - product(0, 0)), cross], [cross, variance * (w2 - product(1, 1))]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, SMatrix};
    use proptest::prelude::*;

    const SINGER: Singer = Singer { sigma: 200.0, tau_s: 0.05 };
    type States = SMatrix<f64, VOLUNTARY, VOLUNTARY>;

    const MOVEMENT: VoluntaryMotion = VoluntaryMotion { sigma: 15.0, tau_s: 0.4 };

    fn matrix(m: [[f64; VOLUNTARY]; VOLUNTARY]) -> States {
        States::from_fn(|r, c| m[r][c])
    }

    /// The transition by its series, from the differential equation alone.
    fn exponential(f: &States) -> States {
        let (mut sum, mut term) = (States::identity(), States::identity());
        for n in 1..40 {
            term = term * f / f64::from(n);
            sum += term;
        }
        sum
    }

    #[test]
    fn short_noise_joins_the_closed_form() {
        let (below, above) = (SINGER.noise(0.002_499_99), SINGER.noise(0.002_500_01));
        for (a, b) in below.into_iter().flatten().zip(above.into_iter().flatten()) {
            assert!((a / b - 1.0).abs() < 0.06, "{a} {b}");
        }
    }

    proptest! {
        #[test]
        fn voluntary_transition_solves_its_equation(dt in -0.1..0.2f64) {
            let (t, mut f) = (MOVEMENT.tau_s, States::zeros());
            (f[(0, 1)], f[(1, 2)]) = (1.0, 1.0);
            for lag in 2..VOLUNTARY {
                f[(lag, lag)] = -1.0 / t;
                if lag + 1 < VOLUNTARY {
                    f[(lag, lag + 1)] = 1.0 / t;
                }
            }
            prop_assert!((matrix(MOVEMENT.transition(dt)) - exponential(&(f * dt))).norm() < 1e-9);
        }

        #[test]
        fn oscillator_solves_its_equation(dt in -0.1..0.1f64, hz in 0.3..14.0f64, damping in 0.01..0.9f64) {
            let o = Oscillator { omega: hz * std::f64::consts::TAU, damping };
            let f = |dt: f64| { let m = o.transition(dt); Matrix2::new(m[0][0], m[0][1], m[1][0], m[1][1]) };
            let equation = Matrix2::new(0.0, 1.0, -o.omega * o.omega, -2.0 * damping * o.omega);
            let slope = (f(dt + 1e-6) - f(dt - 1e-6)) / 2e-6;
            prop_assert!((slope - equation * f(dt)).norm() < 1e-4 * (1.0 + o.omega * o.omega));
            prop_assert!((f(0.0) - Matrix2::identity()).norm() < 1e-12);
        }

        #[test]
        fn process_noise_adds_up(dt in 0.001..0.01f64, hz in 0.3..14.0f64) {
            let o = Oscillator { omega: hz * std::f64::consts::TAU, damping: 0.05 };
            let (f, twice) = (o.transition(dt), o.transition(2.0 * dt));
            let m = |m: [[f64; 2]; 2]| Matrix2::new(m[0][0], m[0][1], m[1][0], m[1][1]);
            let (once, both) = (m(o.noise(&f, 0.01)), m(o.noise(&twice, 0.01)));
            let sum = m(f) * once * m(f).transpose() + once;
            prop_assert!((sum - both).norm() < 1e-9 * (1.0 + both.norm()));
            let (half, whole) = (matrix(MOVEMENT.noise(dt)), matrix(MOVEMENT.noise(2.0 * dt)));
            let step = matrix(MOVEMENT.transition(dt));
            let sum = step * half * step.transpose() + half;
            prop_assert!((sum - whole).norm() < 0.2 * whole.norm(), "leading order only");
        }

        /// A stationary acceleration keeps the variances that its noise gives it: Σ = F·Σ·Fᵀ + Q.
        #[test]
        fn voluntary_noise_keeps_the_stationary_acceleration(dt in 0.0005..0.004f64) {
            let (f, q) = (MOVEMENT.transition(dt), MOVEMENT.noise(dt));
            let mut p = States::zeros();
            for n in 0..LAGS {
                p[(2 + n, 2 + n)] = 1.0;
            }
            let (f, q) = (matrix(f), matrix(q));
            for _ in 0..12_000 {
                p = f * p * f.transpose() + q;
                p.fixed_view_mut::<2, VOLUNTARY>(0, 0).fill(0.0);
                p.fixed_view_mut::<VOLUNTARY, 2>(0, 0).fill(0.0);
            }
            let variance = MOVEMENT.sigma * MOVEMENT.sigma;
            for (n, expected) in VoluntaryMotion::LAG_VARIANCES.into_iter().enumerate() {
                let ratio = p[(2 + n, 2 + n)] / (variance * expected);
                prop_assert!((ratio - 1.0).abs() < 0.03, "state {}: {}", n, ratio);
            }
        }
    }
}
