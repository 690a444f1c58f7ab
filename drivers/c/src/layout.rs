//! The blocks that drivers see, and one number for all their layouts.

use protocol::blobs::{Blob, BlobField};
use protocol::events::Event;
use protocol::fields::FieldHeader;
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Health;
use protocol::message::{Message, fnv1a};
use protocol::poses::{BodyState, FieldUsed, Oscillator, Predictor, TrackerFrame};
use protocol::time::Instants;
use protocol::wire::{Layout, layout_of};

/// Every struct of the header, those that others consist of first.
pub const BLOCKS: [(&str, &Layout); 14] = [
    ("Blob", layout_of::<Blob>()),
    ("BlobField", layout_of::<BlobField>()),
    ("FieldHeader", layout_of::<FieldHeader>()),
    ("HandleState", layout_of::<HandleState>()),
    ("PedalState", layout_of::<PedalState>()),
    ("Instants", layout_of::<Instants>()),
    ("FieldUsed", layout_of::<FieldUsed>()),
    ("Pose", layout_of::<Pose>()),
    ("Oscillator", layout_of::<Oscillator>()),
    ("Predictor", layout_of::<Predictor>()),
    ("BodyState", layout_of::<BodyState>()),
    ("TrackerFrame", layout_of::<TrackerFrame>()),
    ("Event", layout_of::<Event>()),
    ("Health", layout_of::<Health>()),
];

/// A hash of the schemas of every message of the header. A program hands over the number it was compiled with.
pub const LAYOUT: u64 = {
    let schemas = [
        BlobField::SCHEMA,
        FieldHeader::SCHEMA,
        HandleState::SCHEMA,
        PedalState::SCHEMA,
        TrackerFrame::SCHEMA,
        Event::SCHEMA,
        Health::SCHEMA,
    ];
    let mut bytes = [0; 8 * 7];
    let mut i = 0;
    while i < bytes.len() {
        bytes[i] = (schemas[i / 8] >> (8 * (i % 8))) as u8;
        i += 1;
    }
    fnv1a(&bytes)
};
