//! The samples of a buffer of aravis, which the safe functions of its crate do not give.

#![allow(unsafe_code)] // memory that aravis holds; the one use has its SAFETY note

use aravis::Buffer;

/// Copies the samples of a buffer that was taken out of its stream, so that no other thread writes to it.
pub(super) fn copy(buffer: &Buffer, into: &mut Vec<u8>) {
    into.clear();
    let (data, bytes) = buffer.data();
    if data.is_null() || bytes == 0 {
        return;
    }
    // SAFETY: `bytes` bytes at `data` are what the buffer has received, in memory that aravis allocated with it
    // (`Buffer::new_allocate`). They live as long as the buffer, which is borrowed here, and its stream writes
    // into them only once it is handed back.
    into.extend_from_slice(unsafe { std::slice::from_raw_parts(data, bytes) });
}
