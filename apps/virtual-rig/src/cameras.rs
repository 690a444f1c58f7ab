//! The virtual cameras of a rig: fields of pixels, or of blobs.

use crate::direct;
use crate::faults::readout::Tear;
use crate::faults::tally::FaultTally;
use crate::faults::timing::Clock;
use crate::faults::{FaultEvent, FaultInjector};
use crate::painter::{MAX_PATCHES, Painter, Patch};
use crate::pixels;
use crate::projection::{MarkerImage, Markers};
use protocol::blobs::BlobField;
use protocol::fields::{FieldHeader, FieldPicture, PixelFormat};
use rig::Rig;
use rig::camera::Camera;
use rig::region;
use rig::sensor::{Sensor as OfRig, SensorError};
use surgeon::motion::{Motion, MotionSource};

/// Form of the fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Pixels, for the camera hardware to scan.
    Pixels,
    /// Blobs, straight from the markers and with noise.
    Direct,
}

/// Delivery of a field after its exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delivery {
    /// It is not sent.
    pub dropped: bool,
    /// Delay, ns.
    pub delay_ns: u64,
}

/// Draws the fields of one camera.
struct Canvas {
    painter: Painter,
    /// Picture of the previous field, for a torn one.
    before: FieldPicture,
    /// Where a field is painted that leaves in another format.
    planes: Option<FieldPicture>,
}

/// A camera; without a canvas on the direct path.
struct Sensor {
    camera: Camera,
    /// Its times and pixels.
    of_rig: OfRig,
    clock: Clock,
    /// Lines of a field in which markers can appear.
    lines: usize,
    canvas: Option<Canvas>,
}

/// Motion before, at and after the middle of an exposure.
struct ExposureMotion {
    exposed_ns: u64,
    half_exposure_ns: u64,
    motion: [Motion; 3],
}

/// Markers projected into the image of one camera.
struct ProjectedMarkers {
    markers: Markers,
    images: Vec<MarkerImage>,
    patches: Vec<Patch>,
    /// Patches of the previous field, for a torn one.
    before: Vec<Patch>,
    /// Motion in the newest exposure; genlocked cameras share it.
    exposure_motion: Option<ExposureMotion>,
}

/// All cameras.
pub struct Cameras {
    sensors: Vec<Sensor>,
    projected: ProjectedMarkers,
    seed: u64,
    faults: FaultInjector,
    /// Faults of the fields so far.
    pub tally: FaultTally,
}

/// An exposed field, not yet drawn.
pub struct Exposure<'a> {
    sensor: &'a mut Sensor,
    projected: &'a ProjectedMarkers,
    faults: &'a FaultInjector,
    seed: u64,
    number: u64,
    tear: Option<Tear>,
}

impl Cameras {
    /// The cameras of a rig without faults; noise comes from `seed`.
    ///
    /// # Errors
    /// Where a sensor is out of range.
    pub fn new(rig: &Rig, path: Path, seed: u64) -> Result<Self, SensorError> {
        Self::with_faults(rig, path, seed, FaultInjector::none(rig))
    }

    /// The same with faults.
    ///
    /// # Errors
    /// Where a sensor is out of range.
    pub fn with_faults(rig: &Rig, path: Path, seed: u64, faults: FaultInjector) -> Result<Self, SensorError> {
        let sensor = |(camera, of_rig): (Camera, OfRig)| {
            let size = of_rig.field_size()?;
            let lines = region::lines(rig, &camera);
            let planes = || FieldPicture::of_size([size[0], lines]);
            let canvas = || Canvas {
                painter: Painter::of_sensor(&of_rig, seed),
                before: FieldPicture::of_size(size),
                planes: (of_rig.format != PixelFormat::Yuyv).then(planes),
            };
            let canvas = (path == Path::Pixels).then(canvas);
            Ok(Sensor { clock: faults.clock(camera.id), lines, canvas, camera, of_rig })
        };
        let cameras = rig.cameras().into_iter().zip(rig.sensors());
        let sensors = cameras.map(sensor).collect::<Result<_, _>>()?;
        let projected = ProjectedMarkers {
            markers: Markers::of(rig),
            images: Markers::list(),
            patches: Vec::with_capacity(MAX_PATCHES),
            before: Vec::with_capacity(MAX_PATCHES),
            exposure_motion: None,
        };
        Ok(Cameras { sensors, projected, seed, faults, tally: FaultTally::default() })
    }

    /// Number of cameras.
    pub fn len(&self) -> usize {
        self.sensors.len()
    }

    /// False: a rig has cameras.
    pub fn is_empty(&self) -> bool {
        self.sensors.is_empty()
    }

    /// Largest payload of a field, bytes.
    pub fn payload_bytes(&self) -> usize {
        let bytes = |s: &Sensor| s.of_rig.format.bytes(s.camera.size_px[0] as usize, s.lines);
        self.sensors.iter().map(bytes).max().unwrap_or(0)
    }

    /// Id in the rig of camera `i`, in the order of the rig.
    pub fn id(&self, i: usize) -> u32 {
        self.sensors[i].camera.id
    }

    /// The clock of camera `i`; equal clocks are genlocked.
    pub fn clock(&self, i: usize) -> Clock {
        self.sensors[i].clock
    }

    /// Time from the middle of an exposure of camera `i` to the end of the region's last line, ns.
    pub fn out_after_ns(&self, i: usize) -> u64 {
        let Sensor { of_rig, lines, .. } = &self.sensors[i];
        of_rig.read_out_ns().saturating_sub((u64::from(of_rig.lines()) - *lines as u64) * of_rig.line_ns)
    }

    /// Exposes field `number` of camera `i`. Even fields hold the even lines where it is interlaced.
    pub fn expose(&mut self, i: usize, surgeon: &mut MotionSource, number: u64) -> Exposure<'_> {
        let sensor = &mut self.sensors[i];
        let Sensor { camera, clock, of_rig, .. } = &*sensor;
        let (projected, faults, tally) = (&mut self.projected, &self.faults, &mut self.tally);
        if number == 0 {
            faults.permanent_events(camera.id).for_each(|event| tally.record(0, camera.id, event));
        }
        let tear = faults.tear(camera.id, number, of_rig.lines() as usize);
        if let Some(tear) = tear {
            projected.project((camera, of_rig), surgeon, clock.exposed_ns(number - 1));
            faults.inject_into_scene(camera.id, number - 1, &mut projected.patches, |_| {});
            std::mem::swap(&mut projected.patches, &mut projected.before);
            tally.record(number, camera.id, FaultEvent::Torn { line: tear.line, missing: tear.missing });
        }
        projected.project((camera, of_rig), surgeon, clock.exposed_ns(number));
        faults.inject_into_scene(camera.id, number, &mut projected.patches, |event| {
            tally.record(number, camera.id, event)
        });
        Exposure { sensor, projected, faults, seed: self.seed, number, tear }
    }

    /// Decides whether and when the exposed field `number` of camera `i` is sent.
    pub fn delivery(&mut self, i: usize, number: u64) -> Delivery {
        let id = self.sensors[i].camera.id;
        let dropped = self.faults.dropped(id, number);
        let delay_ns = if dropped { 0 } else { self.faults.delay_ns(id, number) };
        if dropped {
            self.tally.record(number, id, FaultEvent::Dropped);
        }
        if delay_ns > 0 {
            self.tally.record(number, id, FaultEvent::Late { delay_ns });
        }
        Delivery { dropped, delay_ns }
    }
}

impl Exposure<'_> {
    /// Header of the field; its instants count from the start of the schedule.
    pub fn header(&self) -> FieldHeader {
        let OfRig { camera: id, size_px: [width, _], line_ns, format, .. } = self.sensor.of_rig;
        let exposed_ns = self.sensor.clock.exposed_ns(self.number);
        FieldHeader {
            field: self.number,
            exposed_ns,
            first_line_ns: self.sensor.of_rig.first_line_ns(exposed_ns),
            line_period_ns: line_ns,
            camera: id,
            parity: self.sensor.of_rig.parity(self.number, 0),
            format: format as u32,
            width: width & !1,
            height: self.sensor.of_rig.lines(),
            lines: self.sensor.lines as u32,
        }
    }

    /// Draws the field into the payload of its block.
    ///
    /// # Panics
    /// On the direct path, and if the payload is shorter than its header says.
    pub fn paint(&mut self, payload: &mut [u8]) {
        let (header, canvas) = (self.header(), self.sensor.canvas.as_mut());
        let planes = canvas.expect("cameras that draw have canvases").planes.take();
        let Some(mut planes) = planes else {
            return self.paint_planes(FieldPicture::in_payload_mut(&header, payload));
        };
        let FieldPicture { width, height, luma, blue, red } = &mut planes;
        let picture = FieldPicture {
            width: *width,
            height: *height,
            luma: &mut luma[..],
            blue: &mut blue[..],
            red: &mut red[..],
        };
        self.paint_planes(picture);
        pixels::encode(self.sensor.of_rig.format, &planes, payload);
        if let Some(canvas) = &mut self.sensor.canvas {
            canvas.planes = Some(planes);
        }
    }

    fn paint_planes(&mut self, mut picture: FieldPicture<&mut [u8]>) {
        let Sensor { camera, clock, canvas, .. } = &mut *self.sensor;
        let Canvas { painter, before, .. } = canvas.as_mut().expect("cameras that draw have canvases");
        let (faults, projected, number) = (self.faults, self.projected, self.number);
        let height = before.height;
        let light = |number: u64| faults.light(camera.id, clock.exposed_ns(number));
        painter.paint(projected.patches.iter().copied(), &light(number), camera.id, number, &mut picture);
        faults.add_hot_pixels(camera.id, height, &mut picture);
        if let Some(tear) = self.tear {
            let patches = projected.before.iter().copied();
            painter.paint(patches, &light(number - 1), camera.id, number - 1, before);
            faults.add_hot_pixels(camera.id, height, before);
            tear.apply(&mut picture, before);
        }
    }

    /// Makes blobs of the markers without drawing them; the instants are the header's, but for that
    /// at which they leave.
    pub fn blobs(&self, field: &mut BlobField) {
        let header = self.header();
        (field.field, field.camera, field.parity) = (header.field, header.camera, header.parity);
        (field.exposed_ns, field.read_out_ns) = (header.exposed_ns, header.read_out_ns());
        (field.count, field.blobs_left_out) = (0, 0);
        let (lines, tear) = (self.sensor.lines as f64, self.tear);
        let keep = |line: f64| line < lines && tear.is_none_or(|t| t.is_intact(line));
        let camera = &self.sensor.camera;
        let of = |number: u64| (number, self.sensor.of_rig.parity(number, 0));
        direct::blobs(self.seed, camera, &self.projected.patches, of(self.number), keep, field);
        if let Some(tear) = tear.filter(|t| t.missing == 0) {
            let older = |line: f64| line < lines && !tear.is_intact(line);
            direct::blobs(self.seed, camera, &self.projected.before, of(self.number - 1), older, field);
        }
    }
}

impl ProjectedMarkers {
    /// Fills `patches` with the markers that `camera` sees in an exposure, farthest first.
    fn project(&mut self, (camera, of_rig): (&Camera, &OfRig), surgeon: &mut MotionSource, exposed_ns: u64) {
        let half = of_rig.exposure_ns / 2;
        if self
            .exposure_motion
            .as_ref()
            .is_none_or(|m| (m.exposed_ns, m.half_exposure_ns) != (exposed_ns, half))
        {
            let instants = [exposed_ns.saturating_sub(half), exposed_ns, exposed_ns + half];
            self.exposure_motion = Some(ExposureMotion {
                exposed_ns,
                half_exposure_ns: half,
                motion: instants.map(|t| surgeon.at(t)),
            });
        }
        let Some(ExposureMotion { motion: [before, middle, after], .. }) = &self.exposure_motion else {
            return;
        };
        self.markers.project(camera, middle, &mut self.images);
        self.patches.clear();
        let rolls = of_rig.row_ns() > 0.0;
        self.patches.extend(self.images.iter().map(|&(mut image)| {
            let smear_px = self.markers.moved_px(camera, &image, before, after);
            if rolls {
                // Seen when its line was exposed: further along the way on which it smears.
                let share = of_rig.row_delay_ns(image.centre_px.y) / (2 * half) as f64;
                image.centre_px += smear_px * share;
            }
            Patch { image, smear_px, brightness: 1.0 }
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use fpga_model::camera_extractor::CameraExtractor;
    use scene::{DEFAULT_SCENE, SceneFile};

    #[test]
    fn both_paths_see_the_same_markers() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut source = MotionSource::new(&scene, &rig, None, 1);
        let mut pixels = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        let mut direct = Cameras::new(&rig, Path::Direct, 1).unwrap();
        let mut extractors: Vec<_> =
            rig.cameras().iter().map(|c| CameraExtractor::new(&rig, c).unwrap()).collect();
        let mut payload = vec![0; pixels.payload_bytes()];
        let (mut near, mut all) = (0, 0);
        let (mut a, mut b) = (BlobField::zeroed(), BlobField::zeroed());
        for number in 0..50 {
            for (i, extractor) in extractors.iter_mut().enumerate() {
                let mut exposure = pixels.expose(i, &mut source, 17 * number);
                let header = exposure.header();
                exposure.paint(&mut payload);
                let picture = FieldPicture::in_payload(&header, &payload).unwrap();
                extractor.extract(&header, &picture, &mut a);
                direct.expose(i, &mut source, 17 * number).blobs(&mut b);
                assert_eq!((a.camera, a.parity, a.field), (b.camera, b.parity, b.field));
                assert_eq!((a.exposed_ns, a.read_out_ns), (b.exposed_ns, b.read_out_ns));
                all += b.count;
                let same = |a: &protocol::blobs::Blob, b: &protocol::blobs::Blob| {
                    a.colour == b.colour
                        && (a.x_px - b.x_px).abs() < 0.5
                        && (a.y_field_px - b.y_field_px).abs() < 0.3
                };
                near += b.blobs().iter().filter(|b| a.blobs().iter().any(|a| same(a, b))).count() as u32;
            }
        }
        assert!(all > 1500 && f64::from(near) > 0.9 * f64::from(all), "{near} of {all}");
    }

    #[test]
    fn no_marker_is_ever_seen_below_the_region() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let (markers, mut seen) = (Markers::of(&rig), Markers::list());
        for camera in rig.cameras() {
            let region = region::lines(&rig, &camera);
            let mut lowest: f64 = 0.0;
            let mut source = MotionSource::new(&scene, &rig, None, 3);
            for k in 0..800 {
                markers.project(&camera, &source.at(k * 40_000_000), &mut seen);
                for image in &seen {
                    lowest = lowest.max((image.centre_px.y + image.half_size_px().y) / 2.0);
                }
            }
            println!("camera {}: {region} lines, lowest marker ends on {lowest:.1}", camera.id);
            assert!(lowest <= region as f64 && region <= 288);
        }
    }
}
