//! The microscope's optics: key `optics`. A scene that does not say so looks without a lens.

use super::{Defect, MicroscopeScene, Range, SceneFile, refuse};
use protocol::optics::{Filter, Lens};
use protocol::scene::Microscope;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

/// Most steps of magnification.
const MOST_STEPS: usize = 10;

/// Lens, inverter, steps and filter at the start. See `docs/microscope.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpticsScene {
    /// The lens.
    pub lens: Lens,
    /// The inverter (prism) turns the picture by half a turn and exchanges the channels.
    pub inverter: bool,
    /// Diameter of a channel's beam at the objective, by which things out of focus blur, mm.
    pub aperture_mm: f64,
    /// Fields of view of the steps of magnification, mm, falling.
    pub steps_mm: Vec<f64>,
    /// Focal length of the wide-angle lens, mm.
    pub focal_mm: f64,
    /// Height of the wide-angle lens over the centre of the eye, mm.
    pub lens_height_mm: f64,
    /// The lamp's colour filter.
    pub filter: Filter,
}

impl Default for OpticsScene {
    /// Steps of a five-step changer about a field of 16 mm. The beam is narrower than an
    /// objective's (10 to 16 mm), because the viewer's eye cannot accommodate on a display. The
    /// wide-angle lens is one of 83 dioptres that stands 9.5 mm over the cornea, so that the
    /// microscope looks through a point 8.8 mm over the centre of the eye: its pupil.
    fn default() -> Self {
        OpticsScene {
            lens: Lens::None,
            inverter: false,
            aperture_mm: 4.0,
            steps_mm: vec![27.0, 16.0, 10.0, 6.4, 4.0],
            focal_mm: 12.0,
            lens_height_mm: 21.5,
            filter: Filter::Clear,
        }
    }
}

/// What a scene without the table has.
static USUAL: LazyLock<OpticsScene> = LazyLock::new(OpticsScene::default);

impl SceneFile {
    /// Its optics, or the usual ones.
    pub fn optics_or_usual(&self) -> &OpticsScene {
        self.optics.as_ref().unwrap_or(&USUAL)
    }
}

impl OpticsScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("optics.aperture_mm", self.aperture_mm, 0.0, 30.0),
            ("optics.focal_mm", self.focal_mm, 5.0, 25.0),
            ("optics.lens_height_mm", self.lens_height_mm, 15.0, 40.0),
        ]
    }

    /// The first thing that makes no sense beyond a plain range: field, what was expected, what was
    /// found.
    pub(super) fn defect(&self, microscope: &MicroscopeScene) -> Option<Defect> {
        let falls = self.steps_mm.windows(2).all(|w| w[0] > w[1]);
        let in_range = self.steps_mm.iter().all(|s| (1.0..=60.0).contains(s));
        if !falls || !in_range || !(1..=MOST_STEPS).contains(&self.steps_mm.len()) {
            let expected = format!("1 to {MOST_STEPS} fields of 1 to 60 mm, falling");
            return refuse("optics.steps_mm", expected, format!("{:?}", self.steps_mm));
        }
        // The target must lie well beyond the lens's focus, or there is no picture in the air.
        let over_target = self.lens_height_mm - microscope.target_in_world_mm[2];
        if over_target < 1.25 * self.focal_mm {
            let expected = format!("at least {:.1} mm over the target", 1.25 * self.focal_mm);
            return refuse("optics.lens_height_mm", expected, format!("{over_target:.1} mm over it"));
        }
        None
    }
}

impl SceneFile {
    /// The microscope at the start.
    pub fn start_microscope(&self) -> Microscope {
        let (scene, optics) = (&self.microscope, self.optics_or_usual());
        Microscope {
            target_in_world_mm: scene.target_in_world_mm,
            working_distance_mm: scene.working_distance_mm,
            stereo_base_mm: scene.stereo_base_mm,
            field_mm: scene.field_mm,
            focus_mm: 0.0,
            aperture_mm: optics.aperture_mm,
            lens_focal_mm: optics.focal_mm,
            lens_height_mm: optics.lens_height_mm,
            lens: optics.lens as u32,
            inverter: u32::from(optics.inverter),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(table: &str) -> Result<SceneFile, String> {
        let text = SceneFile::load("peel").unwrap().to_toml();
        SceneFile::parse(&format!("{text}\n[optics]\n{table}"), "test").map_err(|e| e.to_string())
    }

    #[test]
    fn a_table_of_its_own_is_read_and_bad_values_are_named() {
        let scene = with("lens = \"wide-angle\"\ninverter = true\nfilter = \"amber\"\n").unwrap();
        assert_eq!(scene, SceneFile::parse(&scene.to_toml(), "again").unwrap());
        assert!(with("lens = \"fisheye\"\n").unwrap_err().contains("wide-angle"));
        assert!(with("steps_mm = [10.0, 16.0]\n").unwrap_err().contains("optics.steps_mm"));
        assert!(with("aperture_mm = -1.0\n").unwrap_err().contains("optics.aperture_mm"));
        let near = with("lens_height_mm = 15.0\nfocal_mm = 25.0\n").unwrap_err();
        assert!(near.contains("optics.lens_height_mm") && near.contains("31.2 mm over"), "{near}");
    }
}
