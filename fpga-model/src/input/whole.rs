//! Whole pictures of one camera out of a recording of pixels, for boards that are held still: the two fields of an
//! interlaced frame are put together.

use super::Picture;
use super::recorded::{CUT, Recorded};
use anyhow::{Result, ensure};
use protocol::blobs::WHOLE_FRAME;
use protocol::fields::FieldHeader;
use recording::PixelsReader;
use std::path::Path;

/// True of a recording of pixels; one of messages has another profile.
pub fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap") && PixelsReader::open(path, None).is_ok()
}

/// Number of the frame that a field belongs to: fields 2k and 2k + 1 make frame k.
pub fn frame_of(header: &FieldHeader) -> u64 {
    if header.parity == WHOLE_FRAME { header.field } else { header.field / 2 }
}

/// Fields of one camera in their order, of which two make a frame where it is interlaced.
#[derive(Default)]
pub struct Frames {
    /// A field whose frame lacks the other one so far.
    first: Option<(FieldHeader, Picture)>,
}

impl Frames {
    /// Takes the next field. Where it ends a frame, that replaces the picture, and its number is returned; the same for
    /// all cameras. A frame of which a field is missing is left out.
    pub fn take(&mut self, header: &FieldHeader, picture: &mut Picture) -> Option<u64> {
        let number = frame_of(header);
        if header.parity == WHOLE_FRAME {
            return Some(number);
        }
        match self.first.take() {
            Some((first, other)) if frame_of(&first) == number && first.parity != header.parity => {
                *picture = woven(&other, picture, first.parity == 0);
                Some(number)
            }
            _ => {
                self.first = Some((*header, picture.clone()));
                None
            }
        }
    }
}

/// The frames of a camera.
pub struct WholePictures {
    recorded: Recorded,
    fields: Frames,
    frames: u64,
}

impl WholePictures {
    /// Opens a recording.
    ///
    /// # Errors
    /// A file that is no recording of pixels, or one without this camera.
    pub fn open(path: &Path, camera: u32) -> Result<Self> {
        let cameras = Recorded::head(path)?.cameras;
        let name = path.display();
        ensure!(cameras.contains(&camera), "{name}: has no camera {camera}; its cameras are {cameras:?}");
        Ok(WholePictures { recorded: Recorded::open(path, camera)?, fields: Frames::default(), frames: 0 })
    }

    /// Reads the next frame and returns its number, which is the same for all cameras; `None` at the end. Interlaced
    /// frames of which a field is missing are left out.
    ///
    /// # Errors
    /// A damaged file, or one without a frame of this camera.
    pub fn read(&mut self, into: &mut Picture) -> Result<Option<u64>> {
        while self.recorded.read(into)? {
            let Some(header) = self.recorded.header else { continue };
            if let Some(number) = self.fields.take(&header, into) {
                self.frames += 1;
                return Ok(Some(number));
            }
        }
        let (file, camera) = (self.recorded.file(), self.recorded.camera());
        ensure!(self.frames > 0, "{file}: has no whole picture of camera {camera}");
        if self.recorded.is_cut() {
            tracing::warn!("{file}: {CUT}: {} pictures of camera {camera} were read", self.frames);
        }
        Ok(None)
    }
}

/// Lines of two fields in turn, as many of each as both have.
pub fn woven(a: &Picture, b: &Picture, a_is_even: bool) -> Picture {
    let (even, odd) = if a_is_even { (a, b) } else { (b, a) };
    let (width, lines) = (even.width, even.height.min(odd.height));
    let mut whole = Picture { width, height: 2 * lines, ..Picture::default() };
    for y in 0..lines {
        for field in [even, odd] {
            let (luma, blue, red) = field.line(y);
            whole.luma.extend_from_slice(luma);
            whole.blue.extend_from_slice(blue);
            whole.red.extend_from_slice(red);
        }
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::fields::FORMAT_YCBCR_422;
    use recording::{PixelsHead, PixelsWriter};
    use std::fs::File;

    const SIZE: [u32; 2] = [16, 8];

    /// Fields with these numbers, of which every line has its number in the frame as luma.
    fn written(path: &Path, numbers: &[u64]) {
        let head = PixelsHead {
            rig_json: "{}".into(),
            cameras: vec![3],
            field_hz: 50.0,
            realtime_offset_ns: 0,
            sources: Vec::new(),
        };
        let mut writer = PixelsWriter::on(File::create(path).unwrap(), path, &head).unwrap();
        for &field in numbers {
            let parity = (field % 2) as u32;
            let header = FieldHeader {
                field,
                exposed_ns: field + 1,
                first_line_ns: field + 1,
                line_period_ns: 1,
                camera: 3,
                parity,
                format: FORMAT_YCBCR_422,
                width: SIZE[0],
                height: SIZE[1],
                lines: SIZE[1],
            };
            let luma = (0..SIZE[1]).flat_map(|y| [(2 * y + parity) as u8; SIZE[0] as usize]);
            let samples: Vec<u8> = luma.chain([128; (SIZE[0] * SIZE[1]) as usize]).collect();
            writer.write(&header, &samples).unwrap();
        }
        writer.finish().unwrap();
    }

    #[test]
    fn two_fields_make_a_frame_and_a_single_one_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        // Frames 1, 3 and 5 are whole; of 2 and 4 a field is missing.
        written(&path, &[1, 2, 3, 5, 6, 7, 8, 10, 11]);
        assert!(is_recording(&path));
        let (mut pictures, mut picture) = (WholePictures::open(&path, 3).unwrap(), Picture::default());
        let mut numbers = Vec::new();
        while let Some(number) = pictures.read(&mut picture).unwrap() {
            numbers.push(number);
            assert_eq!([picture.width, picture.height], [16, 16]);
            let lines: Vec<u8> = picture.luma.iter().step_by(16).copied().collect();
            assert_eq!(lines, (0..16).collect::<Vec<u8>>());
            assert_eq!((picture.blue.len(), picture.red.len()), (128, 128));
        }
        assert_eq!(numbers, [1, 3, 5]);
    }

    #[test]
    fn a_camera_or_pictures_that_are_not_there_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        written(&path, &[0, 2]);
        let refused = |camera| {
            let read = |mut whole: WholePictures| whole.read(&mut Picture::default());
            WholePictures::open(&path, camera).and_then(read).unwrap_err().to_string()
        };
        assert!(refused(0).contains("has no camera 0; its cameras are [3]"), "{}", refused(0));
        assert!(refused(3).contains("has no whole picture of camera 3"), "{}", refused(3));
        std::fs::write(&path, "x").unwrap();
        assert!(!is_recording(&path));
    }
}
