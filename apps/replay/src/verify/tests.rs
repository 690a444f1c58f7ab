//! What is compared, counted and said.

use super::*;
use bytemuck::Zeroable;
use protocol::geometry::Pose;

#[test]
fn the_first_difference_names_its_field() {
    let mut verdict = Verdict::default();
    let mut recorded = TrackerFrame::zeroed();
    recorded.field = 41;
    verdict.pose(&recorded, &recorded.clone());
    assert_eq!((verdict.poses.compared, verdict.poses.identical, &verdict.difference), (1, 1, &None));
    let mut other = recorded;
    other.bodies[1].predictor.velocity_mm_s[2] = -0.0;
    verdict.pose(&recorded, &other);
    let text = verdict.difference.clone().unwrap();
    assert!(text.contains("field 41") && text.contains("inst1") && text.contains("predictor"), "{text}");
    let step = StepRecord { field: 42, ..StepRecord::zeroed() };
    verdict.step(&step, &StepRecord { state_hash: 1, ..step });
    assert_eq!(verdict.difference.as_ref(), Some(&text), "the first one stays");
    assert!(verdict.text().contains("1 of 2 poses") && verdict.text().contains("0 of 1 states"));
}

#[test]
fn stretches_are_runs_of_steps_that_could_be_compared() {
    let mut verdict = Verdict::default();
    let step = StepRecord { field: 42, ..StepRecord::zeroed() };
    verdict.step(&step, &step);
    verdict.step(&step, &step);
    verdict.pass_over_steps(2);
    verdict.step(&step, &step);
    let states = &verdict.states;
    assert_eq!((states.compared, states.stretches, states.undetermined, states.recorded), (3, 2, 2, 5));
    assert!(
        verdict
            .text()
            .contains("3 of 3 compared states (5 recorded) from recorded poses identical, in 2 stretches")
    );
    assert!(
        verdict.left_out().contains(&"2 steps could not be compared: inputs are missing".to_string()),
        "{:?}",
        verdict.left_out()
    );
}

#[test]
fn hashes_are_compared_where_they_are_of_one_version_and_timing_is_not() {
    let mut verdict = Verdict::default();
    let step = StepRecord { field: 42, step: 3, ..StepRecord::zeroed() };
    let mut slower = step;
    (slower.instants.stepped, slower.profile.tissue_ns) = (99, 7);
    verdict.step(&step, &slower);
    assert_eq!(verdict.difference, None);
    let other = StepRecord { state_hash: 1, ..step };
    let mut incomparable = Verdict::default();
    incomparable.states.other_version = Some(7);
    incomparable.step(&step, &other);
    let states = &incomparable.states;
    assert_eq!((states.recorded, states.compared, &incomparable.difference), (1, 0, &None));
    assert!(incomparable.is_empty() && incomparable.text().starts_with("nothing verified: "));
    assert!(incomparable.text().ends_with("0 of 1 states compared"));
    assert!(incomparable.left_out().join("; ").contains("state hashes are of version 7"));
    verdict.step(&step, &other);
    assert!(verdict.difference.unwrap().contains("field 42"));
}

#[test]
fn poses_of_another_tracker_are_measured_and_do_not_count_as_altered() {
    let frame = |x_mm: f64, half_angle: f64, validity: Validity| {
        let mut frame = TrackerFrame::zeroed();
        for body in &mut frame.bodies {
            body.world_from_body = Pose::IDENTITY;
            body.validity = validity as u32;
        }
        let body = &mut frame.bodies[0].world_from_body;
        body.position_mm[0] = x_mm;
        body.rotation_wxyz = [half_angle.cos(), half_angle.sin(), 0.0, 0.0];
        frame
    };
    let mut verdict = Verdict::default();
    verdict.poses.other_version = Some(3);
    let recorded = frame(1.0, 0.0, Validity::Measured);
    verdict.pose(&recorded, &frame(1.003, 0.001, Validity::Measured));
    verdict.pose(&recorded, &frame(1.004, 0.0, Validity::Measured));
    verdict.pose(&recorded, &frame(1.0, 0.0, Validity::Lost));
    let d = &verdict.poses.differences["inst0"];
    assert_eq!((d.frames, d.measured_by_one, verdict.poses.compared, &verdict.difference), (2, 1, 3, &None));
    assert!((d.rms_um - 12.5_f64.sqrt()).abs() < 1e-6 && (d.max_um - 4.0).abs() < 1e-6, "{d:?}");
    assert!((d.max_mrad - 2.0).abs() < 1e-6 && (d.rms_mrad - 2.0_f64.sqrt()).abs() < 1e-6, "{d:?}");
    let text = verdict.text();
    let expected = format!("made by tracker 3, this is {TRACKER_VERSION}: 3 of 3 poses");
    assert!(text.contains(&expected) && text.contains("inst0 RMS 3.54 max 4.00 µm, RMS 1.414"), "{text}");
    assert!(verdict.left_out()[0].starts_with("made by tracker 3"));
}

#[test]
fn a_recording_without_versions_is_said_to_have_none() {
    let verdict = Verdict::new(&Provenance::default(), false);
    assert_eq!((verdict.poses.other_version, verdict.states.other_version), (Some(0), Some(1)));
    let reasons = verdict.left_out().join("; ");
    for words in ["without a version", "no poses were recorded", "state hashes are of version 1", "no steps"]
    {
        assert!(reasons.contains(words), "{words}: {reasons}");
    }
}

#[test]
fn poses_of_a_desk_need_no_cameras() {
    let mut verdict = Verdict::new(&Provenance::default(), true);
    verdict.states.other_version = None;
    verdict.pass_over_pose();
    let step = StepRecord::zeroed();
    verdict.step(&step, &step);
    assert_eq!(verdict.left_out(), Vec::<String>::new());
    assert_eq!(
        verdict.text(),
        "verified: 1 poses of a desk or of another tracker, without cameras; 1 of 1 states from recorded poses identical"
    );
}
