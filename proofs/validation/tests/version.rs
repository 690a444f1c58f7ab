//! The tracker's arithmetic and its version change together: recordings name the version, and
//! `vitreo replay --verify` compares poses to the bit only where it is the same.

#[path = "../../../libs/recording/src/tracker_version.rs"]
mod tracker_version;

use blob_stream::BlobReader;
use nalgebra::Vector3;
use protocol::blobs::BlobField;
use protocol::message::fnv1a;
use rig::Rig;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use tracker::stream::track_stream;
use tracker_version::{TRACKER_DIGESTS, TRACKER_VERSION};
use validation::streams::{Knock, Recipe, Scenario};

/// Recorded streams, folders of `tests/data/tracker`, and streams that are drawn here. A further one needs no other version.
const STREAMS: [&str; 6] = ["calib", "nominal", "samecol", "static", "hard", "knocked"];
/// Fewer frames than this say nothing about the arithmetic.
const FRAMES: u64 = 50;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A rig and its fields. The drawn ones last as long as it takes that an instrument is taken out, a camera is
/// silent, and one that stood elsewhere from the start is used again.
fn stream(name: &str) -> (Rig, Vec<BlobField>) {
    let knock = |at_s, px: f64| {
        let turn = Vector3::new(0.6, 0.8, 0.0) * (px / 1_600.0);
        Knock { camera: 1, at_s, turn, shift_mm: Vector3::zeros(), goes_on: false }
    };
    let (scenario, knocks) = match name {
        "hard" => (Scenario::Hard, vec![]),
        "knocked" => (Scenario::Withdrawn, vec![knock(0.0, 2.0), knock(7.0, 3.0)]),
        recorded => {
            let folder = repository().join("tests/data/tracker").join(recorded);
            let fields = BlobReader::open(&folder.join("blobs.jsonl")).unwrap();
            return (Rig::load(&folder.join("rig.json")).unwrap(), fields.collect::<Result<_, _>>().unwrap());
        }
    };
    let drawn =
        Recipe { scenario, seed: 1, seconds: 10.0, knocks }.draw(&Rig::load_or_shipped(None).unwrap());
    (drawn.rig, drawn.fields)
}

/// FNV-1a over the bytes of every body of every frame.
fn digest(name: &str) -> u64 {
    let (rig, fields) = stream(name);
    let (mut bytes, mut frames) = (Vec::new(), 0);
    track_stream(&rig, &fields, |frame, _| {
        frames += 1;
        bytes.extend_from_slice(bytemuck::bytes_of(&frame.bodies));
    });
    assert!(frames >= FRAMES, "{name}: {frames} frames");
    fnv1a(&bytes)
}

/// What the file holds of a stream, and what is computed now.
fn compare() -> Vec<(&'static str, Option<u64>, u64)> {
    let held = |stream| TRACKER_DIGESTS.iter().find(|(name, _)| *name == stream).map(|(_, digest)| *digest);
    STREAMS.iter().map(|&stream| (stream, held(stream), digest(stream))).collect()
}

#[test]
fn arithmetic_changes_only_with_its_version() {
    for (stream, held, now) in compare() {
        assert_eq!(
            held,
            Some(now),
            "poses of {stream} are not those of tracker version {TRACKER_VERSION}. If that is meant, run \
             `make tracker-version`, which raises the version and renews the golden recording, and commit both"
        );
    }
}

/// Rewrites the version's file: a higher version where a digest that it holds has changed.
#[test]
#[ignore = "writes a source file; run by `make tracker-version`"]
fn renew() {
    let digests = compare();
    let changed = digests.iter().any(|(_, held, now)| held.is_some_and(|held| held != *now));
    let version = TRACKER_VERSION + u32::from(changed);
    let file = repository().join("libs/recording/src/tracker_version.rs");
    let text = std::fs::read_to_string(&file).unwrap();
    let (head, rest) = text.split_once("pub const TRACKER_VERSION").unwrap();
    let (_, rest) = rest.split_once(";\n").unwrap();
    let (middle, _) = rest.split_once("pub const TRACKER_DIGESTS").unwrap();
    let mut new = format!("{head}pub const TRACKER_VERSION: u32 = {version};\n{middle}");
    new += "pub const TRACKER_DIGESTS: &[(&str, u64)] = &[\n";
    for (stream, _, now) in &digests {
        writeln!(new, "    (\"{stream}\", 0x{now:016x}),").unwrap();
    }
    std::fs::write(&file, new + "];\n").unwrap();
    println!("tracker version {version}");
}
