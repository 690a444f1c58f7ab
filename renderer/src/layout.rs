//! The structs that the shaders see, in one place. `tests/shaders.rs` compares sizes and offsets
//! with those in `passes/common.wgsl`. Everything is in the eye frame, mm, linear light.

use crate::fundus_map;
use bytemuck::{Pod, Zeroable};
use protocol::limits::INSTRUMENTS;

/// One instrument.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct InstrumentUniform {
    /// Columns of `eye_from_instrument`.
    pub eye_from_instrument: [[f32; 4]; 4],
    /// Half the jaw opening (rad), z of the pivot (mm), opacity, 1 if the lamp lights it.
    pub shape: [f32; 4],
    /// Radius and length of the shaft (mm), 1 if it is drawn, height over the tip from which it is
    /// round (mm).
    pub shaft: [f32; 4],
}

/// What is the same for both channels.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct FrameUniform {
    /// Columns of the lamp's projection.
    pub lamp_from_eye: [[f32; 4]; 4],
    /// Position, and irradiance at 1 mm.
    pub lamp_position: [f32; 4],
    /// Direction of the beam, and cosine of the outer edge of its cone.
    pub lamp_direction: [f32; 4],
    /// Linear RGB, and 1 / (cosine of the inner edge − cosine of the outer edge).
    pub lamp_colour: [f32; 4],
    /// Scattered light, and the share of light that the membrane takes away.
    pub ambient: [f32; 4],
    /// Radius (mm), map scale, 0, strength of the specular film.
    pub retina: [f32; 4],
    /// Depth bias, half width of the soft edge (share of a tile), relief of the vessels, membrane
    /// detail.
    pub shadow: [f32; 4],
    /// Growth of a shadow's soft edge with the difference of depths in the map, widest half width
    /// that is looked for (shares of a tile), 1 / radius of the retina (1/mm), 0.
    pub penumbra: [f32; 4],
    /// Corner of the vitreous' densities with the smallest coordinates, and extinction at full
    /// density (1/mm).
    pub haze_corner: [f32; 4],
    /// Edges of their box, 0.
    pub haze_size: [f32; 4],
    /// The instruments.
    pub instruments: [InstrumentUniform; INSTRUMENTS],
}

/// What differs between the channels.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ViewUniform {
    /// Columns of the channel's projection.
    pub clip_from_eye: [[f32; 4]; 4],
    /// Position of the channel's objective, and height of a pixel in NDC.
    pub camera: [f32; 4],
    /// Middle of the plane through the target.
    pub plane_origin: [f32; 4],
    /// Way of one unit of NDC x in that plane; width of a cell of the retina in NDC.
    pub plane_x: [f32; 4],
    /// Way of one unit of NDC y; height of a cell.
    pub plane_y: [f32; 4],
    /// Field coordinates per NDC x and y, squared inner edge of the border, 1 / (1 − that).
    pub field: [f32; 4],
}

/// A vertex of an instrument, instrument frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct MetalVertex {
    /// mm.
    pub position: [f32; 3],
    /// Unit, outwards.
    pub normal: [f32; 3],
    /// 0 shaft, +1 the jaw on the +x side, −1 the other.
    pub part: f32,
    /// 0 metal, 1 glowing fibre, 2 dark port.
    pub material: f32,
}

/// A vertex of the membrane or of lifted retina, eye frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TissueVertex {
    /// mm.
    pub position: [f32; 3],
    /// Unit.
    pub normal: [f32; 3],
    /// 1 on an edge of the sheet, and the share of the dye that it can take.
    pub more: [f32; 2],
}

/// Where a vertex of the membrane or of lifted retina lay at the start.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TissueHome {
    /// Place in the fundus map, 0 to 1.
    pub in_map: [f32; 2],
    /// Way to the edge that the sheet had, mm.
    pub from_edge_mm: f32,
}

impl TissueHome {
    /// Of a place in the eye, mm.
    pub fn of(position_mm: [f32; 3], from_edge_mm: f32) -> Self {
        TissueHome { in_map: fundus_map::coordinates(position_mm), from_edge_mm }
    }
}

/// Both vertex types look the same to the GPU: two vectors of three, two numbers.
pub const VERTEX_STRIDE: u64 = size_of::<MetalVertex>() as u64;
const _: () = assert!(size_of::<MetalVertex>() == 32 && size_of::<TissueVertex>() == 32);
