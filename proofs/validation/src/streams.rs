//! Streams of marker blobs with truth, drawn from a seed: hands with tremor, a turning eye, and what
//! the cameras of a rig see of their markers. No code is shared with the tracker but the camera model,
//! so that a tracker that is tuned on some seeds can be judged by others.
//!
//! | scenario | cameras | tremor, µm per axis | besides |
//! |---|---|---|---|
//! | `nominal` | genlocked | 37, 8 to 12 Hz | markers hide each other |
//! | `async` | each with a clock of its own | 37, 8 to 12 Hz | as nominal |
//! | `tremor` | each with a clock of its own | 65, 6 to 14 Hz | as nominal |
//! | `withdrawn` | genlocked | 37, 8 to 12 Hz | as nominal; an instrument is taken out for a third of the time |
//! | `rest` | genlocked | none | nothing moves |
//! | `hard` | each with a clock of its own | 65, 8 to 12 Hz | lost fields, a camera that fails for a second, false blobs, an instrument that is taken out and put back |
//!
//! A stream can be drawn so that its motion is periodic ([`Recipe::draw_periodic`]); repeated, it lasts as
//! long as a session ([`lasting`]).
//!
//! A stream of another generator can be read with its truth ([`Stream::read`]), and is judged in the same way.
//!
//! A camera can be [`Knock`]ed at any instant; the rig that is given stays as it was.

pub mod bound;
mod imaging;
pub mod lasting;
pub mod motion;
mod read;
pub mod recorded;
pub mod score;
mod spectrum;

use motion::Motion;
use nalgebra::{Rotation3, Vector3};
use protocol::blobs::{Blob, BlobField, Colour};
use protocol::limits::{BODIES, MAX_CAMERAS};
use protocol::random::Random;
use rig::Rig;
use rig::camera::Camera;

/// A kind of stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Scenario {
    Nominal,
    Async,
    Tremor,
    Hard,
    Withdrawn,
    Rest,
}

impl Scenario {
    /// Every one.
    pub const ALL: [Scenario; 6] = [
        Scenario::Nominal,
        Scenario::Async,
        Scenario::Tremor,
        Scenario::Hard,
        Scenario::Withdrawn,
        Scenario::Rest,
    ];

    /// As in the table.
    pub fn name(self) -> &'static str {
        match self {
            Scenario::Nominal => "nominal",
            Scenario::Async => "async",
            Scenario::Tremor => "tremor",
            Scenario::Hard => "hard",
            Scenario::Withdrawn => "withdrawn",
            Scenario::Rest => "rest",
        }
    }

    /// True if the cameras expose together.
    fn is_genlocked(self) -> bool {
        matches!(self, Scenario::Nominal | Scenario::Withdrawn | Scenario::Rest)
    }
}

/// How a camera moves against the rig that is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knock {
    /// Id of the camera.
    pub camera: u32,
    /// From this instant on, s.
    pub at_s: f64,
    /// Turn in the camera's frame, rad (axis times angle).
    pub turn: Vector3<f64>,
    /// Shift in the camera's frame, mm.
    pub shift_mm: Vector3<f64>,
    /// True if it grows from there on, by that much a second.
    pub goes_on: bool,
}

impl Knock {
    /// The camera at an instant.
    fn moved(&self, camera: &Camera, t_s: f64) -> Camera {
        let since = t_s - self.at_s;
        let share = if since < 0.0 {
            0.0
        } else if self.goes_on {
            since
        } else {
            1.0
        };
        let turn = Rotation3::new(self.turn * share);
        Camera {
            camera_from_world: turn.matrix() * camera.camera_from_world,
            translation_mm: turn * camera.translation_mm + self.shift_mm * share,
            ..camera.clone()
        }
    }
}

/// What to draw.
#[derive(Debug, Clone)]
pub struct Recipe {
    /// Kind.
    pub scenario: Scenario,
    /// Seed of everything.
    pub seed: u64,
    /// Length, s.
    pub seconds: f64,
    /// Cameras that were moved.
    pub knocks: Vec<Knock>,
}

/// A stream, its truth, and the rig that is given.
pub struct Stream {
    /// The rig; moved cameras stand where they stood.
    pub rig: Rig,
    /// Fields in the order in which they arrive.
    pub fields: Vec<BlobField>,
    /// Where everything was.
    pub motion: Motion,
    /// Which markers were seen, in the order of exposures.
    sightings: Vec<Sighting>,
    /// Of the blobs.
    noise: imaging::Noise,
}

/// The markers that a field shows.
struct Sighting {
    exposed_s: f64,
    camera: u32,
    /// Sets of markers, by body.
    markers: [u32; BODIES],
    /// Markers of each blob that is of more than one.
    merged: Vec<Vec<imaging::Part>>,
}

/// Margin about an instant, s: fields count as of it if their exposures lie at most a period of the slowest camera and
/// this margin before it, or this margin after it.
const SEEN_WITHIN_S: f64 = 0.0005;

impl Stream {
    /// Exposures of which a frame is due: those of the fastest camera, or of another where that has none.
    pub fn reference_exposures(&self) -> usize {
        let numbers: std::collections::BTreeSet<u64> = self.fields.iter().map(|f| f.field).collect();
        numbers.len()
    }

    /// How many markers of a body two cameras saw at an instant.
    pub fn markers_seen(&self, body: usize, t_s: f64) -> u32 {
        let period_s = self.rig.longest_period_ns() as f64 * 1e-9;
        let first = self.sightings.partition_point(|s| s.exposed_s < t_s - period_s - SEEN_WITHIN_S);
        let near = self.sightings[first..].iter().take_while(|s| s.exposed_s <= t_s + SEEN_WITHIN_S);
        let mut by_camera = [0; MAX_CAMERAS];
        for sighting in near {
            by_camera[sighting.camera as usize] |= sighting.markers[body];
        }
        let by_two = |marker: &u32| by_camera.iter().filter(|set| *set & (1 << marker) != 0).count() >= 2;
        (0..u32::BITS).filter(by_two).count() as u32
    }
}

/// A rig whose cameras are as many times faster as `hz` is than its own rate: exposure, lines and all.
pub fn rig_at(rig: &Rig, hz: f64) -> Rig {
    let scale = rig.field_hz / hz;
    let scaled = |ns: u64| ((ns as f64 * scale) as u64).max(1);
    Rig { field_hz: hz, line_ns: scaled(rig.line_ns), exposure_ns: scaled(rig.exposure_ns), ..rig.clone() }
}

/// The same with cameras of their own rates, Hz, in the order of the rig; the fastest makes the frames.
pub fn rig_of_rates(rig: &Rig, rates_hz: &[f64]) -> Rig {
    let mut mixed = rig_at(rig, rates_hz.iter().copied().fold(0.0, f64::max));
    mixed.cameras.iter_mut().zip(rates_hz).for_each(|(camera, hz)| camera.field_hz = Some(*hz));
    mixed
}

/// First exposure, ns.
const BEGIN_NS: f64 = 47e6;
/// From the last line of a field to the arrival of its blobs, in periods of fields.
const DELAY: (f64, f64) = (0.1784, 0.1984);
/// Jitter of exposures, ns.
const JITTER_NS: f64 = 45e3;

/// Fields that a camera does not send.
struct Losses {
    share: f64,
    /// First and last of a stretch.
    outages: Vec<[u64; 2]>,
}

impl Losses {
    fn draw(scenario: Scenario, fields: u64, failing: bool, random: &mut Random) -> Self {
        let mut outages = Vec::new();
        let mut outage = |length: u64, random: &mut Random| {
            let first = random.below(fields.max(1) as usize) as u64;
            outages.push([first, first + length]);
        };
        if scenario == Scenario::Hard {
            for _ in 0..fields / 350 + 1 {
                outage(5 + random.below(5) as u64, random);
            }
            if failing {
                outage(75, random);
            }
        }
        Losses { share: if scenario == Scenario::Hard { 0.012 } else { 0.005 }, outages }
    }

    fn has(&self, field: u64, random: &mut Random) -> bool {
        let alone = random.uniform() < self.share;
        alone || self.outages.iter().any(|[first, last]| (*first..*last).contains(&field))
    }
}

/// When cameras expose, beside their stamps.
#[derive(Clone, Copy, PartialEq)]
enum Exposure {
    AsStamped,
    /// One camera is later by so many seconds.
    Late(u32, f64),
    /// The second field of each picture with the first.
    Progressive,
}

impl Recipe {
    /// Draws the stream on a rig.
    pub fn draw(&self, rig: &Rig) -> Stream {
        self.draw_motion(rig, Motion::draw(self.scenario, rig, self.seconds, self.seed), Exposure::AsStamped)
    }

    /// Draws it with the motion of another seed.
    pub fn draw_motion_of(&self, rig: &Rig, seed: u64) -> Stream {
        self.draw_motion(rig, Motion::draw(self.scenario, rig, self.seconds, seed), Exposure::AsStamped)
    }

    /// Draws it with a camera that exposes later than its stamps say, by so many seconds.
    pub fn draw_late(&self, rig: &Rig, camera: u32, late_s: f64) -> Stream {
        let motion = Motion::draw(self.scenario, rig, self.seconds, self.seed);
        self.draw_motion(rig, motion, Exposure::Late(camera, late_s))
    }

    /// Draws the stream of progressive cameras: the second field of each picture is exposed with the first,
    /// and is stamped as if it came a period later.
    pub fn draw_progressive(&self, rig: &Rig) -> Stream {
        let motion = Motion::draw(self.scenario, rig, self.seconds, self.seed);
        self.draw_motion(rig, motion, Exposure::Progressive)
    }

    /// Draws a stream whose end joins its beginning: the motion's period is its length.
    pub fn draw_periodic(&self, rig: &Rig) -> Stream {
        self.draw_motion(
            rig,
            Motion::draw(self.scenario, rig, self.seconds, self.seed).periodic(self.seconds),
            Exposure::AsStamped,
        )
    }

    fn draw_motion(&self, rig: &Rig, motion: Motion, exposure: Exposure) -> Stream {
        let hard = self.scenario == Scenario::Hard;
        let failing = rig.cameras[Random::new(self.seed, 1).below(rig.cameras.len())].id;
        let frame_period = rig.field_period_ns() as f64;
        let (mut fields, mut sightings) = (Vec::new(), Vec::new());
        for (n, camera) in rig.cameras().iter().enumerate() {
            let sensor = rig.sensor(camera.id);
            let period = sensor.period_ns as f64;
            let count = (self.seconds * 1e9 / period) as u64;
            let delay = [DELAY.0, DELAY.1].map(|share| sensor.read_out_ns() as f64 + share * frame_period);
            let mut random = Random::new(self.seed, 100 + u64::from(camera.id));
            let losses = Losses::draw(self.scenario, count, hard && failing == camera.id, &mut random);
            let (phase, rate) = match self.scenario {
                scenario if scenario.is_genlocked() => (0.0, 1.0),
                _ => (
                    period * (n as f64 + random.between(-0.2, 0.2)) / rig.cameras.len() as f64,
                    1.0 + 1e-5 * random.between(-1.0, 1.0),
                ),
            };
            for field in 0..count {
                let exposed = BEGIN_NS + phase + period * rate * field as f64 + JITTER_NS * random.normal();
                let lost = losses.has(field, &mut random);
                let arrives = exposed + random.between(delay[0], delay[1]);
                let late_s = match exposure {
                    Exposure::Late(id, late_s) if id == camera.id => late_s,
                    _ => 0.0,
                };
                let t_s = exposed * 1e-9 + late_s;
                if lost || (t_s > self.seconds && !motion.is_periodic()) {
                    continue;
                }
                let knock = self.knocks.iter().filter(|k| k.camera == camera.id);
                let seen_by = knock.fold(camera.clone(), |c, k| k.moved(&c, t_s));
                let mut seen: BlobField = bytemuck::Zeroable::zeroed();
                (seen.field, seen.camera, seen.parity) = (field, camera.id, sensor.parity(field, n as u32));
                (seen.exposed_ns, seen.read_out_ns) = (exposed as u64, arrives as u64);
                seen.blobs_out_ns = arrives as u64;
                let with_first = exposure == Exposure::Progressive && field % 2 == 1;
                let early_s = if with_first { period * 1e-9 } else { 0.0 };
                let scene =
                    imaging::Scene { motion: &motion, t_s: t_s - early_s, row_s: sensor.row_ns() * 1e-9 };
                let imaging::Seen { markers, merged } =
                    imaging::see(rig, &seen_by, &scene, &mut seen, &mut random);
                sightings.push(Sighting { exposed_s: t_s, camera: camera.id, markers, merged });
                if hard {
                    false_blobs(&mut seen, camera, &mut random);
                }
                fields.push(seen);
            }
        }
        fields.sort_by_key(|f| (f.blobs_out_ns, f.camera));
        sightings.sort_by(|a, b| a.exposed_s.total_cmp(&b.exposed_s));
        Stream { rig: rig.clone(), fields, motion, sightings, noise: imaging::Noise::DRAWN }
    }
}

/// Reflections: smaller blobs of a marker's colour, anywhere, 2 a field.
fn false_blobs(field: &mut BlobField, camera: &Camera, random: &mut Random) {
    const COLOURS: [Colour; 5] = [Colour::Red, Colour::Yellow, Colour::Green, Colour::Cyan, Colour::Blue];
    for _ in 0..4 {
        if random.once_in(2) {
            continue;
        }
        let [w, h] = camera.size_px.map(f64::from);
        let area = random.between(12.0, 70.0);
        let width = libm::sqrt(area * 8.0 / std::f64::consts::PI);
        field.push(Blob {
            x_px: random.between(5.0, w - 5.0),
            y_field_px: random.between(3.0, h / 2.0 - 3.0),
            ..imaging::blob(random.one_of(&COLOURS), area, width)
        });
    }
}

#[cfg(test)]
mod bound_tests;
#[cfg(test)]
mod camera_tests;
#[cfg(test)]
mod tests;
