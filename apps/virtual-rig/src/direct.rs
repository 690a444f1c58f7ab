//! Blobs straight from the markers, with Gaussian noise and no pixels: for fast studies.

use crate::faults::scene::GHOST;
use crate::painter::Patch;
use nalgebra::Vector2;
use protocol::blobs::{BLOB_SATURATED, Blob, BlobField, WHOLE_FRAME, field_line};
use protocol::random::unit_interval;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rig::camera::Camera;
use std::f64::consts::{PI, TAU};

/// Noise of a centre along each axis of the frame, px (σ).
pub const NOISE_PX: f64 = 0.05;
/// Words of randomness that each marker has for itself: two pairs of numbers.
const WORDS: u128 = 4;

/// Noise of a marker that glares, as a multiple of the usual.
const GLARE_NOISE: f64 = 3.0;
/// A marker lit brighter than this saturates: the palest reference has 184 of 219 levels.
const GLARE: f64 = 1.2;
/// A marker dimmer than this does not rise above the threshold.
const DIM: f64 = 0.3;

/// Puts a blob for every marker whose centre is in the frame, and on a line that `keep` wants, into
/// `out`, in the order in which the hardware would complete them. `number` and `parity`
/// are of the field that saw the markers. The noise is drawn from the seed, the camera, that field and the marker, so that no
/// marker's noise depends on which others are seen.
pub fn blobs(
    seed: u64,
    camera: &Camera,
    patches: &[Patch],
    (number, parity): (u64, u32),
    keep: impl Fn(f64) -> bool,
    out: &mut BlobField,
) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number.wrapping_mul(64).wrapping_add(u64::from(camera.id)));
    let last_line = |b: &Blob| b.y_field_px + b.height_px / 2.0;
    // Lines of a field that is no whole frame lie two lines of the frame apart.
    let squeeze = if parity == WHOLE_FRAME { 1.0 } else { 0.5 };
    let lit = |p: &&Patch| p.image.is_in_frame(camera) && p.brightness >= DIM;
    for patch in patches.iter().filter(lit) {
        let (image, glares) = (&patch.image, patch.brightness > GLARE);
        random.set_word_pos(u128::from(image.body as u32 * 2 * GHOST + image.marker) * WORDS);
        let noise_px = NOISE_PX * if glares { GLARE_NOISE } else { 1.0 };
        let seen = image.centre_px + gaussian_pair(&mut random) * noise_px;
        let half = image.half_size_px();
        let y_field_px = field_line(seen.y, parity);
        if !keep(y_field_px) {
            continue;
        }
        out.push(Blob {
            x_px: seen.x,
            y_field_px,
            area_px: PI * image.shape_px2.determinant().max(0.0).sqrt() * squeeze,
            width_px: 2.0 * half.x,
            height_px: 2.0 * squeeze * half.y,
            var_x_px2: noise_px * noise_px,
            var_y_px2: noise_px * noise_px,
            cov_xy_px2: 0.0,
            colour: image.colour as u32,
            flags: if glares { BLOB_SATURATED } else { 0 },
        });
    }
    let count = out.blobs().len();
    out.blobs[..count].sort_unstable_by(|a, b| last_line(a).total_cmp(&last_line(b)));
}

/// Two independent numbers of unit variance (Box and Muller 1958).
fn gaussian_pair(random: &mut ChaCha8Rng) -> Vector2<f64> {
    let mut uniform = || unit_interval(random.next_u64());
    let radius = (-2.0 * libm::log(1.0 - uniform())).sqrt();
    let angle = TAU * uniform();
    Vector2::new(radius * libm::cos(angle), radius * libm::sin(angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::projection::Markers;
    use bytemuck::Zeroable;
    use rig::Rig;
    use scene::{DEFAULT_SCENE, SceneFile};
    use surgeon::motion::MotionSource;

    #[test]
    fn centres_scatter_by_the_stated_noise() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        let motion = MotionSource::new(&scene, &rig, None, 1).at(0);
        let mut seen = Markers::list();
        let camera = &rig.cameras()[0];
        Markers::of(&rig).project(camera, &motion, &mut seen);
        let patches: Vec<Patch> = seen.iter().copied().map(Patch::from).collect();
        let (mut n, mut square) = (0.0, Vector2::zeros());
        for number in 0..400u64 {
            let mut field = BlobField::zeroed();
            (field.field, field.parity) = (number, (number & 1) as u32);
            blobs(9, camera, &patches, (number, field.parity), |_| true, &mut field);
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
