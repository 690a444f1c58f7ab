//! Fault injection: camera faults drawn from a seed.
//!
//! Every fault is a pure function of seed, camera and field number (flicker and colour drift of the
//! field's instant). Neither the order of the calls nor another fault changes it.
//!
//! | fault | acts on | pixels | direct blobs |
//! |---|---|---|---|
//! | `dropped` | timing | the field is never sent | the same |
//! | `late` | timing | blobs leave later, in order within a camera | the same |
//! | `clock-drift` | timing | each camera has its own period and phase | the same |
//! | `torn` | read-out | lines are missing or of the previous field | blobs by centre line |
//! | `occlusion` | scene | markers of one body are hidden | the same |
//! | `reflections` | scene | a marker has a dimmer, smaller ghost that circles it | the same |
//! | `saturated` | scene | a marker glares: clipped, pale, wide | flagged, three times the noise |
//! | `hot-pixels` | sensor | single bright pixels | none: specks are no blobs |
//! | `flicker` | light | the lamp beats against the exposure | none: centres stay |
//! | `colour-drift` | decoder | hue and gain of chroma turn slowly | none |
//!
//! Each injected fault is a [`FaultEvent`]: counted for the health text, and written to
//! `--fault-log`.

pub mod readout;
pub mod sampler;
pub mod scene;
pub mod spec;
pub mod tally;
pub mod timing;

use protocol::limits::MAX_CAMERAS;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use sampler::FaultSampler;
use serde::Serialize;
pub use spec::FaultKind;
use spec::FaultSpec;

impl FaultKind {
    /// True for a fault that lasts from the first field to the last: it has one event a camera.
    pub fn is_permanent(self) -> bool {
        matches!(
            self,
            FaultKind::HotPixels | FaultKind::Flicker | FaultKind::ColourDrift | FaultKind::ClockDrift
        )
    }
}

/// Effect of a fault on one field; of a permanent fault, on a camera from its first field on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum FaultEvent {
    /// The field was not sent.
    Dropped,
    /// The field was held back.
    Late {
        /// Delay, ns.
        delay_ns: u64,
    },
    /// The field was torn.
    Torn {
        /// First torn line of the field.
        line: usize,
        /// Missing lines from there on; 0: all lines from there on are of the previous field.
        missing: usize,
    },
    /// Pixels are hot.
    HotPixels {
        /// Number of hot pixels.
        count: u32,
    },
    /// The lamp flickers.
    Flicker {
        /// Amplitude as a share of the mean.
        depth: f64,
        /// Frequency of the light, Hz.
        hz: f64,
    },
    /// A marker had a ghost image.
    Reflections {
        /// Body of the marker, as in the rig.
        body: &'static str,
        /// Number of the marker.
        marker: u32,
        /// Column of the ghost, px of the frame.
        x: f64,
        /// Line of the ghost, px of the frame.
        y: f64,
    },
    /// A marker was overexposed.
    Saturated {
        /// Body of the marker.
        body: &'static str,
        /// Number of the marker.
        marker: u32,
    },
    /// Colours drift.
    ColourDrift {
        /// Amplitude of the hue, degrees.
        hue_deg: f64,
        /// Amplitude of the chroma gain.
        gain: f64,
        /// Period, s.
        period_s: f64,
    },
    /// Markers were hidden.
    Occlusion {
        /// Body of the markers.
        body: &'static str,
        /// One bit a marker.
        markers: u32,
    },
    /// A camera has a clock of its own.
    ClockDrift {
        /// Error of its period, parts per billion.
        ppb: i64,
        /// First exposure after the start, ns.
        phase_ns: u64,
    },
}

/// A marker of the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct MarkerId {
    /// Index of its body in [`BODY_NAMES`].
    body: usize,
    /// Number of the marker on the body.
    marker: u32,
}

/// Decides which faults befall which field of which camera.
#[derive(Debug, Clone)]
pub struct FaultInjector {
    spec: FaultSpec,
    sampler: FaultSampler,
    /// Cameras of each kind of fault, one bit an id.
    cameras: [u32; FaultKind::ALL.len()],
    /// Every marker of the rig.
    markers: Vec<MarkerId>,
    /// From field to field, by camera, ns.
    period_ns: [u64; MAX_CAMERAS],
    /// By camera.
    exposure_s: [f64; MAX_CAMERAS],
}

impl FaultInjector {
    /// Faults of `spec` on the cameras of `rig`, drawn from `seed`.
    ///
    /// # Errors
    /// Where `spec` names a camera that the rig does not have.
    pub fn new(spec: FaultSpec, rig: &Rig, seed: u64) -> anyhow::Result<Self> {
        spec.check_rig(rig)?;
        let bits = |ids: &[u32]| ids.iter().fold(0u32, |bits, id| bits | 1 << id);
        let cameras = FaultKind::ALL.map(|kind| match spec.cameras(kind) {
            [] => u32::MAX,
            ids => bits(ids),
        });
        let mut markers = Vec::new();
        for (body, name) in BODY_NAMES.iter().enumerate() {
            let own = rig.body(name).map_or(&[][..], |b| &b.markers);
            markers.extend(own.iter().map(|m| MarkerId { body, marker: m.id }));
        }
        Ok(FaultInjector {
            cameras,
            markers,
            sampler: FaultSampler::new(seed),
            period_ns: std::array::from_fn(|id| rig.sensor(id as u32).period_ns),
            exposure_s: std::array::from_fn(|id| rig.sensor(id as u32).exposure_ns as f64 * 1e-9),
            spec,
        })
    }

    /// An injector without faults.
    pub fn none(rig: &Rig) -> Self {
        Self::new(FaultSpec::default(), rig, 0).expect("no fault is limited to a camera")
    }

    /// The section of a fault of `kind`, where it is on and befalls the camera.
    fn of<'a, S>(&self, section: &'a Option<S>, kind: FaultKind, camera: u32) -> Option<&'a S> {
        section.as_ref().filter(|_| self.cameras[kind as usize] >> camera & 1 == 1)
    }

    /// Permanent faults of a camera.
    pub fn permanent_events(&self, camera: u32) -> impl Iterator<Item = FaultEvent> {
        let clock = self.clock(camera);
        let all = [
            self.of(&self.spec.hot_pixels, FaultKind::HotPixels, camera)
                .map(|s| FaultEvent::HotPixels { count: s.count }),
            self.of(&self.spec.flicker, FaultKind::Flicker, camera)
                .map(|s| FaultEvent::Flicker { depth: s.depth, hz: s.hz }),
            self.of(&self.spec.colour_drift, FaultKind::ColourDrift, camera).map(|s| {
                let (hue_deg, gain, period_s) = (s.hue_deg, s.gain, s.period_s);
                FaultEvent::ColourDrift { hue_deg, gain, period_s }
            }),
            self.of(&self.spec.clock_drift, FaultKind::ClockDrift, camera)
                .map(|_| FaultEvent::ClockDrift { ppb: clock.ppb, phase_ns: clock.phase_ns }),
        ];
        all.into_iter().flatten()
    }
}

#[cfg(test)]
mod tests;
