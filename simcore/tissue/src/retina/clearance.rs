//! How far a point is before the retina, wherever the retina is.

use super::Retina;
use super::line::Line;
use super::state::RetinaState;
use nalgebra::Vector3;

/// Distance of a point from the retina.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// Towards the eye's centre above 0, behind the retina below, mm.
    pub mm: f64,
    /// The retina there is off the choroid.
    pub loose: bool,
}

impl Retina {
    /// Clearance of a point from the retina on the ray from the eye's centre through it; of several
    /// layers the one nearest to the centre counts, which a tip meets first. Over gaps that were
    /// torn it is that from the choroid.
    pub fn clearance(&mut self, state: &RetinaState, point_mm: &Vector3<f64>) -> Clearance {
        let distance = point_mm.norm();
        let mut found = Clearance { mm: self.figures.radius_mm - distance, loose: false };
        if distance == 0.0 || self.blebs.count() == 0 {
            return found;
        }
        let mut nearest = self.figures.radius_mm;
        let along = point_mm / distance;
        let line = Line { from_mm: Vector3::zeros(), along, reach_mm: nearest };
        self.sides.compare(&line, &state.sheet.position_mm, self.body.span());
        for &t in (0..self.blebs.count()).flat_map(|b| self.blebs.triangles_of(b)) {
            let meets = self.sides.may_meet(&self.body.mesh.triangles[t as usize]);
            if !meets || self.body.active()[t as usize] == 0 {
                continue;
            }
            let [a, b, c] = self.corners(state, t);
            // Corners are counter-clockwise seen from the centre, so that all three weights are
            // below 0 inside the triangle's cone.
            let weights = [(&b, &c), (&c, &a), (&a, &b)].map(|(from, to)| point_mm.dot(&from.cross(to)));
            let sum: f64 = weights.iter().sum();
            if weights.iter().any(|w| *w > 0.0) || sum >= 0.0 {
                continue;
            }
            let share = a.dot(&b.cross(&c)) / sum;
            if share > 0.0 && share * distance < nearest {
                nearest = share * distance;
                let normal = (b - a).cross(&(c - a)).normalize();
                found = Clearance { mm: (a - point_mm).dot(&-normal), loose: true };
            }
        }
        found
    }
}
