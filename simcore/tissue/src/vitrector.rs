//! Vitrector: a port in the side of the shaft that sucks, and a blade inside that closes it with
//! the cut rate.
//!
//! The port lies along the instrument's +x, [`PORT_HEIGHT_MM`] above the tip. Suction acts in a
//! [`Cone`] whose apex lies on the shaft's axis behind the port (the paper, section 3.3.2: the
//! viewing frustum of a camera in the port). The pressure of a point sink falls with the reciprocal
//! distance, p(d) = p₀ r/d outside of the port's radius r (potential flow), so that the force on a
//! piece of tissue of area a is p(d)·a towards the port: Pa · mm² = µN.
//!
//! The blade turns with simulated time alone: [`Cutter`] counts time × rate in whole numbers.
//! Cutting is at the instant at which the port closes; with the rate at 0 the blade rests and the
//! port is open.

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};
use protocol::handles::{PORT_HEIGHT_MM, PORT_RADIUS_MM};
use scene::VitrectorScene;
use serde::{Deserialize, Serialize};

/// The suction cone of a port, eye frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// Apex: on the shaft's axis behind the port, mm.
    pub apex_in_eye_mm: Vector3<f64>,
    /// Out of the port.
    pub axis_in_eye: UnitVector3<f64>,
    /// Tangent of the half angle.
    pub tan_half_angle: f64,
    /// How far from the apex, measured along the axis, suction acts, mm.
    pub reach_mm: f64,
}

impl Cone {
    /// The cone of an instrument.
    pub fn new(eye_from_instrument: &Isometry3<f64>, scene: &VitrectorScene) -> Self {
        let apex = eye_from_instrument * Point3::new(0.0, 0.0, PORT_HEIGHT_MM);
        Cone {
            apex_in_eye_mm: apex.coords,
            axis_in_eye: eye_from_instrument.rotation * Vector3::x_axis(),
            tan_half_angle: libm::tan(scene.cone_half_angle_rad),
            reach_mm: scene.cone_reach_mm,
        }
    }

    /// Distance from the apex in mm of a point that lies in the cone; `None` outside.
    pub fn distance_mm(&self, at_in_eye_mm: &Vector3<f64>) -> Option<f64> {
        let way = at_in_eye_mm - self.apex_in_eye_mm;
        let along = way.dot(&self.axis_in_eye);
        let aside2 = way.norm_squared() - along * along;
        let width = along * self.tan_half_angle;
        (along > 0.0 && along <= self.reach_mm && aside2 <= width * width).then(|| way.norm())
    }
}

/// The port during a substep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Port {
    /// Where it sucks.
    pub cone: Cone,
    /// Radius of the opening, mm.
    pub radius_mm: f64,
    /// From the apex to the end of the port, mm: what lies within this length and the radius is
    /// **in** the port.
    pub depth_mm: f64,
    /// Open at the end of the substep; a closed port does not suck.
    pub open: bool,
    /// It closed during the substep, and cut what was in it.
    pub cuts: bool,
    /// Suction at the port, Pa; 0 or more.
    pub suction_pa: f64,
}

impl Port {
    /// The port of an instrument whose shaft has the radius `shaft_radius_mm`.
    pub fn new(
        eye_from_instrument: &Isometry3<f64>,
        shaft_radius_mm: f64,
        scene: &VitrectorScene,
        blade: Blade,
        suction_pa: f64,
    ) -> Self {
        Port {
            cone: Cone::new(eye_from_instrument, scene),
            radius_mm: PORT_RADIUS_MM,
            depth_mm: shaft_radius_mm + PORT_RADIUS_MM,
            open: blade.open,
            cuts: blade.cuts,
            suction_pa,
        }
    }

    /// True for a point in the port.
    pub fn holds(&self, at_in_eye_mm: &Vector3<f64>) -> bool {
        let way = at_in_eye_mm - self.cone.apex_in_eye_mm;
        let along = way.dot(&self.cone.axis_in_eye);
        let aside2 = way.norm_squared() - along * along;
        along >= 0.0 && along <= self.depth_mm && aside2 <= self.radius_mm * self.radius_mm
    }

    /// Suction at a distance from the apex, Pa; 0 while closed.
    pub fn pressure_pa(&self, distance_mm: f64) -> f64 {
        if !self.open {
            return 0.0;
        }
        let near = distance_mm <= self.radius_mm;
        if near { self.suction_pa } else { self.suction_pa * self.radius_mm / distance_mm }
    }

    /// Force on a piece of tissue of `area_mm2` that lies `way_mm` before the apex (vector from the
    /// tissue to the apex), µN. Within the port's radius it falls to 0 with the distance, so that
    /// what is in the port is not thrown about.
    pub fn pull_un(&self, way_mm: &Vector3<f64>, area_mm2: f64) -> Vector3<f64> {
        let distance = way_mm.norm();
        let length = if distance > self.radius_mm { distance } else { self.radius_mm };
        way_mm * (self.pressure_pa(distance) * area_mm2 / length)
    }
}

/// One turn of the blade in the unit of [`Cutter::turned`]: 1 cut/min for 60·10⁹ ns.
const TURN: u64 = 60_000_000_000;

/// How far the blade is in its turn: open first, then closed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cutter {
    /// Cuts per minute × ns since the port opened last, below 60·10⁹.
    pub turned: u64,
}

/// What the blade did in a substep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Blade {
    /// The port is open at its end.
    pub open: bool,
    /// The port closed during it.
    pub cuts: bool,
}

impl Cutter {
    /// True if a state may hold this number.
    pub fn is_sound(&self) -> bool {
        self.turned < TURN
    }

    /// Turns the blade for `dt_ns`. `open_share` is the share of a turn for which the port is open
    /// (duty cycle, above 0 and below 1). At most one cut is made: rates above 60·10⁹/`dt_ns` per
    /// minute are cut down to it.
    pub fn turn(&mut self, cuts_per_min: u32, open_share: f64, dt_ns: u64) -> Blade {
        if cuts_per_min == 0 {
            self.turned = 0;
            return Blade { open: true, cuts: false };
        }
        let closes_at = (open_share * TURN as f64) as u64;
        let was_open = self.turned < closes_at;
        let way = (u64::from(cuts_per_min) * dt_ns).min(TURN);
        let to = self.turned + way;
        let cuts = (was_open && to >= closes_at) || to >= TURN + closes_at;
        self.turned = to % TURN;
        Blade { open: self.turned < closes_at, cuts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn scene() -> VitrectorScene {
        VitrectorScene::default()
    }

    #[test]
    fn the_port_looks_along_x_of_the_instrument() {
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.4, 1.1);
        let pose = Isometry3::from_parts(Translation3::new(1.0, 2.0, -9.0), turn);
        let port = Port::new(&pose, 0.25, &scene(), Blade { open: true, cuts: false }, 1000.0);
        let at = |x: f64, y: f64, z: f64| (pose * Point3::new(x, y, z)).coords;
        let distance = port.cone.distance_mm(&at(0.8, 0.0, PORT_HEIGHT_MM)).unwrap();
        assert!((distance - 0.8).abs() < 1e-12);
        assert_eq!(port.cone.distance_mm(&at(-0.8, 0.0, PORT_HEIGHT_MM)), None, "behind the shaft");
        assert_eq!(port.cone.distance_mm(&at(0.1, 0.4, PORT_HEIGHT_MM)), None, "beside the cone");
        assert_eq!(port.cone.distance_mm(&at(scene().cone_reach_mm + 0.01, 0.0, PORT_HEIGHT_MM)), None);
        assert!(
            port.holds(&at(0.3, 0.1, PORT_HEIGHT_MM)) && !port.holds(&at(0.3, 0.0, PORT_HEIGHT_MM + 0.2))
        );
    }

    #[test]
    fn suction_falls_with_the_reciprocal_distance_and_ends_with_the_port() {
        let pose = Isometry3::identity();
        let mut port = Port::new(&pose, 0.25, &scene(), Blade { open: true, cuts: false }, 30_000.0);
        let products = [0.2, 0.5, 1.3].map(|d| port.pressure_pa(d) * d);
        assert!(products.iter().all(|p| (p - 30_000.0 * PORT_RADIUS_MM).abs() < 1e-9), "{products:?}");
        assert_eq!(port.pressure_pa(0.01), 30_000.0, "never more than at the port");
        let pull = port.pull_un(&Vector3::new(0.0, -0.6, 0.0), 0.05);
        assert!((pull - Vector3::new(0.0, -30_000.0 * PORT_RADIUS_MM / 0.6 * 0.05, 0.0)).norm() < 1e-9);
        assert!(port.pull_un(&Vector3::new(0.0, 0.0, 1e-6), 0.05).norm() < 0.1, "nothing at the apex");
        port.open = false;
        assert_eq!(port.pressure_pa(0.5), 0.0);
    }

    #[test]
    fn a_blade_at_rest_leaves_the_port_open() {
        let mut cutter = Cutter { turned: TURN - 1 };
        assert_eq!(cutter.turn(0, 0.5, 1_000_000), Blade { open: true, cuts: false });
    }

    proptest! {
        /// Cuts in a minute are the rate, whatever the step; the port is open for its share of the
        /// time.
        #[test]
        fn the_rate_is_kept(rate in 60u32..20_000, share in 0.2f64..0.8, dt_us in 200u64..2_000) {
            let mut cutter = Cutter::default();
            let steps = 10_000_000 / dt_us;
            let (mut cuts, mut open) = (0u32, 0u64);
            for _ in 0..steps {
                let blade = cutter.turn(rate, share, dt_us * 1000);
                cuts += u32::from(blade.cuts);
                open += u64::from(blade.open);
            }
            let expected = f64::from(rate) * (steps * dt_us) as f64 / 60e6;
            prop_assert!((f64::from(cuts) - expected).abs() <= 1.0, "{} {}", cuts, expected);
            // Samples at the ends of the substeps: evenly spread over the turn unless the rate
            // divides the step.
            if rate < 2_000 {
                let found = open as f64 / steps as f64;
                prop_assert!((found - share).abs() < 0.06, "{} {}", found, share);
            }
        }
    }
}
