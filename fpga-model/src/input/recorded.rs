//! The fields of one camera out of a recording of pixels (`recording::PixelsReader`).

use super::Picture;
use crate::pixels;
use anyhow::{Result, bail};
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::file::MAX_SETTINGS_BYTES;
use recording::{PixelsHead, PixelsReader};
use std::path::Path;

/// Warning for a recording whose end is missing.
pub const CUT: &str = "is truncated: its writer was stopped or is still writing";

/// One camera of a recording.
pub struct Recorded {
    reader: PixelsReader,
    file: String,
    camera: u32,
    samples: Vec<u8>,
    planes: Option<FieldPicture>,
    /// The field that was read last.
    pub header: Option<FieldHeader>,
}

impl Recorded {
    /// What a recording says of itself.
    ///
    /// # Errors
    /// A file that is no recording of pixels.
    pub fn head(path: &Path) -> Result<PixelsHead> {
        let head = PixelsReader::open(path, None)?.head;
        if head.rig_json.len() as u64 > MAX_SETTINGS_BYTES {
            bail!("{}: its rig is longer than any rig file", path.display());
        }
        Ok(head)
    }

    /// Opens it.
    ///
    /// # Errors
    /// A file that is no recording of pixels.
    pub fn open(path: &Path, camera: u32) -> Result<Self> {
        let (reader, file) = (PixelsReader::open(path, Some(camera))?, path.display().to_string());
        Ok(Recorded { reader, file, camera, samples: Vec::new(), planes: None, header: None })
    }

    /// Its file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Its camera in the rig.
    pub fn camera(&self) -> u32 {
        self.camera
    }

    /// True once the end of a file was reached that is not whole.
    pub fn is_cut(&self) -> bool {
        self.reader.is_cut
    }

    /// Reads the next field; false at the end.
    ///
    /// # Errors
    /// A damaged file.
    pub fn read(&mut self, into: &mut Picture) -> Result<bool> {
        let Some(header) = self.reader.next(&mut self.samples)? else { return Ok(false) };
        let size = [header.width, header.height].map(|n| n as usize);
        let kept = self.planes.take().filter(|p| [p.width, p.height] == size);
        let mut planes = kept.unwrap_or_else(|| FieldPicture::of_size(size));
        let Some(lines) = pixels::decode(&header, &self.samples, &mut planes) else {
            bail!("{}: field {} of camera {} has no lines", self.file, header.field, header.camera);
        };
        let (width, chroma) = (planes.width, planes.width / 2);
        into.as_read.clear();
        (into.width, into.height) = (width, lines);
        let copy = |from: &[u8], to: &mut Vec<u8>, wide: usize| {
            to.clear();
            to.extend_from_slice(&from[..wide * lines]);
        };
        copy(&planes.luma, &mut into.luma, width);
        copy(&planes.blue, &mut into.blue, chroma);
        copy(&planes.red, &mut into.red, chroma);
        (self.planes, self.header) = (Some(planes), Some(header));
        Ok(true)
    }
}
