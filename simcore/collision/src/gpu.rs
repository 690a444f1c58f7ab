//! ZCOLL on a graphics adapter: the same whole numbers as [`super::zcoll`], in compute shaders, the
//! same answer to the bit on every adapter.
//!
//! ```text
//! positions, pose ──▶ cull ──▶ draw_depth ──▶ draw_name ──▶ reduce ──▶ counters, triangles, nodes, pixels
//!                      │ survivors                (or touch ──▶ one word)
//! ```
//!
//! `cull` drops triangles by an estimate in `f32`, wide enough for any rounding. What it leaves is
//! placed exactly: `soft_float.wgsl` does the `f32` arithmetic of [`super::quantize`] in whole
//! numbers, because a shading language lets an adapter fuse, flush and reorder. Depths are divided
//! in 64 bits made of two words (`wide.wgsl`). Everything that threads do to the same word is a
//! maximum or a sum of whole numbers, so that no order of threads can show. The images stay on the
//! adapter: colliding pixels, triangles and nodes are compacted there, and only they come back,
//! here sorted by number.
//!
//! This folder is the only part of the crate that knows wgpu; without the feature `gpu` it is not
//! built.

mod device;
mod layout;
mod part_clock;
mod passes;

pub use device::{GpuDevice, GpuError};
pub use layout::QueryParams;
pub use part_clock::PartTimes;
pub use passes::SHADER;

use super::instrument_image::{Side, Volume};
use super::surface::{Frame, Surface};
use super::zcoll::{Contacts, PixelContact};
use layout::{COUNTERS, Lists, WORDS};
use nalgebra::Isometry3;
use part_clock::PartClock;
use wgpu::{BindGroup, Buffer, BufferUsages, CommandEncoder};

/// Threads of a workgroup of the cull and the drawing.
const GROUP: usize = 64;
/// Most workgroups along an axis that every adapter gives.
const MOST_GROUPS: usize = 65_535;
/// Workgroups that draw: enough to fill a large adapter; each takes every so many'th 64 triangles.
const DRAWING_GROUPS: usize = 256;
/// The same where the processor does the work.
const DRAWING_GROUPS_SOFTWARE: usize = 8;

/// A part of a query, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Draw,
    Analyse,
    ReadBack,
}

/// Word of each counter, as in zcoll.wgsl.
mod counter {
    pub const PIXELS: usize = 1;
    pub const DEEPEST: usize = 2;
    pub const FOLDED: usize = 3;
    pub const REFUSED: usize = 4;
    pub const FLAT: usize = 5;
    pub const TRIANGLES: usize = 6;
    pub const NODES: usize = 7;
    pub const TOUCHED: usize = 8;
}

/// The adapter's memory for a mesh.
#[derive(Debug)]
struct Memory {
    params: Buffer,
    position: Buffer,
    alive: Buffer,
    instrument: Buffer,
    work: Buffer,
    results: Buffer,
    /// What comes back at once.
    staging: Buffer,
    /// Everything, for a look that found more.
    rest: Option<Buffer>,
}

impl Memory {
    /// For a mesh and an image of so many parts.
    fn new(gpu: &GpuDevice, lists: &Lists, triangles: usize, nodes: usize, pixels: usize) -> Self {
        let (storage, filled) = (BufferUsages::STORAGE, BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let params = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let at_once = lists.at_once();
        let back = COUNTERS + (0..3).map(|k| at_once[k] * WORDS[k]).sum::<usize>();
        Memory {
            params: gpu.buffer("params", size_of::<QueryParams>() / 4, params),
            position: gpu.buffer("positions", 3 * nodes, filled),
            alive: gpu.buffer("alive", triangles.div_ceil(32), filled),
            instrument: gpu.buffer("instrument", pixels, filled),
            work: gpu.buffer("work", COUNTERS + 3 * pixels, filled | BufferUsages::COPY_SRC),
            results: gpu.buffer("results", lists.words(), storage | BufferUsages::COPY_SRC),
            staging: gpu.buffer("staging", back, BufferUsages::MAP_READ | BufferUsages::COPY_DST),
            rest: None,
        }
    }

    /// Binds the memory to the passes, with the corners and those buffers that only the passes use.
    fn bind(&self, gpu: &GpuDevice, [corner, survivor, longest]: [&Buffer; 3]) -> BindGroup {
        let bound = [
            &self.params,
            &self.position,
            corner,
            &self.alive,
            &self.instrument,
            survivor,
            &self.work,
            longest,
            &self.results,
        ];
        gpu.passes.bind(&gpu.device, bound)
    }
}

/// Refuses a mesh of which one of the buffers would be larger than the adapter binds.
fn expect_room(gpu: &GpuDevice, lists: &Lists, triangles: usize, nodes: usize) -> Result<(), GpuError> {
    let largest = [9 * triangles, 3 * nodes, triangles + nodes, lists.words()];
    let bytes = 4 * largest.into_iter().max().unwrap_or(0) as u64;
    if bytes > gpu.room {
        return Err(GpuError::TooLarge { triangles, vertices: nodes, bytes, room: gpu.room });
    }
    Ok(())
}

/// ZCOLL for one mesh on one adapter.
#[derive(Debug)]
pub struct GpuZcoll {
    gpu: GpuDevice,
    volume: Volume,
    lists: Lists,
    memory: Memory,
    group: BindGroup,
    /// Flags and instrument image that the adapter has; they are sent again only when they change.
    sent_alive: Vec<u8>,
    sent_image: Vec<i32>,
    words: Vec<u32>,
    /// Results of the last look, sorted: (triangle, depth), (node, depth).
    triangles: Vec<(u32, i32)>,
    nodes: Vec<(u32, i32)>,
    hits: Vec<PixelContact>,
    vertices: Vec<(u32, i32)>,
    /// Where the parts of queries are timed.
    clock: Option<PartClock>,
}

impl GpuZcoll {
    /// Memory and passes for a mesh whose topology [`super::zcoll::Zcoll`] has accepted.
    pub fn new(
        gpu: GpuDevice,
        volume: Volume,
        triangles: &[[u32; 3]],
        nodes: usize,
    ) -> Result<Self, GpuError> {
        let pixels = volume.resolution * volume.resolution;
        let lists = Lists::new(triangles.len(), nodes, pixels);
        expect_room(&gpu, &lists, triangles.len(), nodes)?;
        let corners = triangles.as_flattened();
        let (storage, filled) = (BufferUsages::STORAGE, BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let corner = gpu.buffer("corners", corners.len(), filled);
        let survivor = gpu.buffer("survivors", triangles.len(), storage);
        // New buffers are zero: no triangle and no node has a vector yet.
        let longest = gpu.buffer("longest", triangles.len() + nodes, storage);
        let memory = Memory::new(&gpu, &lists, triangles.len(), nodes, pixels);
        let group = memory.bind(&gpu, [&corner, &survivor, &longest]);
        gpu.queue.write_buffer(&corner, 0, bytemuck::cast_slice(corners));
        gpu.check()?;
        Ok(GpuZcoll {
            volume,
            lists,
            memory,
            group,
            sent_alive: Vec::new(),
            sent_image: Vec::new(),
            words: Vec::with_capacity(triangles.len().div_ceil(32)),
            triangles: Vec::with_capacity(lists.most[0]),
            nodes: Vec::with_capacity(lists.most[1].min(3 * pixels)),
            hits: Vec::with_capacity(pixels),
            vertices: Vec::new(),
            clock: None,
            gpu,
        })
    }

    /// The adapter.
    pub fn gpu(&self) -> &GpuDevice {
        &self.gpu
    }

    /// Times the parts of all further queries; false where the adapter has no timestamps. A timed query has its parts
    /// in passes of their own, and takes a little longer.
    pub fn time_parts(&mut self) -> bool {
        self.clock = PartClock::new(&self.gpu);
        self.clock.is_some()
    }

    /// Times of the parts of the last query that was timed; `None` where none is.
    pub fn part_times(&self) -> Result<Option<PartTimes>, GpuError> {
        self.clock.as_ref().map(|clock| clock.read(&self.gpu)).transpose()
    }

    /// As [`super::zcoll::Zcoll::query`], or [`super::zcoll::Zcoll::query_reversed`] for an
    /// instrument seen from its handle: to the shaders these differ by the image and by the scale
    /// of depth, which is negative from the handle. On an error nothing was found, and the adapter
    /// is better left alone.
    pub fn query(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Result<Contacts, GpuError> {
        self.clear();
        if side.rect.is_empty() {
            return Ok(Contacts::default());
        }
        self.send(side, instrument_from_eye, surface)?;
        let encoder = self.query_commands();
        let counters = self.fetch(encoder, [true; 3])?;
        let (triangles, nodes) = (&mut self.triangles, &mut self.nodes);
        triangles.sort_unstable();
        nodes.sort_unstable();
        self.hits.sort_unstable_by_key(|hit| hit.pixel);
        Ok(Contacts {
            pixels: counters[counter::PIXELS],
            deepest: counters[counter::DEEPEST] as i32,
            folded: counters[counter::FOLDED],
            refused: counters[counter::REFUSED],
            flat: counters[counter::FLAT],
        })
    }

    /// As [`super::zcoll::Zcoll::touches`]; one word comes back.
    pub fn touches(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Result<bool, GpuError> {
        self.clear();
        if side.rect.is_empty() {
            return Ok(false);
        }
        self.send(side, instrument_from_eye, surface)?;
        let mut encoder = self.begin();
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_bind_group(0, &self.group, &[]);
            self.draw(&mut pass);
            pass.set_pipeline(&self.gpu.passes.touch);
            let pixels = self.volume.resolution * self.volume.resolution;
            pass.dispatch_workgroups(pixels.div_ceil(GROUP) as u32, 1, 1);
        }
        let staging = &self.memory.staging;
        encoder.copy_buffer_to_buffer(&self.memory.work, 4 * counter::TOUCHED as u64, staging, 0, 4);
        self.gpu.run(encoder, staging, 4, |words| words[0] != 0)
    }

    /// As [`super::zcoll::Zcoll::vertices`]: of the last look.
    pub fn vertices(&mut self) -> Result<&[(u32, i32)], GpuError> {
        self.vertices.clear();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.memory.work, 4 * counter::NODES as u64, Some(4));
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_bind_group(0, &self.group, &[]);
            pass.set_pipeline(&self.gpu.passes.vertices);
            pass.dispatch_workgroups(1, 1, 1);
        }
        let nodes = std::mem::take(&mut self.nodes);
        let fetched = self.fetch(encoder, [false, true, false]);
        self.vertices = std::mem::replace(&mut self.nodes, nodes);
        fetched?;
        self.vertices.sort_unstable();
        Ok(&self.vertices)
    }

    /// Triangles of the last look with their longest vector, steps; by number.
    pub fn triangles(&self) -> &[(u32, i32)] {
        &self.triangles
    }

    /// Nodes of the last look with their depth (Eq. 1), steps; by number.
    pub fn displaced(&self) -> &[(u32, i32)] {
        &self.nodes
    }

    /// Vectors of the last look, by pixel.
    pub fn hits(&self) -> &[PixelContact] {
        &self.hits
    }

    fn clear(&mut self) {
        self.triangles.clear();
        self.nodes.clear();
        self.hits.clear();
    }

    /// Positions and pose go to the adapter each time, flags and instrument image when they
    /// changed.
    fn send(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Result<(), GpuError> {
        self.gpu.check()?;
        let (queue, memory) = (&self.gpu.queue, &self.memory);
        let params = QueryParams::new(&Frame::new(instrument_from_eye), &self.volume, side, &self.lists);
        queue.write_buffer(&memory.params, 0, bytemuck::bytes_of(&params));
        for (axis, values) in surface.position_mm.iter().enumerate() {
            let values = &values[..self.lists.nodes];
            queue.write_buffer(
                &memory.position,
                (4 * axis * values.len()) as u64,
                bytemuck::cast_slice(values),
            );
        }
        if self.sent_image != side.depth {
            self.sent_image.clear();
            self.sent_image.extend_from_slice(side.depth);
            queue.write_buffer(&memory.instrument, 0, bytemuck::cast_slice(&self.sent_image));
        }
        if self.sent_alive != surface.alive {
            self.sent_alive.clear();
            self.sent_alive.extend_from_slice(surface.alive);
            self.words.clear();
            let bits =
                |flags: &[u8]| flags.iter().enumerate().fold(0, |w, (i, &f)| w | u32::from(f != 0) << i);
            self.words.extend(surface.alive.chunks(32).map(bits));
            queue.write_buffer(&memory.alive, 0, bytemuck::cast_slice(&self.words));
        }
        Ok(())
    }

    /// Commands that begin with empty images and counters.
    fn begin(&self) -> CommandEncoder {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.memory.work, 0, None);
        encoder
    }

    /// Commands of a query until its results are there; between its parts the clock, if there is one, takes the time.
    fn query_commands(&self) -> CommandEncoder {
        let mut encoder = self.begin();
        let stamp = |encoder: &mut CommandEncoder, part: Part| {
            if let Some(clock) = &self.clock {
                clock.end(encoder, part);
            }
        };
        if let Some(clock) = &self.clock {
            clock.begin(&mut encoder);
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_bind_group(0, &self.group, &[]);
        self.draw(&mut pass);
        pass.set_pipeline(&self.gpu.passes.draw_name);
        pass.dispatch_workgroups(self.drawing_groups(), 1, 1);
        if self.clock.is_some() {
            drop(pass);
            stamp(&mut encoder, Part::Draw);
            pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_bind_group(0, &self.group, &[]);
        }
        pass.set_pipeline(&self.gpu.passes.reduce);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        stamp(&mut encoder, Part::Analyse);
        encoder
    }

    /// The cull and the depth image.
    fn draw(&self, pass: &mut wgpu::ComputePass<'_>) {
        let groups = self.lists.triangles.div_ceil(GROUP).clamp(1, MOST_GROUPS);
        pass.set_pipeline(&self.gpu.passes.cull);
        pass.dispatch_workgroups(groups as u32, 1, 1);
        pass.set_pipeline(&self.gpu.passes.draw_depth);
        pass.dispatch_workgroups(self.drawing_groups(), 1, 1);
    }

    fn drawing_groups(&self) -> u32 {
        let most = if self.gpu.is_software() { DRAWING_GROUPS_SOFTWARE } else { DRAWING_GROUPS };
        self.lists.triangles.div_ceil(GROUP).clamp(1, most) as u32
    }

    /// Runs the commands and takes the counters and the `wanted` lists; what does not come at once
    /// is fetched in a second transfer.
    fn fetch(&mut self, mut encoder: CommandEncoder, wanted: [bool; 3]) -> Result<[u32; COUNTERS], GpuError> {
        let at_once = self.lists.at_once();
        let ends = copy(&mut encoder, &self.memory, &self.memory.staging, &self.lists, at_once);
        if let Some(clock) = &self.clock {
            clock.end(&mut encoder, Part::ReadBack);
        }
        let (mut counters, mut complete) = ([0; COUNTERS], true);
        let found = |counters: &[u32; COUNTERS]| {
            let counts = [counter::TRIANGLES, counter::NODES, counter::PIXELS].map(|c| counters[c] as usize);
            std::array::from_fn(|k| if wanted[k] { counts[k].min(self.lists.most[k]) } else { 0 })
        };
        let (triangles, nodes, hits) = (&mut self.triangles, &mut self.nodes, &mut self.hits);
        self.gpu.run(encoder, &self.memory.staging, 4 * ends[3] as u64, |words| {
            counters.copy_from_slice(&words[..COUNTERS]);
            let counts: [usize; 3] = found(&counters);
            complete = (0..3).all(|k| counts[k] <= at_once[k]);
            if complete {
                take(words, ends, counts, triangles, nodes, hits);
            }
        })?;
        if complete {
            return Ok(counters);
        }
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let words = COUNTERS + self.lists.words();
        let rest = self.memory.rest.get_or_insert_with(|| self.gpu.buffer("rest", words, usage)).clone();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let counts = found(&counters);
        let ends = copy(&mut encoder, &self.memory, &rest, &self.lists, counts);
        self.gpu.run(encoder, &rest, 4 * ends[3] as u64, |words| {
            take(words, ends, counts, triangles, nodes, hits)
        })?;
        Ok(counters)
    }
}

/// Copies the counters and so many results of each kind; where each begins, and the end, words.
fn copy(
    encoder: &mut CommandEncoder,
    memory: &Memory,
    to: &Buffer,
    lists: &Lists,
    counts: [usize; 3],
) -> [usize; 4] {
    encoder.copy_buffer_to_buffer(&memory.work, 0, to, 0, 4 * COUNTERS as u64);
    let mut ends = [COUNTERS; 4];
    for k in 0..3 {
        let words = counts[k] * WORDS[k];
        ends[k + 1] = ends[k] + words;
        if words > 0 {
            let (from, at) = (4 * lists.first[k] as u64, 4 * ends[k] as u64);
            encoder.copy_buffer_to_buffer(&memory.results, from, to, at, 4 * words as u64);
        }
    }
    ends
}

/// Reads results of each kind that begin at `ends`.
fn take(
    words: &[u32],
    ends: [usize; 4],
    counts: [usize; 3],
    triangles: &mut Vec<(u32, i32)>,
    nodes: &mut Vec<(u32, i32)>,
    hits: &mut Vec<PixelContact>,
) {
    let list = |k: usize| words[ends[k]..ends[k] + counts[k] * WORDS[k]].chunks_exact(WORDS[k]);
    triangles.extend(list(0).map(|w| (w[0], w[1] as i32)));
    nodes.extend(list(1).map(|w| (w[0], w[1] as i32)));
    hits.extend(list(2).map(|w| PixelContact { pixel: w[0], triangle: w[1], depth: w[2] as i32 }));
}
