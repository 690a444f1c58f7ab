//! Collision and tissue: what the instruments do to the eye.
//!
//! [`world::World::step`] is a pure function of the previous state and of the tracker frame, handle
//! and pedal states it is given; [`process`] is the only part that knows a clock or a transport.
//!
//! ```text
//! process ── StepInput ──▶ world::step ──▶ sweep      instruments between two poses
//!                                     ├──▶ membrane   mass-spring sheet, limits, tearing
//!                                     ├──▶ retina     the whole retina, blebs, their fluid
//!                                     ├──▶ tools      what forceps do to nodes
//!                                     ├──▶ bodies     rigid bodies pushed and carried
//!                                     ├──▶ vitreous   the gel, a chain mail of elements
//!                                     ├──▶ [collision] ZCOLL, tip against retina
//!                                     ├──▶ guard      finite check, last good state
//!                                     └──▶ checkpoint state hash, save and restore
//! ```
//!
//! Units are mm, g, s, hence µN and Pa; tissue lives in the eye frame. Results are the same to the
//! bit in every build: no fused operations, fixed order of sums, transcendentals from `libm`.

pub mod bodies;
pub mod checkpoint;
pub mod config;
pub mod constants;
pub mod dose;
pub mod event_log;
pub mod microscope;
pub mod process;
pub mod resume;
pub mod scene_block;
pub mod state;
pub mod sweep;
pub mod task_view;
pub mod ticks;
pub mod tools;
pub mod world;
