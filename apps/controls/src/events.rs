//! Events of the kernel's input devices as bytes: `struct input_event` of 64-bit Linux, 24 bytes each, as
//! a device gives them and as they lie in a recorded file (`cat /dev/input/event5 > pedal.events`). Pure.

/// Length of one event, bytes.
pub const EVENT_BYTES: usize = 24;
/// Kind of an event that closes what happened at one instant.
pub const SYN: u16 = 0;
/// Kind of a key or button.
pub const KEY: u16 = 1;
/// Kind of an absolute axis.
pub const ABS: u16 = 3;
/// Code of a [`SYN`]: events were lost before it, and the device must be asked for its state.
pub const SYN_DROPPED: u16 = 3;

/// One event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event {
    /// When it happened, µs of the device's clock.
    pub at_us: i64,
    /// [`SYN`], [`KEY`], [`ABS`] or another that says nothing of a pedal.
    pub kind: u16,
    /// Which key or axis.
    pub code: u16,
    /// A key: 1 down, 0 up, 2 held; an axis: where it is.
    pub value: i32,
}

impl Event {
    /// From the kernel's bytes.
    pub fn from_bytes(bytes: &[u8; EVENT_BYTES]) -> Self {
        let long = |at: usize| i64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let short = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        Event {
            at_us: long(0).saturating_mul(1_000_000).saturating_add(long(8)),
            kind: short(16),
            code: short(18),
            value: i32::from_le_bytes(std::array::from_fn(|i| bytes[20 + i])),
        }
    }

    /// As the kernel's bytes.
    pub fn to_bytes(self) -> [u8; EVENT_BYTES] {
        let mut bytes = [0; EVENT_BYTES];
        bytes[..8].copy_from_slice(&self.at_us.div_euclid(1_000_000).to_le_bytes());
        bytes[8..16].copy_from_slice(&self.at_us.rem_euclid(1_000_000).to_le_bytes());
        bytes[16..18].copy_from_slice(&self.kind.to_le_bytes());
        bytes[18..20].copy_from_slice(&self.code.to_le_bytes());
        bytes[20..].copy_from_slice(&self.value.to_le_bytes());
        bytes
    }
}

/// Cuts a stream of bytes into blocks of one length, however the stream arrives.
#[derive(Debug, Clone)]
pub struct Blocks {
    length: usize,
    part: Vec<u8>,
}

impl Blocks {
    /// Blocks of `length` bytes; at least 1.
    pub fn of(length: usize) -> Self {
        Blocks { length: length.max(1), part: Vec::with_capacity(length.max(1)) }
    }

    /// Takes what has come, and hands on every block that is whole.
    pub fn take(&mut self, mut bytes: &[u8], mut whole: impl FnMut(&[u8])) {
        while !bytes.is_empty() {
            let (piece, rest) = bytes.split_at(bytes.len().min(self.length - self.part.len()));
            self.part.extend_from_slice(piece);
            bytes = rest;
            if self.part.len() == self.length {
                whole(&self.part);
                self.part.clear();
            }
        }
    }

    /// Forgets a block that is not whole: another stream begins. Returns whether there was one.
    pub fn forget(&mut self) -> bool {
        let broken = !self.part.is_empty();
        self.part.clear();
        broken
    }
}

/// Reads events from a stream of bytes.
#[derive(Debug, Clone)]
pub struct EventReader(Blocks);

impl Default for EventReader {
    fn default() -> Self {
        EventReader(Blocks::of(EVENT_BYTES))
    }
}

impl EventReader {
    /// Takes what has come, and hands on every event that is whole.
    pub fn take(&mut self, bytes: &[u8], mut event: impl FnMut(Event)) {
        self.0.take(bytes, |block| {
            // A block of this reader has this length.
            if let Some(block) = block.first_chunk() {
                event(Event::from_bytes(block));
            }
        });
    }

    /// Forgets half an event. Returns whether there was one.
    pub fn forget(&mut self) -> bool {
        self.0.forget()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn events_come_back_however_they_are_cut(
            events in prop::collection::vec((-1i64 << 40..1i64 << 40, any::<(u16, u16, i32)>()), 0..20),
            cut in 1usize..60,
        ) {
            let events: Vec<Event> = events
                .into_iter()
                .map(|(at_us, (kind, code, value))| Event { at_us, kind, code, value })
                .collect();
            let bytes: Vec<u8> = events.iter().flat_map(|e| e.to_bytes()).collect();
            let (mut reader, mut read) = (EventReader::default(), Vec::new());
            bytes.chunks(cut).for_each(|piece| reader.take(piece, |event| read.push(event)));
            prop_assert_eq!(read, events);
            prop_assert!(!reader.forget());
        }
    }

    #[test]
    fn half_an_event_is_forgotten_with_its_stream() {
        let event = Event { at_us: 7, kind: KEY, code: 30, value: 1 };
        let (mut reader, mut read) = (EventReader::default(), Vec::new());
        reader.take(&event.to_bytes()[..10], |e| read.push(e));
        assert!(reader.forget() && !reader.forget());
        reader.take(&event.to_bytes(), |e| read.push(e));
        assert_eq!(read, [event]);
    }

    #[test]
    fn no_bytes_are_too_odd() {
        let mut read = Vec::new();
        EventReader::default().take(&[255; EVENT_BYTES], |e| read.push(e));
        assert_eq!((read[0].kind, read[0].code, read[0].value), (u16::MAX, u16::MAX, -1));
    }
}
