//! The command line of `vitreo film`.

use super::arrangement::{Arrangement, of_films};
use super::{FundusArgs, SpanArgs};
use outputs::{Force, video_file};
use std::path::PathBuf;

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
    #[arg(long, value_name = "HOW", default_value_t, value_parser = of_films(), hide_possible_values = true)]
    pub arrange: Arrangement,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected seconds, found '{text}'"))?;
    if (0.04..=3_600.0).contains(&value) { Ok(value) } else { Err("expected 0.04 to 3600 s".into()) }
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
        assert_eq!((film.tier, film.arrange), (Some(3), Arrangement::SideBySide));
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
}
