//! Exact pairs: which triangle of the membrane meets which triangle of the instrument.
//!
//! The membrane is put into the instrument's frame, where the instrument never moves: a static tree
//! over the instrument serves every pose, and none is needed over the membrane, which is culled by
//! the instrument's box ([`collision::surface`]). What is left goes down the tree, sixteen boxes at
//! a time, and at the end an exact test ([`tritri`]) decides.
//!
//! Exact means: with respect to corners rounded to a grid that follows from the instrument's size
//! (a power of two of mm; 31 nm for a shaft of 3 mm). From there on all numbers are whole and no
//! sign is ever rounded.

pub mod tritri;

use collision::quantize::{FixedFormat, PLANES, QuantizedVertex, Quantizer, REFUSED};
use collision::surface::{CollisionError, Cull, Frame, Surface};
use collision::tool_mesh::Facet;
use nalgebra::Isometry3;
use tritri::{Corner, LIMIT, Triangle};

/// Children of a node of the instrument's tree.
const WIDE: usize = 16;
/// Levels of the largest tree: 16⁸ = 2³².
const MAX_LEVELS: usize = 8;
/// The instrument's box takes at most this part of the grid; a membrane triangle that reaches into
/// the box may be three times as large as the instrument before it leaves the grid.
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

/// Sixteen boxes side by side: one AVX-512 register each of their six bounds.
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

    /// Bit i is 1 if box i meets the given one, else 0.
    #[inline(always)]
    fn intersects(&self, [low, high]: &[Corner; 2]) -> u32 {
        // A word a lane and selections: the form that becomes vector code.
        let mut apart = [0u32; WIDE];
        for k in 0..3 {
            for (i, apart) in apart.iter_mut().enumerate() {
                *apart |= if self.low[k][i] > high[k] { 1 } else { 0 };
                *apart |= if self.high[k][i] < low[k] { 1 } else { 0 };
            }
        }
        apart.iter().enumerate().fold(0, |mask, (i, &a)| mask | u32::from(a == 0) << i)
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
    pub fn new(facets: &[Facet]) -> Result<Self, CollisionError> {
        let found = facets.len();
        if found >= collision::surface::MAX_IDS {
            return Err(CollisionError::TooManyIds { found });
        }
        let largest =
            facets.iter().flatten().flatten().fold(0.0f64, |m, c| if c.abs() > m { c.abs() } else { m });
        let finite = facets.iter().flatten().flatten().all(|c| c.is_finite());
        if !(finite && largest > 0.0) {
            return Err(CollisionError::NoVolume { half_mm: largest, depth_mm: largest });
        }
        let scale = libm::exp2(libm::floor(libm::log2(f64::from(BOX_LIMIT - 1) / largest))) as f32;
        let mut mesh =
            StaticMesh { scale, triangles: Vec::new(), levels: Vec::new(), bounds: [[0; 3]; 2], flat: 0 };
        let format = mesh.format();
        for (facet, number) in facets.iter().zip(0u32..) {
            let corners = facet.map(|p| p.map(|c| format.to_fixed(c as f32, LIMIT)));
            match Triangle::new(corners) {
                Some(triangle) => mesh.triangles.push((triangle, number)),
                None => mesh.flat += 1,
            }
        }
        if mesh.triangles.is_empty() {
            return Err(CollisionError::Empty);
        }
        order(&mut mesh.triangles);
        mesh.build();
        Ok(mesh)
    }

    fn format(&self) -> FixedFormat {
        FixedFormat { scale: self.scale, offset: 0.0 }
    }

    fn build(&mut self) {
        let mut boxes: Vec<[Corner; 2]> = self.triangles.iter().map(|(t, _)| t.bounds()).collect();
        loop {
            let mut level = Vec::with_capacity(boxes.len().div_ceil(WIDE));
            for children in boxes.chunks(WIDE) {
                let mut node = Boxes::NONE;
                children.iter().enumerate().for_each(|(i, b)| node.set(i, *b));
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

    /// Calls `met(i, number)` for every own triangle that has a point in common with the i-th of
    /// the given ones. They go down the tree together, which is worth it if they are neighbours.
    #[inline(always)]
    pub fn for_each_intersecting(&self, triangles: &[Triangle], mut met: impl FnMut(usize, u32)) {
        let Some(first) = triangles.first() else { return };
        let mut bounds = first.bounds();
        for other in &triangles[1..] {
            bounds = join(&bounds, &other.bounds());
        }
        let top = self.levels.len() - 1;
        // Which children of the node in work on each level still wait.
        let (mut node, mut waiting) = ([0usize; MAX_LEVELS], [0u32; MAX_LEVELS]);
        let mut level = top;
        waiting[top] = self.levels[top][0].intersects(&bounds);
        loop {
            if waiting[level] == 0 {
                if level == top {
                    return;
                }
                level += 1;
                continue;
            }
            let child = node[level] * WIDE + waiting[level].trailing_zeros() as usize;
            waiting[level] &= waiting[level] - 1;
            if level > 0 {
                level -= 1;
                (node[level], waiting[level]) = (child, self.levels[level][child].intersects(&bounds));
                continue;
            }
            let (other, number) = &self.triangles[child];
            for (i, triangle) in triangles.iter().enumerate() {
                if triangle.intersects(other) {
                    met(i, *number);
                }
            }
        }
    }
}

/// The box around two.
#[inline(always)]
fn join(a: &[Corner; 2], b: &[Corner; 2]) -> [Corner; 2] {
    let of = |i: usize, pick: fn(i32, i32) -> i32| std::array::from_fn(|k| pick(a[i][k], b[i][k]));
    [of(0, Ord::min), of(1, Ord::max)]
}

/// Puts near triangles side by side: halves along the longest side of the box of their centres, cut
/// where a whole subtree ends.
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
pub struct PairCounts {
    /// Pairs.
    pub pairs: u32,
    /// Triangles that reach beyond the grid, or have a corner that is not a number: not tested.
    pub refused: u32,
    /// Triangles without area: not tested.
    pub flat: u32,
}

/// Work space of the queries of one membrane.
#[derive(Debug)]
pub struct PairQuery {
    cull: Cull,
    vertex: Vec<QuantizedVertex>,
    pairs: Vec<Pair>,
}

impl PairQuery {
    /// Lists for a membrane of these triangles between so many nodes.
    pub fn new(triangles: &[[u32; 3]], nodes: usize) -> Result<Self, CollisionError> {
        let cull = Cull::new(triangles, nodes)?;
        Ok(PairQuery { cull, vertex: vec![QuantizedVertex::default(); nodes], pairs: Vec::new() })
    }

    /// Uses the base instruction set only: for the proof that every path gives the same bits.
    pub fn without_simd(mut self) -> Self {
        self.cull = self.cull.without_simd();
        self
    }

    /// Finds all pairs; [`Self::pairs`] lists them.
    pub fn query(
        &mut self,
        mesh: &StaticMesh,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> PairCounts {
        self.pairs.clear();
        let frame = Frame::new(instrument_from_eye);
        let wide = |c: Corner, by: f32| c.map(|c| (c as f32 + by) / mesh.scale);
        let [low, high] = [wide(mesh.bounds[0], -CULL_MARGIN), wide(mesh.bounds[1], CULL_MARGIN)];
        self.cull.classify(surface, &frame, low, high);
        let placing = Quantizer {
            frame,
            format: [mesh.format(); 3],
            limit: [LIMIT; 3],
            low: mesh.bounds[0],
            high: mesh.bounds[1],
        };
        let simd = self.cull.simd();
        let mut found = PairCounts::default();
        self.cull.for_each_survivor(
            surface.triangles.len(),
            &mut (&mut self.vertex, &mut self.pairs, &mut found),
            |(vertex, _, _), block| placing.block(simd, surface, block, vertex),
            |(vertex, pairs, found), from, to| {
                simd.dispatch(TestChunk { mesh, surface, range: from..to, vertex, pairs, found });
            },
        );
        found.pairs = self.pairs.len() as u32;
        found
    }

    /// Pairs of the last query, in an order that depends on the meshes alone.
    pub fn pairs(&self) -> &[Pair] {
        &self.pairs
    }
}

/// A point on the grid of a mesh; what lies beyond is put on the limit.
pub fn on_grid(mesh: &StaticMesh, frame: &Frame, point: [f32; 3]) -> Corner {
    frame.point(point).map(|c| mesh.format().to_fixed(c, LIMIT))
}

struct TestChunk<'a> {
    mesh: &'a StaticMesh,
    surface: &'a Surface<'a>,
    range: std::ops::Range<usize>,
    vertex: &'a [QuantizedVertex],
    pairs: &'a mut Vec<Pair>,
    found: &'a mut PairCounts,
}

impl pulp::NullaryFnOnce for TestChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        let mut waiting = Batch::new();
        for t in self.range.clone() {
            let [a, b, c] = self.surface.triangles[t].map(|v| self.vertex[v as usize]);
            if a.code & b.code & c.code & PLANES != 0 || self.surface.alive[t] == 0 {
                continue;
            }
            if (a.code | b.code | c.code) & REFUSED != 0 {
                self.found.refused += 1;
                continue;
            }
            let Some(triangle) = Triangle::new([a.at, b.at, c.at]) else {
                self.found.flat += 1;
                continue;
            };
            waiting.triangles[waiting.count] = triangle;
            waiting.numbers[waiting.count] = t as u32;
            waiting.count += 1;
            if waiting.count == BATCH {
                self.test(&mut waiting);
            }
        }
        self.test(&mut waiting);
    }
}

/// Triangles that go down the tree together: the two of a square have nearly the same box.
const BATCH: usize = 2;

struct Batch {
    triangles: [Triangle; BATCH],
    numbers: [u32; BATCH],
    count: usize,
}

impl Batch {
    #[inline(always)]
    fn new() -> Self {
        let none = Triangle { corners: [[0; 3]; 3], normal: [0; 3], height: 0 };
        Batch { triangles: [none; BATCH], numbers: [0; BATCH], count: 0 }
    }
}

impl TestChunk<'_> {
    #[inline(always)]
    fn test(&mut self, batch: &mut Batch) {
        let Batch { triangles, numbers, count } = batch;
        self.mesh.for_each_intersecting(&triangles[..*count], |i, instrument| {
            self.pairs.push(Pair { membrane: numbers[i], instrument });
        });
        *count = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::Scene;
    use collision::tool_mesh::{PLAIN, ToolMesh};
    use proptest::prelude::*;
    use protocol::handles::Tool;
    use protocol::random::Random;

    fn brute(mesh: &StaticMesh, pose: &Isometry3<f64>, surface: &Surface) -> Vec<Pair> {
        let frame = Frame::new(pose);
        let mut pairs = Vec::new();
        for (t, nodes) in surface.triangles.iter().enumerate() {
            let corners = nodes.map(|v| on_grid(mesh, &frame, surface.position_mm.map(|a| a[v as usize])));
            let on_grid = corners.as_flattened().iter().all(|c| c.abs() < LIMIT);
            let finite = nodes.iter().all(|v| surface.position_mm.iter().all(|a| a[*v as usize].is_finite()));
            if !on_grid || !finite {
                continue;
            }
            let Some(triangle) = Triangle::new(corners) else { continue };
            let met = mesh.triangles().iter().filter(|(other, _)| other.intersects(&triangle));
            pairs.extend(met.map(|(_, n)| Pair { membrane: t as u32, instrument: *n }));
        }
        pairs.sort_unstable();
        pairs
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// Cull, tree and vector code lose nothing and add nothing.
        #[test]
        fn pairs_are_those_of_every_triangle_with_every_triangle(seed in any::<u64>(), spoilt in any::<bool>()) {
            let mut random = Random::from_seed(seed);
            let mut scene = Scene::random(&mut random, &[32]);
            if spoilt { scene.spoil(&mut random); }
            let mesh = StaticMesh::new(&scene.facets()).unwrap();
            let surface = Surface {
                position_mm: scene.position_mm.each_ref().map(Vec::as_slice),
                triangles: &scene.triangles,
                alive: &scene.alive,
            };
            let pose = scene.instrument_from_eye;
            let mut expected = brute(&mesh, &pose, &surface);
            expected.retain(|p| scene.alive[p.membrane as usize] != 0);
            let nodes = scene.position_mm[0].len();
            let mut exact = PairQuery::new(&scene.triangles, nodes).unwrap();
            let found = exact.query(&mesh, &pose, &surface);
            let order = exact.pairs().to_vec();
            let mut pairs = order.clone();
            pairs.sort_unstable();
            prop_assert_eq!(pairs, expected);
            let mut plain = PairQuery::new(&scene.triangles, nodes).unwrap().without_simd();
            prop_assert_eq!((plain.query(&mesh, &pose, &surface), plain.pairs()), (found, &order[..]));
        }
    }

    #[test]
    fn an_instrument_that_cannot_be_one_is_refused() {
        let flat = [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]];
        assert_eq!(StaticMesh::new(&flat).unwrap_err(), CollisionError::Empty);
        let nan = [[[0.0, 0.0, f64::NAN], [1.0, 0.0, 0.0], [2.0, 1.0, 0.0]]];
        assert!(matches!(StaticMesh::new(&nan).unwrap_err(), CollisionError::NoVolume { .. }));
        assert!(StaticMesh::new(&[]).is_err());
    }

    #[test]
    fn a_triangle_beyond_the_grid_is_refused_and_counted() {
        let facets = ToolMesh::with_detail(Tool::LightPipe, 0.25, 1.5, PLAIN).facets(0.0);
        let mesh = StaticMesh::new(&facets).unwrap();
        let position = [[-1000.0f32, 1000.0, 0.0, -1.0], [-1.0, -1.0, 1000.0, -1.0], [0.5; 4]];
        let surface = Surface {
            position_mm: position.each_ref().map(|a| &a[..]),
            triangles: &[[0, 1, 2], [0, 0, 3]],
            alive: &[1, 1],
        };
        let mut exact = PairQuery::new(surface.triangles, 4).unwrap();
        let found = exact.query(&mesh, &Isometry3::identity(), &surface);
        assert_eq!((found.pairs, found.refused), (0, 1));
    }
}
