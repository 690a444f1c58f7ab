//! The picture of a replay: a film and stills of it, drawn on another thread.

use crate::film::{Drawing, Pictures, StepShown, film_config};
use crate::steps::StepAgain;
use outputs::Outputs;
use protocol::poses::TrackerFrame;
use recording::Recording;
use rig::Rig;
use scene::SceneFile;
use settings::commands::ReplayArgs;
use simcore::world::World;
use std::collections::VecDeque;
use std::ops::ControlFlow;

/// Tier of the pictures where no other one is asked for.
const TIER: u32 = 0;
/// Frames kept for steps to come; a step follows its frame within half a second.
const FRAMES: usize = 64;

/// A film of what a replay makes.
pub struct Screen {
    drawing: Drawing,
    pictures: Pictures,
    /// The newest frames, which steps consumed in their recorded form.
    frames: VecDeque<TrackerFrame>,
}

impl Screen {
    /// Begins what `args` ask for, of `recording` whose scene is `scene`; `outputs` has their claims.
    ///
    /// # Errors
    /// Where the pictures cannot be drawn.
    pub fn begin(
        args: &ReplayArgs,
        recording: &Recording,
        (scene, world): (&SceneFile, &World),
        rig: &Rig,
        outputs: Outputs,
    ) -> anyhow::Result<Self> {
        let config = film_config(&args.drawing, args.video.clone(), args.span.from, TIER);
        let length_s = args.span.length_s(recording.exposed_s());
        let start = recording.exposures().next().unwrap_or(0);
        Ok(Screen {
            drawing: Drawing::begin(config, outputs, scene, rig, length_s)?,
            pictures: Pictures::new(world, start, args.span),
            frames: VecDeque::with_capacity(FRAMES),
        })
    }

    /// Takes a frame that the tracker made: a picture of its step shows its poses.
    pub fn frame(&mut self, made: &TrackerFrame) {
        if self.frames.len() == FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(*made);
    }

    /// Shows a recorded step.
    ///
    /// # Errors
    /// Where it lies too far behind the one before.
    pub fn step(&mut self, again: &StepAgain<'_>) -> anyhow::Result<ControlFlow<()>> {
        let made = self.frames.iter().rfind(|frame| frame.frame == again.poses.frame);
        let step = StepShown { poses: made.unwrap_or(&again.poses), ..StepShown::of(again) };
        show(&mut self.pictures, &self.drawing, &step)
    }

    /// Shows a step of an imported stream.
    ///
    /// # Errors
    /// As [`Screen::step`].
    pub fn streamed(
        &mut self,
        frame: &TrackerFrame,
        world: &World,
        state_hash: u64,
    ) -> anyhow::Result<ControlFlow<()>> {
        show(&mut self.pictures, &self.drawing, &StepShown::made_now(frame, world, state_hash))
    }

    /// Closes the film; how many pictures there are.
    ///
    /// # Errors
    /// Where one could not be drawn or written.
    pub fn finish(self) -> anyhow::Result<u64> {
        self.drawing.finish()
    }
}

/// Draws a step, if there is a picture of it. Breaks where nothing can be drawn any more, not where the part
/// that is drawn is over: the rest of the replay has its own end.
fn show(pictures: &mut Pictures, drawing: &Drawing, step: &StepShown<'_>) -> anyhow::Result<ControlFlow<()>> {
    let mut flow = ControlFlow::Continue(());
    let _ = pictures.take(step, &mut |shown| {
        flow = drawing.show(shown);
        Ok(flow)
    })?;
    Ok(flow)
}
