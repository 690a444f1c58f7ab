//! Moves nodes through a step of any [`Elastic`] thing.
//!
//! With θ = 1 (implicit: backward Euler) or θ = ½ (midpoint) a step solves for Δv
//!
//! ```text
//! v_θ = v₀ + θ Δv,  x_θ = x₀ + θ dt v_θ
//! M Δv = dt (f(x_θ, v_θ) + outer − g M v_θ)
//! x₁ = x₀ + dt v_θ,  v₁ = v₀ + Δv
//! ```
//!
//! by Newton's method, each correction from (M (1 + θ dt g) + θ dt C + θ² dt² K) d = residual by
//! conjugate gradients. One correction is the linearised step of Baraff and Witkin (SIGGRAPH 1998).
//! Backward Euler is stable at any step and loses energy; midpoint keeps linear and angular
//! momentum and, for linear forces, energy. g is the damping by the fluid, 1/s.
//!
//! Quasi-static: the minimum of U(x) − outer·x by Levenberg's method, (K + μ M) d = residual, μ
//! from 1/dt² down tenfold after each success and up after each failure; velocities become 0.

use super::conjugate::{Conjugate, Limits, dot};
use super::{Elastic, Nodes, Point};

/// How a step is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// The old velocity moves the nodes: grows by dt²ω² in energy each step.
    Explicit,
    /// The new velocity moves them; stable while dt·ω < 2.
    SemiImplicit,
    /// Backward Euler.
    Implicit,
    /// Implicit midpoint.
    Midpoint,
    /// Where all forces balance.
    QuasiStatic,
}

/// How hard a step tries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Newton corrections at most; 1 is the linearised step.
    pub newton: u32,
    /// They end when the residual has fallen to this share of the first one.
    pub share: f64,
    /// Conjugate gradients of each correction.
    pub conjugate: Limits,
}

/// What a step took.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Effort {
    /// Newton corrections tried.
    pub newton: u32,
    /// Iterations of conjugate gradients in all of them.
    pub conjugate: u32,
    /// Residual after the last one that was looked at, as a share of the first.
    pub residual: f64,
}

/// Largest μ over its start before a quasi-static step gives up.
const MU_CEILING: f64 = 1e12;

/// The integrator with its arrays.
#[derive(Debug, Clone, Default)]
pub struct Integrator {
    /// Imbalance that is no more than rounding of the positions a step is given, µN: a quasi-static
    /// step leaves that alone.
    pub floor_un: f64,
    conjugate: Conjugate,
    force: Vec<Point>,
    change: Vec<Point>,
    x: Vec<Point>,
    v: Vec<Point>,
}

impl Integrator {
    /// One step of `dt_s` with the fluid's damping `fluid_per_s`.
    pub fn step(
        &mut self,
        nodes: &mut Nodes,
        elastic: &mut impl Elastic,
        rule: Rule,
        settings: &Settings,
        [dt_s, fluid_per_s]: [f64; 2],
    ) -> Effort {
        self.resize(nodes.x_mm.len());
        match rule {
            Rule::Explicit | Rule::SemiImplicit => {
                self.march(nodes, elastic, rule, [dt_s, fluid_per_s]);
                Effort::default()
            }
            Rule::Implicit => self.newton(nodes, elastic, settings, [dt_s, fluid_per_s, 1.0]),
            Rule::Midpoint => self.newton(nodes, elastic, settings, [dt_s, fluid_per_s, 0.5]),
            Rule::QuasiStatic => self.settle(nodes, elastic, settings, dt_s),
        }
    }

    fn resize(&mut self, n: usize) {
        for array in [&mut self.force, &mut self.change, &mut self.x, &mut self.v] {
            array.resize(n, Point::zeros());
        }
    }

    fn march(&mut self, nodes: &mut Nodes, elastic: &impl Elastic, rule: Rule, [dt, fluid]: [f64; 2]) {
        self.force.copy_from_slice(&nodes.outer_un);
        elastic.add_forces(&nodes.x_mm, &nodes.v_mm_s, &mut self.force);
        for i in 0..nodes.x_mm.len() {
            if nodes.held[i] {
                continue;
            }
            let before = nodes.v_mm_s[i];
            let after = before + (self.force[i] / nodes.mass_g[i] - before * fluid) * dt;
            nodes.v_mm_s[i] = after;
            nodes.x_mm[i] += if rule == Rule::Explicit { before } else { after } * dt;
        }
    }

    fn newton(
        &mut self,
        nodes: &mut Nodes,
        elastic: &mut impl Elastic,
        settings: &Settings,
        [dt, fluid, theta]: [f64; 3],
    ) -> Effort {
        let mut effort = Effort { residual: 1.0, ..Effort::default() };
        let mut first = 0.0;
        self.change.fill(Point::zeros());
        for newton in 0..settings.newton {
            let size = self.residual(nodes, elastic, [dt, fluid, theta]);
            first = if newton == 0 { size } else { first };
            effort.residual = if first > 0.0 { size / first } else { 0.0 };
            if effort.residual.is_nan() || effort.residual <= settings.share {
                break;
            }
            elastic.linearise(&self.x);
            let mass = &nodes.mass_g;
            let limits = settings.conjugate;
            let product = |p: &[Point], out: &mut [Point]| {
                elastic.add_product(theta * theta * dt * dt, theta * dt, p, out);
                for i in 0..p.len() {
                    out[i] += p[i] * (mass[i] * (1.0 + theta * dt * fluid));
                }
            };
            effort.conjugate += self.conjugate.solve(&self.force, mass, &nodes.held, limits, product);
            effort.newton += 1;
            self.change.iter_mut().zip(&self.conjugate.solution).for_each(|(c, d)| *c += d);
        }
        for i in 0..nodes.x_mm.len() {
            if !nodes.held[i] {
                let way = nodes.v_mm_s[i] + self.change[i] * theta;
                nodes.x_mm[i] += way * dt;
                nodes.v_mm_s[i] += self.change[i];
            }
        }
        effort
    }

    /// Leaves dt (f + outer − g M v_θ) − M Δv in `force`, x_θ in `x`; returns its norm.
    fn residual(&mut self, nodes: &Nodes, elastic: &impl Elastic, [dt, fluid, theta]: [f64; 3]) -> f64 {
        for i in 0..nodes.x_mm.len() {
            self.v[i] = nodes.v_mm_s[i] + self.change[i] * theta;
            let way = if nodes.held[i] { Point::zeros() } else { self.v[i] * (theta * dt) };
            self.x[i] = nodes.x_mm[i] + way;
        }
        self.force.copy_from_slice(&nodes.outer_un);
        elastic.add_forces(&self.x, &self.v, &mut self.force);
        let mut size = 0.0;
        for i in 0..nodes.x_mm.len() {
            let mass = nodes.mass_g[i];
            self.force[i] = if nodes.held[i] {
                Point::zeros()
            } else {
                (self.force[i] - self.v[i] * (fluid * mass)) * dt - self.change[i] * mass
            };
            size += self.force[i].norm_squared() / mass;
        }
        size.sqrt()
    }

    fn settle(
        &mut self,
        nodes: &mut Nodes,
        elastic: &mut impl Elastic,
        settings: &Settings,
        dt: f64,
    ) -> Effort {
        let mut effort = Effort { residual: 1.0, ..Effort::default() };
        let start = 1.0 / (dt * dt);
        let (mut mu, mut first) = (start, 0.0);
        let mut potential = elastic.energy_nj(&nodes.x_mm) - dot(&nodes.outer_un, &nodes.x_mm);
        self.v.fill(Point::zeros());
        let mut stale = true;
        while effort.newton < settings.newton && mu < start * MU_CEILING {
            if stale {
                let size = self.imbalance(nodes, elastic);
                first = if effort.newton == 0 { size } else { first };
                effort.residual = if first > 0.0 { size / first } else { 0.0 };
                let floor = if effort.newton == 0 { self.floor_un } else { 0.0 };
                let balanced = effort.residual <= settings.share || size <= floor;
                if effort.residual.is_nan() || balanced {
                    break;
                }
                elastic.linearise(&nodes.x_mm);
            }
            let mass = &nodes.mass_g;
            let product = |p: &[Point], out: &mut [Point]| {
                elastic.add_product(1.0, 0.0, p, out);
                (0..p.len()).for_each(|i| out[i] += p[i] * (mass[i] * mu));
            };
            effort.conjugate +=
                self.conjugate.solve(&self.force, mass, &nodes.held, settings.conjugate, product);
            effort.newton += 1;
            let moved = nodes.x_mm.iter().zip(&self.conjugate.solution).map(|(x, d)| x + d);
            self.x.iter_mut().zip(moved).for_each(|(x, m)| *x = m);
            let now = elastic.energy_nj(&self.x) - dot(&nodes.outer_un, &self.x);
            // Close to the minimum, differences drown in rounding; the residual then decides.
            stale = now <= potential + potential.abs() * 1e-13;
            mu *= if stale { 0.1 } else { 10.0 };
            if stale {
                potential = now;
                std::mem::swap(&mut nodes.x_mm, &mut self.x);
            }
        }
        for (v, held) in nodes.v_mm_s.iter_mut().zip(&nodes.held) {
            *v = if *held { *v } else { Point::zeros() };
        }
        effort
    }

    /// Leaves the forces on free nodes in `force`; returns their norm, µN.
    fn imbalance(&mut self, nodes: &Nodes, elastic: &impl Elastic) -> f64 {
        self.force.copy_from_slice(&nodes.outer_un);
        elastic.add_forces(&nodes.x_mm, &self.v, &mut self.force);
        let free = self.force.iter().zip(&nodes.held).filter(|(_, held)| !**held);
        free.map(|(f, _)| f.norm_squared()).sum::<f64>().sqrt()
    }
}

/// Forces on every node at its present position and velocity, outer ones included, µN. On a held
/// node it is what whoever holds it must resist.
pub fn forces_un(nodes: &Nodes, elastic: &impl Elastic, out: &mut Vec<Point>) {
    out.clear();
    out.extend_from_slice(&nodes.outer_un);
    elastic.add_forces(&nodes.x_mm, &nodes.v_mm_s, out);
}

#[cfg(test)]
mod tests {
    use super::super::springs::{Spring, Springs};
    use super::*;

    const TIGHT: Settings =
        Settings { newton: 30, share: 1e-13, conjugate: Limits { iterations: 300, share: 1e-12 } };

    impl Nodes {
        /// Momentum, g·mm/s.
        fn momentum(&self) -> Point {
            self.mass_g.iter().zip(&self.v_mm_s).map(|(&m, v)| v * m).sum()
        }

        /// Angular momentum about the origin, g·mm²/s.
        fn angular_momentum(&self) -> Point {
            let all = self.mass_g.iter().zip(&self.x_mm).zip(&self.v_mm_s);
            all.map(|((&m, x), v)| x.cross(v) * m).sum()
        }

        /// Kinetic energy, nJ.
        fn kinetic_nj(&self) -> f64 {
            self.mass_g.iter().zip(&self.v_mm_s).map(|(&m, v)| 0.5 * m * v.norm_squared()).sum()
        }
    }

    /// A mass on a spring of rest length 10 along x; ω² = 100.
    fn oscillator(damping: f64) -> (Nodes, Springs) {
        let mut nodes = Nodes::at_rest(vec![Point::zeros(), Point::new(10.1, 0.0, 0.0)], 0.5);
        nodes.held[0] = true;
        let spring =
            Spring { ends: [0, 1], stiffness_un_per_mm: 50.0, damping_un_s_per_mm: damping, rest_mm: 10.0 };
        (nodes, Springs::new(vec![spring]))
    }

    /// Free springs thrown about.
    fn thrown() -> (Nodes, Springs) {
        let x = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.3, 0.9, 0.2], [0.5, 0.4, 1.1]];
        let mut nodes = Nodes::at_rest(x.map(Point::from).to_vec(), 1.0);
        nodes.mass_g = vec![1.0, 0.4, 2.5, 0.7];
        for (i, v) in nodes.v_mm_s.iter_mut().enumerate() {
            *v = Point::new(0.3 * i as f64 - 0.2, 0.5 - 0.4 * i as f64, 0.1 * i as f64);
        }
        let spring = |a, b| Spring {
            ends: [a, b],
            stiffness_un_per_mm: 40.0,
            damping_un_s_per_mm: 0.05,
            rest_mm: 1.0,
        };
        let pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
        (nodes, Springs::new(pairs.map(|(a, b)| spring(a, b)).to_vec()))
    }

    fn run(rule: Rule, steps: u32, dt: f64, nodes: &mut Nodes, springs: &mut Springs) {
        let mut integrator = Integrator::default();
        for _ in 0..steps {
            integrator.step(nodes, springs, rule, &TIGHT, [dt, 0.0]);
        }
    }

    /// Closed forms of one step on an oscillator: backward Euler divides the energy by 1 + (ω dt)²,
    /// explicit Euler multiplies it, midpoint keeps it.
    #[test]
    fn energy_of_an_oscillator_follows_the_closed_forms() {
        let (dt, wh2): (f64, f64) = (0.02, 0.04);
        for (rule, expected) in [
            (Rule::Implicit, (1.0 + wh2).powi(-10)),
            (Rule::Explicit, (1.0 + wh2).powi(10)),
            (Rule::Midpoint, 1.0),
        ] {
            let (mut nodes, mut springs) = oscillator(0.0);
            let energy = |n: &Nodes, s: &Springs| n.kinetic_nj() + s.energy_nj(&n.x_mm);
            let before = energy(&nodes, &springs);
            run(rule, 10, dt, &mut nodes, &mut springs);
            let share = energy(&nodes, &springs) / before;
            assert!((share / expected - 1.0).abs() < 1e-6, "{rule:?}: {share} {expected}");
        }
    }

    #[test]
    fn backward_euler_is_stable_at_any_step() {
        let (mut nodes, mut springs) = oscillator(0.0);
        run(Rule::Implicit, 50, 10.0, &mut nodes, &mut springs);
        assert!((nodes.x_mm[1].x - 10.0).abs() < 1e-6 && nodes.v_mm_s[1].norm() < 1e-6);
    }

    #[test]
    fn momentum_is_kept_to_rounding() {
        for rule in [Rule::Explicit, Rule::SemiImplicit, Rule::Implicit, Rule::Midpoint] {
            let (mut nodes, mut springs) = thrown();
            let (p, l) = (nodes.momentum(), nodes.angular_momentum());
            run(rule, 200, 0.01, &mut nodes, &mut springs);
            assert!((nodes.momentum() - p).norm() < 1e-12, "{rule:?}");
            let turned = (nodes.angular_momentum() - l).norm() / l.norm();
            // Both Euler methods turn what moves across itself: dt v₀ × v₁ each step.
            if matches!(rule, Rule::SemiImplicit | Rule::Midpoint) {
                assert!(turned < 1e-11, "{rule:?}: {turned}");
            }
        }
    }

    /// However early the solver gives up, a linearised step keeps the momentum.
    #[test]
    fn an_unfinished_solve_keeps_momentum() {
        let (mut nodes, mut springs) = thrown();
        let p = nodes.momentum();
        let settings = Settings { newton: 1, share: 0.0, conjugate: Limits { iterations: 2, share: 0.0 } };
        for _ in 0..100 {
            let one = [0.05, 0.0];
            Integrator::default().step(&mut nodes, &mut springs, Rule::Implicit, &settings, one);
        }
        assert!((nodes.momentum() - p).norm() < 1e-12);
    }

    #[test]
    fn quasi_static_finds_the_balance_and_the_force_that_holds_it() {
        let (mut nodes, mut springs) = oscillator(0.0);
        nodes.outer_un[1] = Point::new(0.0, 25.0, 0.0);
        run(Rule::QuasiStatic, 1, 1.0, &mut nodes, &mut springs);
        // A pendulum: the spring turns into the force and lengthens by 25/50.
        assert!((nodes.x_mm[1] - Point::new(0.0, 10.5, 0.0)).norm() < 1e-6, "{}", nodes.x_mm[1]);
        let mut held = Vec::new();
        forces_un(&nodes, &springs, &mut held);
        assert!((held[0] - Point::new(0.0, 25.0, 0.0)).norm() < 1e-5);
    }

    #[test]
    fn damping_by_fluid_and_springs_converges_to_the_closed_form() {
        // x'' + (c/m + g) x' + ω² x = 0
        let (fluid, half) = (1.0, 0.5 * (0.4 / 0.5 + 1.0));
        let w = libm::sqrt(100.0 - half * half);
        let t = 0.5;
        let expected = 0.1 * libm::exp(-half * t) * (libm::cos(w * t) + half / w * libm::sin(w * t));
        let error = |steps: u32| {
            let (mut nodes, mut springs) = oscillator(0.4);
            let mut integrator = Integrator::default();
            for _ in 0..steps {
                let dt = t / f64::from(steps);
                integrator.step(&mut nodes, &mut springs, Rule::Midpoint, &TIGHT, [dt, fluid]);
            }
            (nodes.x_mm[1].x - 10.0 - expected).abs()
        };
        let (coarse, fine) = (error(50), error(100));
        assert!(fine < 1e-3 && (coarse / fine - 4.0).abs() < 0.3, "{coarse} {fine}");
    }

    #[test]
    fn bad_numbers_neither_panic_nor_hang() {
        for rule in [Rule::Implicit, Rule::Midpoint, Rule::QuasiStatic, Rule::SemiImplicit] {
            let (mut nodes, mut springs) = thrown();
            nodes.x_mm[1].x = f64::NAN;
            run(rule, 2, 0.01, &mut nodes, &mut springs);
        }
    }
}
