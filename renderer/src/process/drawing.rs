//! Drawing a frame on the device: its commands and their completion.

use super::RendererShell;
use crate::latch::Latched;
use crate::timing::PassTimes;
use anyhow::Result;
use ipc::clock::now;
use ipc::trace::About;
use protocol::phases::Phase;
use protocol::time::Nanos;
use wgpu::CommandBuffer;

/// Timestamps of a drawn frame.
pub(super) struct Drawn {
    /// Time at which this process was notified of the completion, ns.
    pub(super) done: Nanos,
    /// Time of the completion, ns of `CLOCK_MONOTONIC`; from the device's clock if it has one.
    pub(super) drawn: Nanos,
    /// Duration of the calls that upload the tissue, ns.
    pub(super) transfer_ns: u64,
    /// True if the device has timestamps.
    pub(super) stamped: bool,
}

impl RendererShell {
    /// Records the commands of a frame's passes. If tracing is on, each pass is traced as a phase of the
    /// scene's field.
    pub(super) fn encode(&mut self, tier: usize, of_scene: About) -> CommandBuffer {
        match self.shell.trace.laps(of_scene) {
            Some(mut laps) => self.renderer.encode_in_phases(&self.gpu, tier, &mut laps),
            None => self.renderer.encode(&self.gpu, tier),
        }
    }

    /// Submits the commands with the latched pose, and waits for the device.
    pub(super) fn draw(
        &mut self,
        tier: usize,
        latched: &Latched,
        commands: CommandBuffer,
        latched_at: Nanos,
    ) -> Result<Drawn> {
        let (about, begun) = (About::field(latched.field), self.shell.trace.begin());
        let transfer_ns = self.renderer.submit_timed(&self.gpu, tier, latched, [commands], &mut now);
        self.present.copy(&self.gpu, self.renderer.target(tier), self.renderer.text());
        let submitted = self.shell.trace.end(Phase::Submit, about, begun);
        self.gpu.wait()?;
        let done = now();
        self.shell.trace.note(Phase::Draw, about, [submitted, done]);
        let stamped = self.renderer.pass_times();
        let drawn = stamped.map_or(done, |times| self.clock.finished_at(latched_at, times.whole, done));
        if let Some(times) = stamped {
            self.note_passes(about, &times, [latched_at, drawn]);
        }
        Ok(Drawn { done, drawn, transfer_ns, stamped: stamped.is_some() })
    }

    /// Traces the passes of a frame on the device.
    fn note_passes(&mut self, about: About, times: &PassTimes, frame: [Nanos; 2]) {
        let passes = [Phase::GpuShadow, Phase::GpuPicture, Phase::GpuFocus];
        for (phase, from_to) in passes.into_iter().zip(times.on_processor_clock(frame)) {
            from_to.into_iter().for_each(|from_to| self.shell.trace.note(phase, about, from_to));
        }
    }
}
