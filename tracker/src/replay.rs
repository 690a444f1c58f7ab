//! Replay: the camera-fields that a recorded frame consumed, found again among those received.

use protocol::blobs::BlobField;
use protocol::control::RecordedFrame;
use protocol::poses::FieldUsed;

/// Fields kept for recorded frames to come; the queue of the channel holds as many.
const CAPACITY: usize = 256;

/// Keeps received fields until a recorded frame consumes them.
pub struct FieldStore {
    fields: Vec<BlobField>,
    consumed: Vec<BlobField>,
    dropped: u64,
}

impl Default for FieldStore {
    fn default() -> Self {
        FieldStore {
            fields: Vec::with_capacity(CAPACITY),
            consumed: Vec::with_capacity(protocol::limits::MAX_FIELDS_USED),
            dropped: 0,
        }
    }
}

impl FieldStore {
    /// Keeps a field; the oldest is dropped where there is no room.
    pub fn push(&mut self, field: &BlobField) {
        if self.fields.len() == CAPACITY {
            self.fields.remove(0);
            self.dropped += 1;
        }
        self.fields.push(*field);
    }

    /// Fields dropped before a recorded frame consumed them.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Forgets all fields.
    pub fn clear(&mut self) {
        self.fields.clear();
    }

    /// The first field of a recorded frame that has not arrived yet.
    pub fn missing(&self, recorded: &RecordedFrame) -> Option<FieldUsed> {
        used_of(recorded).iter().find(|used| self.find(used).is_none()).copied()
    }

    /// The fields of a recorded frame in the recorded order, if all have arrived. They and all
    /// older fields of their cameras are then forgotten.
    pub fn take(&mut self, recorded: &RecordedFrame) -> Option<&[BlobField]> {
        if self.missing(recorded).is_some() {
            return None;
        }
        self.consumed.clear();
        for used in used_of(recorded) {
            let at = self.find(used)?;
            self.consumed.push(self.fields[at]);
            let (camera, mut index) = (used.camera, 0);
            self.fields.retain(|f| {
                index += 1;
                index > at + 1 || f.camera != camera
            });
        }
        Some(&self.consumed)
    }

    fn find(&self, used: &FieldUsed) -> Option<usize> {
        self.fields
            .iter()
            .position(|f| (f.camera, f.field, f.exposed_ns) == (used.camera, used.field, used.exposed_ns))
    }
}

fn used_of(recorded: &RecordedFrame) -> &[FieldUsed] {
    &recorded.used[..(recorded.used_count as usize).min(recorded.used.len())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn field(camera: u32, number: u64) -> BlobField {
        let mut field = BlobField::zeroed();
        (field.camera, field.field, field.exposed_ns) = (camera, number, 1 + number);
        field
    }

    fn recorded(used: &[(u32, u64)]) -> RecordedFrame {
        let mut recorded = RecordedFrame::zeroed();
        for (slot, &(camera, field)) in recorded.used.iter_mut().zip(used) {
            *slot = FieldUsed { field, exposed_ns: 1 + field, camera, blobs_used: 0 };
        }
        recorded.used_count = used.len() as u32;
        recorded
    }

    #[test]
    fn a_recorded_frame_gets_its_fields_in_the_recorded_order() {
        let mut store = FieldStore::default();
        for (camera, number) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 5)] {
            store.push(&field(camera, number));
        }
        assert_eq!(store.missing(&recorded(&[(1, 1), (0, 2)])).unwrap().field, 2);
        assert!(store.take(&recorded(&[(1, 1), (0, 2)])).is_none());
        let taken: Vec<_> =
            store.take(&recorded(&[(1, 1), (0, 0)])).unwrap().iter().map(|f| (f.camera, f.field)).collect();
        assert_eq!(taken, [(1, 1), (0, 0)]);
        assert!(store.take(&recorded(&[(1, 0)])).is_none(), "sent before a field that was consumed");
        assert!(store.take(&recorded(&[(0, 1), (2, 5)])).is_some());
    }

    #[test]
    fn too_many_fields_push_the_oldest_out() {
        let mut store = FieldStore::default();
        for n in 0..300 {
            store.push(&field(0, n));
        }
        assert_eq!(store.dropped(), 44);
        assert!(store.take(&recorded(&[(0, 43)])).is_none());
        assert!(store.take(&recorded(&[(0, 44)])).is_some());
    }
}
