//! `vitreo film`: a film of a module as the scripted surgeon does it, or of a recording as it was.
//! Simulation and renderer work side by side, without cameras and without a clock, so that the film is
//! whole and good however slow the machine is.
//!
//! - `scripted`, `recorded`: the scenes of the one and of the other
//! - `subject`: which of them is asked for
//! - `pictures`: which steps of a recording a film shows
//! - `drawing`: the thread that draws

mod drawing;
mod pictures;
pub mod recorded;
pub mod scripted;
mod subject;

pub use drawing::{Drawing, claim, film_config};
pub use pictures::{Pictures, StepShown};

use crate::stop::StopSignal;
use anyhow::Context;
use ipc::logging::inform;
use outputs::exit::INTERRUPTED;
use outputs::{Outputs, println};
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use renderer::film::FilmConfig;
use settings::commands::FilmArgs;
use std::ops::ControlFlow;
use std::process::ExitCode;
use subject::Subject;

/// Pictures a second: that of the renderer's films.
pub const PICTURES_PER_S: f64 = renderer::config::VIDEO_HZ as f64;

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
    let video = args.output.clone().or_else(|| args.drawing.stills.is_none().then(|| "out/film.mp4".into()));
    let mut outputs = Outputs::new(args.force.force).reading_all(recording::files_of(args.subject.as_ref()));
    claim(&args.drawing, video.as_deref(), &mut outputs)?;
    let subject = Subject::open(args)?;
    let config = film_config(&args.drawing, video.clone(), args.span.from, subject.tier());
    let (drawn, code) = side_by_side(&subject, config, outputs, &stop)?;
    let shown_s = drawn as f64 / PICTURES_PER_S;
    let share = if stop.is_raised() { "stopped" } else { subject.share(shown_s) };
    inform(&format!("{shown_s:.1} s: {share}"));
    for path in video.iter().chain(&args.drawing.stills) {
        println!("{}", path.display());
    }
    Ok(ExitCode::from(code))
}

/// Simulates here and draws on another thread; how many pictures, and the exit code.
fn side_by_side(
    subject: &Subject,
    config: FilmConfig,
    outputs: Outputs,
    stop: &StopSignal,
) -> anyhow::Result<(u64, u8)> {
    let drawing = Drawing::begin(config, outputs, &subject.scene, &subject.rig, subject.longest_s())?;
    let played = subject
        .play(&mut |shown| Ok(if stop.is_raised() { ControlFlow::Break(()) } else { drawing.show(shown) }));
    // What was simulated until then can be seen.
    let drawn = drawing.finish()?;
    let code = match (stop.is_raised(), played) {
        (true, _) => INTERRUPTED,
        (false, code) => code?,
    };
    Ok((drawn, code))
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
            (&[&golden, "--length", "2"], "--length"),
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
