//! Inputs become movements. A person says where a tip shall be ([`Desk::take`]); the tip follows as a hand would
//! ([`Desk::advance`]): smoothly, no faster than [`MOST_MM_S`], and inside the eye. Pure: time is an argument.
//!
//! Sideways is as the picture shows it: right is −x of the eye, up is −y (`docs/conventions.md`). Depth is along −z.

use crate::reach::Reach;
use nalgebra::{Isometry3, Vector3};
use protocol::bindings::Action;
use protocol::geometry::shaft_pose;
use protocol::handles::{PedalMode, PedalState, Tool};
use protocol::inputs::{AXIS_COUNT, Axis, Input, Key};
use protocol::limits::INSTRUMENTS;
use protocol::optics::PedalButton;
use protocol::rig::Rig;
use scene::SceneFile;

/// A tip moves so far for a pixel of the mouse, mm.
pub const MM_PER_PX: f64 = 0.02;
/// A tip goes so far for a notch of the wheel, mm.
pub const MM_PER_NOTCH: f64 = 0.2;
/// Speed of a tip led by a key, mm/s.
const KEY_MM_S: f64 = 3.0;
/// Speed of a tip led by a stick at its end, mm/s; halfway it is a quarter, as sticks are hard to hold still.
const STICK_MM_S: f64 = 6.0;
/// Speed of a turn about the shaft by key or stick, rad/s.
const ROLL_RAD_S: f64 = 1.6;
/// A stick this near its middle is at rest.
const STICK_REST: f64 = 0.12;
/// What is left of a movement with the key for fine work.
const FINE: f64 = 0.25;
/// No tip is faster, mm/s. Surgeons stay below 20 mm/s.
pub const MOST_MM_S: f64 = 12.0;
/// Stiffness of a hand that follows its aim, 1/s: an aim that jumps is reached within half a second.
const FOLLOW_PER_S: f64 = 12.0;
/// Speed of the jaws, rad/s.
const JAW_RAD_S: f64 = 2.5;
/// Opening of jaws that are not asked to close, rad.
const OPEN_RAD: f64 = 0.9;
/// A hand's part of [`Desk::advance`] is never longer, s.
const LONGEST_S: f64 = 0.2;

/// One hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// Where the tip is, eye frame, mm.
    pub tip_mm: Vector3<f64>,
    /// How it moves, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Turn about the shaft, rad.
    pub roll_rad: f64,
    /// Jaw opening, rad.
    pub jaw_rad: f64,
    /// What is in it.
    pub tool: Tool,
    /// Angular velocity of the instrument, eye frame, rad/s.
    pub turning_rad_s: Vector3<f64>,
    aim_mm: Vector3<f64>,
    aim_roll_rad: f64,
    kept: bool,
    trocar_mm: Vector3<f64>,
    reach: Reach,
}

impl Hand {
    /// `eye_from_instrument`: the shaft passes its trocar.
    pub fn pose(&self) -> Isometry3<f64> {
        shaft_pose(&self.tip_mm, &self.trocar_mm, self.roll_rad)
    }

    /// Leads the aim by `by`, mm.
    fn lead(&mut self, by: Vector3<f64>) {
        self.aim_mm = self.reach.hold(&(self.aim_mm + by));
    }

    /// Follows the aim for `dt_s`: a critically damped spring in closed form, cut to the largest speed.
    fn follow(&mut self, dt_s: f64) {
        let before = self.pose().rotation;
        let off = self.tip_mm - self.aim_mm;
        let decay = libm::exp(-FOLLOW_PER_S * dt_s);
        let swing = self.velocity_mm_s + off * FOLLOW_PER_S;
        let to = self.aim_mm + (off + swing * dt_s) * decay;
        let velocity = (self.velocity_mm_s - swing * (FOLLOW_PER_S * dt_s)) * decay;
        let (step, most) = (to - self.tip_mm, MOST_MM_S * dt_s);
        let length = step.norm();
        if length > most {
            self.velocity_mm_s = step * (MOST_MM_S / length);
            self.tip_mm += step * (most / length);
        } else {
            (self.tip_mm, self.velocity_mm_s) = (to, velocity.cap_magnitude(MOST_MM_S));
        }
        self.tip_mm = self.reach.hold(&self.tip_mm);
        self.roll_rad += (self.aim_roll_rad - self.roll_rad) * (1.0 - decay);
        let turned = self.pose().rotation * before.inverse();
        self.turning_rad_s = if dt_s > 0.0 { turned.scaled_axis() / dt_s } else { Vector3::zeros() };
    }

    fn move_jaws(&mut self, closes: bool, dt_s: f64) {
        let aim = if self.tool != Tool::Forceps || closes { 0.0 } else { OPEN_RAD };
        let most = JAW_RAD_S * dt_s;
        self.jaw_rad += (aim - self.jaw_rad).clamp(-most, most);
    }
}

/// Two hands, a foot, and what is held.
#[derive(Debug, Clone, PartialEq)]
pub struct Desk {
    hands: [Hand; INSTRUMENTS],
    chosen: usize,
    held: u128,
    /// Pressed since the last field, so that a short tap is not missed.
    tapped: u128,
    axes: [f64; AXIS_COUNT],
}

/// The tools that [`Action::NextTool`] goes round.
const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::Pick, Tool::Vitrector, Tool::Needle, Tool::LightPipe];

impl Desk {
    /// At the start of a scene: instruments where its script has them first, at rest
    /// without one; the first hand led.
    pub fn new(scene: &SceneFile, rig: &Rig) -> Self {
        let script = scene.script_or_rest();
        let hand = |i: usize| {
            let first = script.first_key(i).expect("a checked script has a key for each instrument");
            let trocar_mm = rig.trocars.get(i).map_or(Vector3::z() * 12.0, |t| Vector3::from(t.p_eye));
            let reach = Reach::new(scene.eye.retina_radius_mm, &trocar_mm);
            let tip = Vector3::from(first.tip_in_eye_mm);
            let (tip_mm, tool) = (reach.hold(&tip), scene.instruments[i].tool);
            Hand {
                tip_mm,
                velocity_mm_s: Vector3::zeros(),
                roll_rad: first.roll_rad,
                jaw_rad: if tool == Tool::Forceps { OPEN_RAD } else { 0.0 },
                tool,
                turning_rad_s: Vector3::zeros(),
                aim_mm: tip_mm,
                aim_roll_rad: first.roll_rad,
                kept: false,
                trocar_mm,
                reach,
            }
        };
        Desk { hands: std::array::from_fn(hand), chosen: 0, held: 0, tapped: 0, axes: [0.0; AXIS_COUNT] }
    }

    /// The hands.
    pub fn hands(&self) -> &[Hand; INSTRUMENTS] {
        &self.hands
    }

    /// What the picture says: which hand is led, and what is in it.
    pub fn hint(&self) -> String {
        let hand = &self.hands[self.chosen];
        let tool = match hand.tool {
            Tool::Forceps => "forceps",
            Tool::LightPipe => "light",
            Tool::Pick => "pick",
            Tool::Vitrector => "vitrector",
            Tool::Needle => "needle",
        };
        let kept = if hand.kept { ", kept" } else { "" };
        format!("hand {}: {tool}{kept}", self.chosen + 1)
    }

    /// Takes an input in.
    pub fn take(&mut self, input: Input) {
        match input {
            Input::Press(key) => self.press(key),
            Input::Release(key) => self.held &= !key.bit(),
            Input::Move([right, down]) => {
                let fine = self.fine() * MM_PER_PX;
                self.hands[self.chosen].lead(Vector3::new(-right, down, 0.0) * fine);
            }
            Input::Wheel(away) => {
                let fine = self.fine() * MM_PER_NOTCH;
                self.hands[self.chosen].lead(Vector3::new(0.0, 0.0, -away) * fine);
            }
            Input::Axis(axis, at) => self.axes[axis as usize] = if at.is_finite() { at } else { 0.0 },
            Input::LetGo => (self.held, self.axes) = (0, [0.0; AXIS_COUNT]),
        }
    }

    fn press(&mut self, key: Key) {
        self.held |= key.bit();
        self.tapped |= key.bit();
        let hand = &mut self.hands[self.chosen];
        match Action::of(key) {
            Some(Action::OtherHand) => self.chosen = (self.chosen + 1) % INSTRUMENTS,
            Some(Action::Keep) => hand.kept = !hand.kept,
            Some(Action::NextTool) => {
                let at = TOOLS.iter().position(|t| *t == hand.tool).unwrap_or(0);
                (hand.tool, hand.kept) = (TOOLS[(at + 1) % TOOLS.len()], false);
                hand.jaw_rad = if hand.tool == Tool::Forceps { OPEN_RAD } else { 0.0 };
            }
            _ => {}
        }
    }

    fn holds(&self, action: Action) -> bool {
        self.held & action.keys() != 0
    }

    fn fine(&self) -> f64 {
        if self.holds(Action::Fine) { FINE } else { 1.0 }
    }

    /// −1, 0 or 1, by which of two actions is held.
    fn between(&self, less: Action, more: Action) -> f64 {
        f64::from(u8::from(self.holds(more))) - f64::from(u8::from(self.holds(less)))
    }

    /// A stick's place as a speed, −1 to 1.
    fn stick(&self, axis: Axis) -> f64 {
        let at = self.axes[axis as usize];
        if at.abs() < STICK_REST { 0.0 } else { (at * at.abs()).clamp(-1.0, 1.0) }
    }

    /// Goes on by `dt_s` seconds, at most 0.2.
    pub fn advance(&mut self, dt_s: f64) {
        let dt_s = if dt_s.is_finite() { dt_s.clamp(0.0, LONGEST_S) } else { 0.0 };
        let keys = Vector3::new(
            self.between(Action::Right, Action::Left),
            self.between(Action::Up, Action::Down),
            self.between(Action::Deeper, Action::Higher),
        );
        let sticks =
            Vector3::new(-self.stick(Axis::LeftX), self.stick(Axis::LeftY), self.stick(Axis::RightY));
        let roll = self.between(Action::RollLeft, Action::RollRight) + self.stick(Axis::RightX);
        let fine = self.fine() * dt_s;
        let uses = self.holds(Action::Use);
        let chosen = self.chosen;
        let led = &mut self.hands[chosen];
        led.lead((keys * KEY_MM_S + sticks * STICK_MM_S) * fine);
        led.aim_roll_rad = (led.aim_roll_rad + roll.clamp(-1.0, 1.0) * ROLL_RAD_S * fine)
            .clamp(-std::f64::consts::PI, std::f64::consts::PI);
        for (i, hand) in self.hands.iter_mut().enumerate() {
            hand.follow(dt_s);
            hand.move_jaws(hand.kept || (i == chosen && uses), dt_s);
        }
    }

    /// The pedal, and forgets the taps that it tells. Number and instant are the caller's.
    pub fn pedal(&mut self) -> PedalState {
        let uses = |tool: Tool| {
            let in_use = |(i, hand): (usize, &Hand)| {
                hand.tool == tool && (hand.kept || (i == self.chosen && self.holds(Action::Use)))
            };
            self.hands.iter().enumerate().any(in_use)
        };
        let share = |on: bool| f64::from(u8::from(on));
        let scope = [
            self.between(Action::ScopeLeft, Action::ScopeRight),
            self.between(Action::ScopeDown, Action::ScopeUp),
        ];
        let zoom =
            [self.between(Action::ZoomOut, Action::ZoomIn), self.between(Action::FocusDown, Action::FocusUp)];
        let (air, fluid) = (self.holds(Action::Air), self.holds(Action::Fluid));
        let (cuts, sucks) = (uses(Tool::Vitrector), self.holds(Action::Suck));
        let (mode, axes) = if air || fluid {
            (PedalMode::Exchange, [share(air), share(fluid && !air)])
        } else if cuts || sucks {
            (PedalMode::Aspirate, [1.0, share(cuts)])
        } else if uses(Tool::Needle) {
            (PedalMode::Inject, [1.0, 0.0])
        } else if zoom != [0.0; 2] {
            (PedalMode::Zoom, zoom)
        } else {
            (PedalMode::Move, scope)
        };
        let down = self.held | std::mem::take(&mut self.tapped);
        let pressed = BUTTONS.iter().filter(|(action, _)| down & action.keys() != 0);
        let buttons = pressed.fold(0, |bits, (_, button)| bits | *button as u32);
        PedalState { seq: 0, instant_ns: 0, axes, buttons, mode: mode as u32 }
    }
}

/// The pedal's buttons on keys.
const BUTTONS: [(Action, PedalButton); 5] = [
    (Action::Magnify, PedalButton::Magnify),
    (Action::Reduce, PedalButton::Reduce),
    (Action::Lens, PedalButton::Lens),
    (Action::Inverter, PedalButton::Inverter),
    (Action::Filter, PedalButton::Filter),
];

#[cfg(test)]
mod tests;
