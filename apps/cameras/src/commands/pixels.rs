//! Fields of cameras kept in a recording of pixels, which grows from its first field on.

use anyhow::Result;
use fpga_model::input::Picture;
use outputs::{GrowingFile, Outputs};
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader};
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use std::collections::BTreeMap;
use std::path::Path;

/// A recording of pixels of some cameras.
pub struct Pixels {
    file: GrowingFile,
    writer: PixelsWriter,
    samples: Vec<u8>,
    /// What each camera was last said to be set to.
    settings: BTreeMap<u32, String>,
}

impl Pixels {
    /// Begins one of the first cameras of a rig, whose pictures come from `sources`. It gets its name with its first field.
    ///
    /// # Errors
    /// Where a file exists or cannot be made.
    pub fn begin(path: &Path, sources: Vec<String>, rig: &Rig, outputs: &mut Outputs) -> Result<Self> {
        let file = outputs.grow(path)?;
        let head = PixelsHead {
            rig_json: rig.to_json(),
            cameras: rig.cameras().iter().take(sources.len()).map(|camera| camera.id).collect(),
            field_hz: rig.field_hz,
            realtime_offset_ns: ipc::clock::realtime_offset_ns(),
            sources,
        };
        let writer = PixelsWriter::on(file.handle()?, path, &head)?;
        Ok(Pixels { file, writer, samples: Vec::new(), settings: BTreeMap::new() })
    }

    /// Says what a camera was set to, where that is news.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn set(&mut self, camera: u32, settings: &str) -> Result<()> {
        let known = self.settings.entry(camera).or_default();
        if known != settings {
            self.writer.write_settings(camera, settings)?;
            settings.clone_into(known);
        }
        Ok(())
    }

    /// Keeps a field, all of its lines. One without an instant is passed over: only the first of invented cameras, at
    /// the origin of their time, has none.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn keep(&mut self, header: &FieldHeader, picture: &Picture) -> Result<()> {
        if header.exposed_ns == 0 {
            return Ok(());
        }
        self.file.appear()?;
        let header = FieldHeader { format: FORMAT_YCBCR_422, lines: picture.height as u32, ..*header };
        self.samples.clear();
        [&picture.luma, &picture.blue, &picture.red].iter().for_each(|plane| self.samples.extend(*plane));
        Ok(self.writer.write(&header, &self.samples)?)
    }

    /// Ends the recording, and returns it as a source of `--cameras`.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn finish(mut self) -> Result<String> {
        self.writer.finish()?;
        self.file.appear()?;
        Ok(format!("mcap:{}", self.file.path().display()))
    }
}

#[cfg(test)]
mod tests;
