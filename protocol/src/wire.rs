//! The layout of wire types as data.
//!
//! `#[derive(Wire)]` makes a [`Layout`] from a struct's own declaration. The schema hash of a
//! channel, the messages of a recording and the columns of exported tables all come from it.

use crate::message::fnv_bytes;
use bytemuck::Pod;
pub use protocol_derive::Wire;

/// A plain value whose layout is known: a number, an array, or a struct of such.
///
/// `Pod` proves that there are no pointers, no padding and no invalid bit patterns.
pub trait Wire: Pod {
    /// What it consists of.
    const KIND: Kind;
}

/// Most fields of a struct.
pub const MAX_FIELDS: usize = 32;

/// What a field consists of.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum Kind {
    U8,
    U16,
    U32,
    U64,
    F32,
    F64,
    Struct(&'static Layout),
    /// Elements of one kind, and how many.
    Array(&'static Kind, usize),
}

/// The fields of a struct, in order and without gaps.
#[derive(Debug, PartialEq)]
pub struct Layout {
    /// Name of its message in recordings.
    pub name: &'static str,
    /// Bytes.
    pub size: usize,
    /// Its fields.
    pub fields: &'static [Field],
}

/// One field of a struct.
#[derive(Debug, PartialEq)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// Bytes from the start of the struct.
    pub offset: usize,
    /// What it consists of.
    pub kind: Kind,
    /// Protobuf field number in recordings, rising from field to field; 0: not recorded.
    pub tag: u32,
    /// What it is for.
    pub role: Role,
    /// Names of its columns in tables, separated by commas, where they are not its own.
    pub columns: Option<&'static str>,
}

/// What a field is for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// A value.
    Value,
    /// A hash: `fixed64` in recordings, hexadecimal in tables.
    Hash,
    /// An array whose first elements are in use; the `u32` at this offset counts them.
    Counted(usize),
    /// Bytes of the payload that follows the block; recorded as that payload, under this name.
    Payload(&'static str),
    /// Where a section of the payload lies; its elements are of this kind.
    Section(Kind),
}

macro_rules! scalars {
    ($($type:ty => $kind:ident),*) => { $(impl Wire for $type { const KIND: Kind = Kind::$kind; })* };
}
scalars!(u8 => U8, u16 => U16, u32 => U32, u64 => U64, f32 => F32, f64 => F64);

impl<T: Wire, const N: usize> Wire for [T; N] {
    const KIND: Kind = Kind::Array(&T::KIND, N);
}

/// The layout of a struct. Fails to compile for other types.
pub const fn layout_of<T: Wire>() -> &'static Layout {
    match T::KIND {
        Kind::Struct(layout) => layout,
        _ => panic!("not a struct"),
    }
}

impl Kind {
    /// Bytes.
    pub const fn size(&self) -> usize {
        match self {
            Kind::U8 => 1,
            Kind::U16 => 2,
            Kind::U32 | Kind::F32 => 4,
            Kind::U64 | Kind::F64 => 8,
            Kind::Struct(layout) => layout.size,
            Kind::Array(element, count) => element.size() * *count,
        }
    }

    /// The struct that it is, or that its elements are.
    pub const fn layout(&self) -> Option<&'static Layout> {
        match self {
            Kind::Struct(layout) => Some(*layout),
            Kind::Array(element, _) => element.layout(),
            _ => None,
        }
    }

    /// Continues a hash with the kind and all that it consists of, but for the names of types.
    const fn hash(&self, hash: u64) -> u64 {
        let code: u64 = match self {
            Kind::U8 => 1,
            Kind::U16 => 2,
            Kind::U32 => 3,
            Kind::U64 => 4,
            Kind::F32 => 5,
            Kind::F64 => 6,
            Kind::Struct(_) => 7,
            Kind::Array(_, count) => 8 + *count as u64,
        };
        let hash = fnv_bytes(hash, &code.to_le_bytes());
        match self {
            Kind::Struct(layout) => layout.hash(hash),
            Kind::Array(element, _) => element.hash(hash),
            _ => hash,
        }
    }

    /// True for what a recording can hold: `u32`, `u64`, `f32`, `f64`, arrays of `f64`, structs and
    /// arrays of them.
    const fn is_recordable(&self) -> bool {
        match self {
            Kind::U32 | Kind::U64 | Kind::F32 | Kind::F64 | Kind::Struct(_) => true,
            Kind::Array(element, _) => matches!(element, Kind::F64 | Kind::Struct(_)),
            Kind::U8 | Kind::U16 => false,
        }
    }
}

impl Field {
    /// Its bytes in a block.
    pub fn bytes<'a>(&self, block: &'a [u8]) -> &'a [u8] {
        &block[self.offset..self.offset + self.kind.size()]
    }

    /// Its bytes in a block, to be written.
    pub fn bytes_mut<'a>(&self, block: &'a mut [u8]) -> &'a mut [u8] {
        &mut block[self.offset..self.offset + self.kind.size()]
    }
}

impl Layout {
    /// The fields that a recording holds.
    pub fn recorded(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().filter(|f| f.tag > 0)
    }

    /// Fails to compile where fields leave a gap, or have tags that do not rise or that a
    /// recording cannot hold.
    pub const fn prove(&self) {
        assert!(self.fields.len() <= MAX_FIELDS, "too many fields");
        let (mut i, mut end, mut tag) = (0, 0, 0);
        while i < self.fields.len() {
            let field = &self.fields[i];
            assert!(field.offset == end, "fields leave a gap");
            end += field.kind.size();
            if field.tag > 0 {
                assert!(field.tag > tag, "tags do not rise");
                assert!(field.kind.is_recordable(), "a recording cannot hold such a field");
                tag = field.tag;
            }
            i += 1;
        }
        assert!(end == self.size, "there is a gap at the end");
    }

    /// Continues a hash with the fields: name, offset, kind, and the elements of sections.
    pub const fn hash(&self, mut hash: u64) -> u64 {
        let mut i = 0;
        while i < self.fields.len() {
            let field = &self.fields[i];
            hash = fnv_bytes(hash, field.name.as_bytes());
            hash = fnv_bytes(hash, &(field.offset as u64).to_le_bytes());
            hash = field.kind.hash(hash);
            if let Role::Section(element) = &field.role {
                hash = element.hash(hash);
            }
            i += 1;
        }
        fnv_bytes(hash, &(self.size as u64).to_le_bytes())
    }
}
