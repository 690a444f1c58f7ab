//! `vitreo film`: a film of a module as the scripted surgeon does it, or of a recording as it was.
//! Simulation and renderer work side by side, without cameras and without a clock, so that the film is
//! whole and good however slow the machine is.
//!
//! - `scripted`, `recorded`: the scenes of the one and of the other
//! - `subject`: which of them is asked for

pub mod recorded;
pub mod scripted;
mod subject;

use crate::stop::StopSignal;
use anyhow::{Context, anyhow};
use ipc::logging::inform;
use outputs::exit::INTERRUPTED;
use outputs::progress::pictures_bar;
use outputs::{FILM_STILLS, Outputs, println};
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use renderer::film::{Film, FilmConfig, Stills};
use settings::commands::FilmArgs;
use settings::inputs::check_file;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, sync_channel};
use subject::Subject;

/// Pictures a second: that of the renderer's films.
const PICTURES_PER_S: f64 = renderer::config::VIDEO_HZ as f64;
/// Scenes that the simulation makes ahead of the picture.
const AHEAD: usize = 4;

/// What the simulation sends for a picture.
#[derive(Debug, Clone)]
pub struct SceneShown {
    /// The scene's header.
    pub header: SceneHeader,
    /// The poses that its step was made of, with their validity.
    pub poses: Box<TrackerFrame>,
    /// The scene's payload.
    pub payload: Vec<u8>,
}

/// Runs it. Exit code 3 where a part of the recording is missing or its states cannot be compared, 5
/// where a state is not the recorded one, 130 where a signal ended it: the film then shows what was
/// drawn until then.
///
/// # Errors
/// Where module or recording are refused, or simulation or renderer fail.
pub fn run(args: &FilmArgs) -> anyhow::Result<ExitCode> {
    let stop = StopSignal::install().context("signals")?;
    let video = args.output.clone().or_else(|| args.stills.is_none().then(|| "out/film.mp4".into()));
    args.fundus.fundus.as_deref().map_or(Ok(()), |photograph| check_file("--fundus", photograph))?;
    let mut outputs = Outputs::new(args.force.force).reading(&args.subject).reading_all(&args.fundus.fundus);
    video.as_deref().map_or(Ok(()), |file| outputs.claim(file))?;
    args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, FILM_STILLS))?;
    let subject = Subject::open(args)?;
    let config = config(args, &subject, video.clone());
    let (drawn, code) = side_by_side(&subject, config, outputs, &stop)?;
    let shown_s = drawn as f64 / PICTURES_PER_S;
    let share = if stop.is_raised() { "stopped" } else { subject.share(shown_s) };
    inform(&format!("{shown_s:.1} s: {share}"));
    for path in video.iter().chain(&args.stills) {
        println!("{}", path.display());
    }
    Ok(ExitCode::from(code))
}

fn config(args: &FilmArgs, subject: &Subject, video: Option<PathBuf>) -> FilmConfig {
    let stills = |folder: &PathBuf| Stills {
        folder: folder.clone(),
        from_s: args.span.from,
        every_s: args.every,
        jpeg_bytes: args.jpeg.map(|kb| kb as usize * 1000),
    };
    FilmConfig {
        tier: args.tier.unwrap_or(subject.tier()) as usize,
        arrangement: args.arrange,
        fundus: args.fundus.clone(),
        video,
        stills: args.stills.as_ref().map(stills),
    }
}

/// Simulates on a thread and draws on this one; how many pictures, and the exit code.
fn side_by_side(
    subject: &Subject,
    config: FilmConfig,
    outputs: Outputs,
    stop: &StopSignal,
) -> anyhow::Result<(u64, u8)> {
    let film = Film::begin(config, outputs, &subject.scene, &subject.rig)?;
    std::thread::scope(|scope| {
        let (sender, scenes) = sync_channel(AHEAD);
        // Nobody who draws any more takes scenes: that is the end of it.
        let mut show = move |shown| match sender.send(shown) {
            Ok(()) => Ok(ControlFlow::Continue(())),
            Err(_) => Ok(ControlFlow::Break(())),
        };
        let simulation = scope.spawn(move || subject.play(&mut show));
        let drawn = draw(film, scenes, (subject.longest_s() * PICTURES_PER_S) as u64 + 1, stop);
        let simulated = simulation.join().map_err(|_| anyhow!("the simulation ended unexpectedly"));
        let drawn = drawn?;
        let code = match (stop.is_raised(), simulated?) {
            (true, _) => INTERRUPTED,
            (false, code) => code?,
        };
        Ok((drawn, code))
    })
}

/// Draws the scenes until the last or a signal, and shows how far they are; how many.
fn draw(
    mut film: Film,
    scenes: Receiver<SceneShown>,
    expected: u64,
    stop: &StopSignal,
) -> anyhow::Result<u64> {
    let bar = pictures_bar(expected, "pictures");
    let mut drawn = 0;
    while !stop.is_raised()
        && let Ok(SceneShown { header, poses, payload }) = scenes.recv()
    {
        film.take(&header, &poses, &payload)?;
        drawn += 1;
        bar.inc(1);
    }
    drop(scenes);
    film.finish()?;
    bar.finish_and_clear();
    Ok(drawn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        film: FilmArgs,
    }

    fn golden() -> String {
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden/peel-2s.mcap").into()
    }

    #[test]
    fn a_file_is_a_recording_and_each_has_its_own_options() {
        let open = |words: &[&str]| {
            let film = Line::try_parse_from(std::iter::once(&"film").chain(words)).unwrap().film;
            Subject::open(&film).map(|subject| (subject.tier(), subject.longest_s()))
        };
        let golden = golden();
        let (tier, length_s) = open(&[&golden, "--from", "0.5", "--until", "1.5"]).unwrap();
        assert_eq!((tier, length_s), (0, 1.0));
        assert_eq!(open(&["navigation", "--length", "2"]).unwrap(), (1, 2.0));
        for (words, told) in [
            (&[golden.as_str(), "--level", "2"][..], "--level"),
            (&[&golden, "--surgeon", "expert"], "--surgeon"),
            (&[&golden, "--length", "2"], "--until"),
            (&[&golden, "--seed", "2"], "--seed"),
            (&[&golden, "--from", "1", "--until", "0.5"], "--until 0.5"),
            (&[&golden, "--from", "60"], "--from 60"),
            (&["navigation", "--from", "1"], "--length"),
            (&["navigation", "--until", "1"], "--length"),
            (&["juggling"], "juggling"),
        ] {
            let error = open(words).unwrap_err();
            assert_eq!(crate::exit::code_of(&error), outputs::exit::WRONG_USE, "{words:?}");
            assert!(error.to_string().contains(told), "{words:?}: {error}");
        }
        let missing = open(&["no.mcap"]).unwrap_err();
        assert_eq!(crate::exit::code_of(&missing), outputs::exit::FAILED);
        assert!(missing.to_string().contains("no.mcap"), "{missing}");
    }
}
