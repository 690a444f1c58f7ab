//! What cameras were set to, in a recording of pixels: a metadata record for each camera and each change.

use super::{PixelsWriter, RecordingError, failure};
use mcap::records::{Metadata, Record};
use std::collections::BTreeMap;

/// Name of the metadata record.
const METADATA: &str = "vitreo-camera-settings";
/// Its keys: the camera's id in the rig, and its settings in words.
const KEYS: [&str; 2] = ["camera", "settings"];
/// Most settings of a camera that a reader keeps.
const MOST: usize = 100;

/// Settings by camera, in the order of their records.
pub type CameraSettings = BTreeMap<u32, Vec<String>>;

impl PixelsWriter {
    /// Says what a camera was set to, for the fields of it that follow.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write_settings(&mut self, camera: u32, settings: &str) -> Result<(), RecordingError> {
        let values = [camera.to_string(), settings.to_owned()];
        let metadata = KEYS.map(str::to_owned).into_iter().zip(values).collect();
        let record = Metadata { name: METADATA.into(), metadata };
        self.writer.write_metadata(&record).map_err(|e| failure(&self.file, e))
    }
}

/// Adds what a metadata record says of a camera; one of another name, or that says nothing, is passed over.
pub(super) fn take(opcode: u8, body: &[u8], into: &mut CameraSettings) {
    let Ok(Record::Metadata(found)) = mcap::parse_record(opcode, body) else { return };
    let [camera, settings] = KEYS.map(|key| found.metadata.get(key));
    let (Some(camera), Some(settings)) = (camera.and_then(|id| id.parse().ok()), settings) else { return };
    let all = if found.name == METADATA { into.entry(camera).or_default() } else { return };
    if all.last() != Some(settings) && all.len() < MOST {
        all.push(settings.clone());
    }
}
