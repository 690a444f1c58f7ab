//! Reads pictures from a camera of this machine (Video4Linux2, for instance `/dev/video0`).
//!
//! The camera keeps the size it is set to (`v4l2-ctl --set-fmt-video` changes it) and is asked for
//! YUYV, which is 4:2:2. A camera without YUYV is refused. The driver gives no instant of exposure;
//! the reader stamps pictures on arrival.

use super::Picture;
use super::packed::{Layout, Packing};
use anyhow::{Result, anyhow, bail, ensure};
use linuxvideo::format::{Format, PixFormat, PixelFormat};
use linuxvideo::stream::ReadStream;
use linuxvideo::{BufType, Device};
use std::path::Path;

/// A running camera.
pub struct Camera {
    file: String,
    stream: ReadStream,
    layout: Layout,
    taken: u64,
}

impl Camera {
    /// Opens a camera and starts it.
    ///
    /// # Errors
    /// A device that is no camera, or delivers no YUYV of a valid size.
    pub fn open(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let refused = |problem| anyhow!("{file}: {problem}");
        let device = Device::open(path).map_err(|e| failed("opens", e)).map_err(refused)?;
        let (stream, layout) = start(device).map_err(refused)?;
        Ok(Camera { file, stream, layout, taken: 0 })
    }

    /// Its name, for messages.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Waits for the next picture.
    ///
    /// # Errors
    /// A driver that fails or delivers too few bytes.
    pub fn read(&mut self, into: &mut Picture) -> Result<bool> {
        self.taken += 1;
        let layout = self.layout;
        let taken = self.stream.dequeue(|bytes| Ok(layout.unpack(&bytes, into)));
        let unpacked = taken.map_err(anyhow::Error::from).and_then(|unpacked| unpacked);
        unpacked.map_err(|problem| anyhow!("{}, picture {}: {problem}", self.file, self.taken))?;
        Ok(true)
    }
}

fn failed(what: &str, error: std::io::Error) -> anyhow::Error {
    anyhow!("expected a Video4Linux2 camera that {what}: {error}")
}

/// Starts a camera in its present size.
fn start(device: Device) -> Result<(ReadStream, Layout)> {
    let now = device.format(BufType::VIDEO_CAPTURE).map_err(|e| failed("takes pictures", e))?;
    let Format::VideoCapture(now) = now else { bail!("expected a camera with one plane of samples") };
    let asked = PixFormat::new(now.width(), now.height(), PixelFormat::YUYV);
    let camera = device.video_capture(asked).map_err(|e| failed("delivers YUYV", e))?;
    let got = camera.format();
    let layout = Layout::of(Packing::Yuyv, got.width(), got.height(), got.bytes_per_line())?;
    let format = got.pixel_format();
    ensure!(format == PixelFormat::YUYV, "expected a camera that delivers YUYV, found {format}");
    Ok((camera.into_stream().map_err(|e| failed("starts", e))?, layout))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_is_refused() {
        let error = Camera::open(Path::new("/dev/null")).err().unwrap().to_string();
        assert!(error.contains("/dev/null: expected a Video4Linux2 camera"), "{error}");
    }
}
