//! The protobuf messages, and which item becomes which.

#![allow(missing_docs, clippy::all)] // generated; documented in proto/vitreo.proto

include!(concat!(env!("OUT_DIR"), "/vitreo.rs"));

/// The descriptors of all messages, which the file carries as their schema.
pub(super) const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/vitreo.descriptors"));

/// Message of each topic, in the order of [`super::Item::TOPICS`].
pub(super) const MESSAGES: [&str; 10] = [
    "vitreo.BlobField",
    "vitreo.HandleState",
    "vitreo.PedalState",
    "vitreo.TrackerFrame",
    "vitreo.StepRecord",
    "vitreo.Event",
    "vitreo.FrameRecord",
    "vitreo.Checkpoint",
    "vitreo.Picture",
    "vitreo.Note",
];
