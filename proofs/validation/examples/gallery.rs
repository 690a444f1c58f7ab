//! Pictures of moments of the shipped scenes: `cargo run --release -p validation --example gallery
//! --` with `FOLDER` for those of the documentation (`make gallery`), with `--reference FOLDER` for
//! those that `tests/scenarios/pictures.rs` compares with (`make pictures`), with `[--tier N]
//! FOLDER SCENE SECONDS…` for any others (`module NAME` for a module), to tune a scene by.

use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use protocol::bindings::help;
use protocol::optics::Lens;
use protocol::scene::Section;
use protocol::scene_text::Row;
use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::output::picture::rgb;
use renderer::output::save_png;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::similarity::{reference_sized, reference_tier};
use scene::SceneFile;
use std::path::{Path, PathBuf};
use surgeon::skill::{CARELESS, EXPERT};
use validation::moments::{MOMENTS, REFERENCE_MAP_PX, ScenePlayer};

/// Edge of the fundus map, px: as fine as the photograph.
const MAP_PX: u32 = 2048;
/// Tier of the pictures: 2×800×640 px.
const TIER: usize = 1;
/// Tier of the pages with text: 640×512 px.
const PAGE_TIER: usize = 2;
/// Instants of the pages, s: the tip has begun to move; what comes after the end of the limit.
const MOVES_S: f64 = 2.5;
const AFTER_S: f64 = 3.0;
/// A tool number without a tool: nothing is drawn.
const NO_TOOL: u32 = 99;
/// Largest file, bytes.
const MAX_BYTES: usize = 150_000;

/// The pictures of the documentation: file, scene, instant (s), change to what the simulation sent.
const GALLERY: [(&str, &str, f64, Change); 10] = [
    ("forceps-open", "peel", 4.0, as_it_is),
    ("peeling", "erm", 9.0, close_up),
    ("flap", "erm", 22.0, as_it_is),
    ("pick-under-the-edge", "lift", 9.0, close_up),
    ("trimming", "trim", 13.0, as_it_is),
    ("vitreous", "vitrectomy", 16.0, as_it_is),
    ("bleb", "relocation", 10.0, as_it_is),
    ("retina-turned", "translocation", 20.0, wide_angle),
    ("bleeding", "module shadow", 30.0, as_it_is),
    ("ora-serrata", "vitrectomy", 0.0, to_the_rim),
];

type Change = fn(&mut SceneBlock);

fn as_it_is(_: &mut SceneBlock) {}

/// A field of 7 mm round the tip of the first instrument.
fn close_up(block: &mut SceneBlock) {
    let tip = block.header.instruments[0].world_from_instrument.position_mm;
    block.header.microscope.target_in_world_mm = tip;
    block.header.microscope.field_mm = 7.0;
}

/// Without the vitreous, the eye turned until the border of its retina comes into view, the light
/// pipe pointed at it.
fn to_the_rim(block: &mut SceneBlock) {
    block.header.bricks = Section::default();
    let half = 0.5f64 * 0.95;
    block.header.world_from_eye.rotation_wxyz = [half.cos(), half.sin(), 0.0, 0.0];
    block.header.instruments[0].tool = NO_TOOL;
    let lean = -0.5f64 * 0.85;
    let light = &mut block.header.instruments[1].world_from_instrument;
    (light.position_mm, light.rotation_wxyz) = ([1.0, -3.5, -2.5], [lean.cos(), lean.sin(), 0.0, 0.0]);
    block.header.microscope.target_in_world_mm = [0.0, -5.5, -9.0];
    block.header.microscope.field_mm = 12.0;
}

/// Through the wide-angle lens, set upright.
fn wide_angle(block: &mut SceneBlock) {
    block.header.microscope.lens = Lens::WideAngle as u32;
    block.header.microscope.inverter = 1;
    block.header.microscope.field_mm = 16.0;
}

/// A shipped scene, or the first level of a module (`module NAME`) done by a careless surgeon.
fn begin(name: &str) -> Result<ScenePlayer> {
    let scene = match name.strip_prefix("module ") {
        Some(module) => surgeon::compose(&surgeon::load(module)?, 1, &CARELESS, 1)?,
        None => SceneFile::load(name)?,
    };
    Ok(ScenePlayer::begin(scene))
}

fn main() -> Result<()> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let mut tier = TIER;
    if let Some(i) = args.iter().position(|a| a == "--tier") {
        tier = args.get(i + 1).context("a tier after --tier")?.parse()?;
        args.drain(i..i + 2);
    }
    let gpu = Gpu::headless()?;
    match args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["--reference", folder] => reference(&gpu, &made(folder)?.join("scenes")),
        [folder] => gallery(&gpu, &made(folder)?),
        [folder, scene, ref instants @ ..] => moments(&gpu, &made(folder)?, tier, scene, instants),
        [] => anyhow::bail!("usage: gallery [--reference] FOLDER | [--tier N] FOLDER SCENE SECONDS…"),
    }
}

fn made(folder: &str) -> Result<PathBuf> {
    std::fs::create_dir_all(folder).with_context(|| folder.to_owned())?;
    Ok(folder.into())
}

fn gallery(gpu: &Gpu, folder: &Path) -> Result<()> {
    for (file, scene, at_s, change) in GALLERY {
        let mut player = begin(scene)?;
        let mut block = player.play_to(at_s);
        change(&mut block);
        save(&folder.join(format!("{file}.jpg")), &player.draw(gpu, &block, TIER, MAP_PX))?;
    }
    pages(gpu, folder)
}

/// What a person at a desk sees in the first minute, and after an attempt.
fn pages(gpu: &Gpu, folder: &Path) -> Result<()> {
    let save = |file: &str, player: &ScenePlayer, block: &SceneBlock, overlay: &str| {
        let path = folder.join(format!("{file}.png"));
        println!("{}", path.display());
        save_png(&path, &player.draw_at_desk(gpu, block, PAGE_TIER, MAP_PX, overlay))
    };
    let mut player = ScenePlayer::begin(surgeon::compose(&surgeon::load("navigation")?, 1, &EXPERT, 1)?);
    let mut keys = String::new();
    help(true).lines().for_each(|line| Row::Plain(line).push(&mut keys));
    let block = player.play_to(0.02);
    save("start-page", &player, &block, "")?;
    let block = player.play_to(MOVES_S);
    save("first-movement", &player, &block, "")?;
    save("help-page", &player, &block, &keys)?;
    let mut player = begin("module shadow")?;
    let limit_s = player.scene.task.as_ref().context("a task")?.limit_s;
    let block = player.play_to(limit_s + AFTER_S);
    save("end-page", &player, &block, "")?;
    Ok(())
}

fn reference(gpu: &Gpu, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for moment in MOMENTS {
        let mut player = moment.begin();
        let block = player.play_to(moment.at_s);
        for shading in Shading::ALL {
            let tier = reference_tier(shading);
            let picture = reference_sized(&player.draw(gpu, &block, tier, REFERENCE_MAP_PX));
            let path = folder.join(format!("{}-{}.png", moment.file(), shading.name()));
            save_png(&path, &picture)?;
            println!("{}", path.display());
        }
    }
    Ok(())
}

fn moments(gpu: &Gpu, folder: &Path, tier: usize, scene: &str, instants: &[&str]) -> Result<()> {
    let mut player = begin(scene)?;
    for at in instants {
        let block = player.play_to(at.parse().with_context(|| format!("expected seconds, found '{at}'"))?);
        let picture = player.draw(gpu, &block, tier, MAP_PX);
        let name = Path::new(scene).file_stem().context("a scene's name")?.to_string_lossy();
        save(&folder.join(format!("{name}-{at}.jpg")), &picture)?;
    }
    Ok(())
}

/// Saves a JPEG as good as fits into [`MAX_BYTES`].
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
        if file.len() <= MAX_BYTES {
            std::fs::write(path, file)?;
            println!("{}, quality {quality}", path.display());
            return Ok(());
        }
    }
    anyhow::bail!("{}: larger than {MAX_BYTES} bytes", path.display())
}
