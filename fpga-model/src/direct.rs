//! Blobs straight from the markers, with Gaussian noise and no pixels: for fast studies.

use crate::motion::tremor::uniform;
use crate::sight::MarkerImage;
use nalgebra::Vector2;
use protocol::blobs::{Blob, BlobField};
use protocol::camera::Camera;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Noise of a centre along each axis of the frame, px (σ).
pub const NOISE_PX: f64 = 0.05;

/// Puts a blob for every marker whose centre is in the frame into `out`, in the order in which the
/// hardware would complete them. The noise is drawn from the seed, the camera and the field's number.
pub fn blobs(seed: u64, camera: &Camera, markers: &[MarkerImage], out: &mut BlobField) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(out.field.wrapping_mul(64).wrapping_add(u64::from(camera.id)));
    let last_line = |b: &Blob| b.y_field_px + b.height_px / 2.0;
    let before = out.count as usize;
    for marker in markers.iter().filter(|m| m.is_in_frame(camera)) {
        let seen = marker.centre_px + gaussian_pair(&mut random) * NOISE_PX;
        let half = marker.half_size_px();
        out.push(Blob {
            x_px: seen.x,
            y_field_px: (seen.y - f64::from(out.parity)) / 2.0,
            area_px: PI * marker.shape_px2.determinant().max(0.0).sqrt() / 2.0,
            width_px: 2.0 * half.x,
            height_px: half.y,
            var_x_px2: NOISE_PX * NOISE_PX,
            var_y_px2: NOISE_PX * NOISE_PX,
            cov_xy_px2: 0.0,
            colour: marker.colour as u32,
            flags: 0,
        });
    }
    let count = out.count as usize;
    out.blobs[before..count].sort_unstable_by(|a, b| last_line(a).total_cmp(&last_line(b)));
}

/// Two independent numbers of unit variance (Box and Muller 1958).
fn gaussian_pair(random: &mut ChaCha8Rng) -> Vector2<f64> {
    let radius = (-2.0 * libm::log(1.0 - uniform(random))).sqrt();
    let angle = TAU * uniform(random);
    Vector2::new(radius * libm::cos(angle), radius * libm::sin(angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSource;
    use crate::sight::Markers;
    use bytemuck::Zeroable;
    use protocol::rig::Rig;
    use protocol::scene_file::{DEFAULT_SCENE, SceneFile};

    #[test]
    fn centres_scatter_by_the_stated_noise() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let motion = MotionSource::new(&scene, &rig, None, 1).at(0);
        let mut seen = Markers::list();
        let camera = &rig.cameras()[0];
        Markers::of(&rig).see(camera, &motion, &mut seen);
        let (mut n, mut square) = (0.0, Vector2::zeros());
        for number in 0..400u64 {
            let mut field = BlobField::zeroed();
            (field.field, field.parity) = (number, (number & 1) as u32);
            blobs(9, camera, &seen, &mut field);
            for blob in field.blobs() {
                let at = Vector2::new(blob.x_px, field.y_frame_px(blob));
                let off = seen
                    .iter()
                    .map(|m| at - m.centre_px)
                    .min_by(|a, b| a.norm().total_cmp(&b.norm()))
                    .unwrap();
                n += 1.0;
                square += off.component_mul(&off);
            }
            assert!(field.blobs().is_sorted_by_key(|b| b.y_field_px + b.height_px / 2.0));
        }
        let sigma = (square / n).map(f64::sqrt);
        assert!((sigma - Vector2::repeat(NOISE_PX)).norm() < 0.003, "{sigma}");
    }
}
