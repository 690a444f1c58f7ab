//! A film and stills of scenes that come one after the other. No clock: each scene is drawn with the
//! poses that it was made of, however long that takes. Without a film only the stills are drawn.

use crate::assets::Assets;
use crate::config::VIDEO_HZ;
use crate::gpu::Gpu;
use crate::latch::latch;
use crate::offscreen::Offscreen;
use crate::output::picture::rgb;
use crate::output::save_png;
use crate::output::video::Video;
use crate::readback::Picture;
use crate::start::{HARDWARE_MAP_PX, renderer_config};
use crate::stereo::{Arrangement, arrange};
use anyhow::{Context, Result};
use image::codecs::jpeg::JpegEncoder;
use outputs::Outputs;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use rig::Rig;
use scene::SceneFile;
use settings::commands::FundusArgs;
use std::path::{Path, PathBuf};

/// JPEG qualities, tried in turn until a still is small enough.
const QUALITIES: [u8; 8] = [92, 88, 84, 80, 74, 66, 55, 40];

/// What is asked of a film.
#[derive(Debug, Clone, Default)]
pub struct FilmConfig {
    /// Quality tier, 0 is the best.
    pub tier: usize,
    /// How the two channels share the picture.
    pub arrangement: Arrangement,
    /// The fundus photograph.
    pub fundus: FundusArgs,
    /// The film, by its ending MP4 (H.264) or Y4M.
    pub video: Option<PathBuf>,
    /// The stills.
    pub stills: Option<Stills>,
}

/// Stills that are asked for.
#[derive(Debug, Clone)]
pub struct Stills {
    /// Their folder.
    pub folder: PathBuf,
    /// Instant of the first scene, from which their names count, s.
    pub from_s: f64,
    /// Time from one to the next, s.
    pub every_s: f64,
    /// JPEG of at most this many bytes, instead of PNG.
    pub jpeg_bytes: Option<usize>,
}

/// A film that is being drawn.
pub struct Film {
    config: FilmConfig,
    outputs: Outputs,
    offscreen: Offscreen,
    picture: Picture,
    video: Option<Video>,
    /// Scenes so far.
    number: u64,
    /// Stills so far.
    stills: u64,
}

impl Film {
    /// Of a scene and the instruments of a rig. The files that `config` names are claimed in `outputs`.
    ///
    /// # Errors
    /// Where there is no device, it cannot draw the tier, or the photograph is refused.
    pub fn begin(config: FilmConfig, outputs: Outputs, scene: &SceneFile, rig: &Rig) -> Result<Self> {
        let assets = Assets::load(&config.fundus, None)?;
        let gpu = Gpu::headless()?;
        gpu.check_tier(config.tier)?;
        let drawn = renderer_config(scene, rig, config.tier, HARDWARE_MAP_PX);
        let offscreen = Offscreen::with_assets(gpu, drawn, &assets);
        let picture = Picture::default();
        Ok(Film { config, outputs, offscreen, picture, video: None, number: 0, stills: 0 })
    }

    /// Takes the next scene with the poses of its step, and draws it where it is wanted: what is drawn
    /// later can depend on every scene.
    ///
    /// # Errors
    /// If the scene makes no sense, the device is lost or a file cannot be written.
    pub fn take(&mut self, header: &SceneHeader, poses: &TrackerFrame, payload: &[u8]) -> Result<()> {
        self.offscreen.renderer.take_scene(&self.offscreen.gpu, header, payload)?;
        let still = self.is_still();
        if self.config.video.is_none() && !still {
            // What the scene brought goes to the device, or it would pile up here.
            self.offscreen.gpu.queue.submit([]);
        } else {
            self.draw(poses)?;
            self.write_video()?;
        }
        if still {
            self.save_still()?;
            self.stills += 1;
        }
        self.number += 1;
        Ok(())
    }

    /// Draws one scene with the poses of its step, of which nothing is written: a JPEG of at most so many bytes, where
    /// one of the qualities is as small as that.
    ///
    /// # Errors
    /// If the scene makes no sense, or the device is lost.
    pub fn picture_of(
        &mut self,
        header: &SceneHeader,
        poses: &TrackerFrame,
        payload: &[u8],
        most_bytes: usize,
    ) -> Result<Vec<u8>> {
        self.offscreen.renderer.take_scene(&self.offscreen.gpu, header, payload)?;
        self.draw(poses)?;
        jpeg(&self.picture, most_bytes)
    }

    /// Closes the film.
    ///
    /// # Errors
    /// If its end cannot be written.
    pub fn finish(mut self) -> Result<()> {
        Ok(self.video.as_mut().map_or(Ok(()), Video::finish)?)
    }

    /// Whether the picture is the one nearest to the instant of the next still.
    fn is_still(&self) -> bool {
        let next = |stills: &Stills| {
            (self.stills as f64 * stills.every_s * f64::from(VIDEO_HZ)).round() as u64 <= self.number
        };
        self.config.stills.as_ref().is_some_and(next)
    }

    fn draw(&mut self, poses: &TrackerFrame) -> Result<()> {
        let (tier, latched) = (self.config.tier, latch(poses, poses.instants.exposed));
        self.offscreen.renderer.settle(&latched);
        self.offscreen.draw(tier, &latched);
        let arrangement = self.config.arrangement.for_files();
        self.offscreen.compose(tier, arrangement, &mut self.picture)?;
        arrange(&mut self.picture, arrangement);
        Ok(())
    }

    fn write_video(&mut self) -> Result<()> {
        let Some(path) = &self.config.video else { return Ok(()) };
        let size_px = [self.picture.width_px & !1, self.picture.height_px & !1];
        let file = match &mut self.video {
            Some(file) => file,
            none => none.insert(Video::begin(self.outputs.grow(path)?, size_px, VIDEO_HZ)?),
        };
        Ok(file.write(&self.picture, 1)?)
    }

    /// A still, named by its instant in seconds.
    fn save_still(&self) -> Result<()> {
        let Some(Stills { folder, from_s, jpeg_bytes, .. }) = &self.config.stills else { return Ok(()) };
        let name = format!("still-{:06.2}", from_s + self.number as f64 / f64::from(VIDEO_HZ));
        match jpeg_bytes {
            None => save_png(&folder.join(name + ".png"), &self.picture).context("a still"),
            Some(most) => save_jpeg(&folder.join(name + ".jpg"), &self.picture, *most),
        }
    }
}

fn save_jpeg(path: &Path, picture: &Picture, most_bytes: usize) -> Result<()> {
    Ok(Outputs::new(true).write(path, jpeg(picture, most_bytes)?)?)
}

/// The best of the qualities that is no larger, else the smallest.
fn jpeg(picture: &Picture, most_bytes: usize) -> Result<Vec<u8>> {
    let (pixels, mut file) = (rgb(picture), Vec::new());
    for quality in QUALITIES {
        file.clear();
        let mut encoder = JpegEncoder::new_with_quality(&mut file, quality);
        encoder.encode(&pixels, picture.width_px, picture.height_px, image::ExtendedColorType::Rgb8)?;
        if file.len() <= most_bytes {
            break;
        }
    }
    Ok(file)
}
