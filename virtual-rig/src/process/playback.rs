//! Playback of a recorded stream of blobs with the script's controls.

use super::controls::ControlSample;
use super::{VirtualRigShell, Wake};
use crate::playback::BlobPlayback;
use anyhow::Result;
use bytemuck::Zeroable;
use protocol::blobs::BlobField;

impl VirtualRigShell {
    /// Plays a recorded stream of blobs, then reports the end.
    pub(super) fn play(&mut self, playback: &BlobPlayback) -> Result<()> {
        let mut field = BlobField::zeroed();
        let (mut i, mut beats) = (0, 0);
        let period_ns = self.rig.field_period_ns();
        loop {
            let over = i == playback.count() || playback.due_ns(i) >= self.duration_ns;
            let wake = if over { self.finish(0)? } else { self.wait_for(playback.due_ns(i))? };
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    (i, beats) = (0, 0);
                    continue;
                }
                Wake::Due => {}
            }
            // The stream has no controls: those of the script are sent once a field period.
            let elapsed = playback.due_ns(i);
            if elapsed >= beats * period_ns {
                let sample = ControlSample::at(&mut self.surgeon.motion, elapsed, beats, elapsed);
                self.controls.send(&sample)?;
                beats = elapsed / period_ns + 1;
            }
            playback.field(i, self.timeline.start(), &mut field);
            self.shell.inject_delay();
            self.send(&mut field)?;
            i += 1;
        }
    }
}
