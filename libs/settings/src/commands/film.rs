//! The command line of `vitreo film`.

use super::drawing::seconds;
use super::{DrawingArgs, SpanArgs};
use outputs::{Force, video_file};
use std::path::PathBuf;

/// Arguments of `vitreo film`.
#[derive(Debug, clap::Args)]
// A heading applies to all arguments that follow.
#[command(mut_arg("force", |arg| arg.help_heading(None::<&str>)))]
pub struct FilmArgs {
    /// Module name or folder (vitreo modules lists them), or a recording, which is simulated again and shown
    /// as recorded.
    #[arg(value_name = "MODULE|FILE.mcap")]
    pub subject: String,
    /// Film: .mp4 (H.264) or .y4m (uncompressed) [default: out/film.mp4, or no film with --stills].
    #[arg(short, long, value_name = "FILE.mp4|FILE.y4m", value_parser = video_file)]
    pub output: Option<PathBuf>,
    /// Level of the module, from 1 [default: the last].
    #[arg(long, value_name = "N", help_heading = "Film of a module")]
    pub level: Option<u32>,
    /// Scripted surgeon: expert, average, novice, careless or idle [default: expert].
    #[arg(long, value_name = "SURGEON", help_heading = "Film of a module")]
    pub surgeon: Option<String>,
    /// Seed of the surgeon's attempt and tremor [default: 1].
    #[arg(long, help_heading = "Film of a module")]
    pub seed: Option<u64>,
    /// Maximum length of a module's film, s; it ends earlier if the operation does [default: 120].
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true, help_heading = "Film of a module")]
    pub length: Option<f64>,
    /// The part of the recording.
    #[command(flatten, next_help_heading = "Film of a recording")]
    pub span: SpanArgs,
    /// Stills, and how all pictures are drawn.
    #[command(flatten)]
    pub drawing: DrawingArgs,
    /// `--force`.
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
