//! The epiretinal membrane of a scene: key `membrane`.

use super::{AdhesionScene, CurlScene, Defect, ElementsScene, MeshScene, Range, is_default, refuse, shown};
use serde::{Deserialize, Serialize};

/// A sheet before the retina, its rim attached to the retina: squares, or any mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MembraneScene {
    /// Direction from the eye's centre to the middle of the sheet, eye frame (any length).
    #[serde(default, skip_serializing_if = "is_default")]
    pub towards_in_eye: [f64; 3],
    /// Width and height of the sheet, mm.
    #[serde(default, skip_serializing_if = "is_default")]
    pub size_mm: [f64; 2],
    /// Squares along width and height; each square is two triangles.
    #[serde(default, skip_serializing_if = "is_default")]
    pub squares: [u32; 2],
    /// Height of the middle of the sheet over the retina, mm; the rim lies on the retina.
    #[serde(default, skip_serializing_if = "is_default")]
    pub lift_mm: f64,
    /// One edge (that at the end of the sheet's first axis) is free, and the sheet rises towards
    /// it instead of its middle.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub loose_edge: bool,
    /// Spring stiffness, µN/mm.
    pub stiffness_un_per_mm: f64,
    /// Stiffness of the bending springs, µN/mm; 0 for none.
    pub bending_un_per_mm: f64,
    /// Damping along a spring, µN·s/mm.
    pub spring_damping_un_s_per_mm: f64,
    /// How a substep is made.
    #[serde(default, skip_serializing_if = "is_default")]
    pub integrator: MembraneIntegrator,
    /// Strain over which springs are drawn together again at the end of each substep; 0 for no
    /// limit.
    #[serde(default, skip_serializing_if = "is_default")]
    pub strain_limit: f64,
    /// Damping of a node by the fluid, 1/s.
    pub fluid_damping_per_s: f64,
    /// Mass of a node, g. Scaled up from the true mass so that a step of 1 ms is stable.
    pub node_mass_g: f64,
    /// Limit of a node's acceleration, mm/s².
    pub a_max_mm_s2: f64,
    /// Limit of a node's velocity, mm/s; 0 gives the quasi-static system of the paper.
    pub v_max_mm_s: f64,
    /// Strain beyond which rest lengths creep; 0 for tissue that is elastic for ever.
    #[serde(default, skip_serializing_if = "is_default")]
    pub yield_strain: f64,
    /// Share of the strain beyond the yield by which rest lengths follow, 1/s.
    #[serde(default, skip_serializing_if = "is_default")]
    pub creep_per_s: f64,
    /// Share by which `a_max` must be exceeded for the hardest pulling spring to tear.
    pub p_tear: f64,
    /// Spring tension per length of edge at which it tears, N/m; 0 switches this rule off.
    pub tear_tension_n_per_m: f64,
    /// Force on a rim node that warns, µN.
    pub rim_warn_un: f64,
    /// Force on a rim node that tears it off the retina, µN.
    pub rim_tear_un: f64,
    /// A mesh of its own. `towards_in_eye`, `size_mm`, `squares`, `lift_mm` and `loose_edge` are
    /// those of a sheet of squares; only one of both may be there.
    pub mesh: Option<MeshScene>,
    /// A continuum in place of the springs; without it springs carry the sheet.
    pub elements: Option<ElementsScene>,
    /// Glue under the whole sheet; without it the rim alone is fixed.
    pub adhesion: Option<AdhesionScene>,
    /// Rolling up of what is free; without it the sheet stays as it is.
    pub curl: Option<CurlScene>,
}

/// How a substep of the membrane is made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MembraneIntegrator {
    /// The new velocity moves the nodes: the fast core, for masses scaled to the substep.
    #[default]
    SemiImplicit,
    /// The old velocity moves them, as in the paper.
    Explicit,
    /// Backward Euler: stable for any stiffness and mass.
    Implicit,
    /// Each substep goes to where all forces balance; mass plays no part.
    QuasiStatic,
}

impl MembraneScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        let mut ranges = vec![
            ("membrane.stiffness_un_per_mm", self.stiffness_un_per_mm, 0.0, 1e7),
            ("membrane.bending_un_per_mm", self.bending_un_per_mm, 0.0, 1e7),
            ("membrane.spring_damping_un_s_per_mm", self.spring_damping_un_s_per_mm, 0.0, 1e6),
            ("membrane.strain_limit", self.strain_limit, 0.0, 10.0),
            ("membrane.fluid_damping_per_s", self.fluid_damping_per_s, 0.0, 1e5),
            ("membrane.node_mass_g", self.node_mass_g, 1e-9, 1e3),
            ("membrane.a_max_mm_s2", self.a_max_mm_s2, 0.0, 1e12),
            ("membrane.v_max_mm_s", self.v_max_mm_s, 0.0, 1e6),
            ("membrane.yield_strain", self.yield_strain, 0.0, 1e3),
            ("membrane.creep_per_s", self.creep_per_s, 0.0, 1e6),
            ("membrane.p_tear", self.p_tear, 0.0, 1e9),
            ("membrane.tear_tension_n_per_m", self.tear_tension_n_per_m, 0.0, 1e6),
            ("membrane.rim_warn_un", self.rim_warn_un, 0.0, 1e9),
            ("membrane.rim_tear_un", self.rim_tear_un, 0.0, 1e9),
        ];
        if self.mesh.is_none() {
            ranges.push(("membrane.size_mm[0]", self.size_mm[0], 0.1, 20.0));
            ranges.push(("membrane.size_mm[1]", self.size_mm[1], 0.1, 20.0));
            ranges.push(("membrane.lift_mm", self.lift_mm, 0.0, 5.0));
        }
        ranges.extend(self.elements.iter().flat_map(ElementsScene::ranges));
        ranges.extend(self.adhesion.iter().flat_map(AdhesionScene::ranges));
        ranges.extend(self.curl.iter().flat_map(CurlScene::ranges));
        ranges
    }

    /// What is wrong beyond the ranges in an eye of this radius: key, what would be right, what is
    /// there.
    pub(super) fn defect(&self, retina_radius_mm: f64) -> Option<Defect> {
        self.shape_defect(retina_radius_mm).or_else(|| self.material_defect())
    }

    fn shape_defect(&self, retina_radius_mm: f64) -> Option<Defect> {
        if let Some(mesh) = &self.mesh {
            let beside = [
                ("membrane.towards_in_eye", !is_default(&self.towards_in_eye)),
                ("membrane.size_mm", !is_default(&self.size_mm)),
                ("membrane.squares", !is_default(&self.squares)),
                ("membrane.lift_mm", self.lift_mm != 0.0),
                ("membrane.loose_edge", self.loose_edge),
            ];
            return match beside.into_iter().find(|(_, is_set)| *is_set) {
                Some((key, _)) => refuse(key, "no such key with membrane.mesh", "one"),
                None => mesh.defect(retina_radius_mm),
            };
        }
        if self.squares.iter().any(|&n| !(2..=800).contains(&n)) {
            return refuse("membrane.squares", "two numbers from 2 to 800", format!("{:?}", self.squares));
        }
        let towards: f64 = self.towards_in_eye.iter().map(|c| c * c).sum();
        if !(towards.is_finite() && towards > 1e-12) {
            return refuse("membrane.towards_in_eye", "a direction", format!("{:?}", self.towards_in_eye));
        }
        None
    }

    fn material_defect(&self) -> Option<Defect> {
        let springs =
            matches!(self.integrator, MembraneIntegrator::SemiImplicit | MembraneIntegrator::Explicit);
        if self.yield_strain > 0.0 && !springs {
            let expected = "0 unless the integrator is semi-implicit or explicit";
            let found = format!("{} with {}", self.yield_strain, shown(&self.integrator));
            return refuse("membrane.yield_strain", expected, found);
        }
        if self.elements.is_some() && springs {
            let expected =
                "the integrator \"implicit\" or \"quasi-static\": explicit substeps carry springs only";
            return refuse("membrane.elements", expected, shown(&self.integrator));
        }
        let elements = self.elements.as_ref().and_then(ElementsScene::defect);
        elements.or_else(|| self.adhesion.as_ref().and_then(AdhesionScene::defect))
    }
}
