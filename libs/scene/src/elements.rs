//! A membrane as a continuum in place of springs: key `membrane.elements`.

use super::{Defect, Range, refuse};
use serde::{Deserialize, Serialize};

/// Membrane triangles of constant strain, for the implicit and the quasi-static integrator. Springs
/// stay where they are not of the material: their damping, and bending.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElementsScene {
    /// How stress follows from strain.
    pub law: ElementsLaw,
    /// Young's modulus times thickness, µN/mm (1 N/m is 1,000 of them).
    pub young_un_per_mm: f64,
    /// Poisson's ratio; a neo-Hookean membrane is incompressible and has none to choose.
    pub poisson: Option<f64>,
}

/// Law of a membrane's material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ElementsLaw {
    /// Linear between Green's strain and the second Piola–Kirchhoff stress: for strains of some per
    /// cent.
    StVenantKirchhoff,
    /// Incompressible rubber, for any stretch.
    NeoHookean,
}

/// Poisson's ratio where the scene names none.
const USUAL_POISSON: f64 = 0.45;

impl ElementsScene {
    /// Poisson's ratio of the St. Venant–Kirchhoff law.
    pub fn poisson(&self) -> f64 {
        self.poisson.unwrap_or(USUAL_POISSON)
    }

    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("membrane.elements.young_un_per_mm", self.young_un_per_mm, 1e-3, 1e7),
            ("membrane.elements.poisson", self.poisson(), -0.99, 0.99),
        ]
    }

    pub(super) fn defect(&self) -> Option<Defect> {
        let chosen = self.poisson.filter(|_| self.law == ElementsLaw::NeoHookean)?;
        let expected = "no such key with law \"neo-hookean\", which is incompressible";
        refuse("membrane.elements.poisson", expected, chosen)
    }
}
