//! The calls of Video4Linux2 that stream buffers with their timestamps, which the library in use does not
//! provide: request buffers, map, queue and dequeue them. This is all the unsafe code of the
//! crate. It needs a camera; on a machine without one, only sizes and numbers of the calls are checked.

#![allow(unsafe_code)] // calls of the driver and memory that it fills; each use has its SAFETY note

use rustix::ioctl::{Opcode, Setter, Updater, ioctl, opcode};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::c_void;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`.
const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`.
const MAPPED: u32 = 1;

const REQBUFS: Opcode = opcode::read_write::<RequestBuffers>(b'V', 8);
const QUERYBUF: Opcode = opcode::read_write::<RawBuffer>(b'V', 9);
const QBUF: Opcode = opcode::read_write::<RawBuffer>(b'V', 15);
const DQBUF: Opcode = opcode::read_write::<RawBuffer>(b'V', 17);
const STREAMON: Opcode = opcode::write::<i32>(b'V', 18);

/// `struct v4l2_requestbuffers`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
struct RequestBuffers {
    count: u32,
    kind: u32,
    memory: u32,
    capabilities: u32,
    flags: u8,
    reserved: [u8; 3],
}

/// `struct v4l2_buffer` of 64 bits.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RawBuffer {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) bytes_used: u32,
    pub(super) flags: u32,
    pub(super) field: u32,
    pub(super) seconds: i64,
    pub(super) microseconds: i64,
    pub(super) timecode: [u32; 4],
    pub(super) sequence: u32,
    pub(super) memory: u32,
    pub(super) offset: u64,
    pub(super) length: u32,
    pub(super) reserved: [u32; 2],
}

impl RawBuffer {
    fn of(index: u32) -> Self {
        RawBuffer { index, kind: CAPTURE, memory: MAPPED, ..RawBuffer::default() }
    }
}

/// Memory that a driver fills.
struct Mapping {
    at: *mut c_void,
    length: usize,
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping was made with this length, and no slice of it is alive: slices borrow its owner.
        // The error of a driver that is gone is of no use.
        let _ = unsafe { munmap(self.at, self.length) };
    }
}

/// A running stream; it stops when the device is closed.
pub(super) struct Streaming<D> {
    device: D,
    buffers: Vec<Mapping>,
}

fn update(device: BorrowedFd<'_>, call: Call, buffer: &mut RawBuffer) -> io::Result<()> {
    // SAFETY: each of these calls reads and writes one `struct v4l2_buffer`, whose layout `RawBuffer` has.
    unsafe {
        match call {
            Call::Query => ioctl(device, Updater::<QUERYBUF, _>::new(buffer)),
            Call::Hand => ioctl(device, Updater::<QBUF, _>::new(buffer)),
            Call::Take => ioctl(device, Updater::<DQBUF, _>::new(buffer)),
        }
    }?;
    Ok(())
}

#[derive(Clone, Copy)]
enum Call {
    Query,
    Hand,
    Take,
}

impl<D: AsFd> Streaming<D> {
    /// Asks the driver for `count` buffers, hands them all over and starts.
    pub(super) fn start(device: D, count: u32) -> io::Result<Self> {
        let mut asked = RequestBuffers { count, kind: CAPTURE, memory: MAPPED, ..RequestBuffers::default() };
        // SAFETY: the call reads and writes one `struct v4l2_requestbuffers`, whose layout the type has.
        unsafe { ioctl(&device, Updater::<REQBUFS, _>::new(&mut asked)) }?;
        let mut streaming = Streaming { device, buffers: Vec::new() };
        for index in 0..asked.count {
            let mut buffer = RawBuffer::of(index);
            update(streaming.device.as_fd(), Call::Query, &mut buffer)?;
            let mapping = streaming.map(&buffer)?;
            streaming.buffers.push(mapping);
            streaming.hand_over(index)?;
        }
        // SAFETY: the call reads one int.
        unsafe { ioctl(&streaming.device, Setter::<STREAMON, i32>::new(CAPTURE as i32)) }?;
        Ok(streaming)
    }

    fn map(&self, buffer: &RawBuffer) -> io::Result<Mapping> {
        let (length, none) = (buffer.length as usize, std::ptr::null_mut());
        // SAFETY: a new mapping, placed by the kernel; the driver says where its buffer lies and how long it is.
        let at = unsafe {
            mmap(none, length, ProtFlags::READ, MapFlags::SHARED, &self.device, buffer.offset & 0xffff_ffff)
        }?;
        Ok(Mapping { at, length })
    }

    /// Lets the driver fill a buffer again.
    pub(super) fn hand_over(&mut self, index: u32) -> io::Result<()> {
        update(self.device.as_fd(), Call::Hand, &mut RawBuffer::of(index))
    }

    /// Waits for a filled buffer and dequeues it; the driver does not fill it until it is queued again.
    pub(super) fn take(&mut self) -> io::Result<RawBuffer> {
        let mut buffer = RawBuffer::of(0);
        update(self.device.as_fd(), Call::Take, &mut buffer)?;
        Ok(buffer)
    }

    /// The samples of a buffer that was taken.
    pub(super) fn samples(&self, buffer: &RawBuffer) -> &[u8] {
        let Some(mapping) = self.buffers.get(buffer.index as usize) else { return &[] };
        let used = if buffer.bytes_used == 0 { mapping.length } else { buffer.bytes_used as usize };
        // SAFETY: the mapping lives as long as `self`; a dequeued buffer is not written by the driver, and
        // queueing it borrows `self` mutably.
        let all = unsafe { std::slice::from_raw_parts(mapping.at.cast::<u8>(), mapping.length) };
        &all[..used.min(mapping.length)]
    }

    /// The device.
    pub(super) fn device(&self) -> BorrowedFd<'_> {
        self.device.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{offset_of, size_of};

    #[test]
    fn blocks_and_calls_are_those_of_the_kernels_header() {
        assert_eq!((size_of::<RawBuffer>(), size_of::<RequestBuffers>()), (88, 20));
        let places = [
            offset_of!(RawBuffer, seconds),
            offset_of!(RawBuffer, timecode),
            offset_of!(RawBuffer, sequence),
            offset_of!(RawBuffer, offset),
            offset_of!(RawBuffer, length),
        ];
        assert_eq!(places, [24, 40, 56, 64, 72]);
        let calls = [REQBUFS, QUERYBUF, QBUF, DQBUF, STREAMON];
        assert_eq!(calls, [0xc014_5608, 0xc058_5609, 0xc058_560f, 0xc058_5611, 0x4004_5612]);
    }

    #[test]
    fn what_is_no_camera_answers_with_an_error() {
        let null = std::fs::File::open("/dev/null").unwrap();
        let error = Streaming::start(null, 4).err().expect("no camera");
        assert_eq!(error.raw_os_error(), Some(25), "ENOTTY: {error}");
    }
}
