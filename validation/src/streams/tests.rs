use super::*;
use nalgebra::Vector3;
use score::{Score, rms};
use tracker::stream::track_stream;

fn recipe(scenario: Scenario, seed: u64) -> Recipe {
    Recipe { scenario, seed, seconds: 4.0, knocks: vec![] }
}

#[test]
fn a_stream_is_drawn_from_its_seed_alone() {
    let rig = Rig::load_or_shipped(None).unwrap();
    let draw = |seed| recipe(Scenario::Hard, seed).draw(&rig).fields;
    let bytes = |fields: &[BlobField]| bytemuck::cast_slice::<_, u8>(fields).to_vec();
    assert_eq!(bytes(&draw(1)), bytes(&draw(1)));
    assert_ne!(bytes(&draw(1)), bytes(&draw(2)));
}

#[test]
fn a_knocked_camera_sees_everything_elsewhere_from_then_on() {
    let rig = Rig::load_or_shipped(None).unwrap();
    let turn = Vector3::new(0.0, 5e-3, 0.0);
    let knock = Knock { camera: 1, at_s: 2.0, turn, shift_mm: Vector3::zeros(), goes_on: false };
    let still = recipe(Scenario::Nominal, 3).draw(&rig).fields;
    let moved = Recipe { knocks: vec![knock], ..recipe(Scenario::Nominal, 3) }.draw(&rig).fields;
    for (a, b) in still.iter().zip(&moved) {
        let same = bytemuck::bytes_of(a) == bytemuck::bytes_of(b);
        assert_eq!(
            same,
            a.camera != 1 || a.exposed_ns < 2_000_000_000,
            "camera {} at {}",
            a.camera,
            a.exposed_ns
        );
    }
}

#[test]
fn the_tracker_finds_what_was_drawn() {
    let rig = Rig::load_or_shipped(None).unwrap();
    let stream = recipe(Scenario::Nominal, 1).draw(&rig);
    let mut frames = Vec::new();
    track_stream(&rig, &stream.fields, |frame, _| frames.push(*frame));
    let score = Score::of(&frames, &stream.motion, 0.5, 3.9);
    assert!(rms(&score.tips_um) < 6.0 && score.coverage() > 0.99, "{} µm", rms(&score.tips_um));
}
