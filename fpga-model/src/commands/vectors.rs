//! `vitreo-fpga-model vectors`: writes the test vectors that a hardware description is checked
//! with.

use crate::vectors::{patterns, text};
use anyhow::Result;
use ipc::logging::inform;
use outputs::{Force, Outputs};
use std::path::PathBuf;

/// Arguments of `vectors`.
#[derive(Debug, Clone, clap::Args)]
pub struct VectorsArgs {
    /// Output folder.
    #[arg(value_name = "FOLDER", default_value = "fpga-model/vectors")]
    pub folder: PathBuf,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Writes one file a pattern.
///
/// # Errors
/// Where the folder or a file cannot be written.
pub fn run(args: &VectorsArgs) -> Result<()> {
    let folder = &args.folder;
    let all = patterns::all();
    let mut outputs = Outputs::new(args.force.force);
    let path = |name: &str| folder.join(format!("{name}.txt"));
    for pattern in &all {
        outputs.claim(&path(pattern.name))?;
    }
    for pattern in &all {
        outputs.write(&path(pattern.name), text(pattern))?;
    }
    inform(&format!("{} files in {}", all.len(), folder.display()));
    Ok(())
}
