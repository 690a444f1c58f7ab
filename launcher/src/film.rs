//! `vitreo film`: a film of a module as the scripted surgeon does it. Simulation and renderer work
//! one after the other, without cameras and without a clock, so that the film is whole and good
//! however slow the machine is.

use crate::children::command;
use crate::fundus::FundusArgs;
use crate::inputs::check_file;
use crate::modules::Composed;
use crate::progress::pictures_bar;
use anyhow::{Context, bail};
use ipc::logging::{arguments, inform};
use outputs::{Force, Outputs};
use protocol::scene_stream::{self, Reader};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, ExitCode, Stdio};

/// Pictures a second: that of the renderer's films.
const PICTURES_PER_S: f64 = 25.0;
/// Fields of the simulation from one picture to the next.
const FIELDS_PER_PICTURE: u32 = 2;

/// Arguments of `vitreo film`.
#[derive(Debug, clap::Args)]
pub struct FilmArgs {
    /// The module: its name or folder (vitreo modules lists them).
    #[arg(value_name = "MODULE")]
    pub module: String,
    /// Level of the module, from 1 on [default: the last, which shows most].
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// Who works: expert, average, novice or careless.
    #[arg(long, value_name = "WHO", default_value = "expert")]
    pub surgeon: String,
    /// Seed of the surgeon's attempt and tremor.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Longest film, s; it ends earlier where the operation does.
    #[arg(long, value_name = "S", default_value_t = 120.0, value_parser = seconds)]
    pub length: f64,
    /// The film [default: out/film.y4m, or none where stills are asked for].
    #[arg(short, long, value_name = "FILE.y4m")]
    pub output: Option<PathBuf>,
    /// Stills into this folder.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Time from one still to the next, s.
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds, requires = "stills")]
    pub every: f64,
    /// Stills are JPEG of at most so many kB instead of PNG.
    #[arg(long, value_name = "KB", requires = "stills")]
    pub jpeg: Option<u32>,
    /// Quality tier of the picture, 0 (2×1280×1024) to 8.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..9))]
    pub tier: u32,
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

/// Runs it.
///
/// # Errors
/// Where the module is refused, or simulation or renderer fail.
pub fn run(args: &FilmArgs) -> anyhow::Result<ExitCode> {
    let level = args.level.map_or_else(|| Ok(surgeon::load(&args.module)?.levels()), anyhow::Ok)?;
    let film = args.output.clone().or_else(|| args.stills.is_none().then(|| "out/film.y4m".into()));
    args.fundus.fundus.as_deref().map_or(Ok(()), |photograph| check_file("--fundus", photograph))?;
    let mut outputs = Outputs::new(args.force.force).reading(&args.module).reading_all(&args.fundus.fundus);
    film.as_deref().map_or(Ok(()), |file| outputs.claim(file))?;
    args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder))?;
    let composed = Composed::new(&args.module, level, &args.surgeon, args.seed)?;
    let (mut simulation, scenes) = simulate(args, &composed)?;
    let (mut renderer, pictures) = draw(args, &composed, film.as_deref())?;
    let carried = carry(scenes, pictures, (args.length.min(composed.longest_s) * PICTURES_PER_S) as u64 + 1);
    // The pipe is closed now: the process that failed has written why, and the other ends.
    ended(&mut renderer, "the picture")?;
    ended(&mut simulation, "the simulation")?;
    let shown_s = carried? as f64 / PICTURES_PER_S;
    let whole = if shown_s + 0.1 < args.length { "the whole of it" } else { "as long as asked for" };
    inform(&format!("{shown_s:.1} s: {whole}"));
    for path in film.iter().chain(&args.stills) {
        println!("{}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Starts the simulation, which writes scenes.
fn simulate(args: &FilmArgs, composed: &Composed) -> anyhow::Result<(Child, ChildStdout)> {
    let mut command = command("vitreo-offline")?;
    command.args(arguments()).args([
        "film",
        "--scene",
        &composed.name(),
        "--every",
        &FIELDS_PER_PICTURE.to_string(),
    ]);
    command.args(["--seed", &args.seed.to_string(), "--length", &args.length.to_string()]);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().context("start the simulation")?;
    let scenes = child.stdout.take().context("the simulation's output")?;
    Ok((child, scenes))
}

/// Starts the renderer, which draws them.
fn draw(args: &FilmArgs, composed: &Composed, film: Option<&Path>) -> anyhow::Result<(Child, ChildStdin)> {
    let mut command = command("vitreo-renderer")?;
    command.args(["film", "--scene", &composed.name(), "--tier", &args.tier.to_string()]);
    command.args(arguments());
    command.args(["--arrange", &args.arrange]).args(args.fundus.arguments());
    if let Some(film) = film {
        command.arg("--video").arg(film);
    }
    if let Some(stills) = &args.stills {
        let every = ((args.every * PICTURES_PER_S).round() as u64).max(1);
        command.arg("--stills").arg(stills).args(["--every", &every.to_string()]);
    }
    if args.force.force {
        command.arg("--force");
    }
    if let Some(kb) = args.jpeg {
        command.args(["--jpeg", &(u64::from(kb) * 1000).to_string()]);
    }
    let mut child =
        command.stdin(Stdio::piped()).stdout(Stdio::null()).spawn().context("start the renderer")?;
    let pictures = child.stdin.take().context("the renderer's input")?;
    Ok((child, pictures))
}

/// Carries the scenes from the one to the other and shows how far they are; how many.
fn carry(scenes: ChildStdout, pictures: ChildStdin, expected: u64) -> anyhow::Result<u64> {
    let (mut reader, mut to) = (Reader::new(scenes)?, BufWriter::new(pictures));
    let bar = pictures_bar(expected, "pictures");
    let mut carried = 0;
    scene_stream::begin(&mut to)?;
    while let Some((header, payload)) = reader.next_scene()? {
        scene_stream::write(&mut to, &header, payload)?;
        carried += 1;
        bar.inc(1);
    }
    to.flush()?;
    bar.finish_and_clear();
    Ok(carried)
}

fn ended(child: &mut Child, what: &str) -> anyhow::Result<()> {
    let status = child.wait().with_context(|| format!("wait for {what}"))?;
    // A broken pipe is the other one's failure.
    if !status.success() {
        bail!("{what} failed ({status}); vitreo doctor says what this machine lacks");
    }
    Ok(())
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
        assert_eq!((film.module.as_str(), film.level, film.length, film.tier), ("peeling", None, 30.0, 3));
        let film = parse(&["peeling", "--fundus", "a.jpg", "--fundus-field", "50"]).unwrap().film;
        assert_eq!(film.fundus.arguments(), ["--fundus", "a.jpg", "--fundus-field", "50"]);
        for wrong in [
            &[][..],
            &["peeling", "--length", "0"],
            &["peeling", "--every", "2"],
            &["peeling", "--tier", "9"],
            &["peeling", "--arrange", "sequential"],
            &["peeling", "--fundus-eye", "right"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
