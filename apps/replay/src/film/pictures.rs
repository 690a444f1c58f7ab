//! The pictures of a recording: one scene for each 40 ms of it, whatever the distance of its steps.

use super::SceneShown;
use crate::blocks::Blocks;
use crate::steps::StepAgain;
use anyhow::ensure;
use protocol::poses::TrackerFrame;
use protocol::time::{Instants, Nanos};
use settings::commands::SpanArgs;
use simcore::world::World;
use std::ops::ControlFlow;

/// Time from one picture to the next, ns.
pub const PICTURE_NS: Nanos = 40_000_000;
/// How far a step's exposure may lie from the instant of a picture that shows it, ns.
pub const NEAR_NS: Nanos = PICTURE_NS / 4;
/// Longest time without a step for which a picture stands, ns; instants that lie farther apart are no
/// film.
const LONGEST_STAND_NS: Nanos = 3_600_000_000_000;

/// A step of which a picture can be made.
pub struct StepShown<'a> {
    /// The world after it.
    pub world: &'a World,
    /// Its number.
    pub step: u64,
    /// Its instants; `exposed` says which picture shows it.
    pub instants: Instants,
    /// Hash of the world's state.
    pub state_hash: u64,
    /// The poses of the instruments and the eye in the picture.
    pub poses: &'a TrackerFrame,
}

impl<'a> StepShown<'a> {
    /// A recorded step, with the recorded poses.
    pub fn of(again: &'a StepAgain<'a>) -> Self {
        let (step, instants, state_hash) = (again.step.step, again.step.instants, again.step.state_hash);
        StepShown { world: again.world, step, instants, state_hash, poses: &again.poses }
    }

    /// A recorded step, with the poses that this tracker makes, where one does.
    pub fn again(again: &'a StepAgain<'a>) -> Self {
        let poses = again.made.as_deref().unwrap_or(&again.poses);
        StepShown { poses, ..Self::of(again) }
    }

    /// A step that was never recorded, made of `poses`.
    pub fn made_now(poses: &'a TrackerFrame, world: &'a World, state_hash: u64) -> Self {
        StepShown { world, step: world.state().step, instants: poses.instants, state_hash, poses }
    }
}

/// The pictures of a recording, one after the other.
pub struct Pictures {
    blocks: Blocks,
    /// Instant of the next picture.
    next: Nanos,
    /// Instant of the last one at the latest.
    end: Nanos,
    last_step: Option<u64>,
    shown: Option<SceneShown>,
}

impl Pictures {
    /// Of a part of a recording that begins at `start`, ns.
    pub fn new(world: &World, start: Nanos, part: SpanArgs) -> Self {
        let at = |s: f64| start.saturating_add((s * 1e9) as Nanos);
        Pictures {
            blocks: Blocks::new(world),
            next: at(part.from),
            end: part.until.map_or(Nanos::MAX, at),
            last_step: None,
            shown: None,
        }
    }

    /// Whether there was a picture yet.
    pub fn has_shown(&self) -> bool {
        self.shown.is_some()
    }

    /// Gives the scene of a step to `show` if there is a picture of it; before it those of pictures for which
    /// there was no step.
    ///
    /// # Errors
    /// Where the step lies so far behind the one before that this is no film; those of `show`.
    pub fn take(
        &mut self,
        step: &StepShown<'_>,
        show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<ControlFlow<()>> {
        let follows = self.last_step.is_none_or(|last| step.step == last + 1);
        self.last_step = Some(step.step);
        if !follows {
            self.blocks.forget();
        }
        let exposed = step.instants.exposed;
        if self.shown.is_none() {
            self.next = first_picture(self.next, exposed);
        }
        let stands_ns = exposed.min(self.end).saturating_sub(self.next);
        ensure!(
            self.shown.is_none() || stands_ns <= LONGEST_STAND_NS,
            "step {}: {} s after the previous step; skip the gap with --from or --until",
            step.step,
            stands_ns / 1_000_000_000
        );
        while self.shown.is_some() && self.next.saturating_add(NEAR_NS) < exposed && self.next <= self.end {
            if self.put(show)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        if self.next > self.end {
            return Ok(ControlFlow::Break(()));
        }
        if self.next <= exposed.saturating_add(NEAR_NS) {
            let (header, payload) = self.blocks.make(step.world, step.instants, step.state_hash);
            let (poses, payload) = (Box::new(*step.poses), payload.to_vec());
            self.shown = Some(SceneShown { header, poses, payload });
            return self.put(show);
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Gives what is shown as the next picture.
    fn put(
        &mut self,
        show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<ControlFlow<()>> {
        let Some(shown) = &self.shown else { return Ok(ControlFlow::Continue(())) };
        self.next += PICTURE_NS;
        show(shown.clone())
    }
}

/// Instant of the first picture that a film can show, which was to begin at `next` and whose first step was
/// exposed at `exposed`: no scene stands for what comes before.
fn first_picture(next: Nanos, exposed: Nanos) -> Nanos {
    let missing = exposed.saturating_sub(next.saturating_add(NEAR_NS)).div_ceil(PICTURE_NS);
    next.saturating_add(missing.saturating_mul(PICTURE_NS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_whose_beginning_is_missing_begins_with_its_first_step() {
        assert_eq!(first_picture(100, 100), 100);
        assert_eq!(first_picture(100, 100 + NEAR_NS), 100, "the picture that shows it");
        assert_eq!(first_picture(5 * PICTURE_NS, PICTURE_NS), 5 * PICTURE_NS, "it is yet to come");
        for exposed in [2_416_000_000_123, 2_416_000_000_000, PICTURE_NS + NEAR_NS + 1] {
            let first = first_picture(0, exposed);
            assert!(
                first.is_multiple_of(PICTURE_NS)
                    && first + NEAR_NS >= exposed
                    && first < exposed + PICTURE_NS
            );
        }
        first_picture(0, Nanos::MAX);
    }
}
