//! Estimation of a colour class from sample pictures.
//!
//! Only colourful pixels of the most frequent hue count: those with at least half the chroma of the
//! most colourful ones. Their medians are the reference, and the spread of their hues gives the
//! tolerance. Highlights, shadows and some background in a sample therefore have no effect.

use super::Class;
use super::convert::GREY;
use crate::input::{Picture, bin_of_rank};
use protocol::blobs::Colour;

/// Most samples of one picture.
const MOST_SAMPLES: usize = 200_000;
/// Share of samples, in 1/1000, above the quantile of chroma that counts as colourful: in a region
/// of the colour, and in a whole picture, of which the colour may be a small part.
const COLOURFUL: [usize; 2] = [50, 5];
/// Bins of hue.
const BINS: usize = 72;
/// Largest difference from the most frequent hue within one colour, degrees.
const SAME_HUE_DEG: f64 = 30.0;
/// Tolerance: multiple of the standard deviation of hue, and its bounds, degrees.
const TOLERANCE: (f64, f64, f64) = (4.0, 12.0, 60.0);
/// Least chroma of a class: share of its median, in 1/8, and the least that differs from grey.
const CHROMA_SHARE_8: u32 = 3;
const LEAST_CHROMA: u32 = 8;
/// Fewest samples of a class.
const FEWEST: usize = 16;
/// The median deviation of a normal distribution is σ over this.
const MAD_TO_SIGMA: f64 = 1.482_6;

/// A part of a picture, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First line.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Lines.
    pub height: usize,
}

impl Region {
    /// Defect of the region in `picture`, if any.
    pub fn defect(&self, picture: &Picture) -> Option<String> {
        let inside = |at: usize, length: usize, side: usize| length > 0 && at.saturating_add(length) <= side;
        let fits = inside(self.x, self.width, picture.width) && inside(self.y, self.height, picture.height);
        let (Region { x, y, width, height }, Picture { width: w, height: h, .. }) = (self, picture);
        (!fits).then(|| format!("expected a region within 0,0,{w},{h}, found {x},{y},{width},{height}"))
    }
}

/// Samples of one colour, from any number of pictures.
#[derive(Debug, Clone, Default)]
pub struct Samples(Vec<[u8; 3]>);

impl Samples {
    /// Adds samples that are known to be of the colour.
    pub fn add(&mut self, samples: impl IntoIterator<Item = [u8; 3]>) {
        self.0.extend(samples);
    }

    /// Adds the samples of `colour` in a region, or in the whole picture.
    pub fn take(&mut self, picture: &Picture, region: Option<Region>, colour: Colour) {
        let whole = Region { x: 0, y: 0, width: picture.width, height: picture.height };
        let Region { x, y, width, height } = region.unwrap_or(whole);
        let every = (width * height).div_ceil(MOST_SAMPLES).max(1);
        let all = (0..width * height).step_by(every).map(|i| picture.pixel(x + i % width, y + i / width));
        let all: Vec<[u8; 3]> = all.collect();
        let permille = COLOURFUL[usize::from(region.is_none())];
        if colour == Colour::White {
            self.0.extend(bright(&all, permille));
        } else {
            self.0.extend(one_hue(&colourful(&all, permille)));
        }
    }

    /// The class of the samples.
    ///
    /// # Errors
    /// Where there are too few samples, or their chroma is too near to grey.
    pub fn class(&self, colour: Colour) -> Result<Class, String> {
        if self.0.len() < FEWEST {
            let (name, found) = (colour.name(), self.0.len());
            return Err(format!("expected at least {FEWEST} samples of {name}, found {found}"));
        }
        let at = |k: usize, percent: usize| quantile(self.0.iter().map(|s| s[k]), percent * 10);
        // Three quarters of a marker are at least this bright.
        let y = at(0, 25);
        if colour == Colour::White {
            return Ok(Class { reference: [y, GREY, GREY], ..Class::of_reference(colour) });
        }
        let reference = [y, at(1, 50), at(2, 50)];
        let chroma = chroma2(&reference).isqrt();
        if chroma < 2 * LEAST_CHROMA {
            let (name, least) = (colour.name(), 2 * LEAST_CHROMA);
            return Err(format!("expected samples of {name} at least {least} from grey, found {chroma}"));
        }
        let middle = hue_deg(&reference);
        let mut off: Vec<f64> = self.0.iter().map(|s| apart_deg(hue_deg(s), middle)).collect();
        off.sort_by(f64::total_cmp);
        let (times, least, most) = TOLERANCE;
        let tolerance = (times * MAD_TO_SIGMA * off[off.len() / 2]).clamp(least, most);
        let least_chroma = (chroma * CHROMA_SHARE_8 / 8).max(LEAST_CHROMA) as u8;
        Ok(Class { colour, reference, least_chroma, tolerance_deg: tolerance.round() })
    }
}

/// Square of the distance from grey.
fn chroma2(sample: &[u8; 3]) -> u32 {
    let [_, cb, cr] = sample.map(|v| u32::from(v.abs_diff(GREY)));
    cb * cb + cr * cr
}

/// Angle from the Cb axis, degrees, −180 to 180.
pub fn hue_deg(sample: &[u8; 3]) -> f64 {
    let [_, cb, cr] = sample.map(|v| f64::from(v) - f64::from(GREY));
    libm::atan2(cr, cb).to_degrees()
}

/// Difference of two hues, 0 to 180.
pub fn apart_deg(a: f64, b: f64) -> f64 {
    let d = (a - b).abs() % 360.0;
    d.min(360.0 - d)
}

/// The value below which a share of the values lies.
fn quantile(values: impl Iterator<Item = u8>, permille: usize) -> u8 {
    let mut counts = [0; 256];
    values.for_each(|v| counts[usize::from(v)] += 1);
    let rank = counts.iter().sum::<u32>() as usize * permille / 1000;
    bin_of_rank(&counts, rank as u64).unwrap_or(255) as u8
}

fn colourful(all: &[[u8; 3]], permille: usize) -> Vec<[u8; 3]> {
    let distance = |s: &[u8; 3]| chroma2(s).isqrt().min(255) as u8;
    let most = quantile(all.iter().map(distance), 1000 - permille);
    let least = (most / 2).max(LEAST_CHROMA as u8);
    all.iter().filter(|&s| distance(s) >= least).copied().collect()
}

fn one_hue(samples: &[[u8; 3]]) -> impl Iterator<Item = [u8; 3]> {
    let bin = |s: &[u8; 3]| ((hue_deg(s) + 180.0) / 360.0 * BINS as f64) as usize % BINS;
    let mut counts = [0u64; BINS];
    // Weighted by chroma², because the hue of a colourful sample is more certain.
    samples.iter().for_each(|s| counts[bin(s)] += u64::from(chroma2(s)));
    let around = |i: usize| counts[(i + BINS - 1) % BINS] + 2 * counts[i] + counts[(i + 1) % BINS];
    let peak = (0..BINS).max_by_key(|&i| around(i)).unwrap_or(0);
    let middle = (peak as f64 + 0.5) / BINS as f64 * 360.0 - 180.0;
    samples.iter().filter(move |s| apart_deg(hue_deg(s), middle) <= SAME_HUE_DEG).copied()
}

/// The brightest grey samples.
fn bright(all: &[[u8; 3]], permille: usize) -> Vec<[u8; 3]> {
    let limit = u32::from(super::LEAST_CHROMA);
    let grey: Vec<[u8; 3]> = all.iter().filter(|s| chroma2(s) < limit * limit).copied().collect();
    let most = quantile(grey.iter().map(|s| s[0]), 1000 - permille);
    grey.into_iter().filter(|s| s[0] >= most - most / 4).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::ColourTable;
    use protocol::fields::DARK;

    /// A disc of a colour with noise, shading and a highlight, before a ground of another colour.
    fn disc(colour: [u8; 3], ground: [u8; 3]) -> Picture {
        let (width, height) = (80, 60);
        let mut picture = Picture { width, height, ..Picture::default() };
        for i in 0..width * height {
            let (x, y) = (i % width, i / width);
            let (dx, dy) = (x as i32 - 40, y as i32 - 30);
            let inside = dx * dx + dy * dy <= 400;
            let highlight = (dx - 5) * (dx - 5) + (dy + 5) * (dy + 5) <= 25;
            let shade = if inside { dx } else { 0 };
            let grain = (i * 7 % 5) as i32 - 2;
            let ycc = if highlight {
                [230, 128, 128]
            } else if inside {
                colour
            } else {
                ground
            };
            let [y, cb, cr] = ycc.map(|v| (i32::from(v) + grain).clamp(16, 235) as u8);
            picture.luma.push((i32::from(y) + shade).clamp(16, 235) as u8);
            if x % 2 == 0 {
                picture.blue.push(cb);
                picture.red.push(cr);
            }
        }
        picture
    }

    #[test]
    fn reference_colours_are_learnt_without_a_region() {
        let mut classes = Vec::new();
        for colour in Colour::ALL {
            let mut samples = Samples::default();
            samples.take(&disc(colour.reference(), [DARK, 128, 128]), None, colour);
            let class = samples.class(colour).unwrap();
            let [y, cb, cr] = colour.reference();
            let [fy, fb, fr] = class.reference;
            assert!(fb.abs_diff(cb) <= 2 && fr.abs_diff(cr) <= 2, "{colour:?}: {class:?}");
            assert!(fy <= y.saturating_add(5).max(230) && fy >= y / 2, "{colour:?}: {class:?}");
            classes.push(class);
        }
        let table = ColourTable::of_classes(&classes);
        for colour in Colour::ALL.into_iter().filter(|&c| c != Colour::White) {
            let [_, cb, cr] = colour.reference();
            assert_eq!(table.class(cb, cr), colour as u8);
        }
    }

    #[test]
    fn a_colourful_ground_is_no_class_where_a_region_shows_another_one() {
        let [red, green] = [Colour::Red, Colour::Green].map(Colour::reference);
        let picture = disc(red, green);
        let mut samples = Samples::default();
        samples.take(&picture, Some(Region { x: 22, y: 12, width: 36, height: 36 }), Colour::Red);
        let class = samples.class(Colour::Red).unwrap();
        assert!(class.reference[2].abs_diff(red[2]) <= 2, "{class:?}");
        let table = ColourTable::of_classes(&[class]);
        assert_eq!([table.class(red[1], red[2]), table.class(green[1], green[2])], [Colour::Red as u8, 0]);
    }

    #[test]
    fn grey_pictures_teach_no_colour_and_regions_are_checked() {
        let grey = disc([200, 128, 128], [DARK, 128, 128]);
        let mut samples = Samples::default();
        samples.take(&grey, None, Colour::Red);
        assert!(samples.class(Colour::Red).unwrap_err().contains("red"));
        let outside = Region { x: 70, y: 0, width: 11, height: 5 };
        assert!(outside.defect(&grey).unwrap().contains("found 70,0,11,5"));
        assert!(Region { x: usize::MAX, ..outside }.defect(&grey).is_some());
        assert!(Region { width: 0, ..outside }.defect(&grey).is_some());
    }
}
