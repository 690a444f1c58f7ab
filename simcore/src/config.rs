//! Arguments of the process.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use collision::backend::Backend;
use ipc::shell::ShellArgs;
use scene::DEFAULT_SCENE;
use std::path::PathBuf;

/// Collision and tissue of the vitreo eye.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-simcore", version)]
pub struct Args {
    /// What every process takes.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// Scene: a shipped one by name, or a TOML file.
    #[arg(long, default_value = DEFAULT_SCENE)]
    pub scene: String,
    /// Back end of collisions; it changes no result. `auto` measures at start-up which is faster.
    #[arg(long, default_value = "auto", value_parser = backend_parser(), value_name = "WHO")]
    pub collision: Backend,
    /// Journal to go on from: the newest checkpoint, and the inputs since.
    #[arg(long, value_name = "FILE")]
    pub resume: Option<PathBuf>,
}

fn backend_parser() -> impl TypedValueParser<Value = Backend> {
    PossibleValuesParser::new(Backend::NAMES).map(|name| Backend::named(&name).unwrap_or_default())
}
