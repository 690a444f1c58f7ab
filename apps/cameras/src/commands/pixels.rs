//! Fields of cameras kept in a recording of pixels, which grows from its first field on.

use anyhow::Result;
use fpga_model::input::Picture;
use outputs::{GrowingFile, Outputs};
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader};
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use std::path::Path;

/// A recording of pixels of some cameras.
pub struct Pixels {
    file: GrowingFile,
    writer: PixelsWriter,
    samples: Vec<u8>,
}

impl Pixels {
    /// Begins one of the first `cameras` cameras of a rig. It gets its name with its first field.
    ///
    /// # Errors
    /// Where a file exists or cannot be made.
    pub fn begin(path: &Path, cameras: usize, rig: &Rig, outputs: &mut Outputs) -> Result<Self> {
        let file = outputs.grow(path)?;
        let head = PixelsHead {
            rig_json: rig.to_json(),
            cameras: rig.cameras().iter().take(cameras).map(|camera| camera.id).collect(),
            field_hz: rig.field_hz,
            realtime_offset_ns: ipc::clock::realtime_offset_ns(),
        };
        let writer = PixelsWriter::on(file.handle()?, path, &head)?;
        Ok(Pixels { file, writer, samples: Vec::new() })
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
