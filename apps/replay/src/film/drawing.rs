//! Drawing on a thread of its own, beside who makes the scenes.

use super::{PICTURES_PER_S, SceneShown};
use anyhow::anyhow;
use outputs::progress::pictures_bar;
use outputs::{FILM_STILLS, Outputs};
use renderer::film::{Film, FilmConfig, Stills};
use rig::Rig;
use scene::SceneFile;
use settings::commands::DrawingArgs;
use settings::inputs::check_file;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{JoinHandle, spawn};

/// Scenes that are made ahead of the picture.
const AHEAD: usize = 4;

/// What a command line asks for: `video`, and pictures whose names count from `from_s`, of `tier` where no
/// other one is asked for.
pub fn film_config(args: &DrawingArgs, video: Option<PathBuf>, from_s: f64, tier: u32) -> FilmConfig {
    let stills = |folder: &PathBuf| Stills {
        folder: folder.clone(),
        from_s,
        every_s: args.every,
        jpeg_bytes: args.jpeg.map(|kb| kb as usize * 1000),
    };
    FilmConfig {
        tier: args.tier.unwrap_or(tier) as usize,
        arrangement: args.arrange,
        fundus: args.fundus.clone(),
        video,
        stills: args.stills.as_ref().map(stills),
    }
}

/// Claims the files of a film in `outputs`, after a look at the photograph.
///
/// # Errors
/// Where one of them is refused.
pub fn claim(args: &DrawingArgs, video: Option<&Path>, outputs: &mut Outputs) -> anyhow::Result<()> {
    if let Some(photograph) = &args.fundus.fundus {
        check_file("--fundus", photograph)?;
        outputs.add_input(photograph);
    }
    video.map_or(Ok(()), |file| outputs.claim(file))?;
    args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, FILM_STILLS))?;
    Ok(())
}

/// A film that is being drawn.
pub struct Drawing {
    scenes: SyncSender<SceneShown>,
    thread: JoinHandle<anyhow::Result<u64>>,
}

impl Drawing {
    /// Begins a film of `longest_s` seconds at most, for the progress bar. The files that `config` names are
    /// claimed in `outputs`.
    ///
    /// # Errors
    /// Where there is no graphics device, it cannot draw the tier, or the photograph is refused.
    pub fn begin(
        config: FilmConfig,
        outputs: Outputs,
        scene: &SceneFile,
        rig: &Rig,
        longest_s: f64,
    ) -> anyhow::Result<Self> {
        let (begun, has_begun) = sync_channel(1);
        let (scenes, received) = sync_channel(AHEAD);
        let (scene, rig) = (scene.clone(), rig.clone());
        let expected = (longest_s * PICTURES_PER_S) as u64 + 1;
        let thread = spawn(move || {
            let film = Film::begin(config, outputs, &scene, &rig)?;
            let _ = begun.send(());
            draw(film, &received, expected)
        });
        let drawing = Drawing { scenes, thread };
        match has_begun.recv() {
            Ok(()) => Ok(drawing),
            Err(_) => Err(drawing.finish().err().unwrap_or_else(ended_unexpectedly)),
        }
    }

    /// Draws a scene, now or soon; breaks where nothing is drawn any more, for what reason [`Drawing::finish`]
    /// says.
    pub fn show(&self, shown: SceneShown) -> ControlFlow<()> {
        if self.scenes.send(shown).is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }

    /// Draws what is left and closes the film; how many scenes there were.
    ///
    /// # Errors
    /// Where a scene could not be drawn, or a file not be written.
    pub fn finish(self) -> anyhow::Result<u64> {
        drop(self.scenes);
        self.thread.join().map_err(|_| ended_unexpectedly())?
    }
}

fn ended_unexpectedly() -> anyhow::Error {
    anyhow!("the drawing ended unexpectedly")
}

/// Draws the scenes until the last, and shows how far they are.
fn draw(mut film: Film, scenes: &Receiver<SceneShown>, expected: u64) -> anyhow::Result<u64> {
    let bar = pictures_bar(expected, "pictures");
    let mut drawn = 0;
    while let Ok(SceneShown { header, poses, payload }) = scenes.recv() {
        film.take(&header, &poses, &payload)?;
        drawn += 1;
        bar.inc(1);
    }
    film.finish()?;
    bar.finish_and_clear();
    Ok(drawn)
}
