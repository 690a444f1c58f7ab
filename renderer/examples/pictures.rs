//! Renews the reference pictures that `tests/pictures/reference.rs` compares with:
//! `cargo run --release -p renderer --example pictures -- FOLDER` (`make pictures`).

use anyhow::{Context, Result};
use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::output::save_png;
use renderer::readback::Picture;
use renderer::reference_scene::{SUBJECTS, subject};
use renderer::similarity::{reference_sized, reference_tier};
use renderer::start::renderer_config;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::path::PathBuf;

/// Edge of the fundus map: that of a software driver, whatever the device.
const MAP_PX: u32 = 512;

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).context("usage: pictures FOLDER")?);
    std::fs::create_dir_all(&folder)?;
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE)?, Rig::load_or_shipped(None)?);
    let config = renderer_config(&file, &rig, reference_tier(Shading::Full), MAP_PX);
    let gpu = Gpu::headless()?;
    for (name, shading) in SUBJECTS.iter().flat_map(|n| Shading::ALL.map(|s| (n, s))) {
        let mut offscreen = Offscreen::new(gpu.clone(), config)?;
        let scenes = subject(&file, &rig, name);
        for scene in &scenes {
            offscreen.renderer.take_scene(&gpu, &scene.header, scene.payload())?;
        }
        let mut picture = Picture::default();
        offscreen.draw(reference_tier(shading), &latch_scene(&scenes[scenes.len() - 1].header));
        offscreen.read(reference_tier(shading), &mut picture)?;
        let path = folder.join(format!("{name}-{}.png", shading.name()));
        save_png(&path, &reference_sized(&picture))?;
        println!("{}", path.display());
    }
    Ok(())
}
