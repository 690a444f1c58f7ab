//! A recording drawn again: what the simulation sent, one scene for each picture of a film.

use super::SceneShown;
use super::pictures::{Pictures, StepShown};
use crate::engine::{Streamed, stream};
use crate::resimulate::{scene_of, steps};
use crate::steps::Resimulated;
use anyhow::{Context, ensure};
use recording::{Recording, Source};
use rig::Rig;
use settings::commands::SpanArgs;
use simcore::world::World;
use std::ops::ControlFlow;

/// Does every step of a recording again and gives the scene of every 40 ms of `part` to `show`, until
/// that has enough. Where steps are missing the scene before them stands for them. The blobs of an imported
/// stream, which holds no steps, go through a tracker of `rig`.
///
/// # Errors
/// Where the recording holds no step in that part, or its scene cannot be simulated; those of `show`.
pub fn play(
    recording: &Recording,
    rig: &Rig,
    part: SpanArgs,
    show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Resimulated> {
    let world = World::new(&scene_of(recording)?).context("scene")?;
    let start = recording.exposures().next().unwrap_or(0);
    let mut pictures = Pictures::new(&world, start, part);
    let done = match recording.provenance().source {
        Source::Live => steps(recording, world, |again| pictures.take(&StepShown::of(&again), show))?,
        Source::Import => {
            let mut done = Resimulated::default();
            let damage = stream(recording, rig, world, |made| match made {
                Streamed::Field(..) => Ok(ControlFlow::Continue(())),
                Streamed::Frame { frame, world, report, .. } => {
                    done.steps += 1;
                    pictures.take(&StepShown::made_now(frame, world, report.state_hash), show)
                }
            })?;
            done.damage = damage.map(|damage| damage.to_string());
            done
        }
    };
    ensure!(pictures.has_shown(), "{}: contains no step to be drawn", recording.path().display());
    Ok(done)
}

#[cfg(test)]
mod tests {
    use super::super::pictures::{NEAR_NS, PICTURE_NS};
    use super::*;
    use protocol::geometry::Pose;
    use protocol::poses::{EYE, TrackerFrame};
    use protocol::scene::SceneHeader;
    use protocol::steps::{InputsDigest, StepRecord};
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
        let done =
            play(&Recording::open(file).unwrap(), &Rig::load_or_shipped(None).unwrap(), part, &mut show)
                .unwrap();
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
                // The digest of what it consumed is of the recorded exposures.
                Item::Step(s) => {
                    s.instants.exposed = later(s.instants.exposed, s.step);
                    *s = s.with_inputs(InputsDigest::default());
                }
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
    fn a_recording_without_steps_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("empty.mcap");
        let writer = Writer::create(&file, Recording::open(&golden()).unwrap().provenance()).unwrap();
        writer.finish().unwrap();
        let mut show = |_| unreachable!("there is nothing to show");
        let told = play(
            &Recording::open(&file).unwrap(),
            &Rig::load_or_shipped(None).unwrap(),
            SpanArgs::default(),
            &mut show,
        );
        let told = told.unwrap_err().to_string();
        assert!(told.contains("empty.mcap") && told.contains("no step"), "{told}");
    }
}
