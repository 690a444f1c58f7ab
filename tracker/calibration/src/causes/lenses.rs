//! A lens that is not the one of the rig file, by what no place of cameras and markers explains.
//!
//! A wrong focal length or distortion looks much like a camera that was moved, and most of the rest goes into the places
//! of all markers: "several are elsewhere" then explains it, and nothing less does. In that case each lens is estimated with
//! its camera's place while all else stays as it is. One is named if the rig holds with it mended, and does not with the
//! place of that camera alone mended.

use super::Cause;
use super::judgement::Explanation;
use super::measure::measure;
use super::refit::{fit, mended};
use super::together::Together;
use crate::bundle::{Part, PriorSigmas};
use crate::lens::{DISTORTION, lens_of};
use crate::observations::collect;
use crate::self_calibration::spread;
use protocol::blobs::BlobField;
use rig::Rig;
use rig::camera::Camera;

/// How far a lens, its camera's place and no marker are free: 3 % of a usual focal length are some 50 px, and a place that
/// makes up for it is millimetres away.
const WIDE: PriorSigmas = PriorSigmas { camera_mm: 3.0, camera_rad: 0.02, marker_mm: 0.0, lens_px: 30.0 };
/// Instants that show which lens it may be.
const FEW: usize = 60;
/// Noise of blobs over what their covariances say, above which nothing was estimated.
const NOISE: f64 = 3.0;
/// A lens may leave so many times the noise that is left where everything else is free.
const ALIKE: f64 = 1.15;
/// A place leaves more than a lens does where its noise is so many times larger.
const CLEARLY: f64 = 1.02;

/// The lens that explains a stretch; `None` where something simpler does, or no lens. `mends`: the tracker follows the rig
/// with everything mended that was found.
pub fn explain(rig: &Rig, fields: &[BlobField], found: &Together, mends: bool) -> Option<Explanation> {
    if !is_suspected(found, mends) {
        return None;
    }
    let instants = collect(&found.found.bundle.rig(rig), fields);
    let few = spread(instants, FEW);
    let noise =
        |c: usize| fit(rig, &few, &[Part::Camera(c)], &WIDE).map_or(f64::INFINITY, |f| f.shared.noise);
    let (c, least) = (0..rig.cameras.len()).map(|c| (c, noise(c))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    if least > ALIKE * found.noise {
        return None;
    }
    let (lens, rest) = mended(rig, fields, &[Part::Camera(c)], &WIDE, found)?;
    let with_lens = lens.bundle.rig(rig);
    if !rest.above.is_noise() || !rest.mends(&with_lens, fields) {
        return None;
    }
    // A camera that was moved far leaves more than its own noise only because its turn is no small one.
    let place = PriorSigmas { lens_px: 0.0, ..WIDE };
    if let Some((_, of_place)) = mended(rig, fields, &[Part::Camera(c)], &place, found)
        && of_place.above.is_noise()
        && of_place.noise < CLEARLY * rest.noise
    {
        return None;
    }
    let cause = cause(rig.cameras[c].id, &rig.cameras[c].model(), &lens.bundle.cameras[c]);
    let left = measure(&with_lens, fields);
    Some(Explanation { cause, left_px: left.all.rms()?, blobs: left.all.count })
}

/// True where places of cameras and markers explain what is left, and only several of them together; or one alone, while
/// the tracker does not follow the rig that they mend: a place explains what is followed, which is what fits it.
fn is_suspected(found: &Together, mends: bool) -> bool {
    let is_all = |cause: &Cause| *cause == Cause::Drifted;
    let simpler = found.explained.iter().any(|(cause, rest)| !is_all(cause) && rest.is_noise());
    let all = found.best.as_ref().is_some_and(|(cause, rest)| is_all(cause) && rest.is_noise());
    let is_possible = !found.above.is_noise() && all && found.noise < NOISE;
    is_possible && (!simpler || !mends)
}

/// How a lens is in truth against the rig's.
fn cause(id: u32, before: &Camera, after: &Camera) -> Cause {
    let ([fx, fy, cx, cy, k1, ..], to) = (lens_of(before), lens_of(after));
    Cause::Lens {
        camera: id,
        focal: (to[0] / fx * (to[1] / fy)).sqrt(),
        centre_px: [to[2] - cx, to[3] - cy],
        k1: to[DISTORTION] - k1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::set_lens;

    #[test]
    fn a_lens_is_reported_by_its_difference_from_the_rig_file() {
        let before = Rig::load_or_shipped(None).unwrap().cameras[0].model();
        let mut lens = lens_of(&before);
        (lens[0], lens[1]) = (lens[0] * 0.98, lens[1] * 0.98);
        (lens[2], lens[3], lens[DISTORTION]) = (lens[2] + 3.0, lens[3] - 4.0, lens[DISTORTION] - 0.05);
        let mut after = before.clone();
        set_lens(&mut after, &lens);
        let Cause::Lens { camera: 7, focal, centre_px: [x, y], k1 } = cause(7, &before, &after) else {
            panic!("another cause or camera")
        };
        assert!((focal - 0.98).abs() < 1e-12 && (k1 + 0.05).abs() < 1e-12, "{focal} {k1}");
        assert!((x - 3.0).abs() < 1e-9 && (y + 4.0).abs() < 1e-9, "{x} {y}");
    }
}
