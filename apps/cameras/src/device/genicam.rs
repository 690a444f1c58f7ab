//! A GenICam camera (GigE Vision, USB3 Vision) by aravis: its format and features, and a stream of buffers.
//!
//! As with [`super::v4l2`], what needs a camera is kept thin. Frames are counted by [`super::frames`], and the clock
//! of the camera is brought to ours by [`crate::stamps::own_clock`]. A buffer that lacks packets, in spite of
//! asking for them again, is damaged.

mod formats;
mod samples;
mod set;

use super::frames::Frames;
use super::{Absent, Buffer, Device, Open, Stamp, StampClock};
use anyhow::{Result, anyhow, ensure};
use aravis::glib;
use aravis::glib::object::Cast;
use aravis::prelude::*;
use aravis::{Aravis, BufferStatus, DeviceError, GvStream, Stream};
use fpga_model::input::packed::{Layout, Packing};
use settings::commands::cameras::Wanted;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Buffers that are asked for: some are filled while packets are asked for again, one is read, and two wait.
const BUFFERS: u32 = 8;
/// `ENODEV`.
const GONE: i32 = 19;
/// `V4L2_FIELD_NONE`: what these cameras bring is progressive.
const PROGRESSIVE: u32 = 1;

/// Searching and opening, one at a time: aravis keeps one list of cameras for all.
static ARAVIS: Mutex<Option<Aravis>> = Mutex::new(None);

/// How a camera is opened.
#[derive(Debug, Clone)]
pub struct Opener {
    /// Its name or address; aravis takes either.
    pub name: String,
    /// Width and height of its pictures, px.
    pub frame_px: [u32; 2],
    /// How the rig says that it gives its pixels.
    pub format: protocol::fields::PixelFormat,
    /// Pictures a second.
    pub hz: f64,
    /// A picture of half the height is a field.
    pub interlaced: bool,
    /// What it is to be set to.
    pub wanted: Wanted,
}

/// A camera that is there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// What it is called by.
    pub name: String,
    /// Its address.
    pub address: String,
    /// Maker, model and protocol.
    pub about: String,
}

/// A camera that streams.
struct Camera {
    camera: aravis::Camera,
    stream: Stream,
    layout: Layout,
    settings: String,
    note: Option<String>,
    frames: Frames,
    /// Samples of the picture that was read last.
    bytes: Vec<u8>,
    /// It has stopped answering.
    is_lost: Arc<AtomicBool>,
}

/// Calls `work` with exclusive access to aravis' list of cameras.
fn alone<T>(work: impl FnOnce(Option<&Aravis>) -> T) -> T {
    let mut held = ARAVIS.lock().unwrap_or_else(PoisonError::into_inner);
    if held.is_none() {
        *held = Aravis::initialize().ok();
    }
    work(held.as_ref())
}

/// The cameras on this machine's networks and buses.
pub fn found() -> Vec<Found> {
    let devices = alone(|aravis| aravis.map(Aravis::get_device_list)).unwrap_or_default();
    let text = |text: &std::ffi::CString| text.to_string_lossy().into_owned();
    let about = |d: &aravis::DeviceInfo| [&d.vendor, &d.model, &d.protocol].map(text).join(" ");
    devices.iter().map(|d| Found { name: text(&d.id), address: text(&d.address), about: about(d) }).collect()
}

/// What a camera can be asked for, a line each.
///
/// # Errors
/// A camera that does not answer, in words that follow its name.
pub fn modes(name: &str) -> Result<Vec<String>> {
    let camera = alone(|_| aravis::Camera::new(Some(name))).map_err(refused)?;
    let (_, widest) = camera.width_bounds().map_err(refused)?;
    let (_, highest) = camera.height_bounds().map_err(refused)?;
    let offered = formats::offered(&camera)?;
    let formats = offered.iter().map(|name| match formats::packing(name) {
        Some(_) => name.clone(),
        None => format!("{name} (not understood)"),
    });
    let formats = formats.collect::<Vec<_>>().join(", ");
    let mut lines = vec![format!("up to {widest}×{highest}: {formats}")];
    lines.extend(set::settable(&camera));
    Ok(lines)
}

impl Open for Opener {
    fn open(&mut self) -> Result<Box<dyn Device>> {
        let camera = alone(|_| aravis::Camera::new(Some(&self.name))).map_err(refused)?;
        let packing = formats::choose(&camera, self.format)?;
        let layout = self.set_size(&camera, packing)?;
        let settings = set::all(&camera, &self.wanted)?;
        let note = self.set_rate(&camera);
        let (stream, is_lost) = self.start(&camera)?;
        let (frames, bytes) = (Frames::default(), Vec::new());
        Ok(Box::new(Camera { camera, stream, layout, settings, note, frames, bytes, is_lost }))
    }
}

/// An error of the camera or of aravis: absence, or what it says.
fn refused(error: glib::Error) -> anyhow::Error {
    use DeviceError::{NotConnected, NotFound, Timeout, TransferError};
    let absent = [NotFound, NotConnected, Timeout, TransferError];
    match error.kind::<DeviceError>() {
        Some(kind) if absent.contains(&kind) => Absent.into(),
        Some(DeviceError::NotController) => anyhow!("is in use by another program"),
        _ => anyhow!("refuses: {}", error.message()),
    }
}

impl Opener {
    /// Asks for the rig's size, from the middle of the sensor where that is larger.
    fn set_size(&self, camera: &aravis::Camera, packing: Packing) -> Result<Layout> {
        let [width, height] = self.frame_px;
        let (_, widest) = camera.width_bounds().map_err(refused)?;
        let (_, highest) = camera.height_bounds().map_err(refused)?;
        // An interlaced rig may have cameras that bring single fields.
        let height = if self.interlaced { height / 2 } else { height };
        let [w, h] = [width, height].map(|px| i32::try_from(px).unwrap_or(i32::MAX));
        ensure!(
            w <= widest && h <= highest,
            "delivers at most {widest}×{highest} px; the rig expects pictures of {width}×{height} px"
        );
        let [x, y] = [(widest - w) / 2, (highest - h) / 2].map(|at| at & !15);
        let region = camera.set_region(x, y, w, h).or_else(|_| camera.set_region(0, 0, w, h));
        region.map_err(refused)?;
        let (_, _, found_w, found_h) = camera.region().map_err(refused)?;
        ensure!(
            (found_w, found_h) == (w, h),
            "delivers {found_w}×{found_h} px instead of the rig's {width}×{height} px"
        );
        Layout::of(packing, width, height, 0)
    }

    /// Asks for the rig's rate; a different answer is reported.
    fn set_rate(&self, camera: &aravis::Camera) -> Option<String> {
        if !camera.is_frame_rate_available().unwrap_or(false) {
            return None;
        }
        let asked = camera.set_frame_rate(self.hz).and_then(|()| camera.frame_rate());
        match asked {
            Ok(found) if (found / self.hz - 1.0).abs() < 0.01 => None,
            Ok(found) => Some(format!("takes {found:.2} pictures per second; the rig needs {:.2}", self.hz)),
            Err(problem) => Some(format!("rejects the rig's rate: {}", problem.message())),
        }
    }

    /// Starts the stream.
    fn start(&self, camera: &aravis::Camera) -> Result<(Stream, Arc<AtomicBool>)> {
        if camera.is_gv_device() {
            // The largest packets that the way takes; where it cannot be found out, they stay as they are.
            let _ = camera.gv_auto_packet_size();
        }
        let stream = camera.create_stream().map_err(refused)?;
        if let Some(stream) = stream.downcast_ref::<GvStream>() {
            // A picture that waits longer for its packets is late anyway.
            let period_us = (1e6 / self.hz) as u32;
            stream.set_frame_retention(2 * period_us.max(1_000));
        }
        let is_lost = Arc::<AtomicBool>::default();
        if let Some(device) = camera.device() {
            let lost = Arc::clone(&is_lost);
            device.connect_control_lost(move |_| lost.store(true, Ordering::Relaxed));
        }
        let payload = camera.payload().map_err(refused)? as usize;
        (0..BUFFERS).for_each(|_| stream.push_buffer(aravis::Buffer::new_allocate(payload)));
        camera.start_acquisition().map_err(refused)?;
        Ok((stream, is_lost))
    }
}

/// What is wrong with a buffer.
fn damage(status: BufferStatus) -> Option<&'static str> {
    Some(match status {
        BufferStatus::Success => return None,
        BufferStatus::MissingPackets | BufferStatus::Timeout => "lacks packets",
        BufferStatus::SizeMismatch => "is larger than announced",
        BufferStatus::WrongPacketId => "contains packets of another picture",
        _ => "is incomplete",
    })
}

impl Device for Camera {
    fn layout(&self) -> Layout {
        self.layout
    }

    fn notes(&self) -> (String, Option<String>) {
        (self.settings.clone(), self.note.clone())
    }

    fn next(&mut self, wait_ms: i64) -> io::Result<Option<Buffer<'_>>> {
        if self.is_lost.load(Ordering::Relaxed) {
            return Err(io::Error::from_raw_os_error(GONE));
        }
        let wait_us = u64::try_from(wait_ms).unwrap_or(0) * 1_000;
        let Some(buffer) = self.stream.timeout_pop_buffer(wait_us) else { return Ok(None) };
        let mut damage = damage(buffer.status());
        if damage.is_none() {
            let found = [buffer.image_width(), buffer.image_height()].map(|px| px as usize);
            samples::copy(&buffer, &mut self.bytes);
            if found != [self.layout.width, self.layout.height] {
                damage = Some("has a different size than requested");
            }
        }
        let stamp = Stamp { ns: buffer.timestamp(), clock: StampClock::Own, is_start: false };
        let sequence = self.frames.sequence(buffer.frame_id());
        self.stream.push_buffer(buffer);
        Ok(Some(Buffer { bytes: &self.bytes, stamp, sequence, field: PROGRESSIVE, damage }))
    }
}

impl Drop for Camera {
    /// Stops a camera that is still connected.
    fn drop(&mut self) {
        if !self.is_lost.load(Ordering::Relaxed) {
            // It stops by itself where it hears nothing more.
            let _ = self.camera.stop_acquisition();
        }
    }
}
