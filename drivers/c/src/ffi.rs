//! What C sees. The one module of this crate with `unsafe`: pointers are looked at here, and nowhere else.
//!
//! A driver is a number, not a pointer: one that was closed, or that another thread opened, is not found and is an
//! error. Pointers to blocks come with the size that the caller's compiler gave them. A panic ends in a code.

#![allow(unsafe_code)] // pointers of C; each use has its SAFETY note

use crate::code::{self, Code, Failure, failure};
use crate::driver::Driver;
use crate::layout::LAYOUT;
use bytemuck::Pod;
use protocol::blobs::BlobField;
use protocol::events::Event;
use protocol::fields::FieldHeader;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Health;
use protocol::poses::TrackerFrame;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};

/// Nanoseconds of a millisecond.
const NS_PER_MS: u64 = 1_000_000;

thread_local! {
    /// The drivers of this thread, by number.
    static DRIVERS: RefCell<BTreeMap<u64, Driver>> = const { RefCell::new(BTreeMap::new()) };
}
/// The number of the next driver.
static NEXT: AtomicU64 = AtomicU64::new(1);

/// Does `work`; keeps the words of its failure, and returns its code.
fn guarded(work: impl FnOnce() -> Result<Code, Failure>) -> i32 {
    let done = catch_unwind(AssertUnwindSafe(work));
    let done = done.unwrap_or_else(|_| Err(failure(Code::Defect, "the library has a defect: it panicked")));
    match done {
        Ok(code) => code as i32,
        Err(failure) => {
            code::keep(&failure.text);
            failure.code as i32
        }
    }
}

/// Does `work` with a driver of this thread.
fn with(driver: u64, work: impl FnOnce(&mut Driver) -> Result<Code, Failure>) -> i32 {
    guarded(|| {
        DRIVERS.with(|drivers| {
            let gone = || failure(Code::Closed, format!("driver {driver} is closed, or of another thread"));
            work(drivers.borrow_mut().get_mut(&driver).ok_or_else(gone)?)
        })
    })
}

fn null(what: &str) -> Failure {
    failure(Code::Null, format!("{what} is NULL"))
}

/// A text of C.
///
/// # Safety
/// `text` is NULL or points to a text that ends with a zero and does not change during the call.
unsafe fn text_at<'a>(text: *const c_char, what: &str) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(null(what));
    }
    // SAFETY: not NULL, and by the contract of this function a text with its end.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map_err(|_| failure(Code::Argument, format!("{what} is not UTF-8")))
}

fn check_size<T>(size: usize) -> Result<(), Failure> {
    let (name, expected) =
        (std::any::type_name::<T>().rsplit("::").next().unwrap_or("block"), size_of::<T>());
    let text = || {
        format!(
            "{name}: expected {expected} bytes, found {size}: recompile this program with the library's \
             vitreo.h"
        )
    };
    if size == expected { Ok(()) } else { Err(failure(Code::Size, text())) }
}

/// A copy of a block of C.
///
/// # Safety
/// `block` is NULL or points to `size` readable bytes.
unsafe fn block_at<T: Pod>(block: *const T, size: usize) -> Result<T, Failure> {
    if block.is_null() {
        return Err(null("the block"));
    }
    check_size::<T>(size)?;
    // SAFETY: not NULL, and as many readable bytes as the block has; a `Pod` may hold any of them. It need not be
    // aligned.
    Ok(unsafe { block.read_unaligned() })
}

/// Copies a block to C, if there is one.
///
/// # Safety
/// `to` is NULL or points to `size` writable bytes.
unsafe fn give<T: Pod>(
    to: *mut T,
    size: usize,
    next: impl FnOnce() -> Result<Option<T>, Failure>,
) -> Result<Code, Failure> {
    if to.is_null() {
        return Err(null("the place for the block"));
    }
    check_size::<T>(size)?;
    let Some(block) = next()? else { return Ok(Code::Nothing) };
    // SAFETY: not NULL, and as many writable bytes as the block has. It need not be aligned.
    unsafe { to.write_unaligned(block) };
    Ok(Code::Ok)
}

/// Milliseconds of C; below 0 is for ever.
fn wait_ns(ms: i32) -> u64 {
    u64::try_from(ms).map_or(u64::MAX, |ms| ms * NS_PER_MS)
}

/// Joins the run `instance` (vitreo run --instance; "main" by default) as the driver `name`, which sends and reads what
/// `roles` say (a sum of VITREO_SENDS_… and VITREO_READS_…). Where no such run is at work, waits for it for at most
/// `wait_ms` (below 0: for ever). A channel has one driver: VITREO_TAKEN where another one sends it. `layout` is
/// VITREO_LAYOUT. The number of the driver is written to `driver`; only this thread can use it.
///
/// # Safety
/// `instance` and `name` are NULL or texts that end with a zero; `driver` is NULL or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_open(
    instance: *const c_char,
    name: *const c_char,
    roles: u32,
    layout: u64,
    wait_ms: i32,
    driver: *mut u64,
) -> i32 {
    guarded(|| {
        if driver.is_null() {
            return Err(null("the place for the driver"));
        }
        if layout != LAYOUT {
            let text = "this program was compiled with a vitreo.h of another version: recompile it with \
                that of this library";
            return Err(failure(Code::Header, format!("{text} (there {layout:016x}, here {LAYOUT:016x})")));
        }
        // SAFETY: by the contract of this function.
        let (instance, name) = unsafe { (text_at(instance, "the instance")?, text_at(name, "the name")?) };
        let opened = Driver::open(instance, name, roles, wait_ns(wait_ms))?;
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        DRIVERS.with(|drivers| drivers.borrow_mut().insert(number, opened));
        // SAFETY: not NULL, and by the contract of this function writable. It need not be aligned.
        unsafe { driver.write_unaligned(number) };
        Ok(Code::Ok)
    })
}

/// Leaves the run. The handle and lent memory are invalid from then on.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_close(driver: u64) -> i32 {
    guarded(|| {
        let closed = DRIVERS.with(|drivers| drivers.borrow_mut().remove(&driver));
        let gone = || failure(Code::Closed, format!("driver {driver} is closed, or of another thread"));
        closed.map(|_| Code::Ok).ok_or_else(gone)
    })
}

/// VITREO_OK while the run goes on; VITREO_STOP once it has ended or asks this program to end.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_check(driver: u64) -> i32 {
    with(driver, |driver| driver.check().map(|()| Code::Ok))
}

/// Sends the blobs of a camera-field; `blobs_out_ns` 0 becomes the present instant.
///
/// # Safety
/// `field` is NULL or points to `size` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_send_blobs(driver: u64, field: *const BlobField, size: usize) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| driver.send_blobs(&unsafe { block_at(field, size)? }).map(|()| Code::Ok))
}

/// Sends the state of a handle; the library counts `seq`, and `instant_ns` 0 becomes the present instant.
///
/// # Safety
/// `handle` is NULL or points to `size` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_send_handle(driver: u64, handle: *const HandleState, size: usize) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| driver.send_handle(&unsafe { block_at(handle, size)? }).map(|()| Code::Ok))
}

/// Sends the state of the foot pedal; the library counts `seq`, and `instant_ns` 0 becomes the present instant.
///
/// # Safety
/// `pedal` is NULL or points to `size` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_send_pedal(driver: u64, pedal: *const PedalState, size: usize) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| driver.send_pedal(&unsafe { block_at(pedal, size)? }).map(|()| Code::Ok))
}

/// Sends poses; the library counts `frame`, and `instants.tracked` 0 becomes the present instant.
///
/// # Safety
/// `frame` is NULL or points to `size` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_send_poses(driver: u64, frame: *const TrackerFrame, size: usize) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| driver.send_poses(&unsafe { block_at(frame, size)? }).map(|()| Code::Ok))
}

/// Lends shared memory for the pixels of a field: `*bytes` of them from `*memory` on, to be written until
/// vitreo_send_field or vitreo_close. No field may have more than the first one's width × height asks for.
///
/// # Safety
/// `header` is NULL or points to `size` readable bytes; `memory` and `bytes` are NULL or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_lend_field(
    driver: u64,
    header: *const FieldHeader,
    size: usize,
    memory: *mut *mut u8,
    bytes: *mut usize,
) -> i32 {
    with(driver, |driver| {
        if memory.is_null() || bytes.is_null() {
            return Err(null("the place for the memory or its size"));
        }
        // SAFETY: by the contract of this function.
        let lent = driver.lend_field(&unsafe { block_at(header, size)? })?;
        // SAFETY: neither is NULL, and by the contract of this function both can be written.
        unsafe {
            memory.write_unaligned(lent.as_mut_ptr());
            bytes.write_unaligned(lent.len());
        }
        Ok(Code::Ok)
    })
}

/// Sends the field that was lent.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_send_field(driver: u64) -> i32 {
    with(driver, |driver| driver.send_field().map(|()| Code::Ok))
}

/// Reads the next poses; VITREO_NOTHING where none came within `wait_ms` (0: looks only; below 0: for ever).
///
/// # Safety
/// `frame` is NULL or points to `size` writable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_next_poses(
    driver: u64,
    frame: *mut TrackerFrame,
    size: usize,
    wait_ms: i32,
) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| unsafe { give(frame, size, || driver.next_poses(wait_ns(wait_ms))) })
}

/// Reads the next event, as vitreo_next_poses does poses.
///
/// # Safety
/// `event` is NULL or points to `size` writable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_next_event(driver: u64, event: *mut Event, size: usize, wait_ms: i32) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| unsafe { give(event, size, || driver.next_event(wait_ns(wait_ms))) })
}

/// Reads the next heartbeat of any process of the run, as vitreo_next_poses does poses.
///
/// # Safety
/// `health` is NULL or points to `size` writable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_next_health(
    driver: u64,
    health: *mut Health,
    size: usize,
    wait_ms: i32,
) -> i32 {
    // SAFETY: by the contract of this function.
    with(driver, |driver| unsafe { give(health, size, || driver.next_health(wait_ns(wait_ms))) })
}

/// Says that the driver works, or with `degraded` not 0 that it does so with a limitation, which `text` names for
/// people: it stands in status and report.
///
/// # Safety
/// `text` is NULL or a text that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vitreo_tell(driver: u64, degraded: i32, text: *const c_char) -> i32 {
    with(driver, |driver| {
        // SAFETY: by the contract of this function.
        driver.tell(degraded != 0, unsafe { text_at(text, "the text")? });
        Ok(Code::Ok)
    })
}

/// Says that nothing more will come: a run that takes its blobs, fields or poses from this driver ends in order.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_finish(driver: u64) -> i32 {
    with(driver, |driver| {
        driver.finish();
        Ok(Code::Ok)
    })
}

/// The present instant of CLOCK_MONOTONIC, ns: the clock of every instant in every block.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_now() -> u64 {
    ipc::clock::now()
}

/// Why the newest call of this thread that failed did so, in words; empty before the first. The text stays where it is
/// until the next failure of this thread.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_error_text() -> *const c_char {
    code::words(|text| text.as_ptr())
}

/// The layout of this library's blocks, to be compared with VITREO_LAYOUT.
#[unsafe(no_mangle)]
pub extern "C" fn vitreo_layout() -> u64 {
    LAYOUT
}

#[cfg(test)]
mod tests;
