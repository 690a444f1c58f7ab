//! Films in H.264: Cisco's OpenH264 encodes, and the boxes of a fragmented MP4 hold what it makes.
//!
//! A fragment of a second is written in one piece once it is complete, so that a film that was not
//! closed, as after a crash, lacks its last second and can be played.

mod boxes;

use super::picture::scale_rgb;
use super::planes::{VIDEO, to_planes};
use super::video::VideoError;
use crate::readback::Picture;
use boxes::{Sample, TICKS_PER_S};
use openh264::OpenH264API;
use openh264::encoder::{
    BitRate, EncodedBitStream, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange,
    RateControlMode, VuiConfig,
};
use openh264::formats::YUVSlices;
use outputs::{GrowingFile, OutputError};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};

/// Most bits a second that are declared, for each pixel of a picture: 8 Mbit/s for two channels of
/// 640×512. Pictures of the eye take a tenth to a third of it.
const BITS_PER_S_PX: f64 = 8e6 / (2.0 * 640.0 * 512.0);
/// Time from one picture that is coded on its own to the next, s.
const KEY_S: u32 = 2;
/// Steps of quantisation, the same for every picture: the quality is constant, 45 dB in luma. Coarser
/// steps show as blocks in dark pictures.
const QUANTISATION: QpRange = QpRange::new(18, 18);
/// Bytes before each unit that OpenH264 makes.
const START_CODE: &[u8] = &[0, 0, 0, 1];
/// Kind of the unit with the parameters of the sequence, which belongs into the file's head.
const SEQUENCE: u8 = 7;
/// Kind of the one with those of pictures.
const PICTURE: u8 = 8;

/// A film being written; it appears with its first picture. All pictures have one size.
pub struct Mp4 {
    name: GrowingFile,
    file: File,
    encoder: Encoder,
    size_px: [u32; 2],
    hz: u32,
    rgb: Vec<u8>,
    planes: Vec<u8>,
    /// Parameter sets, once the first picture has brought them.
    head: Option<[Vec<u8>; 2]>,
    /// The fragment that is being collected.
    samples: Vec<Sample>,
    units: Vec<u8>,
    fragments: u32,
    /// Pictures in the fragments that were written.
    written: u64,
    /// Bytes written.
    bytes: u64,
    /// Time and place of each fragment that begins with a picture coded on its own.
    index: Vec<(u64, u64)>,
}

impl Mp4 {
    /// Begins a film of pictures of `size_px` (both even), `hz` a second.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn begin(name: GrowingFile, size_px: [u32; 2], hz: u32) -> Result<Self, VideoError> {
        let [w, h] = size_px.map(f64::from);
        let config = EncoderConfig::new()
            .bitrate(BitRate::from_bps((w * h * BITS_PER_S_PX) as u32))
            .max_frame_rate(FrameRate::from_hz(hz as f32))
            // The mode that leaves the quality to the steps, and drops no picture.
            .rate_control_mode(RateControlMode::Bufferbased)
            .intra_frame_period(IntraFramePeriod::from_num_frames(KEY_S * hz))
            .qp(QUANTISATION)
            .skip_frames(false)
            .scene_change_detect(false)
            .num_threads(1)
            .vui(VuiConfig::bt709());
        let refused = |e: openh264::Error| VideoError::Encoder {
            file: name.path().display().to_string(),
            problem: e.to_string(),
        };
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config).map_err(refused)?;
        Ok(Mp4 {
            file: name.handle()?,
            name,
            encoder,
            size_px,
            hz,
            rgb: Vec::new(),
            planes: Vec::new(),
            head: None,
            samples: Vec::new(),
            units: Vec::new(),
            fragments: 0,
            written: 0,
            bytes: 0,
            index: Vec::new(),
        })
    }

    /// Writes `picture`, scaled to the film's size, `count` times.
    ///
    /// # Errors
    /// If the encoder refuses the picture or the file cannot be written.
    pub fn write(&mut self, picture: &Picture, count: u64) -> Result<(), VideoError> {
        let [w, h] = self.size_px.map(|n| n as usize);
        scale_rgb(picture, self.size_px[0], self.size_px[1], &mut self.rgb);
        to_planes(&self.rgb, w, h, &VIDEO, &mut self.planes);
        for _ in 0..count {
            self.encode([w, h])?;
            if self.samples.len() >= self.hz as usize {
                self.write_fragment()?;
            }
        }
        Ok(())
    }

    /// Writes what is left, an index of the pictures at which a player can begin, and the length.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn finish(&mut self) -> Result<(), VideoError> {
        self.write_fragment()?;
        let Some(head) = &self.head else { return Ok(()) };
        let index = boxes::index(&self.index);
        let first = boxes::head(self.size_px, head, self.written * self.ticks());
        self.append(&index)?;
        // A pipe keeps the head that it has.
        if self.file.seek(SeekFrom::Start(0)).is_ok() {
            self.file.write_all(&first).map_err(|e| OutputError::io(self.name.path(), e))?;
        }
        Ok(())
    }

    /// Length of a picture, ticks.
    fn ticks(&self) -> u64 {
        u64::from(TICKS_PER_S / self.hz)
    }

    /// Encodes the planes once into the fragment.
    fn encode(&mut self, [w, h]: [usize; 2]) -> Result<(), VideoError> {
        let (luma, chroma) = self.planes.split_at(w * h);
        let (blue, red) = chroma.split_at(w * h / 4);
        let planes = YUVSlices::new((luma, blue, red), (w, h), (w, w / 2, w / 2));
        let coded = self.encoder.encode(&planes).map_err(|e| VideoError::Encoder {
            file: self.name.path().display().to_string(),
            problem: e.to_string(),
        })?;
        let begins = matches!(coded.frame_type(), FrameType::IDR);
        let before = self.units.len();
        let sets = take_units(&coded, &mut self.units);
        self.samples.push(Sample { bytes: (self.units.len() - before) as u32, begins });
        if let (None, [Some(sequence), Some(picture)]) = (&self.head, sets) {
            let head = [sequence, picture];
            let first = boxes::head(self.size_px, &head, 0);
            self.head = Some(head);
            self.name.appear()?;
            self.append(&first)?;
        }
        Ok(())
    }

    fn write_fragment(&mut self) -> Result<(), VideoError> {
        if self.samples.is_empty() {
            return Ok(());
        }
        let time = self.written * self.ticks();
        if self.samples[0].begins {
            self.index.push((time, self.bytes));
        }
        self.fragments += 1;
        let fragment = boxes::fragment(self.fragments, time, self.ticks() as u32, &self.samples, &self.units);
        self.written += self.samples.len() as u64;
        self.samples.clear();
        self.units.clear();
        self.append(&fragment)
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), VideoError> {
        self.file.write_all(bytes).map_err(|e| OutputError::io(self.name.path(), e))?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }
}

/// Appends the units of a coded picture, each behind its length; its parameter sets, which belong
/// into the head, come back.
fn take_units(coded: &EncodedBitStream<'_>, out: &mut Vec<u8>) -> [Option<Vec<u8>>; 2] {
    let mut sets = [None, None];
    let layers = (0..coded.num_layers()).filter_map(|l| coded.layer(l));
    for layer in layers {
        for unit in (0..layer.nal_count()).filter_map(|n| layer.nal_unit(n)) {
            let unit = unit.strip_prefix(START_CODE).unwrap_or(unit);
            match unit.first().map_or(0, |first| first & 0x1f) {
                SEQUENCE => sets[0] = Some(unit.to_vec()),
                PICTURE => sets[1] = Some(unit.to_vec()),
                _ => {
                    out.extend((unit.len() as u32).to_be_bytes());
                    out.extend_from_slice(unit);
                }
            }
        }
    }
    sets
}

#[cfg(test)]
mod tests;
