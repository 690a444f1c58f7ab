//! What the shaders see: the block of a look, and where things lie in the buffers.

use crate::instrument_image::{Side, Volume};
use crate::raster::{DEPTH_STEPS, XY_LIMIT, Z_LIMIT};
use crate::surface::Frame;
use bytemuck::{Pod, Zeroable};

/// Words of counters before the images.
pub(super) const COUNTERS: usize = 16;
/// Results that come back with the counters in one transfer: triangles, nodes, pixels. A look that
/// found more fetches the rest in a second one.
pub(super) const AT_ONCE: [usize; 3] = [512, 1024, 1024];
/// Words of a result of each kind.
pub(super) const WORDS: [usize; 3] = [2, 2, 3];
/// The estimate of the cull is good for tips up to here from the origin, mm; it is the shader's
/// `FAR`.
const FAR_MM: f32 = 1e6;
/// Pixels around the instrument by which the estimate's box is wider than the exact test's, as in
/// the processor's cull.
const CULL_MARGIN: f32 = 2.0;

/// The block of a look; `QueryParams` in zcoll.wgsl says what is what.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct QueryParams {
    /// Rows of the rotation and the tip, bits of `f32`.
    pub turn: [[u32; 4]; 3],
    /// Scales and offsets, bits of `f32`.
    pub format: [u32; 4],
    /// Limits, 1/2, bits of `f32`; whether nothing may be culled by estimate.
    pub bound: [u32; 4],
    /// Limits, depth steps, resolution.
    pub limit: [i32; 4],
    /// The instrument's rectangle, pixels.
    pub rect: [i32; 4],
    /// Lower corner of the estimate's box, mm.
    pub low: [f32; 4],
    /// Upper corner of the estimate's box, mm.
    pub high: [f32; 4],
    /// Triangles, vertices, first words of the lists of nodes and of pixels.
    pub count: [u32; 4],
}

impl QueryParams {
    /// A look of an instrument at a mesh, from either of its ends.
    pub(super) fn new(frame: &Frame, volume: &Volume, side: &Side, lists: &Lists) -> Self {
        let [xy, ahead] = volume.format();
        let z = if side.reversed { volume.format_back() } else { ahead };
        let (turn, tip) = (frame.turn(), frame.tip());
        let row = |i: usize| [turn[i][0], turn[i][1], turn[i][2], tip[i]].map(f32::to_bits);
        let estimable = tip.iter().all(|c| c.abs() < FAR_MM) && turn.iter().flatten().all(|c| c.abs() < 2.0);
        let [low, high] = volume.box_around(side.rect, CULL_MARGIN);
        let wide = |v: [f32; 3]| [v[0], v[1], v[2], 0.0];
        let (min, max) = (side.rect.min, side.rect.max);
        QueryParams {
            turn: [row(0), row(1), row(2)],
            format: [xy.scale, xy.offset, z.scale, z.offset].map(f32::to_bits),
            bound: [
                (XY_LIMIT as f32).to_bits(),
                (Z_LIMIT as f32).to_bits(),
                0.5f32.to_bits(),
                u32::from(!estimable),
            ],
            limit: [XY_LIMIT, Z_LIMIT, DEPTH_STEPS, volume.resolution as i32],
            rect: [min[0], min[1], max[0], max[1]],
            low: wide(low),
            high: wide(high),
            count: [lists.triangles as u32, lists.nodes as u32, lists.first[1] as u32, lists.first[2] as u32],
        }
    }
}

/// Sizes of the mesh, and of the lists that a look fills.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lists {
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Vertices of the mesh.
    pub nodes: usize,
    /// Most results of each kind: triangles, nodes (or vertices), pixels.
    pub most: [usize; 3],
    /// First word of each kind's list.
    pub first: [usize; 3],
}

impl Lists {
    pub(super) fn new(triangles: usize, nodes: usize, pixels: usize) -> Self {
        let most = [pixels.min(triangles), nodes, pixels];
        let second = most[0] * WORDS[0];
        Lists { triangles, nodes, most, first: [0, second, second + most[1] * WORDS[1]] }
    }

    /// Words of all lists.
    pub(super) fn words(&self) -> usize {
        self.first[2] + self.most[2] * WORDS[2]
    }

    /// How many results of each kind come back at once.
    pub(super) fn at_once(&self) -> [usize; 3] {
        std::array::from_fn(|k| self.most[k].min(AT_ONCE[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::offset_of;
    use wgpu::naga::TypeInner;
    use wgpu::naga::front::wgsl;
    use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};

    #[test]
    fn the_shaders_are_valid_and_see_the_same_block() {
        let text = super::super::SHADER;
        let module = wgsl::parse_str(text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
        let valid = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
        assert!(valid.is_ok(), "{}", valid.unwrap_err().emit_to_string(text));
        let (_, block) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some("QueryParams")).unwrap();
        let TypeInner::Struct { members, span } = &block.inner else { panic!("QueryParams is no struct") };
        let theirs: Vec<_> =
            members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize)).collect();
        let ours = [
            ("turn", offset_of!(QueryParams, turn)),
            ("format", offset_of!(QueryParams, format)),
            ("bound", offset_of!(QueryParams, bound)),
            ("limit", offset_of!(QueryParams, limit)),
            ("rect", offset_of!(QueryParams, rect)),
            ("low", offset_of!(QueryParams, low)),
            ("high", offset_of!(QueryParams, high)),
            ("count", offset_of!(QueryParams, count)),
        ];
        assert_eq!(theirs, ours.map(|(name, at)| (name.to_owned(), at)));
        assert_eq!(*span as usize, size_of::<QueryParams>());
    }
}
