//! Raw video: YUV4MPEG2 with 4:2:0 chroma, full range, ITU-R BT.601 (as in JPEG).

use super::picture::scale_rgb;
use super::planes::{JPEG, to_planes};
use crate::readback::Picture;
use outputs::{GrowingFile, OutputError};
use std::fs::File;
use std::io::{BufWriter, Write};

/// A file being written; it appears with its first picture. All pictures have one size.
pub struct Y4m {
    name: GrowingFile,
    file: BufWriter<File>,
    size: [u32; 2],
    rgb: Vec<u8>,
    planes: Vec<u8>,
}

impl Y4m {
    /// Begins a file for pictures of `size` (both even), `hz` a second.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn begin(name: GrowingFile, size: [u32; 2], hz: u32) -> Result<Self, OutputError> {
        let mut file = BufWriter::new(name.handle()?);
        let [w, h] = size;
        writeln!(file, "YUV4MPEG2 W{w} H{h} F{hz}:1 Ip A1:1 C420jpeg XCOLORRANGE=FULL")
            .map_err(|e| OutputError::io(name.path(), e))?;
        Ok(Self { name, file, size, rgb: Vec::new(), planes: Vec::new() })
    }

    /// Writes `picture`, scaled to the file's size, `count` times.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&mut self, picture: &Picture, count: u64) -> Result<(), OutputError> {
        self.name.appear()?;
        let [w, h] = self.size;
        scale_rgb(picture, w, h, &mut self.rgb);
        to_planes(&self.rgb, w as usize, h as usize, &JPEG, &mut self.planes);
        for _ in 0..count {
            let written = self.file.write_all(b"FRAME\n").and_then(|()| self.file.write_all(&self.planes));
            written.map_err(|e| OutputError::io(self.name.path(), e))?;
        }
        Ok(())
    }

    /// Brings everything to the disk's care.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn flush(&mut self) -> Result<(), OutputError> {
        self.file.flush().map_err(|e| OutputError::io(self.name.path(), e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use outputs::Outputs;

    #[test]
    fn every_frame_has_the_same_length() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.y4m");
        let file = Outputs::new(false).grow(&path).unwrap();
        let mut video = Y4m::begin(file, [8, 4], 25).unwrap();
        assert!(!path.exists());
        for n in [4u32, 8, 20] {
            let picture = Picture { width_px: 2 * n, height_px: n, rgba: vec![50; (8 * n * n) as usize] };
            video.write(&picture, 1).unwrap();
        }
        video.flush().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let header = bytes.iter().position(|&b| b == b'\n').unwrap() + 1;
        assert!(bytes.starts_with(b"YUV4MPEG2 W8 H4 F25:1 Ip A1:1 C420"));
        assert_eq!(bytes.len() - header, 3 * (6 + 8 * 4 * 3 / 2));
    }
}
