//! Tests of the faults: effect, side effects and rate of each.

use super::spec::FORMAT;
use super::*;
use crate::cameras::{Cameras, Path};
use crate::painter::Light;
use ::scene::{DEFAULT_SCENE, SceneFile};
use bytemuck::Zeroable;
use fpga_model::camera_extractor::CameraExtractor;
use protocol::blobs::{BLOB_SATURATED, Blob, BlobField};
use protocol::fields::FieldPicture;
use surgeon::motion::MotionSource;

fn rig() -> Rig {
    Rig::load_or_shipped(None).unwrap()
}

fn surgeon() -> MotionSource {
    MotionSource::new(&SceneFile::load(DEFAULT_SCENE).unwrap(), &rig(), None, 1)
}

fn faults(text: &str) -> FaultInjector {
    let spec = FaultSpec::parse(&format!("format = \"{FORMAT}\"\n{text}"), "test").unwrap();
    FaultInjector::new(spec, &rig(), 7).unwrap()
}

/// Blobs of the fields of all cameras, and the fault records.
fn run(
    path: Path,
    faults: FaultInjector,
    numbers: impl Iterator<Item = u64>,
) -> (Vec<BlobField>, Vec<tally::FaultRecord>) {
    let rig = rig();
    let mut cameras = Cameras::with_faults(&rig, path, 1, faults).unwrap();
    let mut extractors: Vec<_> =
        rig.cameras().iter().map(|c| CameraExtractor::new(&rig, c).unwrap()).collect();
    let mut payload = vec![0; cameras.payload_bytes()];
    let (mut surgeon, mut fields, mut records) = (surgeon(), Vec::new(), Vec::new());
    for number in numbers {
        for (i, extractor) in extractors.iter_mut().enumerate() {
            let mut field = BlobField::zeroed();
            let mut exposure = cameras.expose(i, &mut surgeon, number);
            let header = exposure.header();
            if path == Path::Direct {
                exposure.blobs(&mut field);
            } else {
                exposure.paint(&mut payload);
                let picture = FieldPicture::in_payload(&header, &payload).unwrap();
                extractor.extract(&header, &picture, &mut field);
            }
            fields.push(field);
            cameras.delivery(i, number);
        }
        records.extend_from_slice(cameras.tally.waiting());
        cameras.tally.clear_waiting();
    }
    (fields, records)
}

/// Fault events of a field.
fn about<'a>(records: &'a [tally::FaultRecord], field: &BlobField) -> impl Iterator<Item = FaultEvent> + 'a {
    let (number, camera) = (field.field, field.camera);
    records.iter().filter(move |e| (e.field, e.camera) == (number, camera)).map(|e| e.event)
}

fn same(a: &Blob, b: &Blob) -> bool {
    a == b
}

#[test]
fn fields_are_dropped_and_late_at_their_rates_and_independently() {
    let faults = faults("[dropped]\nrate = 0.1\n[late]\nrate = 0.2\ndelay-ms = 10\ncameras = [1]");
    let n = 20_000;
    let share = |hit: &dyn Fn(u64) -> bool| (0..n).filter(|&k| hit(k)).count() as f64 / n as f64;
    let (dropped, late) = (share(&|k| faults.dropped(0, k)), share(&|k| faults.delay_ns(1, k) > 0));
    // Four standard deviations of a share.
    assert!((dropped - 0.1).abs() < 0.0085 && (late - 0.2).abs() < 0.0114, "{dropped} {late}");
    let both = share(&|k| faults.dropped(0, k) && faults.dropped(1, k));
    assert!((both - 0.01).abs() < 0.003, "cameras are independent: {both}");
    assert_eq!(share(&|k| faults.delay_ns(0, k) > 0), 0.0, "limited to camera 1");
    let mean = (0..n).map(|k| faults.delay_ns(1, k)).sum::<u64>() as f64 / (late * n as f64);
    assert!((mean / 5e6 - 1.0).abs() < 0.03, "evenly from 0 to 10 ms: {mean}");
}

#[test]
fn the_answer_does_not_depend_on_the_order_of_questions() {
    for path in [Path::Pixels, Path::Direct] {
        let hard = || FaultInjector::new(FaultSpec::load("hard").unwrap(), &rig(), 3).unwrap();
        let (fields, records) = run(path, hard(), 40..60);
        let (back, records_back) = run(path, hard(), (40..60).rev());
        for field in &fields {
            let other = back.iter().find(|f| (f.camera, f.field) == (field.camera, field.field)).unwrap();
            assert_eq!(bytemuck::bytes_of(field), bytemuck::bytes_of(other), "{path:?}");
            assert!(about(&records, field).eq(about(&records_back, field)));
        }
        let again = run(path, hard(), 40..60);
        assert!(again.1 == records && again.0.iter().zip(&fields).all(|(a, b)| a.blobs() == b.blobs()));
        let other = FaultInjector::new(FaultSpec::load("hard").unwrap(), &rig(), 4).unwrap();
        assert_ne!(run(path, other, 40..60).1, records, "another seed, other faults");
    }
}

#[test]
fn nothing_goes_wrong_where_nothing_is_asked_for() {
    let clean = run(Path::Direct, FaultInjector::none(&rig()), 0..30);
    let none =
        run(Path::Direct, FaultInjector::new(FaultSpec::load("none").unwrap(), &rig(), 9).unwrap(), 0..30);
    assert!(clean.1.is_empty() && none.1.is_empty());
    assert!(clean.0.iter().zip(&none.0).all(|(a, b)| a.blobs() == b.blobs()));
}

#[test]
fn occlusion_takes_blobs_away_and_leaves_the_others_as_they_are() {
    let clean = run(Path::Direct, FaultInjector::none(&rig()), 0..200);
    let (fields, records) = run(Path::Direct, faults("[occlusion]\nrate = 0.02"), 0..200);
    let mut hidden_fields = 0;
    for (field, clean) in fields.iter().zip(&clean.0) {
        let hidden: u32 = about(&records, field)
            .map(|event| match event {
                FaultEvent::Occlusion { markers, .. } => markers.count_ones(),
                other => panic!("{other:?}"),
            })
            .sum();
        let kept = field.blobs().iter().filter(|b| clean.blobs().iter().any(|c| same(b, c))).count();
        assert_eq!(kept, field.blobs().len(), "every blob is one of the clean field");
        assert!(clean.count - field.count <= hidden, "no more than the log says");
        hidden_fields += u32::from(hidden > 0);
    }
    // 0.02 a field, 10.5 fields long: about a fifth of the time.
    let share = f64::from(hidden_fields) / fields.len() as f64;
    assert!((0.1..0.3).contains(&share), "{share}");
}

#[test]
fn a_reflection_adds_one_blob_of_the_markers_colour_that_moves() {
    let clean = run(Path::Direct, FaultInjector::none(&rig()), 0..100);
    let (fields, records) = run(Path::Direct, faults("[reflections]\nrate = 0.05\nfields = 30"), 0..100);
    let mut added = Vec::new();
    for (field, clean) in fields.iter().zip(&clean.0) {
        let new: Vec<_> =
            field.blobs().iter().filter(|b| !clean.blobs().iter().any(|c| same(b, c))).collect();
        let events: Vec<_> = about(&records, field).collect();
        assert!(new.len() <= events.len() && field.count >= clean.count);
        if let ([blob], [FaultEvent::Reflections { x, y, .. }]) = (&new[..], &events[..]) {
            assert!((blob.x_px - x).abs() < 0.5 && (field.y_frame_px(blob) - y).abs() < 0.5);
            added.push((field.camera, field.field, *x));
        }
    }
    assert!(added.len() > 50, "{} ghosts", added.len());
    let moves = |w: &[(u32, u64, f64)]| w[0].0 == w[1].0 && w[1].1 == w[0].1 + 1 && w[0].2 != w[1].2;
    added.sort_by_key(|a| (a.0, a.1));
    assert!(added.windows(2).any(moves));
}

#[test]
fn a_glaring_marker_saturates_on_both_paths() {
    let text = "[saturated]\nrate = 0.05\nbrightness = 4";
    for path in [Path::Direct, Path::Pixels] {
        let (fields, records) = run(path, faults(text), 0..25);
        let (mut glaring, mut flagged, mut wrong) = (0, 0, 0);
        for field in &fields {
            let events = about(&records, field).count();
            let saturated = field.blobs().iter().filter(|b| b.flags & BLOB_SATURATED != 0).count();
            glaring += events;
            flagged += saturated.min(events);
            wrong += saturated.saturating_sub(events);
        }
        assert!(glaring > 10 && wrong == 0, "{path:?}: {glaring} glaring, {wrong} flagged without cause");
        // A marker may lie outside the frame, and one that turns white may be no marker's colour.
        assert!(flagged * 3 > glaring, "{path:?}: {flagged} of {glaring} flagged");
    }
}

#[test]
fn a_torn_field_is_whole_above_the_tear_and_old_or_empty_below() {
    let faults = faults("[torn]\nrate = 0.5");
    let whole = |number: u64| {
        let mut picture = FieldPicture::new([720, 576]);
        picture.luma.iter_mut().for_each(|p| *p = number as u8);
        picture
    };
    let (mut mixed, mut missing) = (0, 0);
    for number in 1..200 {
        let Some(tear) = faults.tear(0, number, 288) else { continue };
        let mut picture = whole(100);
        tear.apply(&mut picture, &whole(50));
        for line in 0..288 {
            let expected = match (tear.is_intact(line as f64), tear.missing) {
                (true, _) => 100,
                (false, 0) => 50,
                (false, _) => 16,
            };
            assert!(picture.line(line).0.iter().all(|&p| p == expected), "line {line} of {tear:?}");
        }
        (mixed, missing) = (mixed + u32::from(tear.missing == 0), missing + u32::from(tear.missing > 0));
    }
    assert!(mixed > 30 && missing > 30, "{mixed} {missing}");
    assert!((0..200).filter(|&k| faults.tear(1, k, 288).is_some()).count() > 70);
}

#[test]
fn torn_fields_show_older_markers_below_the_tear_on_both_paths() {
    for path in [Path::Direct, Path::Pixels] {
        let clean = run(path, FaultInjector::none(&rig()), 0..60).0;
        let (fields, records) = run(path, faults("[torn]\nrate = 0.3"), 0..60);
        let (mut torn, mut changed) = (0, 0);
        for (field, clean) in fields.iter().zip(&clean) {
            let event = about(&records, field).next();
            let Some(FaultEvent::Torn { line, .. }) = event else {
                assert_eq!(field.blobs(), clean.blobs(), "{path:?}: whole fields stay");
                continue;
            };
            torn += 1;
            changed += u32::from(field.blobs() != clean.blobs());
            let above = |b: &&Blob| b.y_field_px + b.height_px < line as f64 - 2.0;
            let upper = field.blobs().iter().filter(above);
            assert!(upper.eq(clean.blobs().iter().filter(above)), "{path:?}: the upper part stays");
        }
        assert!(torn > 30 && changed > torn / 3, "{path:?}: {changed} of {torn}");
    }
}

#[test]
fn hot_pixels_are_specks_and_no_blobs() {
    let faults = faults("[hot-pixels]\ncount = 60");
    let mut picture = FieldPicture::new([720, 576]);
    let clean = picture.clone();
    faults.add_hot_pixels(1, 288, &mut picture);
    let differ: Vec<usize> = (0..clean.luma.len()).filter(|&i| clean.luma[i] != picture.luma[i]).collect();
    assert!((55..=60).contains(&differ.len()), "{}", differ.len());
    assert!(differ.iter().all(|&i| picture.luma[i] >= 150));
    assert_eq!((&picture.blue, &picture.red), (&clean.blue, &clean.red));
    let mut other = clean.clone();
    faults.add_hot_pixels(0, 288, &mut other);
    assert_ne!(other.luma, picture.luma, "each camera has its own");

    let (fields, records) = run(Path::Pixels, faults, 0..10);
    let clean = run(Path::Pixels, FaultInjector::none(&rig()), 0..10).0;
    let counts = |all: &[BlobField]| all.iter().map(|f| i64::from(f.count)).sum::<i64>();
    assert!((counts(&fields) - counts(&clean)).abs() <= 2, "{} {}", counts(&fields), counts(&clean));
    assert_eq!(records.len(), 3, "one record a camera");
}

#[test]
fn a_flickering_lamp_beats_against_the_exposure() {
    let faults = faults("[flicker]\ndepth = 0.2\nhz = 100.5");
    let period = rig().field_period_ns();
    let gains: Vec<f64> = (0..200).map(|k| faults.light(0, k * period).gain).collect();
    let most = gains.iter().copied().fold(0.0, f64::max);
    let least = gains.iter().copied().fold(9.0, f64::min);
    // An exposure of 4 ms leaves sin(x)/x of the swing with x = π·100.5·0.004: 0.755.
    let swing = 0.2 * 0.755;
    assert!((most - 1.0 - swing).abs() < 0.002 && (1.0 - least - swing).abs() < 0.002, "{least} {most}");
    // 100.5 Hz seen 50 times a second is a beat of 0.5 Hz: 100 fields.
    assert!(gains.iter().zip(&gains[100..]).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!((gains[0] - gains[50]).abs() > 0.0);
    assert_eq!(faults.light(0, 5).gain, faults.light(2, 5).gain, "one lamp");
    assert_eq!(faults.light(0, 5).hue_rad, 0.0);
}

#[test]
fn colours_turn_slowly_and_come_back() {
    let faults = faults("[colour-drift]\nhue-deg = 10\ngain = 0.2\nperiod-s = 8\ncameras = [0, 1]");
    let at = |camera: u32, ms: u64| faults.light(camera, ms * 1_000_000);
    let lights: Vec<Light> = (0..800).map(|i| at(0, 10 * i)).collect();
    let hue = lights.iter().map(|l| l.hue_rad.to_degrees().abs()).fold(0.0, f64::max);
    let gain = lights.iter().map(|l| (l.chroma_gain - 1.0).abs()).fold(0.0, f64::max);
    assert!((hue - 10.0).abs() < 0.01 && (gain - 0.2).abs() < 0.001, "{hue} {gain}");
    assert!(lights.windows(2).all(|w| (w[1].hue_rad - w[0].hue_rad).to_degrees().abs() < 0.1), "slowly");
    assert!((at(0, 0).hue_rad - at(0, 8000).hue_rad).abs() < 1e-9);
    assert!(at(0, 0) != at(1, 0), "each decoder drifts by itself");
    assert_eq!(at(2, 77), Light::default());
}

#[test]
fn clocks_drift_within_their_limits() {
    let faults = faults("[clock-drift]\nppm = 200\nphase-ms = 15\ncameras = [1, 2]");
    let second = 1_000_000_000;
    assert_eq!(faults.clock(0).exposed_ns(50), second, "genlocked");
    for camera in [1, 2] {
        let clock = faults.clock(camera);
        assert!(clock.phase_ns < 15_000_000 && clock.ppb.abs() <= 200_000 && clock.ppb != 0);
        let drift = clock.exposed_ns(50) as i64 - (second + clock.phase_ns) as i64;
        assert_eq!(drift, clock.ppb);
        let spacing = (0..100).map(|k| clock.exposed_ns(k + 1) - clock.exposed_ns(k));
        assert!(spacing.into_iter().all(|ns| ns.abs_diff(20_000_000) <= 4001));
    }
    assert_ne!(faults.clock(1), faults.clock(2));
}
