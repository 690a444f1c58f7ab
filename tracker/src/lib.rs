//! From the marker blobs of several cameras to the poses of two instruments and the eye.
//!
//! `process` takes camera-fields from the `blobs` channel and publishes a `TrackerFrame` on `poses`
//! for every exposure of the reference camera. Between them lie pure modules without clock, files
//! or transport: the [`assembler`] decides which fields make a frame, the [`tracker`] consumes them:
//!
//! [`sight`] pixels → [`associate`] blobs to markers (or [`seed`] from nothing) → [`fit`] pose →
//! [`hand`] or [`filter`] motion → [`body`] verdict, with what [`forecast`] expects the hand to do
//! next. [`drift`] watches how well the rig still fits; [`fitness`] refuses rigs that cannot work.
//!
//! The tracker's state depends on nothing but the consumed fields in their order.

pub mod assembler;
pub mod associate;
pub mod block;
pub mod body;
pub mod chain;
pub mod config;
pub mod constants;
pub mod drift;
pub mod estimate;
pub mod filter;
pub mod fit;
pub mod fitness;
pub mod forecast;
pub mod hand;
pub mod learner;
pub mod model;
pub mod process;
pub mod roll;
pub mod script;
pub mod seed;
pub mod sight;
pub mod stream;
pub mod tracker;

pub use tracker::{Reference, Tracker};
