//! Optics between microscope and fundus: lens, inverter, the lamp's filter, and the pedal's buttons
//! for them.

use serde::{Deserialize, Serialize};

/// The lens through which the microscope looks into the eye.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u32)]
pub enum Lens {
    /// No refraction.
    #[default]
    None = 0,
    /// A flat contact lens: the eye is a body of vitreous under a plane, so depths look shorter by
    /// its refractive index.
    Flat = 1,
    /// A strong lens over the eye: it images the pupil into the microscope, so that a wide field is
    /// seen, and makes an inverted image in the air that the microscope looks at.
    WideAngle = 2,
}

impl Lens {
    /// From the wire; an unknown one is none.
    pub fn from_wire(code: u32) -> Self {
        [Lens::Flat, Lens::WideAngle].into_iter().find(|&l| l as u32 == code).unwrap_or_default()
    }

    /// The lens after a swing of the lens arm.
    pub fn swung(self) -> Self {
        if self == Lens::WideAngle { Lens::Flat } else { Lens::WideAngle }
    }
}

/// The colour filter of the light source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u32)]
pub enum Filter {
    /// None.
    #[default]
    Clear = 0,
    /// Takes the blue away, which harms the retina most.
    Yellow = 1,
    /// Deep yellow, for long work near the macula.
    Amber = 2,
    /// Without red: vessels and membranes stand out dark.
    Green = 3,
}

impl Filter {
    /// From the wire; an unknown one is clear.
    pub fn from_wire(code: u32) -> Self {
        [Filter::Yellow, Filter::Amber, Filter::Green]
            .into_iter()
            .find(|&f| f as u32 == code)
            .unwrap_or_default()
    }

    /// The next one of the filter wheel.
    pub fn next(self) -> Self {
        Self::from_wire(self as u32 + 1)
    }

    /// Share of red, green and blue light that passes, linear.
    pub fn passes(self) -> [f32; 3] {
        match self {
            Filter::Clear => [1.0; 3],
            Filter::Yellow => [1.0, 0.97, 0.35],
            Filter::Amber => [1.0, 0.80, 0.08],
            Filter::Green => [0.12, 1.0, 0.25],
        }
    }
}

/// A button of the pedal; it acts when it is pressed, not while it is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u32)]
pub enum PedalButton {
    /// The next step of magnification, a smaller field.
    Magnify = 1,
    /// The step before, a larger field.
    Reduce = 2,
    /// Swings the wide-angle lens in or out; the inverter follows.
    Lens = 4,
    /// Inverter on or off.
    Inverter = 8,
    /// The next colour filter of the lamp.
    Filter = 16,
    /// Pause, and go on. The launcher serves this button and the two after it.
    Pause = 32,
    /// The attempt from its beginning.
    Restart = 64,
    /// The module's next level.
    Next = 128,
}

impl PedalButton {
    /// True if `bits` hold it.
    pub fn is_in(self, bits: u32) -> bool {
        bits & self as u32 != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_come_back_and_unknown_ones_are_harmless() {
        for lens in [Lens::None, Lens::Flat, Lens::WideAngle] {
            assert_eq!(Lens::from_wire(lens as u32), lens);
        }
        let wheel = [Filter::Clear, Filter::Yellow, Filter::Amber, Filter::Green];
        for (i, filter) in wheel.into_iter().enumerate() {
            assert_eq!((Filter::from_wire(i as u32), filter.next()), (filter, wheel[(i + 1) % 4]));
        }
        assert_eq!((Lens::from_wire(77), Filter::from_wire(77)), (Lens::None, Filter::Clear));
    }
}
