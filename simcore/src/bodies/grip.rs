//! Forceps and bodies: closing jaws take a body that both of them touch; opening jaws, or a pull
//! beyond what friction holds, let it go.

use super::solve::TouchedBody;
use super::state::{BodyState, Grip};
use nalgebra::Isometry3;

/// Opening beyond that at the grip at which jaws release a body, rad.
pub const RELEASE_RAD: f64 = 0.05;

/// The body that the jaws of instrument `instrument` have between them: both touch it, from
/// opposite sides.
pub fn between_jaws(touched: &[TouchedBody], instrument: usize) -> Option<usize> {
    let by = |part: usize| touched.iter().filter(move |t| t.instrument == instrument && t.part == part);
    let pair = |one: &TouchedBody, other: &TouchedBody| {
        one.body == other.body && one.normal.dot(&other.normal) < 0.0
    };
    by(1).find(|one| by(2).any(|other| pair(one, other))).map(|t| t.body)
}

/// Takes a body as it lies between jaws of this opening.
pub fn take(body: usize, state: &BodyState, eye_from_instrument: &Isometry3<f64>, opening_rad: f64) -> Grip {
    Grip {
        body: body as u32,
        instrument_from_body: eye_from_instrument.inverse() * state.eye_from_body,
        opening_rad,
        slid_mm: 0.0,
    }
}

/// What the jaws could not hold slides through them: the grip goes where the body is. Returns by
/// how much, mm.
pub fn slide(grip: &mut Grip, state: &BodyState, eye_from_instrument: &Isometry3<f64>) -> f64 {
    let now = eye_from_instrument.inverse() * state.eye_from_body;
    let by = (now.translation.vector - grip.instrument_from_body.translation.vector).norm();
    if by > SLIDE_MM {
        grip.instrument_from_body.translation = now.translation;
        grip.slid_mm += by;
    }
    by
}

/// Less than this is rounding and the solver's rest, mm.
const SLIDE_MM: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn only_a_body_between_both_jaws_is_taken() {
        let at = |instrument, part, body, x: f64| TouchedBody {
            instrument,
            part,
            body,
            normal: Vector3::new(x, 0.1, 0.0),
        };
        assert_eq!(between_jaws(&[at(0, 1, 3, 1.0), at(0, 2, 3, -1.0)], 0), Some(3));
        assert_eq!(between_jaws(&[at(0, 1, 3, 1.0), at(0, 2, 3, -1.0)], 1), None, "another instrument's");
        assert_eq!(between_jaws(&[at(0, 1, 3, 1.0), at(0, 2, 4, -1.0)], 0), None, "two bodies");
        assert_eq!(between_jaws(&[at(0, 1, 3, 1.0), at(0, 2, 3, 1.0)], 0), None, "from one side");
        assert_eq!(between_jaws(&[at(0, 0, 3, 1.0), at(0, 2, 3, -1.0)], 0), None, "shaft and jaw");
    }
}
