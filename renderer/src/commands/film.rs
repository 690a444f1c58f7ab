//! `vitreo-renderer film`: draws a stream of scenes into a film and stills. No clock: each scene is
//! drawn with the poses that it was made of, however long that takes. Without a film only the stills
//! are drawn.

use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use outputs::{FILM_STILLS, Force, Outputs};
use protocol::rig::Rig;
use protocol::scene_stream::{Reader, StreamedScene};
use renderer::assets::Assets;
use renderer::config::VIDEO_HZ;
use renderer::governor::TIERS;
use renderer::gpu::Gpu;
use renderer::latch::latch;
use renderer::offscreen::Offscreen;
use renderer::output::picture::rgb;
use renderer::output::save_png;
use renderer::output::video::Video;
use renderer::photograph::FundusArgs;
use renderer::readback::Picture;
use renderer::start::{HARDWARE_MAP_PX, renderer_config};
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
    /// Rig file (default: the shipped rig); gives the length of the instruments.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Instant of the first scene, s, from which the names of stills count.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    pub from: f64,
    /// Quality tier, 0 is the best.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..TIERS.len() as i64))]
    pub tier: u32,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// How the two channels share the picture.
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    pub arrange: Arrangement,
    /// Write the film, by its ending MP4 (H.264) or Y4M.
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = outputs::video_file)]
    pub video: Option<PathBuf>,
    /// Write stills into this folder.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Time from one still to the next, s.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    pub every: f64,
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
    let mut film = Film::begin(args)?;
    let mut reader = Reader::new(std::io::stdin().lock())?;
    while let Some(scene) = reader.next_scene()? {
        film.take(&scene)?;
    }
    Ok(film.video.as_mut().map_or(Ok(()), Video::finish)?)
}

/// A film that is being drawn.
struct Film<'a> {
    args: &'a FilmArgs,
    outputs: Outputs,
    offscreen: Offscreen,
    picture: Picture,
    video: Option<Video>,
    /// Scenes so far.
    number: u64,
    /// Stills so far.
    stills: u64,
}

impl<'a> Film<'a> {
    fn begin(args: &'a FilmArgs) -> Result<Self> {
        let mut outputs = Outputs::new(args.force.force);
        args.stills.as_deref().map_or(Ok(()), |folder| outputs.claim_folder(folder, FILM_STILLS))?;
        let scene = SceneFile::load(&args.scene)?;
        let assets = Assets::load(&args.fundus, None)?;
        let rig = Rig::load_or_shipped(args.rig.as_deref()).context("--rig")?;
        let config = renderer_config(&scene, &rig, args.tier as usize, HARDWARE_MAP_PX);
        let gpu = Gpu::headless()?;
        gpu.check_tier(args.tier as usize)?;
        let offscreen = Offscreen::with_assets(gpu, config, &assets);
        Ok(Film { args, outputs, offscreen, picture: Picture::default(), video: None, number: 0, stills: 0 })
    }

    /// Takes the next scene, and draws it where it is wanted: what is drawn later can depend on every
    /// scene.
    fn take(&mut self, scene: &StreamedScene<'_>) -> Result<()> {
        let gpu = &self.offscreen.gpu;
        self.offscreen.renderer.take_scene(gpu, &scene.header, scene.payload)?;
        // The picture that is nearest to the instant of the next still.
        let next = (self.stills as f64 * self.args.every * f64::from(VIDEO_HZ)).round() as u64;
        let still = self.args.stills.as_deref().filter(|_| self.number >= next);
        match (&self.args.video, still) {
            // What the scene brought goes to the device, or it would pile up here.
            (None, None) => drop(gpu.queue.submit([])),
            (video, still) => {
                self.draw(scene)?;
                if let Some(path) = video {
                    self.write(path)?;
                }
                if let Some(folder) = still {
                    save(self.args, folder, self.number, &self.picture)?;
                    self.stills += 1;
                }
            }
        }
        self.number += 1;
        Ok(())
    }

    fn draw(&mut self, scene: &StreamedScene<'_>) -> Result<()> {
        let (tier, latched) = (self.args.tier as usize, latch(scene.poses, scene.poses.instants.exposed));
        self.offscreen.renderer.settle(&latched);
        self.offscreen.draw(tier, &latched);
        let arrangement = self.args.arrange.for_files();
        self.offscreen.compose(tier, arrangement, &mut self.picture)?;
        arrange(&mut self.picture, arrangement);
        Ok(())
    }

    fn write(&mut self, path: &Path) -> Result<()> {
        let size_px = [self.picture.width_px & !1, self.picture.height_px & !1];
        let file = match &mut self.video {
            Some(file) => file,
            none => none.insert(Video::begin(self.outputs.grow(path)?, size_px, VIDEO_HZ)?),
        };
        Ok(file.write(&self.picture, 1)?)
    }
}

/// A still, named by its instant in seconds.
fn save(args: &FilmArgs, folder: &Path, number: u64, picture: &Picture) -> Result<()> {
    let name = format!("still-{:06.2}", args.from + number as f64 / f64::from(VIDEO_HZ));
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
