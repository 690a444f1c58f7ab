//! Whatever comes in, frames stay finite and valid, and nothing panics.

use bytemuck::Zeroable;
use proptest::prelude::*;
use protocol::blobs::{Blob, BlobField};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use rig::Rig;
use tracker::assembler::FrameAssembler;
use tracker::{Reference, Tracker};

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -50.0..800.0f64,
        1 => any::<f64>(),
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, 0.0, -0.0, 1e300, f64::MIN_POSITIVE]),
    ]
}

fn any_blob() -> impl Strategy<Value = Blob> {
    (prop::array::uniform8(any_number()), 0u32..9, any::<u32>()).prop_map(|(n, colour, flags)| Blob {
        x_px: n[0],
        y_field_px: n[1] * 0.5,
        area_px: n[2],
        width_px: n[3],
        height_px: n[4],
        var_x_px2: n[5] * 1e-4,
        var_y_px2: n[6] * 1e-4,
        cov_xy_px2: n[7] * 1e-4,
        colour,
        flags,
    })
}

fn any_field() -> impl Strategy<Value = BlobField> {
    let blobs = prop::collection::vec(any_blob(), 0..80);
    (0u32..5, 0u64..50, 1u64..900_000_000, 0u32..3, blobs).prop_map(
        |(camera, number, exposed_ns, parity, blobs)| {
            let mut field = BlobField::zeroed();
            (field.camera, field.field, field.exposed_ns, field.parity) =
                (camera, number, exposed_ns, parity);
            field.blobs_out_ns = exposed_ns + 24_000_000;
            for blob in blobs {
                field.push(blob);
            }
            field
        },
    )
}

fn rig() -> Rig {
    Rig::load_or_shipped(None).unwrap()
}

/// Fields of the shipped rig with both instruments and the eye in view.
fn good_fields() -> Vec<BlobField> {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker/static/blobs.jsonl");
    let all = blob_stream::BlobReader::open(&path).unwrap();
    all.take(90).collect::<Result<_, _>>().unwrap()
}

fn feed(
    assembler: &mut FrameAssembler,
    tracker: &mut Tracker,
    field: &BlobField,
    now: u64,
) -> Vec<TrackerFrame> {
    let mut frames = Vec::new();
    assembler.add(field, now, |used, closed| frames.push(tracker.track(used, &closed.reference)));
    frames
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn garbage_through_the_assembler_makes_valid_frames(fields in prop::collection::vec(any_field(), 1..60)) {
        let (mut assembler, mut tracker) = (FrameAssembler::new(&rig()), Tracker::new(&rig()));
        let mut now = 0;
        for field in &fields {
            now = field.blobs_out_ns.max(now);
            for frame in feed(&mut assembler, &mut tracker, field, now) {
                prop_assert!(frame.validate().is_ok(), "{:?}", frame.validate());
            }
        }
    }

    #[test]
    fn garbage_straight_into_the_tracker_makes_valid_frames(
        frames in prop::collection::vec(prop::collection::vec(any_field(), 0..20), 1..12),
    ) {
        let mut tracker = Tracker::new(&rig());
        for used in &frames {
            let exposed_ns = used.last().map_or(1, |f| f.exposed_ns);
            let frame = tracker.track(used, &Reference { camera: 0, field: 0, exposed_ns });
            prop_assert!(frame.validate().is_ok(), "{:?}", frame.validate());
        }
    }

    #[test]
    fn garbage_between_good_fields_is_survived(
        garbage in prop::collection::vec((0usize..60, any_field()), 1..40),
    ) {
        let (mut assembler, mut tracker) = (FrameAssembler::new(&rig()), Tracker::new(&rig()));
        let good = good_fields();
        let mut last = None;
        for (i, field) in good.iter().enumerate() {
            for (_, bad) in garbage.iter().filter(|(at, _)| *at == i) {
                let mut bad = *bad;
                bad.exposed_ns = bad.exposed_ns.min(field.exposed_ns.saturating_sub(1));
                for frame in feed(&mut assembler, &mut tracker, &bad, field.blobs_out_ns) {
                    prop_assert!(frame.validate().is_ok());
                }
            }
            for frame in feed(&mut assembler, &mut tracker, field, field.blobs_out_ns) {
                prop_assert!(frame.validate().is_ok());
                last = Some(frame);
            }
        }
        let last = last.unwrap();
        prop_assert!(last.bodies.iter().all(|b| b.validity == 2), "{:?}", last.bodies.map(|b| (b.validity, b.status)));
    }
}
