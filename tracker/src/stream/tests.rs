//! The bits of recorded streams, at whatever level of optimisation these tests are built.

use super::track_stream;
use blob_stream::BlobReader;
use protocol::message::fnv1a;
use rig::Rig;
use std::path::Path;

#[path = "../../../libs/recording/src/tracker_version.rs"]
mod tracker_version;

/// `proofs/validation/tests/version.rs` compares the same digests with what the release profile computes.
#[test]
fn poses_do_not_depend_on_how_the_tracker_was_compiled() {
    let mut compared = Vec::new();
    for (name, held) in tracker_version::TRACKER_DIGESTS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker").join(name);
        if !folder.exists() {
            continue; // One that is generated.
        }
        let rig = Rig::load(&folder.join("rig.json")).unwrap();
        let fields: Vec<_> =
            BlobReader::open(&folder.join("blobs.jsonl")).unwrap().collect::<Result<_, _>>().unwrap();
        let mut bytes = Vec::new();
        track_stream(&rig, &fields, |frame, _| bytes.extend_from_slice(bytemuck::bytes_of(&frame.bodies)));
        assert_eq!(fnv1a(&bytes), *held, "{name}, tracker version {}", tracker_version::TRACKER_VERSION);
        compared.push(*name);
    }
    assert_eq!(compared, ["calib", "nominal", "samecol", "static"]);
}
