//! `vitreo-fpga-model vectors`: writes the test vectors that a hardware description is checked
//! with.

use crate::vectors::{patterns, text};
use anyhow::{Context, Result};
use std::path::PathBuf;

/// Arguments of `vectors`.
#[derive(Debug, Clone, clap::Args)]
pub struct VectorsArgs {
    /// Folder to write to.
    #[arg(value_name = "FOLDER", default_value = "fpga-model/vectors")]
    pub folder: PathBuf,
}

/// Writes one file a pattern.
///
/// # Errors
/// Where the folder or a file cannot be written.
pub fn run(args: &VectorsArgs) -> Result<()> {
    let folder = &args.folder;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let all = patterns::all();
    for pattern in &all {
        let path = folder.join(format!("{}.txt", pattern.name));
        std::fs::write(&path, text(pattern)).with_context(|| format!("cannot write {}", path.display()))?;
    }
    eprintln!("{} files in {}", all.len(), folder.display());
    Ok(())
}
