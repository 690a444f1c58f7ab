//! What the tracker says of its blobs is what its poses were made of.

use blob_stream::BlobReader;
use bytemuck::Zeroable;
use protocol::blobs::{Blob, BlobField, Colour};
use protocol::matches::{BlobUse, MatchFrame, NIS_95};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use rig::Rig;
use std::collections::BTreeMap;
use std::path::Path;
use tracker::Tracker;
use tracker::assembler::FrameAssembler;

/// Tracks a stream and hands over every frame with its fields and what the tracker says of them.
fn track(rig: &Rig, fields: &[BlobField], mut visit: impl FnMut(&TrackerFrame, &[BlobField], &MatchFrame)) {
    let (mut assembler, mut tracker) = (FrameAssembler::new(rig), Tracker::new(rig));
    let mut now = 0;
    for field in fields {
        now = now.max(field.blobs_out_ns);
        assembler.add(field, now, |used, closed| {
            let frame = tracker.track(used, &closed.reference);
            visit(&frame, used, tracker.matches());
        });
    }
}

fn stream(name: &str) -> (Rig, Vec<BlobField>) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name);
    let rig = Rig::load(&folder.join("rig.json")).unwrap();
    let fields = BlobReader::open(&folder.join("blobs.jsonl")).unwrap().collect::<Result<_, _>>().unwrap();
    (rig, fields)
}

#[test]
fn residuals_are_those_of_the_poses_and_every_blob_is_there() {
    for (name, least_consistent) in [("nominal", 0.85), ("static", 0.85), ("calib", 0.0)] {
        let (rig, fields) = stream(name);
        let (mut bodies, mut blobs, mut consistent, mut predicted) = (0, 0, 0u32, 0u32);
        track(&rig, &fields, |frame, used, matches| {
            assert_eq!(matches.validate(), Ok(()));
            assert_eq!((matches.frame, matches.field), (frame.frame, frame.field));
            assert_eq!(matches.fields().len(), used.len());
            for ((of_field, field), listed) in matches.fields().iter().zip(used).zip(frame.used()) {
                assert_eq!((of_field.camera, of_field.field), (field.camera, field.field));
                assert_eq!(of_field.blobs().len(), field.blobs().len());
                let taken = of_field.blobs().iter().filter(|b| b.outcome().is_used()).count();
                assert_eq!(taken as u32, listed.blobs_used, "{name}, field {}", field.field);
                for (entry, blob) in of_field.blobs().iter().zip(field.blobs()) {
                    assert!((f64::from(entry.x_px) - blob.x_px).abs() < 0.04);
                    assert!((f64::from(entry.y_px) - field.y_frame_px(blob)).abs() < 0.04);
                    blobs += 1;
                    if entry.outcome() == BlobUse::Used && entry.nis > 0.0 {
                        predicted += 1;
                        consistent += u32::from(f64::from(entry.nis) < NIS_95);
                    }
                }
            }
            for (body, state) in frame.bodies.iter().enumerate().filter(|(_, s)| s.residual_px > 0.0) {
                let all = matches.fields().iter().flat_map(|f| f.blobs());
                let its: Vec<_> = all.filter(|b| b.outcome().is_used() && b.body as usize == body).collect();
                // Of markers that are seen whole.
                let whole = its.iter().filter(|b| b.outcome() == BlobUse::Used);
                let (n, sum) = whole.fold((0u32, 0.0), |(n, sum), b| {
                    let [x, y] = [b.residual_x_px, b.residual_y_px].map(f64::from);
                    (n + 1, sum + x * x + y * y)
                });
                if its.len() as u32 == state.blobs_used {
                    let rms = (sum / f64::from(n)).sqrt();
                    assert!((rms - state.residual_px).abs() < 1e-3, "{name}: {rms} {}", state.residual_px);
                    bodies += 1;
                }
            }
        });
        let share = f64::from(consistent) / f64::from(predicted);
        println!(
            "{name}: {bodies} residuals of bodies, {blobs} blobs, {share:.3} of {predicted} NIS below 5.99"
        );
        assert!(bodies > 100 && blobs > 1000 && predicted > 500);
        assert!(share > least_consistent);
    }
}

#[test]
fn what_is_not_used_has_its_reason() {
    let (rig, fields) = stream("nominal");
    let mut fields: Vec<_> = fields.into_iter().take(300).collect();
    let eye = rig.body("eye").unwrap().markers[0].colour;
    for field in &mut fields {
        // A reflex of a marker's colour far from all markers and one beside a blob, a blob outside of the
        // frame, and one of a colour that the rig has not.
        let near = *field.blobs().iter().find(|b| b.colour == eye as u32).unwrap();
        field.push(Blob { x_px: 2.0, y_field_px: 2.0, ..near });
        field.push(Blob { x_px: near.x_px + 12.0, ..near });
        field.push(Blob { x_px: near.x_px + 3.0, area_px: 9.0 * near.area_px, ..near });
        field.push(Blob { x_px: -400.0, ..near });
        field.push(Blob { colour: Colour::White as u32, ..near });
        field.push(Blob { area_px: 0.0, ..near });
    }
    let stranger = BlobField { camera: 7, field: 1, ..fields[0] };
    let mut counts = BTreeMap::new();
    let mut frames = 0;
    let reference =
        |f: &BlobField| tracker::Reference { camera: 0, field: f.field, exposed_ns: f.exposed_ns };
    track(&rig, &fields, |_, _, matches| {
        frames += 1;
        for blob in matches.fields().iter().flat_map(|f| f.blobs()).filter(|_| frames > 20) {
            *counts.entry(blob.outcome().text()).or_insert(0u32) += 1;
        }
        let bound = |b: &&protocol::matches::MatchedBlob| b.outcome() == BlobUse::Gated;
        for blob in matches.fields().iter().flat_map(|f| f.blobs()).filter(bound) {
            assert!(blob.nis >= 25.0 && blob.marker().is_some(), "{blob:?}");
        }
    });
    println!("{counts:?}");
    for reason in [BlobUse::Unassigned, BlobUse::Gated, BlobUse::WrongSize, BlobUse::NotTracked] {
        assert!(counts[reason.text()] > 100, "{reason:?}");
    }
    assert!(counts["malformed"] > 200 && counts["used"] > 1000);
    let mut tracker = Tracker::new(&rig);
    tracker.track(&[stranger], &reference(&stranger));
    let of_stranger = &tracker.matches().fields()[0];
    assert!(of_stranger.blobs().iter().all(|b| b.outcome() == BlobUse::UnknownCamera));
    assert_eq!(of_stranger.blobs().len(), stranger.blobs().len());
    assert_eq!(MatchFrame::zeroed().fields().len(), 0);
}
