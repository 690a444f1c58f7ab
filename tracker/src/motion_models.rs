//! Linear motion models of one coordinate, each with its transition over a time and the process
//! noise accumulated in it.
//!
//! - [`VoluntaryMotion`]: position, velocity, acceleration and its rate; the acceleration is white
//!   noise through a critically damped second-order lag. Its spectrum falls as that of a voluntary
//!   movement does (as f⁻⁴ above 1/2πτ; Singer's falls as f⁻²).
//! - [`Oscillator`]: a stationary, lightly damped oscillator driven by white noise: a line of the
//!   tremor's spectrum; with more damping, the play of a shaft in its trocar.
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

/// A voluntary movement: x' = v, v' = a, a'' = −a/τ² − 2a'/τ + noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoluntaryMotion {
    /// Standard deviation of the acceleration, mm/s².
    pub sigma: f64,
    /// Time constant of the lag, s.
    pub tau_s: f64,
}

impl VoluntaryMotion {
    /// Transition over `dt` seconds of (x, v, a, a'); only the upper triangle and the lower right
    /// block differ from zero.
    pub fn transition(&self, dt: f64) -> [[f64; 4]; 4] {
        let t = self.tau_s;
        let e = libm::exp(-dt / t);
        let (t2, t3) = (t * t, t * t * t);
        let x_a = 2.0 * t * dt - 3.0 * t2 + e * (3.0 * t2 + t * dt);
        let x_j = t2 * dt - 2.0 * t3 + e * (2.0 * t3 + t2 * dt);
        let v_a = 2.0 * t - e * (2.0 * t + dt);
        let v_j = t2 - e * (t2 + t * dt);
        [
            [1.0, dt, x_a, x_j],
            [0.0, 1.0, v_a, v_j],
            [0.0, 0.0, e * (1.0 + dt / t), e * dt],
            [0.0, 0.0, -e * dt / t2, e * (1.0 - dt / t)],
        ]
    }

    /// Covariance of the process noise over `dt`, to the leading order in dt/τ: white noise of
    /// density 4σ²/τ³ on a', integrated. `dt` must be well below τ.
    pub fn noise(&self, dt: f64) -> [[f64; 4]; 4] {
        let q = 4.0 * self.sigma * self.sigma / (self.tau_s * self.tau_s * self.tau_s);
        // ∫ φᵢ·φⱼ with φ = (s³/6, s²/2, s, 1).
        let factor = [6.0, 2.0, 1.0, 1.0];
        let mut noise = [[0.0; 4]; 4];
        let mut powers = [dt; 7];
        for n in 1..7 {
            powers[n] = powers[n - 1] * dt;
        }
        for (r, row) in noise.iter_mut().enumerate() {
            for (c, cell) in row.iter_mut().enumerate() {
                let n = 6 - r - c;
                *cell = q * powers[n] / ((n + 1) as f64 * factor[r] * factor[c]);
            }
        }
        noise
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
    use nalgebra::{Matrix2, Matrix4};
    use proptest::prelude::*;

    const SINGER: Singer = Singer { sigma: 200.0, tau_s: 0.05 };
    const VOLUNTARY: VoluntaryMotion = VoluntaryMotion { sigma: 15.0, tau_s: 0.2 };

    fn matrix(m: [[f64; 4]; 4]) -> Matrix4<f64> {
        Matrix4::from_fn(|r, c| m[r][c])
    }

    /// The transition by its series, from the differential equation alone.
    fn exponential(f: &Matrix4<f64>) -> Matrix4<f64> {
        let (mut sum, mut term) = (Matrix4::identity(), Matrix4::identity());
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
            let (t, mut f) = (VOLUNTARY.tau_s, Matrix4::zeros());
            (f[(0, 1)], f[(1, 2)], f[(2, 3)]) = (1.0, 1.0, 1.0);
            (f[(3, 2)], f[(3, 3)]) = (-1.0 / (t * t), -2.0 / t);
            prop_assert!((matrix(VOLUNTARY.transition(dt)) - exponential(&(f * dt))).norm() < 1e-9);
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
            let (half, whole) = (matrix(VOLUNTARY.noise(dt)), matrix(VOLUNTARY.noise(2.0 * dt)));
            let step = matrix(VOLUNTARY.transition(dt));
            let sum = step * half * step.transpose() + half;
            prop_assert!((sum - whole).norm() < 0.2 * whole.norm(), "leading order only");
        }
    }
}
