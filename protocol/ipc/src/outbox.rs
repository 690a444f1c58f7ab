//! Blob fields held back until the instants at which they are due.

use crate::{Instance, IpcError, Lease, Sender};
use protocol::blobs::BlobField;
use protocol::limits::MAX_CAMERAS;
use std::collections::VecDeque;

/// Fields that can wait: half a second of every camera at 50 Hz.
const WAITING: usize = 25 * MAX_CAMERAS;

/// Blob fields that are not due yet, earliest first. Each is built in the shared memory from which it is sent, and
/// waits there. Due instants are ns on any clock that the caller keeps to.
pub struct Outbox {
    /// Due instant, ns, with its field; earliest first.
    waiting: VecDeque<(u64, Lease<BlobField>)>,
    /// Due instant of each camera's newest field.
    newest: [u64; MAX_CAMERAS],
}

/// What became of a field that was to be held back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Placed {
    /// It waits.
    Waits,
    /// Whoever was to build it refused.
    Refused,
    /// There is no room.
    NoRoom,
}

impl Default for Outbox {
    fn default() -> Self {
        Outbox { waiting: VecDeque::with_capacity(WAITING), newest: [0; MAX_CAMERAS] }
    }
}

impl Outbox {
    /// Opens the channel of blobs with room for all that can wait, and for one that is sent past them.
    ///
    /// # Errors
    /// Where the channel cannot be opened.
    pub fn sender(instance: &Instance) -> Result<Sender<BlobField>, IpcError> {
        instance.sender_of_many(WAITING + 1)
    }

    /// Has `build` make a field in memory lent by `sender`, and holds it until the instant that `build` returns, or
    /// until the field before it of its camera is due if that is later: fields of a camera do not overtake each
    /// other. The memory holds whatever an earlier field left there. Where `build` returns none, nothing is held.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn put(
        &mut self,
        sender: &mut Sender<BlobField>,
        build: impl FnOnce(&mut BlobField) -> Option<u64>,
    ) -> Result<Placed, IpcError> {
        if self.waiting.len() == WAITING {
            return Ok(Placed::NoRoom);
        }
        let mut lease = sender.lend()?;
        let Some(due_ns) = build(lease.block()) else { return Ok(Placed::Refused) };
        let newest = &mut self.newest[lease.block().camera as usize % MAX_CAMERAS];
        let due_ns = due_ns.max(*newest);
        *newest = due_ns;
        let at = self.waiting.partition_point(|(due, _)| *due <= due_ns);
        self.waiting.insert(at, (due_ns, lease));
        Ok(Placed::Waits)
    }

    /// When the next one is due, ns.
    pub fn due_ns(&self) -> Option<u64> {
        self.waiting.front().map(|(due, _)| *due)
    }

    /// The next one that is due at `now_ns`, to be stamped and sent, or dropped.
    pub fn take(&mut self, now_ns: u64) -> Option<Lease<BlobField>> {
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
    use crate::{Queue, Receiver};
    use bytemuck::Zeroable;

    fn opened(name: &str) -> (Instance, Sender<BlobField>) {
        let instance = Instance::own(&format!("{name}{}", std::process::id() % 1_000_000)).unwrap();
        let sender = Outbox::sender(&instance).unwrap();
        (instance, sender)
    }

    fn put(outbox: &mut Outbox, sender: &mut Sender<BlobField>, due: u64, camera: u32, field: u64) -> Placed {
        let build = |block: &mut BlobField| {
            *block = BlobField { camera, field, ..BlobField::zeroed() };
            Some(due)
        };
        outbox.put(sender, build).unwrap()
    }

    #[test]
    fn fields_leave_when_due_and_never_overtake_their_own() {
        let (instance, mut sender) = opened("box-due");
        let mut receiver: Receiver<BlobField> = instance.receiver(Queue::InOrder).unwrap();
        let mut outbox = Outbox::default();
        for (due, camera, number) in [(50, 0, 1), (20, 1, 1), (20, 2, 1), (30, 0, 2), (40, 1, 2)] {
            assert_eq!(put(&mut outbox, &mut sender, due, camera, number), Placed::Waits);
        }
        assert_eq!(outbox.put(&mut sender, |_| None).unwrap(), Placed::Refused);
        assert_eq!(outbox.due_ns(), Some(20));
        assert!(outbox.take(19).is_none());
        while let Some(mut lease) = outbox.take(1000) {
            lease.block().exposed_ns = 1;
            lease.block().read_out_ns = 1;
            lease.block().blobs_out_ns = 1;
            sender.send_lease(lease).unwrap();
        }
        let all: Vec<_> =
            std::iter::from_fn(|| receiver.next_sample().unwrap()).map(|f| (f.camera, f.field)).collect();
        assert_eq!(all, [(1, 1), (2, 1), (1, 2), (0, 1), (0, 2)]);
        assert_eq!((receiver.counts().lost, sender.sent()), (0, 5));
        assert_eq!(outbox.due_ns(), None);
        outbox.clear();
        put(&mut outbox, &mut sender, 10, 0, 0);
        assert_eq!(outbox.due_ns(), Some(10), "forgot what was before");
    }

    /// What was held back and dropped is lent again, and a full outbox leaves a block for one sent past it.
    #[test]
    fn what_finds_no_room_is_refused() {
        let (_instance, mut sender) = opened("box-full");
        for _ in 0..2 {
            let mut outbox = Outbox::default();
            let all = (0..2 * WAITING as u64).map(|n| put(&mut outbox, &mut sender, n, 0, n));
            assert_eq!(all.filter(|placed| *placed == Placed::Waits).count(), WAITING);
            sender.send(&BlobField::zeroed()).unwrap();
        }
    }
}
