//! A scene's script played without cameras and without a clock, field by field, and what the
//! simulation sends of it: for films and for pictures of a moment.

use super::SceneShown;
use crate::blocks::Blocks;
use crate::perception::perform;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::time::Instants;
use scene::SceneFile;
use simcore::world::{World, WorldError};
use std::ops::ControlFlow;
use surgeon::rehearsal::Rehearsal;
use training::score::recording::is_over;

/// Steps a second of the script.
pub const FIELDS_PER_S: f64 = 50.0;
/// Time for which the end screen of an attempt is shown, s.
const END_SCREEN_S: f64 = 3.0;

/// A scene that is being played.
#[derive(Debug)]
pub struct ScriptedFilm {
    rehearsal: Rehearsal,
    world: World,
    blocks: Blocks,
    field: u64,
    /// Poses of the field before, and the hash of the state that they led to.
    last: Option<(Box<TrackerFrame>, u64)>,
}

impl ScriptedFilm {
    /// The beginning of a scene. With a seed the surgeon's tips shake as the script says.
    pub fn begin(scene: &SceneFile, seed: Option<u64>) -> Result<Self, WorldError> {
        let mut rehearsal = Rehearsal::shipped(scene);
        if let Some(seed) = seed {
            rehearsal = rehearsal.with_tremor(seed);
        }
        let world = World::new(scene)?;
        Ok(ScriptedFilm { rehearsal, blocks: Blocks::new(&world), world, field: 0, last: None })
    }

    /// Fields of the script's round.
    pub fn fields(&self) -> u64 {
        self.rehearsal.fields()
    }

    /// The last field of a film of at most `seconds`, as far as it is known: the film of an attempt ends with
    /// its end screen.
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

/// Gives the scene of every `every`-th field to `show`, from the first on, until that has enough: an
/// attempt at a task until its end screen, else a round of the script, or for `seconds`, whatever the
/// script.
///
/// # Errors
/// Where the scene cannot be simulated, and those of `show`.
pub fn play(
    scene: &SceneFile,
    seed: Option<u64>,
    every: u64,
    seconds: Option<f64>,
    show: &mut impl FnMut(SceneShown) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<()> {
    let mut film = ScriptedFilm::begin(scene, seed)?;
    let (mut field, mut over) = (0, None);
    while field <= film.last_field(seconds, over) {
        // Before the first step no instrument has been seen.
        film.play_to(field + 1);
        over = over.or_else(|| film.world.task().is_some_and(|(_, s)| is_over(s)).then_some(field));
        let (poses, _) = film.last.clone().expect("a step was made");
        let (header, payload) = film.scene();
        if show(SceneShown { header, poses, payload: payload.into() })?.is_break() {
            break;
        }
        field += every.max(1);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_is_as_long_as_asked_or_as_the_script() {
        let scene = SceneFile::load("peel").unwrap();
        let shown = |scene: &SceneFile, every, seconds| {
            let mut steps = Vec::new();
            let mut show = |shown: SceneShown| {
                assert_eq!(shown.header.instants.exposed, shown.poses.instants.exposed);
                assert!(shown.header.nodes.count > 100 && shown.payload.len() > 1000);
                steps.push(shown.header.step);
                Ok(ControlFlow::Continue(()))
            };
            play(scene, Some(3), every, seconds, &mut show).unwrap();
            steps
        };
        assert_eq!(shown(&scene, 10, Some(1.0)), [1, 11, 21, 31, 41, 51]);
        let mut short = scene;
        short.script.as_mut().unwrap().period_s = 16.0;
        assert_eq!(shown(&short, 400, None).len(), 3, "a round of 800 fields");
    }
}
