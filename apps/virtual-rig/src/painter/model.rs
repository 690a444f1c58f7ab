//! The image model: mean and variance of a pixel.
//!
//! A field `k` samples the light on the lines `2·y + (k mod 2)` of the frame, or on all where it is progressive; then
//! `b²/4` below is `b²`. With a marker's
//! outline an ellipse of centre `c` (px of the field, column and line) and shape `Q`
//! (`dᵀ·Q⁻¹·d = 1` on the outline), the luma of pixel `p` has the mean
//!
//! ```text
//! μ(p) = B(p) + (S(p) − B(p))·m(p) + X(p)
//! m(p) = mean over the exposure of Φ(−δ(p)/σ)            share of the pixel that the marker covers
//! δ(p) = (q − √q)/|Q⁻¹d|,  d = p − c,  q = dᵀQ⁻¹d        signed distance from the outline, first order
//! σ²   = nᵀΣn,  n = Q⁻¹d/|Q⁻¹d|                          spread across the outline
//! Σ    = diag(b² + 1/12, b²/4 + 1/12) + v·vᵀ/12          lens, the pixel's own extent, movement
//! S(p) = Y·(1 − r·min(q, 1) + s·clamp(dx/hx, −1, 1))     lit surface: darker rim, brighter side
//! B(p) = background + gradient·(p/size − ½)
//! ```
//!
//! `b` is the lens's blur in px of the frame (a line of the field is two of the frame, hence a
//! quarter of the variance), `v` the movement during one exposure, in px of the field; a movement
//! of more than 1.5 px is cut into equal parts whose `m` are averaged. `hx` is half the width of
//! the outline, Φ the normal distribution. `X` is what is left of the colour carrier of phase ωt,
//! `crosstalk·((Cb − 128)·sin ωt ± (Cr − 128)·cos ωt)`. The variance is
//!
//! ```text
//! var(p) = read² + shot·max(0, μ(p) − 16)  (+ 1/12 for rounding to whole levels)
//! ```
//!
//! independent from pixel to pixel, because the luma filter is wider than the pixel's band. Chroma
//! has the same form with a far wider spread along the line (PAL carries colour with 1.3 MHz) and
//! over two lines (delay-line decoder). Several markers are laid over one another, the nearest
//! last.

use super::{FieldPicture, Light, Patch};
use protocol::blobs::{WHOLE_FRAME, field_line};
use protocol::fields::DARK;
use rig::sensor::Scan;

use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use std::sync::LazyLock;

/// Black of BT.601: no light.
pub const BLACK: f64 = 16.0;
/// No colour: Cb, Cr.
pub(super) const GREY: [f64; 2] = [128.0; 2];
/// Distance from the edge in σ of the blur beyond which a pixel lies wholly inside or outside.
const FAR: f64 = 3.5;
/// Entries of the table of Φ for each σ; linear interpolation is then right to 2 millionths.
const PER_SIGMA: usize = 128;
const PHI_ENTRIES: usize = 2 * 7 * PER_SIGMA / 2 + 2;
const _: () = assert!(PHI_ENTRIES as f64 > 2.0 * FAR * PER_SIGMA as f64 + 1.0);
/// Longest movement that counts as a spread, px of the field; a longer one is cut into parts.
const WHOLE_SMEAR_PX: f64 = 1.5;
/// Parts that one exposure is cut into at most.
const MOST_PARTS: usize = 8;
/// The PAL colour carrier in cycles per pixel of 13.5 MHz.
const CARRIER_PER_PX: f64 = 4.433_618_75 / 13.5;
/// Turn of the carrier from line to line and from field to field of 312.5 lines, cycles.
const CARRIER_PER_LINE: f64 = 0.7516;
const CARRIER_PER_FIELD: f64 = 312.5 * 283.7516;

/// Parameters of optics, sensor and PAL coding. The defaults are a good industrial camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageModel {
    /// Blur of lens and electronics: σ of a Gaussian, px of the frame, the same in both axes.
    pub blur_px: f64,
    /// Noise of the unlit sensor: σ, grey levels.
    pub read_noise: f64,
    /// Shot noise: variance for each grey level above black, levels²/level. 1/50 is a full well of
    /// some 11,000 electrons.
    pub shot_noise: f64,
    /// Noise of a chroma sample: σ, grey levels, limited to the band of chroma.
    pub chroma_noise: f64,
    /// Share by which a marker's right edge is brighter than its middle, and its left edge darker;
    /// 0 to 0.04 is usual.
    pub side_shade: f64,
    /// Share by which a marker is darker at its rim than in its middle.
    pub rim_shade: f64,
    /// Luma of the background, grey levels.
    pub background: f64,
    /// Change of the background from the left to the right border and from top to bottom, grey
    /// levels.
    pub gradient: [f64; 2],
    /// Blur of chroma along the line: σ of a Gaussian, px. 1.38 px is −3 dB at 1.3 MHz.
    pub chroma_blur_px: f64,
    /// Share of chroma's carrier that is left in luma, and of luma's detail that gets into chroma.
    pub crosstalk: f64,
    /// Motion blur over the exposure.
    pub motion: bool,
    /// Which lines of the frame a field has.
    pub scan: Scan,
}

impl Default for ImageModel {
    fn default() -> Self {
        ImageModel {
            blur_px: 0.7,
            read_noise: 2.4,
            shot_noise: 0.02,
            chroma_noise: 1.5,
            side_shade: 0.03,
            rim_shade: 0.05,
            background: DARK as f64,
            gradient: [4.0, 2.0],
            chroma_blur_px: 1.38,
            crosstalk: 0.02,
            motion: true,
            scan: Scan::Interlaced,
        }
    }
}

impl ImageModel {
    /// Of a camera: what has no lines between its lines does not come through a PAL coder either, so that colours are
    /// as sharp as the sensor's filters leave them and nothing of a carrier is left.
    pub fn of_scan(scan: Scan) -> Self {
        match scan {
            Scan::Interlaced => Self::default(),
            Scan::Progressive => ImageModel { scan, chroma_blur_px: 0.5, crosstalk: 0.0, ..Self::default() },
        }
    }

    /// Lines of the frame for each line of a field.
    pub(super) fn per_row(&self) -> f64 {
        if self.scan == Scan::Progressive { 1.0 } else { 2.0 }
    }

    /// Parity of field `number`.
    fn parity(&self, number: u64) -> u32 {
        if self.scan == Scan::Progressive { WHOLE_FRAME } else { (number & 1) as u32 }
    }

    /// Expected luma of the pixel in `column` and `line` of field `number`, with one marker in it,
    /// in a field of `size_px` (columns, lines). Not clipped to the converter's range.
    pub fn mean_luma(&self, patch: &Patch, number: u64, size_px: [usize; 2], column: f64, line: f64) -> f64 {
        let ground = self.ground(size_px, column, line);
        let Some(disc) = Disc::of(self, patch, number, &Light::default()) else { return ground };
        // Chroma is sampled on every second pixel.
        let chroma = disc.chroma_over(GREY, column - column % 2.0, line);
        let axes = Carrier::at(number, line as usize).axes(Carrier::turn(column));
        disc.luma_over(ground, column, line) + self.crosstalk * carried(chroma, axes)
    }

    /// Variance of a pixel of expected luma `mean`, levels², before rounding.
    pub fn luma_variance(&self, mean: f64) -> f64 {
        self.read_noise * self.read_noise + self.shot_noise * (mean - BLACK).max(0.0)
    }

    /// Expected luma of the background.
    pub(super) fn ground(&self, size_px: [usize; 2], column: f64, line: f64) -> f64 {
        let place = |at: f64, n: usize| at / n as f64 - 0.5;
        self.background
            + self.gradient[0] * place(column, size_px[0])
            + self.gradient[1] * place(line, size_px[1])
    }
}

/// Phase of the colour carrier on a line: `U·sin(ωt) ± V·cos(ωt)`, the sign alternating from line
/// to line. What a decoder leaves of it in luma crawls as dots along coloured edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Carrier {
    /// Sine and cosine at the first column.
    start: [f64; 2],
    sign: f64,
}

impl Carrier {
    /// On line `line` of field `number`.
    pub(super) fn at(number: u64, line: usize) -> Self {
        // Eight fields are one round of the carrier.
        let turns = (number % 8) as f64 * CARRIER_PER_FIELD + line as f64 * CARRIER_PER_LINE;
        let angle = TAU * (turns - turns.floor());
        let sign = if line.is_multiple_of(2) { 1.0 } else { -1.0 };
        Carrier { start: [libm::sin(angle), libm::cos(angle)], sign }
    }

    /// Sine and cosine of its turn since the first column.
    pub(super) fn turn(column: f64) -> [f64; 2] {
        let angle = TAU * CARRIER_PER_PX * column;
        [libm::sin(angle), libm::cos(angle)]
    }

    /// The axes of U and V after a turn.
    pub(super) fn axes(&self, turn: [f64; 2]) -> [f64; 2] {
        let ([sin, cos], [s, c]) = (self.start, turn);
        [sin * c + cos * s, self.sign * (cos * c - sin * s)]
    }
}

/// The carrier of a colour along `axes`.
pub(super) fn carried(chroma: [f64; 2], axes: [f64; 2]) -> f64 {
    (chroma[0] - GREY[0]) * axes[0] + (chroma[1] - GREY[1]) * axes[1]
}

/// How the outline of a disc is spread.
#[derive(Debug, Clone, Copy)]
struct Edge {
    /// Σ.
    spread: Matrix2<f64>,
    /// `q` up to which a pixel certainly lies wholly inside, and from which wholly outside.
    sure: [f64; 2],
    /// The same during the whole movement.
    always: [f64; 2],
}

impl Edge {
    /// Of spread `spread` about the outline of `metric`, which moves by `smear`. With |Q⁻¹d|² ≤
    /// λ(Q⁻¹)·q and nᵀΣn ≤ λ(Σ), δ/σ is at least |√q − 1|/√(λ(Σ)·λ(Q⁻¹)); a shift by `s` changes √q
    /// by at most |s|·√λ(Q⁻¹).
    fn new(spread: Matrix2<f64>, metric: &Matrix2<f64>, smear: &Vector2<f64>) -> Self {
        let steepest = largest(metric).sqrt();
        let reach = FAR * largest(&spread).sqrt() * steepest;
        let square = |reach: f64| [(1.0 - reach).max(0.0).powi(2), (1.0 + reach).powi(2)];
        Edge { spread, sure: square(reach), always: square(reach + smear.norm() / 2.0 * steepest) }
    }
}

/// Largest eigenvalue of a symmetric matrix.
fn largest(m: &Matrix2<f64>) -> f64 {
    let (mean, half) = ((m.m11 + m.m22) / 2.0, (m.m11 - m.m22) / 2.0);
    mean + (half * half + m.m12 * m.m12).sqrt()
}

/// The normal distribution's Φ(−z), from a table.
fn phi_of_minus(z: f64) -> f64 {
    static TABLE: LazyLock<[f64; PHI_ENTRIES]> = LazyLock::new(|| {
        std::array::from_fn(|i| {
            let z = i as f64 / PER_SIGMA as f64 - FAR;
            0.5 * libm::erfc(z * FRAC_1_SQRT_2)
        })
    });
    let place = (z.clamp(-FAR, FAR) + FAR) * PER_SIGMA as f64;
    let i = place as usize;
    let share = place - i as f64;
    TABLE[i] + (TABLE[i + 1] - TABLE[i]) * share
}

/// A marker in pixels of one field.
#[derive(Debug, Clone, Copy)]
pub(super) struct Disc {
    /// Y, Cb, Cr as lit.
    pub(super) colour: [f64; 3],
    centre: Vector2<f64>,
    half: Vector2<f64>,
    /// Inverse shape: `dᵀ·metric·d = 1` on the outline.
    metric: Matrix2<f64>,
    luma_edge: Edge,
    chroma_edge: Edge,
    /// Movement in one exposure, and the parts it is cut into.
    smear: Vector2<f64>,
    parts: usize,
    /// Side and rim shading.
    shade: [f64; 2],
}

impl Disc {
    /// The patch in field `number` under `light`; `None` where its outline is no area.
    pub(super) fn of(model: &ImageModel, patch: &Patch, number: u64, light: &Light) -> Option<Self> {
        // Lines of the field lie two lines of the frame apart, where it is interlaced.
        let per_row = model.per_row();
        let squeeze = Matrix2::new(1.0, 0.0, 0.0, 1.0 / per_row);
        let shape = squeeze * patch.image.shape_px2 * squeeze;
        let centre = patch.image.centre_px;
        let smear = if model.motion { squeeze * patch.smear_px } else { Vector2::zeros() };
        let parts = ((smear.norm() / WHOLE_SMEAR_PX).ceil() as usize).clamp(1, MOST_PARTS);
        let part = smear / parts as f64;
        let pixel = 1.0 / 12.0;
        let lens = Vector2::new(model.blur_px, model.blur_px / per_row).map(|b| b * b + pixel);
        let spread = Matrix2::from_diagonal(&lens) + part * part.transpose() / 12.0;
        // A chroma sample is two pixels wide and the mean of two lines.
        let wide = model.chroma_blur_px * model.chroma_blur_px;
        let chroma = Matrix2::new(wide + 3.0 * pixel, 0.0, 0.0, 3.0 * pixel);
        let metric = shape.try_inverse()?;
        Some(Disc {
            colour: light.on(patch.image.colour.reference(), patch.brightness),
            centre: Vector2::new(centre.x, field_line(centre.y, model.parity(number))),
            half: Vector2::new(shape.m11.sqrt(), shape.m22.sqrt()),
            luma_edge: Edge::new(spread, &metric, &smear),
            chroma_edge: Edge::new(spread + chroma, &metric, &smear),
            metric,
            smear,
            parts,
            shade: [model.side_shade, model.rim_shade],
        })
    }

    /// Columns and lines that the disc can reach in chroma or luma.
    pub(super) fn box_px<B>(&self, picture: &FieldPicture<B>) -> [std::ops::Range<usize>; 2] {
        let range = |axis: usize, n: usize| {
            let reach = self.half[axis]
                + FAR * self.chroma_edge.spread[(axis, axis)].sqrt()
                + self.smear[axis].abs() / 2.0
                + 1.0;
            let from = (self.centre[axis] - reach).floor().max(0.0) as usize;
            let to = (self.centre[axis] + reach).ceil().max(0.0) as usize + 1;
            from.min(n)..to.min(n)
        };
        [range(0, picture.width), range(1, picture.height)]
    }

    /// `ground` with the disc over it.
    pub(super) fn luma_over(&self, ground: f64, x: f64, y: f64) -> f64 {
        let cover = self.cover(x, y, &self.luma_edge);
        if cover <= 0.0 {
            return ground;
        }
        let d = Vector2::new(x, y) - self.centre;
        let rim = d.dot(&(self.metric * d)).min(1.0);
        let side = (d.x / self.half.x).clamp(-1.0, 1.0);
        let lit = self.colour[0] * (1.0 - self.shade[1] * rim + self.shade[0] * side);
        ground + (lit - ground) * cover
    }

    /// `ground` (Cb, Cr) with the disc over it.
    pub(super) fn chroma_over(&self, ground: [f64; 2], x: f64, y: f64) -> [f64; 2] {
        let cover = self.cover(x, y, &self.chroma_edge);
        [0, 1].map(|k| ground[k] + (self.colour[k + 1] - ground[k]) * cover)
    }

    /// Mean share covered over the exposure.
    fn cover(&self, x: f64, y: f64, edge: &Edge) -> f64 {
        let d = Vector2::new(x, y) - self.centre;
        let q = d.dot(&(self.metric * d));
        let [inside, outside] = edge.always;
        if q >= outside || q <= inside {
            return if q >= outside { 0.0 } else { 1.0 };
        }
        if self.parts == 1 {
            return self.cover_at(d, edge);
        }
        let parts = self.parts as f64;
        let moved = |i: usize| self.smear * ((i as f64 + 0.5) / parts - 0.5);
        (0..self.parts).map(|i| self.cover_at(d - moved(i), edge)).sum::<f64>() / parts
    }

    /// Φ(−δ/σ) at `d` from the centre.
    fn cover_at(&self, d: Vector2<f64>, edge: &Edge) -> f64 {
        let slope = self.metric * d;
        let q = d.dot(&slope);
        let [inside, outside] = edge.sure;
        if q >= outside {
            return 0.0;
        }
        if q <= inside || q < 1e-9 {
            return 1.0;
        }
        // δ/σ with δ = (q − √q)/|slope| and σ² = slopeᵀ·Σ·slope/|slope|².
        let z = (q - q.sqrt()) / slope.dot(&(edge.spread * slope)).sqrt();
        if z >= FAR { 0.0 } else { phi_of_minus(z) }
    }
}
