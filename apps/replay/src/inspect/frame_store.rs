//! What was seen in every frame of a recording, at hand in any order: in a file without a name, which goes with the
//! program. Some 3 kB a frame.

use super::seen::Seen;
use anyhow::Context;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;

/// Writes one.
pub struct FrameWriter {
    file: BufWriter<File>,
    ends: Vec<u64>,
}

/// The frames.
pub struct FrameStore {
    file: File,
    /// Where each ends.
    ends: Vec<u64>,
}

impl FrameWriter {
    /// Begins with none.
    ///
    /// # Errors
    /// Where the system's place for such files (`TMPDIR`) takes none.
    pub fn new() -> anyhow::Result<Self> {
        let file = tempfile::tempfile().with_context(|| std::env::temp_dir().display().to_string())?;
        Ok(FrameWriter { file: BufWriter::new(file), ends: Vec::new() })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// Where the disk is full.
    pub fn add(&mut self, seen: &Seen) -> anyhow::Result<()> {
        let bytes = seen.to_bytes();
        self.file.write_all(&bytes).with_context(|| std::env::temp_dir().display().to_string())?;
        self.ends.push(self.ends.last().unwrap_or(&0) + bytes.len() as u64);
        Ok(())
    }

    /// Ends the writing.
    ///
    /// # Errors
    /// Where the disk is full.
    pub fn finish(self) -> anyhow::Result<FrameStore> {
        let file = self.file.into_inner().map_err(|e| e.into_error());
        let file = file.with_context(|| std::env::temp_dir().display().to_string())?;
        Ok(FrameStore { file, ends: self.ends })
    }
}

impl FrameStore {
    /// What was seen in a frame, counted from 0.
    ///
    /// # Errors
    /// Where there is no such frame, or the file cannot be read.
    pub fn get(&self, number: usize) -> anyhow::Result<Seen> {
        let end = *self.ends.get(number).with_context(|| format!("no frame {number}"))?;
        let start = number.checked_sub(1).map_or(0, |before| self.ends[before]);
        let mut bytes = vec![0; (end - start) as usize];
        self.file.read_exact_at(&mut bytes, start).context("what was seen")?;
        Seen::from_bytes(&bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::seen::tests::sample;
    use super::*;

    #[test]
    fn frames_come_back_in_any_order() {
        let mut writer = FrameWriter::new().unwrap();
        let frames: Vec<Seen> = (0..50).map(|n| sample(&format!("field {n}"), &[n % 5, 14, n % 2])).collect();
        frames.iter().for_each(|seen| writer.add(seen).unwrap());
        let frame_store = writer.finish().unwrap();
        for n in [49, 0, 17, 18, 3, 17] {
            assert_eq!(frame_store.get(n).unwrap(), frames[n]);
        }
        assert!(frame_store.get(50).is_err());
    }
}
