//! Exact pairs: which triangle of the membrane meets which triangle of the instrument.
//!
//! The membrane is put into the instrument's frame, where the instrument never moves: a static tree over the instrument
//! serves every pose, and none is needed over the membrane, which is culled by the instrument's box
//! ([`super::surface`]). What is left goes down the tree, eight boxes at a time, and at the end an exact test
//! ([`super::tritri`]) decides.
//!
//! Exact means: with respect to corners rounded to a grid that follows from the instrument's size (a power of two of mm; 31 nm
//! for a shaft of 3 mm). From there on all numbers are whole and no sign is ever rounded.

use super::instrument_image::to_fixed;
use super::surface::{BLOCK, Cull, Frame, Surface, Unusable};
use super::tool_mesh::Facet;
use super::tritri::{Corner, LIMIT, Triangle};
use nalgebra::Isometry3;

/// Children of a node of the instrument's tree.
const WIDE: usize = 8;
/// The instrument's box takes at most this part of the grid; a membrane triangle that reaches into the box may be three
/// times as large as the instrument before it leaves the grid.
const BOX_LIMIT: i32 = LIMIT / 4;
/// Grid steps by which the first cull is wider than the exact one.
const CULL_MARGIN: f32 = 4.0;

/// Two triangles that have a point in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pair {
    /// Triangle of the membrane.
    pub membrane: u32,
    /// Triangle of the instrument, as given to [`StaticMesh::new`].
    pub instrument: u32,
}

/// Eight boxes side by side.
#[derive(Debug, Clone)]
struct Boxes {
    low: [[i32; WIDE]; 3],
    high: [[i32; WIDE]; 3],
}

impl Boxes {
    /// Boxes that nothing meets.
    const NONE: Boxes = Boxes { low: [[i32::MAX; WIDE]; 3], high: [[i32::MIN; WIDE]; 3] };

    fn set(&mut self, i: usize, [low, high]: [Corner; 2]) {
        for k in 0..3 {
            (self.low[k][i], self.high[k][i]) = (low[k], high[k]);
        }
    }

    fn around(&self) -> [Corner; 2] {
        let low = self.low.map(|l| l.into_iter().fold(i32::MAX, Ord::min));
        [low, self.high.map(|h| h.into_iter().fold(i32::MIN, Ord::max))]
    }

    /// Bit i is set if box i meets the given one.
    #[inline(always)]
    fn meets(&self, [low, high]: &[Corner; 2]) -> u32 {
        let mut hit = [1u32; WIDE];
        for k in 0..3 {
            for (i, hit) in hit.iter_mut().enumerate() {
                *hit &= u32::from(self.low[k][i] <= high[k]) & u32::from(self.high[k][i] >= low[k]);
            }
        }
        hit.iter().enumerate().fold(0, |mask, (i, hit)| mask | hit << i)
    }
}

/// A rigid mesh with its tree, in its own frame.
#[derive(Debug, Clone)]
pub struct StaticMesh {
    /// Grid steps of a mm.
    scale: f32,
    /// In the tree's order, with their numbers.
    triangles: Vec<(Triangle, u32)>,
    /// Boxes of the triangles, of those boxes, and so on to the root.
    levels: Vec<Vec<Boxes>>,
    bounds: [Corner; 2],
    /// Triangles without area, which nothing can meet.
    pub flat: u32,
}

impl StaticMesh {
    /// Builds the tree; facets in the instrument's frame, mm.
    pub fn new(facets: &[Facet]) -> Result<Self, Unusable> {
        let found = facets.len();
        if found >= super::surface::MAX_IDS {
            return Err(Unusable::TooManyIds { found });
        }
        let largest =
            facets.iter().flatten().flatten().fold(0.0f64, |m, c| if c.abs() > m { c.abs() } else { m });
        let finite = facets.iter().flatten().flatten().all(|c| c.is_finite());
        if !(finite && largest > 0.0) {
            return Err(Unusable::NoVolume { half_mm: largest, depth_mm: largest });
        }
        let scale = libm::exp2(libm::floor(libm::log2(f64::from(BOX_LIMIT - 1) / largest))) as f32;
        let mut mesh =
            StaticMesh { scale, triangles: Vec::new(), levels: Vec::new(), bounds: [[0; 3]; 2], flat: 0 };
        for (facet, number) in facets.iter().zip(0u32..) {
            let corners = facet.map(|p| p.map(|c| to_fixed(c as f32, (scale, 0.0), LIMIT)));
            match Triangle::new(corners) {
                Some(triangle) => mesh.triangles.push((triangle, number)),
                None => mesh.flat += 1,
            }
        }
        if mesh.triangles.is_empty() {
            return Err(Unusable::Empty);
        }
        order(&mut mesh.triangles);
        mesh.build();
        Ok(mesh)
    }

    fn build(&mut self) {
        let mut boxes: Vec<[Corner; 2]> = self.triangles.iter().map(|(t, _)| t.bounds()).collect();
        loop {
            let mut level = Vec::with_capacity(boxes.len().div_ceil(WIDE));
            for eight in boxes.chunks(WIDE) {
                let mut node = Boxes::NONE;
                eight.iter().enumerate().for_each(|(i, b)| node.set(i, *b));
                level.push(node);
            }
            boxes = level.iter().map(Boxes::around).collect();
            self.levels.push(level);
            if let [all] = boxes[..] {
                self.bounds = all;
                return;
            }
        }
    }

    /// Triangles, each with its number, in the tree's order.
    pub fn triangles(&self) -> &[(Triangle, u32)] {
        &self.triangles
    }

    /// Grid steps of a mm.
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// Calls `met(number)` for every triangle that has a point in common with the given one.
    #[inline]
    pub fn meeting(&self, triangle: &Triangle, mut met: impl FnMut(u32)) {
        let bounds = triangle.bounds();
        // At most seven more wait on each of at most eleven levels (8¹¹ > 2³²).
        let mut stack = [(0u8, 0u32); WIDE * 11];
        let mut waiting = 1;
        stack[0] = (self.levels.len() as u8 - 1, 0);
        while waiting > 0 {
            waiting -= 1;
            let (level, node) = stack[waiting];
            let mut mask = self.levels[level as usize][node as usize].meets(&bounds);
            while mask != 0 {
                let child = node * WIDE as u32 + mask.trailing_zeros();
                mask &= mask - 1;
                if level > 0 {
                    stack[waiting] = (level - 1, child);
                    waiting += 1;
                    continue;
                }
                let (other, number) = &self.triangles[child as usize];
                if triangle.meets(other) {
                    met(*number);
                }
            }
        }
    }
}

/// Puts near triangles side by side: halves along the longest side of the box of their centres, cut where a whole subtree ends.
fn order(triangles: &mut [(Triangle, u32)]) {
    let n = triangles.len();
    if n <= WIDE {
        return;
    }
    let centre = |t: &Triangle, k: usize| {
        i64::from(t.corners[0][k]) + i64::from(t.corners[1][k]) + i64::from(t.corners[2][k])
    };
    let extent = |k: usize| {
        let of = || triangles.iter().map(|(t, _)| centre(t, k));
        of().max().unwrap_or(0) - of().min().unwrap_or(0)
    };
    let axis = (0..3).max_by_key(|&k| extent(k)).unwrap_or(0);
    triangles.sort_unstable_by_key(|(t, number)| (centre(t, axis), *number));
    let mut subtree = WIDE;
    while subtree * WIDE < n {
        subtree *= WIDE;
    }
    let cut = ((n / 2 + subtree / 2) / subtree * subtree).clamp(subtree, n - 1);
    let (left, right) = triangles.split_at_mut(cut);
    order(left);
    order(right);
}

/// What a query found besides its pairs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ExactFound {
    /// Pairs.
    pub pairs: u32,
    /// Triangles that reach beyond the grid, or have a corner that is not a number: not tested.
    pub refused: u32,
    /// Triangles without area: not tested.
    pub flat: u32,
}

/// Work space of the queries of one membrane.
#[derive(Debug)]
pub struct Exact {
    cull: Cull,
    grid: Grid,
    pairs: Vec<Pair>,
}

/// Vertices on the grid, each with the planes of the instrument's box beyond which it lies.
#[derive(Debug)]
struct Grid {
    vertex: Vec<(Corner, i32)>,
}

/// Bit of a vertex that lies beyond the grid or is not a number.
const OFF_GRID: i32 = 0x40;

impl Exact {
    /// Lists for a membrane of these triangles between so many nodes.
    pub fn new(triangles: &[[u32; 3]], nodes: usize) -> Result<Self, Unusable> {
        let grid = Grid { vertex: vec![([0; 3], 0); nodes.next_multiple_of(BLOCK)] };
        Ok(Exact { cull: Cull::new(triangles, nodes)?, grid, pairs: Vec::new() })
    }

    /// Finds all pairs; [`Self::pairs`] lists them by membrane triangle.
    pub fn find(
        &mut self,
        mesh: &StaticMesh,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> ExactFound {
        self.pairs.clear();
        let frame = Frame::new(instrument_from_eye);
        let wide = |c: Corner, by: f32| c.map(|c| (c as f32 + by) / mesh.scale);
        let [low, high] = [wide(mesh.bounds[0], -CULL_MARGIN), wide(mesh.bounds[1], CULL_MARGIN)];
        self.cull.sort(surface, &frame, low, high);
        let mut found = ExactFound::default();
        self.cull.survivors(
            surface.triangles.len(),
            &mut (&mut self.grid, &mut self.pairs, &mut found),
            |(grid, _, _), block| grid.place(mesh, &frame, surface, block),
            |(grid, pairs, found), from, to| grid.test(mesh, surface, from..to, pairs, found),
        );
        found.pairs = self.pairs.len() as u32;
        found
    }

    /// Pairs of the last query.
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }
}

/// A point on the grid of a mesh; what lies beyond is put on the limit.
pub fn on_grid(mesh: &StaticMesh, frame: &Frame, point: [f32; 3]) -> Corner {
    frame.point(point).map(|c| to_fixed(c, (mesh.scale, 0.0), LIMIT))
}

impl Grid {
    fn place(&mut self, mesh: &StaticMesh, frame: &Frame, surface: &Surface, block: usize) {
        let [x, y, z] = surface.position_mm;
        let vertices = block * BLOCK..(block * BLOCK + BLOCK).min(x.len());
        let (x, y, z) = (&x[vertices.clone()], &y[vertices.clone()], &z[vertices.clone()]);
        for (((vertex, x), y), z) in self.vertex[vertices].iter_mut().zip(x).zip(y).zip(z) {
            let mut code = 0;
            for axis in 0..3 {
                let value = frame.along(axis, *x, *y, *z);
                let at = to_fixed(value, (mesh.scale, 0.0), LIMIT);
                let [low, high] = [mesh.bounds[0][axis], mesh.bounds[1][axis]];
                let beyond = i32::from(at < low) | i32::from(at > high) << 1;
                code |= (beyond * i32::from(!value.is_nan())) << (2 * axis);
                code |= if at.abs() >= LIMIT { OFF_GRID } else { 0 };
                vertex.0[axis] = at;
            }
            vertex.1 = code;
        }
    }

    fn test(
        &self,
        mesh: &StaticMesh,
        surface: &Surface,
        range: std::ops::Range<usize>,
        pairs: &mut Vec<Pair>,
        found: &mut ExactFound,
    ) {
        for t in range {
            let [a, b, c] = surface.triangles[t].map(|v| self.vertex[v as usize]);
            if a.1 & b.1 & c.1 & !OFF_GRID != 0 || surface.alive[t] == 0 {
                continue;
            }
            if (a.1 | b.1 | c.1) & OFF_GRID != 0 {
                found.refused += 1;
                continue;
            }
            let Some(triangle) = Triangle::new([a.0, b.0, c.0]) else {
                found.flat += 1;
                continue;
            };
            let membrane = t as u32;
            mesh.meeting(&triangle, |instrument| pairs.push(Pair { membrane, instrument }));
        }
    }
}
