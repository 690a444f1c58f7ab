//! Synthesises the pixels of a field: noise in the dark, and markers as blurred, shaded discs.
//!
//! [`model`] gives the mean and the variance of a pixel; this module fills a field with them and
//! allocates nothing. Pixels are YCbCr 4:2:2 in planes. The same seed, camera and field number give
//! the same picture to the bit.

mod light;
pub mod model;
mod noise;

use crate::projection::MarkerImage;
pub use light::Light;
pub use model::{BLACK, ImageModel};
use model::{Carrier, Disc, GREY, carried};
use nalgebra::Vector2;
use noise::{Noise, STEP_BITS, STEPS};
use protocol::fields::FieldPicture;
use rig::sensor::Sensor;
use std::ops::DerefMut;

/// Patches that a field can hold; further ones are left out.
pub const MAX_PATCHES: usize = 64;

/// A marker as it is painted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Where, how large, of which colour; at the middle of the exposure.
    pub image: MarkerImage,
    /// Movement during the exposure, px of the frame.
    pub smear_px: Vector2<f64>,
    /// Illumination as a share of that of the reference colours.
    pub brightness: f64,
}

impl From<MarkerImage> for Patch {
    /// A marker that stands still, lit as it should be.
    fn from(image: MarkerImage) -> Self {
        Patch { image, smear_px: Vector2::zeros(), brightness: 1.0 }
    }
}

/// Draws fields of one size.
pub struct Painter {
    model: ImageModel,
    seed: u64,
    luma_noise: Noise,
    chroma_noise: Noise,
    /// Mean luma of the background's columns in the middle line, in 1/64 levels.
    ground_row: Vec<i16>,
    /// The carrier's turn at every column.
    carrier_turns: Vec<[f64; 2]>,
    /// One over the noise of the background, in 1/64 levels.
    per_dark: f64,
    size_px: [usize; 2],
}

impl Painter {
    /// Prepares the noise for frames of `frame_px`, with the usual image model.
    pub fn new(frame_px: [u32; 2], seed: u64) -> Self {
        Self::with_model(frame_px, seed, ImageModel::default())
    }

    /// For the fields of a camera.
    pub fn of_sensor(sensor: &Sensor, seed: u64) -> Self {
        Self::with_model(sensor.size_px, seed, ImageModel::of_scan(sensor.scan))
    }

    /// The same with another image model.
    pub fn with_model(frame_px: [u32; 2], seed: u64, model: ImageModel) -> Self {
        let [width, height] = [frame_px[0] as usize & !1, frame_px[1] as usize / model.per_row() as usize];
        let dark = model.luma_variance(model.background).sqrt();
        let middle = height as f64 / 2.0;
        let fixed = |x: usize| (model.ground([width, height], x as f64, middle) * STEPS).round() as i16;
        Painter {
            luma_noise: Noise::white(seed, 0, width * height, dark),
            chroma_noise: Noise::narrow(seed, 1, width / 2 * height, model.chroma_noise),
            ground_row: (0..width).map(fixed).collect(),
            carrier_turns: (0..width).map(|x| Carrier::turn(x as f64)).collect(),
            per_dark: if dark > 0.0 { 1.0 / (dark * STEPS) } else { 0.0 },
            size_px: [width, height],
            model,
            seed,
        }
    }

    /// Draws field `number` of camera `camera`: the lines `2·y + parity` of the frame, or all. Markers come
    /// farthest first, so that near ones hide far ones; they stand still.
    pub fn draw<B: DerefMut<Target = [u8]>>(
        &self,
        markers: &[MarkerImage],
        camera: u32,
        number: u64,
        picture: &mut FieldPicture<B>,
    ) {
        self.paint(markers.iter().copied().map(Patch::from), &Light::default(), camera, number, picture);
    }

    /// The same with movement and light. `picture` must be as wide as the painter's fields; it may
    /// end after any line.
    pub fn paint<B: DerefMut<Target = [u8]>>(
        &self,
        patches: impl Iterator<Item = Patch>,
        light: &Light,
        camera: u32,
        number: u64,
        picture: &mut FieldPicture<B>,
    ) {
        let key = |plane: u64| self.seed ^ number.wrapping_mul(3) ^ (u64::from(camera) << 40) ^ (plane << 50);
        let [width, height] = self.size_px;
        let noise = [
            self.luma_noise.stretch(key(0), width * height),
            self.chroma_noise.stretch(key(1), width / 2 * height),
            self.chroma_noise.stretch(key(2), width / 2 * height),
        ];
        self.fill(light, &noise, picture);
        let mut discs = Discs::default();
        patches.filter_map(|p| Disc::of(&self.model, &p, number, light)).for_each(|d| discs.push(d, picture));
        for i in 0..discs.count {
            self.draw_disc(&discs, i, light, number, &noise, picture);
        }
    }

    /// Background and its noise.
    fn fill<B: DerefMut<Target = [u8]>>(
        &self,
        light: &Light,
        noise: &[&[i16]; 3],
        picture: &mut FieldPicture<B>,
    ) {
        let [width, height] = self.size_px;
        let whole = |v: i16| (v.saturating_add(1 << (STEP_BITS - 1)) >> STEP_BITS).clamp(0, 255) as u8;
        // Light changes the background as a whole: the gradient's own change is far below a level.
        let lit = light.gain * (self.model.background - BLACK) + BLACK - self.model.background;
        for y in 0..picture.height {
            let down = self.model.gradient[1] * (y as f64 / height as f64 - 0.5);
            let offset = ((down + lit) * STEPS).round() as i16;
            let line = y * width..(y + 1) * width;
            let pixels = picture.luma[line.clone()].iter_mut().zip(&self.ground_row).zip(&noise[0][line]);
            for ((pixel, ground), grain) in pixels {
                *pixel = whole(ground.saturating_add(offset).saturating_add(*grain));
            }
        }
        for (plane, noise) in [(&mut picture.blue, noise[1]), (&mut picture.red, noise[2])] {
            for (pixel, grain) in plane.iter_mut().zip(noise) {
                *pixel = whole(grain.saturating_add(128 * STEPS as i16));
            }
        }
    }

    /// The pixels that disc `i` can reach, with every disc that lies there. A pixel of two discs
    /// is drawn twice, with the same result.
    fn draw_disc<B: DerefMut<Target = [u8]>>(
        &self,
        discs: &Discs,
        i: usize,
        light: &Light,
        number: u64,
        noise: &[&[i16]; 3],
        picture: &mut FieldPicture<B>,
    ) {
        let [xs, ys] = discs.boxes[i].clone();
        for y in ys {
            let carrier = Carrier::at(number, y);
            // A chroma sample lies on every second pixel.
            for pair in xs.start / 2..xs.end.div_ceil(2).min(picture.width / 2) {
                let line = y as f64;
                let beside = || discs.beside(i);
                let chroma =
                    beside().fold(GREY, |chroma, disc| disc.chroma_over(chroma, (2 * pair) as f64, line));
                for x in [2 * pair, 2 * pair + 1] {
                    let ground = self.model.ground(self.size_px, x as f64, line);
                    let ground = light.gain * (ground - BLACK) + BLACK;
                    let mean = beside().fold(ground, |mean, disc| disc.luma_over(mean, x as f64, line));
                    let carried = carried(chroma, carrier.axes(self.carrier_turns[x]));
                    if mean == ground && carried == 0.0 {
                        continue;
                    }
                    let mean = mean + self.model.crosstalk * carried;
                    let at = y * picture.width + x;
                    let grain =
                        f64::from(noise[0][at]) * self.model.luma_variance(mean).sqrt() * self.per_dark;
                    // `as` saturates at 0 and 255, as the converter does.
                    picture.luma[at] = (mean + grain + 0.5) as u8;
                }
                let detail = self.model.crosstalk * detail(picture.line(y).0, 2 * pair);
                let axes = carrier.axes(self.carrier_turns[2 * pair]);
                let at = y * (picture.width / 2) + pair;
                for (plane, k) in [(&mut picture.blue, 0), (&mut picture.red, 1)] {
                    let grain = f64::from(noise[k + 1][at]) / STEPS;
                    plane[at] = (chroma[k] + detail * axes[k] + grain + 0.5) as u8;
                }
            }
        }
    }
}

/// Detail of a line that a decoder takes for colour: half the second difference.
fn detail(luma: &[u8], x: usize) -> f64 {
    let at = |i: usize| f64::from(luma[i.min(luma.len() - 1)]);
    at(x) - (at(x.saturating_sub(1)) + at(x + 1)) / 2.0
}

/// The discs of a field and the pixels each can reach.
struct Discs {
    count: usize,
    discs: [Option<Disc>; MAX_PATCHES],
    boxes: [[std::ops::Range<usize>; 2]; MAX_PATCHES],
    /// One bit for each disc whose box meets this one's.
    beside: [u64; MAX_PATCHES],
}

const _: () = assert!(MAX_PATCHES <= u64::BITS as usize);

impl Default for Discs {
    fn default() -> Self {
        Discs {
            count: 0,
            discs: [None; MAX_PATCHES],
            boxes: std::array::from_fn(|_| [0..0, 0..0]),
            beside: [0; MAX_PATCHES],
        }
    }
}

impl Discs {
    fn push<B>(&mut self, disc: Disc, picture: &FieldPicture<B>) {
        let new = self.count;
        if new == MAX_PATCHES {
            return;
        }
        self.boxes[new] = disc.box_px(picture);
        self.discs[new] = Some(disc);
        self.beside[new] = 1 << new;
        let meet =
            |a: &std::ops::Range<usize>, b: &std::ops::Range<usize>| a.start < b.end && b.start < a.end;
        for old in 0..new {
            if (0..2).all(|axis| meet(&self.boxes[old][axis], &self.boxes[new][axis])) {
                self.beside[old] |= 1 << new;
                self.beside[new] |= 1 << old;
            }
        }
        self.count += 1;
    }

    /// Every disc that may share a pixel with disc `i`, farthest first, itself among them.
    fn beside(&self, i: usize) -> impl Iterator<Item = &Disc> {
        let mut left = self.beside[i];
        std::iter::from_fn(move || {
            let next = (left != 0).then(|| left.trailing_zeros() as usize)?;
            left &= left - 1;
            self.discs[next].as_ref()
        })
    }
}

#[cfg(test)]
mod tests;
