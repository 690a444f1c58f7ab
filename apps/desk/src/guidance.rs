//! Guidance of the instruments by a user's inputs. Inputs move a tip's target
//! ([`Guidance::apply`]); the tip follows it ([`Guidance::advance`]) smoothly, no faster than
//! [`MAX_SPEED_MM_S`], and inside the eye. Pure: time is an argument.
//!
//! Sideways is as in the picture: right is −x of the eye, up is −y (`docs/conventions.md`). Depth
//! is along −z.

use crate::workspace::Workspace;
use nalgebra::{Isometry3, Vector3};
use protocol::bindings::{Action, key_of, shown};
use protocol::geometry::shaft_pose;
use protocol::handles::{PedalMode, PedalState, Tool};
use protocol::inputs::{AXIS_COUNT, Axis, Input, Key};
use protocol::limits::INSTRUMENTS;
use protocol::optics::PedalButton;
use rig::Rig;
use scene::SceneFile;

/// Movement of a target for a pixel of the mouse, mm.
pub const MM_PER_PX: f64 = 0.02;
/// Movement of a target for a notch of the wheel, mm.
pub const MM_PER_NOTCH: f64 = 0.2;
/// Speed of a target moved by a key, mm/s.
const KEY_MM_S: f64 = 3.0;
/// Speed of a target moved by a stick at its end, mm/s. It grows with the square of the deflection,
/// as sticks are hard to hold still.
const STICK_MM_S: f64 = 6.0;
/// Speed of a turn about the shaft by key or stick, rad/s.
const ROLL_RAD_S: f64 = 1.6;
/// Dead zone of a stick, share of its way.
const STICK_REST: f64 = 0.12;
/// Factor on movements while the key for fine work is held.
const FINE: f64 = 0.25;
/// Largest speed of a tip, mm/s. Surgeons stay below 20 mm/s.
pub const MAX_SPEED_MM_S: f64 = 12.0;
/// Natural frequency of the tip that follows its target, 1/s: a target that jumps is reached within
/// half a second.
const FOLLOW_PER_S: f64 = 12.0;
/// Speed of the jaws, rad/s.
const JAW_RAD_S: f64 = 2.5;
/// Largest step of [`Guidance::advance`], s.
const MAX_STEP_S: f64 = 0.2;
/// Time for which the answer to a key without effect is shown, s.
const ANSWER_S: f64 = 2.5;

fn tool_name(tool: Tool) -> &'static str {
    match tool {
        Tool::Forceps => "forceps",
        Tool::LightPipe => "light pipe",
        Tool::Pick => "pick",
        Tool::Vitrector => "vitrector",
        Tool::Needle => "needle",
    }
}

/// An instrument that follows its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidedInstrument {
    /// Tip, eye frame, mm.
    pub tip_mm: Vector3<f64>,
    /// Velocity of the tip, eye frame, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Turn about the shaft, rad.
    pub roll_rad: f64,
    /// Jaw opening, rad.
    pub jaw_rad: f64,
    /// Tool.
    pub tool: Tool,
    /// Angular velocity of the instrument, eye frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    target_mm: Vector3<f64>,
    target_roll_rad: f64,
    kept: bool,
    trocar_mm: Vector3<f64>,
    workspace: Workspace,
}

impl GuidedInstrument {
    /// `eye_from_instrument`: the shaft passes its trocar.
    pub fn pose(&self) -> Isometry3<f64> {
        shaft_pose(&self.tip_mm, &self.trocar_mm, self.roll_rad)
    }

    /// Moves the target by `by` (eye frame, mm), inside the workspace.
    fn move_target(&mut self, by: Vector3<f64>) {
        self.target_mm = self.workspace.clamp_point(&(self.target_mm + by));
    }

    /// Follows the target for `dt_s`: a critically damped spring in closed form, limited in speed.
    fn follow_target(&mut self, dt_s: f64) {
        let before = self.pose().rotation;
        let off = self.tip_mm - self.target_mm;
        let decay = libm::exp(-FOLLOW_PER_S * dt_s);
        let swing = self.velocity_mm_s + off * FOLLOW_PER_S;
        let to = self.target_mm + (off + swing * dt_s) * decay;
        let velocity = (self.velocity_mm_s - swing * (FOLLOW_PER_S * dt_s)) * decay;
        let (step, most) = (to - self.tip_mm, MAX_SPEED_MM_S * dt_s);
        let length = step.norm();
        if length > most {
            self.velocity_mm_s = step * (MAX_SPEED_MM_S / length);
            self.tip_mm += step * (most / length);
        } else {
            (self.tip_mm, self.velocity_mm_s) = (to, velocity.cap_magnitude(MAX_SPEED_MM_S));
        }
        self.tip_mm = self.workspace.clamp_point(&self.tip_mm);
        self.roll_rad += (self.target_roll_rad - self.roll_rad) * (1.0 - decay);
        let turned = self.pose().rotation * before.inverse();
        self.angular_velocity_rad_s = if dt_s > 0.0 { turned.scaled_axis() / dt_s } else { Vector3::zeros() };
    }

    fn move_jaws(&mut self, closes: bool, dt_s: f64) {
        let aim = if closes { 0.0 } else { self.tool.open_rad() };
        let most = JAW_RAD_S * dt_s;
        self.jaw_rad += (aim - self.jaw_rad).clamp(-most, most);
    }
}

/// Both instruments, the pedal, and the keys and axes that move them.
#[derive(Debug, Clone, PartialEq)]
pub struct Guidance {
    instruments: [GuidedInstrument; INSTRUMENTS],
    selected: usize,
    held: u128,
    /// Keys pressed since the last field, so that a short tap is not missed.
    tapped: u128,
    axes: [f64; AXIS_COUNT],
    /// Answer to a key that did nothing, and how much longer it is shown, s.
    answer: (String, f64),
}

/// The cycle of [`Action::NextTool`].
const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::Pick, Tool::Vitrector, Tool::Needle, Tool::LightPipe];

impl Guidance {
    /// At the start of a scene: instruments at the first keys of its script, at rest without one;
    /// the first one is selected.
    pub fn new(scene: &SceneFile, rig: &Rig) -> Self {
        let script = scene.script_or_rest();
        let instrument = |i: usize| {
            let first = script.first_key(i).expect("a checked script has a key for each instrument");
            let trocar_mm = rig.trocars.get(i).map_or(Vector3::z() * 12.0, |t| Vector3::from(t.p_eye));
            let workspace = Workspace::new(scene.eye.retina_radius_mm, &trocar_mm);
            let tip = Vector3::from(first.tip_in_eye_mm);
            let (tip_mm, tool) = (workspace.clamp_point(&tip), scene.instruments[i].tool);
            GuidedInstrument {
                tip_mm,
                velocity_mm_s: Vector3::zeros(),
                roll_rad: first.roll_rad,
                jaw_rad: tool.open_rad(),
                tool,
                angular_velocity_rad_s: Vector3::zeros(),
                target_mm: tip_mm,
                target_roll_rad: first.roll_rad,
                kept: false,
                trocar_mm,
                workspace,
            }
        };
        Guidance {
            instruments: std::array::from_fn(instrument),
            selected: 0,
            held: 0,
            tapped: 0,
            axes: [0.0; AXIS_COUNT],
            answer: (String::new(), 0.0),
        }
    }

    /// The instruments.
    pub fn instruments(&self) -> &[GuidedInstrument; INSTRUMENTS] {
        &self.instruments
    }

    /// Hint for the picture: the answer to a key that did nothing, else the selected hand, its tool
    /// and the tool's keys.
    pub fn hint(&self) -> String {
        let (answer, left_s) = &self.answer;
        if *left_s > 0.0 {
            return answer.clone();
        }
        let instrument = &self.instruments[self.selected];
        let (used, sucks) = (key_of(Action::Use), key_of(Action::Suck));
        let keys = match instrument.tool {
            Tool::Forceps => format!(", {used}: close"),
            Tool::Vitrector => format!(", {used}: cut, {sucks}: suck"),
            Tool::Needle => format!(", {used}: inject"),
            Tool::LightPipe | Tool::Pick => String::new(),
        };
        let kept = if instrument.kept { ", kept" } else { "" };
        format!("Hand {}: {}{keys}{kept}", self.selected + 1, tool_name(instrument.tool))
    }

    /// Why a key that was pressed does nothing, if it does nothing.
    fn refusal(&self, key: Key) -> Option<String> {
        let (tool, next) = (self.instruments[self.selected].tool, key_of(Action::NextTool));
        let pressed = shown(key.name());
        let still = matches!(tool, Tool::Pick | Tool::LightPipe);
        match Action::of(key) {
            None if key.name() == "other" => {
                Some(format!("This key does nothing. {}: all keys", key_of(Action::Help)))
            }
            None => Some(format!("{pressed} does nothing. {}: all keys", key_of(Action::Help))),
            Some(Action::Use | Action::Keep) if still => {
                Some(format!("{pressed} does nothing with the {}. {next}: next tool", tool_name(tool)))
            }
            Some(Action::Suck) if self.instruments.iter().all(|i| i.tool != Tool::Vitrector) => {
                Some(format!("{pressed} needs the vitrector. {next}: next tool"))
            }
            Some(_) => None,
        }
    }

    /// Applies an input.
    pub fn apply(&mut self, input: Input) {
        match input {
            Input::Press(key) => self.press(key),
            Input::Release(key) => self.held &= !key.bit(),
            Input::Move([right, down]) => {
                let fine = self.fine() * MM_PER_PX;
                self.instruments[self.selected].move_target(Vector3::new(-right, down, 0.0) * fine);
            }
            Input::Wheel(away) => {
                let fine = self.fine() * MM_PER_NOTCH;
                self.instruments[self.selected].move_target(Vector3::new(0.0, 0.0, -away) * fine);
            }
            Input::Axis(axis, at) => self.axes[axis as usize] = if at.is_finite() { at } else { 0.0 },
            Input::LetGo => (self.held, self.axes) = (0, [0.0; AXIS_COUNT]),
        }
    }

    fn press(&mut self, key: Key) {
        self.held |= key.bit();
        self.tapped |= key.bit();
        self.answer = self.refusal(key).map_or((String::new(), 0.0), |text| (text, ANSWER_S));
        let instrument = &mut self.instruments[self.selected];
        match Action::of(key) {
            Some(Action::OtherHand) => self.selected = (self.selected + 1) % INSTRUMENTS,
            Some(Action::Keep) => instrument.kept = !instrument.kept,
            Some(Action::NextTool) => {
                let at = TOOLS.iter().position(|t| *t == instrument.tool).unwrap_or(0);
                (instrument.tool, instrument.kept) = (TOOLS[(at + 1) % TOOLS.len()], false);
                instrument.jaw_rad = instrument.tool.open_rad();
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

    /// −1, 0 or 1 by the action that is held; 0 for both.
    fn between(&self, less: Action, more: Action) -> f64 {
        f64::from(u8::from(self.holds(more))) - f64::from(u8::from(self.holds(less)))
    }

    /// Speed that a stick asks for, −1 to 1.
    fn stick(&self, axis: Axis) -> f64 {
        let at = self.axes[axis as usize];
        if at.abs() < STICK_REST { 0.0 } else { (at * at.abs()).clamp(-1.0, 1.0) }
    }

    /// Advances by `dt_s` seconds, at most [`MAX_STEP_S`].
    pub fn advance(&mut self, dt_s: f64) {
        let dt_s = if dt_s.is_finite() { dt_s.clamp(0.0, MAX_STEP_S) } else { 0.0 };
        self.answer.1 = (self.answer.1 - dt_s).max(0.0);
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
        let selected = self.selected;
        let led = &mut self.instruments[selected];
        led.move_target((keys * KEY_MM_S + sticks * STICK_MM_S) * fine);
        led.target_roll_rad = (led.target_roll_rad + roll.clamp(-1.0, 1.0) * ROLL_RAD_S * fine)
            .clamp(-std::f64::consts::PI, std::f64::consts::PI);
        for (i, instrument) in self.instruments.iter_mut().enumerate() {
            instrument.follow_target(dt_s);
            instrument.move_jaws(instrument.kept || (i == selected && uses), dt_s);
        }
    }

    /// The pedal's state; taps are reported once. The caller fills number and instant in.
    pub fn pedal(&mut self) -> PedalState {
        let uses = |tool: Tool| {
            let in_use =
                |i: usize| self.instruments[i].kept || (i == self.selected && self.holds(Action::Use));
            (0..INSTRUMENTS).any(|i| self.instruments[i].tool == tool && in_use(i))
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

/// Actions that press a button of the pedal.
const BUTTONS: [(Action, PedalButton); 5] = [
    (Action::Magnify, PedalButton::Magnify),
    (Action::Reduce, PedalButton::Reduce),
    (Action::Lens, PedalButton::Lens),
    (Action::Inverter, PedalButton::Inverter),
    (Action::Filter, PedalButton::Filter),
];

#[cfg(test)]
mod tests;
