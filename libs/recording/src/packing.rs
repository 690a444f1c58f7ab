//! How the chunks of a recording are packed. A reader takes every kind, whatever it writes itself.

use mcap::Compression;

/// How chunks are packed; `docs/recording.md` has sizes and times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Packing {
    /// Zstandard: the smallest files.
    #[default]
    Zstd,
    /// LZ4: larger files, quicker to read.
    Lz4,
    /// Not at all: the largest files, for tools that unpack nothing.
    None,
}

impl Packing {
    /// All, in the order of their names in help texts.
    pub const ALL: [Packing; 3] = [Packing::Zstd, Packing::Lz4, Packing::None];

    /// Its name on command lines.
    pub fn name(self) -> &'static str {
        match self {
            Packing::Zstd => "zstd",
            Packing::Lz4 => "lz4",
            Packing::None => "none",
        }
    }

    /// By its name on command lines.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|packing| packing.name() == name)
    }

    /// By its name in the header of a chunk.
    pub(super) fn of_chunk(name: &[u8]) -> Option<Self> {
        match name {
            b"zstd" => Some(Packing::Zstd),
            b"lz4" => Some(Packing::Lz4),
            b"" => Some(Packing::None),
            _ => None,
        }
    }

    /// As the `mcap` crate says it.
    pub(super) fn compression(self) -> Option<Compression> {
        match self {
            Packing::Zstd => Some(Compression::Zstd),
            Packing::Lz4 => Some(Compression::Lz4),
            Packing::None => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_back() {
        for packing in Packing::ALL {
            assert_eq!(Packing::named(packing.name()), Some(packing));
        }
        assert_eq!(Packing::named("gzip"), None);
        assert_eq!(Packing::of_chunk(b"bz2"), None);
    }
}
