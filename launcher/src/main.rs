//! `vitreo`: the one command a person types.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    let cli = launcher::cli::Cli::parse();
    match launcher::cli::dispatch(&cli) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("vitreo: {}", told(&error));
            ExitCode::from(launcher::exit::FAILED)
        }
    }
}

/// The error with its causes; a cause that the text before it tells already is passed over.
fn told(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn no_cause_is_told_twice() {
        let cause = anyhow!("no such file");
        assert_eq!(
            told(&cause.context("rig r.json: no such file").context("start")),
            "start: rig r.json: no such file"
        );
    }
}
