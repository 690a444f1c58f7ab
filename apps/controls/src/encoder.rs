//! The line protocol of handle encoders (`docs/handles.md`): `$VH,SEQ,HANDLE,COUNT,TOOL*CRC`, one line a
//! sample. Read as the bytes come, whatever they are. Pure.

use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;

/// What a line begins with.
const HEAD: &[u8] = b"$VH,";
/// Longest line without its end, bytes.
pub const LONGEST: usize = 48;
/// Most missing numbers that count as a gap; more mean that the sender restarted.
const LONGEST_GAP: u16 = 1_000;

/// One sample of one handle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Counts up by one with every line of the sender, and begins again after 65535.
    pub seq: u16,
    /// Whose handle: 0 or 1.
    pub handle: u32,
    /// The encoder.
    pub count: i32,
    /// The tool in the hand; `None` where the handle does not know.
    pub tool: Option<Tool>,
}

/// What is wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Bad {
    /// It does not begin as one.
    #[error("it does not begin with $VH,")]
    Head,
    /// It is longer than any.
    #[error("it is longer than 48 bytes")]
    Long,
    /// It has no checksum.
    #[error("it has no * with four hexadecimal digits at its end")]
    NoChecksum,
    /// Its checksum is another.
    #[error("its checksum is wrong")]
    Checksum,
    /// It has too few fields or too many.
    #[error("expected 4 fields between $VH, and *")]
    Fields,
    /// The number of the line.
    #[error("SEQ: expected 0 to 65535")]
    Seq,
    /// The handle.
    #[error("HANDLE: expected 0 or 1")]
    Handle,
    /// The encoder.
    #[error("COUNT: expected a whole number of 32 bits")]
    Count,
    /// The tool.
    #[error("TOOL: expected 0 (unknown) to 5")]
    Tool,
}

impl Bad {
    /// Name in counts.
    pub fn name(self) -> &'static str {
        match self {
            Bad::Checksum => "wrong checksum",
            _ => "not a line from a handle",
        }
    }
}

/// CRC-16/CCITT-FALSE: polynomial 0x1021, from 0xFFFF, neither reflected nor inverted.
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, &byte| {
        (0..8).fold(crc ^ (u16::from(byte) << 8), |crc: u16, _| match crc & 0x8000 {
            0 => crc << 1,
            _ => (crc << 1) ^ 0x1021,
        })
    })
}

impl Sample {
    /// A line without its end.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(line: &[u8]) -> Result<Self, Bad> {
        if line.len() > LONGEST {
            return Err(Bad::Long);
        }
        let inside = line.strip_prefix(HEAD).ok_or(Bad::Head)?;
        let star = inside.len().checked_sub(5).filter(|&at| inside[at] == b'*').ok_or(Bad::NoChecksum)?;
        let (fields, checksum) = (&inside[..star], &inside[star + 1..]);
        let checksum = hexadecimal(checksum).ok_or(Bad::NoChecksum)?;
        // Over everything between $ and *.
        if crc16(&line[1..HEAD.len() + star]) != checksum {
            return Err(Bad::Checksum);
        }
        let text = std::str::from_utf8(fields).map_err(|_| Bad::Fields)?;
        let mut fields = text.split(',');
        let mut next = || fields.next().ok_or(Bad::Fields);
        let [seq, handle, count, tool] = [next()?, next()?, next()?, next()?];
        if fields.next().is_some() {
            return Err(Bad::Fields);
        }
        let handle = number::<u32>(handle).filter(|&h| (h as usize) < INSTRUMENTS).ok_or(Bad::Handle)?;
        let tool = match number::<u32>(tool).ok_or(Bad::Tool)? {
            0 => None,
            code => Some(Tool::from_wire(code).ok_or(Bad::Tool)?),
        };
        let (seq, count) = (number(seq).ok_or(Bad::Seq)?, number(count).ok_or(Bad::Count)?);
        Ok(Sample { seq, handle, count, tool })
    }

    /// As a line, with its end.
    pub fn line(&self) -> String {
        let tool = self.tool.map_or(0, |tool| tool as u32);
        let inside = format!("VH,{},{},{},{tool}", self.seq, self.handle, self.count);
        format!("${inside}*{:04X}\r\n", crc16(inside.as_bytes()))
    }
}

/// Decimal digits, with a minus at most: no plus, no blanks.
fn number<N: std::str::FromStr>(text: &str) -> Option<N> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    digits.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok()).flatten()
}

fn hexadecimal(digits: &[u8]) -> Option<u16> {
    let digit = |b: &u8| char::from(*b).to_digit(16);
    digits.iter().try_fold(0, |value: u16, b| Some(value << 4 | digit(b)? as u16))
}

/// What a stream said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heard {
    /// A sample.
    Sample(Sample),
    /// A line that is none.
    Bad(Bad),
    /// So many lines are missing before the next sample.
    Gap(u16),
    /// The numbers go back, or far ahead: the sender restarted.
    Restart,
}

/// Reads lines from bytes as they come.
#[derive(Debug, Clone, Default)]
pub struct LineReader {
    line: Vec<u8>,
    /// The line is too long, and is passed over to its end.
    is_long: bool,
    /// What came before the first end of a line is half a line.
    is_in_step: bool,
    next_seq: Option<u16>,
}

impl LineReader {
    /// Takes what has come, and hands on what it says. What lies before the first `$` belongs to a line
    /// whose beginning was missed, and is passed over.
    pub fn take(&mut self, bytes: &[u8], mut heard: impl FnMut(Heard)) {
        for &byte in bytes {
            match byte {
                b'\n' | b'\r' => self.end(&mut heard),
                // Half a line before it was torn.
                b'$' => {
                    self.end(&mut heard);
                    (self.is_in_step, self.is_long) = (true, false);
                    self.line.push(byte);
                }
                _ if self.line.len() > LONGEST => self.is_long = true,
                _ => self.line.push(byte),
            }
        }
    }

    /// Forgets half a line and the numbers: the line was closed.
    pub fn forget(&mut self) {
        *self = LineReader::default();
    }

    fn end(&mut self, heard: &mut impl FnMut(Heard)) {
        let is_line = std::mem::replace(&mut self.is_in_step, true) && !self.line.is_empty();
        let long = std::mem::take(&mut self.is_long);
        if is_line {
            match if long { Err(Bad::Long) } else { Sample::parse(&self.line) } {
                Ok(sample) => {
                    self.follow(sample.seq, heard);
                    heard(Heard::Sample(sample));
                }
                Err(bad) => heard(Heard::Bad(bad)),
            }
        }
        self.line.clear();
    }

    /// Looks whether the number follows that of the line before.
    fn follow(&mut self, seq: u16, heard: &mut impl FnMut(Heard)) {
        match self.next_seq.replace(seq.wrapping_add(1)).map_or(0, |next| seq.wrapping_sub(next)) {
            0 => {}
            missing @ 1..=LONGEST_GAP => heard(Heard::Gap(missing)),
            _ => heard(Heard::Restart),
        }
    }
}

#[cfg(test)]
mod tests;
