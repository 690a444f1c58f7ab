//! Protobuf encoding of blocks, driven by their [`Layout`].
//!
//! Format: <https://protobuf.dev/programming-guides/encoding/>. A `u32` or `u64` is a varint and
//! left out where it is 0; a hash is a `fixed64`; an `f64` has explicit presence, because an
//! encoder that leaves out 0 loses the sign of −0; an `f32` is left out where all its bits are 0; an array
//! of `f64` is packed.

use super::MessageError;
use protocol::wire::{Field, Kind, Layout, MAX_FIELDS, Role};

const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const DELIMITED: u64 = 2;
const FIXED32: u64 = 5;

// Numbers are copied between block and message as they lie in memory.
const _: () = assert!(cfg!(target_endian = "little"));

fn refuse(problem: impl Into<String>) -> MessageError {
    MessageError::Encoding(problem.into())
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Appends a varint field, 0 or not.
pub(super) fn put_present(out: &mut Vec<u8>, tag: u32, value: u64) {
    put_varint(out, u64::from(tag) << 3 | VARINT);
    put_varint(out, value);
}

/// Appends a varint field unless it is 0.
pub(super) fn put_uint(out: &mut Vec<u8>, tag: u32, value: u64) {
    if value != 0 {
        put_present(out, tag, value);
    }
}

fn put_fixed64(out: &mut Vec<u8>, tag: u32, bytes: &[u8]) {
    put_varint(out, u64::from(tag) << 3 | FIXED64);
    out.extend_from_slice(bytes);
}

fn put_fixed32(out: &mut Vec<u8>, tag: u32, bytes: &[u8]) {
    put_varint(out, u64::from(tag) << 3 | FIXED32);
    out.extend_from_slice(bytes);
}

/// Appends a field of bytes or text unless it is empty.
pub(super) fn put_bytes(out: &mut Vec<u8>, tag: u32, bytes: &[u8]) {
    if !bytes.is_empty() {
        put_message(out, tag, |out| out.extend_from_slice(bytes));
    }
}

/// Appends a field whose contents `write` appends.
pub(super) fn put_message(out: &mut Vec<u8>, tag: u32, write: impl FnOnce(&mut Vec<u8>)) {
    put_varint(out, u64::from(tag) << 3 | DELIMITED);
    let start = out.len();
    write(out);
    let (mut length, end) = (Vec::with_capacity(4), out.len());
    put_varint(&mut length, (end - start) as u64);
    out.splice(start..start, length);
}

fn uint(bytes: &[u8]) -> u64 {
    let mut wide = [0; 8];
    wide[..bytes.len()].copy_from_slice(bytes);
    u64::from_le_bytes(wide)
}

/// Appends the message of a block of this layout, with its payload if it has one.
pub(super) fn encode(layout: &Layout, block: &[u8], payload: &[u8], out: &mut Vec<u8>) {
    for field in layout.recorded() {
        let (tag, value) = (field.tag, field.bytes(block));
        match (field.kind, field.role) {
            (_, Role::Payload(_)) => put_bytes(out, tag, payload),
            (_, Role::Hash) if uint(value) == 0 => {}
            (_, Role::Hash) | (Kind::F64, _) => put_fixed64(out, tag, value),
            (Kind::U32 | Kind::U64, _) => put_uint(out, tag, uint(value)),
            (Kind::F32, _) if uint(value) == 0 => {}
            (Kind::F32, _) => put_fixed32(out, tag, value),
            (Kind::Struct(inner), _) => put_message(out, tag, |out| encode(inner, value, &[], out)),
            (Kind::Array(Kind::Struct(inner), room), role) => {
                let used = match role {
                    Role::Counted(at) => uint(&block[at..at + 4]) as usize,
                    _ => room,
                };
                for element in value.chunks_exact(inner.size).take(used) {
                    put_message(out, tag, |out| encode(inner, element, &[], out));
                }
            }
            (Kind::Array(Kind::F64, _), _) => put_bytes(out, tag, value),
            _ => unreachable!("Layout::prove refuses such a field"),
        }
    }
}

/// A field's value in a message.
#[derive(Debug, Clone, Copy)]
pub(super) enum Value<'a> {
    Varint(u64),
    Fixed64([u8; 8]),
    Delimited(&'a [u8]),
    Fixed32([u8; 4]),
}

/// Iterator over the fields of a message: number and value.
pub(super) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    fn varint(&mut self) -> Result<u64, MessageError> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let [byte] = self.take(1)?[..] else { unreachable!("one byte was asked for") };
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return if shift == 63 && byte > 1 {
                    Err(refuse("a varint over 64 bits"))
                } else {
                    Ok(value)
                };
            }
        }
        Err(refuse("a varint over 10 bytes"))
    }

    fn take(&mut self, bytes: usize) -> Result<&'a [u8], MessageError> {
        let (taken, rest) = self.0.split_at_checked(bytes).ok_or_else(|| refuse("ends within a field"))?;
        self.0 = rest;
        Ok(taken)
    }

    fn field(&mut self) -> Result<(u32, Value<'a>), MessageError> {
        let key = self.varint()?;
        let tag = u32::try_from(key >> 3).ok().filter(|tag| *tag > 0);
        let tag = tag.ok_or_else(|| refuse(format!("no field has the number {}", key >> 3)))?;
        let value = match key & 7 {
            VARINT => Value::Varint(self.varint()?),
            FIXED64 => Value::Fixed64(self.take(8)?.try_into().expect("eight bytes")),
            DELIMITED => {
                let length = self.varint()?;
                Value::Delimited(self.take(usize::try_from(length).unwrap_or(usize::MAX))?)
            }
            FIXED32 => Value::Fixed32(self.take(4)?.try_into().expect("four bytes")),
            other => return Err(refuse(format!("unknown wire type {other}"))),
        };
        Ok((tag, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u32, Value<'a>), MessageError>;

    fn next(&mut self) -> Option<Self::Item> {
        (!self.0.is_empty()).then(|| self.field())
    }
}

/// Reads a message into a zeroed block of this layout and its payload. Unknown fields are skipped.
///
/// # Errors
/// Where the bytes are no such message, or an array has another length than the block's.
pub(super) fn decode(
    layout: &Layout,
    message: &[u8],
    block: &mut [u8],
    payload: &mut Vec<u8>,
) -> Result<(), MessageError> {
    let mut found = [0; MAX_FIELDS];
    for entry in Fields(message) {
        let (tag, value) = entry?;
        if let Some(i) = layout.fields.iter().position(|f| f.tag == tag) {
            found[i] += store(&layout.fields[i], found[i], value, block, payload)?;
        }
    }
    for (field, &found) in layout.fields.iter().zip(&found).filter(|(f, _)| f.tag > 0) {
        let expected = match (field.kind, field.role) {
            (Kind::Array(_, room), Role::Counted(_)) => found.min(room),
            (Kind::Array(_, room), _) => room,
            (Kind::Struct(_), _) => found.max(1),
            _ => continue,
        };
        if found != expected {
            return Err(MessageError::Shape { expected, found });
        }
        if let Role::Counted(at) = field.role {
            block[at..at + 4].copy_from_slice(&(found as u32).to_le_bytes());
        }
    }
    Ok(())
}

/// Puts a value into its place, behind the elements found so far; returns the elements it holds.
fn store(
    field: &Field,
    before: usize,
    value: Value<'_>,
    block: &mut [u8],
    payload: &mut Vec<u8>,
) -> Result<usize, MessageError> {
    let place = field.bytes_mut(block);
    match (field.kind, field.role, value) {
        (_, Role::Payload(_), Value::Delimited(bytes)) => {
            *payload = bytes.to_vec();
            place.copy_from_slice(&(bytes.len() as u64).to_le_bytes());
        }
        (_, Role::Hash, Value::Fixed64(bytes)) => place.copy_from_slice(&bytes),
        (Kind::F32, _, Value::Fixed32(bytes)) => place.copy_from_slice(&bytes),
        (Kind::F64, _, Value::Fixed64(bytes)) => place.copy_from_slice(&bytes),
        (Kind::U32, Role::Value, Value::Varint(v)) => place.copy_from_slice(&(v as u32).to_le_bytes()),
        (Kind::U64, Role::Value, Value::Varint(v)) => place.copy_from_slice(&v.to_le_bytes()),
        (Kind::Struct(inner), _, Value::Delimited(bytes)) => decode(inner, bytes, place, payload)?,
        (Kind::Array(Kind::Struct(inner), _), _, Value::Delimited(bytes)) => {
            if let Some(slot) = place.chunks_exact_mut(inner.size).nth(before) {
                decode(inner, bytes, slot, payload)?;
            }
        }
        (Kind::Array(Kind::F64, _), _, Value::Delimited(bytes)) if bytes.len().is_multiple_of(8) => {
            if let Some(slots) = place.get_mut(8 * before..8 * before + bytes.len()) {
                slots.copy_from_slice(bytes);
            }
            return Ok(bytes.len() / 8);
        }
        (Kind::Array(Kind::F64, _), _, Value::Fixed64(bytes)) => {
            if let Some(slot) = place.chunks_exact_mut(8).nth(before) {
                slot.copy_from_slice(&bytes);
            }
        }
        _ => return Err(refuse(format!("field {}: unexpected wire type", field.name))),
    }
    Ok(1)
}
