//! The compiled shaders of a look, and the one group of buffers that they share.

use wgpu::{BindGroup, BindGroupLayout, Buffer, BufferBindingType, ComputePipeline, Device, ShaderStages};

/// All shaders of a look, in one module.
pub const SHADER: &str =
    concat!(include_str!("soft_float.wgsl"), include_str!("wide.wgsl"), include_str!("zcoll.wgsl"));

/// Buffers that the shaders see: the block of the look, four to read, four to write.
pub(super) const BUFFERS: usize = 9;
/// One past the last that is only read.
const READ_ONLY: u32 = 5;

/// The passes, each an entry point of the same name.
#[derive(Debug)]
pub(super) struct Passes {
    layout: BindGroupLayout,
    pub(super) cull: ComputePipeline,
    pub(super) draw_depth: ComputePipeline,
    pub(super) draw_name: ComputePipeline,
    pub(super) reduce: ComputePipeline,
    pub(super) touch: ComputePipeline,
    pub(super) vertices: ComputePipeline,
}

impl Passes {
    /// Compiles them; what goes wrong is results by the device.
    pub(super) fn new(device: &Device) -> Self {
        let label = Some("collision");
        let entries: Vec<_> = (0..BUFFERS as u32).map(entry).collect();
        let layout =
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let groups = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let source = wgpu::ShaderSource::Wgsl(SHADER.into());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label, source });
        let pipeline = |name: &str| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&groups),
                module: &module,
                entry_point: Some(name),
                // Every word of workgroup memory is written before it is read.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..wgpu::PipelineCompilationOptions::default()
                },
                cache: None,
            })
        };
        Passes {
            cull: pipeline("cull"),
            draw_depth: pipeline("draw_depth"),
            draw_name: pipeline("draw_name"),
            reduce: pipeline("reduce"),
            touch: pipeline("touch"),
            vertices: pipeline("vertices"),
            layout,
        }
    }

    /// The group of a mesh's buffers, in the order of the shader's bindings.
    pub(super) fn bind(&self, device: &Device, buffers: [&Buffer; BUFFERS]) -> BindGroup {
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = &self.layout;
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("mesh"),
            layout,
            entries: &entries,
        })
    }
}

fn entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    let ty = match binding {
        0 => BufferBindingType::Uniform,
        _ => BufferBindingType::Storage { read_only: binding < READ_ONLY },
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

#[cfg(test)]
mod tests {
    use crate::gpu::GpuDevice;
    use wgpu::BufferUsages;

    /// Runs a·b, a + b, a − b, a < b and the integer part of |a| for pairs of `f32` on the adapter.
    const ARITHMETIC: &str = "
        @group(0) @binding(0) var<storage, read> pair: array<vec2<u32>>;
        @group(0) @binding(1) var<storage, read_write> result: array<u32>;
        @compute @workgroup_size(64)
        fn arithmetic(@builtin(global_invocation_id) id: vec3<u32>) {
            let p = pair[id.x];
            result[5u * id.x] = float_mul(p.x, p.y);
            result[5u * id.x + 1u] = float_add(p.x, p.y);
            result[5u * id.x + 2u] = float_sub(p.x, p.y);
            result[5u * id.x + 3u] = select(0u, 1u, float_less(p.x, p.y));
            var whole = 0;
            if (p.x & ~SIGN) < 0x4b000000u { whole = float_floor(p.x & ~SIGN); }
            result[5u * id.x + 4u] = u32(whole);
        }";

    fn on_adapter(gpu: &GpuDevice, pairs: &[[f32; 2]]) -> Vec<u32> {
        let device = &gpu.device;
        let text = [include_str!("soft_float.wgsl"), ARITHMETIC].concat();
        let source = wgpu::ShaderSource::Wgsl(text.into());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let buffer = |bytes: usize, usage| {
            let size = bytes as u64;
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let given = buffer(size_of_val(pairs), BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let bytes = 20 * pairs.len();
        let result = buffer(bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let staging = buffer(bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        gpu.queue.write_buffer(&given, 0, bytemuck::cast_slice(pairs));
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: given.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: result.as_entire_binding() },
            ],
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups((pairs.len() / 64) as u32, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&result, 0, &staging, 0, bytes as u64);
        gpu.run(encoder, &staging, bytes as u64, <[u32]>::to_vec).unwrap()
    }

    /// The processor's own arithmetic is the truth: every kind of number, close exponents, ties and
    /// cancellations.
    #[test]
    fn soft_floats_are_the_processors_floats() {
        let Ok(gpu) = GpuDevice::open() else {
            eprintln!("no graphics driver: arithmetic of the shaders not compared");
            return;
        };
        let mut seed = 3u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 32) as u32
        };
        let odd = [0, 1, 2, 0x007f_ffff, 0x0080_0000, 0x0080_0001, 0x3f80_0000, 0x3f7f_ffff, 0x4b00_0000];
        let odd = odd.into_iter().chain([0x7f7f_ffff, 0x7f80_0000, 0x7f80_0001, 0x7fc0_0000]);
        let odd: Vec<u32> = odd.flat_map(|b: u32| [b, b | 0x8000_0000]).collect();
        let mut pairs: Vec<[f32; 2]> =
            odd.iter().flat_map(|&a| odd.iter().map(move |&b| [a, b].map(f32::from_bits))).collect();
        while pairs.len() < 64 << 12 || !pairs.len().is_multiple_of(64) {
            let (a, mut b) = (random(), random());
            match random() % 4 {
                // Exponents next to each other: ties and cancellation.
                0 => {
                    b = (b & 0x807f_ffff)
                        | (a & 0x7f80_0000).wrapping_add((random() % 60) << 23) & 0x7f80_0000
                }
                // Few bits: exact halves.
                1 => b &= 0xfff0_0000,
                // Near the subnormal numbers.
                2 => b = (b & 0x80ff_ffff) | (0x3f00_0000u32.wrapping_sub(a & 0x7f80_0000) & 0x7f80_0000),
                _ => {}
            }
            pairs.push([a, b].map(f32::from_bits));
        }
        let same = |theirs: u32, ours: f32| {
            theirs == ours.to_bits() || (ours.is_nan() && f32::from_bits(theirs).is_nan())
        };
        for ([a, b], theirs) in pairs.iter().zip(on_adapter(&gpu, &pairs).chunks_exact(5)) {
            let (ab, bb) = (a.to_bits(), b.to_bits());
            assert!(
                same(theirs[0], a * b),
                "{ab:08x} · {bb:08x}: {:08x} {:08x}",
                theirs[0],
                (a * b).to_bits()
            );
            assert!(
                same(theirs[1], a + b),
                "{ab:08x} + {bb:08x}: {:08x} {:08x}",
                theirs[1],
                (a + b).to_bits()
            );
            assert!(
                same(theirs[2], a - b),
                "{ab:08x} − {bb:08x}: {:08x} {:08x}",
                theirs[2],
                (a - b).to_bits()
            );
            assert_eq!(theirs[3] == 1, a < b, "{ab:08x} < {bb:08x}");
            let floor = if a.abs() < 8_388_608.0 { a.abs() as u32 } else { 0 };
            assert_eq!(theirs[4], floor, "{ab:08x}");
        }
    }
}
