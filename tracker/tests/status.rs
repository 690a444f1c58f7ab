//! Every status a body can have, each brought about by what causes it in an operating room.

use blob_stream::BlobReader;
use nalgebra::{Point3, Vector2};
use protocol::blobs::{Blob, BlobField};
use protocol::geometry::Validity;
use protocol::poses::{BodyState, BodyStatus, ClosedBy, TrackerFrame};
use rig::camera::Camera;
use rig::{Rig, RigMarker};
use std::path::PathBuf;
use tracker::assembler::FrameAssembler;
use tracker::tracker::close;
use tracker::{Reference, Tracker};

/// Colours of the first instrument on the wire.
const RED: u32 = 1;
const YELLOW: u32 = 2;
/// Frames before the change, and the frame looked at by default.
const BEFORE: usize = 40;

fn folder(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name)
}

fn rig() -> Rig {
    Rig::load(&folder("nominal").join("rig.json")).unwrap()
}

/// The triples of the stream, each with its reference.
fn triples() -> Vec<(Vec<BlobField>, Reference)> {
    let mut assembler = FrameAssembler::new(&rig());
    let mut triples = Vec::new();
    for field in BlobReader::open(&folder("nominal").join("blobs.jsonl")).unwrap() {
        let field = field.unwrap();
        assembler.push(&field, field.blobs_out_ns).unwrap();
        while let Some(closed) = assembler.complete(field.blobs_out_ns) {
            triples.push((assembler.used().to_vec(), closed.reference));
        }
    }
    triples
}

/// Runs the stream with `rig`; from frame [`BEFORE`] on, `change` is done to every field.
fn run(rig: &Rig, count: usize, change: impl Fn(&mut BlobField)) -> Vec<TrackerFrame> {
    let mut tracker = Tracker::new(rig);
    let track = |(n, (mut used, reference)): (usize, (Vec<BlobField>, Reference))| {
        if n >= BEFORE {
            used.iter_mut().for_each(&change);
        }
        tracker.track(&used, &reference)
    };
    triples().into_iter().take(BEFORE + count).enumerate().map(track).collect()
}

fn edit(field: &mut BlobField, keep: impl FnMut(&Blob) -> Option<Blob>) {
    let blobs: Vec<Blob> = field.blobs().iter().filter_map(keep).collect();
    field.count = 0;
    blobs.into_iter().for_each(|b| field.push(b));
}

fn is_first(blob: &Blob) -> bool {
    blob.colour == RED || blob.colour == YELLOW
}

fn told(body: &BodyState) -> (BodyStatus, Validity) {
    (BodyStatus::from_wire(body.status).unwrap(), body.validity())
}

#[test]
fn tracked() {
    let frames = run(&rig(), 10, |_| ());
    for frame in &frames[2..] {
        assert!(frame.bodies.iter().all(|b| told(b) == (BodyStatus::Tracked, Validity::Measured)));
    }
}

#[test]
fn too_few_markers() {
    let frames = run(&rig(), 10, |field| edit(field, |b| (b.colour != RED).then_some(*b)));
    let (status, validity) = told(&frames[BEFORE + 8].bodies[0]);
    assert_eq!((status, validity), (BodyStatus::TooFewMarkers, Validity::Predicted));
    assert_eq!(told(&frames[BEFORE + 8].bodies[1]).0, BodyStatus::Tracked, "the other one");
}

#[test]
fn predicted_with_its_age_then_lost() {
    let frames = run(&rig(), 20, |field| edit(field, |b| (!is_first(b)).then_some(*b)));
    let last_ns = frames[BEFORE - 1].instants.exposed;
    for (n, frame) in frames.iter().enumerate().skip(BEFORE).take(5) {
        let body = &frame.bodies[0];
        assert_eq!(told(body), (BodyStatus::Predicted, Validity::Predicted), "frame {n}");
        assert_eq!(body.measured_ns.abs_diff(last_ns) / 1_000_000, 0, "the age is reported");
    }
    assert_eq!(told(&frames[BEFORE + 15].bodies[0]), (BodyStatus::Lost, Validity::Lost));
}

#[test]
fn bad_fit() {
    // A bent instrument: its blobs go apart, more every one, so that no pose explains them.
    let bend = |field: &mut BlobField| {
        let mut n = 0.0;
        edit(field, |b| {
            n += if is_first(b) { 1.0 } else { 0.0 };
            let away = if is_first(b) { 1.5 * (2.3 * n + f64::from(field_camera(b))).sin() } else { 0.0 };
            Some(Blob { x_px: b.x_px + away, y_field_px: b.y_field_px - 0.7 * away, ..*b })
        });
    };
    let frames = run(&rig(), 10, bend);
    let statuses: Vec<_> = frames[BEFORE..].iter().map(|f| told(&f.bodies[0]).0).collect();
    assert!(statuses.contains(&BodyStatus::BadFit), "{statuses:?}");
    assert!(!statuses[..3].contains(&BodyStatus::Tracked), "{statuses:?}");
}

/// Something that differs between blobs but not between runs.
fn field_camera(blob: &Blob) -> u16 {
    (blob.x_px * 7.0) as u16 % 11
}

#[test]
fn interference() {
    // A reflection beside a marker takes its place in every camera.
    let frames = run(&rig(), 6, |field| {
        let mut reds = 0;
        edit(field, |b| {
            reds += u32::from(b.colour == RED);
            let taken = b.colour == RED && reds <= 1;
            Some(if taken { Blob { x_px: b.x_px + 2.5, ..*b } } else { *b })
        });
    });
    let statuses: Vec<_> = frames[BEFORE..].iter().map(|f| told(&f.bodies[0]).0).collect();
    assert!(statuses.contains(&BodyStatus::Interference), "{statuses:?}");
    assert_eq!(told(&frames[BEFORE + 1].bodies[1]).0, BodyStatus::Tracked);
}

#[test]
fn partly_out_of_volume() {
    // The pictures of two cameras are cut so that one marker is outside and the others are not.
    let whole = run(&rig(), 1, |_| ());
    let pose = whole[BEFORE].bodies[0].world_from_body;
    let images = |model: &Camera| -> Vec<Vector2<f64>> {
        let image = |m: &RigMarker| model.project(&Point3::from(pose.transform(m.p))).unwrap();
        rig().bodies[0].markers.iter().map(image).collect()
    };
    let cut_of = |model: &Camera, marker: usize| {
        let images = images(model);
        (0..2).find_map(|axis| {
            let edge = images[marker][axis] - 12.0;
            let others = images.iter().enumerate().filter(|(m, _)| *m != marker);
            others.map(|(_, i)| i[axis]).all(|at| at < edge - 12.0).then_some((axis, edge as u32))
        })
    };
    let cuts = |marker: usize| rig().cameras().iter().map(|c| cut_of(c, marker)).collect::<Vec<_>>();
    let outermost = (0..4).map(cuts).find(|c| c.iter().flatten().count() >= 2);
    let mut cut = rig();
    for (camera, (axis, edge)) in
        cut.cameras.iter_mut().zip(outermost.unwrap()).filter_map(|(c, cut)| Some((c, cut?)))
    {
        if axis == 0 { camera.width = edge } else { camera.height = edge }
    }
    let frames = run(&cut, 1, |_| ());
    assert_eq!(told(&frames[BEFORE].bodies[0]), (BodyStatus::PartlyOutOfVolume, Validity::Measured));
}

#[test]
fn fell_behind() {
    let mut frame = *run(&rig(), 1, |_| ()).last().unwrap();
    close(&mut frame, ClosedBy::Inputs);
    assert!(frame.bodies.iter().all(|b| told(b).0 == BodyStatus::Tracked));
    close(&mut frame, ClosedBy::NextField);
    assert_eq!(frame.closed_by, ClosedBy::NextField as u32);
    assert!(frame.bodies.iter().all(|b| told(b) == (BodyStatus::FellBehind, Validity::Measured)));
}

#[test]
fn blobs_that_cannot_be_are_counted_and_ignored() {
    let rig = rig();
    let (mut plain, mut fouled) = (Tracker::new(&rig), Tracker::new(&rig));
    for (used, reference) in triples().into_iter().take(20) {
        let mut foul = used.clone();
        for field in &mut foul {
            let like = field.blobs()[0];
            field.push(Blob { x_px: f64::NAN, ..like });
            field.push(Blob { y_field_px: f64::INFINITY, ..like });
            field.push(Blob { x_px: 5000.0, ..like });
        }
        let (a, b) = (plain.track(&used, &reference), fouled.track(&foul, &reference));
        assert!(bytemuck::bytes_of(&a.bodies) == bytemuck::bytes_of(&b.bodies));
    }
    assert_eq!((plain.blobs_refused(), fouled.blobs_refused()), (0, 20 * 3 * 3));
}

#[test]
fn time_that_runs_backwards_is_counted_and_ignored() {
    let rig = rig();
    let mut assembler = FrameAssembler::new(&rig);
    let mut last = None;
    for (n, (used, _)) in triples().into_iter().take(20).enumerate() {
        for field in &used {
            let now = field.blobs_out_ns + 1_000_000_000;
            assembler.push(field, now).unwrap();
            if let Some(mut old) = last.replace(*field).filter(|_| n > 0) {
                (old.camera, old.exposed_ns) = (field.camera, field.exposed_ns - 30_000_000);
                assert!(assembler.push(&old, now).is_err());
            }
            while assembler.complete(now).is_some() {}
        }
    }
    assert_eq!(assembler.refused(), 19 * 3);
}
