//! A camera of this machine by Video4Linux2: its format and controls, and a stream of buffers.
//!
//! What needs a camera is kept thin here: what is written into its controls ([`super::settings`]), what its
//! buffers mean ([`super::Role`], [`crate::stamps`]) and how it comes and goes is decided elsewhere, where it
//! is tested.

use super::ioctl::{RawBuffer, Streaming};
use super::settings::{Control, Meaning, Write, plan};
use super::{Absent, Buffer, Device, Open, Stamp, StampClock, is_gone};
use anyhow::{Result, anyhow, bail, ensure};
use fpga_model::input::packed::{Layout, Packing};
use linuxvideo::controls::{Cid, CtrlType};
use linuxvideo::format::{Format, PixFormat, PixelFormat};
use linuxvideo::{BufType, Device as Opened, Fract, VideoCaptureDevice};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use settings::commands::cameras::Wanted;
use std::io;
use std::path::PathBuf;

/// Buffers that are asked for: one is filled, one is read, and two wait.
const BUFFERS: u32 = 4;
/// `V4L2_BUF_FLAG_ERROR`, the masks and values of the stamp's clock and place.
const ERROR: u32 = 0x40;
const CLOCK_MASK: u32 = 0xe000;
const CLOCK_MONOTONIC: u32 = 0x2000;
const CLOCK_UNKNOWN: u32 = 0;
const PLACE_MASK: u32 = 0x7_0000;
const PLACE_START: u32 = 0x1_0000;

/// How a camera is opened.
#[derive(Debug, Clone)]
pub struct Opener {
    /// Its device.
    pub path: PathBuf,
    /// Width and height of its frames, px.
    pub frame_px: [u32; 2],
    /// How the rig says that it gives its pixels.
    pub format: protocol::fields::PixelFormat,
    /// Fields a second.
    pub hz: f64,
    /// A frame has two of them.
    pub interlaced: bool,
    /// What it is to be set to.
    pub wanted: Wanted,
}

/// A camera that streams.
struct Camera {
    streaming: Streaming<VideoCaptureDevice>,
    layout: Layout,
    settings: String,
    note: Option<String>,
    /// The buffer that was read last.
    taken: Option<RawBuffer>,
}

impl Open for Opener {
    fn open(&mut self) -> Result<Box<dyn Device>> {
        let mut device = Opened::open(&self.path).map_err(|e| refused("opens", e))?;
        let settings = set(&mut device, &self.wanted)?;
        let (device, layout) = self.start_format(device)?;
        let note = self.set_rate(&device);
        let streaming = Streaming::start(device, BUFFERS).map_err(|e| refused("streams", e))?;
        Ok(Box::new(Camera { streaming, layout, settings, note, taken: None }))
    }
}

/// An error of the driver: absence, or what it lacks in words.
fn refused(what: &str, error: io::Error) -> anyhow::Error {
    if is_gone(&error) { Absent.into() } else { anyhow!("is not a Video4Linux2 camera that {what}: {error}") }
}

impl Opener {
    /// Asks for the rig's size and the best of the packings that its format allows.
    fn start_format(&self, device: Opened) -> Result<(VideoCaptureDevice, Layout)> {
        let formats = device.formats(BufType::VIDEO_CAPTURE).filter_map(Result::ok);
        let letters: Vec<[u8; 4]> = formats.map(|f| f.pixel_format().as_fourcc()).collect();
        let wanted = Packing::wanted(self.format);
        let Some(&packing) = wanted.iter().find(|p| letters.contains(&p.fourcc())) else {
            let [asked, found] = [wanted.iter().map(|p| p.fourcc()).collect(), letters].map(in_words);
            bail!("delivers {found}; the rig's format is {}, which needs {asked}", self.format.name());
        };
        let [width, height] = self.frame_px;
        // One that delivers fields of half the height of a frame stays as it is.
        let height = match device.format(BufType::VIDEO_CAPTURE) {
            Ok(Format::VideoCapture(now)) if [now.width(), 2 * now.height()] == self.frame_px => height / 2,
            _ => height,
        };
        let asked = PixFormat::new(width, height, PixelFormat::from_fourcc(packing.fourcc()));
        let camera = device.video_capture(asked).map_err(|e| refused("delivers the rig's format", e))?;
        let got = camera.format();
        let letters = got.pixel_format().as_fourcc();
        ensure!(
            letters == packing.fourcc(),
            "delivers {} instead of the requested {}",
            in_words(vec![letters]),
            in_words(vec![packing.fourcc()])
        );
        let layout = Layout::of(packing, got.width(), got.height(), got.bytes_per_line())?;
        Ok((camera, layout))
    }

    /// Asks for the rig's rate. A camera without rates keeps its own, which its pictures show.
    fn set_rate(&self, camera: &VideoCaptureDevice) -> Option<String> {
        let frames = if camera.format().height() == self.frame_px[1] && self.interlaced { 2.0 } else { 1.0 };
        let hz = self.hz / frames;
        let got = camera.set_frame_interval(Fract::new(1_000, (hz * 1_000.0).round() as u32)).ok()?;
        let found = f64::from(got.denominator()) / f64::from(got.numerator().max(1));
        let same = (found / hz - 1.0).abs() < 0.01;
        (!same && got.numerator() > 0)
            .then(|| format!("takes {found:.2} pictures per second; the rig needs {hz:.2}"))
    }
}

fn in_words(letters: Vec<[u8; 4]>) -> String {
    let words: Vec<String> = letters.iter().map(|l| String::from_utf8_lossy(l).trim().to_owned()).collect();
    if words.is_empty() { "no pictures".into() } else { words.join(", ") }
}

/// The controls of a camera, and the kernel's numbers.
pub fn controls(device: &Opened) -> Vec<(Cid, Control)> {
    let meaning = |id| match id {
        Cid::AUTOGAIN => Some(Meaning::AutoGain),
        Cid::GAIN => Some(Meaning::Gain),
        Cid::EXPOSURE_AUTO => Some(Meaning::ExposureAuto),
        Cid::EXPOSURE_ABSOLUTE => Some(Meaning::Exposure),
        _ => None,
    };
    let described = device.controls().filter_map(Result::ok).map(|c| {
        let is_menu = c.control_type() == CtrlType::MENU;
        let entries = is_menu.then(|| device.enumerate_menu(&c)).into_iter().flatten().filter_map(Result::ok);
        let menu = entries.map(|entry| (entry.index() as i32, entry.name().to_owned())).collect();
        let (name, [minimum, maximum, step]) = (c.name().to_owned(), [c.minimum(), c.maximum(), c.step()]);
        (c.id(), Control { meaning: meaning(c.id()), name, minimum, maximum, step, menu })
    });
    described.collect()
}

/// Sets what is wanted, and says what it was set to.
fn set(device: &mut Opened, wanted: &Wanted) -> Result<String> {
    if *wanted == Wanted::default() {
        return Ok(String::new());
    }
    let (ids, all): (Vec<Cid>, Vec<Control>) = controls(device).into_iter().unzip();
    let writes: Vec<Write> = plan(wanted, &all).map_err(anyhow::Error::msg)?;
    for write in &writes {
        let id = ids[write.control];
        device.write_control_raw(id, write.value).map_err(|e| anyhow!("rejects {}: {e}", write.text))?;
        let found = device.read_control_raw(id).unwrap_or(write.value);
        ensure!(found == write.value, "did not keep {}: it reports {found}", write.text);
    }
    let texts: Vec<&str> = writes.iter().map(|w| w.text.as_str()).collect();
    Ok(texts.join(", "))
}

fn stamp_of(buffer: &RawBuffer) -> Stamp {
    let [seconds, micros] = [buffer.seconds, buffer.microseconds].map(|t| u64::try_from(t).unwrap_or(0));
    let clock = match buffer.flags & CLOCK_MASK {
        CLOCK_MONOTONIC => StampClock::Monotonic,
        CLOCK_UNKNOWN => StampClock::Unknown,
        _ => StampClock::Copied,
    };
    let ns = seconds.saturating_mul(1_000_000_000).saturating_add(micros.saturating_mul(1_000));
    Stamp { ns, clock, is_start: buffer.flags & PLACE_MASK == PLACE_START }
}

impl Device for Camera {
    fn layout(&self) -> Layout {
        self.layout
    }

    fn notes(&self) -> (String, Option<String>) {
        (self.settings.clone(), self.note.clone())
    }

    fn next(&mut self, wait_ms: i64) -> io::Result<Option<Buffer<'_>>> {
        if let Some(read) = self.taken.take() {
            self.streaming.hand_over(read.index)?;
        }
        let timeout = Timespec { tv_sec: 0, tv_nsec: wait_ms * 1_000_000 };
        let device = self.streaming.device();
        match poll(&mut [PollFd::new(&device, PollFlags::IN)], Some(&timeout)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(None),
            waited => waited?,
        };
        let buffer = self.streaming.take()?;
        self.taken = Some(buffer);
        Ok(Some(Buffer {
            bytes: self.streaming.samples(&buffer),
            stamp: stamp_of(&buffer),
            sequence: buffer.sequence,
            field: buffer.field,
            damage: (buffer.flags & ERROR != 0).then_some("its driver marks as damaged"),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_is_refused_and_what_is_absent_is_waited_for() {
        let open = |path: &str| {
            let format = protocol::fields::PixelFormat::Yuyv;
            let frame_px = [720, 576];
            let (path, wanted) = (path.into(), Wanted::default());
            let mut opener = Opener { path, frame_px, format, hz: 50.0, interlaced: true, wanted };
            opener.open().err().expect("refused")
        };
        assert!(open("/dev/null").to_string().contains("is not a Video4Linux2 camera that opens"));
        assert!(open("/dev/no-video").is::<Absent>());
    }

    #[test]
    fn stamps_are_read_with_their_clock() {
        let of = |flags, seconds| {
            let buffer = RawBuffer { flags, seconds, microseconds: 250_000, ..RawBuffer::default() };
            let Stamp { ns, clock, is_start } = stamp_of(&buffer);
            (ns, clock, is_start)
        };
        assert_eq!(of(0x2000, 7), (7_250_000_000, StampClock::Monotonic, false));
        assert_eq!(of(0x1_2001, 7), (7_250_000_000, StampClock::Monotonic, true));
        assert_eq!(of(0, 1_700_000_000).1, StampClock::Unknown);
        assert_eq!(of(0x4000, -3), (250_000_000, StampClock::Copied, false));
    }
}
