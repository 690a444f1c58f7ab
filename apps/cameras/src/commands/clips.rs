//! Fields of cameras kept as clips, a file each: the picture at place *k* is that of field *k* of every camera.

use anyhow::Result;
use fpga_model::colours::convert::{BLACK, GREY};
use fpga_model::input::Picture;
use outputs::{OutputFile, Outputs};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Files of a folder of clips.
pub const CLIPS: outputs::Names = &[["camera-", ".y4m"]];
/// Most fields that are filled in at once; a longer gap shows only in the clip's length.
const MOST_FILLED: u64 = 10_000;

/// The clip of one camera.
struct Clip {
    file: OutputFile,
    path: PathBuf,
    /// Pictures written so far.
    written: u64,
    field_hz: f64,
    /// Parity of picture 0; `None` before, 2 of whole frames.
    first_parity: Option<u32>,
}

/// Clips of all cameras. They appear whole when they are finished.
pub struct Clips {
    clips: Vec<Clip>,
}

impl Clips {
    /// Begins a clip for each camera, which has so many fields a second, in a folder.
    ///
    /// # Errors
    /// Where a file exists or cannot be made.
    pub fn begin(
        folder: &Path,
        cameras_hz: impl Iterator<Item = f64>,
        outputs: &mut Outputs,
    ) -> Result<Self> {
        let clip = |(i, field_hz)| {
            let path = folder.join(format!("camera-{i}.y4m"));
            Ok(Clip { file: outputs.create(&path)?, path, written: 0, field_hz, first_parity: None })
        };
        Ok(Clips { clips: cameras_hz.enumerate().map(clip).collect::<Result<_>>()? })
    }

    /// Keeps field `number` of a camera. What did not come before it is black: nothing was seen.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn keep(&mut self, camera: usize, number: u64, parity: u32, picture: &Picture) -> Result<()> {
        let clip = &mut self.clips[camera];
        if clip.first_parity.is_none() {
            let (width, height, milli_hz) = (picture.width, picture.height, (clip.field_hz * 1e3).round());
            writeln!(clip.file, "YUV4MPEG2 W{width} H{height} F{milli_hz}:1000 Ip C422")?;
            clip.first_parity = Some(if parity < 2 { (parity + (number % 2) as u32) % 2 } else { parity });
        }
        let (black, grey) = (vec![BLACK; picture.luma.len()], vec![GREY; picture.blue.len()]);
        for _ in 0..number.saturating_sub(clip.written).min(MOST_FILLED) {
            write_picture(&mut clip.file, [&black, &grey, &grey])?;
        }
        clip.written = number + 1;
        Ok(write_picture(&mut clip.file, [&picture.luma, &picture.blue, &picture.red])?)
    }

    /// Ends the clips, which then appear, and returns them as sources of `--cameras`. A camera that brought nothing has
    /// none.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn finish(self) -> Result<Vec<String>> {
        let mut sources = Vec::new();
        for clip in self.clips {
            let Some(parity) = clip.first_parity else { continue };
            clip.file.finish()?;
            let parity = if parity == 1 { "?parity=1" } else { "" };
            sources.push(format!("y4m:{}{parity}", clip.path.display()));
        }
        Ok(sources)
    }
}

fn write_picture(file: &mut impl Write, planes: [&[u8]; 3]) -> std::io::Result<()> {
    file.write_all(b"FRAME\n")?;
    planes.into_iter().try_for_each(|plane| file.write_all(plane))
}

#[cfg(test)]
mod tests {
    use super::*;
    use fpga_model::input::y4m;

    #[test]
    fn a_clip_is_read_as_it_was_kept_and_what_was_lost_is_black() {
        let folder = tempfile::tempdir().unwrap();
        let mut clips = Clips::begin(folder.path(), [50.0; 2].into_iter(), &mut Outputs::new(false)).unwrap();
        let picture = |luma| Picture {
            width: 4,
            height: 2,
            luma: vec![luma; 8],
            blue: vec![90; 4],
            red: vec![200; 4],
            as_read: Vec::new(),
        };
        clips.keep(0, 1, 0, &picture(40)).unwrap();
        clips.keep(0, 3, 0, &picture(50)).unwrap();
        let sources = clips.finish().unwrap();
        let path = folder.path().join("camera-0.y4m");
        assert_eq!(sources, [format!("y4m:{}?parity=1", path.display())]);
        assert!(!folder.path().join("camera-1.y4m").exists());
        let bytes = std::fs::read(path).unwrap();
        let mut clip = y4m::Clip::open(&bytes[..], "clip").unwrap();
        assert_eq!(clip.head.rate, Some([50_000, 1_000]));
        let (mut read, mut lumas) = (Picture::default(), Vec::new());
        while clip.read(&mut read).unwrap() {
            lumas.push(read.luma[0]);
        }
        assert_eq!(lumas, [BLACK, 40, BLACK, 50]);
        assert_eq!(read, picture(50));
    }
}
