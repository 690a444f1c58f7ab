//! From the marker blobs of several cameras to the poses of two instruments and the eye.
//!
//! [`process`] receives camera-fields on the `blobs` channel and publishes a `TrackerFrame` on
//! `poses` for every exposure of the reference camera. Between them are pure modules without clock,
//! files or transport: the [`assembler`] decides which fields make a frame, the [`tracker`]
//! consumes them.
//!
//! | phase of an update | module |
//! |---|---|
//! | observe: pixels and covariances of blobs | [`observation`] |
//! | predict: filters to the fields' instant | [`instrument_filter`], [`eye_filter`] |
//! | associate: blobs to markers | [`associate`] |
//! | estimate: most likely pose of each body | [`fit`], [`roll_recovery`] |
//! | filter: fits into the filters, validity and status | [`body_filter`], [`track`] |
//! | acquire: lost bodies, without a prediction | [`acquisition`] |
//!
//! [`predictor`] extrapolates the tips beyond the frame, [`drift`] estimates how far the rig has
//! moved since its calibration, [`camera_watch`] leaves out cameras that were knocked and finds where
//! they stand, [`match_log`] records what became of every blob, and [`rig_check`] refuses rigs that cannot
//! work.

pub mod acquisition;
#[cfg(test)]
mod adverse;
pub mod assembler;
pub mod associate;
pub mod block_matrix;
pub mod body_filter;
pub mod camera_watch;
pub mod checkpoint;
pub mod config;
pub mod constants;
mod covers;
pub mod drift;
pub mod eye_filter;
pub mod fit;
pub mod instrument_filter;
pub mod lines;
pub mod match_log;
pub mod motion_models;
pub mod observation;
pub mod pose_math;
pub mod predictor;
pub mod process;
pub mod projection;
pub mod rate_constants;
mod reading;
pub mod refusals;
pub mod report;
pub mod rig_check;
pub mod rig_model;
pub mod rls_predictor;
pub mod roll_recovery;
pub mod stream;
pub mod track;
pub mod tracker;
pub mod tremor_bank;
pub mod tuning;
pub mod ud_covariance;

pub use tracker::{Reference, Tracker, TrackerSnapshot};
pub use tuning::Tuning;
