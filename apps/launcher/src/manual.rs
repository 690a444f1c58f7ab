//! `vitreo completions` and `vitreo man`: shell completions and manual pages, both generated from the
//! declaration of the command line.

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use ipc::logging::inform;
use outputs::{Force, Outputs, print};
use std::path::PathBuf;
use std::process::ExitCode;

/// Name of the program.
const NAME: &str = "vitreo";

/// Arguments of `vitreo completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell to print completions for.
    pub shell: Shell,
}

/// Arguments of `vitreo man`.
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Folder for the pages, such as /usr/local/share/man/man1.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Prints the completions for a shell.
///
/// # Errors
/// Never fails.
pub fn completions(args: &CompletionsArgs, line: Command) -> anyhow::Result<ExitCode> {
    print!("{}", completions_of(args.shell, line));
    Ok(ExitCode::SUCCESS)
}

fn completions_of(shell: Shell, mut line: Command) -> String {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut line, NAME, &mut text);
    String::from_utf8_lossy(&text).into_owned()
}

/// Writes a manual page for the program and for each sub-command.
///
/// # Errors
/// If a page exists and `--force` is not given, or a page cannot be written.
pub fn man(args: &ManArgs, line: Command) -> anyhow::Result<ExitCode> {
    let mut outputs = Outputs::new(args.force.force);
    let pages = pages(line)?;
    let paths: Vec<PathBuf> = pages.iter().map(|(name, _)| args.folder.join(name)).collect();
    // All pages are claimed before the first is written, so that either all are written or none.
    paths.iter().try_for_each(|path| outputs.claim(path))?;
    for (path, (_, text)) in paths.iter().zip(&pages) {
        outputs.write(path, text)?;
    }
    inform(&format!("{} pages in {}", pages.len(), args.folder.display()));
    Ok(ExitCode::SUCCESS)
}

/// File names and texts of all pages, section 1.
fn pages(mut root: Command) -> anyhow::Result<Vec<(String, Vec<u8>)>> {
    // Gives sub-commands their full names.
    root.build();
    let mut pages = Vec::new();
    add_pages(&root, &mut pages)?;
    Ok(pages)
}

fn add_pages(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> anyhow::Result<()> {
    let (page, mut text) = (Man::new(command.clone()), Vec::new());
    page.render(&mut text).context("writing into memory")?;
    pages.push((page.get_filename(), text));
    let mut below = command.get_subcommands().filter(|c| c.get_name() != "help" && !c.is_hide_set());
    below.try_for_each(|command| add_pages(command, pages))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::{CommandFactory, ValueEnum};

    fn subcommands() -> Vec<String> {
        Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect()
    }

    #[test]
    fn every_sub_command_has_a_page_that_names_its_options() {
        let pages = pages(Cli::command()).unwrap();
        let of = |name: &str| {
            let page = pages.iter().find(|(file, _)| file == name).unwrap_or_else(|| panic!("no {name}"));
            String::from_utf8(page.1.clone()).unwrap()
        };
        for name in subcommands() {
            let page = of(&format!("vitreo-{name}.1"));
            assert!(page.contains(&format!(".TH vitreo-{name} 1")), "{name}: {page:.80}");
        }
        assert!(of("vitreo-run.1").contains("duration"), "options of a sub-command");
        assert!(of("vitreo.1").contains("recording"));
    }

    #[test]
    fn every_shell_completes_every_sub_command() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let text = completions_of(shell, Cli::command());
            for name in subcommands() {
                assert!(text.contains(&name), "{shell}: {name}");
            }
            assert!(text.contains("assert-budgets"), "{shell}: options of run");
        }
        assert!(
            Shell::value_variants().iter().all(|&shell| completions_of(shell, Cli::command()).len() > 1000)
        );
    }

    #[test]
    fn pages_are_written_whole_and_not_over_others() {
        let folder = tempfile::tempdir().unwrap();
        let args = |force| ManArgs { folder: folder.path().join("man1"), force: Force { force } };
        man(&args(false), Cli::command()).unwrap();
        assert!(folder.path().join("man1/vitreo-replay.1").is_file());
        let again = man(&args(false), Cli::command()).unwrap_err().to_string();
        assert!(again.contains("--force"), "{again}");
        man(&args(true), Cli::command()).unwrap();
    }
}
