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
use std::ops::ControlFlow;

/// Tier of the pictures where no other one is asked for.
const TIER: u32 = 0;

/// A film of what a replay makes.
pub struct Screen {
    drawing: Drawing,
    pictures: Pictures,
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
        })
    }

    /// Shows a recorded step.
    ///
    /// # Errors
    /// Where it lies too far behind the one before.
    pub fn step(&mut self, again: &StepAgain<'_>) -> anyhow::Result<ControlFlow<()>> {
        show(&mut self.pictures, &self.drawing, &StepShown::again(again))
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
