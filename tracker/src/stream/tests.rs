//! The bits of recorded streams, at whatever level of optimisation these tests are built.

use super::track_stream;
use blob_stream::BlobReader;
use protocol::message::fnv1a;
use rig::Rig;
use std::path::Path;

#[path = "../../../libs/recording/src/tracker_version.rs"]
mod tracker_version;
use tracker_version::{TRACKER_DIGESTS, TRACKER_VERSION};

/// `proofs/validation/tests/version.rs` compares the same digests with what the release profile computes.
#[test]
fn poses_do_not_depend_on_how_the_tracker_was_compiled() {
    for name in ["calib", "nominal", "samecol", "static"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name);
        let rig = Rig::load(&folder.join("rig.json")).unwrap();
        let fields = BlobReader::open(&folder.join("blobs.jsonl")).unwrap();
        let fields: Vec<_> = fields.collect::<Result<_, _>>().unwrap();
        let mut bytes = Vec::new();
        track_stream(&rig, &fields, |frame, _| bytes.extend_from_slice(bytemuck::bytes_of(&frame.bodies)));
        let held = TRACKER_DIGESTS.iter().find(|(stream, _)| *stream == name).map(|(_, digest)| *digest);
        assert_eq!(held, Some(fnv1a(&bytes)), "{name}, tracker version {TRACKER_VERSION}");
    }
}
