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
    }
}

/// `template` with these cameras in place of its own, checked as when it is read.
///
/// # Errors
/// Cameras that make no valid rig.
pub fn rig_with(template: &Rig, cameras: &[Camera]) -> Result<Rig, RigError> {
    let mut rig = template.clone();
    rig.cameras = cameras.iter().map(rig_camera).collect();
    if let Some(first) = cameras.first() {
        rig.frame = first.size_px;
    }
    Rig::parse(&rig.to_json(), "of the calibration")
}

/// `rig` with the lens of this camera in place of that of its camera of the same id; its place
/// stays. `None` where the rig has no such camera.
pub fn rig_with_lens(rig: &Rig, camera: &Camera) -> Option<Rig> {
    let mut rig = rig.clone();
    let old = rig.cameras.iter_mut().find(|c| c.id == camera.id)?;
    let place = (old.rotation, old.t);
    *old = rig_camera(camera);
    (old.rotation, old.t) = place;
    Some(rig)
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
