//! Vertices as features of a look.

use super::Zcoll;
use crate::instrument_image::{InstrumentImage, NOTHING};
use crate::quantize::QuantizedVertex;
use crate::raster::SUBPIXELS;
use crate::surface::Surface;

impl Zcoll {
    /// Vertices as features: the vertices of living triangles that lie in the volume and behind the
    /// instrument, each with its own depth below the instrument's, in depth steps. Unlike triangles
    /// they are not limited to one per pixel. Of the last [`Self::query`] or
    /// [`Self::query_reversed`], which must have had the same arguments.
    pub fn vertices(&mut self, image: &InstrumentImage, surface: &Surface) -> &[(u32, i32)] {
        let (looked_from, reversed) = self.looked;
        let side = if reversed { image.back() } else { image.ahead() };
        self.vertex_hits.clear();
        if side.rect.is_empty() {
            return &self.vertex_hits;
        }
        #[cfg(feature = "gpu")]
        if self.gpu.is_some() {
            let mut hits = std::mem::take(&mut self.vertex_hits);
            let answer = self.ask_gpu(|gpu| gpu.vertices().map(|found| hits.extend_from_slice(found)));
            self.vertex_hits = hits;
            if answer.is_some() {
                return &self.vertex_hits;
            }
            // The processor has not seen the last look yet.
            self.query_side(&side, &looked_from, surface, &mut |_| {});
        }
        #[cfg(not(feature = "gpu"))]
        let _ = looked_from;
        let width = self.canvas.resolution as i32;
        let context = &mut (&self.canvas.vertex, &mut self.vertex_hits);
        self.cull.for_each_survivor(
            surface.triangles.len(),
            context,
            |_, _| (),
            |(vertex, hits), from, to| {
                let alive = (from..to).filter(|&t| surface.alive[t] != 0);
                for &v in alive.flat_map(|t| &surface.triangles[t]) {
                    let QuantizedVertex { at: [x, y, z], code } = vertex[v as usize];
                    let [column, row] = [x.div_euclid(SUBPIXELS), y.div_euclid(SUBPIXELS)];
                    let inside = (0..width).contains(&column) && (0..width).contains(&row);
                    let z_i = if inside { side.depth[(row * width + column) as usize] } else { NOTHING };
                    if code == 0 && z_i < z {
                        hits.push((v, z - z_i));
                    }
                }
            },
        );
        self.vertex_hits.sort_unstable();
        self.vertex_hits.dedup();
        &self.vertex_hits
    }
}
