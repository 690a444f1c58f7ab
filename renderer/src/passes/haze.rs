//! The vitreous: bricks of densities gathered in one 3D texture, drawn as a haze.

use super::{
    IndexList, PassDevice, PipelineSpec, Uniforms, sampled_group, sampled_layout, texture_descriptor,
};
use crate::governor::Shading;
use crate::layout::FrameUniform;
use protocol::scene::SceneBrick;
use wgpu::{
    BindGroup, BindGroupLayout, BlendState, CompareFunction, Device, Extent3d, FilterMode, Queue, RenderPass,
    RenderPipeline, Texture, TextureFormat, TextureUsages, TextureViewDimension,
};

/// Densities along a brick.
const BRICK: u32 = 8;
/// Bricks along an axis at most: a texture of 16 MB.
const MAX_ALONG: u32 = 32;
/// Extinction at full density, 1/mm. Vitreous is clear; with the tracer that surgeons inject to see
/// it (triamcinolone) a beam of 10 mm through the core (density 90 of 255) loses about a quarter.
const EXTINCTION: f32 = 0.08;

/// Where the bricks lie.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Lattice {
    /// Corner with the smallest coordinates, eye frame, mm.
    corner: [f32; 3],
    /// Edge of a brick, mm.
    edge: f32,
    /// Bricks along each axis.
    along: [u32; 3],
}

/// The pass.
pub struct Haze {
    layout: BindGroupLayout,
    pipelines: [RenderPipeline; 2],
    volume: Option<(Lattice, Texture, BindGroup)>,
    /// The bricks as the device has them.
    known: Vec<SceneBrick>,
}

impl Haze {
    /// Makes the pipelines.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let layout = sampled_layout(device, "haze", TextureViewDimension::D3);
        let groups = [&uniforms.layout, light, &layout];
        let pipelines = device.shadings(|shading| {
            let (vertex, fragment, compare) = match shading {
                // The march stops at the shafts, so this haze covers instruments as well.
                Shading::Full => ("vs_main", "fs_haze", CompareFunction::Always),
                Shading::Lean => ("vs_haze_lean", "fs_haze_lean", CompareFunction::Less),
            };
            let spec = PipelineSpec {
                fragment: Some(fragment),
                depth: Some((compare, false)),
                blend: Some(BlendState::ALPHA_BLENDING),
                ..PipelineSpec::new("haze", vertex, &groups)
            };
            device.pipeline(&spec.shaded(shading))
        });
        Self { layout, pipelines, volume: None, known: Vec::new() }
    }

    /// Takes the bricks of a scene in; only those that changed are sent to the device. Bricks that
    /// do not lie on one lattice, or on one too large, are not drawn.
    pub fn set(&mut self, device: &Device, queue: &Queue, bricks: &[SceneBrick]) {
        let place = |b: &SceneBrick| (b.corner_mm, b.edge_mm);
        let same_places = self.known.len() == bricks.len()
            && self.known.iter().zip(bricks).all(|(a, b)| place(a) == place(b));
        if !same_places {
            self.known.clear();
            self.volume = lattice_of(bricks).map(|lattice| {
                let texture = texture(device, &lattice);
                let group = sampled_group(device, "haze", &self.layout, &texture, FilterMode::Linear);
                (lattice, texture, group)
            });
        }
        let Some((lattice, texture, _)) = &self.volume else { return };
        for (i, brick) in bricks.iter().enumerate() {
            match self.known.get_mut(i) {
                Some(known) if known.density == brick.density => continue,
                Some(known) => known.density = brick.density,
                None => self.known.push(*brick),
            }
            upload(queue, texture, lattice, brick);
        }
    }

    /// Fills in the haze's part of the uniform.
    pub fn write(&self, uniform: &mut FrameUniform) {
        let Some((lattice, ..)) = &self.volume else { return };
        let [x, y, z] = lattice.corner;
        uniform.haze_corner = [x, y, z, EXTINCTION];
        let [w, h, d] = lattice.along.map(|n| n as f32 * lattice.edge);
        uniform.haze_size = [w, h, d, 0.0];
    }

    /// Draws; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, cells: &IndexList, shading: Shading) {
        if let Some((_, _, group)) = &self.volume {
            pass.set_bind_group(2, group, &[]);
            cells.draw(pass, &self.pipelines[shading as usize]);
        }
    }
}

/// Number of the brick at `corner` along each axis.
fn cell(lattice: &Lattice, corner: [f32; 3]) -> [u32; 3] {
    std::array::from_fn(|c| ((corner[c] - lattice.corner[c]) / lattice.edge).round() as u32)
}

/// The lattice on which all bricks lie, if there is one.
fn lattice_of(bricks: &[SceneBrick]) -> Option<Lattice> {
    let edge = bricks.first()?.edge_mm;
    let sound = |b: &SceneBrick| b.edge_mm == edge && b.corner_mm.iter().all(|c| c.abs() < 1e3);
    let possible = edge > 0.0 && edge < 1e3;
    if !possible || !bricks.iter().all(sound) {
        return None;
    }
    let least = |c: usize| bricks.iter().map(|b| b.corner_mm[c]).fold(f32::MAX, f32::min);
    let mut lattice = Lattice { corner: std::array::from_fn(least), edge, along: [1; 3] };
    for brick in bricks {
        let at = cell(&lattice, brick.corner_mm);
        let on_lattice = (0..3).all(|c| {
            let exact = (brick.corner_mm[c] - lattice.corner[c]) / edge;
            at[c] < MAX_ALONG && (exact - at[c] as f32).abs() < 0.01
        });
        if !on_lattice {
            return None;
        }
        lattice.along = std::array::from_fn(|c| lattice.along[c].max(at[c] + 1));
    }
    Some(lattice)
}

fn texture(device: &Device, lattice: &Lattice) -> Texture {
    let [width, height, depth_or_array_layers] = lattice.along.map(|n| n * BRICK);
    let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
    device.create_texture(&wgpu::TextureDescriptor {
        size: Extent3d { width, height, depth_or_array_layers },
        dimension: wgpu::TextureDimension::D3,
        ..texture_descriptor("haze", TextureFormat::R8Unorm, [width, height], usage)
    })
}

fn upload(queue: &Queue, texture: &Texture, lattice: &Lattice, brick: &SceneBrick) {
    let [x, y, z] = cell(lattice, brick.corner_mm).map(|n| n * BRICK);
    let at = wgpu::TexelCopyTextureInfo { origin: wgpu::Origin3d { x, y, z }, ..texture.as_image_copy() };
    let rows =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(BRICK), rows_per_image: Some(BRICK) };
    let extent = Extent3d { width: BRICK, height: BRICK, depth_or_array_layers: BRICK };
    queue.write_texture(at, &brick.density, rows, extent);
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn brick(corner_mm: [f32; 3]) -> SceneBrick {
        SceneBrick { corner_mm, edge_mm: 2.0, ..SceneBrick::zeroed() }
    }

    #[test]
    fn bricks_find_their_place_on_the_lattice() {
        let bricks = [brick([0.0, -2.0, 1.0]), brick([-4.0, 2.0, 3.0])];
        let lattice = lattice_of(&bricks).unwrap();
        assert_eq!((lattice.corner, lattice.along), ([-4.0, -2.0, 1.0], [3, 3, 2]));
        assert_eq!(cell(&lattice, bricks[1].corner_mm), [0, 2, 1]);
    }

    #[test]
    fn what_lies_on_no_lattice_is_refused() {
        assert_eq!(lattice_of(&[]), None);
        assert_eq!(lattice_of(&[brick([0.0; 3]), brick([0.7, 0.0, 0.0])]), None, "between two places");
        assert_eq!(lattice_of(&[brick([0.0; 3]), brick([200.0, 0.0, 0.0])]), None, "too far apart");
        assert_eq!(lattice_of(&[brick([f32::NAN; 3])]), None);
        assert_eq!(lattice_of(&[SceneBrick::zeroed()]), None, "without an edge");
    }
}
