//! The membrane's images of a look: its depth and its triangles, drawn in integers where there is
//! instrument.

use super::Contacts;
use crate::instrument_image::{NOTHING, Side};
use crate::quantize::{PLANES, QuantizedVertex, REFUSED};
use crate::raster::{self, DEPTH_STEPS, Drawn, Rect};
use crate::surface::Surface;

/// The membrane's images and the vertices drawn into them.
#[derive(Debug)]
pub(super) struct Canvas {
    pub(super) resolution: usize,
    pub(super) vertex: Vec<QuantizedVertex>,
    pub(super) depth: Vec<i32>,
    pub(super) id: Vec<u32>,
    pub(super) second: Vec<u8>,
}

impl Canvas {
    pub(super) fn clear(&mut self, rect: Rect) {
        for row in rect.min[1] as usize..rect.max[1] as usize {
            let first = row * self.resolution;
            let pixels = first + rect.min[0] as usize..first + rect.max[0] as usize;
            self.depth[pixels.clone()].fill(NOTHING);
            self.second[pixels].fill(0);
        }
    }

    pub(super) fn draw(
        &mut self,
        side: &Side,
        surface: &Surface,
        range: std::ops::Range<usize>,
        found: &mut Contacts,
    ) {
        let (triangles, alive) = (&surface.triangles[range.clone()], &surface.alive[range.clone()]);
        for ((nodes, alive), t) in triangles.iter().zip(alive).zip(range) {
            let [a, b, c] = nodes.map(|n| self.vertex[n as usize]);
            if a.code & b.code & c.code & PLANES != 0 || *alive == 0 {
                continue;
            }
            if (a.code | b.code | c.code) & REFUSED != 0 {
                found.refused += 1;
                continue;
            }
            self.draw_one(side, [a.at, b.at, c.at], t as u32, found);
        }
    }

    fn draw_one(&mut self, side: &Side, vertices: [raster::Fixed; 3], triangle: u32, found: &mut Contacts) {
        let Canvas { depth, id, second, resolution, .. } = self;
        let drawn = raster::triangle(vertices, side.rect, |x, y, z| {
            let pixel = y as usize * *resolution + x as usize;
            if side.depth[pixel] == NOTHING {
                return;
            }
            let z = z.steps();
            if !(0..=DEPTH_STEPS).contains(&z) {
                return;
            }
            if depth[pixel] != NOTHING && second[pixel] == 0 {
                second[pixel] = 1;
                found.folded += 1;
            }
            if z < depth[pixel] {
                (depth[pixel], id[pixel]) = (z, triangle);
            }
        });
        found.flat += u32::from(drawn == Drawn::Flat);
    }

    /// The rows of the instrument's rectangle: number of the first pixel, membrane depths,
    /// instrument depths.
    pub(super) fn rows<'a>(&'a self, side: &'a Side) -> impl Iterator<Item = (usize, &'a [i32], &'a [i32])> {
        (side.rect.min[1] as usize..side.rect.max[1] as usize).map(move |row| {
            let first = row * self.resolution + side.rect.min[0] as usize;
            let pixels = first..row * self.resolution + side.rect.max[0] as usize;
            (first, &self.depth[pixels.clone()], &side.depth[pixels])
        })
    }
}
