//! What a rig says of a camera's pictures: whole or in fields, exposed at once or line by line, and how their pixels
//! are given.
//!
//! The instant of a field is the middle of its exposure; where lines are exposed one after the other (a rolling
//! shutter), it is that of the middle of the picture, and a marker was seen so much earlier or later as its line lies
//! above or below ([`Sensor::row_delay_ns`]).

use crate::{Rig, RigCamera};
use protocol::blobs::WHOLE_FRAME;
use protocol::fields::{PixelFormat, SENSOR_PX};
use serde::{Deserialize, Serialize};

/// Which lines a field has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scan {
    /// Every second line of the frame, the even ones and the odd ones in turn.
    #[default]
    Interlaced,
    /// All lines.
    Progressive,
}

impl Scan {
    /// How the lines of a field lie in the frame, as rig files say it.
    pub fn rule(self) -> &'static str {
        match self {
            Scan::Interlaced => "y_frame = 2*y_field + parity",
            Scan::Progressive => "y_frame = y_field",
        }
    }

    /// As in rig files.
    pub fn name(self) -> &'static str {
        match self {
            Scan::Interlaced => "interlaced",
            Scan::Progressive => "progressive",
        }
    }
}

/// When the lines of a field are exposed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shutter {
    /// All at once.
    #[default]
    Global,
    /// One after the other, as they are read out.
    Rolling,
}

/// A sensor whose fields no channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("camera {id}: expected a sensor of 16 to 8192 px a side, found {size_px:?}")]
pub struct SensorError {
    id: u32,
    size_px: [u32; 2],
}

/// What a rig says of the pictures of one camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sensor {
    /// Id of the camera.
    pub camera: u32,
    /// Width and height of the frame, px.
    pub size_px: [u32; 2],
    /// Which lines a field has.
    pub scan: Scan,
    /// When they are exposed.
    pub shutter: Shutter,
    /// How pixels are given.
    pub format: PixelFormat,
    /// From one of its fields to the next, ns.
    pub period_ns: u64,
    /// How long a line is exposed, ns.
    pub exposure_ns: u64,
    /// From one line of a field to the next while it is read out, ns.
    pub line_ns: u64,
}

impl Sensor {
    /// Lines of a field.
    pub fn lines(&self) -> u32 {
        self.size_px[1] / self.lines_per_row()
    }

    /// Lines of the frame for each line of a field.
    pub fn lines_per_row(&self) -> u32 {
        match self.scan {
            Scan::Interlaced => 2,
            Scan::Progressive => 1,
        }
    }

    /// Pixels a line and lines of its fields; an odd width loses its last column.
    ///
    /// # Errors
    /// Where a side of the sensor is out of range.
    pub fn field_size(&self) -> Result<[usize; 2], SensorError> {
        if !self.size_px.iter().all(|n| SENSOR_PX.contains(n)) {
            return Err(SensorError { id: self.camera, size_px: self.size_px });
        }
        Ok([self.size_px[0] as usize & !1, self.lines() as usize])
    }

    /// Parity of field `number`, where that of number 0 is `first`.
    pub fn parity(&self, number: u64, first: u32) -> u32 {
        match self.scan {
            Scan::Interlaced => ((number ^ u64::from(first)) & 1) as u32,
            Scan::Progressive => WHOLE_FRAME,
        }
    }

    /// True for the parity of a field of this camera.
    pub fn has_parity(&self, parity: u32) -> bool {
        (parity == WHOLE_FRAME) == (self.scan == Scan::Progressive)
    }

    /// From the first line to the end of the last while a field is read out, ns.
    pub fn lines_ns(&self) -> u64 {
        self.line_ns.saturating_mul(u64::from(self.lines()))
    }

    /// From a field's instant until the last line has left the sensor, ns.
    pub fn read_out_ns(&self) -> u64 {
        (self.exposure_ns / 2).saturating_add(self.lines_ns() - self.before_middle_ns())
    }

    /// When the first line of a field of instant `exposed_ns` begins to leave the sensor, ns. Under a rolling shutter
    /// that can be before the field's instant; nothing is before 0.
    pub fn first_line_ns(&self, exposed_ns: u64) -> u64 {
        exposed_ns.saturating_add(self.exposure_ns / 2).saturating_sub(self.before_middle_ns())
    }

    /// Time from one line of the frame to the next by which what they show is later, ns; 0 of a global shutter.
    pub fn row_ns(&self) -> f64 {
        match self.shutter {
            Shutter::Global => 0.0,
            Shutter::Rolling => self.line_ns as f64 / f64::from(self.lines_per_row()),
        }
    }

    /// How much later than a field's instant its line `y_frame_px` of the frame was exposed, ns.
    pub fn row_delay_ns(&self, y_frame_px: f64) -> f64 {
        (y_frame_px - 0.5 * f64::from(self.size_px[1])) * self.row_ns()
    }

    /// From the exposure of the first line to that of the middle of the picture, ns.
    fn before_middle_ns(&self) -> u64 {
        match self.shutter {
            Shutter::Global => 0,
            Shutter::Rolling => self.lines_ns() / 2,
        }
    }
}

/// From one field to the next at a rate, ns.
pub(crate) fn period_ns(hz: f64) -> u64 {
    (1e9 / hz).round() as u64
}

impl Rig {
    /// The sensors of the cameras, in the order of the file.
    pub fn sensors(&self) -> Vec<Sensor> {
        self.cameras.iter().map(|camera| self.sensor_of(camera)).collect()
    }

    /// The sensor of camera `id`; that of the file's first where there is none.
    pub fn sensor(&self, id: u32) -> Sensor {
        let own = self.cameras.iter().find(|c| c.id == id).or(self.cameras.first());
        self.sensor_of(own.expect("a rig has cameras"))
    }

    fn sensor_of(&self, camera: &RigCamera) -> Sensor {
        Sensor {
            camera: camera.id,
            size_px: [camera.width, camera.height],
            scan: camera.scan.unwrap_or(self.scan),
            shutter: camera.shutter.unwrap_or(self.shutter),
            format: camera.pixel_format.unwrap_or(self.pixel_format),
            period_ns: period_ns(camera.field_hz.unwrap_or(self.field_hz)),
            exposure_ns: camera.exposure_ns.unwrap_or(self.exposure_ns),
            line_ns: camera.line_ns.unwrap_or(self.line_ns),
        }
    }

    /// From field to field of the slowest camera, ns; [`Rig::field_period_ns`] is that of the fastest.
    pub fn longest_period_ns(&self) -> u64 {
        self.sensors().iter().map(|s| s.period_ns).max().unwrap_or(self.field_period_ns())
    }

    /// From the instant of a field until the last line of the slowest camera has left its sensor, ns.
    pub fn read_out_ns(&self) -> u64 {
        self.sensors().iter().map(Sensor::read_out_ns).max().unwrap_or(0)
    }

    /// Largest payload of a field of any camera, bytes.
    pub fn field_bytes(&self) -> usize {
        let bytes = |s: &Sensor| s.format.bytes(s.size_px[0] as usize, s.lines() as usize);
        self.sensors().iter().map(bytes).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SHIPPED;

    fn shipped() -> Rig {
        Rig::parse(SHIPPED, "shipped").unwrap()
    }

    #[test]
    fn a_file_that_says_nothing_means_pal() {
        let sensor = shipped().sensors()[1];
        let (scan, shutter, format) = (Scan::Interlaced, Shutter::Global, PixelFormat::Yuyv);
        assert_eq!((sensor.scan, sensor.shutter, sensor.format), (scan, shutter, format));
        assert_eq!((sensor.lines(), sensor.field_size().unwrap()), (288, [720, 288]));
        assert_eq!([0, 1, 2].map(|n| sensor.parity(n, 1)), [1, 0, 1]);
        assert_eq!((sensor.lines_ns(), sensor.read_out_ns()), (18_432_000, 20_432_000));
        assert_eq!((sensor.first_line_ns(7), sensor.row_ns()), (2_000_007, 0.0));
        assert!(sensor.has_parity(0) && sensor.has_parity(1) && !sensor.has_parity(WHOLE_FRAME));
        assert_eq!(shipped().field_bytes(), 720 * 288 * 2);
    }

    #[test]
    fn a_camera_may_differ_from_the_others() {
        let mut rig = shipped();
        (rig.cameras[1].scan, rig.cameras[1].line_ns) = (Some(Scan::Progressive), Some(10_000));
        (rig.cameras[1].exposure_ns, rig.cameras[1].pixel_format) =
            (Some(1_000_000), Some(PixelFormat::Rgb8));
        rig.cameras[0].field_hz = Some(25.0);
        rig.field_rule = None;
        let rig = Rig::parse(&rig.to_json(), "again").unwrap();
        let [first, second, _] = rig.sensors()[..] else { panic!("three cameras") };
        assert_eq!((first.lines(), second.lines()), (288, 576));
        assert_eq!((second.lines_ns(), second.read_out_ns()), (5_760_000, 6_260_000));
        assert_eq!((second.parity(3, 0), rig.sensor(1), rig.sensor(0)), (WHOLE_FRAME, second, first));
        assert_eq!((first.period_ns, second.period_ns), (40_000_000, 20_000_000));
        assert_eq!((rig.field_period_ns(), rig.longest_period_ns()), (20_000_000, 40_000_000));
        assert_eq!(rig.field_bytes(), 720 * 576 * 3);
        assert_eq!(rig.read_out_ns(), first.read_out_ns());
    }

    #[test]
    fn a_rolling_shutter_exposes_the_middle_line_at_the_fields_instant() {
        let mut rig = shipped();
        (rig.shutter, rig.scan, rig.line_ns, rig.field_rule) =
            (Shutter::Rolling, Scan::Progressive, 30_000, None);
        let sensor = Rig::parse(&rig.to_json(), "again").unwrap().sensors()[0];
        assert_eq!(sensor.row_delay_ns(288.0), 0.0);
        assert_eq!((sensor.row_delay_ns(0.0), sensor.row_delay_ns(576.0)), (-8_640_000.0, 8_640_000.0));
        // The middle of the exposure of the last line, half an exposure before it leaves.
        assert_eq!(sensor.read_out_ns(), 8_640_000 + 2_000_000);
        assert_eq!(sensor.first_line_ns(20_000_000), 20_000_000 - 8_640_000 + 2_000_000);
        assert_eq!(sensor.first_line_ns(20_000_000) + sensor.lines_ns(), 20_000_000 + sensor.read_out_ns());
        rig.scan = Scan::Interlaced;
        assert_eq!(rig.sensors()[0].row_ns(), 15_000.0, "a line of a field is two of the frame");
    }

    #[test]
    fn unreasonable_sensors_are_refused() {
        let mut rig = shipped();
        rig.cameras[1].width = 1_000_000;
        let error = rig.sensors()[1].field_size().unwrap_err().to_string();
        assert!(error.contains("camera 1") && error.contains("1000000"), "{error}");
    }
}
