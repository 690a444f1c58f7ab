//! Mouse, keyboard and gamepad in place of cameras and tracker: a user's inputs become smooth
//! movements of the instruments and leave as the poses, handles and pedal states of a rig. Every
//! other process is that of a live run.
//!
//! [`process`] is the loop; [`guidance`] turns inputs into movements, [`frame`] movements into
//! messages; [`input_file`] reads files of inputs, [`gamepad`] gamepads. Keys are bound in
//! `protocol::bindings`; for users `docs/play.md`.

pub mod config;
pub mod frame;
pub mod gamepad;
pub mod guidance;
pub mod input_file;
pub mod process;
pub mod workspace;
