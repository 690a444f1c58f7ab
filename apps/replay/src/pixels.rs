//! A recording of pixels for a replay: its blobs are found as `vitreo blobs` finds them, and lie in a temporary recording.

use crate::import::provenance;
use anyhow::ensure;
use calibration::cli::fields_in;
use outputs::Scratch;
use recording::{Item, PixelsReader, Recording, Writer};
use scene::DEFAULT_SCENE;
use std::path::Path;

/// The blobs of a recording of pixels, as a recording.
pub struct Found {
    /// The recording.
    pub recording: Recording,
    /// Where it lies, until it is dropped.
    _folder: Scratch,
}

/// True of a recording of pixels.
pub fn is_recorded(path: &Path) -> bool {
    PixelsReader::open(path, None).is_ok()
}

/// Finds the blobs of a recording of pixels, by the colour classes of `colours` or the shipped ones.
///
/// # Errors
/// A recording or colours that cannot be read, or a folder for temporary files that cannot be written.
pub fn found(path: &Path, colours: Option<&Path>) -> anyhow::Result<Found> {
    let (rig_json, mut fields) = fields_in(path, colours)?;
    // Cameras take turns there, also where one of them has lost fields.
    fields.sort_by_key(|field| field.blobs_out_ns);
    let folder = Scratch::new()?;
    let file = folder.path().join("blobs.mcap");
    let mut writer = Writer::create(&file, &provenance(rig_json.unwrap_or_default(), path, DEFAULT_SCENE)?)?;
    for field in fields {
        writer.write(field.blobs_out_ns, &Item::Blobs(Box::new(field)))?;
    }
    writer.finish()?;
    Ok(Found { recording: Recording::open(&file)?, _folder: folder })
}

/// Refuses colours for what has blobs already.
///
/// # Errors
/// Where it is so.
pub fn check_colours(path: &Path, colours: Option<&Path>) -> anyhow::Result<()> {
    ensure!(
        colours.is_none(),
        "--colours: {} has blobs already; expected a recording of pixels (vitreo cameras --record-fields FILE.mcap)",
        path.display()
    );
    Ok(())
}
