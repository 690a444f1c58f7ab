//! Obeying a record: the fields a recorded frame consumed, found again in what was sent.

use protocol::blobs::BlobField;
use protocol::control::FrameScript;
use protocol::poses::FieldUsed;

/// Fields kept for scripts to come; the queue of the channel holds as many.
const CAPACITY: usize = 256;

/// Fields received, until a script asks for them.
pub struct FieldStore {
    fields: Vec<BlobField>,
    wanted: Vec<BlobField>,
    dropped: u64,
}

impl Default for FieldStore {
    fn default() -> Self {
        FieldStore {
            fields: Vec::with_capacity(CAPACITY),
            wanted: Vec::with_capacity(protocol::limits::MAX_FIELDS_USED),
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

    /// Fields that no script asked for in time.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Forgets all fields.
    pub fn clear(&mut self) {
        self.fields.clear();
    }

    /// The first field of the script that has not come yet.
    pub fn missing(&self, script: &FrameScript) -> Option<FieldUsed> {
        used_of(script).iter().find(|used| self.find(used).is_none()).copied()
    }

    /// The script's fields in its order, if all are there. They and everything their cameras sent
    /// before them are then forgotten.
    pub fn take(&mut self, script: &FrameScript) -> Option<&[BlobField]> {
        if self.missing(script).is_some() {
            return None;
        }
        self.wanted.clear();
        for used in used_of(script) {
            let at = self.find(used)?;
            self.wanted.push(self.fields[at]);
            let (camera, mut index) = (used.camera, 0);
            self.fields.retain(|f| {
                index += 1;
                index > at + 1 || f.camera != camera
            });
        }
        Some(&self.wanted)
    }

    fn find(&self, used: &FieldUsed) -> Option<usize> {
        self.fields
            .iter()
            .position(|f| (f.camera, f.field, f.exposed_ns) == (used.camera, used.field, used.exposed_ns))
    }
}

fn used_of(script: &FrameScript) -> &[FieldUsed] {
    &script.used[..(script.used_count as usize).min(script.used.len())]
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

    fn script(used: &[(u32, u64)]) -> FrameScript {
        let mut script = FrameScript::zeroed();
        for (slot, &(camera, field)) in script.used.iter_mut().zip(used) {
            *slot = FieldUsed { field, exposed_ns: 1 + field, camera, blobs_used: 0 };
        }
        script.used_count = used.len() as u32;
        script
    }

    #[test]
    fn a_script_gets_its_fields_in_its_order() {
        let mut store = FieldStore::default();
        for (camera, number) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 5)] {
            store.push(&field(camera, number));
        }
        assert_eq!(store.missing(&script(&[(1, 1), (0, 2)])).unwrap().field, 2);
        assert!(store.take(&script(&[(1, 1), (0, 2)])).is_none());
        let taken: Vec<_> =
            store.take(&script(&[(1, 1), (0, 0)])).unwrap().iter().map(|f| (f.camera, f.field)).collect();
        assert_eq!(taken, [(1, 1), (0, 0)]);
        assert!(store.take(&script(&[(1, 0)])).is_none(), "sent before a field that was consumed");
        assert!(store.take(&script(&[(0, 1), (2, 5)])).is_some());
    }

    #[test]
    fn too_many_fields_push_the_oldest_out() {
        let mut store = FieldStore::default();
        for n in 0..300 {
            store.push(&field(0, n));
        }
        assert_eq!(store.dropped(), 44);
        assert!(store.take(&script(&[(0, 43)])).is_none());
        assert!(store.take(&script(&[(0, 44)])).is_some());
    }
}
