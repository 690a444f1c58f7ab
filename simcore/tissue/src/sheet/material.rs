//! Figures of the tissue as the solver needs them, and how small its steps must be.
//!
//! Let λ and δ be the largest eigenvalues of stiffness and damping over mass. Gershgorin's circles
//! bound them by λ ≤ 2Σk/m and δ ≤ 2Σc/m + g, Σ over the springs of a node, largest over the nodes.
//! A step dt is stable while
//!
//! ```text
//! semi-implicit   dt²·λ + 2·dt·δ < 4
//! quasi-static    dt²·λ < 2
//! explicit        dt < β + g/λ,  dt·τ λ < g  and  dt·δ < 2        β: smallest c/k of a spring
//! ```
//!
//! The last line follows from the roots of z² − (2 − δ dt) z + 1 − δ dt + λ dt² for every mode with
//! δ ≥ β λ + g: explicit Euler feeds energy into what is not damped. A taut spring holds its ends
//! across its direction, too, by k ε/(1 + ε) at the strain ε, and there only the fluid damps: τ is
//! that share at the strain at which springs tear or are limited, at most [`TAUT_STRAIN`].

use super::mesh::SheetMesh;
use crate::constants::{MAX_SPLITS, SUBSTEP_S};
use crate::elements::law::PlaneLaw;
use crate::sheet::state::SheetState;
use scene::{ElementsLaw, ElementsScene, MembraneIntegrator, MembraneScene, RetinaScene, SceneFile};

/// Largest strain for which explicit Euler is kept stable across taut springs: beyond twice its
/// length no tissue holds.
const TAUT_STRAIN: f64 = 1.0;

/// Figures of the tissue as the solver needs them.
#[derive(Debug, Clone, Copy)]
pub struct Material {
    /// Time that one call of the integrator advances, s: a substep, or a share of it where that
    /// would be unstable.
    pub dt_s: f32,
    /// 1/g.
    pub inverse_mass: f32,
    /// 1/s.
    pub fluid_per_s: f32,
    /// mm/s².
    pub a_max: f32,
    /// mm/s; 0 is quasi-static.
    pub v_max: f32,
    /// Acceleration at which a node's hardest pulling spring tears, mm/s².
    pub a_tear: f32,
    /// Radius of the retina, mm.
    pub radius_mm: f32,
    /// The old velocity moves the nodes.
    pub explicit: bool,
    /// A node's velocity outlives the substep; not where substeps seek a balance, nor in the
    /// paper's quasi-static system.
    pub keeps_velocity: bool,
    /// Strain over which springs are drawn together again; 0 for no limit.
    pub strain_limit: f32,
    /// Strain beyond which a spring's rest length creeps; infinite where the tissue is elastic.
    pub yield_strain: f32,
    /// Share of the strain beyond the yield by which the rest length follows, 1/s.
    pub creep_per_s: f32,
    /// Of structural springs, µN/mm; where elements carry the sheet it only sets how bending
    /// springs are damped.
    pub(super) stiffness: f32,
    /// The law of the elements that carry the sheet in place of its structural springs.
    pub(super) elements: Option<PlaneLaw>,
    /// Of bending springs, µN/mm.
    pub(super) bending: f32,
    /// Of structural springs, µN·s/mm; bending springs have it in proportion to their stiffness.
    pub(super) damping: f32,
    /// Tension per length at which a spring tears, µN/mm; infinite when the rule is off.
    pub(super) tear_un_per_mm: f32,
}

/// The tissue would need steps too short to be computed in time.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "a substep of {substep_ms} ms is unstable, and would be split into {limit} parts; stiffness over node \
     mass is too large \
     (λ ≤ {lambda_per_s2:e} 1/s², δ ≤ {delta_per_s:e} 1/s), or explicit Euler lacks damping"
)]
pub struct Unstable {
    /// The substep, ms.
    pub substep_ms: f64,
    /// Parts tried.
    pub limit: u32,
    /// Bound of the stiffness over mass, 1/s².
    pub lambda_per_s2: f64,
    /// Bound of the damping over mass, 1/s.
    pub delta_per_s: f64,
}

impl Material {
    const INERT: Material = Material {
        dt_s: SUBSTEP_S as f32,
        inverse_mass: 0.0,
        fluid_per_s: 0.0,
        a_max: 0.0,
        v_max: 0.0,
        a_tear: f32::INFINITY,
        radius_mm: f32::INFINITY,
        explicit: false,
        keeps_velocity: false,
        strain_limit: 0.0,
        yield_strain: f32::INFINITY,
        creep_per_s: 0.0,
        stiffness: 0.0,
        elements: None,
        bending: 0.0,
        damping: 0.0,
        tear_un_per_mm: f32::INFINITY,
    };

    /// The tissue of a scene; of one without a membrane, figures that move nothing.
    pub fn new(scene: &SceneFile) -> Self {
        let radius_mm = scene.eye.retina_radius_mm as f32;
        scene.membrane.as_ref().map_or(Self { radius_mm, ..Self::INERT }, |m| Self::of(m, radius_mm))
    }

    /// The tissue of a whole retina, a sphere of radius `radius_mm` while it lies on.
    pub fn of_retina(r: &RetinaScene, radius_mm: f32) -> Self {
        let tear = if r.tear_tension_n_per_m > 0.0 { r.tear_tension_n_per_m * 1e3 } else { f64::INFINITY };
        Material {
            inverse_mass: (1.0 / r.node_mass_g) as f32,
            fluid_per_s: r.fluid_damping_per_s as f32,
            a_max: r.a_max_mm_s2 as f32,
            v_max: r.v_max_mm_s as f32,
            keeps_velocity: r.v_max_mm_s > 0.0,
            a_tear: (r.a_max_mm_s2 * (1.0 + r.p_tear)) as f32,
            radius_mm,
            stiffness: r.stiffness_un_per_mm as f32,
            bending: r.bending_un_per_mm as f32,
            damping: r.spring_damping_un_s_per_mm as f32,
            tear_un_per_mm: tear as f32,
            ..Self::INERT
        }
    }

    fn of(m: &MembraneScene, radius_mm: f32) -> Self {
        let or_never = |limit: f64| if limit > 0.0 { limit } else { f64::INFINITY };
        Material {
            dt_s: SUBSTEP_S as f32,
            inverse_mass: (1.0 / m.node_mass_g) as f32,
            fluid_per_s: m.fluid_damping_per_s as f32,
            a_max: m.a_max_mm_s2 as f32,
            v_max: m.v_max_mm_s as f32,
            a_tear: (m.a_max_mm_s2 * (1.0 + m.p_tear)) as f32,
            radius_mm,
            explicit: m.integrator == MembraneIntegrator::Explicit,
            keeps_velocity: m.v_max_mm_s > 0.0 && m.integrator != MembraneIntegrator::QuasiStatic,
            strain_limit: m.strain_limit as f32,
            yield_strain: or_never(m.yield_strain) as f32,
            creep_per_s: m.creep_per_s as f32,
            stiffness: m.stiffness_un_per_mm as f32,
            elements: m.elements.map(plane_law),
            bending: m.bending_un_per_mm as f32,
            damping: m.spring_damping_un_s_per_mm as f32,
            tear_un_per_mm: (or_never(m.tear_tension_n_per_m) * 1e3) as f32,
        }
    }

    /// True where rest lengths creep.
    pub fn is_plastic(&self) -> bool {
        self.yield_strain.is_finite() && self.creep_per_s > 0.0
    }

    /// Stiffness (µN/mm) and damping (µN·s/mm) of a spring of the sheet; 0 where it is not alive.
    pub fn spring(&self, mesh: &SheetMesh, state: &SheetState, s: usize) -> (f32, f32) {
        let (alive, stiffness) = match s.checked_sub(mesh.structural) {
            None if self.elements.is_some() => {
                let alive = state.spring_alive[s] != 0;
                return (0.0, if alive { self.damping * factor(&mesh.damping_factor, s) } else { 0.0 });
            }
            None => (state.spring_alive[s] != 0, self.stiffness),
            Some(bend) => (mesh.bends[bend].is_whole(state) && self.bending > 0.0, self.bending),
        };
        if !alive {
            return (0.0, 0.0);
        }
        let share = if self.stiffness > 0.0 { stiffness / self.stiffness } else { 1.0 };
        let damping = self.damping * share * factor(&mesh.damping_factor, s);
        (stiffness * factor(&mesh.stiffness_factor, s), damping)
    }

    /// Splits the substep into as many equal parts as the stability of Euler's methods needs;
    /// returns how many.
    ///
    /// # Errors
    /// If more parts than [`MAX_SPLITS`] would be needed.
    pub fn split(&mut self, mesh: &SheetMesh) -> Result<u32, Unstable> {
        let bound = Bound::new(self, mesh);
        let parts = (1..=MAX_SPLITS).find(|&parts| bound.holds(self, SUBSTEP_S / f64::from(parts)));
        let parts = parts.ok_or(Unstable {
            substep_ms: SUBSTEP_S * 1e3,
            limit: MAX_SPLITS,
            lambda_per_s2: bound.lambda,
            delta_per_s: bound.delta,
        })?;
        self.dt_s = (SUBSTEP_S / f64::from(parts)) as f32;
        Ok(parts)
    }
}

/// A spring's own factor of a list that has one for each, or none.
fn factor(list: &[f32], spring: usize) -> f32 {
    list.get(spring).copied().unwrap_or(1.0)
}

/// The law of a scene's elements. Of an incompressible sheet Young's modulus is three times the
/// shear modulus.
fn plane_law(elements: ElementsScene) -> PlaneLaw {
    let young_un_per_mm = elements.young_un_per_mm;
    match elements.law {
        ElementsLaw::StVenantKirchhoff => {
            PlaneLaw::StVenantKirchhoff { young_un_per_mm, poisson: elements.poisson() }
        }
        ElementsLaw::NeoHookean => PlaneLaw::NeoHookean { shear_un_per_mm: young_un_per_mm / 3.0 },
    }
}

/// The bounds of the module's text.
struct Bound {
    lambda: f64,
    delta: f64,
    /// s.
    beta: f64,
}

impl Bound {
    fn new(material: &Material, mesh: &SheetMesh) -> Self {
        let mut sums = vec![[0.0f64; 2]; mesh.nodes()];
        let mut beta = f64::INFINITY;
        let whole = mesh.start();
        for (s, ends) in mesh.springs.iter().enumerate() {
            let (k, c) = material.spring(mesh, &whole, s);
            let (k, c) = (f64::from(k), f64::from(c));
            beta = if k > 0.0 && c / k < beta { c / k } else { beta };
            for &end in ends {
                let [stiffness, damping] = &mut sums[end as usize];
                (*stiffness, *damping) = (*stiffness + k, *damping + c);
            }
        }
        let most =
            |i: usize| 2.0 * sums.iter().fold(0.0f64, |m, s| m.max(s[i])) * f64::from(material.inverse_mass);
        Bound { lambda: most(0), delta: most(1) + f64::from(material.fluid_per_s), beta }
    }

    fn holds(&self, material: &Material, dt: f64) -> bool {
        let (lambda, delta) = (self.lambda, self.delta);
        if material.v_max == 0.0 {
            return dt * dt * lambda < 2.0;
        }
        if !material.explicit {
            return dt * dt * lambda + 2.0 * dt * delta < 4.0;
        }
        let still = lambda == 0.0;
        let fluid = f64::from(material.fluid_per_s);
        let along = dt < self.beta + fluid / lambda;
        (still || (along && dt * lambda * taut_share(material) < fluid)) && dt * delta < 2.0
    }
}

/// Stiffness of the tautest spring across its direction, as a share of that along it.
fn taut_share(material: &Material) -> f64 {
    let tears = f64::from(material.tear_un_per_mm / material.stiffness);
    let limit = if material.strain_limit > 0.0 { f64::from(material.strain_limit) } else { f64::INFINITY };
    let strain = tears.min(limit).min(TAUT_STRAIN);
    strain / (1.0 + strain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sheet::solver::Solver;

    fn peel(change: impl FnOnce(&mut MembraneScene)) -> (SheetMesh, Material) {
        let mut scene = SceneFile::load("peel").unwrap();
        change(scene.membrane.as_mut().unwrap());
        (SheetMesh::new(&scene).unwrap(), Material::new(&scene))
    }

    #[test]
    fn the_shipped_scene_needs_no_split() {
        let (mesh, mut material) = peel(|_| {});
        assert_eq!(material.split(&mesh), Ok(1));
        assert_eq!(material.dt_s, SUBSTEP_S as f32);
    }

    #[test]
    fn stiffer_tissue_is_split_by_the_root_of_its_stiffness_and_too_stiff_refused() {
        let undamped = |stiffness| {
            peel(|m| {
                (m.stiffness_un_per_mm, m.bending_un_per_mm) = (stiffness, 0.0);
                (m.spring_damping_un_s_per_mm, m.fluid_damping_per_s) = (0.0, 0.0);
            })
        };
        // Six springs a node: λ = 12 k/m, dt = 2/√λ, so that 1 ms takes √(3 k/m)·1 ms parts,
        // rounded up.
        for (stiffness, parts) in [(3e3, 1), (4e4, 4), (1e6, 18)] {
            let (mesh, mut material) = undamped(stiffness);
            assert_eq!(material.split(&mesh).unwrap(), parts, "{stiffness}");
            assert!((f64::from(material.dt_s) * f64::from(parts) / SUBSTEP_S - 1.0).abs() < 1e-6);
        }
        let (mesh, mut material) = undamped(1e9);
        assert!(material.split(&mesh).unwrap_err().to_string().contains("split into 64 parts"));
    }

    #[test]
    fn explicit_euler_asks_for_damping() {
        let (mesh, mut material) = peel(|m| {
            (m.integrator, m.spring_damping_un_s_per_mm) = (MembraneIntegrator::Explicit, 0.0);
            m.fluid_damping_per_s = 0.0;
        });
        assert!(material.split(&mesh).is_err());
        let (mesh, mut material) = peel(|m| m.integrator = MembraneIntegrator::Explicit);
        assert!(material.split(&mesh).unwrap() > 1, "0.375 ms of damping do not carry 1 ms");
    }

    /// A sheet drawn out by a half swings across its springs, which damp nothing there: the bound
    /// keeps explicit Euler from feeding that.
    #[test]
    fn explicit_euler_keeps_a_taut_sheet_calm() {
        let (mesh, mut material) = peel(|m| {
            (m.integrator, m.spring_damping_un_s_per_mm) = (MembraneIntegrator::Explicit, 0.4);
            (m.bending_un_per_mm, m.tear_tension_n_per_m) = (0.0, 0.0);
        });
        let along_only = Material { strain_limit: 1e-6, ..material };
        let fed = { along_only }.split(&mesh).unwrap();
        assert!(material.split(&mesh).unwrap() > 4 * fed, "across costs more than along");
        let swing = |material: &Material| {
            let (mut state, mut solver) = (mesh.start(), Solver::new(&mesh));
            state.rest_mm = mesh.rest_mm.iter().map(|l| l / 1.5).collect();
            solver.refresh(&mesh, &state, material);
            state.position_mm[2][mesh.nodes() / 2] += 1e-3;
            let parts = (SUBSTEP_S / f64::from(material.dt_s) + 0.5) as usize;
            for _ in 0..400 * parts {
                solver.accelerate(&mesh, &state, material);
                solver.integrate(&mut state, material);
            }
            (0..state.nodes()).map(|n| f64::from(state.velocity(n).norm_squared())).sum::<f64>()
        };
        let coarse = Material { dt_s: (SUBSTEP_S / f64::from(fed)) as f32, ..material };
        assert!(swing(&material) < 1e-2 * swing(&coarse), "{} {}", swing(&material), swing(&coarse));
    }

    /// Energy of a crumpled sheet after many steps of a share of the substep that the bound allows
    /// just so.
    #[test]
    fn what_the_bound_allows_stays_bounded() {
        for integrator in [MembraneIntegrator::SemiImplicit, MembraneIntegrator::Explicit] {
            let (mesh, mut material) = peel(|m| {
                (m.integrator, m.tear_tension_n_per_m) = (integrator, 0.0);
                (m.stiffness_un_per_mm, m.spring_damping_un_s_per_mm) = (20_000.0, 2.0);
                (m.a_max_mm_s2, m.v_max_mm_s, m.strain_limit) = (1e12, 1e6, 0.01);
                m.fluid_damping_per_s = 60.0;
            });
            let parts = material.split(&mesh).unwrap();
            assert!(parts > 1);
            let (mut state, mut solver) = (mesh.start(), Solver::new(&mesh));
            solver.refresh(&mesh, &state, &material);
            for (i, z) in state.position_mm[2].iter_mut().enumerate() {
                *z += ((i * 37 % 101) as f32 / 101.0 - 0.5) * 0.02;
            }
            let mut speeds = Vec::new();
            for _ in 0..3000 {
                solver.accelerate(&mesh, &state, &material);
                solver.integrate(&mut state, &material);
                let squares = (0..state.nodes()).map(|i| f64::from(state.velocity(i).norm_squared()));
                speeds.push(squares.sum::<f64>());
            }
            let peak = |part: &[f64]| part.iter().fold(0.0f64, |m, &e| m.max(e));
            assert!(peak(&speeds[2900..]) < 1e-2 * peak(&speeds[..100]), "{integrator:?}");
        }
    }
}
