//! Runs that the tests of several modules begin with.

use crate::engine::Recorded;
use crate::resimulate::scene_of;
use recording::Recording;
use rig::Rig;
use simcore::world::World;
use std::path::Path;

/// The recording that every build repeats to the bit. It has no checkpoints of its tracker, so that tests can put
/// them where they want them.
pub fn golden() -> Recording {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap");
    Recording::open(&path).unwrap()
}

/// At its beginning.
pub fn begin(recording: &Recording) -> Recorded {
    let rig = Rig::parse(&recording.provenance().rig_json, "recorded").unwrap();
    Recorded::new(recording, &rig, World::new(&scene_of(recording).unwrap()).unwrap().unseen())
}
