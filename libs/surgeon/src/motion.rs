//! Poses of the instruments and of the eye at any instant, as the scripted surgeon moves them.
//!
//! Tips follow the script in the eye frame, with tremor or a recorded motion added. A shaft always
//! passes through its trocar, which the eye carries along; the eye turns under the shafts' load and
//! springs back. Everything is a function of the time since the start, of the seed, and of what the
//! surgeon has seen ([`MotionSource::see`]).

pub mod eye_spring;
pub mod recorded;

use crate::script::{Gesture, Perception, Script};
use crate::tremor::Tremor;
use eye_spring::EyeSpring;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use protocol::handles::{PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use recorded::RecordedMotion;
use rig::Rig;
use scene::SceneFile;
use std::f64::consts::TAU;

/// Turn of the eye by a tip that moves sideways from the middle of its movements, rad/mm.
const TURN_PER_MM: f64 = 0.003;
/// Turn about the line of sight as a share of the script's turn about x.
const TORSION_SHARE: f64 = 0.3;
/// Room kept between a fitted motion and the limit of the workspace, mm.
const FIT_MARGIN_MM: f64 = 0.5;
/// Height of a pivot where the rig has no trocar: straight above the eye, mm.
const PIVOT_WITHOUT_TROCAR_MM: f64 = 12.0;

/// Time after which the eye's swing no longer depends on how it began, ns.
const SETTLED_NS: u64 = 3_000_000_000;

/// Everything that moves, at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// `world_from_instrument` of each instrument; origin at the tip, +z along the shaft to the
    /// handle.
    pub world_from_instrument: [Isometry3<f64>; INSTRUMENTS],
    /// Rotation `world_from_eye`; the eye turns about the world's origin.
    pub world_from_eye: UnitQuaternion<f64>,
    /// Jaw opening of each instrument, rad.
    pub jaw_rad: [f64; INSTRUMENTS],
    /// Tool of each instrument.
    pub tool: [Tool; INSTRUMENTS],
}

impl Motion {
    /// `world_from_body` in the order of [`BODY_NAMES`].
    pub fn world_from_body(&self) -> [Isometry3<f64>; INSTRUMENTS + 1] {
        let eye = Isometry3::from_parts(Translation3::identity(), self.world_from_eye);
        [self.world_from_instrument[0], self.world_from_instrument[1], eye]
    }
}

/// How a recorded motion moves instrument 0.
#[derive(Debug, Clone)]
pub enum MotionUse {
    /// Its part above 1 Hz takes the place of the tremor.
    Tremor(RecordedMotion),
    /// It moves the tip; the script only opens and closes the jaws.
    Full(RecordedMotion),
}

/// A scripted surgeon with tremor, a recorded motion, and the eye that the shafts turn.
#[derive(Debug, Clone)]
pub struct MotionSource {
    script: Script,
    tremor: [Tremor; INSTRUMENTS],
    recorded: Option<MotionUse>,
    eye: EyeSpring,
    load: Load,
    trocars_in_eye: [Vector3<f64>; INSTRUMENTS],
}

impl MotionSource {
    /// The surgeon of a scene, at the instruments of a rig. A recorded motion takes the place of
    /// the tremor of instrument 0 or, fitted to the workspace, of its movement.
    pub fn new(scene: &SceneFile, rig: &Rig, recorded: Option<MotionUse>, seed: u64) -> Self {
        let script = Script::new(scene);
        let recorded = recorded.map(|motion| match motion {
            MotionUse::Tremor(motion) => MotionUse::Tremor(motion.fast_part()),
            MotionUse::Full(motion) => {
                let room = rig.workspace.tip_radius - script.mean_tip_in_eye_mm(0).norm() - FIT_MARGIN_MM;
                MotionUse::Full(motion.fitted(room.max(FIT_MARGIN_MM)))
            }
        });
        let written = scene.script_or_rest();
        let (rms_um, hz) = (written.tremor_um, written.tremor_hz);
        let trocar = |name: &str| {
            let given = rig.trocar(name).map(|t| Vector3::from(t.p_eye));
            given.unwrap_or(Vector3::z() * PIVOT_WITHOUT_TROCAR_MM)
        };
        let load = Load {
            turn_rad: written.eye_turn_rad,
            period_s: script.period_s(),
            middle: std::array::from_fn(|i| script.mean_tip_in_eye_mm(i)),
        };
        MotionSource {
            eye: EyeSpring::new(load.at(&script, 0.0)),
            tremor: std::array::from_fn(|i| Tremor::new(rms_um, hz, seed, i as u64)),
            trocars_in_eye: std::array::from_fn(|i| trocar(BODY_NAMES[i])),
            script,
            recorded,
            load,
        }
    }

    /// The script, with the reactions so far.
    pub fn script(&self) -> &Script {
        &self.script
    }

    /// Goes on with a script as it stood `t_ns` after the start. The eye swings as it did, but for
    /// what is left of movements of [`SETTLED_NS`] before.
    pub fn go_on(&mut self, script: Script, t_ns: u64) {
        self.script = script;
        let from_ns = t_ns.saturating_sub(SETTLED_NS);
        self.eye = EyeSpring::at_rest(from_ns, self.load.at(&self.script, from_ns as f64 * 1e-9));
    }

    /// Length of a round of the script, s, retries so far included.
    pub fn period_s(&self) -> f64 {
        self.script.period_s()
    }

    /// True if the script reacts to perception.
    pub fn is_reactive(&self) -> bool {
        self.script.is_reactive()
    }

    /// True if the script reacts to perception once all fields until `t_ns` after the start are
    /// exposed.
    pub fn perceives_now(&self, t_ns: u64) -> bool {
        self.script.perceives_now(t_ns as f64 * 1e-9)
    }

    /// Feeds back perception, once all fields until `t_ns` after the start are exposed.
    pub fn see(&mut self, t_ns: u64, perception: &dyn Perception) {
        self.script.see(t_ns as f64 * 1e-9, perception);
    }

    /// Motion `t_ns` after the start: a function of `t_ns` and of the perception before it. Rising
    /// instants are cheapest, because the eye's rotation is integrated from the start.
    pub fn at(&mut self, t_ns: u64) -> Motion {
        let t_s = t_ns as f64 * 1e-9;
        let (script, load) = (&self.script, &self.load);
        let world_from_eye = self.eye.world_from_eye(t_ns, |t| load.at(script, t));
        let gestures: [Gesture; INSTRUMENTS] = std::array::from_fn(|i| self.gesture(i, t_s));
        let world_from_instrument = std::array::from_fn(|i| {
            let eye_from_instrument = gestures[i].eye_from_instrument(self.trocars_in_eye[i]);
            Isometry3::from_parts(Translation3::identity(), world_from_eye) * eye_from_instrument
        });
        let (jaw_rad, tool) = (gestures.map(|g| g.jaw_rad), gestures.map(|g| g.tool));
        Motion { world_from_instrument, world_from_eye, jaw_rad, tool }
    }

    /// The pedal `t_ns` after the start, as message `seq` of the instant `instant_ns`.
    pub fn pedal_at(&self, t_ns: u64, seq: u64, instant_ns: u64) -> PedalState {
        self.script.pedal_at(t_ns as f64 * 1e-9, seq, instant_ns)
    }

    /// Script with tremor or recorded motion.
    fn gesture(&self, instrument: usize, t_s: f64) -> Gesture {
        let mut gesture = self.script.at(instrument, t_s);
        match &self.recorded {
            Some(MotionUse::Tremor(motion)) if instrument == 0 => gesture.tip_in_eye_mm += motion.at(t_s),
            Some(MotionUse::Full(motion)) if instrument == 0 => {
                gesture.tip_in_eye_mm = self.script.mean_tip_in_eye_mm(0) + motion.at(t_s);
            }
            _ => gesture.tip_in_eye_mm += self.tremor[instrument].at(t_s),
        }
        gesture
    }
}

/// Turns the eye: a slow swing over the script's round, and the tips that lever sideways.
#[derive(Debug, Clone)]
struct Load {
    /// Amplitude about x and y, rad.
    turn_rad: [f64; 2],
    period_s: f64,
    /// Middle of each tip's movement in the eye frame, mm.
    middle: [Vector3<f64>; INSTRUMENTS],
}

impl Load {
    /// Angle at which shafts and springs balance, rad about x, y and z of the world.
    fn at(&self, script: &Script, t_s: f64) -> Vector3<f64> {
        let phase = TAU * t_s / self.period_s;
        let [about_x, about_y] = self.turn_rad;
        let swing = Vector3::new(
            about_x * libm::sin(phase),
            about_y * libm::sin(2.0 * phase + 1.0),
            TORSION_SHARE * about_x * libm::sin(3.0 * phase + 2.0),
        );
        let aside = |i: usize| script.at(i, t_s).tip_in_eye_mm - self.middle[i];
        let lever = (0..INSTRUMENTS).map(aside).sum::<Vector3<f64>>() * TURN_PER_MM;
        // A tip below the pivot that moves towards +y pushes the eye's lower half along: it turns
        // about +x; one that moves towards +x turns it about −y.
        swing + Vector3::new(lever.y, -lever.x, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::DEFAULT_SCENE;

    fn source(recorded: Option<MotionUse>) -> (MotionSource, Rig) {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        (MotionSource::new(&scene, &rig, recorded, 7), rig)
    }

    fn recording(mm: f64) -> RecordedMotion {
        let row = |i: usize| {
            format!("{i},{},{},5,0\n", mm * libm::sin(i as f64 * 0.02), 0.03 * ((i / 14) % 2) as f64)
        };
        RecordedMotion::parse(&(0..3000).map(row).collect::<String>(), "h").unwrap()
    }

    proptest! {
        #[test]
        fn shafts_pass_their_trocars(t_ns in 0u64..30_000_000_000) {
            let (mut source, rig) = source(None);
            let motion = source.at(t_ns);
            for i in 0..INSTRUMENTS {
                let trocar = motion.world_from_eye * Vector3::from(rig.trocars[i].p_eye);
                let in_instrument = motion.world_from_instrument[i].inverse() * nalgebra::Point3::from(trocar);
                prop_assert!(in_instrument.x.abs() < 1e-9 && in_instrument.y.abs() < 1e-9);
                prop_assert!(in_instrument.z > 0.0, "the handle lies behind the trocar");
            }
        }
    }

    #[test]
    fn tips_stay_in_the_workspace_and_near_the_script() {
        let (mut source, rig) = source(None);
        let mut turned: f64 = 0.0;
        for k in 0..1600 {
            let motion = source.at(k * 20_000_000);
            turned = turned.max(motion.world_from_eye.angle());
            for i in 0..INSTRUMENTS {
                let tip_in_eye =
                    motion.world_from_eye.inverse() * motion.world_from_instrument[i].translation.vector;
                let asked = source.script.at(i, k as f64 * 0.02).tip_in_eye_mm;
                assert!((tip_in_eye - asked).norm() < 0.25, "tremor of 40 µm RMS, not more");
                assert!(tip_in_eye.norm() < rig.workspace.tip_radius);
            }
        }
        assert!((0.02..0.15).contains(&turned), "the eye turns, and not wildly: {turned}");
    }

    #[test]
    fn who_goes_on_later_moves_alike() {
        let (mut whole, _) = source(None);
        let (mut later, _) = source(None);
        later.go_on(whole.script().clone(), 12_345_000_000);
        for k in 0..100 {
            let t = 12_345_000_000 + k * 20_000_000;
            let (a, b) = (whole.at(t), later.at(t));
            for i in 0..INSTRUMENTS {
                let [a, b] = [a, b].map(|m| m.world_from_instrument[i].translation.vector);
                assert!((a - b).norm() < 1e-4, "{a} {b}");
            }
        }
    }

    #[test]
    fn same_seed_same_motion() {
        let (mut a, _) = source(None);
        let (mut b, _) = source(None);
        for k in 0..40 {
            b.at(k * 33_333_333);
        }
        assert_eq!(a.at(1_234_567_890), b.at(1_234_567_890));
    }

    #[test]
    fn a_recorded_motion_moves_instrument_0_only() {
        let (mut plain, rig) = source(None);
        let (mut shaken, _) = source(Some(MotionUse::Tremor(recording(0.0))));
        let (mut led, _) = source(Some(MotionUse::Full(recording(40.0))));
        let middle = led.script.mean_tip_in_eye_mm(0);
        let mut spread: f64 = 0.0;
        for k in 0..500 {
            let (p, s, l) = (plain.at(k * 20_000_000), shaken.at(k * 20_000_000), led.at(k * 20_000_000));
            assert_eq!(p.world_from_instrument[1], s.world_from_instrument[1]);
            assert_eq!(p.jaw_rad, l.jaw_rad);
            let tip = l.world_from_eye.inverse() * l.world_from_instrument[0].translation.vector;
            spread = spread.max((tip - middle).norm());
            assert!(tip.norm() < rig.workspace.tip_radius, "{tip}");
            let away =
                s.world_from_instrument[0].translation.vector - p.world_from_instrument[0].translation.vector;
            assert!(away.norm() < 0.3);
        }
        assert!(spread > 0.5, "the hand moves the tip: {spread}");
    }
}
