//! The transfer column of the paper's Table 3: how long it takes to bring a deformed mesh to the graphics device.
//!
//! `cargo bench -p renderer --bench transfer`. Of every size two times, medians: that of the call which hands the
//! vertices over, by the host's clock, and that of the copy into the buffer which is drawn from, by the device's own
//! clock where it has one.

use renderer::gpu::{Gpu, GpuError};
use renderer::layout::TissueVertex;
use renderer::passes::membrane::TissueBuffers;
use std::time::Instant;
use wgpu::{
    Buffer, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor, ComputePassTimestampWrites,
    MapMode, QuerySet,
};

/// Triangles, springs and nodes of the paper's membranes, and its times of simulation and transfer, ms.
const SIZES: [(usize, usize, [f64; 2]); 3] =
    [(400, 231, [0.5, 0.7]), (1_000, 546, [1.5, 1.7]), (3_000, 1_581, [4.0, 5.0])];
/// Transfers of each size; the first ones do not count.
const TRANSFERS: usize = 220;
const SETTLED: usize = 20;

fn main() -> Result<(), GpuError> {
    let gpu = Gpu::headless()?;
    let clock = DeviceClock::new(&gpu);
    println!("{}: {}", gpu.name, if clock.is_some() { "with timestamps" } else { "without timestamps" });
    println!("triangles   bytes   paper ms   call, host µs   copy, device µs   transfers");
    for (triangles, nodes, [_, paper_ms]) in SIZES {
        let (calls, copies) = transfers(&gpu, clock.as_ref(), nodes, triangles)?;
        let copy = if copies.is_empty() { "–".into() } else { format!("{:.2}", median(copies)) };
        let (bytes, count) = (nodes * size_of::<TissueVertex>(), calls.len());
        println!(
            "{triangles:>9}  {bytes:>6}   {paper_ms:>8}   {:>13.2}   {copy:>15}   {count:>9}",
            median(calls)
        );
    }
    Ok(())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Times of the calls and of the copies, µs.
fn transfers(
    gpu: &Gpu,
    clock: Option<&DeviceClock>,
    nodes: usize,
    triangles: usize,
) -> Result<(Vec<f64>, Vec<f64>), GpuError> {
    let tissue = TissueBuffers::new(&gpu.device, nodes, triangles);
    let bytes = (nodes * size_of::<TissueVertex>()) as u64;
    let [from, to] = [BufferUsages::COPY_SRC, BufferUsages::VERTEX].map(|usage| buffer(gpu, bytes, usage));
    let (mut calls, mut copies) = (Vec::new(), Vec::new());
    for n in 0..TRANSFERS {
        let vertex = |i: usize| TissueVertex {
            position: [i as f32, n as f32, -11.0],
            normal: [0.0, 0.0, 1.0],
            more: [0.0, 1.0],
        };
        let vertices: Vec<TissueVertex> = (0..nodes).map(vertex).collect();
        let begun = Instant::now();
        tissue.set_vertices(&gpu.queue, &vertices);
        let call_us = begun.elapsed().as_secs_f64() * 1e6;
        gpu.queue.write_buffer(&from, 0, bytemuck::cast_slice(&vertices));
        gpu.queue.submit([]);
        gpu.wait()?;
        let copy_us = clock.map(|clock| clock.copy_us(gpu, &from, &to)).transpose()?;
        if n >= SETTLED {
            calls.push(call_us);
            copies.extend(copy_us);
        }
    }
    Ok((calls, copies))
}

fn buffer(gpu: &Gpu, size: u64, usage: BufferUsages) -> Buffer {
    let usage = usage | BufferUsages::COPY_DST;
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
}

/// Timestamps of the device around a copy.
struct DeviceClock {
    stamps: QuerySet,
    resolved: Buffer,
    back: Buffer,
}

impl DeviceClock {
    /// `None` where the device has no timestamps.
    fn new(gpu: &Gpu) -> Option<Self> {
        if !gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let (label, ty, count) = (None, wgpu::QueryType::Timestamp, 2);
        Some(DeviceClock {
            stamps: gpu.device.create_query_set(&wgpu::QuerySetDescriptor { label, ty, count }),
            resolved: buffer(gpu, 16, BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            back: buffer(gpu, 16, BufferUsages::MAP_READ),
        })
    }

    /// Time of a copy of a whole buffer, µs. Empty passes before and after it carry the stamps.
    fn copy_us(&self, gpu: &Gpu, from: &Buffer, to: &Buffer) -> Result<f64, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&CommandEncoderDescriptor::default());
        let stamp = |encoder: &mut wgpu::CommandEncoder, [begin, end]: [Option<u32>; 2]| {
            let timestamp_writes = Some(ComputePassTimestampWrites {
                query_set: &self.stamps,
                beginning_of_pass_write_index: begin,
                end_of_pass_write_index: end,
            });
            drop(encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes }));
        };
        stamp(&mut encoder, [None, Some(0)]);
        encoder.copy_buffer_to_buffer(from, 0, to, 0, from.size());
        stamp(&mut encoder, [Some(1), None]);
        encoder.resolve_query_set(&self.stamps, 0..2, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.back, 0, 16);
        gpu.queue.submit([encoder.finish()]);
        self.back.slice(..).map_async(MapMode::Read, |_| {});
        gpu.wait()?;
        let read = self.back.slice(..).get_mapped_range().map_err(|e| GpuError::Lost(e.to_string()))?;
        let ticks: Vec<u64> =
            read.chunks_exact(8).map(|b| u64::from_le_bytes(b.try_into().unwrap_or_default())).collect();
        drop(read);
        self.back.unmap();
        Ok(ticks[1].saturating_sub(ticks[0]) as f64 * f64::from(gpu.queue.get_timestamp_period()) * 1e-3)
    }
}
