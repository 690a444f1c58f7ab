//! Faults of the scene and its light: occlusion, reflections, glare, flicker, colour drift.

use super::sampler::Draw;
use super::{FaultEvent, FaultInjector, FaultKind, MarkerId};
use crate::painter::{Light, Patch};
use nalgebra::Vector2;
use protocol::poses::BODY_NAMES;
use std::f64::consts::{PI, TAU};

/// Number of a marker's ghost image, less that of the marker.
pub const GHOST: u32 = 64;
/// Least distance of a ghost from its marker and the range above it, px of the frame.
const GHOST_PX: [f64; 2] = [25.0, 35.0];
/// Highest angular speed of a ghost about its marker, rad a field.
const GHOST_TURN: f64 = 0.12;

const _: () = assert!(protocol::limits::MAX_MARKERS <= GHOST as usize);

impl FaultInjector {
    /// Applies the scene's faults to the patches of field `number` of a camera. `emit` gets each
    /// fault of a visible marker.
    pub fn inject_into_scene(
        &self,
        camera: u32,
        number: u64,
        patches: &mut Vec<Patch>,
        mut emit: impl FnMut(FaultEvent),
    ) {
        if let Some((body, hidden)) = self.hidden(camera, number) {
            let concerned = |p: &Patch| p.image.body == body && hidden >> p.image.marker & 1 == 1;
            let markers = patches.iter().filter(|p| concerned(p)).fold(0, |all, p| all | 1 << p.image.marker);
            if markers != 0 {
                patches.retain(|p| !concerned(p));
                emit(FaultEvent::Occlusion { body: BODY_NAMES[body], markers });
            }
        }
        if let Some((marker, brightness)) = self.glare(camera, number)
            && let Some(patch) = find(patches, marker)
        {
            patch.brightness *= brightness;
            emit(FaultEvent::Saturated { body: BODY_NAMES[marker.body], marker: marker.marker });
        }
        if let Some((marker, ghost_of)) = self.ghost(camera, number)
            && let Some(ghost) = find(patches, marker).map(|p| ghost_of(p))
        {
            let at = ghost.image.centre_px;
            // The first patch is the farthest.
            patches.insert(0, ghost);
            let (body, marker) = (BODY_NAMES[marker.body], marker.marker);
            emit(FaultEvent::Reflections { body, marker, x: at.x, y: at.y });
        }
    }

    /// Body whose markers are hidden (index in [`BODY_NAMES`]), and one bit a hidden marker.
    fn hidden(&self, camera: u32, field: u64) -> Option<(usize, u32)> {
        let kind = FaultKind::Occlusion;
        let spec = self.of(&self.spec.occlusion, kind, camera)?;
        let draw = self.sampler.episode(kind, camera, field, spec.rate, spec.fields)?.draw;
        let MarkerId { body, marker } = self.pick_marker(&draw)?;
        // Each of the body's markers with probability 1/2, and the picked one.
        Some((body, draw.number(3) as u32 | 1 << marker))
    }

    /// The overexposed marker and its brightness as a multiple of the usual one.
    fn glare(&self, camera: u32, field: u64) -> Option<(MarkerId, f64)> {
        let kind = FaultKind::Saturated;
        let spec = self.of(&self.spec.saturated, kind, camera)?;
        let draw = self.sampler.episode(kind, camera, field, spec.rate, spec.fields)?.draw;
        Some((self.pick_marker(&draw)?, spec.brightness))
    }

    /// The marker with a ghost image, and the function from its patch to the ghost's.
    fn ghost(&self, camera: u32, field: u64) -> Option<(MarkerId, impl Fn(&Patch) -> Patch)> {
        let kind = FaultKind::Reflections;
        let spec = self.of(&self.spec.reflections, kind, camera)?;
        let episode = self.sampler.episode(kind, camera, field, spec.rate, spec.fields)?;
        let draw = episode.draw;
        let radius = GHOST_PX[0] + GHOST_PX[1] * draw.uniform(3);
        let turn = GHOST_TURN * (2.0 * draw.uniform(4) - 1.0);
        let angle = TAU * draw.uniform(5) + turn * (field - episode.start) as f64;
        let offset = Vector2::new(libm::cos(angle), libm::sin(angle)) * radius;
        let (brightness, size) = (spec.brightness, spec.size);
        let ghost_of = move |patch: &Patch| {
            let mut ghost = *patch;
            ghost.image.marker += GHOST;
            ghost.image.centre_px += offset;
            ghost.image.shape_px2 *= size * size;
            ghost.brightness *= brightness;
            ghost
        };
        Some((self.pick_marker(&draw)?, ghost_of))
    }

    /// The marker of an episode; `None` for a rig without markers.
    fn pick_marker(&self, draw: &Draw) -> Option<MarkerId> {
        self.markers.get(draw.below(2, self.markers.len() as u64) as usize).copied()
    }

    /// Illumination and chroma `exposed_ns` after the start. All cameras see the same lamp; each
    /// has its own decoder.
    pub fn light(&self, camera: u32, exposed_ns: u64) -> Light {
        let t = exposed_ns as f64 * 1e-9;
        let mut light = Light::default();
        if let Some(flicker) = self.of(&self.spec.flicker, FaultKind::Flicker, camera) {
            let phase = TAU * self.sampler.draw(FaultKind::Flicker, 0, 0).uniform(0);
            // The exposure averages over a part of the lamp's period.
            let part = PI * flicker.hz * self.exposure_s[camera as usize];
            let left = if part > 0.0 { libm::sin(part) / part } else { 1.0 };
            light.gain = 1.0 + flicker.depth * left * libm::cos(TAU * flicker.hz * t + phase);
        }
        if let Some(drift) = self.of(&self.spec.colour_drift, FaultKind::ColourDrift, camera) {
            let draw = self.sampler.draw(FaultKind::ColourDrift, camera, 0);
            let swing = |i: u64| libm::sin(TAU * (t / drift.period_s + draw.uniform(i)));
            light.hue_rad = drift.hue_deg.to_radians() * swing(0);
            light.chroma_gain = 1.0 + drift.gain * swing(1);
        }
        light
    }
}

/// The patch of a marker.
fn find(patches: &mut [Patch], id: MarkerId) -> Option<&mut Patch> {
    patches.iter_mut().find(|p| p.image.body == id.body && p.image.marker == id.marker)
}
