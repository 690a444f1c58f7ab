//! Streams with truth: a rig that has drifted is noticed and brought back, one that has not is left
//! alone.

use blob_stream::BlobReader;
use calibration::bundle::PriorSigmas;
use calibration::causes::{Cause, Verdict, judge};
use calibration::cli::waved_report;
use calibration::drift_check;
use calibration::lens::{LENS, lens_of};
use calibration::mend::{Mended, mend};
use calibration::observations::{FrameObservations, collect};
use calibration::self_calibration::{FEWEST_INSTANTS, fitted, refine, refine_stream};
use calibration::target_problem::rms;
use nalgebra::Vector3;
use protocol::blobs::BlobField;
use rig::Rig;
use std::collections::HashMap;
use std::path::PathBuf;

/// Systematic shift that is tolerated, px: less than the program's default, since the blobs of
/// these streams are centred on their markers' images.
const LIMIT_PX: f64 = 0.02;

struct Stream {
    rig: Rig,
    fields: Vec<BlobField>,
    /// Tips in the world, mm, by exposure.
    truth: HashMap<u64, [Vector3<f64>; 2]>,
}

fn load(name: &str) -> Stream {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/tracker").join(name);
    let text = std::fs::read_to_string(folder.join("truth.csv")).unwrap();
    let row = |line: &str| {
        let (t, rest) = line.split_once(',').unwrap();
        let v: Vec<f64> = rest.split(',').map(|n| n.parse().unwrap()).collect();
        (t.parse().unwrap(), [Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5])])
    };
    Stream {
        rig: Rig::load(&folder.join("rig.json")).unwrap(),
        fields: BlobReader::open(&folder.join("blobs.jsonl")).unwrap().collect::<Result<_, _>>().unwrap(),
        truth: text.lines().skip(1).map(row).collect(),
    }
}

/// Root mean square error, µm, of the tips of poses that are fitted instant by instant with `rig`
/// to what was seen: neither a filter nor a tracker's own estimate of the drift takes part.
fn tips_um(stream: &Stream, rig: &Rig, fields: &[BlobField]) -> f64 {
    let (instants, bundle) = fitted(rig, &collect(rig, fields)).unwrap();
    let (mut squares, mut n) = (0.0, 0);
    for (instant, poses) in instants.iter().zip(&bundle.poses) {
        let Some(truth) = stream.truth.get(&instant.exposed_ns) else { continue };
        for (pose, tip) in poses.iter().zip(truth) {
            let Some(pose) = pose else { continue };
            squares += (pose.translation.vector - tip).norm_squared() * 1e6;
            n += 1;
        }
    }
    assert!(n > 40, "{n} tips only");
    (squares / f64::from(n)).sqrt()
}

#[test]
fn the_rig_that_drew_a_stream_holds_whatever_else_its_cameras_see() {
    // The last one has false blobs in every field, and an instrument that is out of the eye.
    for name in ["nominal", "static", "samecol", "async", "tremor", "hard"] {
        let stream = load(name);
        let judged = judge(&stream.rig, &stream.fields, |_, _| true);
        println!("{name}: {}", judged.text());
        assert!(judged.holds && judged.verdict == Verdict::NothingWrong, "{name}: {}", judged.text());
        assert!(judged.explanations.is_empty() && judged.blobs > 1_000, "{name}: {judged:?}");
        assert_eq!(judged.text().contains("reflections"), name == "hard", "{}", judged.text());
    }
    let drifted = load("calib");
    assert!(!judge(&drifted.rig, &drifted.fields, |_, _| true).holds);
}

#[test]
fn a_drifted_rig_is_noticed_and_brought_back() {
    let stream = load("calib");
    let half_ns = 1_500_000_000;
    let first: Vec<BlobField> = stream.fields.iter().filter(|f| f.exposed_ns < half_ns).copied().collect();
    let seen = collect(&stream.rig, &first);
    let found = drift_check::check(&stream.rig, &seen, LIMIT_PX).unwrap();
    assert!(found.cameras.iter().any(|c| c.systematic_px > 0.05 && c.drifted), "{found:?}");
    let refined = refine(&stream.rig, &seen, &PriorSigmas::default(), &mut |_, _| {}).unwrap();
    let [before, after] = [&refined.before, &refined.residuals].map(|r| rms(r.iter().copied()));
    assert!(after < 0.75 * before, "residuals {before} px, then {after} px");
    let better = refined.bundle.rig(&stream.rig);
    // Judged by what the adjustment has not seen.
    let rest: Vec<BlobField> = stream.fields.iter().filter(|f| f.exposed_ns >= half_ns).copied().collect();
    let [old, new] = [&stream.rig, &better].map(|rig| tips_um(&stream, rig, &rest));
    println!("residuals {before:.4} → {after:.4} px; tips of the other half {old:.2} → {new:.2} µm");
    assert!(new < 0.95 * old, "tips {old} µm, then {new} µm");
    let again = drift_check::check(&better, &collect(&better, &rest), LIMIT_PX).unwrap();
    assert!(!again.drifted(), "{again:?}");
}

#[test]
fn a_rig_that_holds_is_left_alone() {
    for name in ["static", "nominal"] {
        let stream = load(name);
        let seen = collect(&stream.rig, &stream.fields);
        let found = drift_check::check(&stream.rig, &seen, LIMIT_PX).unwrap();
        assert!(!found.drifted(), "{name}: {found:?}");
        assert!(found.cameras.iter().all(|c| c.systematic_px < 0.01), "{name}: {found:?}");
        // Nothing to be gained, and little lost by refining all the same.
        let refined = refine(&stream.rig, &seen, &PriorSigmas::default(), &mut |_, _| {}).unwrap();
        let better = refined.bundle.rig(&stream.rig);
        let [old, new] = [&stream.rig, &better].map(|rig| tips_um(&stream, rig, &stream.fields));
        println!("{name}: tips {old:.2} → {new:.2} µm");
        assert!(new < old + 1.0, "{name}: tips {old} µm, then {new} µm");
    }
}

#[test]
fn a_camera_that_was_knocked_is_the_one_that_is_named() {
    let stream = load("static");
    let mut knocked = stream.rig.clone();
    // Turned about its own centre by 0.1 mrad: its picture moves by 0.16 px.
    let (old, turn) = (&stream.rig.cameras()[1], nalgebra::Rotation3::new(Vector3::new(0.0, 1e-4, 0.0)));
    let (rotation, t) = (turn * old.camera_from_world, turn * old.translation_mm);
    knocked.cameras[1].rotation = std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)]));
    knocked.cameras[1].t = t.into();
    let found = drift_check::check(&knocked, &collect(&knocked, &stream.fields), LIMIT_PX).unwrap();
    let worst =
        (0..3).max_by(|&a, &b| found.cameras[a].systematic_px.total_cmp(&found.cameras[b].systematic_px));
    assert!(found.drifted() && worst == Some(1), "{found:?}");
}

#[test]
fn a_wrong_lens_is_named_and_no_place_is_refined_to_hide_it() {
    let stream = load("nominal");
    // Focal length 2 % too long in the rig file, k1 too large by 0.1, principal point 10 px too far right.
    for (at, by) in [(0, 0.02), (4, 0.1), (2, 10.0)] {
        let mut wrong = stream.rig.clone();
        let own = &mut wrong.cameras[1];
        match at {
            0 => (own.fx, own.fy) = (own.fx * (1.0 + by), own.fy * (1.0 + by)),
            2 => own.cx += by,
            _ => own.dist[0] += by,
        }
        let judged = judge(&wrong, &stream.fields, |_, _| true);
        println!("{}", judged.text());
        let [only] = &judged.explanations[..] else { panic!("{}", judged.text()) };
        let Cause::Lens { camera: 1, focal, centre_px, k1 } = only.cause else { panic!("{}", judged.text()) };
        let off = |i: usize| if at == i { -by } else { 0.0 };
        assert!((focal - 1.0 - off(0)).abs() < 0.004, "{}", judged.text());
        assert!((centre_px[0] - off(2)).abs() < 2.0 && (k1 - off(4)).abs() < 0.02, "{}", judged.text());
        let known = PriorSigmas::default();
        let mended = mend(&wrong, &stream.fields, &known, &judged, 200, &mut |_, _| {}).unwrap();
        let Mended::Nothing(why) = mended else { panic!("a rig was written") };
        assert!(why.contains("lens of camera 1"), "{why}");
    }
}

#[test]
fn places_that_take_up_another_error_are_not_written() {
    // Pixels that are not square: no place of a camera makes up for it, and everything free takes up a part of it.
    let stream = load("tremor");
    let mut wrong = stream.rig.clone();
    wrong.cameras[1].fy *= 1.01;
    let judged = judge(&wrong, &stream.fields, |_, _| true);
    assert!(!judged.holds, "{}", judged.text());
    let mended = mend(&wrong, &stream.fields, &PriorSigmas::default(), &judged, 200, &mut |_, _| {}).unwrap();
    let Mended::Nothing(why) = mended else { panic!("a rig was written: {}", judged.text()) };
    println!("{}: {why}", judged.text());
}

#[test]
fn a_camera_that_was_moved_far_is_no_wrong_lens() {
    let stream = load("nominal");
    // Turned by 6 mrad, some 10 px, so that its turn is not small; and by 2 mrad with a shift of 0.2 mm.
    for (turn, shift) in [([4e-3, -4.5e-3, 0.0], 0.0), ([0.0, 2e-3, 1e-3], 0.2)] {
        let mut knocked = stream.rig.clone();
        let turned = nalgebra::Rotation3::new(turn.into()) * stream.rig.cameras()[2].camera_from_world;
        knocked.cameras[2].rotation = std::array::from_fn(|r| std::array::from_fn(|c| turned[(r, c)]));
        knocked.cameras[2].t[0] += shift;
        let judged = judge(&knocked, &stream.fields, |_, _| true);
        println!("{}", judged.text());
        let is_moved = |cause: &Cause| matches!(cause, Cause::CameraMoved { camera: 2, .. });
        assert!(judged.explanations.iter().any(|e| is_moved(&e.cause)), "{}", judged.text());
        let is_lens = |cause: &Cause| matches!(cause, Cause::Lens { .. });
        assert!(!judged.explanations.iter().any(|e| is_lens(&e.cause)), "{}", judged.text());
    }
}

#[test]
fn a_rough_rig_becomes_as_good_as_the_true_one() {
    let stream = load("nominal");
    let mut rough = stream.rig.clone();
    // Camera by camera some 0.1 mm and 0.8 mrad, which is 2 px; markers by 10 µm.
    for (c, camera) in rough.cameras.iter_mut().enumerate() {
        let k = c as f64 + 1.0;
        let turn =
            nalgebra::Rotation3::new(Vector3::new((1.7 * k).sin(), (2.9 * k).cos(), (0.6 * k).sin()) * 8e-4);
        let turned = turn * camera.model().camera_from_world;
        camera.rotation = std::array::from_fn(|r| std::array::from_fn(|c| turned[(r, c)]));
        camera.t.iter_mut().enumerate().for_each(|(i, t)| *t += 0.1 * (k + 2.0 * i as f64).sin());
    }
    for marker in rough.bodies.iter_mut().flat_map(|b| &mut b.markers) {
        let k = f64::from(marker.id) * 3.1;
        marker.p.iter_mut().enumerate().for_each(|(i, p)| *p += 0.01 * (k + i as f64).cos());
    }
    let known = PriorSigmas { camera_mm: 0.1, camera_rad: 1e-3, marker_mm: 0.01, lens_px: 0.0 };
    let found = refine_stream(&rough, &stream.fields, &known, 200, &mut |_, _| {}).unwrap();
    let after = rms(found.residuals.iter().copied());
    // The noise of the blobs alone leaves 0.09 px.
    println!("rough rig: residuals {:.2} → {after:.4} px", rms(found.before.iter().copied()));
    assert!(after < 0.11 && found.residuals.len() > 4000, "{after} px of {}", found.residuals.len());
    let better = found.bundle.rig(&rough);
    let holds = drift_check::check(&better, &collect(&better, &stream.fields), LIMIT_PX).unwrap();
    assert!(!holds.drifted(), "{holds:?}");
    println!("tips {:.1} µm", tips_um(&stream, &better, &stream.fields));
}

#[test]
fn too_short_a_stream_is_refused_in_words() {
    let stream = load("static");
    let few: Vec<FrameObservations> = collect(&stream.rig, &stream.fields[..12]);
    let refused =
        refine(&stream.rig, &few, &PriorSigmas::default(), &mut |_, _| {}).err().unwrap().to_string();
    assert!(refused.contains(&format!("at least {FEWEST_INSTANTS}")), "{refused}");
    let refused = drift_check::check(&stream.rig, &few, LIMIT_PX).unwrap_err().to_string();
    assert!(refused.contains("at least"), "{refused}");
    assert!(refine(&stream.rig, &[], &PriorSigmas::default(), &mut |_, _| {}).is_err());
}

#[test]
fn lens_terms_that_a_stream_does_not_determine_stay_as_in_the_rig() {
    let stream = load("calib");
    let refined = |lens_px: f64| {
        let known = PriorSigmas { lens_px, ..PriorSigmas::default() };
        refine_stream(&stream.rig, &stream.fields, &known, 60, &mut |_, _| {}).unwrap()
    };
    let before = stream.rig.cameras();
    // A lens of which no stream says more than is known.
    let sure = refined(1e-4);
    assert_eq!(sure.held.len(), 5 * before.len(), "{:?}", sure.held);
    for (old, new) in before.iter().zip(&sure.bundle.cameras) {
        assert_eq!(old.distortion, new.distortion);
        assert_ne!(old.focal_px, new.focal_px, "only the terms of the distortion are held");
    }
    let report = waved_report(&stream.rig, &sure, true);
    let said = "camera 1: the stream does not determine k3, k2, p2, p1, k1: kept as in the rig";
    assert!(report.notes.iter().any(|note| note == said), "{:?}", report.notes);
    let open = refined(2.0);
    println!("held at a lens known to 2 px: {:?}", open.held);
    assert!(open.held.len() < sure.held.len());
    for (c, (old, new)) in before.iter().zip(&open.bundle.cameras).enumerate() {
        for term in 4..LENS {
            let is_held = open.held.contains(&(c, term));
            assert_eq!(lens_of(old)[term] == lens_of(new)[term], is_held, "term {term} of camera {c}");
        }
    }
}
