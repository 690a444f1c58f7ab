//! `vitreo film`: a film of a module as the scripted surgeon does it, or of a recording as it was.
//! Simulation and renderer work one after the other, without cameras and without a clock, so that the
//! film is whole and good however slow the machine is.

mod subject;

use crate::children::command;
use crate::cli::REPLAY;
use crate::fundus::FundusArgs;
use crate::inputs::check_file;
use crate::runtime::{INTERRUPTED, StopSignal, block_on};
use anyhow::{Context, bail};
use ipc::logging::{arguments, inform};
use outputs::progress::pictures_bar;
use outputs::{FILM_STILLS, Force, Outputs, println, video_file};
use protocol::scene_stream::{self, Reader};
use settings::commands::SpanArgs;
use std::io::{BufWriter, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitCode, Stdio};
use subject::Subject;

/// Pictures a second: that of the renderer's films.
const PICTURES_PER_S: f64 = 25.0;
/// Exit codes of `vitreo-replay` with which its scenes are whole: done, with loss, not as recorded.
const DONE: [u8; 3] = [0, crate::exit::LOSS, crate::exit::DIFFERS];

/// Arguments of `vitreo film`.
#[derive(Debug, clap::Args)]
pub struct FilmArgs {
    /// A module, by its name or folder (vitreo modules lists them), or a recording, which is simulated
    /// again and shown as it was.
    #[arg(value_name = "MODULE|FILE.mcap")]
    pub subject: String,
    /// Level of the module, from 1 on [default: the last, which shows most].
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// Who works in the module: expert, average, novice or careless [default: expert].
    #[arg(long, value_name = "WHO")]
    pub surgeon: Option<String>,
    /// Seed of the surgeon's attempt and tremor [default: 1].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Longest film of a module, s; it ends earlier where the operation does [default: 120].
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub length: Option<f64>,
    /// The part of the recording.
    #[command(flatten)]
    pub span: SpanArgs,
    /// The film, by its ending: MP4 (H.264), or Y4M without compression [default: out/film.mp4, or
    /// none where stills are asked for].
    #[arg(short, long, value_name = "FILE.mp4|FILE.y4m", value_parser = video_file)]
    pub output: Option<PathBuf>,
    /// Stills into this folder, named by their instants in s. Without a film nothing else is drawn.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Time from one still to the next, s.
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds, requires = "stills")]
    pub every: f64,
    /// Stills are JPEG of at most so many kB instead of PNG.
    #[arg(long, value_name = "KB", requires = "stills")]
    pub jpeg: Option<u32>,
    /// Quality tier of the picture, 0 (2×1280×1024) to 8 [default: 1 of a module, 0 of a recording].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..9))]
    pub tier: Option<u32>,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// How the two channels share the picture: side-by-side, anaglyph, interleaved, left or right.
    #[arg(long, value_name = "HOW", default_value = "side-by-side",
          value_parser = ["side-by-side", "anaglyph", "interleaved", "left", "right"])]
    pub arrange: String,
    #[command(flatten)]
    force: Force,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected seconds, found '{text}'"))?;
    if (0.04..=3_600.0).contains(&value) { Ok(value) } else { Err("expected 0.04 to 3600 s".into()) }
}

/// Runs it. Exit code 3 where a part of the recording is missing or its states cannot be compared, 5
/// where a state is not the recorded one, 130 where a signal ended it: the film then shows what was
/// drawn until then.
///
/// # Errors
/// Where module or recording are refused, or simulation or renderer fail.
pub fn run(args: &FilmArgs) -> anyhow::Result<ExitCode> {
    block_on(async { film(args, &StopSignal::install()?) })
}

fn film(args: &FilmArgs, stop: &StopSignal) -> anyhow::Result<ExitCode> {
    let film = args.output.clone().or_else(|| args.stills.is_none().then(|| "out/film.mp4".into()));
    args.fundus.fundus.as_deref().map_or(Ok(()), |photograph| check_file("--fundus", photograph))?;
    let mut outputs = Outputs::new(args.force.force).reading(&args.subject).reading_all(&args.fundus.fundus);
    film.as_deref().map_or(Ok(()), |file| outputs.claim(file))?;
    args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, FILM_STILLS))?;
    let subject = Subject::open(args)?;
    // Dropped in reverse: a simulation that is in the way ends without a word of its broken pipe.
    let (mut scenes, mut simulation) = simulate(args, &subject)?;
    let (mut renderer, pictures) = draw(args, &subject, film.as_deref())?;
    let carried = carry(&mut scenes, pictures, (subject.longest_s() * PICTURES_PER_S) as u64 + 1, stop);
    // Its pipe is closed: it ends the film, or has written why it could not.
    ended(&mut renderer.0, "the picture", &DONE[..1])?;
    let code = match stop.is_raised() {
        true => INTERRUPTED,
        false => ended(&mut simulation.0, "the simulation", &DONE)?,
    };
    let shown_s = carried? as f64 / PICTURES_PER_S;
    let share = if stop.is_raised() { "stopped" } else { subject.share(shown_s) };
    inform(&format!("{shown_s:.1} s: {share}"));
    for path in film.iter().chain(&args.stills) {
        println!("{}", path.display());
    }
    Ok(ExitCode::from(code))
}

/// A process that is killed when nobody waits for its end any more.
struct Worker(Child);

impl Worker {
    /// Out of the reach of Ctrl-C, which is for this program alone.
    fn start(command: &mut Command, what: &str) -> anyhow::Result<Self> {
        command.process_group(0).spawn().with_context(|| format!("start {what}")).map(Worker)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the simulation, which writes scenes.
fn simulate(args: &FilmArgs, subject: &Subject) -> anyhow::Result<(ChildStdout, Worker)> {
    let mut command = command(REPLAY)?;
    command.args(arguments());
    subject.for_simulation(args, &mut command);
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let mut worker = Worker::start(&mut command, "the simulation")?;
    let scenes = worker.0.stdout.take().context("the simulation's output")?;
    Ok((scenes, worker))
}

/// Starts the renderer, which draws them.
fn draw(args: &FilmArgs, subject: &Subject, film: Option<&Path>) -> anyhow::Result<(Worker, ChildStdin)> {
    let mut command = command("vitreo-renderer")?;
    let tier = args.tier.unwrap_or(subject.tier());
    command.args(["film", "--tier", &tier.to_string()]).args(arguments());
    subject.for_renderer(args, &mut command);
    command.args(["--arrange", &args.arrange]).args(args.fundus.arguments());
    if let Some(film) = film {
        command.arg("--video").arg(film);
    }
    if let Some(stills) = &args.stills {
        command.arg("--stills").arg(stills).args(["--every", &args.every.to_string()]);
    }
    if args.force.force {
        command.arg("--force");
    }
    if let Some(kb) = args.jpeg {
        command.args(["--jpeg", &(u64::from(kb) * 1000).to_string()]);
    }
    command.stdin(Stdio::piped()).stdout(Stdio::null());
    let mut worker = Worker::start(&mut command, "the renderer")?;
    let pictures = worker.0.stdin.take().context("the renderer's input")?;
    Ok((worker, pictures))
}

/// Carries the scenes from the one to the other, until the last or a signal, and shows how far they
/// are; how many.
fn carry(
    scenes: &mut ChildStdout,
    pictures: ChildStdin,
    expected: u64,
    stop: &StopSignal,
) -> anyhow::Result<u64> {
    let (mut reader, mut to) = (Reader::new(scenes)?, BufWriter::new(pictures));
    let bar = pictures_bar(expected, "pictures");
    let mut carried = 0;
    scene_stream::begin(&mut to)?;
    while !stop.is_raised()
        && let Some(scene) = reader.next_scene()?
    {
        scene_stream::write(&mut to, &scene.header, scene.poses, scene.payload)?;
        carried += 1;
        bar.inc(1);
    }
    to.flush()?;
    bar.finish_and_clear();
    Ok(carried)
}

/// Waits for the end of a process; its exit code, one of `good`.
fn ended(child: &mut Child, what: &str, good: &[u8]) -> anyhow::Result<u8> {
    let status = child.wait().with_context(|| format!("wait for {what}"))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok()).filter(|code| good.contains(code));
    match code {
        Some(code) => Ok(code),
        None if status.code().is_some() => bail!("{what} failed, as told above"),
        None => bail!("{what} failed ({status})"),
    }
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

    #[test]
    fn odd_wishes_are_refused() {
        let parse = |words: &[&str]| Line::try_parse_from(std::iter::once(&"film").chain(words));
        let film = parse(&["peeling", "--length", "30", "-o", "a.y4m", "--tier", "3"]).unwrap().film;
        assert_eq!((film.subject.as_str(), film.level, film.length), ("peeling", None, Some(30.0)));
        assert_eq!(film.tier, Some(3));
        let film = parse(&["peeling", "--fundus", "a.jpg", "--fundus-field", "50"]).unwrap().film;
        assert_eq!(film.fundus.arguments(), ["--fundus", "a.jpg", "--fundus-field", "50"]);
        let film = parse(&["a.mcap", "--from", "1.5", "--until", "3", "-o", "a.mp4"]).unwrap().film;
        assert_eq!(film.span, SpanArgs { from: 1.5, until: Some(3.0) });
        for wrong in [
            &[][..],
            &["peeling", "--length", "0"],
            &["peeling", "--every", "2"],
            &["peeling", "--tier", "9"],
            &["peeling", "--arrange", "sequential"],
            &["peeling", "--fundus-eye", "right"],
            &["a.mcap", "--from", "-1"],
            &["a.mcap", "-o", "a.avi"],
            &["a.mcap", "-o", "a"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }

    fn golden() -> String {
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/golden/peel-2s.mcap").into()
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
            assert_eq!(crate::exit::code_of(&error), crate::exit::WRONG_USE, "{words:?}");
            assert!(error.to_string().contains(told), "{words:?}: {error}");
        }
        let missing = open(&["no.mcap"]).unwrap_err();
        assert_eq!(crate::exit::code_of(&missing), crate::exit::FAILED);
        assert!(missing.to_string().contains("no.mcap"), "{missing}");
    }
}
