//! The surgeon's stereo view of vitreo: scene blocks in, stereo pictures out.
//!
//! `process` is the loop; `frame` draws a stereo frame as a list of passes; `latch`, `pacing` and
//! `governor` decide what pose is shown, when it will be seen and how fine the picture may be, and
//! are pure. Shaders lie beside their pass. wgpu is used in this crate only, windows in `present`.

pub mod assets;
pub mod cells;
pub mod compose;
pub mod config;
pub mod costs;
pub mod film;
pub mod frame;
pub mod fundus_map;
pub mod governor;
pub mod gpu;
pub mod gpu_clock;
mod kept_map;
pub mod lamp;
pub mod latch;
pub mod layers;
pub mod layout;
pub mod offscreen;
pub mod optics;
pub mod output;
pub mod pacing;
pub mod passes;
pub mod periphery;
pub mod photograph;
pub mod present;
pub mod process;
pub mod readback;
pub mod reference_scene;
pub mod similarity;
pub mod start;
pub mod stereo;
pub mod target;
pub mod text;
pub mod timing;
pub mod tissue;
pub mod tools;
pub mod view;
mod workers;
