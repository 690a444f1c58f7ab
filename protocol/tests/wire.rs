//! No bytes of a corrupt peer make a wire type panic, and what passes validation is safe to use.

use proptest::prelude::*;
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::control::{Answer, Request};
use protocol::events::Event;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::geometry::Validity;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Health;
use protocol::inputs::{Hint, InputEvent};
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::predict::predict;
use protocol::scene::{SceneHeader, SceneMark, SceneNode, SceneTriangle, section};
use protocol::steps::{CheckpointHeader, StepRecord};

/// A block made of `seed` bytes, over and over.
fn block<M: Message>(seed: &[u8]) -> M {
    let bytes: Vec<u8> = seed.iter().copied().cycle().take(size_of::<M>()).collect();
    bytemuck::pod_read_unaligned(&bytes)
}

fn validates<M: Message>(seed: &[u8]) {
    let _ = block::<M>(seed).validate();
}

proptest! {
    #[test]
    fn random_bytes_never_panic(seed in prop::collection::vec(any::<u8>(), 1..600)) {
        validates::<BlobField>(&seed);
        validates::<HandleState>(&seed);
        validates::<PedalState>(&seed);
        validates::<TrackerFrame>(&seed);
        validates::<MatchFrame>(&seed);
        validates::<SceneHeader>(&seed);
        validates::<StepRecord>(&seed);
        validates::<CheckpointHeader>(&seed);
        validates::<TrackerCheckpointHeader>(&seed);
        validates::<Event>(&seed);
        validates::<FrameRecord>(&seed);
        validates::<PictureHeader>(&seed);
        validates::<Health>(&seed);
        validates::<Request>(&seed);
        validates::<Answer>(&seed);
        let _ = block::<Health>(&seed).text();
        prop_assert!(block::<BlobField>(&seed).blobs().len() <= 64);
        prop_assert!(block::<TrackerFrame>(&seed).used().len() <= 16);
        let matches = block::<MatchFrame>(&seed);
        prop_assert!(matches.fields().iter().all(|f| f.blobs().len() <= 64 && f.missed().len() <= 48));
    }

    #[test]
    fn foreign_sections_stay_inside_the_payload(seed in prop::collection::vec(any::<u8>(), 1..400)) {
        let header = block::<SceneHeader>(&seed);
        let payload = vec![0u128; 64];
        let payload: &[u8] = bytemuck::cast_slice(&payload);
        let inside = |bytes: usize| bytes <= payload.len();
        if let Ok(nodes) = section::<SceneNode>(payload, header.nodes) { prop_assert!(inside(size_of_val(nodes))); }
        if let Ok(list) = section::<SceneTriangle>(payload, header.triangles) { prop_assert!(inside(size_of_val(list))); }
        if let Ok(marks) = section::<SceneMark>(payload, header.marks) { prop_assert!(inside(size_of_val(marks))); }
    }

    #[test]
    fn valid_frames_predict_finite_poses_near_now(
        velocity in prop::array::uniform3(-1e3..1e3f64), ahead_ms in -300i64..300,
        omega in 0.0..200.0f64, damping in 0.0..2.0f64, tau in prop::sample::select(vec![0.0, 1e-300, 1e-6, 1e-3, 0.1, 2.0]),
    ) {
        let mut frame: TrackerFrame = bytemuck::Zeroable::zeroed();
        frame.instants.exposed = 1_000_000_000;
        for body in &mut frame.bodies {
            body.world_from_body = protocol::geometry::Pose::IDENTITY;
            body.validity = Validity::Measured as u32;
            body.predictor.velocity_mm_s = velocity;
            body.predictor.velocity_tau_s = tau;
            body.predictor.acceleration_tau_s = tau;
            body.predictor.oscillators[0].omega_rad_s = omega;
            body.predictor.oscillators[0].damping = damping;
            body.predictor.oscillators[0].velocity_mm_s = velocity;
        }
        prop_assert!(frame.validate().is_ok());
        let at = (1_000_000_000 + ahead_ms * 1_000_000) as u64;
        prop_assert!(predict(&frame, 0, at).world_from_body.position_mm.iter().all(|c| c.is_finite()));
    }
}

#[test]
fn channel_names_and_schemas_differ() {
    let all = [
        (BlobField::CHANNEL, BlobField::SCHEMA),
        (HandleState::CHANNEL, HandleState::SCHEMA),
        (PedalState::CHANNEL, PedalState::SCHEMA),
        (TrackerFrame::CHANNEL, TrackerFrame::SCHEMA),
        (MatchFrame::CHANNEL, MatchFrame::SCHEMA),
        (SceneHeader::CHANNEL, SceneHeader::SCHEMA),
        (StepRecord::CHANNEL, StepRecord::SCHEMA),
        (CheckpointHeader::CHANNEL, CheckpointHeader::SCHEMA),
        (TrackerCheckpointHeader::CHANNEL, TrackerCheckpointHeader::SCHEMA),
        (Event::CHANNEL, Event::SCHEMA),
        (FrameRecord::CHANNEL, FrameRecord::SCHEMA),
        (PictureHeader::CHANNEL, PictureHeader::SCHEMA),
        (Health::CHANNEL, Health::SCHEMA),
        (Request::CHANNEL, Request::SCHEMA),
        (Answer::CHANNEL, Answer::SCHEMA),
        (InputEvent::CHANNEL, InputEvent::SCHEMA),
        (Hint::CHANNEL, Hint::SCHEMA),
    ];
    let names: std::collections::BTreeSet<_> = all.iter().map(|a| a.0).collect();
    let schemas: std::collections::BTreeSet<_> = all.iter().map(|a| a.1).collect();
    assert_eq!((names.len(), schemas.len()), (all.len(), all.len()));
}
