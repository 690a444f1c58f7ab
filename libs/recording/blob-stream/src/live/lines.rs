//! Bytes as they arrive become lines, with no more memory than one line may take.

/// Longest line that is taken, bytes without its end; 64 blobs with every key take about 15 KiB.
pub const MAX_LINE_BYTES: usize = 64 << 10;

/// A line was longer than [`MAX_LINE_BYTES`] and is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooLong;

/// Cuts a stream of bytes into lines. Lines are counted from 1, over all writers.
#[derive(Debug, Default)]
pub struct LineSplitter {
    /// The beginning of a line whose end has not come.
    begun: Vec<u8>,
    /// The line that has begun is too long: its rest is passed over.
    too_long: bool,
    count: u64,
}

impl LineSplitter {
    /// Takes bytes, and gives every line that ends in them with its number. Stops at the first error of
    /// `line`; the bytes behind it are lost.
    ///
    /// # Errors
    /// Those of `line`.
    pub fn feed<E>(
        &mut self,
        mut bytes: &[u8],
        mut line: impl FnMut(u64, Result<&[u8], TooLong>) -> Result<(), E>,
    ) -> Result<(), E> {
        while let Some(end) = bytes.iter().position(|b| *b == b'\n') {
            let (head, rest) = (&bytes[..end], &bytes[end + 1..]);
            bytes = rest;
            self.count += 1;
            if self.begun.is_empty() && !self.too_long {
                // Whole within what came: no copy is made.
                let whole = if head.len() > MAX_LINE_BYTES { Err(TooLong) } else { Ok(head) };
                line(self.count, whole)?;
            } else {
                self.put(head);
                self.hand_out(&mut line)?;
            }
        }
        self.put(bytes);
        Ok(())
    }

    /// No more comes: what has begun is a line.
    ///
    /// # Errors
    /// Those of `line`.
    pub fn end<E>(
        &mut self,
        mut line: impl FnMut(u64, Result<&[u8], TooLong>) -> Result<(), E>,
    ) -> Result<(), E> {
        if self.begun.is_empty() && !self.too_long {
            return Ok(());
        }
        self.count += 1;
        self.hand_out(&mut line)
    }

    fn put(&mut self, bytes: &[u8]) {
        self.too_long |= self.begun.len() + bytes.len() > MAX_LINE_BYTES;
        if self.too_long {
            self.begun.clear();
        } else {
            self.begun.extend_from_slice(bytes);
        }
    }

    fn hand_out<E>(
        &mut self,
        line: &mut impl FnMut(u64, Result<&[u8], TooLong>) -> Result<(), E>,
    ) -> Result<(), E> {
        let whole = if std::mem::take(&mut self.too_long) { Err(TooLong) } else { Ok(&self.begun[..]) };
        let taken = line(self.count, whole);
        self.begun.clear();
        taken
    }
}
