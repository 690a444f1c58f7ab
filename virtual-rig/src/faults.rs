//! Things that go wrong, from a seed.
//!
//! Every fault is a pure function of seed, camera and field number (flicker and colour drift through
//! the field's instant), so that neither the order of questions nor another fault changes it.
//!
//! | fault | acts on | pixels | direct blobs |
//! |---|---|---|---|
//! | `dropped` | timing | the field never leaves | the same |
//! | `late` | timing | its blobs leave later; no field overtakes one of its camera | the same |
//! | `clock-drift` | timing | each camera has its own period and phase | the same |
//! | `torn` | read-out | lower lines are of the field before, or lines are missing | blobs by their centre's line |
//! | `occlusion` | scene | markers of one body are hidden | the same |
//! | `reflections` | scene | a marker has a dimmer, smaller twin that circles it | the same |
//! | `saturated` | scene | a marker glares: clipped, pale, wide | flagged, three times the noise |
//! | `hot-pixels` | sensor | single bright pixels | none: specks are no blobs |
//! | `flicker` | light | the lamp beats against the exposure | none: centres stay |
//! | `colour-drift` | decoder | hue and gain of chroma turn slowly | none |
//!
//! What was done is told as [`Deed`]s: counted for the health text, and written to `--fault-log`.

pub mod dice;
pub mod readout;
pub mod scene;
pub mod spec;
pub mod tally;
pub mod timing;

use dice::Dice;
use protocol::poses::BODY_NAMES;
use protocol::rig::Rig;
use serde::Serialize;
use spec::{FaultError, FaultSpec};

/// The faults there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Kind {
    Dropped = 0,
    Late = 1,
    Torn = 2,
    HotPixels = 3,
    Flicker = 4,
    Reflections = 5,
    Saturated = 6,
    ColourDrift = 7,
    Occlusion = 8,
    ClockDrift = 9,
}

impl Kind {
    /// Every fault, in the order of its number.
    pub const ALL: [Kind; 10] = [
        Kind::Dropped,
        Kind::Late,
        Kind::Torn,
        Kind::HotPixels,
        Kind::Flicker,
        Kind::Reflections,
        Kind::Saturated,
        Kind::ColourDrift,
        Kind::Occlusion,
        Kind::ClockDrift,
    ];

    /// Name in fault files, logs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Dropped => "dropped",
            Kind::Late => "late",
            Kind::Torn => "torn",
            Kind::HotPixels => "hot-pixels",
            Kind::Flicker => "flicker",
            Kind::Reflections => "reflections",
            Kind::Saturated => "saturated",
            Kind::ColourDrift => "colour-drift",
            Kind::Occlusion => "occlusion",
            Kind::ClockDrift => "clock-drift",
        }
    }

    /// True of a fault that is there all the time: it is told once for a camera.
    pub fn stands(self) -> bool {
        matches!(self, Kind::HotPixels | Kind::Flicker | Kind::ColourDrift | Kind::ClockDrift)
    }
}

/// What a fault did to one field, or, if it stands, does to a camera from its first field on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Deed {
    /// The field was not sent.
    Dropped,
    /// The field was held back.
    Late {
        /// By so many ns.
        delay_ns: u64,
    },
    /// The field was torn.
    Torn {
        /// First line concerned, of the field.
        line: usize,
        /// Lines that are missing from there on; 0: all lines from there on are of the field before.
        missing: usize,
    },
    /// Pixels are hot.
    HotPixels {
        /// So many.
        count: u32,
    },
    /// The lamp flickers.
    Flicker {
        /// Swing as a share of the mean.
        depth: f64,
        /// Frequency of the light, Hz.
        hz: f64,
    },
    /// A marker had a twin.
    Reflections {
        /// Body of the marker, as in the rig.
        body: &'static str,
        /// Its number.
        marker: u32,
        /// Column of the twin, px of the frame.
        x: f64,
        /// Line of the twin, px of the frame.
        y: f64,
    },
    /// A marker glared.
    Saturated {
        /// Its body.
        body: &'static str,
        /// Its number.
        marker: u32,
    },
    /// Colours drift.
    ColourDrift {
        /// Largest turn, degrees.
        hue_deg: f64,
        /// Largest change of gain.
        gain: f64,
        /// Time of a round, s.
        period_s: f64,
    },
    /// Markers were hidden.
    Occlusion {
        /// Their body.
        body: &'static str,
        /// One bit for each of them.
        markers: u32,
    },
    /// A camera has a clock of its own.
    ClockDrift {
        /// Error of its period, parts per thousand million.
        ppb: i64,
        /// First exposure after the start, ns.
        phase_ns: u64,
    },
}

impl Deed {
    /// Which fault it was.
    pub fn kind(&self) -> Kind {
        match self {
            Deed::Dropped => Kind::Dropped,
            Deed::Late { .. } => Kind::Late,
            Deed::Torn { .. } => Kind::Torn,
            Deed::HotPixels { .. } => Kind::HotPixels,
            Deed::Flicker { .. } => Kind::Flicker,
            Deed::Reflections { .. } => Kind::Reflections,
            Deed::Saturated { .. } => Kind::Saturated,
            Deed::ColourDrift { .. } => Kind::ColourDrift,
            Deed::Occlusion { .. } => Kind::Occlusion,
            Deed::ClockDrift { .. } => Kind::ClockDrift,
        }
    }
}

/// The faults of a run.
#[derive(Debug, Clone)]
pub struct Faults {
    spec: FaultSpec,
    dice: Dice,
    /// Cameras of each fault, one bit for an id.
    cameras: [u32; Kind::ALL.len()],
    /// Body and number of every marker of the rig.
    markers: Vec<(usize, u32)>,
    period_ns: u64,
    exposure_s: f64,
}

impl Faults {
    /// The faults of `spec` with the cameras of `rig`.
    pub fn new(spec: FaultSpec, rig: &Rig, seed: u64) -> Result<Self, FaultError> {
        spec.check_rig(rig)?;
        let bits = |ids: &[u32]| ids.iter().fold(0u32, |bits, id| bits | 1 << id);
        let cameras = Kind::ALL.map(|kind| match spec.cameras(kind) {
            [] => u32::MAX,
            ids => bits(ids),
        });
        let of = |(i, name): (usize, &&str)| {
            let markers = rig.body(name).map_or(&[][..], |b| &b.markers);
            markers.iter().map(move |m| (i, m.id)).collect::<Vec<_>>()
        };
        Ok(Faults {
            cameras,
            markers: BODY_NAMES.iter().enumerate().flat_map(of).collect(),
            dice: Dice::new(seed),
            period_ns: rig.field_period_ns(),
            exposure_s: rig.exposure_ns as f64 * 1e-9,
            spec,
        })
    }

    /// Nothing goes wrong.
    pub fn none(rig: &Rig) -> Self {
        Self::new(FaultSpec::default(), rig, 0).expect("no fault is limited to a camera")
    }

    /// True if the camera can have this fault, provided that it is switched on.
    fn concerns(&self, kind: Kind, camera: u32) -> bool {
        self.cameras[kind as usize] >> camera & 1 == 1
    }

    /// What stands for a camera from the start on.
    pub fn standing(&self, camera: u32) -> impl Iterator<Item = Deed> {
        let clock = self.clock(camera);
        let spec = &self.spec;
        let all = [
            spec.hot_pixels.as_ref().map(|s| Deed::HotPixels { count: s.count }),
            spec.flicker.as_ref().map(|s| Deed::Flicker { depth: s.depth, hz: s.hz }),
            spec.colour_drift.as_ref().map(|s| {
                let (hue_deg, gain, period_s) = (s.hue_deg, s.gain, s.period_s);
                Deed::ColourDrift { hue_deg, gain, period_s }
            }),
            spec.clock_drift.as_ref().map(|_| Deed::ClockDrift { ppb: clock.ppb, phase_ns: clock.phase_ns }),
        ];
        all.into_iter().flatten().filter(move |deed| self.concerns(deed.kind(), camera))
    }
}

#[cfg(test)]
mod tests;
