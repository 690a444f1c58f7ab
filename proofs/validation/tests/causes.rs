//! Planted defects are named, and nothing else is.

use calibration::causes::{Cause, Verdict, judge};
use protocol::blobs::{Blob, Colour};
use protocol::random::Random;
use validation::judged::{draw, said};
use validation::planted::{Defect, Planted, is_truth, plant};
use validation::streams::Scenario;

/// A few seconds; what begins later begins after the first.
fn planted(defect: Defect, seed: u64) -> Planted {
    plant(defect, Scenario::Nominal, seed, 4.5, 1.5)
}

#[test]
fn each_defect_is_named_and_no_innocent_with_it() {
    let mut named = 0;
    for defect in Defect::ALL.into_iter().filter(|d| *d != Defect::None) {
        let planted = planted(defect, 1);
        let truth: Cause = planted.truth.clone().expect("a defect");
        let judged = judge(&planted.rig, &planted.fields, |_, _| true);
        println!("{truth}\n    {}", judged.text());
        assert_eq!(judged.verdict, Verdict::Explained, "{defect:?}: {}", judged.text());
        assert!(
            judged.explanations.iter().any(|e| is_truth(&e.cause, &truth)),
            "{defect:?}: {}",
            judged.text()
        );
        assert!((judged.since_s - planted.since_s).abs() < 1.1, "{defect:?}: {}", judged.text());
        named += 1;
    }
    assert_eq!(named, 10);
}

#[test]
fn what_no_residual_shows_is_named() {
    // Colours of one camera and of two markers, from the start; stamps that step halfway, when the judged beginning is over.
    let mut named = 0;
    for defect in Defect::MORE {
        for seed in [3, 4] {
            let planted = plant(defect, Scenario::Nominal, seed, 8.0, 0.0);
            let truth = planted.truth.clone().expect("a defect");
            let judged = judge(&planted.rig, &planted.fields, |_, _| true);
            println!("{truth} from {:.1} s\n    {}", planted.since_s, judged.text());
            assert!(!judged.holds, "{truth}: {}", judged.text());
            assert_eq!(judged.explanations.len(), 1, "{truth}: {}", judged.text());
            assert!(is_truth(&judged.explanations[0].cause, &truth), "{truth}: {}", judged.text());
            assert!((judged.since_s - planted.since_s).abs() < 1.1, "{truth}: {}", judged.text());
            named += 1;
        }
    }
    assert_eq!(named, 6);
}

#[test]
fn a_wrong_lens_of_the_rig_file_is_named_alone() {
    for (defect, seed) in Defect::LENSES.into_iter().zip([8022, 8026, 8024]) {
        let planted = plant(defect, Scenario::Nominal, seed, 4.0, 0.0);
        let truth = planted.truth.clone().expect("a defect");
        let judged = judge(&planted.rig, &planted.fields, |_, _| true);
        assert_eq!(judged.explanations.len(), 1, "{truth}: {}", judged.text());
        assert!(is_truth(&judged.explanations[0].cause, &truth), "{truth}: {}", judged.text());
    }
}

#[test]
fn what_hides_behind_something_else_is_named() {
    // Camera 1 was moved much less than camera 2; the blobs of a marker lie so far beside it that the tracker takes them for
    // reflections, and the rest of the rig is as it should be.
    are_named_alone(&[(22_219, true), (22_326, false)]);
}

#[test]
fn what_is_wrong_in_a_stream_with_many_false_blobs_is_named() {
    // Two markers' colours, one colour in one camera, a clock, a scale, and two cameras that were moved by several pixels;
    // a seventh of the blobs there belongs to no marker.
    are_named_alone(&[(40_038, false), (40_041, true), (40_045, true), (40_046, false), (40_105, true)]);
}

fn are_named_alone(seeds: &[(u64, bool)]) {
    for &(seed, whole) in seeds {
        let (_, planted) = draw(seed, whole, false);
        let truth = planted.truth.clone().expect("a defect");
        let judged = judge(&planted.rig, &planted.fields, |_, _| true);
        assert!(!judged.holds, "{truth}: {}", judged.text());
        assert_eq!(judged.explanations.len(), 1, "{truth}: {}", judged.text());
        assert!(is_truth(&judged.explanations[0].cause, &truth), "{truth}: {}", judged.text());
    }
}

#[test]
fn timestamps_of_the_arrival_are_named() {
    // A driver that stamps pictures of camera 1 when they arrive; nothing is wrong with their exposures.
    let Planted { rig, mut fields, .. } = planted(Defect::None, 5);
    let random = &mut Random::new(5, 91);
    for field in fields.iter_mut().filter(|f| f.camera == 1) {
        field.exposed_ns = field.exposed_ns.saturating_add_signed(random.between(-3e6, 3e6) as i64);
    }
    let judged = judge(&rig, &fields, |_, _| true);
    assert_eq!(judged.explanations.len(), 1, "{}", judged.text());
    let Cause::TimestampsJitter { camera: 1, rms_ms } = judged.explanations[0].cause else {
        panic!("{}", judged.text());
    };
    // A uniform distribution of ± 3 ms.
    assert!((1.5..2.0).contains(&rms_ms), "{rms_ms}");
}

#[test]
fn half_of_the_blobs_may_be_reflections() {
    let Planted { rig, mut fields, .. } = planted(Defect::None, 6);
    let random = &mut Random::new(6, 92);
    let colours = [Colour::Red, Colour::Yellow, Colour::Green, Colour::Cyan, Colour::Blue];
    for field in &mut fields {
        let like = field.blobs[0];
        for _ in 0..13 {
            let (x_px, y_field_px) = (random.between(5.0, 715.0), random.between(3.0, 284.0));
            let (area_px, colour) = (random.between(60.0, 400.0), random.one_of(&colours) as u32);
            field.push(Blob { x_px, y_field_px, area_px, colour, ..like });
        }
    }
    let judged = judge(&rig, &fields, |_, _| true);
    assert!(judged.verdict == Verdict::NothingWrong && judged.holds, "{}", judged.text());
    assert!((0.4..0.6).contains(&judged.unexplained), "{}", judged.unexplained);
}

#[test]
fn where_nothing_is_wrong_nothing_is_named() {
    for seed in 1..4 {
        let planted = planted(Defect::None, seed);
        let judged = judge(&planted.rig, &planted.fields, |_, _| true);
        assert_eq!(
            (judged.verdict, judged.explanations.len()),
            (Verdict::NothingWrong, 0),
            "{}",
            judged.text()
        );
        assert!(judged.blobs > 1000);
    }
}

/// Two cameras do not see an instrument outside of the eye well enough to follow it while the third is silent; and while
/// it is taken out, markers that hide each other seem to have moved. In the last stream a false blob lies beside a hidden
/// marker for 0.3 s, where an estimate from deweighted blobs finds a wrong minimum.
#[test]
fn an_instrument_that_is_taken_out_is_no_error() {
    for (seed, own_rig) in [(40546, false), (40558, false), (40618, false), (40619, true), (40746, false)] {
        let (_, Planted { rig, fields, .. }) = draw(seed, own_rig, true);
        let judged = judge(&rig, &fields, |_, _| true);
        println!("seed {seed}: {}", judged.text());
        assert!(judged.verdict == Verdict::NothingWrong && judged.holds, "seed {seed}: {}", judged.text());
    }
}

#[test]
fn nothing_broken_is_said_to_hold_and_no_innocent_is_blamed() {
    // `make judge` has the others; those of odd seeds have rigs of their own. Cameras of 0 to 15 are free-running; 0 is
    // intact.
    for seed in (0..8).chain([18, 20, 22, 23]) {
        let said = said(seed, seed % 2 == 1, false);
        println!("seed {seed}, {}\n    {}", said.truth, said.judgement.text());
        assert!(!said.holds_wrongly() && !said.is_blamed_wrongly(), "seed {seed}: {}", said.judgement.text());
        assert!(said.right && !said.is_false_alarm(), "seed {seed}: {}", said.judgement.text());
    }
}
