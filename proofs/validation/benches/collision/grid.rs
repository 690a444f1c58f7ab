//! A uniform grid, hashed and rebuilt every frame (Teschner et al., "Optimized spatial hashing for
//! collision detection of deformable objects", 2003), with the exact test behind it.

use crate::peers::{Method, triangle};
use crate::setting::{Frame, Setting};
use validation::exact::tritri::Corner;

/// Side of a cell, mm: about a triangle of the membrane.
const CELL_MM: f32 = 0.12;

/// The grid over the membrane's triangles.
pub struct HashedGrid {
    corners: Vec<Corner>,
    /// Log₂ of the buckets.
    bits: u32,
    /// Where each bucket begins in `entries`.
    first: Vec<u32>,
    entries: Vec<u32>,
    places: Vec<(u32, u32)>,
    candidates: Vec<u32>,
    pairs: Vec<(u32, u32)>,
}

impl HashedGrid {
    /// Buckets for about one triangle each.
    pub fn new(setting: &Setting) -> Self {
        let bits = setting.triangles.len().next_power_of_two().trailing_zeros() + 1;
        HashedGrid {
            corners: Vec::new(),
            bits,
            first: vec![0; (1 << bits) + 1],
            entries: Vec::new(),
            places: Vec::new(),
            candidates: Vec::new(),
            pairs: Vec::new(),
        }
    }
}

/// Calls `each(bucket)` for the cells that a box meets.
fn cells([low, high]: [Corner; 2], cell: i32, bits: u32, mut each: impl FnMut(u32)) {
    let [low, high] = [low, high].map(|c| c.map(|c| c.div_euclid(cell)));
    for z in low[2]..=high[2] {
        for y in low[1]..=high[1] {
            for x in low[0]..=high[0] {
                let hash = (x as u32).wrapping_mul(73_856_093)
                    ^ (y as u32).wrapping_mul(19_349_663)
                    ^ (z as u32).wrapping_mul(83_492_791);
                each(hash.wrapping_mul(0x9e37_79b1) >> (32 - bits));
            }
        }
    }
}

impl Method for HashedGrid {
    fn name(&self) -> &'static str {
        "grid"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.corners);
        let cell = (CELL_MM * frame.mesh.scale()) as i32;
        self.places.clear();
        self.first.fill(0);
        for t in 0..frame.surface.triangles.len() {
            if let Some(mine) = triangle(frame, &self.corners, t) {
                cells(mine.bounds(), cell, self.bits, |bucket| {
                    self.places.push((bucket, t as u32));
                    self.first[bucket as usize] += 1;
                });
            }
        }
        let mut sum = 0;
        for count in &mut self.first {
            sum += *count;
            *count = sum;
        }
        self.entries.resize(self.places.len(), 0);
        for &(bucket, t) in self.places.iter().rev() {
            let at = &mut self.first[bucket as usize];
            *at -= 1;
            self.entries[*at as usize] = t;
        }
    }
    fn query(&mut self, frame: &Frame) -> usize {
        let cell = (CELL_MM * frame.mesh.scale()) as i32;
        self.pairs.clear();
        for (other, number) in frame.mesh.triangles() {
            self.candidates.clear();
            cells(other.bounds(), cell, self.bits, |bucket| {
                let [from, to] = [bucket, bucket + 1].map(|b| self.first[b as usize] as usize);
                self.candidates.extend_from_slice(&self.entries[from..to]);
            });
            self.candidates.sort_unstable();
            self.candidates.dedup();
            for &t in &self.candidates {
                if triangle(frame, &self.corners, t as usize).is_some_and(|mine| mine.intersects(other)) {
                    self.pairs.push((t, *number));
                }
            }
        }
        self.pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}
