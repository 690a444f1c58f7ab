//! The other looks of the product: yes or no, the reversed camera, the suction cone.

use crate::peers::Method;
use crate::setting::{Frame, Setting, pose};
use collision::instrument_image::{InstrumentImage, Volume};
use collision::suction::{PortCamera, SuctionCone};
use collision::zcoll::Zcoll;
use nalgebra::Isometry3;
use protocol::handles::Tool;

/// The volume of the scenes, mm, at 32 × 32.
pub const VOLUME: Volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution: 32 };
/// Shaft of a 20-gauge instrument, mm.
const RADIUS_MM: f64 = 0.25;
/// How far the tip of pick and vitrector is beyond the sheet: half a hook's thickness, mm.
const BEYOND_MM: f64 = 0.06;

/// ZCOLL that answers yes or no, and nothing else.
pub struct YesNo {
    zcoll: Zcoll,
    image: InstrumentImage,
}

impl YesNo {
    /// With the forceps of the setting.
    pub fn new(setting: &Setting) -> Self {
        let (mesh, jaw_rad) = Setting::tool();
        let mut image = InstrumentImage::of_mesh(mesh, &VOLUME);
        image.prepare(jaw_rad, &VOLUME);
        YesNo { zcoll: Zcoll::new(VOLUME, &setting.triangles, setting.nodes()).expect("a sheet"), image }
    }
}

impl Method for YesNo {
    fn name(&self) -> &'static str {
        "zcoll-yes-no"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        "yes or no"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        usize::from(self.zcoll.touches(&self.image, &frame.instrument_from_eye, &frame.surface))
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}

/// The reversed camera, with a pick whose hook is in the sheet.
pub struct Back {
    zcoll: Zcoll,
    image: InstrumentImage,
    instrument_from_eye: Isometry3<f64>,
}

impl Back {
    /// With a pick of its own.
    pub fn new(setting: &Setting) -> Self {
        let mut image = InstrumentImage::new(Tool::Pick, RADIUS_MM, &VOLUME);
        image.prepare(0.0, &VOLUME);
        let zcoll = Zcoll::new(VOLUME, &setting.triangles, setting.nodes()).expect("a sheet");
        Back { zcoll, image, instrument_from_eye: pose(BEYOND_MM) }
    }
}

impl Method for Back {
    fn name(&self) -> &'static str {
        "zcoll-back"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        "as zcoll-cpu, from the handle, a pick"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        self.zcoll.query_reversed(&self.image, &self.instrument_from_eye, &frame.surface);
        self.zcoll.triangles().count()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}

/// The suction cone of a vitrector whose port looks over the sheet.
pub struct Port {
    suction: PortCamera,
    instrument_from_eye: Isometry3<f64>,
}

impl Port {
    /// With a camera of its own.
    pub fn new(setting: &Setting) -> Self {
        let suction =
            PortCamera::new(VOLUME.resolution, &setting.triangles, setting.nodes()).expect("a sheet");
        Port { suction, instrument_from_eye: pose(BEYOND_MM) }
    }
}

impl Method for Port {
    fn name(&self) -> &'static str {
        "suction"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        "triangles in the cone, depths"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        // A half angle of 45° and the reach of the scenes' volume.
        let view = SuctionCone { tan_half_angle: 1.0, reach_mm: VOLUME.depth_mm };
        self.suction.render(&self.instrument_from_eye, &view, &frame.surface);
        self.suction.triangles().len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}
