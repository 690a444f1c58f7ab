//! Whether an instrument can touch the membrane at all.

use crate::state::MembraneState;
use nalgebra::Vector3;
use protocol::scene::NODE_DEAD;

/// True if the box around the living nodes comes within `reach_mm` of `tip_in_eye`, axis by axis.
pub fn near_membrane(membrane: &MembraneState, tip_in_eye: &Vector3<f64>, reach_mm: f64) -> bool {
    let living = |axis: usize| {
        let places = membrane.position_mm[axis].iter().zip(&membrane.flag);
        places.filter(|(_, flag)| **flag != NODE_DEAD).map(|(&p, _)| f64::from(p))
    };
    (0..3).all(|axis| {
        let at = tip_in_eye[axis];
        living(axis).any(|p| p < at + reach_mm) && living(axis).any(|p| p > at - reach_mm)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::sheet::Sheet;
    use scene::SceneFile;

    #[test]
    fn membrane_far_away_is_not_near() {
        let membrane = Sheet::new(&SceneFile::load("peel").unwrap()).unwrap().start();
        assert!(near_membrane(&membrane, &Vector3::new(0.0, 0.0, -10.0), 1.6));
        assert!(!near_membrane(&membrane, &Vector3::new(0.0, 0.0, -5.0), 1.6));
    }
}
