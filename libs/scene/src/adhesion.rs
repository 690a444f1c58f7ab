//! How an epiretinal membrane sticks to the retina, and how it curls: keys `membrane.adhesion` and
//! `membrane.curl`.

use super::{Defect, Range, refuse};
use serde::{Deserialize, Serialize};

/// Glue between the membrane and the retina: an energy per area at every place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdhesionScene {
    /// Work that parts a unit of area, µN/mm (= mJ/m²; 1 N/m is 1,000 of them).
    pub energy_un_per_mm: f64,
    /// Separation at which a bond has broken, mm.
    pub range_mm: f64,
    /// The same energy within `rim_width_mm` of the membrane's edge, µN/mm.
    pub rim_energy_un_per_mm: f64,
    /// Width of the rim, mm; 0 for none.
    pub rim_width_mm: f64,
    /// Pull on the retina that warns, Pa.
    pub retina_warn_pa: f64,
    /// Pull at which the retina comes off the choroid and follows, Pa.
    pub retina_lift_pa: f64,
    /// Height at which a lifted retina tears, mm.
    pub retina_tear_mm: f64,
    /// Places with an energy of their own, the later over the earlier: epicentres, and edges that
    /// are loose (0).
    #[serde(default)]
    pub patches: Vec<PatchScene>,
}

/// A round place with another energy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchScene {
    /// Direction from the eye's centre to its middle, eye frame (any length).
    pub towards_in_eye: [f64; 3],
    /// Radius along the retina, mm.
    pub radius_mm: f64,
    /// Work that parts a unit of area, µN/mm; 0 where the membrane is loose from the start.
    pub energy_un_per_mm: f64,
}

/// What the membrane would roll up to if it were free.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurlScene {
    /// Bending stiffness E t³/12(1 − ν²), µN·mm.
    pub stiffness_un_mm: f64,
    /// Radius of the roll, mm; its hollow faces away from the retina.
    pub radius_mm: f64,
}

impl AdhesionScene {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("membrane.adhesion.energy_un_per_mm", self.energy_un_per_mm, 0.0, 1e6),
            ("membrane.adhesion.range_mm", self.range_mm, 1e-3, 5.0),
            ("membrane.adhesion.rim_energy_un_per_mm", self.rim_energy_un_per_mm, 0.0, 1e6),
            ("membrane.adhesion.rim_width_mm", self.rim_width_mm, 0.0, 5.0),
            ("membrane.adhesion.retina_warn_pa", self.retina_warn_pa, 0.0, 1e9),
            ("membrane.adhesion.retina_lift_pa", self.retina_lift_pa, self.retina_warn_pa, 1e9),
            ("membrane.adhesion.retina_tear_mm", self.retina_tear_mm, 1e-3, 5.0),
        ]
    }

    /// What is wrong beyond the ranges.
    pub(super) fn defect(&self) -> Option<Defect> {
        let bad = |p: &&PatchScene| {
            let length2: f64 = p.towards_in_eye.iter().map(|c| c * c).sum();
            let placed = length2.is_finite() && length2 > 1e-12;
            !placed || !(0.0..=20.0).contains(&p.radius_mm) || !(0.0..=1e6).contains(&p.energy_un_per_mm)
        };
        let patch = self.patches.iter().find(bad)?;
        let expected = "a direction, a radius of 0 to 20 mm and an energy of 0 to 1e6 µN/mm";
        refuse("membrane.adhesion.patches", expected, format!("{patch:?}"))
    }
}

impl CurlScene {
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("membrane.curl.stiffness_un_mm", self.stiffness_un_mm, 0.0, 1e6),
            ("membrane.curl.radius_mm", self.radius_mm, 0.01, 1e6),
        ]
    }
}
