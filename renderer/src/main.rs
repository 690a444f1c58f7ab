//! `vitreo-renderer`: the surgeon's stereo view, and the measurement of what it costs.

mod commands;

use clap::Parser;
use commands::bench;
use protocol::health::Process;
use renderer::config::Config;
use settings::{Program, SettingsArgs};
use std::process::ExitCode;

/// What vitreo.toml says to the sub-commands that a person calls; a process of a run reads no file.
const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Draws the surgeon's stereo view.
#[derive(Debug, Parser)]
#[command(name = "vitreo-renderer", version, about, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    config: Config,
    #[command(flatten)]
    settings: SettingsArgs,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Measure the cost of a part on this machine.
    #[command(subcommand)]
    Bench(Bench),
}

#[derive(Debug, clap::Subcommand)]
enum Bench {
    /// Measure the time of a stereo frame, by quality tier and layer.
    Render(bench::RenderArgs),
}

fn main() -> ExitCode {
    let cli: Cli = match settings::parse(&SETTINGS) {
        Ok(cli) => cli,
        Err((problem, log)) => return ipc::logging::wrong_use(Process::Renderer.name(), &log, &problem),
    };
    ipc::logging::init(Process::Renderer.name(), &cli.config.shell.log);
    let done = match &cli.command {
        Some(Command::Bench(Bench::Render(args))) => bench::render(args),
        None => renderer::process::run(&cli.config),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => ipc::logging::fail(error.as_ref()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        Cli::command().debug_assert();
        let parse = |args: &[&str]| Cli::try_parse_from([&["vitreo-renderer"], args].concat());
        assert!(parse(&["--headless", "--tier", "5"]).unwrap().command.is_none());
        let bench = parse(&["bench", "render", "--json", "--tier", "3", "--subject", "bleb"]).unwrap();
        let Some(Command::Bench(Bench::Render(args))) = bench.command else { panic!("no bench") };
        assert!(args.json && args.tier == Some(3));
        assert!(parse(&["bench", "render", "--tier", "99"]).is_err());
        assert!(parse(&["bench", "render", "--subject", "teapot"]).is_err() && parse(&["bench"]).is_err());
    }
}
