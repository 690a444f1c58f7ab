//! Remarks of the recorder, which are no block of a channel.

use super::MessageError;
use super::protobuf::{Fields, Value, put_bytes, put_uint};
use protocol::health::Process;
use protocol::time::Nanos;

/// What a note is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoteKind {
    /// A message for a person.
    Log = 0,
    /// A process died and was started again.
    Restart = 1,
    /// The recording misses [`Note::count`] blocks here.
    Loss = 2,
}

impl NoteKind {
    fn from_wire(code: u64) -> Option<Self> {
        [NoteKind::Log, NoteKind::Restart, NoteKind::Loss].into_iter().find(|k| *k as u64 == code)
    }
}

/// A remark of the recorder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// When it was made.
    pub instant_ns: Nanos,
    /// What it is about.
    pub kind: NoteKind,
    /// The process concerned.
    pub process: Option<Process>,
    /// Blocks missed, or how often.
    pub count: u64,
    /// In words.
    pub text: String,
}

impl Note {
    /// The recording misses `count` blocks here.
    pub fn loss(instant_ns: Nanos, count: u64, text: String) -> Self {
        Note { instant_ns, kind: NoteKind::Loss, process: None, count, text }
    }

    /// Appends its message. `process` is 0 for none, else one more than its number.
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        put_uint(out, 1, self.instant_ns);
        put_uint(out, 2, self.kind as u64);
        put_uint(out, 3, self.process.map_or(0, |p| p as u64 + 1));
        put_uint(out, 4, self.count);
        put_bytes(out, 5, self.text.as_bytes());
    }

    /// Reads its message.
    ///
    /// # Errors
    /// Where the bytes are no such message, or name an unknown kind or process.
    pub(super) fn decode(message: &[u8]) -> Result<Self, MessageError> {
        let mut note =
            Note { instant_ns: 0, kind: NoteKind::Log, process: None, count: 0, text: String::new() };
        let unknown = |what, code| MessageError::Encoding(format!("unknown {what} {code}"));
        for entry in Fields(message) {
            match entry? {
                (1, Value::Varint(at)) => note.instant_ns = at,
                (2, Value::Varint(code)) => {
                    note.kind = NoteKind::from_wire(code).ok_or_else(|| unknown("kind of note", code))?;
                }
                (3, Value::Varint(0)) => note.process = None,
                (3, Value::Varint(code)) => {
                    let process = u32::try_from(code - 1).ok().and_then(Process::from_wire);
                    note.process = Some(process.ok_or_else(|| unknown("process", code))?);
                }
                (4, Value::Varint(count)) => note.count = count,
                (5, Value::Delimited(text)) => {
                    let text = std::str::from_utf8(text);
                    note.text = text.map_err(|e| MessageError::Encoding(e.to_string()))?.into();
                }
                (1..=5, _) => return Err(MessageError::Encoding("unexpected wire type in a note".into())),
                _ => {}
            }
        }
        Ok(note)
    }
}
