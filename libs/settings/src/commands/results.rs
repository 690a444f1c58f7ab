//! The command line of `vitreo results`.

use outputs::Force;
use std::path::PathBuf;

/// Value of `--plot` that plots in the terminal; the default if no file is given.
pub const TERMINAL: &str = "terminal";

/// Arguments of `vitreo results`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
pub struct ResultsArgs {
    /// Sub-command; without one, the results are shown.
    #[command(subcommand)]
    pub what: Option<ResultsCommand>,
    /// Path of the store.
    #[command(flatten)]
    pub place: StoreArgs,
    /// Show only this trainee.
    #[arg(long, value_name = "NAME")]
    pub trainee: Option<String>,
    /// Show only this module.
    #[arg(long, value_name = "NAME")]
    pub module: Option<String>,
    /// Show only this level.
    #[arg(long, value_name = "N")]
    pub level: Option<u32>,
    /// Plot the learning curve, in the terminal or to a file.
    #[arg(long, value_name = "FILE.png", num_args = 0..=1, default_missing_value = TERMINAL, help_heading = "Outputs")]
    pub plot: Option<PathBuf>,
    /// Write all figures as CSV; - is standard output.
    #[arg(long, value_name = "FILE.csv", help_heading = "Outputs")]
    pub csv: Option<PathBuf>,
    /// Write all figures as Parquet.
    #[arg(long, value_name = "FILE.parquet", help_heading = "Outputs")]
    pub parquet: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Path of the results store.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct StoreArgs {
    /// Results store [default: vitreo/results.sqlite in $XDG_DATA_HOME or ~/.local/share].
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
}

/// The sub-commands.
#[derive(Debug, clap::Subcommand)]
pub enum ResultsCommand {
    /// Add recorded attempts.
    Add {
        /// Path of the store.
        #[command(flatten)]
        place: StoreArgs,
        /// Pseudonym of the trainee.
        trainee: String,
        /// The recordings.
        #[arg(value_name = "FILE.mcap", required = true)]
        files: Vec<PathBuf>,
    },
    /// Delete one attempt, or a trainee with all attempts.
    Delete {
        /// Path of the store.
        #[command(flatten)]
        place: StoreArgs,
        /// Pseudonym of the trainee.
        trainee: String,
        /// Delete only this attempt, by its number in vitreo results.
        #[arg(long, value_name = "N")]
        attempt: Option<i64>,
        /// Delete the recordings too.
        #[arg(long)]
        recordings: bool,
    },
    /// List the trainees.
    Trainees {
        /// Path of the store.
        #[command(flatten)]
        place: StoreArgs,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        results: ResultsArgs,
    }

    fn parse(words: &[&str]) -> Result<ResultsArgs, String> {
        let line = Line::try_parse_from(std::iter::once(&"results").chain(words));
        line.map(|l| l.results).map_err(|e| e.to_string())
    }

    #[test]
    fn a_plot_goes_to_the_terminal_or_into_a_file() {
        let plot = |words: &[&str]| parse(words).unwrap().plot;
        assert_eq!(plot(&[]), None);
        assert_eq!(plot(&["--plot"]), Some(TERMINAL.into()));
        assert_eq!(plot(&["--plot", "a.png", "--module", "shadow"]), Some("a.png".into()));
    }

    #[test]
    fn deleting_needs_a_name() {
        assert!(parse(&["delete"]).is_err() && parse(&["delete", "t7", "--store", "s"]).is_ok());
        assert!(
            parse(&["--module", "shadow", "delete", "t7"]).is_err(),
            "filters do not choose what is deleted"
        );
    }
}
