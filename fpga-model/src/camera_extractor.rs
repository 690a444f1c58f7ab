//! Extraction of one camera's fields, and the instant at which their blobs leave.
//!
//! The hardware reads the lines of the region ([`rig::region`]) as they leave the sensor.
//! Blobs leave when the last one is complete, not before the region has passed; that instant is
//! counted in pixel clocks from the first line.

use crate::colours::file::ColourFile;
use crate::pixels;
use crate::scan::limits::{CAMERA, DIVIDER_CLOCKS, LINE_CLOCKS};
use crate::scan::{Found, Scanner, Settings};
use protocol::blobs::BlobField;
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader, FieldPicture};
use protocol::time::Nanos;
use rig::Rig;
use rig::camera::Camera;
use rig::region;
use rig::sensor::{Sensor, SensorError};

/// The extractor of one camera.
pub struct CameraExtractor {
    sensor: Sensor,
    /// Pixels a line, lines of a field.
    size_px: [usize; 2],
    /// Lines that are read.
    lines: usize,
    scanner: Scanner,
    /// Where fields of another format become planes.
    planes: Option<FieldPicture>,
}

impl CameraExtractor {
    /// The extractor for `camera` of `rig`, for the shipped colours.
    ///
    /// # Errors
    /// Where a side of the sensor is out of range.
    pub fn new(rig: &Rig, camera: &Camera) -> Result<Self, SensorError> {
        Self::with(rig, camera, |_| {})
    }

    /// The extractor for `camera` of `rig`, for these colours.
    ///
    /// # Errors
    /// As [`CameraExtractor::new`].
    pub fn finding(rig: &Rig, camera: &Camera, colours: &ColourFile) -> Result<Self, SensorError> {
        Self::with(rig, camera, |settings| colours.apply(settings))
    }

    fn with(rig: &Rig, camera: &Camera, change: impl Fn(&mut Settings)) -> Result<Self, SensorError> {
        let sensor = rig.sensor(camera.id);
        let [width, height] = sensor.field_size()?;
        let frame_lines = sensor.lines_per_row() as u8;
        let mut settings = Settings { frame_lines, ..Settings::for_sensor(width, height) };
        change(&mut settings);
        let scanner = Scanner::new(settings, width, height);
        let lines = region::lines(rig, camera);
        Ok(CameraExtractor { sensor, size_px: [width, height], lines, scanner, planes: None })
    }

    /// True for a field of this camera's sensor, in its format or in planes.
    pub fn takes(&self, header: &FieldHeader) -> bool {
        let sized = self.size_px == [header.width as usize, header.height as usize];
        let format = [FORMAT_YCBCR_422, self.sensor.format as u32].contains(&header.format);
        header.camera == self.sensor.camera && sized && format && self.sensor.has_parity(header.parity)
    }

    /// As [`CameraExtractor::extract`], of the payload of a block in any format; `None` where it is shorter than its
    /// header says.
    pub fn extract_payload(
        &mut self,
        header: &FieldHeader,
        payload: &[u8],
        out: &mut BlobField,
    ) -> Option<Nanos> {
        if pixels::is_planar(header) {
            return Some(self.extract(header, &FieldPicture::in_payload(header, payload)?, out));
        }
        let mut planes = self.planes.take().unwrap_or_else(|| FieldPicture::of_size(self.size_px));
        let lines = pixels::decode(header, payload, &mut planes);
        let due_ns = lines.map(|lines| {
            let FieldPicture { width, luma, blue, red, .. } = &planes;
            let read = FieldPicture {
                width: *width,
                height: lines,
                luma: &luma[..],
                blue: &blue[..],
                red: &red[..],
            };
            self.extract(header, &read, out)
        });
        self.planes = Some(planes);
        due_ns
    }

    /// Fills `out` with the blobs of a field, but for the instant at which they leave; returns that
    /// instant by the pixel clock.
    pub fn extract(
        &mut self,
        header: &FieldHeader,
        picture: &FieldPicture<&[u8]>,
        out: &mut BlobField,
    ) -> Nanos {
        (out.field, out.camera, out.parity) = (header.field, header.camera, header.parity);
        (out.exposed_ns, out.read_out_ns) = (header.exposed_ns, header.read_out_ns());
        (out.count, out.blobs_left_out) = (0, 0);
        let last = self.scan(picture, out);
        let after = u128::from(last.max(end_clock(self.lines))) * u128::from(header.line_period_ns);
        header.first_line_ns.saturating_add((after / u128::from(LINE_CLOCKS)) as u64)
    }

    /// Extracts the blobs of the region; returns the clock at which the last one leaves, 0 without
    /// any.
    fn scan(&mut self, picture: &FieldPicture<&[u8]>, out: &mut BlobField) -> u64 {
        let mut out_clock = 0;
        let mut leave = |found: Found| {
            out_clock = found.out_clock.max(out_clock);
            found.blobs().for_each(|blob| out.push(blob));
        };
        let lines = (0..self.lines.min(picture.height)).map(|y| picture.line(y));
        self.scanner.field(lines, &mut leave);
        out.blobs_left_out = out.blobs_left_out.saturating_add(self.scanner.tally().lost());
        out_clock
    }
}

/// Clock at which the blobs of `lines` lines have left if none of them ends with the last ones: the
/// last line is followed by a search of every label and one blob's division.
fn end_clock(lines: usize) -> u64 {
    lines as u64 * LINE_CLOCKS + CAMERA.labels as u64 + DIVIDER_CLOCKS
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use scene::{DEFAULT_SCENE, SceneFile};
    use surgeon::motion::MotionSource;
    use virtual_rig::cameras::{Cameras, Path};

    fn rig() -> Rig {
        Rig::load_or_shipped(None).unwrap()
    }

    #[test]
    fn blobs_leave_after_their_last_line_and_before_that_of_the_field() {
        let rig = rig();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut surgeon = MotionSource::new(&scene, &rig, None, 1);
        let mut cameras = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        let mut extractors: Vec<_> =
            rig.cameras().iter().map(|c| CameraExtractor::new(&rig, c).unwrap()).collect();
        let (mut payload, mut field) = (Vec::new(), BlobField::zeroed());
        for number in (0..400).step_by(9) {
            for (i, extractor) in extractors.iter_mut().enumerate() {
                let mut exposure = cameras.expose(i, &mut surgeon, number);
                let header = exposure.header();
                payload.resize(header.bytes(), 0);
                exposure.paint(&mut payload);
                let picture = FieldPicture::in_payload(&header, &payload).unwrap();
                let due_ns = extractor.extract(&header, &picture, &mut field);
                let last = field.blobs().iter().map(|b| b.y_field_px + b.height_px / 2.0).fold(0.0, f64::max);
                let after_ns = due_ns - header.first_line_ns;
                assert!(after_ns as f64 > (last + 1.0) * 64_000.0, "{last} {after_ns}");
                assert!(due_ns + 2_000_000 < header.read_out_ns(), "{after_ns}");
                assert_eq!(header.read_out_ns() - header.exposed_ns, rig.read_out_ns());
                assert!(field.count >= 8, "{} blobs", field.count);
            }
        }
    }

    #[test]
    fn the_line_period_and_the_first_line_give_the_instant() {
        let rig = rig();
        let camera = &rig.cameras()[0];
        let mut extractor = CameraExtractor::new(&rig, camera).unwrap();
        let dark = FieldPicture::new(camera.size_px);
        let dark = FieldPicture {
            width: dark.width,
            height: dark.height,
            luma: &dark.luma[..],
            blue: &dark.blue[..],
            red: &dark.red[..],
        };
        let header = FieldHeader {
            field: 1,
            exposed_ns: 1_000_000,
            first_line_ns: 3_000_000,
            line_period_ns: 64_000,
            camera: camera.id,
            parity: 1,
            format: FORMAT_YCBCR_422,
            width: 720,
            height: 288,
            lines: 288,
        };
        assert!(extractor.takes(&header) && !extractor.takes(&FieldHeader { width: 640, ..header }));
        let mut out = BlobField::zeroed();
        let due_ns = extractor.extract(&header, &dark, &mut out);
        let region_ns = region::lines(&rig, camera) as u64 * 64_000;
        assert!((3_000_000 + region_ns..3_060_000 + region_ns).contains(&due_ns), "{due_ns}");
        let late = FieldHeader { first_line_ns: 10_000_000, ..header };
        assert_eq!(extractor.extract(&late, &dark, &mut out), due_ns + 7_000_000);
        assert_eq!((out.exposed_ns, out.parity, out.count), (1_000_000, 1, 0));
    }
}
