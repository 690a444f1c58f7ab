//! The whole retina of a scene: key `retina`.

use super::Range;
use serde::{Deserialize, Serialize};

/// The retina as a mesh on the rear hemisphere that lies on the choroid until fluid lifts it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetinaScene {
    /// Rings of nodes from the fovea to the equator: n rings have 1 + 3n(n + 1) nodes and 6n²
    /// triangles.
    pub rings: u32,
    /// Spring stiffness, µN/mm; as a membrane the mesh has 1.155 times that.
    pub stiffness_un_per_mm: f64,
    /// Stiffness of the bending springs, µN/mm; 0 for none.
    pub bending_un_per_mm: f64,
    /// Damping along a spring, µN·s/mm.
    pub spring_damping_un_s_per_mm: f64,
    /// Damping of a node by the fluid, 1/s.
    pub fluid_damping_per_s: f64,
    /// Mass of a node, g. Scaled up from the true mass so that a step of 1 ms is stable.
    pub node_mass_g: f64,
    /// Limit of a node's acceleration, mm/s².
    pub a_max_mm_s2: f64,
    /// Limit of a node's velocity, mm/s.
    pub v_max_mm_s: f64,
    /// Share by which `a_max` must be exceeded for the hardest pulling spring to tear.
    pub p_tear: f64,
    /// Spring tension per length of edge at which it tears, N/m; 0 switches this rule off.
    pub tear_tension_n_per_m: f64,
    /// Strain of the retina as it lies on the choroid; its tension draws a lifted part flat.
    pub prestrain: f64,
    /// Adhesion to the choroid as an energy per area, N/m = J/m².
    pub adhesion_n_per_m: f64,
    /// Retina that is pressed on holds again where it is this near to the choroid, mm.
    pub lie_on_mm: f64,
    /// Pressure from which an injection flows and takes the retina off, Pa.
    pub flow_from_pa: f64,
    /// Flow for each kPa over that, µl/min.
    pub flow_ul_per_min_per_kpa: f64,
    /// Flow over which the simulator warns, µl/min.
    pub flow_warn_ul_per_min: f64,
    /// Distance within which an injection takes the retina off at once, mm for each kPa.
    pub detach_mm_per_kpa: f64,
    /// Depth behind the retina from which a needle hurts the choroid, mm.
    pub deep_mm: f64,
    /// Speed of a needle along the retina that warns, mm/s.
    pub needle_warn_mm_s: f64,
    /// Speed that tears, mm/s.
    pub needle_tear_mm_s: f64,
    /// Share of a needle's hole that stays open.
    pub hole_open_share: f64,
    /// Time in which a hole closes to a third of what will close, s.
    pub hole_close_s: f64,
    /// Pressure by which air drives fluid out from under the retina, Pa.
    pub air_pa: f64,
    /// Under air, fluid without a hole of its own seeps away under the pressed retina: height lost,
    /// µm/s.
    pub seep_um_per_s: f64,
    /// Share of a pressing tip's sideways way by which it drags loose retina along.
    pub drag: f64,
    /// Place of the optic disc, eye frame, mm: the nearest node never comes off, and a retina that
    /// is free all round turns about it. Left out, nothing but the ora holds.
    pub disc_in_eye_mm: Option<[f64; 3]>,
    /// What was done before the scene begins.
    pub operation: Option<RetinaOperation>,
}

/// An operation that has begun: the retina is off within a circle about the fovea, and may be cut
/// along another one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetinaOperation {
    /// Polar angle from the fovea up to which it is off the choroid, rad.
    pub detached_rad: f64,
    /// Fluid under it, mm³; 0 with a cut, through which it would flow.
    #[serde(default)]
    pub fluid_mm3: f64,
    /// Polar angle of a retinotomy all round, rad; 0 for none.
    #[serde(default)]
    pub cut_rad: f64,
}

impl RetinaScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        let mut ranges = vec![
            ("retina.rings", f64::from(self.rings), 4.0, 64.0),
            ("retina.stiffness_un_per_mm", self.stiffness_un_per_mm, 0.0, 1e7),
            ("retina.bending_un_per_mm", self.bending_un_per_mm, 0.0, 1e7),
            ("retina.spring_damping_un_s_per_mm", self.spring_damping_un_s_per_mm, 0.0, 1e6),
            ("retina.fluid_damping_per_s", self.fluid_damping_per_s, 0.0, 1e5),
            ("retina.node_mass_g", self.node_mass_g, 1e-9, 1e3),
            ("retina.a_max_mm_s2", self.a_max_mm_s2, 0.0, 1e12),
            ("retina.v_max_mm_s", self.v_max_mm_s, 1.0, 1e6),
            ("retina.p_tear", self.p_tear, 0.0, 1e9),
            ("retina.tear_tension_n_per_m", self.tear_tension_n_per_m, 0.0, 1e6),
            ("retina.prestrain", self.prestrain, 0.0, 0.5),
            ("retina.adhesion_n_per_m", self.adhesion_n_per_m, 0.0, 1e4),
            ("retina.lie_on_mm", self.lie_on_mm, 0.0, 1.0),
            ("retina.flow_from_pa", self.flow_from_pa, 0.0, 1e6),
            ("retina.flow_ul_per_min_per_kpa", self.flow_ul_per_min_per_kpa, 0.0, 1e3),
            ("retina.flow_warn_ul_per_min", self.flow_warn_ul_per_min, 0.0, 1e5),
            ("retina.detach_mm_per_kpa", self.detach_mm_per_kpa, 0.0, 1.0),
            ("retina.deep_mm", self.deep_mm, 0.0, 2.0),
            ("retina.needle_warn_mm_s", self.needle_warn_mm_s, 0.0, 1e3),
            ("retina.needle_tear_mm_s", self.needle_tear_mm_s, self.needle_warn_mm_s, 1e4),
            ("retina.hole_open_share", self.hole_open_share, 0.0, 1.0),
            ("retina.hole_close_s", self.hole_close_s, 1e-3, 1e4),
            ("retina.air_pa", self.air_pa, 0.0, 1e5),
            ("retina.seep_um_per_s", self.seep_um_per_s, 0.0, 1e4),
            ("retina.drag", self.drag, 0.0, 1.0),
        ];
        let disc = self.disc_in_eye_mm.iter().flatten();
        ranges.extend(disc.map(|&c| ("retina.disc_in_eye_mm", c, -20.0, 20.0)));
        if let Some(begun) = &self.operation {
            let fluid_mm3 = if begun.cut_rad > 0.0 { 0.0 } else { 2000.0 };
            ranges.extend([
                ("retina.operation.detached_rad", begun.detached_rad, 0.05, 1.5),
                ("retina.operation.fluid_mm3", begun.fluid_mm3, 0.0, fluid_mm3),
                ("retina.operation.cut_rad", begun.cut_rad, 0.0, begun.detached_rad),
            ]);
        }
        ranges
    }
}
