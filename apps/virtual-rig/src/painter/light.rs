//! Illumination of a scene and gain and hue of the decoded chroma.

use super::BLACK;

/// Largest value of a colour channel, in the levels of BT.601 from black on.
const CHANNEL_FULL: f64 = 219.0;

/// Light and colour of one field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Illumination averaged over the exposure, as a share of the nominal one.
    pub gain: f64,
    /// Gain of chroma.
    pub chroma_gain: f64,
    /// Turn of the hue, rad, from Cb towards Cr.
    pub hue_rad: f64,
}

impl Default for Light {
    fn default() -> Self {
        Light { gain: 1.0, chroma_gain: 1.0, hue_rad: 0.0 }
    }
}

impl Light {
    /// A surface of reference colour `ycbcr` under this light, `brightness` times as bright as
    /// usual. A sensor's channels are clipped at full before they become YCbCr, so that what is too
    /// bright turns pale.
    pub(super) fn on(&self, ycbcr: [u8; 3], brightness: f64) -> [f64; 3] {
        let [y, cb, cr] = ycbcr.map(f64::from);
        let lit = self.gain * brightness;
        let (y, cb, cr) = ((y - BLACK) * lit, (cb - 128.0) * lit, (cr - 128.0) * lit);
        // BT.601 with luma and colour differences in levels of 219 and 224.
        let (cb_full, cr_full) = (cb * CHANNEL_FULL / 224.0, cr * CHANNEL_FULL / 224.0);
        let red = y + 1.402 * cr_full;
        let green = y - 0.344_136 * cb_full - 0.714_136 * cr_full;
        let blue = y + 1.772 * cb_full;
        let (mut y, mut cb, mut cr) = (y, cb, cr);
        if red.max(green).max(blue) > CHANNEL_FULL {
            let [red, green, blue] = [red, green, blue].map(|v| v.min(CHANNEL_FULL));
            y = 0.299 * red + 0.587 * green + 0.114 * blue;
            cb = (blue - y) / 1.772 * 224.0 / CHANNEL_FULL;
            cr = (red - y) / 1.402 * 224.0 / CHANNEL_FULL;
        }
        let (sin, cos) = (libm::sin(self.hue_rad), libm::cos(self.hue_rad));
        let turned = [cb * cos - cr * sin, cb * sin + cr * cos].map(|c| 128.0 + c * self.chroma_gain);
        [y + BLACK, turned[0], turned[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fpga_model::scan::sums::SATURATED;
    use protocol::blobs::Colour;

    #[test]
    fn usual_light_leaves_the_reference_colours() {
        for colour in Colour::ALL {
            let lit = Light::default().on(colour.reference(), 1.0);
            let expected = colour.reference().map(f64::from);
            assert!(lit.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{colour:?}: {lit:?}");
        }
    }

    #[test]
    fn too_much_light_turns_colours_white() {
        for colour in Colour::ALL {
            let [y, cb, cr] = Light::default().on(colour.reference(), 50.0);
            assert!(y > 100.0 && y <= f64::from(SATURATED) + 1e-9, "{y}");
            let pale = |c: f64| (16.0..=240.0).contains(&c);
            assert!(pale(cb) && pale(cr), "{colour:?}: {cb} {cr}");
        }
        let [y, cb, cr] = Light::default().on(Colour::White.reference(), 2.0);
        assert!((y - 235.0).abs() < 1e-9 && (cb - 128.0).abs() < 1e-9 && (cr - 128.0).abs() < 1e-9);
    }

    #[test]
    fn hue_turns_and_gain_stretches_chroma() {
        let light = Light { chroma_gain: 0.5, hue_rad: std::f64::consts::FRAC_PI_2, ..Light::default() };
        let [y, cb, cr] = light.on([100, 148, 128], 1.0);
        assert!((y - 100.0).abs() < 1e-9 && (cb - 128.0).abs() < 1e-9 && (cr - 138.0).abs() < 1e-9);
    }
}
