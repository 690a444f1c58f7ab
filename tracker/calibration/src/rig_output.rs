//! Cameras into rig files.

use rig::camera::Camera;
use rig::{Rig, RigCamera, RigError};

/// A camera as a rig file has it.
pub fn rig_camera(camera: &Camera) -> RigCamera {
    let r = camera.camera_from_world;
    RigCamera {
        id: camera.id,
        width: camera.size_px[0],
        height: camera.size_px[1],
        fx: camera.focal_px.x,
        fy: camera.focal_px.y,
        cx: camera.centre_px.x,
        cy: camera.centre_px.y,
        dist: camera.distortion,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)])),
        t: camera.translation_mm.into(),
        field_hz: None,
        line_ns: None,
        exposure_ns: None,
        scan: None,
        shutter: None,
        pixel_format: None,
    }
}

/// `template` with these cameras in place of its own, checked as when it is read.
///
/// # Errors
/// Cameras that make no valid rig.
pub fn rig_with(template: &Rig, cameras: &[Camera]) -> Result<Rig, RigError> {
    let mut rig = template.clone();
    rig.cameras = cameras.iter().map(|camera| like(rig_camera(camera), template)).collect();
    rig.frame = cameras.first().map(|c| c.size_px).filter(|size| cameras.iter().all(|c| c.size_px == *size));
    Rig::parse(&rig.to_json(), "of the calibration")
}

/// What a file says of times and pixels of the camera with this id stays.
fn like(camera: RigCamera, template: &Rig) -> RigCamera {
    let Some(old) = template.cameras.iter().find(|c| c.id == camera.id) else { return camera };
    RigCamera {
        field_hz: old.field_hz,
        line_ns: old.line_ns,
        exposure_ns: old.exposure_ns,
        scan: old.scan,
        shutter: old.shutter,
        pixel_format: old.pixel_format,
        ..camera
    }
}

/// `rig` with the lens of this camera in place of that of its camera of the same id; its place
/// stays. `None` where the rig has no such camera.
pub fn rig_with_lens(rig: &Rig, camera: &Camera) -> Option<Rig> {
    let mut out = rig.clone();
    let old = out.cameras.iter_mut().find(|c| c.id == camera.id)?;
    let place = (old.rotation, old.t);
    *old = like(rig_camera(camera), rig);
    (old.rotation, old.t) = place;
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_come_back_as_they_went() {
        let rig = Rig::load_or_shipped(None).unwrap();
        assert_eq!(rig_with(&rig, &rig.cameras()).unwrap(), rig);
        let mut camera = rig.cameras()[1].clone();
        camera.focal_px.x += 1.0;
        camera.translation_mm.x += 1.0;
        let changed = rig_with_lens(&rig, &camera).unwrap();
        assert_eq!(changed.cameras[1].fx, rig.cameras[1].fx + 1.0);
        assert_eq!(changed.cameras[1].t, rig.cameras[1].t);
        camera.id = 7;
        assert!(rig_with_lens(&rig, &camera).is_none());
    }
}
