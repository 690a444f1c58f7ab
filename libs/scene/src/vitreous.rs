//! The vitreous body of a scene: key `vitreous`.

use super::{Defect, Range, refuse};
use serde::{Deserialize, Serialize};

/// Most zones a scene may have.
const MAX_ZONES: usize = 15;

/// The gel that fills the eye, as elements of a chain mail on a lattice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VitreousScene {
    /// Elements along the eye's diameter; the lattice is clipped to the eye's ball.
    pub lattice: u32,
    /// Back of the lens: no gel at a larger z of the eye frame, mm.
    pub front_mm: f64,
    /// The gel where no zone says otherwise.
    pub gel: GelScene,
    /// Parts with a gel of their own; a later one wins where two overlap.
    #[serde(default)]
    pub zones: Vec<ZoneScene>,
    /// How it holds to the retina.
    pub adhesion: VitreousAdhesionScene,
    /// How far a shaft takes the gel along before it slips through it, mm along each axis.
    pub slip_mm: f64,
    /// How it comes back.
    pub relaxation: RelaxationScene,
    /// How the vitrector takes it.
    pub suction: SuctionScene,
}

/// What a gel allows and how it looks. The limits are shares of the lattice's spacing, per axis of
/// the eye frame: two neighbours along an axis may come nearer by `compress` and part by `stretch`,
/// and slip across it by `shear`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GelScene {
    /// By how much neighbours along x, y and z may come nearer.
    pub compress: [f64; 3],
    /// By how much neighbours along x, y and z may part.
    pub stretch: [f64; 3],
    /// By how much neighbours along x, y and z may slip across that axis.
    pub shear: [f64; 3],
    /// Shear modulus, Pa.
    pub modulus_pa: f64,
    /// Density that is drawn, 0 to 255.
    pub density: u32,
}

/// A part of the vitreous.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneScene {
    /// What it is, for people.
    pub name: String,
    /// Where it is: everything within this depth of the retina, mm; 0 for none.
    #[serde(default)]
    pub shell_mm: f64,
    /// Or a ball: its centre in the eye frame, mm.
    #[serde(default)]
    pub centre_in_eye_mm: [f64; 3],
    /// Radius of the ball, mm; 0 for none.
    #[serde(default)]
    pub radius_mm: f64,
    /// Only from this z on, mm.
    #[serde(default = "everywhere")]
    pub from_z_mm: f64,
    /// Its gel.
    pub gel: GelScene,
}

fn everywhere() -> f64 {
    -30.0
}

/// How the gel holds to the retina. Stresses are those of the gel at the wall, Pa.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VitreousAdhesionScene {
    /// From this z on it is the vitreous base, which never lets go, mm.
    pub base_from_z_mm: f64,
    /// Stress that warns.
    pub warn_pa: f64,
    /// Stress at the base at which the retina may tear.
    pub tear_pa: f64,
    /// Stress at which the gel behind the base comes off the retina.
    pub release_pa: f64,
    /// The same within `strong_rad` of the optic disc and the fovea, where it holds best.
    pub strong_release_pa: f64,
    /// Half angle of these places, rad.
    pub strong_rad: f64,
    /// Half angle about the posterior pole (−z) within which it is detached from the start, rad.
    pub detached_rad: f64,
}

/// How the gel comes back after it was moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelaxationScene {
    /// Share of the way to its neighbours' middle that an element goes at a time.
    pub share: f64,
    /// Weight of an element's own rest place beside one neighbour's.
    pub rest_weight: f64,
    /// Rows of the lattice done every 20 ms; a bound on the work.
    pub rows: u32,
}

/// How the vitrector takes the gel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuctionScene {
    /// Speed at which gel flows towards the port for each kPa of suction where it is, mm/s.
    pub speed_mm_s_per_kpa: f64,
    /// Elements nearer than this to the port's middle when it cuts and sucks are gone, mm.
    pub bite_mm: f64,
    /// Removed volume from one event to the next, ml.
    pub milestone_ml: f64,
}

impl GelScene {
    fn defect(&self, place: &str) -> Option<Defect> {
        let limits = [("compress", self.compress), ("stretch", self.stretch), ("shear", self.shear)];
        for (name, values) in limits {
            if let Some(value) = values.iter().find(|v| !(0.02..=0.9).contains(*v)) {
                return refuse(format!("{place}.{name}"), "0.02 to 0.9", value);
            }
        }
        for axis in 0..3 {
            // Then the edges of every cell keep their order and no cell can turn inside out.
            if 1.0 - self.compress[axis] <= 2.0 * self.shear[axis] + 0.01 {
                let found = format!("compress {} and shear {}", self.compress[axis], self.shear[axis]);
                let expected = "1 − compress above 2·shear, so that no cell turns over";
                return refuse(format!("{place}.shear[{axis}]"), expected, found);
            }
        }
        if !(0.0..=1e6).contains(&self.modulus_pa) {
            return refuse(format!("{place}.modulus_pa"), "0 to 1e6", self.modulus_pa);
        }
        if self.density > 255 {
            return refuse(format!("{place}.density"), "0 to 255", self.density);
        }
        None
    }
}

impl VitreousScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        let (a, r, s) = (&self.adhesion, &self.relaxation, &self.suction);
        vec![
            ("vitreous.lattice", f64::from(self.lattice), 8.0, 96.0),
            ("vitreous.front_mm", self.front_mm, -5.0, 20.0),
            ("vitreous.slip_mm", self.slip_mm, 0.0, 10.0),
            ("vitreous.adhesion.base_from_z_mm", a.base_from_z_mm, -20.0, 20.0),
            ("vitreous.adhesion.warn_pa", a.warn_pa, 0.0, 1e9),
            ("vitreous.adhesion.tear_pa", a.tear_pa, 0.0, 1e9),
            ("vitreous.adhesion.release_pa", a.release_pa, 0.0, 1e9),
            ("vitreous.adhesion.strong_release_pa", a.strong_release_pa, 0.0, 1e9),
            ("vitreous.adhesion.strong_rad", a.strong_rad, 0.0, 1.0),
            ("vitreous.adhesion.detached_rad", a.detached_rad, 0.0, 3.2),
            ("vitreous.relaxation.share", r.share, 0.0, 1.0),
            ("vitreous.relaxation.rest_weight", r.rest_weight, 0.001, 10.0),
            ("vitreous.relaxation.rows", f64::from(r.rows), 0.0, 100_000.0),
            ("vitreous.suction.speed_mm_s_per_kpa", s.speed_mm_s_per_kpa, 0.0, 100.0),
            ("vitreous.suction.bite_mm", s.bite_mm, 0.0, 3.0),
            ("vitreous.suction.milestone_ml", s.milestone_ml, 0.001, 100.0),
        ]
    }

    /// What is wrong beyond the ranges: key, what would be right, what is there.
    pub(super) fn defect(&self, retina_radius_mm: f64) -> Option<Defect> {
        if retina_radius_mm > 16.0 {
            let expected = "at most 16 with a vitreous, whose places are whole µm of 16 bits";
            return refuse("eye.retina_radius_mm", expected, retina_radius_mm);
        }
        if let Some(defect) = self.gel.defect("vitreous.gel") {
            return Some(defect);
        }
        if self.zones.len() > MAX_ZONES {
            return refuse("vitreous.zones", format!("at most {MAX_ZONES}"), self.zones.len());
        }
        self.zones.iter().enumerate().find_map(|(i, zone)| {
            let place = format!("vitreous.zones[{i}]");
            let shape = [zone.shell_mm, zone.radius_mm];
            let sizes = shape.iter().all(|s| (0.0..=30.0).contains(s)) && shape.iter().any(|&s| s > 0.0);
            let centre = zone.centre_in_eye_mm.iter().chain([&zone.from_z_mm]);
            if !sizes || !centre.into_iter().all(|c| c.abs() <= 30.0) {
                let expected = "shell_mm or radius_mm above 0, every length at most 30 mm";
                return refuse(place, expected, format!("{zone:?}"));
            }
            zone.gel.defect(&format!("{place}.gel"))
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::SceneFile;

    #[test]
    fn defects_are_named() {
        let text = include_str!("../../../assets/scenes/vitrectomy.toml");
        SceneFile::parse(text, "vitrectomy").unwrap();
        let changes = [
            ("lattice = 64", "lattice = 640", "vitreous.lattice"),
            ("front_mm = ", "front_mm = nan #", "vitreous.front_mm"),
            ("shear = [", "shear = [0.5, 0.5, 0.5] #", "vitreous.gel.shear[0]"),
            ("stretch = [", "stretch = [0.0, 0.5, 0.5] #", "vitreous.gel.stretch"),
            ("shell_mm = ", "shell_mm = 0.0 #", "vitreous.zones[0]"),
            ("retina_radius_mm = 11.5", "retina_radius_mm = 17.0", "eye.retina_radius_mm"),
            ("rest_weight = ", "rest_weight = 0.0 #", "vitreous.relaxation.rest_weight"),
        ];
        for (from, to, field) in changes {
            let broken = text.replacen(from, to, 1);
            assert_ne!(broken, text, "{from} is not in the scene");
            let message = SceneFile::parse(&broken, "s.toml").unwrap_err().to_string();
            assert!(message.contains(field), "{message}");
        }
    }
}
