//! Figures of the retina: those of the scene in the units of the step, and the constants of the
//! method.

use crate::constants::SUBSTEP_S;
use scene::RetinaScene;

/// Pieces of loose retina that have a fluid account of their own; more pieces share the last one's.
pub const MAX_BLEBS: usize = 32;
/// Holes that are remembered.
pub const MAX_HOLES: usize = 32;
/// Time over which the pressure of a bleb is smoothed, s: longer than a node's swing on its
/// springs, shorter than anything a hand does.
pub const PRESSURE_S: f64 = 0.02;
/// The front is examined at this interval, substeps; a node that comes off changes the pull on its
/// neighbours, so that only the worst node of a bleb goes at a time. At most 250 nodes a second:
/// faster than any fluid can follow.
pub const FRONT_EVERY: u64 = 4;
/// Rounds in which a front node's load is added to its neighbours': after two it stands for five
/// nodes of front. Fewer let the corners of the lattice unzip the front far below its adhesion,
/// more would round off a real corner.
pub const FRONT_SMOOTHING: u32 = 2;
/// Time over which the speed of a needle is smoothed, s: half a field, so that a pose's noise is
/// not a speed.
pub const SPEED_S: f64 = 0.01;
/// A warning is armed again below this share of its limit.
pub const REARM: f64 = 0.8;
/// Contraction of a jet through a sharp hole (Torricelli's law with the usual coefficient of
/// discharge).
pub const DISCHARGE: f64 = 0.62;
/// Density of balanced salt solution, g/mm³.
pub const DENSITY: f64 = 1.0e-3;
/// A bleb loses at most this share of its fluid in a substep, so that a large tear does not empty
/// it past 0.
pub const LARGEST_LOSS: f64 = 0.1;
/// A bleb with larger gaps than this, mm², is open: fluid passes freely, and nothing is left of a
/// pressure. By Torricelli's law a pascal would drive more than the largest bleb's fluid through
/// them in a second.
pub const OPEN_MM2: f64 = 5.0;
/// Flow at which a fluid–air exchange drives fluid out of an open bleb, mm³/s: 12 ml/min, what an
/// air pump delivers through its line.
pub const EXCHANGE_MM3_S: f64 = 200.0;
/// An open bleb may lag behind the pump by so much of its flow, s; a larger lag is none that the
/// pump could make good by pressing on it.
pub const OPEN_LAG_S: f64 = 0.01;
/// A node that lies farther than this from where it lay at the start, mm, is drawn there: more than
/// the rounding of a place on the choroid.
pub const MOVED_MM: f32 = 0.01;
/// Retina this near to a loose node of its own bleb that holds less than this over its area counts
/// as lying on: the film that is left, mm, is taken up by the choroid.
pub const FILM_MM: f64 = 0.005;
/// A needle has left when its tip is so far before the retina, mm: larger than tremor, smaller than
/// a movement that is meant.
pub const LEFT_MM: f64 = 0.1;
/// How far behind the tip the shaft is looked at for where it passes the loose retina, mm; the
/// largest bleb is lower.
pub const SHAFT_MM: f64 = 8.0;
/// Volume error at which a step stops correcting, mm³: what the rounding of the nodes' f32
/// positions makes of a small bleb.
pub const VOLUME_ERROR_MM3: f64 = 1.0e-6;
/// Corrections at the end of a step.
pub const VOLUME_TRIES: u32 = 8;

const _: () = assert!(PRESSURE_S > 4.0 * SUBSTEP_S && SPEED_S > SUBSTEP_S);

/// Figures of a scene, in mm, g, s.
#[derive(Debug, Clone)]
pub struct Figures {
    /// As the scene says.
    pub scene: RetinaScene,
    /// Radius of the choroid, mm.
    pub radius_mm: f64,
    /// Energy that the front pays, µN/mm = µJ/m²·10³.
    pub adhesion_un_per_mm: f64,
    /// Stiffness of the lattice as a membrane, µN/mm: 2k/√3 for springs k on equilateral triangles
    /// (ν = 1/3).
    pub membrane_un_per_mm: f64,
    /// Tension of the retina as it lies, µN/mm: √3·k·ε, the same lattice stretched by ε in both
    /// directions.
    pub prestress_un_per_mm: f64,
    /// Area of a needle's hole, mm².
    pub hole_mm2: f64,
}

impl Figures {
    /// Of a scene.
    pub fn new(scene: &RetinaScene, radius_mm: f64, needle_radius_mm: f64) -> Self {
        let (k, root3) = (scene.stiffness_un_per_mm, libm::sqrt(3.0));
        Figures {
            radius_mm,
            hole_mm2: std::f64::consts::PI * needle_radius_mm * needle_radius_mm,
            adhesion_un_per_mm: scene.adhesion_n_per_m * 1e3,
            membrane_un_per_mm: 2.0 * k / root3,
            prestress_un_per_mm: root3 * k * scene.prestrain,
            scene: scene.clone(),
        }
    }

    /// Flow of an injection at `pressure_pa` into a bleb that is at `bleb_pa` already, mm³/s.
    pub fn flow_mm3_s(&self, pressure_pa: f64, bleb_pa: f64) -> f64 {
        let over_kpa = (pressure_pa - bleb_pa - self.scene.flow_from_pa) * 1e-3;
        if over_kpa > 0.0 { over_kpa * self.scene.flow_ul_per_min_per_kpa / 60.0 } else { 0.0 }
    }

    /// Distance from the needle within which an injection at `pressure_pa` takes the retina off at
    /// once (the paper's d), mm; 0 below the pressure from which it flows.
    pub fn detach_mm(&self, pressure_pa: f64) -> f64 {
        let flows = pressure_pa > self.scene.flow_from_pa;
        if flows { self.scene.detach_mm_per_kpa * pressure_pa * 1e-3 } else { 0.0 }
    }

    /// Flow out of an opening of `area_mm2` under `pressure_pa`, mm³/s (Torricelli); into it where
    /// the pressure is below 0.
    pub fn leak_mm3_s(area_mm2: f64, pressure_pa: f64) -> f64 {
        let speed = libm::sqrt(2.0 * pressure_pa.abs() / DENSITY);
        DISCHARGE * area_mm2 * if pressure_pa < 0.0 { -speed } else { speed }
    }

    /// What a node of the front would release if it came off, µN/mm, from the force per length of
    /// rim that it carries: `normal` away from the choroid, `inward` along it towards the bleb
    /// (Kendall 1975, with the energy of stretching over the retina's own tension).
    ///
    /// ```text
    /// G = T − T cos θ + (T − T₀)²/2E,   T = |(normal, inward)|,  T cos θ = inward
    /// ```
    pub fn release_un_per_mm(&self, normal: f64, inward: f64) -> f64 {
        if normal <= 0.0 {
            return 0.0;
        }
        let tension = libm::sqrt(normal * normal + inward * inward);
        let over = (tension - self.prestress_un_per_mm).max(0.0);
        let stretch =
            if self.membrane_un_per_mm > 0.0 { over * over / (2.0 * self.membrane_un_per_mm) } else { 0.0 };
        tension - inward + stretch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::SceneFile;

    fn figures() -> Figures {
        let scene = SceneFile::load("relocation").unwrap();
        Figures::new(scene.retina.as_ref().unwrap(), scene.eye.retina_radius_mm, 0.05)
    }

    #[test]
    fn nothing_flows_and_nothing_detaches_below_the_limit() {
        let f = figures();
        assert_eq!((f.flow_mm3_s(41_000.0, 0.0), f.detach_mm(41_000.0)), (0.0, 0.0));
        assert!(f.flow_mm3_s(50_000.0, 0.0) > 0.0 && f.detach_mm(50_000.0) > 0.0);
        assert_eq!(f.flow_mm3_s(50_000.0, 20_000.0), 0.0, "a bleb can stop it");
    }

    #[test]
    fn leaks_follow_torricelli() {
        // 500 Pa drive water at 1 m/s.
        assert!((Figures::leak_mm3_s(0.01, 500.0) - 0.62 * 0.01 * 1000.0).abs() < 1e-9);
        assert_eq!(Figures::leak_mm3_s(0.01, -500.0), -Figures::leak_mm3_s(0.01, 500.0));
    }

    /// A strip of unstretchable tape: peeled at 90° it takes force = adhesion × width, at 180° half
    /// of that.
    #[test]
    fn the_front_obeys_kendall_at_the_two_textbook_angles() {
        let f = Figures { membrane_un_per_mm: 1e12, ..figures() };
        assert!((f.release_un_per_mm(180.0, 0.0) - 180.0).abs() < 1e-6);
        assert!((f.release_un_per_mm(1e-9, -90.0) - 180.0).abs() < 1e-6);
        assert_eq!(f.release_un_per_mm(-10.0, 50.0), 0.0, "pressed on, nothing comes off");
    }

    proptest! {
        #[test]
        fn flow_and_front_are_monotone_in_the_pressure(p in 0.0f64..2e5, more in 0.0f64..1e5, bleb in -1e3f64..1e4) {
            let f = figures();
            prop_assert!(f.flow_mm3_s(p + more, bleb) >= f.flow_mm3_s(p, bleb));
            prop_assert!(f.detach_mm(p + more) >= f.detach_mm(p));
        }
    }
}
