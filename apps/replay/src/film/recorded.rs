//! A recording drawn again: what the simulation sent, one scene for each picture of a film.

use super::SceneShown;
use crate::blocks::Blocks;
use crate::resimulate::{scene_of, steps};
use crate::steps::{Resimulated, StepAgain};
use anyhow::{Context, ensure};
use protocol::limits::FIELD_PERIOD_NS;
use protocol::time::Nanos;
use recording::Recording;
use settings::commands::SpanArgs;
use simcore::world::World;
use std::ops::ControlFlow;

/// Time from one picture to the next, ns.
pub const PICTURE_NS: Nanos = 40_000_000;
/// How far a step's exposure may lie from the instant of a picture that shows it, ns.
const NEAR_NS: Nanos = FIELD_PERIOD_NS / 2;
/// Longest time without a step for which a picture stands, ns; instants that lie farther apart are no
/// film.
const LONGEST_STAND_NS: Nanos = 3_600_000_000_000;

/// Does every step of a recording again and gives the scene of every 40 ms of `part` to `show`, until
/// that has enough. Where steps are missing the scene before them stands for them.
///
/// # Errors
/// Where the recording holds no step in that part, or its scene cannot be simulated; those of `show`.
pub fn play(
    recording: &Recording,
    part: SpanArgs,
    show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Resimulated> {
    let world = World::new(&scene_of(recording)?).context("scene")?;
    let start = recording.exposures().next().unwrap_or(0);
    let at = |s: f64| start.saturating_add((s * 1e9) as Nanos);
    let mut pictures = Pictures {
        blocks: Blocks::new(&world),
        next: at(part.from),
        end: part.until.map_or(Nanos::MAX, at),
        last_step: None,
        shown: None,
        show,
    };
    let done = steps(recording, world, |again| pictures.take(&again))?;
    ensure!(pictures.shown.is_some(), "{}: holds no step to be drawn", recording.path().display());
    Ok(done)
}

/// The pictures of a recording, one after the other.
struct Pictures<'a, F> {
    blocks: Blocks,
    /// Instant of the next picture.
    next: Nanos,
    /// Instant of the last one at the latest.
    end: Nanos,
    last_step: Option<u64>,
    shown: Option<SceneShown>,
    show: &'a mut F,
}

impl<F: FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>> Pictures<'_, F> {
    /// Shows the scene of a step if there is a picture of it; before it those of pictures for which
    /// there was no step.
    fn take(&mut self, again: &StepAgain<'_>) -> anyhow::Result<ControlFlow<()>> {
        let follows = self.last_step.is_none_or(|last| again.step.step == last + 1);
        self.last_step = Some(again.step.step);
        if !follows {
            self.blocks.forget();
        }
        let exposed = again.step.instants.exposed;
        if self.shown.is_none() {
            self.next = first_picture(self.next, exposed);
        }
        let stands_ns = exposed.min(self.end).saturating_sub(self.next);
        ensure!(
            self.shown.is_none() || stands_ns <= LONGEST_STAND_NS,
            "step {}: {} s after the step before; --from or --until leaves that out",
            again.step.step,
            stands_ns / 1_000_000_000
        );
        while self.shown.is_some() && self.next.saturating_add(NEAR_NS) < exposed && self.next <= self.end {
            if self.put()?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        if self.next > self.end {
            return Ok(ControlFlow::Break(()));
        }
        if self.next <= exposed.saturating_add(NEAR_NS) {
            let (header, payload) = self.blocks.make(again.world, again.step.instants, again.step.state_hash);
            let (poses, payload) = (again.poses.clone(), payload.to_vec());
            self.shown = Some(SceneShown { header, poses, payload });
            return self.put();
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Gives what is shown as the next picture.
    fn put(&mut self) -> anyhow::Result<ControlFlow<()>> {
        let Some(shown) = &self.shown else { return Ok(ControlFlow::Continue(())) };
        self.next += PICTURE_NS;
        (self.show)(shown.clone())
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
    use protocol::geometry::Pose;
    use protocol::poses::{EYE, TrackerFrame};
    use protocol::scene::SceneHeader;
    use protocol::steps::StepRecord;
    use recording::{Item, Writer};
    use std::path::{Path, PathBuf};

    fn golden() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
    }

    /// What the recording says of each step.
    fn recorded(file: &Path) -> Vec<StepRecord> {
        let items = Recording::open(file).unwrap().items_of(&["steps"]);
        let step = |item| if let (_, Item::Step(step)) = item { step } else { unreachable!("steps only") };
        items.map(|item| step(item.unwrap())).collect()
    }

    fn poses(file: &Path) -> Vec<TrackerFrame> {
        let items = Recording::open(file).unwrap().items_of(&["poses"]);
        let pose = |item| if let (_, Item::Poses(pose)) = item { *pose } else { unreachable!("poses only") };
        items.map(|item| pose(item.unwrap())).collect()
    }

    /// Header and poses of every scene.
    fn scenes(file: &Path, part: SpanArgs) -> (Resimulated, Vec<(SceneHeader, TrackerFrame)>) {
        let mut scenes = Vec::new();
        let mut show = |shown: SceneShown| {
            scenes.push((shown.header, *shown.poses));
            Ok(ControlFlow::Continue(()))
        };
        let done = play(&Recording::open(file).unwrap(), part, &mut show).unwrap();
        (done, scenes)
    }

    #[test]
    fn what_is_drawn_is_what_was_recorded() {
        let (steps, frames) = (recorded(&golden()), poses(&golden()));
        let (done, scenes) = scenes(&golden(), SpanArgs::default());
        assert_eq!((done.differs_at, done.has_gaps(), done.steps), (None, false, steps.len() as u64));
        let span_ns = steps.last().unwrap().instants.exposed - frames[0].instants.exposed;
        assert!((scenes.len() as u64).abs_diff(span_ns / PICTURE_NS + 1) <= 1, "{} pictures", scenes.len());
        for (number, (header, poses)) in scenes.iter().enumerate() {
            let step = steps.iter().find(|s| s.step == header.step).expect("a recorded step");
            assert_eq!((header.state_hash, header.field), (step.state_hash, step.field));
            assert_eq!(header.instants, step.instants);
            let frame = frames.iter().find(|f| f.frame == step.frame).expect("its poses");
            assert_eq!(bytemuck::bytes_of(poses), bytemuck::bytes_of(frame), "poses as they were recorded");
            let eye = Pose::from_isometry(&frame.bodies[EYE].world_from_body.isometry());
            assert_eq!(header.world_from_eye, eye, "normalised, as the simulation has it");
            let instant = frames[0].instants.exposed + number as u64 * PICTURE_NS;
            assert!(step.instants.exposed.abs_diff(instant) <= NEAR_NS, "picture {number}");
        }
    }

    #[test]
    fn a_part_begins_and_ends_where_it_was_asked_to() {
        let all = scenes(&golden(), SpanArgs::default()).1;
        let (done, part) = scenes(&golden(), SpanArgs { from: 0.4, until: Some(0.8) });
        let steps = |scenes: &[(SceneHeader, TrackerFrame)]| -> Vec<(u64, u64)> {
            scenes.iter().map(|(header, _)| (header.step, header.state_hash)).collect()
        };
        assert_eq!(steps(&part), steps(&all[10..21]));
        assert!(done.steps < recorded(&golden()).len() as u64, "what comes later is not simulated");
    }

    #[test]
    fn a_picture_stands_where_steps_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.mcap");
        let mut writer = Writer::create(&file, Recording::open(&golden()).unwrap().provenance()).unwrap();
        // From step 20 on everything is half a second later.
        let later = |at: u64, step: u64| if step >= 20 { at + 500_000_000 } else { at };
        let of_frame =
            |frame: u64| recorded(&golden()).iter().find(|s| s.frame == frame).map_or(0, |s| s.step);
        for item in Recording::open(&golden()).unwrap().items_of(&["poses", "handles", "pedal", "steps"]) {
            let (at, mut item) = item.unwrap();
            match &mut item {
                Item::Poses(f) => f.instants.exposed = later(f.instants.exposed, of_frame(f.frame)),
                Item::Step(s) => s.instants.exposed = later(s.instants.exposed, s.step),
                _ => {}
            }
            writer.write(at, &item).unwrap();
        }
        writer.finish().unwrap();
        let usual = scenes(&golden(), SpanArgs::default()).1.len();
        let (_, scenes) = scenes(&file, SpanArgs::default());
        let steps: Vec<u64> = scenes.iter().map(|(header, _)| header.step).collect();
        let stands = steps.iter().filter(|s| **s == steps[9]).count();
        assert!(steps.is_sorted() && (11..15).contains(&stands), "{steps:?}");
        assert!((12..=13).contains(&(steps.len() - usual)), "half a second more: {steps:?}");
    }

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

    #[test]
    fn a_recording_without_steps_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("empty.mcap");
        let writer = Writer::create(&file, Recording::open(&golden()).unwrap().provenance()).unwrap();
        writer.finish().unwrap();
        let mut show = |_| unreachable!("there is nothing to show");
        let told = play(&Recording::open(&file).unwrap(), SpanArgs::default(), &mut show);
        let told = told.unwrap_err().to_string();
        assert!(told.contains("empty.mcap") && told.contains("no step"), "{told}");
    }
}
