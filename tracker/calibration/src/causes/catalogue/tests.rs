//! Every cause has words, and those that can be mended a remedy.

use super::*;
use std::collections::BTreeSet;

/// One of each kind, in the order of the catalogue.
fn all() -> Vec<Cause> {
    let text = || "x".to_owned();
    vec![
        Cause::CamerasSwapped { cameras: [0, 1] },
        Cause::ColoursSwapped { colours: [Colour::Red, Colour::Blue], cameras: vec![1, 2] },
        Cause::MarkersSwapped { body: "inst0", markers: [1, 2] },
        Cause::MarkerColoursSwapped { bodies: ["inst0", "eye"], markers: [0, 2] },
        Cause::ParitySwapped { camera: None },
        Cause::Progressive { camera: Some(1) },
        Cause::ClockShifted { camera: 1, by_ms: -2.5 },
        Cause::Scale { camera: Some(2), factor: 1.01 },
        Cause::Scale { camera: None, factor: 0.99 },
        Cause::marker_moved(0, 3, [0.1, 0.0, 0.0]),
        Cause::CameraMoved { camera: 2, turn_deg: 0.3, shift_mm: 0.1 },
        Cause::Drifted,
        Cause::CamerasMoved { cameras: [0, 2] },
        Cause::Lens { camera: 1, focal: 0.97, centre_px: [0.0, 10.0], k1: -0.1 },
        Cause::PictureSize { camera: None, size_px: [640, 480] },
        Cause::KeyChanged { part: Part::Scene, key: text(), a: None, b: Some(1.5.into()) },
        Cause::InputMissing { what: text(), count: 2, lacking: 'B' },
        Cause::CameraLost { camera: 0, from_s: 1.0, lacking: 'A' },
        Cause::Shorter { lacking: 'B', fields: 3 },
        Cause::OtherVersion { program: text(), a: text(), b: text() },
        Cause::BlobNoise { rms_px: 0.1 },
        Cause::OtherMotion { rms_px: 0.0 },
        Cause::OtherMotion { rms_px: 0.5 },
        Cause::Unexplained { what: text() },
    ]
}

#[test]
fn every_cause_has_words_and_a_name_of_its_own() {
    let texts: BTreeSet<String> = all().iter().map(Cause::to_string).collect();
    assert_eq!(texts.len(), all().len());
    assert!(texts.iter().all(|text| text.len() > 10), "{texts:?}");
    let name = |cause: &Cause| serde_json::to_value(cause).unwrap()["cause"].as_str().unwrap().to_owned();
    let names: BTreeSet<String> = all().iter().map(name).collect();
    // Two kinds stand there twice, in different words.
    assert_eq!(names.len(), all().len() - 2, "{names:?}");
    assert!(names.contains("camera-moved") && names.contains("clock-shifted"));
}

#[test]
fn what_can_be_mended_has_a_remedy_and_other_motion_has_none() {
    let (mended, rest): (Vec<Cause>, Vec<Cause>) = all().into_iter().partition(|c| c.remedy().is_some());
    assert_eq!((mended.len(), rest.len()), (17, 7), "{rest:?}");
    assert!(rest.iter().all(|cause| cause.parameters() == 0));
}

#[test]
fn words_name_camera_marker_size_and_direction() {
    let says = |cause: Cause, words: &str| assert_eq!(cause.to_string(), words);
    says(Cause::ClockShifted { camera: 1, by_ms: -2.5 }, "the timestamps of camera 1 are 2.50 ms early");
    says(
        Cause::ColoursSwapped { colours: [Colour::Red, Colour::Blue], cameras: vec![1, 2] },
        "the colours red and blue are swapped in cameras 1, 2",
    );
    says(
        Cause::Lens { camera: 1, focal: 0.97, centre_px: [0.0, 10.0], k1: -0.1 },
        "the lens of camera 1 is not that of the rig file: focal length -3.00 %, principal point +0.0, +10.0 px, k1 -0.100",
    );
    says(
        Cause::marker_moved(0, 3, [0.3, 0.0, 0.4]),
        "marker 3 of inst0 was moved by 0.500 mm (+0.300, +0.000, +0.400 in its frame)",
    );
}

#[test]
fn a_wrong_lens_is_of_its_camera_and_waving_is_no_remedy() {
    let lens = Cause::Lens { camera: 1, focal: 0.97, centre_px: [0.0, 0.0], k1: 0.0 };
    assert!(lens.concerns_camera(1) && !lens.concerns_camera(0));
    assert!(!lens.moves_camera(1), "else drift recommends to refine places");
    let remedy = lens.remedy().expect("a remedy");
    assert!(remedy.contains("calibrate intrinsics") && !remedy.contains("waved"), "{remedy}");
}
