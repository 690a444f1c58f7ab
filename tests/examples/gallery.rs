//! Pictures of moments of the shipped scenes:
//! `cargo run --release -p vitreo-tests --example gallery -- FOLDER` (`make gallery`) makes those of the documentation;
//! with `FOLDER SCENE SECONDS…` any others, to look at while a scene is tuned (`--tier N` before the scene's name).

use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use protocol::scene_file::SceneFile;
use renderer::gpu::Gpu;
use renderer::output::picture::rgb;
use renderer::readback::Picture;
use std::path::{Path, PathBuf};
use vitreo_tests::surgery::Surgery;

/// Edge of the fundus map, px: as fine as the photograph.
const MAP_PX: u32 = 2048;
/// Tier of the pictures: 2×800×640 px.
const TIER: usize = 2;
/// Largest file, bytes.
const MOST_BYTES: usize = 150_000;

fn main() -> Result<()> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let mut tier = TIER;
    if let Some(i) = args.iter().position(|a| a == "--tier") {
        tier = args.get(i + 1).context("a tier after --tier")?.parse()?;
        args.drain(i..i + 2);
    }
    let folder = PathBuf::from(args.first().context("usage: gallery FOLDER [SCENE SECONDS…]")?);
    std::fs::create_dir_all(&folder)?;
    let gpu = Gpu::headless()?;
    let Some(scene) = args.get(1) else { return Ok(()) };
    let mut surgery = Surgery::begin(SceneFile::load(scene)?);
    for at in &args[2..] {
        let block = surgery.play_to(at.parse()?);
        let picture = surgery.draw(&gpu, &block, tier, MAP_PX);
        let name = Path::new(scene).file_stem().context("a scene's name")?.to_string_lossy();
        save(&folder.join(format!("{name}-{at}.jpg")), &picture)?;
    }
    Ok(())
}

/// Saves a JPEG as good as fits into [`MOST_BYTES`].
fn save(path: &Path, picture: &Picture) -> Result<()> {
    let pixels = rgb(picture);
    for quality in [92, 88, 84, 80, 74, 66, 55] {
        let mut file = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut file, quality);
        image::ImageEncoder::write_image(
            encoder,
            &pixels,
            picture.width_px,
            picture.height_px,
            image::ExtendedColorType::Rgb8,
        )?;
        if file.len() <= MOST_BYTES {
            std::fs::write(path, file)?;
            println!("{}, quality {quality}", path.display());
            return Ok(());
        }
    }
    anyhow::bail!("{}: larger than {MOST_BYTES} bytes", path.display())
}
