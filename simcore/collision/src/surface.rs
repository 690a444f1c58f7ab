//! A deforming triangle mesh as the collision queries see it, and the cull that comes before each
//! of them.
//!
//! A tree over a mesh that moves every frame is wasted work. Here the vertices stay in
//! structure-of-arrays order and one pass turns them into the instrument's frame, sixteen at a
//! time, and keeps of each block of sixteen one byte: the planes of the query's box beyond which
//! **all** of them lie. Chunks of triangles know their blocks from the topology alone; a chunk
//! whose blocks share a plane is dropped. Only what is left is looked at one by one.
//!
//! The pass is compiled for AVX-512, AVX2 and the base instruction set and chosen at run time. It
//! adds, multiplies and compares in a fixed order and fuses nothing, so that every path gives the
//! same bits; and it only ever drops triangles that the exact integer tests after it would drop, so
//! that it cannot change a result.

use nalgebra::{Isometry3, Matrix3, Vector3};

/// Vertices of a block: one AVX-512 register of `f32`.
pub const BLOCK: usize = 16;
/// Triangles of a chunk.
const CHUNK: usize = 32;
/// Most vertices and most triangles of a surface: an ID has 32 bits, one value of which means
/// "none".
pub const MAX_IDS: usize = u32::MAX as usize;

/// Why a surface or a volume cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CollisionError {
    /// Nothing to collide with.
    #[error("the membrane has no triangles")]
    Empty,
    /// An ID would not fit.
    #[error("{found} vertices or triangles; IDs of 32 bits name at most {limit}", limit = MAX_IDS)]
    TooManyIds {
        /// Asked for.
        found: usize,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}; there are {vertices}")]
    NoSuchVertex {
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices there are.
        vertices: usize,
    },
    /// A side of the collision volume is zero, negative or not a number.
    #[error(
        "collision volume of half width {half_mm} mm and depth {depth_mm} mm; both must be above 0 and finite"
    )]
    NoVolume {
        /// Half width, mm.
        half_mm: f64,
        /// Depth, mm.
        depth_mm: f64,
    },
    /// The image is too small or too large.
    #[error("{resolution} pixels along a side of the collision image; 8 to 256 are possible")]
    Resolution {
        /// Asked for.
        resolution: usize,
    },
}

/// The mesh at this moment: borrowed, nothing is copied.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    /// x, y and z of the vertices, eye frame, mm.
    pub position_mm: [&'a [f32]; 3],
    /// Vertices of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// 0 for triangles that were torn out.
    pub alive: &'a [u8],
}

/// `p ↦ R·(p − t)` in `f32`: eye frame to instrument frame. Relative to the tip first, since the
/// difference of two near positions is exact.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    turn: [[f32; 3]; 3],
    tip: [f32; 3],
}

impl Frame {
    /// The map of a pose.
    pub fn new(instrument_from_eye: &Isometry3<f64>) -> Self {
        let turn: Matrix3<f32> = instrument_from_eye.rotation.to_rotation_matrix().matrix().map(|c| c as f32);
        let tip: Vector3<f32> = instrument_from_eye.inverse().translation.vector.map(|c| c as f32);
        let row = |i: usize| [turn[(i, 0)], turn[(i, 1)], turn[(i, 2)]];
        Frame { turn: [row(0), row(1), row(2)], tip: tip.into() }
    }

    /// Rows of the rotation.
    pub fn turn(&self) -> &[[f32; 3]; 3] {
        &self.turn
    }

    /// The tip in the eye frame, mm.
    pub fn tip(&self) -> &[f32; 3] {
        &self.tip
    }

    /// A point of the eye frame along one axis of the instrument's; the order of sums is part of
    /// the format.
    #[inline(always)]
    pub fn along(&self, axis: usize, x: f32, y: f32, z: f32) -> f32 {
        let [m0, m1, m2] = self.turn[axis];
        m0 * (x - self.tip[0]) + m1 * (y - self.tip[1]) + m2 * (z - self.tip[2])
    }

    /// A point of the eye frame in the instrument's.
    pub fn point(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| self.along(axis, x, y, z))
    }
}

/// Planes of a box, one bit each: below its minimum along x, above its maximum, then y, then z.
const PLANES: u8 = 0x3f;
/// Bit of a block that the caller has not prepared yet in this query.
const FRESH: u8 = 0x80;

/// Which blocks the chunks of a mesh use, and which blocks lie beyond which planes in this query.
#[derive(Debug, Clone)]
pub struct Cull {
    simd: pulp::Arch,
    vertices: usize,
    /// Where each chunk's blocks begin in `blocks`; one more entry than chunks.
    first: Vec<u32>,
    blocks: Vec<u32>,
    beyond: Vec<u8>,
}

impl Cull {
    /// Reads the topology; it may lose triangles later, but not gain any.
    pub fn new(triangles: &[[u32; 3]], vertices: usize) -> Result<Self, CollisionError> {
        let found = triangles.len().max(vertices);
        if found >= MAX_IDS {
            return Err(CollisionError::TooManyIds { found });
        }
        if triangles.is_empty() {
            return Err(CollisionError::Empty);
        }
        let mut cull = Cull {
            simd: pulp::Arch::new(),
            vertices,
            first: vec![0],
            blocks: Vec::new(),
            beyond: vec![0; vertices.div_ceil(BLOCK)],
        };
        for (c, chunk) in triangles.chunks(CHUNK).enumerate() {
            if let Some((t, &vertex)) = chunk
                .iter()
                .enumerate()
                .find_map(|(t, triangle)| triangle.iter().find(|&&v| v as usize >= vertices).map(|v| (t, v)))
            {
                return Err(CollisionError::NoSuchVertex { triangle: c * CHUNK + t, vertex, vertices });
            }
            let mut used: Vec<u32> = chunk.as_flattened().iter().map(|v| v / BLOCK as u32).collect();
            used.sort_unstable();
            used.dedup();
            cull.blocks.extend(used);
            cull.first.push(cull.blocks.len() as u32);
        }
        Ok(cull)
    }

    /// The instruction set in use.
    pub fn simd(&self) -> pulp::Arch {
        self.simd
    }

    /// The same without AVX: for the proof that every path gives the same bits.
    pub fn without_simd(mut self) -> Self {
        self.simd = pulp::Arch::Scalar;
        self
    }

    /// Notes the planes beyond which each block lies. `low` and `high` are the box in the
    /// instrument's frame, mm.
    pub fn classify(&mut self, surface: &Surface, frame: &Frame, low: [f32; 3], high: [f32; 3]) {
        let position = surface.position_mm.map(|v| &v[..self.vertices]);
        let beyond = &mut self.beyond;
        self.simd.dispatch(ClassifyBlocks { position, frame: *frame, low, high, beyond });
    }

    /// Calls `prepare(block)` once for each block of the surviving chunks, then `visit(first
    /// triangle, one past the last)` for each surviving chunk, in order.
    #[inline(always)]
    pub fn for_each_survivor<C>(
        &mut self,
        triangles: usize,
        context: &mut C,
        prepare: impl Fn(&mut C, usize),
        visit: impl Fn(&mut C, usize, usize),
    ) {
        for (chunk, ends) in self.first.windows(2).enumerate() {
            let blocks = &self.blocks[ends[0] as usize..ends[1] as usize];
            if blocks.iter().fold(PLANES, |all, &b| all & self.beyond[b as usize]) != 0 {
                continue;
            }
            for &block in blocks {
                let state = &mut self.beyond[block as usize];
                if *state & FRESH != 0 {
                    *state &= !FRESH;
                    prepare(context, block as usize);
                }
            }
            visit(context, chunk * CHUNK, (chunk * CHUNK + CHUNK).min(triangles));
        }
    }
}

struct ClassifyBlocks<'a> {
    position: [&'a [f32]; 3],
    frame: Frame,
    low: [f32; 3],
    high: [f32; 3],
    beyond: &'a mut [u8],
}

impl pulp::NullaryFnOnce for ClassifyBlocks<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let [x, y, z] = self.position;
        let (xs, ys, zs) = (x.as_chunks::<BLOCK>(), y.as_chunks::<BLOCK>(), z.as_chunks::<BLOCK>());
        for (((x, y), z), beyond) in xs.0.iter().zip(ys.0).zip(zs.0).zip(self.beyond.iter_mut()) {
            *beyond = classify_block(&self.frame, x, y, z, &self.low, &self.high);
        }
        if !xs.1.is_empty() {
            // The last block is filled up with its last vertex.
            let fill = |rest: &[f32]| std::array::from_fn(|i| rest[i.min(rest.len() - 1)]);
            let last =
                classify_block(&self.frame, &fill(xs.1), &fill(ys.1), &fill(zs.1), &self.low, &self.high);
            if let Some(beyond) = self.beyond.last_mut() {
                *beyond = last;
            }
        }
    }
}

/// Planes beyond which all sixteen lie. Of a coordinate that is not a number every comparison is
/// false: it lies beyond nothing.
#[inline(always)]
fn classify_block(
    frame: &Frame,
    x: &[f32; BLOCK],
    y: &[f32; BLOCK],
    z: &[f32; BLOCK],
    low: &[f32; 3],
    high: &[f32; 3],
) -> u8 {
    let mut beyond = FRESH;
    for axis in 0..3 {
        // One word a lane instead of one flag for all: this is the form that becomes vector code.
        let (mut below, mut above) = ([0u32; BLOCK], [0u32; BLOCK]);
        for i in 0..BLOCK {
            let value = frame.along(axis, x[i], y[i], z[i]);
            below[i] = if value < low[axis] { 0 } else { 1 };
            above[i] = if value > high[axis] { 0 } else { 1 };
        }
        let all = |lanes: [u32; BLOCK]| u8::from(lanes.iter().fold(0, |any, lane| any | lane) == 0);
        beyond |= all(below) << (2 * axis) | all(above) << (2 * axis + 1);
    }
    beyond
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn pose(a: f64, b: f64, c: f64) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(a, b, c), UnitQuaternion::from_euler_angles(b, c, a))
    }

    #[test]
    fn what_cannot_be_used_is_refused_by_name() {
        assert_eq!(Cull::new(&[], 3).unwrap_err(), CollisionError::Empty);
        let wrong = Cull::new(&[[0, 1, 2], [0, 1, 3]], 3).unwrap_err();
        assert_eq!(wrong, CollisionError::NoSuchVertex { triangle: 1, vertex: 3, vertices: 3 });
        assert!(wrong.to_string().contains("triangle 1 names vertex 3"));
        let many = Cull::new(&[[0, 1, 2]], MAX_IDS).unwrap_err();
        assert_eq!(many, CollisionError::TooManyIds { found: MAX_IDS });
    }

    proptest! {
        /// Whatever the cull drops has a plane with every vertex of it beyond, found one by one in
        /// f64.
        #[test]
        fn only_what_lies_beyond_a_plane_is_dropped(
            points in prop::collection::vec(prop::array::uniform3(-3.0f32..3.0), 3..200),
            picks in prop::collection::vec(prop::array::uniform3(0usize..1000), 1..300),
            a in -1.0f64..1.0, b in -1.0f64..1.0, c in -1.0f64..1.0, half in 0.05f32..2.0,
            bad in prop::option::of(0usize..1000),
        ) {
            let mut axes: [Vec<f32>; 3] = std::array::from_fn(|k| points.iter().map(|p| p[k]).collect());
            if let Some(bad) = bad { axes[bad % 3][bad % points.len()] = f32::NAN; }
            let n = points.len();
            let triangles: Vec<[u32; 3]> = picks.iter().map(|p| p.map(|v| (v % n) as u32)).collect();
            let alive = vec![1; triangles.len()];
            let surface = Surface {
                position_mm: [&axes[0], &axes[1], &axes[2]], triangles: &triangles, alive: &alive,
            };
            let pose = pose(a, b, c);
            let frame = Frame::new(&pose);
            let mut cull = Cull::new(&triangles, n).unwrap();
            let mut plain = cull.clone().without_simd();
            let mut kept = vec![false; triangles.len()];
            for cull in [&mut cull, &mut plain] {
                cull.classify(&surface, &frame, [-half; 3], [half; 3]);
            }
            prop_assert_eq!(&cull.beyond, &plain.beyond);
            cull.for_each_survivor(triangles.len(), &mut kept, |_, _| (), |kept, from, to| kept[from..to].fill(true));
            for (t, _) in kept.iter().enumerate().filter(|(_, kept)| !**kept) {
                let p = triangles[t].map(|v| {
                    let p = [0, 1, 2].map(|k| f64::from(axes[k][v as usize]));
                    pose * nalgebra::Point3::from(p)
                });
                let half = f64::from(half);
                let beyond = (0..3).any(|k| p.iter().all(|p| p[k] < -half + 1e-5) || p.iter().all(|p| p[k] > half - 1e-5));
                prop_assert!(beyond, "triangle {} at {:?}", t, p);
            }
        }
    }
}
