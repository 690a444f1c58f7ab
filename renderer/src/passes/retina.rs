//! Retina that is off the choroid, and the bare choroid under it.

use super::membrane::TissueBuffers;
use super::{PassDevice, PipelineSpec, Uniforms};
use crate::governor::Shading;
use wgpu::{BindGroupLayout, CompareFunction, RenderPass, RenderPipeline};

/// The pass.
pub struct Retina {
    /// TissueBuffers and choroid, for each shading.
    pipelines: [[RenderPipeline; 2]; 2],
}

impl Retina {
    /// Makes the pipelines: both sides, opaque.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let make = |shading, vertex, fragment| {
            let spec = PipelineSpec {
                fragment: Some(fragment),
                vertices: true,
                homes: true,
                depth: Some((CompareFunction::Less, true)),
                ..PipelineSpec::new("retina", vertex, &groups)
            };
            device.pipeline(&spec.shaded(shading))
        };
        let both = |s| [make(s, "vs_sheet", "fs_sheet"), make(s, "vs_choroid", "fs_choroid")];
        Self { pipelines: device.shadings(both) }
    }

    /// Draws before the fundus, which then shades only what is still seen of it; groups 0 and 1 are
    /// set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, tissue: &TissueBuffers, shading: Shading) {
        let [lifted, choroid] = &self.pipelines[shading as usize];
        pass.set_pipeline(lifted);
        tissue.draw_retina(pass);
        pass.set_pipeline(choroid);
        tissue.draw_bare(pass);
    }
}
