//! What putting an instrument in, or taking it out, does to its motion across the shaft.
//!
//! The shaft turns about the trocar. With the lever L and the direction d from the tip to the trocar at Q, the tip is at
//! Q − L·d and moves with −L'·d − L·d'. A turn d' that goes on evenly moves the tip across the shaft by L·d', which grows
//! with L, while the motion −L'·d along the shaft turns with it. In the world the two together are the Coriolis
//! acceleration −2·L'·d': at 40 mm/s as large as all that is expected of a hand, so it would count as a manoeuvre.
//!
//! Within the eye a surgeon guides the tip, and turns the shaft as this needs. It is put in and taken out without being
//! guided across. So the effect is weighted by the speed along the shaft.

use super::transition::StateTransition;
use super::{InstrumentFilter, N, PLAY, Pivot, VECTORS};
use crate::block_matrix::combine_rows;
use crate::constants as k;
use nalgebra::{Matrix3, Vector3};

/// What a step does to velocity, lags and tremor besides the transition: half before it, half after it.
pub(super) struct Insertion {
    halves: [Matrix3<f64>; 2],
}

impl Insertion {
    /// Of a step from this direction (unit length) and lever to those `after`.
    fn new(before: (Vector3<f64>, f64), after: (Vector3<f64>, f64), weight: f64) -> Self {
        let scale = libm::pow(after.1 / before.1, 0.5 * weight);
        let turn = before.0.cross(&after.0) * (0.5 * weight);
        let rotation = Matrix3::identity() + turn.cross_matrix();
        let of =
            |d: Vector3<f64>| rotation * (Matrix3::identity() * scale + d * d.transpose() * (1.0 - scale));
        Insertion { halves: [of(before.0), of((rotation * before.0).normalize())] }
    }

    /// Applies a half to the vector states.
    pub fn apply_to_vectors(&self, half: usize, vectors: &mut [Vector3<f64>; VECTORS]) {
        vectors[1..PLAY].iter_mut().for_each(|v| *v = self.halves[half] * *v);
    }

    /// H·M, where `rows` are the rows of M, three for each vector, and H is a half.
    pub fn apply<const W: usize>(&self, half: usize, rows: &mut [[f64; W]; N]) {
        let f: [[f64; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|c| self.halves[half][(r, c)]));
        for vector in 1..PLAY {
            combine_rows(rows, [3 * vector, 3 * vector + 1, 3 * vector + 2], &f);
        }
    }
}

impl InstrumentFilter {
    /// `None` where the instrument is not put in or taken out, or turns freely.
    pub(super) fn insertion(&self, step: &StateTransition, pivot: &Pivot) -> Option<Insertion> {
        if !pivot.tracked {
            return None;
        }
        // Of the voluntary movement alone: nobody pushes a shaft in the direction of its tremor.
        let place = |vectors: &[Vector3<f64>; VECTORS]| {
            let to_pivot = pivot.position + vectors[PLAY] - vectors[0];
            let lever = to_pivot.norm();
            (to_pivot / lever, lever)
        };
        let before = place(&self.vectors);
        let along = self.vectors[1].dot(&before.0) / k::INSERTION_MM_S;
        let weight = 1.0 - 1.0 / (1.0 + along * along * along * along);
        if !(weight > k::LEAST_INSERTION && before.1 > k::SHORTEST_INSERTION_MM) {
            return None;
        }
        let mut vectors = self.vectors;
        step.apply_to_vectors(&mut vectors);
        let after = place(&vectors);
        (after.1 > k::SHORTEST_INSERTION_MM).then(|| Insertion::new(before, after, weight))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig_model::RigModel;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};
    use rig::Rig;

    const TROCAR: Pivot = Pivot { position: Vector3::new(0.0, 0.0, 20.0), sigma: 0.05, tracked: true };
    const MM_S: f64 = 40.0;

    /// The tip of a shaft that is put in, with `turn` rad/s about the trocar.
    fn tip(t_s: f64, turn: f64) -> Vector3<f64> {
        let (lever, angle) = (8.0 + MM_S * t_s, 0.1 + turn * t_s);
        TROCAR.position - lever * Vector3::new(libm::sin(angle), 0.0, libm::cos(angle))
    }

    fn put_in(turn: f64) -> InstrumentFilter {
        let rig = RigModel::new(&Rig::load_or_shipped(None).expect("the shipped rig"));
        let axis = (TROCAR.position - tip(0.0, turn)).normalize();
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis).expect("not opposite");
        let pose = Isometry3::from_parts(Translation3::from(tip(0.0, turn)), rotation);
        let covariance = crate::pose_math::Matrix6::identity() * 1e-6;
        let mut filter = InstrumentFilter::new(&pose, &covariance, Some(TROCAR), 0, &rig.bodies[0], None);
        filter.vectors[1] = (tip(1e-6, turn) - tip(-1e-6, turn)) / 2e-6;
        filter
    }

    #[test]
    fn a_shaft_that_turns_evenly_while_it_is_put_in_is_predicted() {
        let (mut largest, mut without) = (0.0_f64, 0.0_f64);
        for turn in [0.0, 0.2, -0.3] {
            let mut filter = put_in(turn);
            let straight = filter.vectors[0] + filter.vectors[1] * 0.2;
            for n in 1..=10 {
                filter.predict(n * 20_000_000, Some(TROCAR));
            }
            largest = largest.max((filter.pose().translation.vector - tip(0.2, turn)).norm());
            without = without.max((straight - tip(0.2, turn)).norm());
        }
        println!("{:.1} µm beside the true tip; along a line, {:.1}", 1e3 * largest, 1e3 * without);
        assert!(largest < 0.15 * without && without > 0.2, "{largest} of {without}");
    }

    #[test]
    fn slow_movement_and_free_shafts_are_left_as_they_are() {
        let mut filter = put_in(0.2);
        let model = RigModel::new(&Rig::load_or_shipped(None).expect("the shipped rig"));
        let step = StateTransition::new(0.02, &model.bodies[0].tuning, &filter.bank);
        assert!(filter.insertion(&step, &TROCAR).is_some());
        assert!(filter.insertion(&step, &Pivot { tracked: false, ..TROCAR }).is_none());
        filter.vectors[1] *= 0.05;
        assert!(filter.insertion(&step, &TROCAR).is_none());
    }
}
