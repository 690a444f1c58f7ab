//! The command line of `vitreo film`.

use super::drawing::seconds;
use super::{DrawingArgs, SpanArgs};
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
    /// Stills, and how all pictures are drawn.
    #[command(flatten)]
    pub drawing: DrawingArgs,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::Arrangement;
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
        assert_eq!((film.drawing.tier, film.drawing.arrange), (Some(3), Arrangement::SideBySide));
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
