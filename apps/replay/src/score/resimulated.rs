//! The score of what the simulation makes of a recording's poses, handles and pedal when it does every
//! step again.

use crate::resimulate::{steps, tell};
use anyhow::Context;
use outputs::exit::LOSS;
use recording::Recording;
use results::scored::{ScoredRecording, reader_of, score_file};
use simcore::world::World;
use std::ops::ControlFlow;
use std::path::Path;

/// Scores `file` as it comes out now.
///
/// # Errors
/// Where the simulation refuses the recording, or it holds no task.
pub fn score(file: &Path) -> anyhow::Result<ScoredRecording> {
    let recording = Recording::open(file)?;
    let (scene, mut reader) = reader_of(&recording)?;
    let refused = || format!("{}: not simulated again", file.display());
    let world = World::new(&scene).context("scene").with_context(refused)?.unseen();
    let done = steps(&recording, world, |again| {
        reader.take_poses(again.poses);
        again.world.events().iter().for_each(|event| reader.take_event(*event));
        reader.take_step(&again.step);
        Ok(ControlFlow::Continue(()))
    });
    let done = done.with_context(refused)?;
    let gaps = tell(file, &done) == LOSS;
    // The score of the live run stands in the recording; here is that of the new steps.
    let recorded = score_file(file)?;
    let scored = ScoredRecording::new(&recording, &scene, reader.finish(), recorded.seconds);
    let agrees = agrees_again(&recorded, scored.score.total);
    Ok(ScoredRecording {
        other_state_hash_version: recording.provenance().other_state_hash_version(),
        live_total: recorded.live_total,
        agrees,
        damage: recorded
            .damage
            .or_else(|| gaps.then(|| format!("{}: inputs of steps are missing", file.display()))),
        ..scored
    })
}

/// Whether new steps lead to the score that the live run published; `None` where that is of another
/// version of the score, or there is none.
fn agrees_again(recorded: &ScoredRecording, total: f64) -> Option<bool> {
    recorded.agrees.and(recorded.live_total).map(|live| live.to_bits() == total.to_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_of_another_version_neither_agrees_nor_differs() {
        let scene = surgeon::load("navigation").unwrap().level_scene(1).unwrap();
        let scorer = training::score::Scorer::of(&scene).unwrap();
        let score = scorer.score(&scorer.start());
        let told = |agrees| ScoredRecording {
            file: String::new(),
            module: String::new(),
            level: 1,
            ended: true,
            seconds: 1.0,
            unmatched: 0,
            live_total: Some(97.5),
            agrees,
            other_state_hash_version: None,
            damage: None,
            score: score.clone(),
        };
        assert_eq!(agrees_again(&told(Some(true)), 97.5), Some(true));
        assert_eq!(agrees_again(&told(Some(true)), 97.4), Some(false));
        assert_eq!(agrees_again(&told(None), 97.4), None);
    }
}
