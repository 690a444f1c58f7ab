//! Playback of a recorded stream of blobs with the script's controls.

use super::controls::ControlSample;
use super::{Source, VirtualRigShell};
use crate::playback::BlobPlayback;
use anyhow::Result;
use ipc::clock::now;

/// The stream, and how far it is played.
pub(super) struct Playback {
    pub(super) stream: BlobPlayback,
    pub(super) next: usize,
    /// Field periods for which the controls were sent.
    pub(super) beats: u64,
}

impl Playback {
    /// When the next field is due, ns after the start; `None` after the last.
    fn due_ns(&self, duration_ns: u64) -> Option<u64> {
        let due_ns = (self.next < self.stream.count()).then(|| self.stream.due_ns(self.next));
        due_ns.filter(|due_ns| *due_ns < duration_ns)
    }

    /// Sends the next field, due at `due_ns`. The stream has no controls: those of the script are sent
    /// once a field period.
    fn send(&mut self, rig: &mut VirtualRigShell, due_ns: u64) -> Result<()> {
        let period_ns = rig.rig.field_period_ns();
        if due_ns >= self.beats * period_ns {
            let sample = ControlSample::at(&mut rig.surgeon.motion, due_ns, self.beats, due_ns);
            rig.send_controls(&sample)?;
            self.beats = due_ns / period_ns + 1;
        }
        rig.shell.inject_delay();
        let (stream, next, start_ns) = (&self.stream, self.next, rig.timeline.start());
        self.next += 1;
        rig.send(|field| stream.field(next, start_ns, field))
    }
}

impl Source for Playback {
    /// One field at a time: a stream may hold many that are due at once.
    fn advance(&mut self, rig: &mut VirtualRigShell) -> Result<u64> {
        if let Some(due_ns) = self.due_ns(rig.duration_ns)
            && now() >= rig.timeline.instant(due_ns)
        {
            self.send(rig, due_ns)?;
        }
        self.due_ns(rig.duration_ns).map_or_else(|| rig.finish(0), Ok)
    }

    fn restart(&mut self) {
        (self.next, self.beats) = (0, 0);
    }
}
