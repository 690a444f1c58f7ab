//! Renews the reference pictures that `tests/reference.rs` compares with:
//! `cargo run --release -p renderer --example pictures -- FOLDER` (`make pictures`).

mod common;

use anyhow::{Context, Result};
use common::stage::{Stage, small, tier_of};
use renderer::governor::Shading;
use std::path::PathBuf;

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).context("usage: pictures FOLDER")?);
    std::fs::create_dir_all(&folder)?;
    let mut stage = Stage::open().context("a graphics driver")?;
    for (name, shading) in common::SUBJECTS.iter().flat_map(|n| Shading::ALL.map(|s| (n, s))) {
        let scenes = common::subject(&stage.file, &stage.rig, name);
        let picture = small(&stage.draw(&scenes, tier_of(shading)));
        let path = folder.join(format!("{name}-{}.png", shading.name()));
        renderer::output::save_png(&path, &picture)?;
        println!("{}", path.display());
    }
    Ok(())
}
