//! Makes the instruments' meshes: `cargo run --release -p renderer --example instruments -- FOLDER` (`make instruments`) writes a
//! glTF file for each tool. Every measure that the simulation knows too comes from `protocol::handles`.

mod glb;
mod shapes;

use anyhow::{Context, Result};
use std::path::PathBuf;

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).context("usage: instruments FOLDER")?);
    std::fs::create_dir_all(&folder)?;
    for tool in shapes::all() {
        let path = folder.join(format!("{}.glb", tool.name));
        std::fs::write(&path, glb::bytes(&tool)).with_context(|| path.display().to_string())?;
        let triangles: usize = tool.parts.iter().flat_map(|p| &p.surfaces).map(|s| s.triangles.len()).sum();
        println!("{}: {triangles} triangles", path.display());
    }
    Ok(())
}
