//! The cameras of a rig: from where everything is to the blobs of one field of each camera.

use crate::direct;
use crate::faults::ledger::Ledger;
use crate::faults::timing::Clock;
use crate::faults::{Deed, Faults};
use crate::picture::{FieldPicture, MAX_PATCHES, Painter, Patch};
use crate::region;
use crate::scan::limits::{CAMERA, DIVIDER_CLOCKS, LINE_CLOCKS};
use crate::scan::{Found, Scanner, Settings};
use crate::sight::{MarkerImage, Markers};
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::camera::Camera;
use protocol::rig::Rig;
use surgeon::motion::{Motion, MotionSource};

/// Sides a sensor may have, px.
const SENSOR_PX: std::ops::RangeInclusive<u32> = 16..=8192;

/// A sensor nobody can simulate.
#[derive(Debug, thiserror::Error)]
#[error("camera {id}: expected a sensor of 16 to 8192 px a side, found {size_px:?}")]
pub struct SensorError {
    id: u32,
    size_px: [u32; 2],
}

/// How fields come about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Draw the field, extract the blobs.
    Pixels,
    /// Markers to blobs with noise.
    Direct,
}

/// A field that was exposed.
pub struct Exposure<'a> {
    /// Its blobs; the instants are left to the sender.
    pub field: &'a mut BlobField,
    /// When its last blob has left, pixel clocks after the first pixel.
    pub out_clock: u64,
}

/// What becomes of a field on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fate {
    /// It never leaves.
    pub dropped: bool,
    /// It leaves so much later, ns.
    pub delay_ns: u64,
}

/// What the pixels of a camera pass through.
struct Pixels {
    painter: Painter,
    picture: FieldPicture,
    /// The field before, where one is torn.
    before: FieldPicture,
    scanner: Scanner,
}

/// A camera with what its pixels pass through; `None` on the direct path.
struct Sensor {
    camera: Camera,
    clock: Clock,
    /// Lines that are read.
    lines: usize,
    pixels: Option<Pixels>,
    field: BlobField,
}

/// Motion before, at and after the middle of an exposure.
struct Moment {
    exposed_ns: u64,
    motion: [Motion; 3],
}

/// All cameras.
pub struct Cameras {
    sensors: Vec<Sensor>,
    view: View,
    seed: u64,
    line_ns: u64,
    faults: Faults,
    /// What the faults did.
    pub ledger: Ledger,
}

/// What is before the cameras.
struct View {
    markers: Markers,
    seen: Vec<MarkerImage>,
    patches: Vec<Patch>,
    before: Vec<Patch>,
    half_exposure_ns: u64,
    moment: Option<Moment>,
}

impl Cameras {
    /// The cameras of a rig; noise comes from `seed`, nothing goes wrong.
    pub fn new(rig: &Rig, path: Path, seed: u64) -> Result<Self, SensorError> {
        Self::with_faults(rig, path, seed, Faults::none(rig))
    }

    /// The same with faults.
    pub fn with_faults(rig: &Rig, path: Path, seed: u64, faults: Faults) -> Result<Self, SensorError> {
        let cameras = rig.cameras();
        for camera in &cameras {
            if !camera.size_px.iter().all(|n| SENSOR_PX.contains(n)) {
                return Err(SensorError { id: camera.id, size_px: camera.size_px });
            }
        }
        let pixels = |size_px: [u32; 2]| {
            let picture = FieldPicture::new(size_px);
            let (width, height) = (picture.width, picture.height);
            let scanner = Scanner::new(Settings::for_sensor(width, height), width, height);
            Pixels { painter: Painter::new(size_px, seed), before: picture.clone(), picture, scanner }
        };
        let sensor = |camera: Camera| Sensor {
            clock: faults.clock(camera.id),
            lines: region::lines(rig, &camera),
            pixels: (path == Path::Pixels).then(|| pixels(camera.size_px)),
            field: BlobField::zeroed(),
            camera,
        };
        let view = View {
            markers: Markers::of(rig),
            seen: Markers::list(),
            patches: Vec::with_capacity(MAX_PATCHES),
            before: Vec::with_capacity(MAX_PATCHES),
            half_exposure_ns: rig.exposure_ns / 2,
            moment: None,
        };
        let sensors = cameras.into_iter().map(sensor).collect();
        let line_ns = rig.line_ns;
        Ok(Cameras { sensors, view, seed, line_ns, faults, ledger: Ledger::default() })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.sensors.len()
    }

    /// True of no rig.
    pub fn is_empty(&self) -> bool {
        self.sensors.is_empty()
    }

    /// Id in the rig of camera `i`, in the order of the rig.
    pub fn id(&self, i: usize) -> u32 {
        self.sensors[i].camera.id
    }

    /// The clock of camera `i`; equal clocks are genlocked.
    pub fn clock(&self, i: usize) -> Clock {
        self.sensors[i].clock
    }

    /// From the middle of an exposure until a clock of its field, ns.
    pub fn after_exposure_ns(&self, clock: u64) -> u64 {
        self.view.half_exposure_ns
            + (u128::from(clock) * u128::from(self.line_ns) / u128::from(LINE_CLOCKS)) as u64
    }

    /// From the middle of an exposure of camera `i` until its blobs can leave at the earliest, ns.
    pub fn out_after_ns(&self, i: usize) -> u64 {
        self.after_exposure_ns(end_clock(self.sensors[i].lines))
    }

    /// Exposes field `number` of camera `i` and extracts its blobs. Even fields hold the even lines.
    pub fn expose(&mut self, i: usize, surgeon: &mut MotionSource, number: u64) -> Exposure<'_> {
        let Sensor { camera, clock, lines, pixels, field } = &mut self.sensors[i];
        let (view, faults, ledger) = (&mut self.view, &self.faults, &mut self.ledger);
        (field.field, field.camera, field.parity) = (number, camera.id, (number & 1) as u32);
        (field.count, field.blobs_left_out) = (0, 0);
        if number == 0 {
            faults.standing(camera.id).for_each(|deed| ledger.tell(0, camera.id, deed));
        }
        let tear = faults.tear(camera.id, number, camera.size_px[1] as usize / 2);
        if let Some(tear) = tear {
            view.look(camera, surgeon, clock.exposed_ns(number - 1));
            faults.spoil(camera.id, number - 1, &mut view.patches, |_| {});
            std::mem::swap(&mut view.patches, &mut view.before);
            ledger.tell(number, camera.id, Deed::Torn { line: tear.line, missing: tear.missing });
        }
        view.look(camera, surgeon, clock.exposed_ns(number));
        faults.spoil(camera.id, number, &mut view.patches, |deed| ledger.tell(number, camera.id, deed));
        let earliest = end_clock(*lines);
        let Some(pixels) = pixels else {
            let keep = |line: f64| line < *lines as f64 && tear.is_none_or(|t| t.spares(line));
            direct::blobs(self.seed, camera, &view.patches, number, keep, field);
            if let Some(tear) = tear.filter(|t| t.missing == 0) {
                let older = |line: f64| line < *lines as f64 && !tear.spares(line);
                direct::blobs(self.seed, camera, &view.before, number - 1, older, field);
            }
            return Exposure { field, out_clock: earliest };
        };
        let lights = [number, number.saturating_sub(1)].map(|n| faults.light(camera.id, clock.exposed_ns(n)));
        let Pixels { painter, picture, before, .. } = pixels;
        painter.paint(view.patches.iter().copied(), &lights[0], camera.id, number, picture);
        faults.heat(camera.id, picture);
        if let Some(tear) = tear {
            painter.paint(view.before.iter().copied(), &lights[1], camera.id, number - 1, before);
            faults.heat(camera.id, before);
            tear.apply(picture, before);
        }
        let out_clock = pixels.scan(*lines, field).max(earliest);
        Exposure { field, out_clock }
    }

    /// What becomes of field `number` of camera `i` after it was exposed.
    pub fn fate(&mut self, i: usize, number: u64) -> Fate {
        let id = self.sensors[i].camera.id;
        let dropped = self.faults.dropped(id, number);
        let delay_ns = if dropped { 0 } else { self.faults.delay_ns(id, number) };
        if dropped {
            self.ledger.tell(number, id, Deed::Dropped);
        }
        if delay_ns > 0 {
            self.ledger.tell(number, id, Deed::Late { delay_ns });
        }
        Fate { dropped, delay_ns }
    }
}

impl Pixels {
    /// Extracts the blobs of so many lines; returns the clock at which the last one leaves, 0 without any.
    fn scan(&mut self, lines: usize, field: &mut BlobField) -> u64 {
        let mut out_clock = 0;
        let mut leave = |found: Found| {
            out_clock = found.out_clock.max(out_clock);
            found.blobs().for_each(|blob| field.push(blob));
        };
        self.scanner.begin();
        for y in 0..lines {
            let (luma, blue, red) = self.picture.line(y);
            self.scanner.line(luma, blue, red, &mut leave);
        }
        self.scanner.end(&mut leave);
        field.blobs_left_out = field.blobs_left_out.saturating_add(self.scanner.tally().lost());
        out_clock
    }
}

/// When the blobs of a field of so many lines have left if none of them ends with the last ones, pixel
/// clocks: the last line is followed by a look at every label and one blob's division.
fn end_clock(lines: usize) -> u64 {
    lines as u64 * LINE_CLOCKS + CAMERA.labels as u64 + DIVIDER_CLOCKS
}

impl View {
    /// Fills `patches` with what `camera` sees in an exposure, farthest first.
    fn look(&mut self, camera: &Camera, surgeon: &mut MotionSource, exposed_ns: u64) {
        if self.moment.as_ref().is_none_or(|m| m.exposed_ns != exposed_ns) {
            let half = self.half_exposure_ns;
            let instants = [exposed_ns.saturating_sub(half), exposed_ns, exposed_ns + half];
            self.moment = Some(Moment { exposed_ns, motion: instants.map(|t| surgeon.at(t)) });
        }
        let Some(Moment { motion: [before, middle, after], .. }) = &self.moment else { return };
        self.markers.see(camera, middle, &mut self.seen);
        self.patches.clear();
        self.patches.extend(self.seen.iter().map(|&image| {
            let smear_px = self.markers.moved_px(camera, &image, before, after);
            Patch { image, smear_px, brightness: 1.0 }
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{DEFAULT_SCENE, SceneFile};
    use surgeon::motion::MotionSource;

    #[test]
    fn both_paths_see_the_same_markers() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut source = MotionSource::new(&scene, &rig, None, 1);
        let mut pixels = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        let mut direct = Cameras::new(&rig, Path::Direct, 1).unwrap();
        let (mut near, mut all) = (0, 0);
        for number in 0..50 {
            for i in 0..pixels.len() {
                let a = *pixels.expose(i, &mut source, 17 * number).field;
                let b = direct.expose(i, &mut source, 17 * number).field;
                assert_eq!((a.camera, a.parity, a.field), (b.camera, b.parity, b.field));
                all += b.count;
                near += b
                    .blobs()
                    .iter()
                    .filter(|b| {
                        let same = |a: &&protocol::blobs::Blob| {
                            a.colour == b.colour
                                && (a.x_px - b.x_px).abs() < 0.5
                                && (a.y_field_px - b.y_field_px).abs() < 0.3
                        };
                        a.blobs().iter().any(|a| same(&a))
                    })
                    .count() as u32;
            }
        }
        assert!(all > 1500 && f64::from(near) > 0.9 * f64::from(all), "{near} of {all}");
    }

    #[test]
    fn blobs_leave_after_their_last_line_and_before_that_of_the_field() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut source = MotionSource::new(&scene, &rig, None, 1);
        let mut cameras = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        assert_eq!(cameras.after_exposure_ns(0), 2_000_000, "half the exposure");
        assert_eq!(cameras.after_exposure_ns(10 * LINE_CLOCKS), 2_640_000, "64 µs a line");
        for i in 0..cameras.len() {
            let [earliest, whole] = [cameras.out_after_ns(i), rig.read_out_ns()];
            assert!(earliest + 2_000_000 < whole, "camera {i}: {earliest} ns, read out at {whole} ns");
        }
        for number in (0..400).step_by(9) {
            for i in 0..cameras.len() {
                let Exposure { field, out_clock } = cameras.expose(i, &mut source, number);
                let last = field.blobs().iter().map(|b| b.y_field_px + b.height_px / 2.0).fold(0.0, f64::max);
                assert!(out_clock as f64 > (last + 1.0) * LINE_CLOCKS as f64, "{last} {out_clock}");
                let ns = cameras.after_exposure_ns(out_clock);
                assert!((cameras.out_after_ns(i)..rig.read_out_ns()).contains(&ns), "{ns}");
            }
        }
    }

    #[test]
    fn unreasonable_sensors_are_refused() {
        let mut rig = Rig::load_or_shipped(None).unwrap();
        rig.cameras[1].width = 1_000_000;
        let error = Cameras::new(&rig, Path::Pixels, 1).err().unwrap().to_string();
        assert!(error.contains("camera 1") && error.contains("1000000"), "{error}");
    }
}
