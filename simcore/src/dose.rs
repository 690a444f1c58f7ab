//! The dose of light on the retina, by place: what the light pipe shone into each cell of
//! `protocol::dose` so far.
//!
//! Retina at the distance r from a light pipe's tip, θ off its axis, that the rays meet at the
//! angle φ to the normal, gets by the inverse square and the cosine law
//!
//! E = P / (π tan² α) · s(θ) · cos φ / r²
//!
//! s is the beam's profile, with which the picture is lit too (`beam_share` in `protocol::dose`).
//! P, α and the least distance are those with which the score counts `light-dose`: P spread over
//! the disc that a cone of the half angle α cuts out of a plane at the distance d, P / (π (d tan
//! α)²). On the axis of a pipe that looks straight at the retina both are the same; over the whole
//! beam the profile carries 0.77 P. The score follows the spot: it is the dose of a place that
//! always lies under the pipe. Shadows are not taken off: what an instrument covers for a moment
//! counts as lit.

use nalgebra::{Isometry3, Vector3};
use protocol::dose::{BEAM_OUTER_RAD, CELLS, beam_share, cell_of, direction};
use training::score::table::{LIGHT_HALF_ANGLE_RAD, LIGHT_MW, NEAREST_LIGHT_MM};

/// Doses of all cells, mJ/mm². No result depends on them, so they are saved with the state and not
/// hashed.
#[derive(Debug, Clone, PartialEq)]
pub struct DoseState {
    /// mJ/mm² (100 mJ/cm²), in the order of `protocol::dose`.
    pub mj_mm2: Vec<f64>,
}

impl DoseState {
    /// No light yet.
    pub fn start() -> Self {
        Self { mj_mm2: vec![0.0; CELLS] }
    }

    /// What is wrong with doses from elsewhere, if anything is.
    pub fn is_sound(&self) -> bool {
        self.mj_mm2.len() == CELLS && self.mj_mm2.iter().all(|d| d.is_finite() && *d >= 0.0)
    }
}

/// The cells' centres on a retina, and the light pipe's figures.
#[derive(Debug)]
pub struct LightDose {
    radius_mm: f64,
    /// Directions from the eye's centre; zero where there is no retina.
    directions: Vec<Vector3<f64>>,
    /// P / (π tan² α), mW.
    at_1_mm: f64,
    cos_outer: f64,
}

impl LightDose {
    /// For a retina of this radius.
    pub fn new(radius_mm: f64) -> Self {
        let tan = libm::tan(LIGHT_HALF_ANGLE_RAD);
        Self {
            radius_mm,
            directions: (0..CELLS).map(|c| direction(c).unwrap_or_default().into()).collect(),
            at_1_mm: LIGHT_MW / (std::f64::consts::PI * tan * tan),
            cos_outer: libm::cos(BEAM_OUTER_RAD),
        }
    }

    /// Irradiance at the place of the retina in direction `u` from the eye's centre, mW/mm²; 0
    /// outside the cone.
    fn irradiance(&self, tip: &Vector3<f64>, axis: &Vector3<f64>, u: &Vector3<f64>) -> f64 {
        let way = u * self.radius_mm - tip;
        let (along, distance, across) = (way.dot(axis), way.norm(), way.dot(u));
        if along <= distance * self.cos_outer || across <= 0.0 {
            return 0.0;
        }
        let r = if distance > NEAREST_LIGHT_MM { distance } else { NEAREST_LIGHT_MM };
        self.at_1_mm / (r * r) * (across / distance) * beam_share(along / distance)
    }

    /// Adds what a light pipe at `eye_from_pipe` shines in `dt_s`.
    pub fn expose(&self, dose: &mut DoseState, eye_from_pipe: &Isometry3<f64>, dt_s: f64) {
        let tip = eye_from_pipe.translation.vector;
        let axis = -(eye_from_pipe.rotation * Vector3::z());
        if tip.norm() >= self.radius_mm {
            return;
        }
        // The beam may be narrower than a cell: the one that the axis meets counts what falls
        // there.
        let b = tip.dot(&axis);
        let hit = tip + axis * (libm::sqrt(b * b - tip.norm_squared() + self.radius_mm * self.radius_mm) - b);
        let met = cell_of(hit.into());
        let at_hit = self.irradiance(&tip, &axis, &(hit / self.radius_mm));
        for (cell, (sum, u)) in dose.mj_mm2.iter_mut().zip(&self.directions).enumerate() {
            let here = self.irradiance(&tip, &axis, u);
            *sum += dt_s * if met == Some(cell) && at_hit > here { at_hit } else { here };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use protocol::dose::cell_mm2;

    const R: f64 = 11.5;

    /// A light pipe at `tip` that shines towards `target`.
    fn pipe(tip: [f64; 3], target: [f64; 3]) -> Isometry3<f64> {
        let to_handle = Vector3::from(tip) - Vector3::from(target);
        let turned = UnitQuaternion::rotation_between(&Vector3::z(), &to_handle);
        let turned = turned
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        Isometry3::from_parts(Translation3::from(tip), turned)
    }

    fn dose(pose: &Isometry3<f64>, s: f64) -> DoseState {
        let mut dose = DoseState::start();
        let steps = 50;
        (0..steps).for_each(|_| LightDose::new(R).expose(&mut dose, pose, s / f64::from(steps)));
        dose
    }

    #[test]
    fn a_resting_lamp_gives_what_the_closed_formula_says() {
        // 8 mm over the pole, for ten seconds: 10 mW over a disc of the radius 8 tan 0.6.
        let dose = dose(&pipe([0.0, 0.0, 8.0 - R], [0.0, 0.0, -R]), 10.0);
        let disc = std::f64::consts::PI * (8.0 * 0.6f64.tan()).powi(2);
        let (most, place) =
            dose.mj_mm2.iter().zip(0..).fold((0.0, 0), |a, (&d, i)| if d > a.0 { (d, i) } else { a });
        assert!((most / (10.0 * 10.0 / disc) - 1.0).abs() < 0.01, "{most}");
        let u = Vector3::from(direction(place).unwrap());
        assert!((u * R - Vector3::new(0.0, 0.0, -R)).norm() < 1.2, "under the lamp");
        // A place beside the axis, by the angle between the ray and the sphere written out.
        let beside = cell_of([0.17, 0.0, -1.0]).unwrap();
        let p = Vector3::from(direction(beside).unwrap()) * R;
        let (dx, dz) = (p.x.hypot(p.y), 8.0 - R - p.z);
        let (theta, polar) = (dx.atan2(dz), p.x.hypot(p.y).atan2(-p.z));
        let at_8_mm = 10.0 * 10.0 / disc;
        let expected = at_8_mm * 64.0 / (dx * dx + dz * dz) * (theta - polar).cos();
        assert!(theta < 0.3, "at full intensity: {theta}");
        assert!((dose.mj_mm2[beside] / expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_lamp_at_the_retina_is_counted_at_the_least_distance() {
        let near = dose(&pipe([0.1, 0.1, 0.2 - R], [0.1, 0.1, -R]), 1.0);
        let most = near.mj_mm2.iter().copied().fold(0.0, f64::max);
        let expected = 10.0 / (std::f64::consts::PI * (0.5 * 0.6f64.tan()).powi(2));
        assert!((most / expected - 1.0).abs() < 0.01, "{most}, expected {expected}");
    }

    #[test]
    fn outside_the_eye_and_away_from_the_retina_nothing_is_counted() {
        assert_eq!(dose(&pipe([0.0, 0.0, 12.0], [0.0, 0.0, -R]), 1.0), DoseState::start());
        assert_eq!(dose(&pipe([0.0, 0.0, 5.0], [0.0, 0.0, R]), 1.0), DoseState::start());
    }

    proptest! {
        /// Energy: whatever the pose, all cells together have got the intensity, summed up over the
        /// beam's solid angle.
        #[test]
        fn no_light_is_lost(x in -3.0..3.0f64, y in -3.0..3.0f64, z in -3.0..1.0f64, to in prop::array::uniform2(-0.35..0.35f64)) {
            let (tip, target) = ([x, y, z], [R * to[0].sin(), R * to[1].sin(), -R]);
            let dose = dose(&pipe(tip, target), 1.0);
            let all = dose.mj_mm2.iter().sum::<f64>() * cell_mm2(R);
            let intensity = 10.0 / (std::f64::consts::PI * 0.6f64.tan().powi(2));
            // A smooth step has the mean 1/2.
            let full = 1.0 - 0.3f64.cos() + 0.5 * (0.3f64.cos() - 0.82f64.cos());
            let expected = intensity * 2.0 * std::f64::consts::PI * full;
            prop_assert!((all / expected - 1.0).abs() < 0.12, "{all} mJ of {expected}");
        }
    }
}
