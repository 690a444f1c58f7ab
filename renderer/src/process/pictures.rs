//! Picture outputs: stills, video, and the small JPEGs of channel `pictures`.

use super::RendererShell;
use crate::compose::{SMALL_PX, output_px};
use crate::governor::TIERS;
use crate::output::PictureRequest;
use anyhow::Result;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::health::STATE_DEGRADED;
use protocol::limits::MAX_PICTURE_BYTES;
use protocol::time::Nanos;

impl RendererShell {
    /// Passes the picture to the outputs that are due.
    pub(super) fn output_frame(&mut self, tier: usize, record: &FrameRecord) -> Result<()> {
        let at = record.displayed;
        let request = PictureRequest {
            frame: record.frame,
            field: record.field,
            displayed: at,
            still: self.stills.due(at) > 0 || std::mem::take(&mut self.snapshot),
            last: false,
            jpeg: self.small.due(at) > 0,
            video: self.video.due(at),
        };
        self.output_picture(tier, request)
    }

    fn output_picture(&mut self, tier: usize, request: PictureRequest) -> Result<()> {
        if request.is_empty() {
            return Ok(());
        }
        let (gpu, target) = (&self.gpu, self.renderer.target(tier));
        let (size_px, arrangement) = (self.picture_px(tier, request), self.arrangement);
        let (composer, text) = (&mut self.composer, self.renderer.text());
        let read_back = &self.read_back;
        self.output.submit(request, |picture| {
            let texture = composer.compose(gpu, target, size_px, text, arrangement);
            read_back.read(gpu, texture, picture)
        })?;
        Ok(())
    }

    /// Size of one channel of the output picture, px, chosen so that the text on it need not be scaled: that
    /// of the video while there is one, else that of the tier for stills, else the small size.
    fn picture_px(&self, tier: usize, request: PictureRequest) -> [u32; 2] {
        match self.video_px {
            Some(size_px) => size_px,
            None if request.still || request.last => output_px(&TIERS[tier]),
            None => SMALL_PX,
        }
    }

    /// Publishes finished small pictures, and reports once if a file cannot be written.
    pub(super) fn publish_pictures(&mut self) -> Result<()> {
        let pictures = &mut self.pictures;
        let mut sent = Ok(());
        self.output.collect(|of, jpeg| {
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
        if let (Some(problem), false) = (self.output.problem(), self.write_failed) {
            self.write_failed = true;
            self.shell.report.state = STATE_DEGRADED;
            self.shell.set_text(&format!("a picture file cannot be written: {problem}"));
        }
        Ok(())
    }

    /// Sends the remaining records, saves the last picture and closes the files.
    pub(super) fn finish(mut self) -> Result<()> {
        self.send_frames(Nanos::MAX)?;
        if let (true, Some(tier)) = (self.keeps_last, self.shown_tier) {
            self.output.wait_for_slot();
            let frame = self.frame.saturating_sub(1);
            let request = PictureRequest { frame, last: true, ..PictureRequest::default() };
            self.output_picture(tier, request)?;
        }
        match self.output.finish() {
            Some(problem) => Err(anyhow::anyhow!("a picture file could not be written: {problem}")),
            None => Ok(()),
        }
    }
}
