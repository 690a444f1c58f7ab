//! Faults of the scene and its light: what hides, doubles, glares, flickers and changes colour.

use super::{Deed, Faults, Kind};
use crate::painter::{Light, Patch};
use nalgebra::Vector2;
use protocol::poses::BODY_NAMES;
use std::f64::consts::{PI, TAU};

/// Added to a marker's number, this is the number of its twin.
pub const TWIN: u32 = 64;
/// How near and how much farther from its marker a twin circles, px of the frame.
const TWIN_PX: [f64; 2] = [25.0, 35.0];
/// Fastest turn of a twin, rad a field.
const TWIN_TURN: f64 = 0.12;

const _: () = assert!(protocol::limits::MAX_MARKERS <= TWIN as usize);

impl Faults {
    /// Changes what a camera sees in field `number` and tells what was done. Nothing is told of
    /// markers that are out of sight anyway.
    pub fn spoil(&self, camera: u32, number: u64, patches: &mut Vec<Patch>, mut tell: impl FnMut(Deed)) {
        if let Some((body, hidden)) = self.hidden(camera, number) {
            let concerned = |p: &Patch| p.image.body == body && hidden >> p.image.marker & 1 == 1;
            let markers = patches.iter().filter(|p| concerned(p)).fold(0, |all, p| all | 1 << p.image.marker);
            if markers != 0 {
                patches.retain(|p| !concerned(p));
                tell(Deed::Occlusion { body: BODY_NAMES[body], markers });
            }
        }
        if let Some((marker, brightness)) = self.glare(camera, number)
            && let Some(patch) = find(patches, marker)
        {
            patch.brightness *= brightness;
            tell(Deed::Saturated { body: BODY_NAMES[marker.0], marker: marker.1 });
        }
        if let Some((marker, twin_of)) = self.twin(camera, number)
            && let Some(twin) = find(patches, marker).map(|p| twin_of(p))
        {
            let at = twin.image.centre_px;
            // Behind everything else.
            patches.insert(0, twin);
            let (body, marker) = (BODY_NAMES[marker.0], marker.1);
            tell(Deed::Reflections { body, marker, x: at.x, y: at.y });
        }
    }

    /// Body whose markers are hidden, one bit for each of them.
    fn hidden(&self, camera: u32, field: u64) -> Option<(usize, u32)> {
        let kind = Kind::Occlusion;
        let spec = self.spec.occlusion.as_ref().filter(|_| self.concerns(kind, camera))?;
        let throw = self.dice.episode(kind, camera, field, spec.rate, spec.fields)?.throw;
        let (body, always) = self.chosen(throw.below(2, self.markers.len() as u64))?;
        // Every second one of the body's markers, and the chosen one.
        Some((body, throw.number(3) as u32 | 1 << always))
    }

    /// The marker that glares, and how much.
    fn glare(&self, camera: u32, field: u64) -> Option<((usize, u32), f64)> {
        let kind = Kind::Saturated;
        let spec = self.spec.saturated.as_ref().filter(|_| self.concerns(kind, camera))?;
        let throw = self.dice.episode(kind, camera, field, spec.rate, spec.fields)?.throw;
        Some((self.chosen(throw.below(2, self.markers.len() as u64))?, spec.brightness))
    }

    /// The marker that has a twin, and how it comes from the marker.
    fn twin(&self, camera: u32, field: u64) -> Option<((usize, u32), impl Fn(&Patch) -> Patch)> {
        let kind = Kind::Reflections;
        let spec = self.spec.reflections.as_ref().filter(|_| self.concerns(kind, camera))?;
        let episode = self.dice.episode(kind, camera, field, spec.rate, spec.fields)?;
        let throw = episode.throw;
        let radius = TWIN_PX[0] + TWIN_PX[1] * throw.uniform(3);
        let turn = TWIN_TURN * (2.0 * throw.uniform(4) - 1.0);
        let angle = TAU * throw.uniform(5) + turn * (field - episode.start) as f64;
        let offset = Vector2::new(libm::cos(angle), libm::sin(angle)) * radius;
        let (brightness, size) = (spec.brightness, spec.size);
        let twin_of = move |patch: &Patch| {
            let mut twin = *patch;
            twin.image.marker += TWIN;
            twin.image.centre_px += offset;
            twin.image.shape_px2 *= size * size;
            twin.brightness *= brightness;
            twin
        };
        Some((self.chosen(throw.below(2, self.markers.len() as u64))?, twin_of))
    }

    fn chosen(&self, i: u64) -> Option<(usize, u32)> {
        self.markers.get(i as usize).copied()
    }

    /// Light and colours `exposed_ns` after the start. All cameras see the same lamp; each has its own
    /// decoder.
    pub fn light(&self, camera: u32, exposed_ns: u64) -> Light {
        let t = exposed_ns as f64 * 1e-9;
        let mut light = Light::default();
        if let Some(flicker) = self.spec.flicker.as_ref().filter(|_| self.concerns(Kind::Flicker, camera)) {
            let phase = TAU * self.dice.throw(Kind::Flicker, 0, 0).uniform(0);
            // The exposure averages over a part of the lamp's period.
            let part = PI * flicker.hz * self.exposure_s;
            let left = if part > 0.0 { libm::sin(part) / part } else { 1.0 };
            light.gain = 1.0 + flicker.depth * left * libm::cos(TAU * flicker.hz * t + phase);
        }
        let drift = self.spec.colour_drift.as_ref().filter(|_| self.concerns(Kind::ColourDrift, camera));
        if let Some(drift) = drift {
            let throw = self.dice.throw(Kind::ColourDrift, camera, 0);
            let swing = |i: u64| libm::sin(TAU * (t / drift.period_s + throw.uniform(i)));
            light.hue_rad = drift.hue_deg.to_radians() * swing(0);
            light.chroma_gain = 1.0 + drift.gain * swing(1);
        }
        light
    }
}

/// The patch of a marker.
fn find(patches: &mut [Patch], (body, marker): (usize, u32)) -> Option<&mut Patch> {
    patches.iter_mut().find(|p| p.image.body == body && p.image.marker == marker)
}
