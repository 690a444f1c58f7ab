//! Random inputs: tips move from place to place, jaws open and close, tools are exchanged, the
//! pedal is pressed; at times the tracker loses a body, skips fields or jumps.

use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::geometry::{Pose, Validity};
use protocol::handles::{HandleState, PedalState};
use protocol::limits::{BODIES, FIELD_PERIOD_NS, INSTRUMENTS};
use protocol::optics::PedalButton;
use protocol::poses::{EYE, TrackerFrame};
use protocol::random::Random;
use rig::Rig;
use scene::SceneFile;

/// Exposure of the first field, ns.
const FIRST_NS: u64 = 1_000_000_000;
/// Every combination of the pedal's buttons is below this.
const BUTTONS: usize = 2 * PedalButton::Filter as usize;

/// One step's inputs.
#[derive(Debug, Clone)]
pub struct Input {
    pub frame: TrackerFrame,
    pub handles: [HandleState; INSTRUMENTS],
    pub pedals: [PedalState; 1],
}

/// An instrument on its way from one place to the next.
#[derive(Debug, Clone)]
struct InstrumentMotion {
    trocar: Vector3<f64>,
    from: Vector3<f64>,
    to: Vector3<f64>,
    /// Fields done and fields in all of this movement.
    way: (u32, u32),
    roll_rad: f64,
    jaw_rad: f64,
    jaw_to_rad: f64,
    tool: u32,
    /// Fields for which the tracker does not see it.
    lost: u32,
}

/// A stream of inputs.
#[derive(Debug, Clone)]
pub struct Programme {
    draw: Random,
    retina_mm: f64,
    instruments: [InstrumentMotion; INSTRUMENTS],
    field: u64,
    exposed_ns: u64,
    eye_rad: Vector3<f64>,
    pedal: PedalState,
}

impl Programme {
    /// The programme that `draw` gives in a scene.
    pub fn new(scene: &SceneFile, draw: Random) -> Self {
        let rig = Rig::load_or_shipped(None).expect("the shipped rig is tested");
        let hand = |i: usize| {
            let trocar = rig.trocars.get(i).map_or(Vector3::new(0.0, 0.0, 10.0), |t| Vector3::from(t.p_eye));
            let start = trocar * 0.6;
            let tool = scene.instruments[i].tool as u32;
            InstrumentMotion {
                trocar,
                from: start,
                to: start,
                way: (0, 0),
                roll_rad: 0.0,
                jaw_rad: 0.5,
                jaw_to_rad: 0.5,
                tool,
                lost: 0,
            }
        };
        Programme {
            draw,
            retina_mm: scene.eye.retina_radius_mm,
            instruments: std::array::from_fn(hand),
            field: 0,
            exposed_ns: FIRST_NS,
            eye_rad: Vector3::zeros(),
            pedal: PedalState::zeroed(),
        }
    }

    /// The next field's inputs.
    pub fn next(&mut self) -> Input {
        let draw = &mut self.draw;
        for hand in &mut self.instruments {
            hand.go_on(draw, self.retina_mm);
        }
        self.eye_rad += Vector3::new(draw.between(-1.0, 1.0), draw.between(-1.0, 1.0), 0.0) * 0.004;
        self.eye_rad *= 0.98;
        if draw.once_in(40) {
            self.pedal.axes = [draw.between(-1.0, 1.0), draw.between(-1.0, 1.0)];
            self.pedal.mode = draw.below(5) as u32;
        }
        if draw.once_in(25) {
            self.pedal.buttons = if draw.once_in(2) { 0 } else { draw.below(BUTTONS) as u32 };
        }
        // Mostly the regular period; sometimes fields are missing, or the clock jumps so far that
        // the world pauses.
        let fields = match draw.below(200) {
            0 => 60,
            1..=4 => 2 + draw.below(4) as u64,
            _ => 1,
        };
        self.exposed_ns += fields * FIELD_PERIOD_NS + draw.below(20_000) as u64;
        self.input()
    }

    /// Hands that open and leave the eye, so that the tissue comes to rest.
    pub fn leave(&mut self) -> Input {
        for hand in &mut self.instruments {
            (hand.from, hand.to, hand.way) = (hand.trocar * 1.2, hand.trocar * 1.2, (0, 0));
            (hand.jaw_rad, hand.jaw_to_rad, hand.lost) = (1.0, 1.0, 0);
        }
        (self.pedal.axes, self.pedal.buttons) = ([0.0; 2], 0);
        self.exposed_ns += FIELD_PERIOD_NS;
        self.input()
    }

    fn input(&mut self) -> Input {
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.frame, frame.instants.exposed) = (self.field, self.field, self.exposed_ns);
        let world_from_eye =
            Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_scaled_axis(self.eye_rad));
        for (i, hand) in self.instruments.iter().enumerate() {
            frame.bodies[i].world_from_body = Pose::from_isometry(&(world_from_eye * hand.pose()));
        }
        frame.bodies[EYE].world_from_body = Pose::from_isometry(&world_from_eye);
        for body in 0..BODIES {
            let lost = self.instruments.get(body).is_some_and(|h| h.lost > 0);
            let validity = if lost { Validity::Lost } else { Validity::Measured };
            frame.bodies[body].validity = validity as u32;
        }
        let handle = |i: usize| HandleState {
            seq: self.field * INSTRUMENTS as u64 + i as u64,
            field: self.field,
            instant_ns: self.exposed_ns,
            instrument: i as u32,
            tool: self.instruments[i].tool,
            jaw_rad: self.instruments[i].jaw_rad,
        };
        let handles = std::array::from_fn(handle);
        let pedals = [PedalState { seq: self.field, instant_ns: self.exposed_ns, ..self.pedal }];
        self.field += 1;
        Input { frame, handles, pedals }
    }
}

impl InstrumentMotion {
    fn go_on(&mut self, draw: &mut Random, retina_mm: f64) {
        if self.way.0 >= self.way.1 {
            (self.from, self.to) = (self.to, place(draw, retina_mm, &self.trocar));
            self.way = (0, 3 + draw.below(80) as u32);
            self.jaw_to_rad = if draw.once_in(2) { 0.02 } else { draw.between(0.0, 1.2) };
        }
        self.way.0 += 1;
        self.jaw_rad += (self.jaw_to_rad - self.jaw_rad) * 0.15;
        self.roll_rad += draw.between(-0.05, 0.05);
        if draw.once_in(300) {
            self.tool = 1 + draw.below(5) as u32;
        }
        if draw.once_in(400) {
            self.lost = 1 + draw.below(20) as u32;
        }
        self.lost = self.lost.saturating_sub(1);
        if draw.once_in(1500) {
            // A tracker that jumps: the hand is elsewhere at once.
            (self.from, self.way) = (self.to, (1, 1));
        }
    }

    fn pose(&self) -> Isometry3<f64> {
        let (done, all) = (f64::from(self.way.0), f64::from(self.way.1.max(1)));
        let u = (done / all).min(1.0);
        let u = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let tip = self.from * (1.0 - u) + self.to * u;
        let z = (self.trocar * 2.0 - tip).normalize();
        let x = Vector3::y().cross(&z).normalize();
        let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.roll_rad);
        Isometry3::from_parts(Translation3::from(tip), UnitQuaternion::from_rotation_matrix(&axes) * roll)
    }
}

/// Somewhere to go: mostly at the tissue before the rear of the retina, sometimes anywhere,
/// sometimes out.
fn place(draw: &mut Random, retina_mm: f64, trocar: &Vector3<f64>) -> Vector3<f64> {
    let aside = |draw: &mut Random, by: f64| Vector3::new(draw.between(-by, by), draw.between(-by, by), 0.0);
    match draw.below(12) {
        0 => trocar * 1.2,
        1 => (aside(draw, 1.0) + Vector3::z() * draw.between(-1.0, 0.5)) * 8.0,
        _ => {
            let towards = (aside(draw, 0.35) - Vector3::z()).normalize();
            towards * (retina_mm - draw.between(-0.3, 1.8))
        }
    }
}
