//! Picture outputs: stills, video, and the small JPEGs of channel `pictures`.

use super::RendererShell;
use crate::compose::{SMALL_PX, output_px};
use crate::config::{Config, STILL_NS, VIDEO_HZ};
use crate::governor::TIERS;
use crate::output::{Output, OutputConfig, PictureRequest};
use crate::pacing::Ticks;
use crate::stereo::Arrangement;
use anyhow::{Context, Result};
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::health::STATE_DEGRADED;
use protocol::limits::MAX_PICTURE_BYTES;
use protocol::time::Nanos;

/// The files of pictures, and when a picture is due for each kind.
pub(super) struct PictureFiles {
    pub(super) output: Output,
    /// Size of one channel of the video, px, if there is a video.
    video_px: Option<[u32; 2]>,
    arrangement: Arrangement,
    stills: Ticks,
    video: Ticks,
    small: Ticks,
    /// True if the last picture of the run is saved as a still.
    pub(super) keeps_last: bool,
    /// True if the next picture is saved as a still, because the user asked for it.
    pub(super) snapshot: bool,
    pub(super) write_failed: bool,
}

impl PictureFiles {
    /// Opens the files. `video_px`: size of one channel of a video, px.
    ///
    /// # Errors
    /// If a file or folder cannot be written.
    pub(super) fn open(config: &Config, video_px: [u32; 2], first_tier: usize) -> Result<Self> {
        let output_config = output_config(config, video_px);
        let output = Output::start(&output_config, first_tier).context("files for stills or video")?;
        let rate = |wanted: bool, hz: f64| Ticks::new(if wanted { hz } else { 0.0 });
        let (stills, video) = (config.picture.stills.is_some(), config.picture.video.is_some());
        Ok(PictureFiles {
            output,
            video_px: video.then_some(video_px),
            arrangement: output_config.arrangement,
            stills: rate(stills, 1e9 / STILL_NS as f64),
            video: rate(video, f64::from(VIDEO_HZ)),
            small: Ticks::new(config.pictures_hz),
            keeps_last: stills,
            snapshot: false,
            write_failed: false,
        })
    }
}

/// Settings of the files to write.
fn output_config(config: &Config, video_px: [u32; 2]) -> OutputConfig {
    OutputConfig {
        stills: config.picture.stills.clone(),
        video: config.picture.video.clone(),
        force: config.force.force,
        video_px,
        video_hz: VIDEO_HZ,
        arrangement: config.arrangement().for_files(),
    }
}

impl RendererShell {
    /// Passes the picture to the outputs that are due.
    pub(super) fn output_frame(&mut self, tier: usize, record: &FrameRecord) -> Result<()> {
        let (at, files) = (record.displayed, &mut self.files);
        let request = PictureRequest {
            frame: record.frame,
            field: record.field,
            displayed: at,
            still: files.stills.due(at) > 0 || std::mem::take(&mut files.snapshot),
            last: false,
            jpeg: files.small.due(at) > 0,
            video: files.video.due(at),
        };
        self.output_picture(tier, request)
    }

    fn output_picture(&mut self, tier: usize, request: PictureRequest) -> Result<()> {
        if request.is_empty() {
            return Ok(());
        }
        let (gpu, target) = (&self.gpu, self.renderer.target(tier));
        let (size_px, arrangement) = (self.picture_px(tier, request), self.files.arrangement);
        let (composer, text) = (&mut self.composer, self.renderer.text());
        let read_back = &self.read_back;
        self.files.output.submit(request, |picture| {
            let texture = composer.compose(gpu, target, size_px, text, arrangement);
            read_back.read(gpu, texture, picture)
        })?;
        Ok(())
    }

    /// Size of one channel of the output picture, px, chosen so that the text on it need not be scaled: that
    /// of the video while there is one, else that of the tier for stills, else the small size.
    fn picture_px(&self, tier: usize, request: PictureRequest) -> [u32; 2] {
        match self.files.video_px {
            Some(size_px) => size_px,
            None if request.still || request.last => output_px(&TIERS[tier]),
            None => SMALL_PX,
        }
    }

    /// Publishes finished small pictures, and reports once if a file cannot be written.
    pub(super) fn publish_pictures(&mut self) -> Result<()> {
        let pictures = &mut self.channels.pictures;
        let mut sent = Ok(());
        self.files.output.collect(|of, jpeg| {
            let bytes = jpeg.len().min(MAX_PICTURE_BYTES);
            let header = PictureHeader {
                frame: of.frame,
                field: of.field,
                displayed: of.displayed,
                bytes: bytes as u64,
            };
            sent = pictures.send(bytes, |to| {
                to[..bytes].copy_from_slice(&jpeg[..bytes]);
                header
            });
        });
        sent?;
        if let (Some(problem), false) = (self.files.output.problem(), self.files.write_failed) {
            self.files.write_failed = true;
            self.shell.report.state = STATE_DEGRADED;
            self.shell.set_text(&format!("a picture file cannot be written: {problem}"));
        }
        Ok(())
    }

    /// Sends the remaining records, saves the last picture and closes the files.
    pub(super) fn finish(mut self) -> Result<()> {
        self.send_frames(Nanos::MAX)?;
        if let (true, Some(tier)) = (self.files.keeps_last, self.shown_tier) {
            self.files.output.wait_for_slot();
            let frame = self.frame.saturating_sub(1);
            let request = PictureRequest { frame, last: true, ..PictureRequest::default() };
            self.output_picture(tier, request)?;
        }
        match self.files.output.finish() {
            Some(problem) => Err(anyhow::anyhow!("a picture file could not be written: {problem}")),
            None => Ok(()),
        }
    }
}
