//! Mouse, keyboard and gamepad in place of cameras and tracker: what a person does at a desk becomes movements that a hand can
//! make, and leaves as the poses, handles and pedal states that a rig sends. From there on nothing differs.
//!
//! [`process`] is the loop; [`hands`] turns inputs into movements, [`frame`] movements into messages; [`script`] reads files of
//! inputs, [`gamepad`] gamepads. What keys mean is in `protocol::bindings`; for users `docs/play.md`.

pub mod config;
pub mod frame;
pub mod gamepad;
pub mod hands;
pub mod process;
pub mod reach;
pub mod script;
