//! Messages between the processes of vitreo, and what two processes must compute alike.
//!
//! The transport is in crate `ipc`, which opens these channels:
//!
//! | channel | block | sender → receivers | rate | rule |
//! |---|---|---|---|---|
//! | `fields` | [`fields::FieldHeader`] + pixels | rig, cameras or driver → fpga-model | rig's | every one |
//! | `blobs` | [`blobs::BlobField`] | fpga-model, rig or driver → tracker, recorder | 3 × 50 Hz | every one |
//! | `handles` | [`handles::HandleState`] | rig, desk, controls or driver → simcore, recorder | ≥ 50 Hz | every one |
//! | `pedal` | [`handles::PedalState`] | rig, desk, controls or driver → simcore, recorder | ≥ 10 Hz | every one |
//! | `poses` | [`poses::TrackerFrame`] | tracker, desk or driver → simcore, renderer | rig's | every one, or newest |
//! | `matches` | [`matches::MatchFrame`] | tracker → recorder | rig's | every one |
//! | `scene` | [`scene::SceneHeader`] + sections | simcore → renderer, rig | per step | newest wins |
//! | `steps` | [`steps::StepRecord`] | simcore → launcher | per step | every one |
//! | `checkpoints` | [`steps::CheckpointHeader`] + bytes | simcore → launcher | ≥ 0.5 Hz | newest wins |
//! | `tracker-checkpoints` | [`checkpoints::TrackerCheckpointHeader`] + bytes | tracker → launcher | 0.5 Hz | newest wins |
//! | `events` | [`events::Event`] | simcore → rig, console, recorder | on change | every one |
//! | `frames` | [`frames::FrameRecord`] | renderer → launcher | per frame | every one |
//! | `pictures` | [`frames::PictureHeader`] + JPEG | renderer → recorder | ≤ 15 Hz | newest wins |
//! | `health` | [`health::Health`] | each → launcher | 10 Hz | every one |
//! | `control` | [`control::Request`] | launcher or `vitreo ctl` → each | on demand | every one |
//! | `answers` | [`control::Answer`] | each → launcher | on demand | every one |
//! | `notices` | [`control::Notice`] | launcher → renderer | 1 Hz | newest wins |
//! | `inputs` | [`inputs::InputEvent`] | window, gamepad → desk, launcher | on change | every one |
//! | `hints` | [`inputs::Hint`] | desk → renderer | on change | newest wins |
//!
//! Each message is a plain block ([`wire::Wire`]); its layout is hashed, and processes connect only
//! where the hashes are equal. Units are mm, g, s (so force is µN and pressure Pa); angles are
//! radians; time is integer nanoseconds of `CLOCK_MONOTONIC`. Frames are `world`, `eye`,
//! `instrument`, `camera` (see `docs/conventions.md`); transforms are named `target_from_source`.

pub mod bindings;
pub mod blobs;
pub mod budget;
pub mod checkpoints;
pub mod condition;
pub mod contain;
pub mod control;
pub mod controls;
pub mod deliveries;
pub mod dose;
pub mod events;
pub mod fields;
pub mod file;
pub mod frames;
pub mod geometry;
pub mod handles;
pub mod health;
pub mod inputs;
pub mod journal;
pub mod limits;
pub mod matches;
pub mod message;
pub mod optics;
pub mod parse_error;
pub mod phases;
pub mod poses;
pub mod predict;
pub mod random;
pub mod scene;
pub mod scene_text;
pub mod steps;
pub mod time;
pub mod transport;
pub mod wire;

// `#[derive(Wire)]` names this crate, also inside it.
extern crate self as protocol;
