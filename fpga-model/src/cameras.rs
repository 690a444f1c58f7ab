//! The cameras of a rig: from where everything is to the blobs of one field of each camera.

use crate::direct;
use crate::motion::Motion;
use crate::picture::{FieldPicture, Painter};
use crate::scan::{Scanner, Settings};
use crate::sight::{MarkerImage, Markers};
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::camera::Camera;
use protocol::rig::Rig;

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

/// A camera with what its pixels pass through; `None` on the direct path.
struct Sensor {
    camera: Camera,
    pixels: Option<(Painter, FieldPicture, Scanner)>,
}

/// All cameras, genlocked.
pub struct Cameras {
    sensors: Vec<Sensor>,
    markers: Markers,
    seen: Vec<MarkerImage>,
    seed: u64,
    /// Fields of the newest instant, one a camera, in the order of the rig.
    fields: Vec<BlobField>,
}

impl Cameras {
    /// The cameras of a rig; noise comes from `seed`.
    pub fn new(rig: &Rig, path: Path, seed: u64) -> Result<Self, SensorError> {
        let cameras = rig.cameras();
        for camera in &cameras {
            if !camera.size_px.iter().all(|n| SENSOR_PX.contains(n)) {
                return Err(SensorError { id: camera.id, size_px: camera.size_px });
            }
        }
        let pixels = |size_px: [u32; 2]| {
            let picture = FieldPicture::new(size_px);
            let settings = Settings::for_sensor(picture.width, picture.height);
            let scanner = Scanner::new(settings, picture.width, picture.height);
            (Painter::new(size_px, seed), picture, scanner)
        };
        let sensor = |camera: Camera| Sensor {
            pixels: (path == Path::Pixels).then(|| pixels(camera.size_px)),
            camera,
        };
        let fields = vec![BlobField::zeroed(); cameras.len()];
        let sensors = cameras.into_iter().map(sensor).collect();
        Ok(Cameras { sensors, markers: Markers::of(rig), seen: Markers::list(), seed, fields })
    }

    /// Exposes field `number` of every camera and extracts its blobs. Even fields hold the even
    /// lines. The instants are left to the sender.
    pub fn expose(&mut self, motion: &Motion, number: u64) -> &mut [BlobField] {
        for (sensor, field) in self.sensors.iter_mut().zip(&mut self.fields) {
            (field.field, field.camera, field.parity) = (number, sensor.camera.id, (number & 1) as u32);
            (field.count, field.blobs_left_out) = (0, 0);
            self.markers.see(&sensor.camera, motion, &mut self.seen);
            match &mut sensor.pixels {
                Some((painter, picture, scanner)) => {
                    painter.draw(&self.seen, sensor.camera.id, number, picture);
                    scanner.scan(picture, field);
                }
                None => direct::blobs(self.seed, &sensor.camera, &self.seen, field),
            }
        }
        &mut self.fields
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSource;
    use protocol::scene_file::{DEFAULT_SCENE, SceneFile};

    #[test]
    fn both_paths_see_the_same_markers() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let mut source = MotionSource::new(&scene, &rig, None, 1);
        let mut pixels = Cameras::new(&rig, Path::Pixels, 1).unwrap();
        let mut direct = Cameras::new(&rig, Path::Direct, 1).unwrap();
        let (mut near, mut all) = (0, 0);
        for number in 0..50 {
            let motion = source.at(number * 320_000_000);
            let drawn = pixels.expose(&motion, number);
            for (a, b) in drawn.iter().zip(direct.expose(&motion, number)) {
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
    fn unreasonable_sensors_are_refused() {
        let mut rig = Rig::load_or_shipped(None).unwrap();
        rig.cameras[1].width = 1_000_000;
        let error = Cameras::new(&rig, Path::Pixels, 1).err().unwrap().to_string();
        assert!(error.contains("camera 1") && error.contains("1000000"), "{error}");
    }
}
