//! Both recordings at one instant, each simulated to it and drawn off-screen, as pictures for a page.

use super::instant::Instant;
use crate::blocks::Blocks;
use crate::film::{SceneShown, recorded};
use crate::resimulate::scene_of;
use crate::timeline::player::Player;
use crate::timeline::{Target, Timeline};
use anyhow::{Context, bail};
use outputs::Outputs;
use outputs::progress::pictures_bar;
use protocol::time::Nanos;
use recording::{Recording, Source};
use renderer::film::{Film, FilmConfig};
use rig::Rig;
use settings::commands::{Arrangement, SpanArgs};
use simcore::world::World;
use std::ops::ControlFlow;
use std::path::Path;

/// Tier of the pictures: what every adapter draws, software too.
const TIER: usize = 3;
/// Bytes of a picture at most, where its quality allows.
const BYTES: usize = 200_000;
/// How long before an instant a stream is drawn that has no checkpoints, s.
const BEFORE_S: f64 = 0.1;

/// A picture of a recording, or why there is none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Drawn {
    /// JPEG.
    Jpeg {
        /// The file's bytes.
        bytes: Vec<u8>,
        /// What is to be known of it.
        note: Option<String>,
    },
    /// Why it cannot be drawn.
    Not(String),
}

/// Both recordings at an instant, drawn.
pub fn both(a: &Path, b: &Path, at: &Instant) -> [Drawn; 2] {
    let bar = pictures_bar(2, "pictures");
    let drawn = [0, 1].map(|side| {
        let drawn = draw([a, b][side], at.exposed_ns[side], at.at_s[side]);
        bar.inc(1);
        drawn.unwrap_or_else(|problem| Drawn::Not(format!("{problem:#}")))
    });
    bar.finish_and_clear();
    drawn
}

fn draw(file: &Path, exposed_ns: Nanos, at_s: f64) -> anyhow::Result<Drawn> {
    let recording = Recording::open(file)?;
    let provenance = recording.provenance();
    if provenance.scene_toml.trim().is_empty() {
        bail!("it was recorded without a scene");
    }
    // A stream has no states.
    if let (Source::Live, Some(version)) = (provenance.source, provenance.other_state_hash_version()) {
        bail!("its states are of another build (version {version}): this one would simulate another eye");
    }
    let rig = Rig::parse(&provenance.rig_json, "of the recording")?;
    let (shown, note) = match provenance.source {
        Source::Live => simulated(&recording, exposed_ns)?,
        Source::Import => (streamed(&recording, &rig, at_s)?, Some("as this build tracks its blobs".into())),
    };
    let config = FilmConfig { tier: TIER, arrangement: Arrangement::Left, ..FilmConfig::default() };
    let mut film = Film::begin(config, Outputs::new(false), &scene_of(&recording)?, &rig)?;
    let bytes = film.picture_of(&shown.header, &shown.poses, &shown.payload, BYTES)?;
    Ok(Drawn::Jpeg { bytes, note })
}

/// A run at the instant, from its recorded poses; and what is to be known of it.
fn simulated(recording: &Recording, exposed_ns: Nanos) -> anyhow::Result<(SceneShown, Option<String>)> {
    let world = World::new(&scene_of(recording)?).context("scene")?;
    let mut player = Player::as_recorded(Timeline::open(recording)?, world)?;
    let arrival = player.seek(Target::Exposed(exposed_ns))?;
    let at = arrival.at.context("no recorded step at that time or later")?;
    let last = player.last().context("a step")?;
    let (instants, state_hash) = (last.record.instants, last.record.state_hash);
    let mut blocks = Blocks::new(player.world());
    let (header, payload) = blocks.make(player.world(), instants, state_hash);
    let shown = SceneShown { header, poses: Box::new(last.poses), payload: payload.to_vec() };
    let late_s = at.exposed_ns.saturating_sub(exposed_ns) as f64 * 1e-9;
    let notes = [
        (late_s > 0.1).then(|| format!("{late_s:.2} s later, where its next step is")),
        arrival.lost.map(|lost| format!("the recording has a gap before it: {lost}")),
        (player.run().steps.done.differs_at.is_some())
            .then(|| "the simulated state differs from the recorded one".into()),
    ];
    let notes: Vec<String> = notes.into_iter().flatten().collect();
    Ok((shown, (!notes.is_empty()).then(|| notes.join("; "))))
}

/// A stream at the instant: it is tracked and simulated from its beginning.
fn streamed(recording: &Recording, rig: &Rig, at_s: f64) -> anyhow::Result<SceneShown> {
    let part = SpanArgs { from: (at_s - BEFORE_S).max(0.0), until: Some(at_s) };
    let mut last = None;
    recorded::play(recording, rig, part, &mut |shown| {
        last = Some(shown);
        Ok(ControlFlow::Continue(()))
    })?;
    last.context("no step at that time")
}
