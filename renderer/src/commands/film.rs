//! `vitreo-renderer film`: draws a stream of scenes into a film and stills. No clock: each scene is
//! drawn as the simulation left it, however long that takes.

use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use outputs::{Force, Outputs};
use protocol::rig::Rig;
use protocol::scene_stream::Reader;
use renderer::assets::Assets;
use renderer::config::VIDEO_HZ;
use renderer::governor::TIERS;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::output::picture::rgb;
use renderer::output::save_png;
use renderer::output::y4m::Y4m;
use renderer::photograph::FundusArgs;
use renderer::readback::Picture;
use renderer::start::{map_px, renderer_config};
use renderer::stereo::{Arrangement, arrange};
use scene::SceneFile;
use std::path::{Path, PathBuf};

/// JPEG qualities, tried in turn until a still is small enough.
const QUALITIES: [u8; 8] = [92, 88, 84, 80, 74, 66, 55, 40];

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct FilmArgs {
    /// Scene by name or file, whose stream comes on standard input.
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: String,
    /// Quality tier, 0 is the best.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..TIERS.len() as i64))]
    pub tier: u32,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// How the two channels share the picture.
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    pub arrange: Arrangement,
    /// Write the film.
    #[arg(long, value_name = "FILE.y4m")]
    pub video: Option<PathBuf>,
    /// Write stills into this folder.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Scenes from one still to the next.
    #[arg(long, value_name = "N", default_value_t = u64::from(VIDEO_HZ), value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// Write stills as JPEG of at most this many bytes, instead of PNG.
    #[arg(long, value_name = "BYTES")]
    pub jpeg: Option<usize>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// Draws the stream on standard input.
///
/// # Errors
/// If the stream breaks off, the device is lost or a file cannot be written.
pub fn film(args: &FilmArgs) -> Result<()> {
    let mut outputs = Outputs::new(args.force.force);
    args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder))?;
    let scene = SceneFile::load(&args.scene)?;
    let assets = Assets::load(&args.fundus, None)?;
    let (gpu, rig, tier) = (Gpu::headless()?, Rig::load_or_shipped(None)?, args.tier as usize);
    let config = renderer_config(&scene, &rig, tier, map_px(&gpu));
    let mut offscreen = Offscreen::with_assets(gpu, config, &assets);
    let mut reader = Reader::new(std::io::stdin().lock())?;
    let (mut picture, mut video, mut number) = (Picture::default(), None, 0u64);
    while let Some((header, payload)) = reader.next_scene()? {
        offscreen.renderer.take_scene(&offscreen.gpu, &header, payload)?;
        // Text follows with the next frame, so the first one is drawn twice.
        for _ in 0..if number == 0 { 2 } else { 1 } {
            offscreen.draw(tier, &latch_scene(&header));
        }
        let still = args.stills.as_deref().filter(|_| number.is_multiple_of(args.every));
        if args.video.is_some() || still.is_some() {
            offscreen.read(tier, &mut picture)?;
            arrange(&mut picture, args.arrange.for_files());
        }
        if let Some(path) = &args.video {
            let size = [picture.width_px & !1, picture.height_px & !1];
            let file = match &mut video {
                Some(file) => file,
                none => none.insert(Y4m::begin(outputs.grow(path)?, size, VIDEO_HZ)?),
            };
            file.write(&picture, 1)?;
        }
        if let Some(folder) = still {
            save(args, folder, number, &picture)?;
        }
        number += 1;
    }
    if let Some(file) = &mut video {
        file.flush()?;
    }
    Ok(())
}

/// A still, named by its instant in seconds.
fn save(args: &FilmArgs, folder: &Path, number: u64, picture: &Picture) -> Result<()> {
    let name = format!("still-{:05.1}", number as f64 / f64::from(VIDEO_HZ));
    let Some(most) = args.jpeg else {
        return save_png(&folder.join(name + ".png"), picture).context("a still");
    };
    let (path, pixels) = (folder.join(name + ".jpg"), rgb(picture));
    let (width, height) = (picture.width_px, picture.height_px);
    let mut file = Vec::new();
    for quality in QUALITIES {
        file.clear();
        let mut encoder = JpegEncoder::new_with_quality(&mut file, quality);
        encoder.encode(&pixels, width, height, image::ExtendedColorType::Rgb8)?;
        if file.len() <= most {
            break;
        }
    }
    Ok(Outputs::new(true).write(&path, file)?)
}
