//! A bleb of the scene's retina, blown up by so much fluid: its volume is that of the cap that it
//! is, its pressure is Laplace's and the springs' work per volume, and of an injection nothing is
//! lost.

use super::case::{Case, Chart, Depth, Outcome, Series};
use nalgebra::{UnitVector3, Vector3};
use scene::{RetinaOperation, SceneFile};
use serde_json::Value;
use std::f64::consts::{FRAC_PI_2, PI};
use tissue::needle::Needle;
use tissue::retina::Retina;
use tissue::retina::state::RetinaState;
use tissue::retina::volume::Cap;
use tissue::sheet::state::NODE_PINNED;

/// The case.
pub const CASE: Case =
    Case { name: "retina-bleb", title: "A bleb of the retina", ours: "springs and fluid of the scenes", run };

/// Polar angle of the bleb's rim, rad: a ring of every mesh.
const RIM_RAD: f64 = 0.25 * FRAC_PI_2;
/// Height of the analytic cap over its base, mm.
const HEIGHT_MM: f64 = 1.2;
/// Substeps until it hangs still: 16 times the time in which its swing dies down to a third.
const SUBSTEPS: u64 = 1300;

/// A retina that lies still over a bleb.
struct Bleb {
    model: Retina,
    state: RetinaState,
}

impl Bleb {
    /// With `fluid_mm3` under it, so taut that its tension is nearly that of a film, on a choroid
    /// that holds it.
    fn new(rings: u32, fluid_mm3: f64) -> Self {
        let mut scene = SceneFile::load("relocation").expect("the shipped scene is tested");
        let retina = scene.retina.as_mut().expect("it has a retina");
        (retina.rings, retina.prestrain, retina.adhesion_n_per_m) = (rings, 0.5, 1e4);
        (retina.tear_tension_n_per_m, retina.p_tear) = (0.0, 1e9);
        let detached_rad = RIM_RAD - 0.25 * FRAC_PI_2 / f64::from(rings);
        retina.operation = Some(RetinaOperation { detached_rad, fluid_mm3, cut_rad: 0.0 });
        let (model, state) = Retina::new(&scene).expect("a retina").expect("a retina");
        let mut bleb = Bleb { model, state };
        bleb.run(SUBSTEPS, None);
        bleb
    }

    fn run(&mut self, substeps: u64, needle: Option<&Needle>) {
        for substep in 0..substeps {
            if substep % 20 == 0 {
                self.model.begin_step(&self.state);
            }
            self.model.follow_needle(&mut self.state, 0, needle);
            let inside = self.state.needles[0].inside;
            let pressure = needle.filter(|n| inside && n.pressure_pa > 0.0).map(|n| n.pressure_pa);
            self.model.flow(&mut self.state, [pressure, None]);
            self.model.substep(&mut self.state, substep);
            if substep % 20 == 19 {
                self.model.end_step(&mut self.state);
            }
        }
    }

    /// Place of a node by the number that it has in [`tissue::retina::mesh`], which counts ring by
    /// ring from the pole.
    fn at_in_rings(&self, node: u32) -> Vector3<f64> {
        self.at(self.model.body.mesh.order[node as usize])
    }

    fn at(&self, node: u32) -> Vector3<f64> {
        self.state.sheet.position(node as usize).map(f64::from)
    }

    /// Force and length of a spring from the positions alone, µN and mm.
    fn spring(&self, spring: u32) -> [f64; 2] {
        let [a, b] = self.model.body.mesh.springs[spring as usize].map(|n| self.at(n));
        let (length, rest) = ((b - a).norm(), f64::from(self.model.body.mesh.rest_mm[spring as usize]));
        [self.model.figures.scene.stiffness_un_per_mm * (length - rest), length]
    }

    /// Energy of the springs, µN·mm.
    fn energy(&self) -> f64 {
        let stiffness = self.model.figures.scene.stiffness_un_per_mm;
        let energy = |s: u32| 0.5 * self.spring(s)[0] * self.spring(s)[0] / stiffness;
        (0..self.model.body.mesh.structural as u32).map(energy).sum()
    }

    /// Mean tension of the inner half of the bleb by the virial of its springs, µN/mm: T = Σ f
    /// l/2A, half of a spring to each side.
    fn tension(&self) -> f64 {
        let sheet = &self.model.body.mesh;
        let inner = |t: &usize| sheet.triangles[*t].iter().all(|&n| self.at(n).xy().norm() < 2.3);
        let (mut virial, mut area) = (0.0, 0.0);
        for t in (0..sheet.triangles.len()).filter(inner) {
            let [a, b, c] = sheet.triangles[t].map(|n| self.at(n));
            area += 0.5 * (b - a).cross(&(c - a)).norm();
            virial += sheet.triangle_springs[t]
                .iter()
                .map(|&s| self.spring(s))
                .map(|[f, l]| 0.5 * f * l)
                .sum::<f64>();
        }
        virial / (2.0 * area)
    }

    fn pressure(&self) -> f64 {
        self.state.blebs[0].pressure_pa
    }
}

fn run(_: &Value, depth: Depth) -> Outcome {
    let mut outcome = Outcome::default().refined_by("ring / radius");
    let radius = 11.5;
    let (base_mm, plane) = (radius * libm::sin(RIM_RAD), radius * libm::cos(RIM_RAD));
    let cap = Cap { base_mm, height_mm: HEIGHT_MM };
    let below = Cap { base_mm, height_mm: radius - plane };
    let fluid = cap.volume_mm3() + below.volume_mm3();
    let mut height = Series::new("height over the base, mm", HEIGHT_MM);
    let mut laplace = Series::new("pressure / (2 T / R)", 1.0);
    let mut work = Series::new("pressure / work of the springs per volume", 1.0);
    let mut finest = 0;
    for rings in depth.of(&[16u32, 32, 64], 2) {
        let size = 1.0 / f64::from(rings);
        let blebs = [0.95, 1.0, 1.05].map(|share| Bleb::new(rings, share * fluid));
        let [less, bleb, more] = &blebs;
        let found = Cap { base_mm, height_mm: plane + bleb.at_in_rings(0).z };
        height.found.push([size, found.height_mm]);
        laplace.found.push([size, bleb.pressure() * cap.radius_mm() / (2.0 * bleb.tension())]);
        let slope = (more.energy() - less.energy()) / (0.1 * fluid);
        work.found.push([size, bleb.pressure() / slope]);
        outcome.solution = Chart::new("distance from the middle, mm", "height, mm");
        let round =
            |r: f64| [r, libm::sqrt(cap.radius_mm() * cap.radius_mm() - r * r) - cap.radius_mm() + HEIGHT_MM];
        outcome.solution.line("reference", (0..=50).map(|i| round(base_mm * f64::from(i) / 50.0)).collect());
        let spoke = |ring: u32| if ring == 0 { 0 } else { 1 + 3 * ring * (ring - 1) };
        let spokes = (0..=rings / 4).map(|r| bleb.at_in_rings(spoke(r)));
        outcome.solution.marks("ours", spokes.map(|x| [x.xy().norm(), x.z + plane]).collect());
        finest = rings;
    }
    for series in [height, laplace, work] {
        outcome.add(series, format!("{finest} rings"), 0.02);
    }
    let (injected, found) = inject();
    let mut account = Series::new("injected: under the retina and leaked, mm3", injected);
    account.found.push([1.0, found]);
    outcome.add(account, "1 s of injection, 1 s of reflux", 1e-9);
    outcome
}

/// Injects into the shipped retina, withdraws, and waits: what went in (by the flow's law, for the
/// pressures there were), and what is there.
fn inject() -> (f64, f64) {
    let scene = SceneFile::load("relocation").expect("the shipped scene is tested");
    let (model, state) = Retina::new(&scene).expect("a retina").expect("a retina");
    let mut bleb = Bleb { model, state };
    let out = Vector3::new(libm::sin(0.1), 0.0, -libm::cos(0.1));
    let needle = Needle {
        tip_in_eye_mm: out * 11.6,
        axis_in_eye: UnitVector3::new_normalize(-out),
        velocity_mm_s: Vector3::zeros(),
        radius_mm: 0.05,
        pressure_pa: 80_000.0,
    };
    bleb.run(1000, Some(&needle));
    let injected = bleb.state.needles[0].injected_mm3;
    bleb.run(1000, None);
    let pinned = bleb.state.sheet.flag.iter().filter(|&&f| f == NODE_PINNED).count();
    assert!(
        pinned < bleb.state.sheet.nodes() && bleb.state.account.leaked_mm3 > 0.0 && injected < PI * 100.0
    );
    // What lies under it as the mesh has it, not as the account says, to the rounding of its
    // positions (1e-6 mm³).
    let mesh = bleb.model.measured_all_mm3(&bleb.state);
    assert!((mesh - bleb.state.under_mm3()).abs() < 2e-4, "{mesh}");
    (injected, bleb.state.under_mm3() + bleb.state.account.leaked_mm3)
}
