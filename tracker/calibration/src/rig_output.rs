//! Cameras into rig files.

use rig::camera::Camera;
use rig::sensor::{Scan, Shutter};
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

/// `template` for cameras of other sizes than its own, of whose timing nothing is known: whole frames with a global
/// shutter at the template's rate, read out within the period. `None` if all sizes are the template's.
pub fn whole_frames(template: &Rig, sizes_px: &[[u32; 2]]) -> Option<Rig> {
    let has = |size: &[u32; 2]| template.cameras.iter().any(|c| [c.width, c.height] == *size);
    if sizes_px.iter().all(has) {
        return None;
    }
    let lines = sizes_px.iter().map(|size| size[1]).max()?.max(1);
    let mut rig = template.clone();
    (rig.scan, rig.shutter, rig.field_rule) = (Scan::Progressive, Shutter::Global, None);
    rig.line_ns = rig.field_period_ns() / u64::from(lines);
    rig.exposure_ns = rig.exposure_ns.min(rig.field_period_ns());
    for camera in &mut rig.cameras {
        (camera.field_hz, camera.line_ns, camera.exposure_ns) = (None, None, None);
        (camera.scan, camera.shutter, camera.pixel_format) = (None, None, None);
    }
    Some(rig)
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
    use nalgebra::Vector2;

    #[test]
    fn a_template_fits_any_size() {
        let shipped = Rig::load_or_shipped(None).unwrap();
        assert!(whole_frames(&shipped, &[[720, 576]; 3]).is_none());
        for size in [[1280, 1024], [1920, 1200], [656, 491], [16, 16]] {
            let template = whole_frames(&shipped, &[size; 2]).unwrap();
            let cameras = shipped.cameras().into_iter().take(2).map(|camera| Camera {
                size_px: size,
                focal_px: Vector2::repeat(2.0 * f64::from(size[0])),
                centre_px: Vector2::from(size.map(f64::from)) / 2.0,
                ..camera
            });
            let rig = rig_with(&template, &cameras.collect::<Vec<_>>()).unwrap();
            assert_eq!((rig.frame, rig.scan), (Some(size), Scan::Progressive));
        }
    }

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
