//! A text file in memory for child processes, which leaves nothing on disk even if the command is killed.

use anyhow::Context;
use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{Seek, Write};
use std::os::fd::AsRawFd;

/// A file in memory that exists as long as this value and that processes open through `/proc`.
#[derive(Debug)]
pub struct MemoryFile(File);

impl MemoryFile {
    /// Creates a file that contains `text`.
    ///
    /// # Errors
    /// If the system provides no memory.
    pub fn new(text: &str) -> anyhow::Result<Self> {
        let mut file =
            MemoryFile(memfd_create("vitreo", MemfdFlags::CLOEXEC).context("a file in memory")?.into());
        file.replace(text)?;
        Ok(file)
    }

    /// Replaces the contents with `text`.
    ///
    /// # Errors
    /// If the system provides no memory.
    pub fn replace(&mut self, text: &str) -> anyhow::Result<()> {
        self.0.set_len(0)?;
        self.0.rewind()?;
        Ok(self.0.write_all(text.as_bytes())?)
    }

    /// Path under which every process of this user can open the file.
    pub fn name(&self) -> String {
        format!("/proc/{}/fd/{}", std::process::id(), self.0.as_raw_fd())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_text_is_found_under_its_name_as_long_as_it_lasts() {
        let mut file = MemoryFile::new("a longer text").unwrap();
        let name = file.name();
        let read = || std::fs::read_to_string(&name).unwrap();
        assert_eq!(read(), "a longer text");
        file.replace("short").unwrap();
        assert_eq!((read().as_str(), read().as_str()), ("short", "short"), "it is read from its start");
    }
}
