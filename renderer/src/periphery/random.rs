//! Chance that is the same on every machine, and smooth noise of a place.

/// Smooth noise of the place, −1 to 1.
#[derive(Debug, Clone, Copy)]
pub struct Noise(pub u64);

impl Noise {
    pub fn at(self, [x, y]: [f32; 2]) -> f32 {
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (smooth(x - i), smooth(y - j));
        let corner = |di: i64, dj: i64| {
            let place = ((i as i64 + di) as u64) << 32 ^ (j as i64 + dj) as u32 as u64;
            Random(place ^ self.0 << 17).share() * 2.0 - 1.0
        };
        let row = |dj: i64| corner(0, dj) * (1.0 - u) + corner(1, dj) * u;
        row(0) * (1.0 - v) + row(1) * v
    }
}

/// SplitMix64 (Steele, Lea, Flood: OOPSLA 2014): the same periphery on every machine.
pub struct Random(pub u64);

impl Random {
    /// 0 to 1.
    pub fn share(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// −`most` to `most`.
    pub fn within(&mut self, most: f32) -> f32 {
        most * (2.0 * self.share() - 1.0)
    }
}

/// 0 below 0, 1 above 1, smooth between.
pub fn smooth(share: f32) -> f32 {
    let s = share.clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}
