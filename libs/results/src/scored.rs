//! The score of a recording, without simulating again.

use anyhow::{Context, bail};
use recording::{Item, Recording};
use scene::SceneFile;
use serde::Serialize;
use std::path::Path;
use training::score::recording::{LiveScore, Reader, Verdict};
use training::score::table::Category;

/// A scored recording as programs read it.
#[derive(Debug, Clone, Serialize)]
pub struct ScoredRecording {
    /// The recording.
    pub file: String,
    /// Module of its scene.
    pub module: String,
    /// Level.
    pub level: u32,
    /// The attempt ended in the recording; else it is scored as far as it went.
    pub ended: bool,
    /// Time that passes in the recording, s.
    pub seconds: f64,
    /// Steps whose poses the recording misses.
    pub unmatched: u64,
    /// The score that the live run published, if it did.
    pub live_total: Option<f64>,
    /// Whether that is the same to the bit; `None` where the run published none, or by another
    /// version of the score.
    pub agrees: Option<bool>,
    /// Version of the recording's state hashes where it is not this build's, so that states could
    /// not be compared; only where it was resimulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_state_hash_version: Option<u32>,
    /// What the recording's damage is, if it has some; the score is that of what comes before, or
    /// where it was resimulated of all that could be.
    pub damage: Option<String>,
    /// The score.
    #[serde(flatten)]
    pub score: training::score::Score,
}

impl ScoredRecording {
    /// What came of the steps of `recording`, which takes so many seconds.
    pub fn new(recording: &Recording, scene: &SceneFile, verdict: Verdict, seconds: f64) -> Self {
        let task = scene.task.as_ref();
        ScoredRecording {
            file: recording.path().display().to_string(),
            module: task.map(|task| task.module.clone()).unwrap_or_default(),
            level: task.map_or(0, |task| task.level),
            ended: verdict.ended,
            seconds,
            unmatched: verdict.unmatched,
            live_total: verdict.live.total.map(|(points, _)| points),
            agrees: verdict.agrees(),
            other_state_hash_version: None,
            damage: None,
            score: verdict.score,
        }
    }
}

/// The scene of a recording, and what scores its task.
///
/// # Errors
/// Where the scene is refused or has no task.
pub fn reader_of(recording: &Recording) -> anyhow::Result<(SceneFile, Reader)> {
    let name = recording.path().display();
    let scene =
        SceneFile::parse(&recording.provenance().scene_toml, &name.to_string()).context("its scene")?;
    match Reader::new(&scene) {
        Some(reader) => Ok((scene, reader)),
        None => {
            bail!("{name}: its scene '{}' has no task: nothing to score", recording.provenance().scene_name)
        }
    }
}

/// Scores a recording. Damage ends it early and is reported; a recording without a task is an
/// error.
///
/// # Errors
/// Where the file is no recording, or holds no task.
pub fn score_file(file: &Path) -> anyhow::Result<ScoredRecording> {
    let recording = Recording::open(file)?;
    let (scene, mut reader) = reader_of(&recording)?;
    let (mut damage, mut span) = (None, [u64::MAX, 0]);
    for item in recording.items_of(&Reader::TOPICS) {
        match item {
            Ok((at, item)) => {
                span = [span[0].min(at), span[1].max(at)];
                take(&mut reader, item);
            }
            Err(problem) => {
                damage = Some(problem.to_string());
                break;
            }
        }
    }
    let seconds = span[1].saturating_sub(span[0]) as f64 * 1e-9;
    Ok(ScoredRecording { damage, ..ScoredRecording::new(&recording, &scene, reader.finish(), seconds) })
}

/// Gives a recording's item to the score.
fn take(reader: &mut Reader, item: Item) {
    match item {
        Item::Poses(frame) => reader.take_poses(frame),
        Item::Event(event) => reader.take_event(event),
        Item::Step(step) => reader.take_step(&step),
        _ => {}
    }
}

/// The score of the live run, in words; empty where there was no task or no end of it.
pub fn live_text(live: &LiveScore) -> String {
    use std::fmt::Write;
    let Some((total, sigma)) = live.total else { return String::new() };
    let mut out = format!("score {total:.2} ± {sigma:.2} of 100 (version {})\n", live.version);
    for category in Category::ALL {
        if let Some(points) = live.categories[category as usize] {
            let _ = writeln!(out, "  {:<22} {points:>7.2} of {:>5.1}", category.name(), category.points());
        }
    }
    out
}
