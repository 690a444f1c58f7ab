//! What the tools of a scene can do: keys `vitrector` and `needle`. A scene that does not say so
//! has the figures of the defaults.

use super::Range;
use serde::{Deserialize, Serialize};

/// The vitrector and its pump.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VitrectorScene {
    /// Suction with the pedal fully pressed, Pa.
    pub suction_pa: f64,
    /// Cut rate with the pedal's second axis fully pressed, cuts/min.
    pub cuts_per_min: u32,
    /// Share of a cut for which the port is open.
    pub open_share: f64,
    /// Half angle of the suction cone, rad.
    pub cone_half_angle_rad: f64,
    /// How far from the shaft's axis suction acts, mm.
    pub cone_reach_mm: f64,
    /// Pixels along a side of the suction camera's image.
    pub resolution: u32,
    /// Thickness of the membrane, by which a removed area becomes a volume, mm.
    pub membrane_thickness_mm: f64,
}

impl Default for VitrectorScene {
    /// 650 mmHg and 7,500 cuts/min, the upper end of common machines; a membrane of 20 µm.
    fn default() -> Self {
        VitrectorScene {
            suction_pa: 86_660.0,
            cuts_per_min: 7_500,
            open_share: 0.5,
            cone_half_angle_rad: 0.6,
            cone_reach_mm: 1.5,
            resolution: 32,
            membrane_thickness_mm: 0.02,
        }
    }
}

impl VitrectorScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("vitrector.suction_pa", self.suction_pa, 0.0, 100_000.0),
            ("vitrector.cuts_per_min", f64::from(self.cuts_per_min), 0.0, 30_000.0),
            ("vitrector.open_share", self.open_share, 0.05, 0.95),
            ("vitrector.cone_half_angle_rad", self.cone_half_angle_rad, 0.2, 1.3),
            ("vitrector.cone_reach_mm", self.cone_reach_mm, 0.1, 10.0),
            ("vitrector.resolution", f64::from(self.resolution), 8.0, 256.0),
            ("vitrector.membrane_thickness_mm", self.membrane_thickness_mm, 0.0, 1.0),
        ]
    }
}

/// The needle and its syringe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NeedleScene {
    /// Outer radius of the needle, mm.
    pub radius_mm: f64,
    /// Pressure at the tip with the pedal fully pressed, Pa.
    pub pressure_pa: f64,
    /// Force along the shaft at which the needle pierces the membrane instead of pushing it, µN.
    pub pierce_un: f64,
}

impl Default for NeedleScene {
    /// A 41G needle (outer diameter 0.1 mm); 12 psi, twice the pressure from which a subretinal
    /// injection flows.
    fn default() -> Self {
        NeedleScene { radius_mm: 0.05, pressure_pa: 82_740.0, pierce_un: 40.0 }
    }
}

impl NeedleScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("needle.radius_mm", self.radius_mm, 0.01, 1.0),
            ("needle.pressure_pa", self.pressure_pa, 0.0, 1e6),
            ("needle.pierce_un", self.pierce_un, 0.0, 1e9),
        ]
    }
}
