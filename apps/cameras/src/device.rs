//! A camera as far as its reader must know it: buffers with their stamps. [`v4l2`] is one of this machine, `genicam`
//! (a feature of the build) one by GigE Vision or USB3 Vision; tests play recorded buffers.

pub mod frames;
#[cfg(feature = "genicam")]
pub mod genicam;
mod ioctl;
pub mod settings;
pub mod v4l2;

use anyhow::{Result, bail, ensure};
use fpga_model::input::packed::Layout;
use protocol::time::Nanos;
use rig::sensor::Scan;
use std::io;

/// How the lines of a buffer lie in the frame (`enum v4l2_field`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// A picture of its own.
    None,
    /// The even lines alone.
    Top,
    /// The odd lines alone.
    Bottom,
    /// Even and odd lines in turn, the even ones first in time.
    InterlacedTop,
    /// Even and odd lines in turn, the odd ones first in time.
    InterlacedBottom,
    /// All even lines, then all odd lines.
    SequenceTop,
    /// All odd lines, then all even lines.
    SequenceBottom,
}

impl Order {
    /// From the kernel's number, of a frame of `lines`; `None` of a number that no buffer has.
    pub fn of_v4l2(field: u32, lines: u32) -> Option<Self> {
        Some(match field {
            0 | 1 => Order::None,
            2 => Order::Top,
            3 => Order::Bottom,
            // The order in time follows the standard: 60 Hz has 480 lines and the odd ones first.
            4 if lines == 480 => Order::InterlacedBottom,
            4 | 8 => Order::InterlacedTop,
            5 => Order::SequenceTop,
            6 => Order::SequenceBottom,
            9 => Order::InterlacedBottom,
            _ => return None,
        })
    }

    /// In words, for messages.
    fn name(self) -> &'static str {
        match self {
            Order::None => "progressive pictures",
            Order::Top | Order::Bottom => "single fields",
            _ => "interlaced frames",
        }
    }
}

/// The clock of a stamp, as the driver says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampClock {
    /// CLOCK_MONOTONIC.
    Monotonic,
    /// It does not say.
    Unknown,
    /// The camera's own: it began at some time, and runs a little faster or slower.
    Own,
    /// That of the program that feeds the device; it means nothing here.
    Copied,
}

/// When a buffer was taken, as the driver says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// The instant, ns.
    pub ns: Nanos,
    /// Its clock.
    pub clock: StampClock,
    /// It is the beginning of the exposure, not the end of the picture.
    pub is_start: bool,
}

/// A filled buffer.
#[derive(Debug, Clone, Copy)]
pub struct Buffer<'a> {
    /// Its samples.
    pub bytes: &'a [u8],
    /// When it was taken.
    pub stamp: Stamp,
    /// The driver's count of frames, lost ones included.
    pub sequence: u32,
    /// The kernel's number of its field order.
    pub field: u32,
    /// What the driver says is wrong with its samples, where something is; in words that follow "a picture that".
    pub damage: Option<&'static str>,
}

/// A camera that delivers.
pub trait Device {
    /// How a buffer's samples are laid out.
    fn layout(&self) -> Layout;

    /// Its settings and its problems, in words; empty where there is nothing to report.
    fn notes(&self) -> (String, Option<String>);

    /// Waits up to `wait_ms` for the next buffer.
    ///
    /// # Errors
    /// The driver's; a camera that is gone answers `ENODEV` or `EIO`.
    fn next(&mut self, wait_ms: i64) -> io::Result<Option<Buffer<'_>>>;
}

/// Opens a camera, again and again where it comes and goes.
pub trait Open: Send {
    /// Opens it and starts it.
    ///
    /// # Errors
    /// [`Absent`] while it is not there; otherwise why it cannot be used, in words that follow its name.
    fn open(&mut self) -> Result<Box<dyn Device>>;
}

/// A camera that is not there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Absent;

impl std::fmt::Display for Absent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("is unplugged; waiting for it")
    }
}

impl std::error::Error for Absent {}

/// True of an error that a camera has that was pulled out.
pub fn is_gone(error: &io::Error) -> bool {
    // ENXIO, EIO, ENODEV, and a name that is not there.
    matches!(error.raw_os_error(), Some(5 | 6 | 19)) || error.kind() == io::ErrorKind::NotFound
}

/// A field in a picture: its parity, where the camera says it, and its first line and step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// 0: even lines, 1: odd lines; `None` where the number decides.
    pub parity: Option<u32>,
    /// First line in the picture, and from one line to the next.
    pub lines: [usize; 2],
}

/// The one or two fields of a picture, in the order of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parts {
    all: [Part; 2],
    count: usize,
}

impl Parts {
    /// A picture that is one field.
    pub fn one(parity: Option<u32>) -> Self {
        Parts { all: [Part { parity, lines: [0, 1] }; 2], count: 1 }
    }

    /// A frame of two fields: the parity of the earlier, and the first line and step of even and odd lines.
    pub fn two(first: u32, lines: [[usize; 2]; 2]) -> Self {
        let part = |parity: u32| Part { parity: Some(parity), lines: lines[parity as usize] };
        Parts { all: [part(first), part(1 - first)], count: 2 }
    }

    /// Every second line of a frame, those of `first` earlier.
    pub fn woven(first: u32) -> Self {
        Parts::two(first, [[0, 2], [1, 2]])
    }

    /// The fields.
    pub fn all(&self) -> &[Part] {
        &self.all[..self.count]
    }
}

/// The camera of a rig that a device stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Role {
    /// Width and height of its frames, px.
    pub frame_px: [u32; 2],
    /// Whether its fields are whole frames.
    pub scan: Scan,
}

impl Role {
    /// The fields of a buffer of so many lines.
    ///
    /// # Errors
    /// Pictures that are not the camera's, in words that follow its name.
    pub fn parts(&self, layout: &Layout, field: u32) -> Result<Parts> {
        let [width, lines] = self.frame_px.map(|n| n as usize);
        let found = [layout.width, layout.height];
        let Some(order) = Order::of_v4l2(field, self.frame_px[1]) else {
            bail!("delivers buffers of the unknown field order {field}");
        };
        let is_field = matches!(order, Order::Top | Order::Bottom)
            || (order == Order::None && self.scan == Scan::Interlaced && layout.height == lines / 2);
        let height = if is_field { lines / 2 } else { lines };
        ensure!(
            found == [width, height],
            "delivers {} of {}×{} px; the rig expects frames of {width}×{lines} px",
            order.name(),
            found[0],
            found[1]
        );
        let fits = match self.scan {
            Scan::Progressive => order == Order::None,
            Scan::Interlaced => order != Order::None || is_field,
        };
        ensure!(fits, "delivers {}; the scan of the rig's camera is {}", order.name(), self.scan.name());
        let half = lines / 2;
        Ok(match order {
            Order::None => Parts::one(None),
            Order::Top => Parts::one(Some(0)),
            Order::Bottom => Parts::one(Some(1)),
            Order::InterlacedTop => Parts::woven(0),
            Order::InterlacedBottom => Parts::woven(1),
            Order::SequenceTop => Parts::two(0, [[0, 1], [half, 1]]),
            Order::SequenceBottom => Parts::two(1, [[half, 1], [0, 1]]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fpga_model::input::packed::Packing;

    fn layout(width: u32, height: u32) -> Layout {
        Layout::of(Packing::Yuyv, width, height, 2 * width).unwrap()
    }

    #[test]
    fn fields_lie_in_a_buffer_as_the_kernel_says() {
        let pal = Role { frame_px: [720, 576], scan: Scan::Interlaced };
        let lines = |field, height| {
            let parts = pal.parts(&layout(720, height), field).unwrap();
            parts.all().iter().map(|p| (p.parity, p.lines)).collect::<Vec<_>>()
        };
        assert_eq!(lines(4, 576), [(Some(0), [0, 2]), (Some(1), [1, 2])]);
        assert_eq!(lines(9, 576), [(Some(1), [1, 2]), (Some(0), [0, 2])]);
        assert_eq!(lines(5, 576), [(Some(0), [0, 1]), (Some(1), [288, 1])]);
        assert_eq!(lines(6, 576), [(Some(1), [0, 1]), (Some(0), [288, 1])]);
        assert_eq!(lines(2, 288), [(Some(0), [0, 1])]);
        assert_eq!(lines(3, 288), [(Some(1), [0, 1])]);
        assert_eq!(lines(1, 288), [(None, [0, 1])]);
        let ntsc = Role { frame_px: [720, 480], scan: Scan::Interlaced };
        assert_eq!(ntsc.parts(&layout(720, 480), 4).unwrap(), Parts::woven(1));
        let whole = Role { frame_px: [640, 480], scan: Scan::Progressive };
        assert_eq!(whole.parts(&layout(640, 480), 1).unwrap(), Parts::one(None));
    }

    #[test]
    fn pictures_of_another_camera_are_refused_by_name() {
        let pal = Role { frame_px: [720, 576], scan: Scan::Interlaced };
        let whole = Role { frame_px: [720, 576], scan: Scan::Progressive };
        for (role, field, size, named) in [
            (pal, 4, [640, 480], "interlaced frames of 640×480 px; the rig expects frames of 720×576 px"),
            (pal, 4, [720, 288], "720×288"),
            (pal, 1, [720, 576], "progressive pictures; the scan of the rig's camera is interlaced"),
            (whole, 4, [720, 576], "interlaced frames; the scan of the rig's camera is progressive"),
            (whole, 2, [720, 288], "single fields"),
            (pal, 77, [720, 576], "unknown field order 77"),
        ] {
            let told = role.parts(&layout(size[0], size[1]), field).unwrap_err().to_string();
            assert!(told.contains(named), "{told}");
        }
    }
}
