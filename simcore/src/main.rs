//! `vitreo-simcore`: the simulation as a process of its own.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match run(&simcore::config::Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vitreo-simcore: {}", protocol::shell::told(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

fn run(args: &simcore::config::Args) -> anyhow::Result<()> {
    if let Some(every) = args.film {
        let scene = protocol::scene_file::SceneFile::load(&args.scene)?;
        let mut out = std::io::BufWriter::new(std::io::stdout().lock());
        simcore::film::write(&scene, args.film_seed, every, args.film_length, &mut out)?;
        return Ok(());
    }
    let Some([file, out]) = args.again.as_deref() else { return simcore::process::run(args) };
    let again = simcore::again::run(file, out)?;
    if let Some(step) = again.differs_at {
        eprintln!(
            "vitreo-simcore: {}: from step {step} on the state is not the recorded one",
            file.display()
        );
    }
    Ok(())
}
