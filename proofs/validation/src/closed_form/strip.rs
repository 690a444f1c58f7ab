//! A strip of tissue on a flat base, peeled off by one end under a chosen angle, as in a testing
//! machine. The strip is the product's sheet, solver and adhesion; only the machine is made here.
//!
//! The lattice is equilateral, with springs of stiffness k: an isotropic membrane with Y = E t =
//! 2k/√3 and ν = ⅓.

use scene::{AdhesionScene, CurlScene, SceneFile};
use tissue::sheet::adhesion::{Adhesion, AdhesionState};
use tissue::sheet::curl::Curl;
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::solver::{Material, Solver};
use tissue::sheet::state::{NODE_PINNED, SheetState};

/// A peel test.
#[derive(Debug, Clone, Copy)]
pub struct PeelTest {
    /// Spacing of the lattice, mm.
    pub spacing_mm: f64,
    /// Rows of nodes along the strip.
    pub rows: u32,
    /// Length of the strip, mm.
    pub length_mm: f64,
    /// Membrane stiffness Y, µN/mm.
    pub stiffness_un_per_mm: f64,
    /// Bending stiffness D, µN·mm; 0 for none. Without it a strip that is folded back flutters at
    /// the fold, and that costs.
    pub bending_un_mm: f64,
    /// Adhesion energy Γ, µN/mm.
    pub energy_un_per_mm: f64,
    /// Separation at which a bond has broken, mm.
    pub range_mm: f64,
    /// Angle between the free arm and what is still bonded, rad: 0 along the strip, π folded back
    /// on it.
    pub angle_rad: f64,
    /// Height of the grip over where the angle says, mm: an arm that is folded back needs room for
    /// its fold.
    pub lift_mm: f64,
    /// Speed of the front, mm/s.
    pub speed_mm_s: f64,
    /// Mass of the strip per area, g/mm².
    pub density_g_per_mm2: f64,
    /// Share of the longest stable step.
    pub step: f64,
}

impl Default for PeelTest {
    fn default() -> Self {
        PeelTest {
            spacing_mm: 0.1,
            rows: 9,
            length_mm: 4.0,
            stiffness_un_per_mm: 20_000.0,
            bending_un_mm: 0.0,
            energy_un_per_mm: 1000.0,
            range_mm: 0.2,
            angle_rad: std::f64::consts::FRAC_PI_2,
            lift_mm: 0.0,
            speed_mm_s: 0.2,
            density_g_per_mm2: 10.0,
            step: 0.7,
        }
    }
}

/// What the machine measured over the second half of the way.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Mean force at the grip along the arm over the width, µN/mm.
    pub force_un_per_mm: f64,
    /// Largest and smallest of it.
    pub range_un_per_mm: [f64; 2],
    /// Work of the grip less what the arm stores, over the area parted, µN/mm.
    pub energy_un_per_mm: f64,
}

impl PeelTest {
    /// Width that the rows stand for, mm.
    pub fn width_mm(&self) -> f64 {
        f64::from(self.rows - 1) * self.spacing_mm * 0.75_f64.sqrt()
    }

    /// Steady force over width of a thin elastic strip (Rivlin 1944 for Y → ∞; Kendall 1975): the
    /// positive root of f (1 − cos θ) + f²/2Y = Γ, µN/mm. For Hooke's law in force over initial
    /// length it is exact at any stretch.
    pub fn kendall_un_per_mm(&self) -> f64 {
        let (lever, y) = (1.0 - self.angle_rad.cos(), self.stiffness_un_per_mm);
        y * ((lever * lever + 2.0 * self.energy_un_per_mm / y).sqrt() - lever)
    }

    /// The strip's tissue, with a step of the chosen share of the longest stable one.
    pub fn tissue(&self) -> Material {
        let mut scene = SceneFile::load("peel").expect("the shipped scene is tested");
        scene.eye.retina_radius_mm = 1e9;
        let m = scene.membrane.as_mut().expect("it has a membrane");
        let k = self.stiffness_un_per_mm * 0.75_f64.sqrt();
        m.stiffness_un_per_mm = k;
        m.bending_un_per_mm = 0.0;
        m.node_mass_g = self.density_g_per_mm2 * self.spacing_mm * self.spacing_mm * 0.75_f64.sqrt();
        // A quarter of the critical damping of one spring between two nodes.
        m.spring_damping_un_s_per_mm = 0.25 * (k * m.node_mass_g).sqrt();
        m.fluid_damping_per_s = 0.5;
        (m.a_max_mm_s2, m.v_max_mm_s, m.tear_tension_n_per_m) = (1e9, 1e5, 0.0);
        // Gershgorin, see the solver's opening: λ dt² + 2 δ dt < 4.
        let (lambda, delta) = (12.0 * k / m.node_mass_g, 12.0 * m.spring_damping_un_s_per_mm / m.node_mass_g);
        let mut tissue = Material::new(&scene);
        let longest = ((delta * delta + 4.0 * lambda).sqrt() - delta) / lambda;
        tissue.dt_s = (self.step * longest) as f32;
        tissue
    }

    /// Runs the test.
    pub fn run(&self) -> Measured {
        let (sheet, grip) = self.sheet();
        let tissue = self.tissue();
        let (mut membrane, mut solver) = (sheet.start(), Solver::new(&sheet));
        solver.refresh(&sheet, &membrane, &tissue);
        assert!(grip.iter().all(|&n| membrane.flag[n as usize] == NODE_PINNED));
        let curl = CurlScene { stiffness_un_mm: self.bending_un_mm, radius_mm: 1e6 };
        let mut curl = (self.bending_un_mm > 0.0).then(|| Curl::new(&sheet, &curl, f32::INFINITY));
        let adhesion = Adhesion::new(&sheet, &self.adhesion(), 1e9);
        let mut bonds = adhesion.start();
        let dt = f64::from(tissue.dt_s);
        let steps = (0.8 * self.length_mm / (self.speed_mm_s * dt)) as u64;
        let direction = [-self.angle_rad.cos(), 0.0, self.angle_rad.sin()];
        let stretch = 1.0 + self.kendall_un_per_mm() / self.stiffness_un_per_mm;
        // The grip goes with the front, so that the arm keeps its angle.
        let velocity =
            [self.speed_mm_s * (1.0 + stretch * direction[0]), 0.0, self.speed_mm_s * stretch * direction[2]];
        let start = membrane.position_mm.clone();
        let (mut sum, mut low, mut high, mut count) = (0.0, f64::INFINITY, 0.0f64, 0u64);
        let (mut work, mut at_half) = (0.0, (0.0, 0.0));
        for step in 0..steps {
            let t = (step + 1) as f64 * dt;
            for (axis, speed) in velocity.iter().enumerate() {
                let lifted = if axis == 2 { self.lift_mm.min(self.speed_mm_s * t) as f32 } else { 0.0 };
                for &n in &grip {
                    membrane.position_mm[axis][n as usize] =
                        start[axis][n as usize] + (speed * t) as f32 + lifted;
                    membrane.velocity_mm_s[axis][n as usize] = *speed as f32;
                }
            }
            substep(&sheet, &mut membrane, &mut solver, &tissue, &adhesion, &mut bonds, curl.as_mut());
            let force: [f64; 3] = std::array::from_fn(|axis| {
                -grip.iter().map(|&n| f64::from(solver.force_un[axis][n as usize])).sum::<f64>()
                    / self.width_mm()
            });
            let dot = |v: [f64; 3]| force.iter().zip(v).map(|(f, v)| f * v).sum::<f64>();
            work += dot(velocity) * dt * self.width_mm();
            if step == steps / 2 {
                at_half = (work - stored(&sheet, &solver, self.stiffness_un_per_mm), bonds.freed_mm2);
            }
            if step >= steps / 2 {
                let along = dot(direction);
                (sum, low, high, count) = (sum + along, low.min(along), high.max(along), count + 1);
            }
        }
        let spent = work - stored(&sheet, &solver, self.stiffness_un_per_mm) - at_half.0;
        Measured {
            force_un_per_mm: sum / count as f64,
            range_un_per_mm: [low, high],
            energy_un_per_mm: spent / (bonds.freed_mm2 - at_half.1),
        }
    }

    fn sheet(&self) -> (SheetMesh, Vec<u32>) {
        let columns = (self.length_mm / self.spacing_mm).round() as u32 + 1;
        let (positions, triangles) = lattice(self.spacing_mm, self.rows, columns);
        let grip: Vec<u32> = (0..self.rows).map(|r| r * columns).collect();
        let sheet = SheetMesh::from_triangles(&positions, &triangles, &grip).expect("a lattice is a mesh");
        let grip = grip.iter().map(|&n| sheet.order[n as usize]).collect();
        (sheet, grip)
    }

    fn adhesion(&self) -> AdhesionScene {
        AdhesionScene {
            energy_un_per_mm: self.energy_un_per_mm,
            range_mm: self.range_mm,
            rim_energy_un_per_mm: 0.0,
            rim_width_mm: 0.0,
            retina_warn_pa: 1e9,
            retina_lift_pa: 1e9,
            retina_tear_mm: 1.0,
            patches: Vec::new(),
        }
    }
}

/// Rows of nodes along x, every other one moved by half a spacing, and their equilateral triangles;
/// node (r, c) is r·columns + c.
pub fn lattice(spacing_mm: f64, rows: u32, columns: u32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let all = (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c)));
    let at = |r: u32, c: u32| {
        let x = spacing_mm * (f64::from(c) + 0.5 * f64::from(r % 2));
        [x as f32, (spacing_mm * 0.75_f64.sqrt() * f64::from(r)) as f32, 0.0]
    };
    let node = |r: u32, c: u32| r * columns + c;
    let squares = (0..rows - 1).flat_map(|r| (0..columns - 1).map(move |c| (r, c)));
    let halves = |r: u32, c: u32| {
        let (a, b, d, e) = (node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1));
        if r.is_multiple_of(2) { [[a, b, d], [b, e, d]] } else { [[a, b, e], [a, e, d]] }
    };
    (all.map(|(r, c)| at(r, c)).collect(), squares.flat_map(|(r, c)| halves(r, c)).collect())
}

/// Elastic energy of the springs, µN·mm.
fn stored(sheet: &SheetMesh, solver: &Solver, stiffness_un_per_mm: f64) -> f64 {
    let k = stiffness_un_per_mm * 0.75_f64.sqrt();
    (0..sheet.structural).map(|s| solver.tension_un(s)).map(|t| 0.5 * f64::from(t * t) / k).sum()
}

fn substep(
    sheet: &SheetMesh,
    membrane: &mut SheetState,
    solver: &mut Solver,
    tissue: &Material,
    adhesion: &Adhesion,
    bonds: &mut AdhesionState,
    curl: Option<&mut Curl>,
) {
    solver.clear_outer();
    adhesion.pull(&membrane.position_mm, &membrane.flag, bonds, solver, tissue.dt_s);
    if let Some(curl) = curl {
        curl.bend(membrane, None, &mut solver.outer_un);
    }
    let alarms = solver.accelerate(sheet, membrane, tissue);
    assert!(!alarms.not_finite, "the strip ran away");
    solver.integrate(membrane, tissue);
}
