//! Grid of square cells over the round field; the shaders project its corners onto the retina.
//! Their borders lie on multiples of four pixels: a processor that draws shades whole blocks of
//! 4×4, and a block that an edge cuts is shaded once for each of its sides.

use crate::governor::Tier;
use crate::passes::IndexList;
use crate::view::FIELD_FILL;
use wgpu::Device;

/// Corners of a row, as in `fundus.wgsl`.
const ROW: u32 = 32;
/// Cells along a picture's width, about: 0.7 mm of a field of 16 mm, over which the retina bulges
/// by 5 µm, a tenth of a pixel.
const ALONG: u32 = 25;
/// Edge of the blocks, px.
const BLOCK_PX: u32 = 4;

/// Edge of a tier's cells, px.
pub fn cell_px(tier: &Tier) -> u32 {
    let blocks = (2 * tier.width_px + ALONG * BLOCK_PX) / (2 * ALONG * BLOCK_PX);
    blocks.max(2) * BLOCK_PX
}

/// A tier's cells, for its shaders: their width and height in NDC.
pub fn cell_ndc(tier: &Tier) -> [f32; 2] {
    [tier.width_px, tier.height_px].map(|size| 2.0 * cell_px(tier) as f32 / size as f32)
}

/// Indices of the triangles of all cells that reach into the round field, row by row.
fn triangles(tier: &Tier) -> Vec<u32> {
    let cell = cell_px(tier);
    let [columns, rows] = [tier.width_px, tier.height_px].map(|size| size.div_ceil(cell));
    let radius = 0.5 * FIELD_FILL * f64::from(tier.height_px);
    // Distance of the nearest pixel of cell `i` to the middle, along an axis.
    let away = |i: u32, size: u32| {
        let [from, to] = [i, i + 1].map(|k| f64::from(k * cell) - 0.5 * f64::from(size));
        from.max(-to).max(0.0)
    };
    let mut corners = Vec::new();
    for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        if away(column, tier.width_px).hypot(away(row, tier.height_px)) < radius {
            let a = row * ROW + column;
            let (b, c, d) = (a + 1, a + ROW, a + ROW + 1);
            corners.extend([a, c, d, a, d, b]);
        }
    }
    corners
}

/// The cells of a tier on the device.
pub fn cells(device: &Device, tier: &Tier) -> IndexList {
    IndexList::new(device, "cells", &triangles(tier))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::governor::TIERS;

    /// Pixel coordinates of a corner, as the shader has it.
    fn place(tier: &Tier, index: u32) -> [f64; 2] {
        let ndc = cell_ndc(tier).map(f64::from);
        let x = (f64::from(index % ROW) * ndc[0]) * 0.5 * f64::from(tier.width_px);
        [x, f64::from(index / ROW) * ndc[1] * 0.5 * f64::from(tier.height_px)]
    }

    #[test]
    fn every_pixel_of_the_field_lies_in_one_cell() {
        for tier in &TIERS {
            let mut covered = vec![0u32; (tier.width_px * tier.height_px) as usize];
            for cell in triangles(tier).chunks(6) {
                let ([x0, y0], [x1, y1]) = (place(tier, cell[0]), place(tier, cell[2]));
                assert!(x1 > x0 && y1 > y0);
                for y in y0.round() as u32..(y1.round() as u32).min(tier.height_px) {
                    for x in x0.round() as u32..(x1.round() as u32).min(tier.width_px) {
                        covered[(y * tier.width_px + x) as usize] += 1;
                    }
                }
            }
            assert!(covered.iter().all(|&n| n <= 1));
            let [w, h] = [tier.width_px, tier.height_px].map(|n| 0.5 * f64::from(n));
            for (i, &n) in covered.iter().enumerate() {
                let (x, y) = (i as u32 % tier.width_px, i as u32 / tier.width_px);
                let r = (f64::from(x) + 0.5 - w).hypot(f64::from(y) + 0.5 - h);
                assert!(n == 1 || r >= FIELD_FILL * h, "{tier:?}: ({x}, {y})");
            }
        }
    }

    #[test]
    fn borders_lie_between_blocks_and_rows_have_room() {
        for tier in &TIERS {
            let cell = cell_px(tier);
            assert_eq!(cell % BLOCK_PX, 0);
            assert!(tier.width_px.div_ceil(cell) < ROW, "{tier:?}");
            for index in triangles(tier) {
                let at = place(tier, index);
                let blocks = at.map(|c| c / f64::from(BLOCK_PX));
                assert!(blocks.iter().all(|b| (b - b.round()).abs() < 1e-3), "{at:?}");
            }
        }
    }
}
