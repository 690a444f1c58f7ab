//! A frame on the device: its commands and their completion.

use super::RendererShell;
use crate::latch::Latched;
use crate::timing::PassTimes;
use anyhow::Result;
use ipc::clock::now;
use ipc::trace::About;
use protocol::phases::Phase;
use protocol::time::Nanos;
use wgpu::CommandBuffer;

/// Instants of a frame that the device has drawn.
pub(super) struct Drawn {
    /// When this process knew that it was.
    pub(super) done: Nanos,
    /// Its times, by the device's clock if available.
    pub(super) drawn: Nanos,
    /// Time of the calls that upload the tissue, ns.
    pub(super) transfer_ns: u64,
    /// The device has timestamps.
    pub(super) stamped: bool,
}

impl RendererShell {
    /// Records the passes of a frame, each as a phase of the field of its scene where that is traced.
    pub(super) fn encode(&mut self, tier: usize, of_scene: About) -> CommandBuffer {
        match self.shell.trace.laps(of_scene) {
            Some(mut laps) => self.renderer.encode_in_phases(&self.gpu, tier, &mut laps),
            None => self.renderer.encode(&self.gpu, tier),
        }
    }

    /// Submits the commands for the latched pose and waits for the device.
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

    /// Records the device's timeline of a frame.
    fn note_passes(&mut self, about: About, times: &PassTimes, frame: [Nanos; 2]) {
        let passes = [Phase::GpuShadow, Phase::GpuPicture, Phase::GpuFocus];
        for (phase, from_to) in passes.into_iter().zip(times.on_processor_clock(frame)) {
            from_to.into_iter().for_each(|from_to| self.shell.trace.note(phase, about, from_to));
        }
    }
}
