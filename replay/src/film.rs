//! A scene's script played without cameras and without a clock, field by field, and what the
//! simulation sends of it: for films and for pictures of a moment.

use crate::blocks::Blocks;
use crate::perception::perform;
use anyhow::Context;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::scene_stream;
use protocol::time::Instants;
use scene::SceneFile;
use simcore::world::{World, WorldError};
use std::io::Write;
use surgeon::rehearsal::Rehearsal;
use training::score::recording::is_over;

/// Steps a second of the script.
pub const FIELDS_PER_S: f64 = 50.0;
/// The end screen of an attempt stands for so long, s.
const END_SCREEN_S: f64 = 3.0;

/// A scene that is being played.
#[derive(Debug)]
pub struct Film {
    rehearsal: Rehearsal,
    world: World,
    blocks: Blocks,
    field: u64,
    /// Poses of the field before, and the hash of the state that they led to.
    last: Option<(Box<TrackerFrame>, u64)>,
}

impl Film {
    /// The beginning of a scene. With a seed the surgeon's tips shake as the script says.
    pub fn begin(scene: &SceneFile, seed: Option<u64>) -> Result<Self, WorldError> {
        let mut rehearsal = Rehearsal::shipped(scene);
        if let Some(seed) = seed {
            rehearsal = rehearsal.with_tremor(seed);
        }
        let world = World::new(scene)?;
        Ok(Film { rehearsal, blocks: Blocks::new(&world), world, field: 0, last: None })
    }

    /// Fields of the script's round.
    pub fn fields(&self) -> u64 {
        self.rehearsal.fields()
    }

    /// The last field of a film that is at most so long, as far as is known by now: an attempt's
    /// ends with its end screen.
    fn last_field(&self, seconds: Option<f64>, over_since: Option<u64>) -> u64 {
        let end_screen = (END_SCREEN_S * FIELDS_PER_S) as u64;
        let round = match self.world.task() {
            Some(_) => over_since.unwrap_or(self.fields()) + end_screen,
            None if seconds.is_some() => u64::MAX,
            None => self.fields(),
        };
        seconds.map_or(round, |s| round.min((s * FIELDS_PER_S) as u64))
    }

    /// Plays on until `field` fields after the beginning.
    pub fn play_to(&mut self, field: u64) {
        while self.field < field {
            let (poses, report) = perform(&mut self.rehearsal, &mut self.world, self.field);
            self.last = Some((poses, report.state_hash));
            self.field += 1;
        }
    }

    /// What the simulation sends now: header and payload.
    pub fn scene(&mut self) -> (SceneHeader, &[u8]) {
        // Instants of 0 mean "not yet".
        let exposed = self.world.state().exposed_ns.max(1);
        let instants = Instants { exposed, ..bytemuck::Zeroable::zeroed() };
        let state_hash = self.last.as_ref().map_or(0, |(_, hash)| *hash);
        self.blocks.make(&self.world, instants, state_hash)
    }
}

/// Writes the scene of every `every`-th field, from the first on: an attempt at a task until its
/// end screen, else a round of the script, or for `seconds`, whatever the script; how many.
pub fn write(
    scene: &SceneFile,
    seed: Option<u64>,
    every: u64,
    seconds: Option<f64>,
    out: &mut impl Write,
) -> anyhow::Result<u64> {
    let mut film = Film::begin(scene, seed).context("scene")?;
    scene_stream::begin(out)?;
    let (mut field, mut written, mut over) = (0, 0, None);
    while field <= film.last_field(seconds, over) {
        // Before the first step no instrument has been seen.
        film.play_to(field + 1);
        over = over.or_else(|| film.world.task().is_some_and(|(_, s)| is_over(s)).then_some(field));
        let (poses, _) = film.last.clone().expect("a step was made");
        let (header, payload) = film.scene();
        scene_stream::write(out, &header, &poses, payload)?;
        written += 1;
        field += every.max(1);
    }
    out.flush()?;
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_is_as_long_as_asked_or_as_the_script() {
        let scene = SceneFile::load("peel").unwrap();
        let mut bytes = Vec::new();
        assert_eq!(write(&scene, Some(3), 10, Some(1.0), &mut bytes).unwrap(), 6);
        let mut reader = scene_stream::Reader::new(&bytes[..]).unwrap();
        let mut steps = Vec::new();
        while let Some(scene) = reader.next_scene().unwrap() {
            steps.push(scene.header.step);
            assert_eq!(scene.header.instants.exposed, scene.poses.instants.exposed);
            assert!(scene.header.nodes.count > 100 && scene.payload.len() > 1000);
        }
        assert_eq!(steps, [1, 11, 21, 31, 41, 51]);
        let mut nothing = std::io::sink();
        let mut short = scene;
        short.script.as_mut().unwrap().period_s = 16.0;
        assert_eq!(write(&short, None, 400, None, &mut nothing).unwrap(), 3, "a round of 800 fields");
    }
}
