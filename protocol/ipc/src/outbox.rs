//! Blob fields held back until the instants at which they are due.

use protocol::blobs::BlobField;
use protocol::limits::MAX_CAMERAS;
use std::collections::VecDeque;

/// Fields that can wait: half a second of every camera at 50 Hz.
const WAITING: usize = 25 * MAX_CAMERAS;

/// Blob fields that are not due yet, earliest first. Due instants are ns on any clock that the
/// caller keeps to.
pub struct Outbox {
    /// Due instant, ns, with its field; earliest first.
    waiting: VecDeque<(u64, BlobField)>,
    /// Due instant of each camera's newest field.
    newest: [u64; MAX_CAMERAS],
}

impl Default for Outbox {
    fn default() -> Self {
        Outbox { waiting: VecDeque::with_capacity(WAITING), newest: [0; MAX_CAMERAS] }
    }
}

impl Outbox {
    /// Holds a field until `due_ns`, or until the field before it of its camera is due if that is
    /// later: fields of a camera do not overtake each other. False if there is no room.
    pub fn put(&mut self, due_ns: u64, field: &BlobField) -> bool {
        if self.waiting.len() == WAITING {
            return false;
        }
        let newest = &mut self.newest[field.camera as usize % MAX_CAMERAS];
        let due_ns = due_ns.max(*newest);
        *newest = due_ns;
        let at = self.waiting.partition_point(|(due, _)| *due <= due_ns);
        self.waiting.insert(at, (due_ns, *field));
        true
    }

    /// When the next one is due, ns.
    pub fn due_ns(&self) -> Option<u64> {
        self.waiting.front().map(|(due, _)| *due)
    }

    /// The next one that is due at `now_ns`.
    pub fn take(&mut self, now_ns: u64) -> Option<BlobField> {
        self.due_ns().filter(|due| *due <= now_ns)?;
        self.waiting.pop_front().map(|(_, field)| field)
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.waiting.clear();
        self.newest = [0; MAX_CAMERAS];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn field(camera: u32, field: u64) -> BlobField {
        BlobField { camera, field, ..BlobField::zeroed() }
    }

    #[test]
    fn fields_leave_when_due_and_never_overtake_their_own() {
        let mut outbox = Outbox::default();
        for (due, camera, number) in [(50, 0, 1), (20, 1, 1), (20, 2, 1), (30, 0, 2), (40, 1, 2)] {
            assert!(outbox.put(due, &field(camera, number)));
        }
        assert_eq!(outbox.due_ns(), Some(20));
        assert!(outbox.take(19).is_none());
        let all: Vec<_> = std::iter::from_fn(|| outbox.take(1000)).map(|f| (f.camera, f.field)).collect();
        assert_eq!(all, [(1, 1), (2, 1), (1, 2), (0, 1), (0, 2)]);
        assert_eq!(outbox.due_ns(), None);
        outbox.clear();
        outbox.put(10, &field(0, 0));
        assert_eq!(outbox.due_ns(), Some(10), "forgot what was before");
    }

    #[test]
    fn what_finds_no_room_is_refused() {
        let mut outbox = Outbox::default();
        let taken = (0..2 * WAITING as u64).filter(|&n| outbox.put(n, &field(0, n))).count();
        assert_eq!(taken, WAITING);
    }
}
