//! Pressure that stays normal to a triangulated surface as it moves.
//!
//! With V = ⅙ Σ a·(b × c) over the triangles, the volume between surface and origin, the energy is
//! −p V and each corner's force p ∂V/∂x. On a closed surface, or one whose rim is held, this is
//! conservative and its tangent symmetric. The tangent leaves out how the load turns where asked
//! ([`Pressure::turns`]), which keeps a system positive.

use super::{Elastic, Point};

/// Pressure on a surface.
#[derive(Debug, Clone, Default)]
pub struct Pressure {
    /// Corners of each triangle; the normal by the right-hand rule is the way the pressure pushes.
    pub triangles: Vec<[u32; 3]>,
    /// Pressure, Pa.
    pub pressure_pa: f64,
    /// Further pressure for each mm³ that the volume lacks to `volume_mm3`, Pa/mm³: 0 for none.
    /// Large values prescribe the volume.
    pub bulk_pa_per_mm3: f64,
    /// Volume at which that further pressure is 0, mm³.
    pub volume_mm3: f64,
    /// Whether the tangent holds how the load turns with the surface.
    pub turns: bool,
    x_mm: Vec<Point>,
    gradient_mm2: Vec<Point>,
    now_pa: f64,
}

impl Pressure {
    /// A constant pressure.
    pub fn new(triangles: Vec<[u32; 3]>, pressure_pa: f64) -> Self {
        Pressure { triangles, pressure_pa, turns: true, ..Pressure::default() }
    }

    /// Volume between the surface and the origin, mm³.
    pub fn volume_mm3(&self, x_mm: &[Point]) -> f64 {
        let volume = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| x_mm[n as usize]);
            a.dot(&b.cross(&c)) / 6.0
        };
        self.triangles.iter().map(volume).sum()
    }

    /// Pressure at `x_mm`, Pa.
    pub fn now_pa(&self, x_mm: &[Point]) -> f64 {
        if self.bulk_pa_per_mm3 == 0.0 {
            return self.pressure_pa;
        }
        self.pressure_pa + self.bulk_pa_per_mm3 * (self.volume_mm3 - self.volume_mm3(x_mm))
    }

    fn add_gradient(&self, scale: f64, x_mm: &[Point], out: &mut [Point]) {
        for t in &self.triangles {
            let nodes = t.map(|n| n as usize);
            let [a, b, c] = nodes.map(|n| x_mm[n]);
            out[nodes[0]] += b.cross(&c) * (scale / 6.0);
            out[nodes[1]] += c.cross(&a) * (scale / 6.0);
            out[nodes[2]] += a.cross(&b) * (scale / 6.0);
        }
    }
}

impl Elastic for Pressure {
    fn add_forces(&self, x_mm: &[Point], _: &[Point], force_un: &mut [Point]) {
        self.add_gradient(self.now_pa(x_mm), x_mm, force_un);
    }

    fn linearise(&mut self, x_mm: &[Point]) {
        self.x_mm.clear();
        self.x_mm.extend_from_slice(x_mm);
        let mut gradient = std::mem::take(&mut self.gradient_mm2);
        gradient.clear();
        gradient.resize(x_mm.len(), Point::zeros());
        self.add_gradient(1.0, x_mm, &mut gradient);
        self.gradient_mm2 = gradient;
        self.now_pa = self.now_pa(x_mm);
    }

    fn add_product(&self, stiffness: f64, _: f64, p: &[Point], out: &mut [Point]) {
        if self.bulk_pa_per_mm3 != 0.0 {
            let change = super::conjugate::dot(&self.gradient_mm2, p);
            let scale = stiffness * self.bulk_pa_per_mm3 * change;
            out.iter_mut().zip(&self.gradient_mm2).for_each(|(o, g)| *o += g * scale);
        }
        if !self.turns {
            return;
        }
        let scale = -stiffness * self.now_pa / 6.0;
        for t in &self.triangles {
            let nodes = t.map(|n| n as usize);
            let ([a, b, c], [u, v, w]) = (nodes.map(|n| self.x_mm[n]), nodes.map(|n| p[n]));
            out[nodes[0]] += (v.cross(&c) + b.cross(&w)) * scale;
            out[nodes[1]] += (w.cross(&a) + c.cross(&u)) * scale;
            out[nodes[2]] += (u.cross(&b) + a.cross(&v)) * scale;
        }
    }

    fn energy_nj(&self, x_mm: &[Point]) -> f64 {
        let volume = self.volume_mm3(x_mm);
        let lack = self.volume_mm3 - volume;
        0.5 * self.bulk_pa_per_mm3 * lack * lack - self.pressure_pa * volume
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::*;
    use super::*;

    /// A tetrahedron of volume 1/6, seen from outside.
    fn closed() -> (Pressure, Vec<Point>) {
        let x = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        (Pressure::new(faces, 50.0), x.map(Point::from).to_vec())
    }

    #[test]
    fn a_closed_surface_has_its_volume_wherever_it_is() {
        let (pressure, x) = closed();
        let moved: Vec<Point> = x.iter().map(|x| x + Point::new(3.0, -2.0, 5.0)).collect();
        assert!((pressure.volume_mm3(&x) - 1.0 / 6.0).abs() < 1e-15);
        assert!((pressure.volume_mm3(&moved) - 1.0 / 6.0).abs() < 1e-13);
    }

    #[test]
    fn forces_and_tangent_are_consistent_with_and_without_bulk() {
        for bulk in [0.0, 200.0] {
            let (mut pressure, x) = closed();
            (pressure.bulk_pa_per_mm3, pressure.volume_mm3) = (bulk, 0.3);
            let x = jitter(&x, 0.1, 4);
            forces_follow_from_energy(&pressure, &x, 50.0);
            tangent_follows_from_forces(&mut pressure, &x, 1e-6);
        }
    }
}
