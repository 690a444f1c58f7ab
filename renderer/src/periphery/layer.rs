//! Lines drawn on the map.

use super::{Tip, direction};
use crate::fundus_map::{RADIUS_MM, map_scale};
use scene::Side;

/// Shares of something on the map, 0 to 1.
pub struct Layer {
    size: usize,
    /// +1 where temporal is +x.
    mirror: f32,
    pub shares: Vec<f32>,
}

impl Layer {
    pub fn new(size: usize, side: Side) -> Self {
        let mirror = if side == Side::Left { 1.0 } else { -1.0 };
        Layer { size, mirror, shares: vec![0.0; size * size] }
    }

    /// Pixel of a place, from the middle of the map.
    fn pixel(&self, theta: f32, bearing: f32) -> [f32; 2] {
        let rho = 2.0 * (0.5 * theta).sin() * map_scale() * self.size as f32;
        let [temporal, down] = direction(bearing);
        [self.mirror * temporal * rho, -down * rho]
    }

    /// A soft line; one thinner than a pixel is as much fainter.
    pub fn line(&mut self, from: &Tip, to: &Tip, share: f32) {
        let [a, b] = [from, to].map(|t| self.pixel(t.theta, t.bearing));
        let wanted = to.radius_mm / RADIUS_MM * map_scale() * self.size as f32;
        let radius = wanted.max(0.8);
        let stamps = (2.0 * (b[0] - a[0]).hypot(b[1] - a[1]) / radius).ceil().max(1.0);
        for k in 1..=stamps as usize {
            let at = [0, 1].map(|c| a[c] + (b[c] - a[c]) * k as f32 / stamps);
            self.stamp(at, radius, share * (wanted / radius));
        }
    }

    /// A soft disc.
    fn stamp(&mut self, at: [f32; 2], radius: f32, share: f32) {
        let (reach, last) = (1.6 * radius, self.size as f32 - 1.0);
        let [x, y] = at.map(|c| c + 0.5 * last);
        let range = |c: f32| (c - reach).ceil().max(0.0) as usize..=(c + reach).floor().min(last) as usize;
        for j in range(y) {
            for i in range(x) {
                let away2 = ((i as f32 - x).powi(2) + (j as f32 - y).powi(2)) / (radius * radius);
                let here = &mut self.shares[j * self.size + i];
                *here = here.max(share * (-away2 * away2).exp()).min(1.0);
            }
        }
    }
}
