//! The virtual cameras with the camera hardware's twin behind them, in one process.

use bytemuck::Zeroable;
use fpga_model::camera_extractor::CameraExtractor;
use protocol::blobs::BlobField;
use protocol::time::Nanos;
use rig::Rig;
use rig::camera::Camera;
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path};

/// Cameras from which blobs come: through drawn pixels, or straight from the markers.
pub struct CameraTwin {
    cameras: Cameras,
    /// One for each camera; none on the direct path.
    extractors: Vec<CameraExtractor>,
    payload: Vec<u8>,
    start_ns: Nanos,
}

impl CameraTwin {
    /// The cameras of `rig`, whose schedule starts at `start_ns`; noise comes from `seed`.
    ///
    /// # Panics
    /// If a sensor of the rig is out of range.
    pub fn new(rig: &Rig, path: Path, seed: u64, start_ns: Nanos) -> Self {
        let cameras = Cameras::new(rig, path, seed).expect("a rig with sensors in range");
        let extractor = |c: Camera| CameraExtractor::new(rig, &c).expect("the same sensors");
        let drawn = rig.cameras().into_iter().filter(|_| path == Path::Pixels);
        let extractors = drawn.map(extractor).collect();
        CameraTwin { payload: vec![0; cameras.payload_bytes()], extractors, cameras, start_ns }
    }

    /// Number of cameras.
    pub fn count(&self) -> usize {
        self.cameras.len()
    }

    /// The blobs of field `number` of camera `i`; they leave when the hardware would send them.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn blobs(&mut self, i: usize, surgeon: &mut MotionSource, number: u64) -> BlobField {
        let mut field = BlobField::zeroed();
        let out_after_ns = self.cameras.out_after_ns(i);
        let mut exposure = self.cameras.expose(i, surgeon, number);
        let header = exposure.header();
        if let Some(extractor) = self.extractors.get_mut(i) {
            exposure.paint(&mut self.payload);
            assert!(extractor.takes(&header), "the extractor is of the same rig");
            let due_ns = extractor.extract_payload(&header, &self.payload, &mut field);
            field.blobs_out_ns = due_ns.expect("a whole payload");
        } else {
            exposure.blobs(&mut field);
            field.blobs_out_ns = header.exposed_ns + out_after_ns;
        }
        for instant in [&mut field.exposed_ns, &mut field.read_out_ns, &mut field.blobs_out_ns] {
            *instant += self.start_ns;
        }
        field
    }
}
