//! Draws triangles into a small depth image, in integers only.
//!
//! Fixed-point format: x and y in 1/256 pixel, z in 1/65536 of the volume's depth. Vertices are
//! limited to |x|, |y| < 2¹⁹ (2,048 pixels) and |z| < 2²⁰ (16 depths of the volume). Therefore
//! coordinate differences stay below 2²⁰, their products below 2⁴⁰, an edge function or twice the
//! area below 2⁴¹ for every point within the limits, also one pixel step (2⁸ · 2²⁰) behind the last
//! one; inside a triangle the three edge functions are ≥ 0 and add up to the area, so the sum that
//! is divided for the depth stays below 2⁴¹ · 2²⁰ = 2⁶¹: an `i64` cannot overflow.
//!
//! A pixel is covered if its centre is inside; a centre on an edge belongs to the triangle for
//! which the edge is a top or a left one, so that of two triangles at an edge exactly one draws it.

/// 1/256 pixel.
pub const SUBPIXELS: i32 = 1 << PIXEL_BITS;
/// Bits of a coordinate behind the pixel.
const PIXEL_BITS: u32 = 8;
/// Depth steps of the volume.
pub const DEPTH_STEPS: i32 = 1 << 16;
/// Limit of x and y, exclusive.
pub const XY_LIMIT: i32 = 1 << 19;
/// Limit of z, exclusive.
pub const Z_LIMIT: i32 = 1 << 20;
/// Smallest resolution of an image, pixels.
pub const MIN_RESOLUTION: usize = 8;
/// Largest resolution of an image, pixels.
pub const MAX_RESOLUTION: usize = 256;

const _: () = assert!((MAX_RESOLUTION as i32) * SUBPIXELS < XY_LIMIT);
const _: () = {
    let area_bits = 2 * (XY_LIMIT.trailing_zeros() + 1) + 1;
    assert!(area_bits + Z_LIMIT.trailing_zeros() < 63, "the depth's numerator fits an i64");
    let step_bits = PIXEL_BITS + XY_LIMIT.trailing_zeros() + 1;
    assert!(step_bits < area_bits && area_bits + 1 < 63, "so does an edge one step behind the last pixel");
};

/// A vertex in fixed point.
pub type Fixed = [i32; 3];

/// Pixels from `min` to below `max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// First column and row.
    pub min: [i32; 2],
    /// One past the last column and row.
    pub max: [i32; 2],
}

impl Rect {
    /// No pixel.
    pub const EMPTY: Rect = Rect { min: [0; 2], max: [0; 2] };

    /// A whole image.
    pub fn whole(resolution: usize) -> Self {
        Rect { min: [0; 2], max: [resolution as i32; 2] }
    }

    /// True without pixels.
    pub fn is_empty(&self) -> bool {
        self.min[0] >= self.max[0] || self.min[1] >= self.max[1]
    }

    /// Grows to hold a pixel.
    pub fn include(&mut self, x: i32, y: i32) {
        if self.is_empty() {
            *self = Rect { min: [x, y], max: [x + 1, y + 1] };
        } else {
            self.min = [self.min[0].min(x), self.min[1].min(y)];
            self.max = [self.max[0].max(x + 1), self.max[1].max(y + 1)];
        }
    }
}

/// An edge as E(x, y) = a·x + b·y + c, ≥ 0 inside, and what an edge that is not top or left lacks.
#[derive(Clone, Copy)]
struct Edge {
    a: i64,
    b: i64,
    c: i64,
    bias: i64,
}

impl Edge {
    #[inline(always)]
    fn new(p: Fixed, q: Fixed) -> Self {
        let (px, py) = (i64::from(p[0]), i64::from(p[1]));
        let (dx, dy) = (i64::from(q[0]) - px, i64::from(q[1]) - py);
        // Rows grow downwards: inside of a left edge lies to its right, of a top edge below it.
        let owns = dy < 0 || (dy == 0 && dx > 0);
        Edge { a: -dy, b: dx, c: dy * px - dx * py, bias: if owns { 0 } else { -1 } }
    }

    #[inline(always)]
    fn at(&self, x: i64, y: i64) -> i64 {
        self.a * x + self.b * y + self.c
    }
}

/// What became of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// It was drawn, on however many pixels.
    Yes,
    /// It has no area in the image: degenerate, or seen from its edge.
    Flat,
}

/// A depth before its division: most pixels are decided without it.
#[derive(Debug, Clone, Copy)]
pub struct Depth {
    numerator: i64,
    area: i64,
}

impl Depth {
    /// The depth in steps, rounded down.
    #[inline(always)]
    pub fn steps(self) -> i32 {
        self.numerator.div_euclid(self.area) as i32
    }
}

/// Pixels of an axis whose centres lie between the extremes of three coordinates, within
/// `first..end`.
#[inline(always)]
fn span([a, b, c]: [i32; 3], first: i32, end: i32) -> [i32; 2] {
    // Centre of pixel p is at p + 1/2: the first at or after `low`, the last at or before `high`.
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let half = SUBPIXELS / 2;
    [((low + half - 1) >> PIXEL_BITS).max(first), (((high - half) >> PIXEL_BITS) + 1).min(end)]
}

/// Calls `draw(column, row, depth)` for every pixel of `rect` that the triangle covers, rows in
/// order. The depth may lie outside the volume; vertices must be within the limits.
#[inline(always)]
pub fn triangle(vertices: [Fixed; 3], rect: Rect, mut draw: impl FnMut(i32, i32, Depth)) -> Drawn {
    let [a, mut b, mut c] = vertices;
    debug_assert!(vertices.iter().all(is_within));
    let mut area = Edge::new(a, b).at(i64::from(c[0]), i64::from(c[1]));
    if area == 0 {
        return Drawn::Flat;
    }
    let columns = span([a[0], b[0], c[0]], rect.min[0], rect.max[0]);
    let rows = span([a[1], b[1], c[1]], rect.min[1], rect.max[1]);
    if columns[0] >= columns[1] || rows[0] >= rows[1] {
        return Drawn::Yes;
    }
    if area < 0 {
        (b, c, area) = (c, b, -area);
    }
    let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
    let depths = [i64::from(a[2]), i64::from(b[2]), i64::from(c[2])];
    let centre = |pixel: i32| i64::from(pixel * SUBPIXELS + SUBPIXELS / 2);
    let (x, y) = (centre(columns[0]), centre(rows[0]));
    // From here on the edges only grow by a step per column and per row.
    let mut at_row = edges.map(|e| e.at(x, y) + e.bias);
    for row in rows[0]..rows[1] {
        let mut w = at_row;
        for column in columns[0]..columns[1] {
            if w[0] | w[1] | w[2] >= 0 {
                let part = |i: usize| (w[i] - edges[i].bias) * depths[i];
                draw(column, row, Depth { numerator: part(0) + part(1) + part(2), area });
            }
            for (w, e) in w.iter_mut().zip(&edges) {
                *w += e.a << PIXEL_BITS;
            }
        }
        for (w, e) in at_row.iter_mut().zip(&edges) {
            *w += e.b << PIXEL_BITS;
        }
    }
    Drawn::Yes
}

/// True within the limits of the format.
pub fn is_within(v: &Fixed) -> bool {
    v[0].abs() < XY_LIMIT && v[1].abs() < XY_LIMIT && v[2].abs() < Z_LIMIT
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covered(vertices: [Fixed; 3]) -> Vec<(i32, i32)> {
        let mut pixels = Vec::new();
        triangle(vertices, Rect::whole(32), |x, y, _| pixels.push((x, y)));
        pixels
    }

    #[test]
    fn a_plane_comes_back_at_its_depth() {
        // z = x in pixels of 256 depth steps.
        let v = |x: i32, y: i32| [x * 256, y * 256, x * 256];
        let mut count = 0;
        triangle([v(0, 0), v(31, 0), v(0, 31)], Rect::whole(32), |x, _, z| {
            assert_eq!(z.steps(), x * 256 + 128);
            count += 1;
        });
        assert!(count > 400);
    }

    #[test]
    fn shared_edges_through_pixel_centres_are_drawn_once() {
        // A square whose corners are pixel centres, split both ways.
        let v = |x: i32, y: i32| [x * 256 + 128, y * 256 + 128, 0];
        for split in [
            [[v(4, 4), v(12, 4), v(12, 12)], [v(4, 4), v(12, 12), v(4, 12)]],
            [[v(4, 4), v(12, 4), v(4, 12)], [v(12, 4), v(4, 12), v(12, 12)]],
        ] {
            let mut pixels: Vec<_> = split.into_iter().flat_map(covered).collect();
            let all = pixels.len();
            pixels.sort_unstable();
            pixels.dedup();
            assert_eq!((pixels.len(), all), (64, 64));
            assert!(pixels.contains(&(4, 4)) && !pixels.contains(&(12, 12)), "top and left belong to it");
        }
    }

    #[test]
    fn the_largest_triangle_does_not_overflow() {
        let (x, z) = (XY_LIMIT - 1, Z_LIMIT - 1);
        let mut count = 0;
        triangle([[-x, -x, z], [x, -x, z], [0, x, z]], Rect::whole(256), |_, _, depth| {
            assert_eq!(depth.steps(), z);
            count += 1;
        });
        assert_eq!(count, 256 * 256);
    }

    proptest! {
        /// A fan around an inner point covers each pixel at most once, and the same pixels as
        /// the brute-force test of every pixel against exact barycentric signs would.
        #[test]
        fn fans_never_draw_a_pixel_twice(
            corners in prop::collection::vec((-2000i32..10000, -2000i32..10000), 4..5),
        ) {
            let mut v: Vec<Fixed> = corners.iter().map(|&(x, y)| [x, y, 0]).collect();
            let cross = |a: Fixed, b: Fixed, c: Fixed| {
                i64::from(b[0] - a[0]) * i64::from(c[1] - a[1]) - i64::from(b[1] - a[1]) * i64::from(c[0] - a[0])
            };
            // Two triangles on different sides of the diagonal v0–v2: through its middle every
            // corner has its counterpart beyond it.
            if cross(v[0], v[2], v[1]).signum() == cross(v[0], v[2], v[3]).signum() {
                v[3] = std::array::from_fn(|axis| v[0][axis] + v[2][axis] - v[3][axis]);
            }
            prop_assert!(cross(v[0], v[2], v[1]).signum() * cross(v[0], v[2], v[3]).signum() <= 0);
            let mut pixels = covered([v[0], v[1], v[2]]);
            pixels.extend(covered([v[0], v[2], v[3]]));
            let all = pixels.len();
            pixels.sort_unstable();
            pixels.dedup();
            prop_assert_eq!(pixels.len(), all);
        }

        #[test]
        fn winding_does_not_matter(a in -3000i32..9000, b in -3000i32..9000, c in -3000i32..9000) {
            let v = [[a, b, 5], [b, c, 700], [c, a, -90]];
            let mut first = Vec::new();
            triangle(v, Rect::whole(32), |x, y, z| first.push((x, y, z.steps())));
            let mut second = Vec::new();
            triangle([v[0], v[2], v[1]], Rect::whole(32), |x, y, z| second.push((x, y, z.steps())));
            prop_assert_eq!(first, second);
        }
    }
}
