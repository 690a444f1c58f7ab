//! What a vitrector's port sees: a perspective camera in the port draws the membrane alone (paper,
//! section 3.3.2); the triangles that it sees lie in the suction cone.
//!
//! The camera sits at the cone's apex. Its z runs along the instrument's +x, its x along the
//! instrument's y and its y along the instrument's z. Across, lengths are divided by the tangent of
//! the half angle, so that the cone's edge is |x| = z. Pixel (column, row) of R × R stands for the
//! ray (2·column + 1 − R, 2·row + 1 − R, R); only rays inside the round cone are drawn.
//!
//! Nothing is divided by depth and nothing is clipped: with corners P₀ P₁ P₂ in whole numbers and a
//! ray r, the three determinants Eᵢ = r·(Pⱼ × Pₖ) have the sign of D = P₀·(P₁ × P₂) exactly if the
//! ray meets the triangle (Olano and Greer, "Triangle scan conversion using 2D homogeneous
//! coordinates", 1997), also where corners lie behind the camera; the depth is D·r_z / ΣEᵢ. A ray
//! on an edge belongs to the triangle that it would meet if it were moved by (ε, ε²).
//!
//! Format: [`REACH_STEPS`] = 2¹⁵ steps are the cone's reach, coordinates stay below 2¹⁷. A cross
//! product is below 2³⁵, E below 3·2⁴³, ΣE below 9·2⁴³, D below 3·2⁵², D·r_z below 3·2⁶⁰: an `i64`
//! holds all.

use super::quantize::{FixedFormat, PLANES, QuantizedVertex, Quantizer, REFUSED};
use super::surface::{CollisionError, Cull, Frame, Surface};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use protocol::handles::PORT_HEIGHT_MM;

/// Depth steps of the cone's reach.
pub const REACH_STEPS: i32 = 1 << 15;
/// Limit of a coordinate, exclusive.
pub const LIMIT: i32 = 1 << 17;
/// Largest resolution, pixels along a side.
pub const MAX_RESOLUTION: usize = 256;
/// No membrane at this pixel.
const NOTHING: i32 = i32::MAX;

const _: () = {
    let (limit, ray) = (LIMIT as i128, MAX_RESOLUTION as i128);
    let cross = 2 * limit * limit;
    assert!(3 * limit * cross * ray < i64::MAX as i128, "the depth's numerator fits an i64");
    assert!(3 * 3 * cross * ray < i64::MAX as i128, "so does the sum of the edge functions");
};

/// The shape of a cone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SuctionCone {
    /// Tangent of the half angle; above 0.
    pub tan_half_angle: f64,
    /// From the apex along the axis, mm.
    pub reach_mm: f64,
}

/// What a look counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PortCounts {
    /// Pixels with membrane.
    pub pixels: u32,
    /// Triangles too large for the number format, or with a corner that is not a number.
    pub refused: u32,
    /// Triangles in the cone that the camera sees from their edge, or without area.
    pub flat: u32,
}

/// A pixel with membrane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PortPixel {
    /// Column and row.
    pub at: [i32; 2],
    /// The nearest triangle there.
    pub triangle: u32,
    /// Its depth, steps.
    pub depth: i32,
}

/// The image of a port and its lists; one serves all vitrectors.
#[derive(Debug)]
pub struct PortCamera {
    resolution: i32,
    cull: Cull,
    canvas: Canvas,
    triangles: Vec<u32>,
    listed: Vec<u8>,
}

#[derive(Debug)]
struct Canvas {
    vertex: Vec<QuantizedVertex>,
    depth: Vec<i32>,
    id: Vec<u32>,
}

impl PortCamera {
    /// An image of `resolution` × `resolution` pixels, lists for a membrane of these triangles
    /// between so many nodes.
    pub fn new(resolution: usize, triangles: &[[u32; 3]], nodes: usize) -> Result<Self, CollisionError> {
        if !(1..=MAX_RESOLUTION).contains(&resolution) {
            return Err(CollisionError::Resolution { resolution });
        }
        let pixels = resolution * resolution;
        Ok(PortCamera {
            resolution: resolution as i32,
            cull: Cull::new(triangles, nodes)?,
            canvas: Canvas {
                vertex: vec![QuantizedVertex::default(); nodes],
                depth: vec![NOTHING; pixels],
                id: vec![0; pixels],
            },
            triangles: Vec::with_capacity(pixels.min(triangles.len())),
            listed: vec![0; triangles.len()],
        })
    }

    /// Uses the base instruction set only: for the proof that every path gives the same bits.
    pub fn without_simd(mut self) -> Self {
        self.cull = self.cull.without_simd();
        self
    }

    /// Looks out of the port. Afterwards [`Self::triangles`] and [`Self::pixels_seen`] hold what
    /// lies in the cone.
    pub fn render(
        &mut self,
        instrument_from_eye: &Isometry3<f64>,
        cone: &SuctionCone,
        surface: &Surface,
    ) -> PortCounts {
        self.triangles.drain(..).for_each(|t| self.listed[t as usize] = 0);
        self.canvas.depth.fill(NOTHING);
        let frame = Frame::new(&(camera_from_instrument() * instrument_from_eye));
        let (width, reach) = ((cone.reach_mm * cone.tan_half_angle) as f32, cone.reach_mm as f32);
        // Wider than the exact planes by more than any rounding.
        let (wide, slack) = (width * 1.01, reach * 0.01);
        self.cull.classify(surface, &frame, [-wide, -wide, -slack], [wide, wide, reach + slack]);
        let (simd, resolution) = (self.cull.simd(), self.resolution);
        let placing = placing(frame, cone);
        let mut seen = PortCounts::default();
        self.cull.for_each_survivor(
            surface.triangles.len(),
            &mut (&mut self.canvas, &mut seen),
            |(canvas, _), block| placing.block(simd, surface, block, &mut canvas.vertex),
            |(canvas, seen), from, to| {
                for t in (from..to).filter(|&t| surface.alive[t] != 0) {
                    canvas.draw(resolution, surface.triangles[t], t as u32, seen);
                }
            },
        );
        self.list(&mut seen);
        seen
    }

    /// Triangles seen, in the order of their first pixels.
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// Pixels with membrane, row by row.
    pub fn pixels_seen(&self) -> impl Iterator<Item = PortPixel> + '_ {
        let width = self.resolution;
        let pixels = self.canvas.depth.iter().zip(&self.canvas.id).zip(0i32..);
        pixels.filter(|((depth, _), _)| **depth != NOTHING).map(move |((&depth, &triangle), pixel)| {
            PortPixel { at: [pixel % width, pixel / width], triangle, depth }
        })
    }

    /// Distance of a pixel's membrane along the axis, and from the axis, mm.
    pub fn place_mm(&self, spot: &PortPixel, cone: &SuctionCone) -> [f64; 2] {
        let along = f64::from(spot.depth) * cone.reach_mm / f64::from(REACH_STEPS);
        let [u, v] = spot.at.map(|p| f64::from(2 * p + 1 - self.resolution));
        let aside = libm::sqrt(u * u + v * v) / f64::from(self.resolution);
        [along, along * cone.tan_half_angle * aside]
    }

    fn list(&mut self, seen: &mut PortCounts) {
        for (&depth, &triangle) in self.canvas.depth.iter().zip(&self.canvas.id) {
            if depth == NOTHING {
                continue;
            }
            seen.pixels += 1;
            let listed = &mut self.listed[triangle as usize];
            if *listed == 0 {
                *listed = 1;
                self.triangles.push(triangle);
            }
        }
    }
}

/// The port's camera on the instrument.
pub fn camera_from_instrument() -> Isometry3<f64> {
    // x to z, y to x, z to y: a third of a turn.
    let turn = UnitQuaternion::new_unchecked(Quaternion::new(0.5, -0.5, -0.5, -0.5));
    Isometry3::from_parts(Translation3::new(0.0, -PORT_HEIGHT_MM, 0.0), turn)
}

/// How a look maps the eye to whole steps.
fn placing(frame: Frame, cone: &SuctionCone) -> Quantizer {
    let along = f64::from(REACH_STEPS) / cone.reach_mm;
    let format = |steps: f64| FixedFormat { scale: steps as f32, offset: 0.0 };
    let across = format(along / cone.tan_half_angle);
    Quantizer {
        frame,
        format: [across, across, format(along)],
        limit: [LIMIT; 3],
        low: [-REACH_STEPS, -REACH_STEPS, 0],
        high: [REACH_STEPS; 3],
    }
}

type Wide = [i64; 3];

fn cross(a: Wide, b: Wide) -> Wide {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: Wide, b: Wide) -> i64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The plane through the apex and an edge, and what an edge that does not own its rays lacks.
#[derive(Clone, Copy)]
struct Edge {
    normal: Wide,
    bias: i64,
}

impl Edge {
    fn new(p: Wide, q: Wide) -> Self {
        let normal = cross(p, q);
        let owns = normal[0] > 0 || (normal[0] == 0 && normal[1] > 0);
        Edge { normal, bias: if owns { 0 } else { -1 } }
    }
}

/// First and one past the last pixel of an axis that a triangle before the camera can cover, a
/// pixel more to both sides.
fn span(corners: &[Wide; 3], axis: usize, resolution: i64) -> [i64; 2] {
    if corners.iter().any(|p| p[2] <= 0) {
        return [0, resolution];
    }
    let pixel = |p: &Wide| ((p[axis] * resolution).div_euclid(p[2]) + resolution - 1).div_euclid(2);
    let all = corners.each_ref().map(pixel);
    let (low, high) = (all[0].min(all[1]).min(all[2]), all[0].max(all[1]).max(all[2]));
    [(low - 1).clamp(0, resolution), (high + 3).clamp(0, resolution)]
}

impl Canvas {
    fn draw(&mut self, resolution: i32, nodes: [u32; 3], triangle: u32, seen: &mut PortCounts) {
        let placed = nodes.map(|n| self.vertex[n as usize]);
        if placed.iter().fold(PLANES, |all, p| all & p.code) & PLANES != 0 {
            return;
        }
        if placed.iter().any(|p| p.code & REFUSED != 0) {
            seen.refused += 1;
            return;
        }
        let [a, mut b, mut c] = placed.map(|p| p.at.map(i64::from));
        let mut volume = dot(a, cross(b, c));
        if volume == 0 {
            seen.flat += 1;
            return;
        }
        if volume < 0 {
            (b, c, volume) = (c, b, -volume);
        }
        self.fill(i64::from(resolution), [a, b, c], volume, triangle);
    }

    fn fill(&mut self, resolution: i64, corners: [Wide; 3], volume: i64, triangle: u32) {
        let [a, b, c] = corners;
        let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
        let ([left, right], [top, bottom]) = (span(&corners, 0, resolution), span(&corners, 1, resolution));
        for row in top..bottom {
            for column in left..right {
                let ray = [2 * column + 1 - resolution, 2 * row + 1 - resolution, resolution];
                let e = edges.map(|edge| dot(edge.normal, ray) + edge.bias);
                if e[0] | e[1] | e[2] < 0 || ray[0] * ray[0] + ray[1] * ray[1] > resolution * resolution {
                    continue;
                }
                let sum = e[0] + e[1] + e[2] - edges[0].bias - edges[1].bias - edges[2].bias;
                let depth = (volume * resolution) / sum;
                let pixel = (row * resolution + column) as usize;
                if depth <= i64::from(REACH_STEPS) && (depth as i32) < self.depth[pixel] {
                    (self.depth[pixel], self.id[pixel]) = (depth as i32, triangle);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    const VIEW: SuctionCone = SuctionCone { tan_half_angle: 0.7, reach_mm: 1.5 };

    struct Mesh {
        position_mm: [Vec<f32>; 3],
        triangles: Vec<[u32; 3]>,
        alive: Vec<u8>,
    }

    impl Mesh {
        /// Points of the instrument's frame, seen from the eye.
        fn new(eye_from_instrument: &Isometry3<f64>, points: &[[f64; 3]], triangles: Vec<[u32; 3]>) -> Self {
            let at = |k: usize| {
                points.iter().map(|p| (eye_from_instrument * Point3::from(*p))[k] as f32).collect()
            };
            let alive = vec![1; triangles.len()];
            Mesh { position_mm: std::array::from_fn(at), triangles, alive }
        }

        fn surface(&self) -> Surface<'_> {
            let position_mm = self.position_mm.each_ref().map(Vec::as_slice);
            Surface { position_mm, triangles: &self.triangles, alive: &self.alive }
        }
    }

    fn pose() -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(3.0, -1.0, -10.4),
            UnitQuaternion::from_euler_angles(0.4, -0.2, 1.3),
        )
    }

    fn render(mesh: &Mesh, resolution: usize) -> (PortCamera, PortCounts) {
        let mut suction = PortCamera::new(resolution, &mesh.triangles, mesh.position_mm[0].len()).unwrap();
        let seen = suction.render(&pose().inverse(), &VIEW, &mesh.surface());
        (suction, seen)
    }

    #[test]
    fn the_camera_looks_out_of_the_port() {
        let at = camera_from_instrument() * Point3::new(0.5, 0.1, PORT_HEIGHT_MM + 0.2);
        assert!((at - Point3::new(0.1, 0.2, 0.5)).norm() < 1e-12, "{at}");
    }

    #[test]
    fn a_wall_across_fills_the_round_cone_at_its_depth() {
        let wall =
            [[0.6, -9.0, -9.0], [0.6, 9.0, -9.0], [0.6, 0.0, 9.0]].map(|[x, y, z]| [x, y * 0.4, z * 0.4]);
        let mesh = Mesh::new(&pose(), &wall, vec![[0, 1, 2]]);
        let (suction, seen) = render(&mesh, 32);
        assert_eq!(seen.refused, 0);
        let round = std::f64::consts::PI * 256.0;
        assert!((f64::from(seen.pixels) - round).abs() < 24.0, "{} {round}", seen.pixels);
        for spot in suction.pixels_seen() {
            let [along, aside] = suction.place_mm(&spot, &VIEW);
            assert!((along - 0.6).abs() < 1e-4 && aside < 0.6 * 0.7 + 1e-4);
        }
        assert_eq!(suction.triangles(), [0]);
    }

    #[test]
    fn what_lies_behind_the_port_or_beyond_the_reach_is_not_seen() {
        for x in [-0.6, 1.6] {
            let wall = [[x, -1.0, -1.0], [x, 1.0, -1.0], [x, 0.0, 2.0]];
            let mesh = Mesh::new(&pose(), &wall, vec![[0, 1, 2]]);
            assert_eq!(render(&mesh, 16).1.pixels, 0, "{x}");
        }
    }

    #[test]
    fn a_triangle_that_reaches_behind_the_camera_is_drawn_where_it_is_before_it() {
        // A floor under the axis: from behind the camera to the far end.
        let floor = [[-1.0, -1.5, 0.1], [1.4, -1.5, 0.1], [0.2, 2.0, 0.1]];
        let mesh = Mesh::new(&pose(), &floor, vec![[0, 1, 2]]);
        let (suction, seen) = render(&mesh, 32);
        assert!(seen.pixels > 100, "{seen:?}");
        assert!(suction.pixels_seen().all(|s| s.at[1] < 16), "only below the axis");
    }

    #[test]
    fn bad_corners_are_refused_and_counted() {
        let wall = [[0.6, -1.0, -1.0], [0.6, 1.0, -1.0], [f64::NAN, 0.0, 1.0]];
        let mesh = Mesh::new(&pose(), &wall, vec![[0, 1, 2]]);
        assert_eq!(render(&mesh, 16).1, PortCounts { refused: 1, ..PortCounts::default() });
        let same = [[0.6, 0.1, 0.3], [0.6, 0.1, 0.3], [0.6, 0.2, 0.3]];
        let mesh = Mesh::new(&pose(), &same, vec![[0, 1, 2]]);
        assert_eq!(render(&mesh, 16).1, PortCounts { flat: 1, ..PortCounts::default() });
        assert!(PortCamera::new(0, &mesh.triangles, 3).is_err());
    }

    /// The corners in whole steps as documented, then every ray against every triangle in 128 bits
    /// by Cramer's rule: t·r = Σ bᵢ Pᵢ with Σ bᵢ = 1. No edge functions: b from the inverse,
    /// compared as fractions.
    fn exact(mesh: &Mesh, resolution: i128) -> Vec<Option<(u32, i128)>> {
        let frame = Frame::new(&(camera_from_instrument() * pose().inverse()));
        let along = f64::from(REACH_STEPS) / VIEW.reach_mm;
        let scales =
            [(along / VIEW.tan_half_angle) as f32, (along / VIEW.tan_half_angle) as f32, along as f32];
        let limit = LIMIT as f32;
        let corner = |n: u32| -> [i128; 3] {
            let p = frame.point(mesh.position_mm.each_ref().map(|a| a[n as usize]));
            std::array::from_fn(|k| {
                i128::from(f64::from(p[k] * scales[k] + limit + 0.5).floor() as i64 - i64::from(LIMIT))
            })
        };
        let mut image = vec![None; (resolution * resolution) as usize];
        for (t, nodes) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = nodes.map(corner);
            let (ab, ac) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            for (row, column) in (0..resolution).flat_map(|r| (0..resolution).map(move |c| (r, c))) {
                let r = [2 * column + 1 - resolution, 2 * row + 1 - resolution, resolution];
                if r[0] * r[0] + r[1] * r[1] > resolution * resolution {
                    continue;
                }
                // a + u·ab + v·ac = t·r; a ray on an edge is moved by (ε, ε²), which the sign of
                // the first derivative that is not 0 decides.
                let det = |p: [i128; 3], q: [i128; 3], s: [i128; 3]| {
                    p[0] * (q[1] * s[2] - q[2] * s[1]) - p[1] * (q[0] * s[2] - q[2] * s[0])
                        + p[2] * (q[0] * s[1] - q[1] * s[0])
                };
                let minus = |p: [i128; 3]| p.map(|c| -c);
                let whole = |r: [i128; 3]| det(ab, ac, minus(r));
                let share_u = |r: [i128; 3]| det(minus(a), ac, minus(r));
                let share_v = |r: [i128; 3]| det(ab, minus(a), minus(r));
                let way = det(ab, ac, minus(a));
                let d = whole(r);
                if d == 0 {
                    continue;
                }
                let inside = |f: &dyn Fn([i128; 3]) -> i128| {
                    let chain = [f(r), f([1, 0, 0]), f([0, 1, 0])];
                    chain.into_iter().find(|c| *c != 0).unwrap_or(0).signum() == d.signum()
                };
                let rest = |r: [i128; 3]| whole(r) - share_u(r) - share_v(r);
                if !(inside(&share_u) && inside(&share_v) && inside(&rest)) || way.signum() != d.signum() {
                    continue;
                }
                let depth = (way * d.signum() * r[2]).div_euclid(d.abs());
                let pixel = &mut image[(row * resolution + column) as usize];
                let nearer = pixel.is_none_or(|(_, old)| depth < old);
                if depth <= i128::from(REACH_STEPS) && nearer {
                    *pixel = Some((t as u32, depth));
                }
            }
        }
        image
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// A wavy sheet anywhere about the port, also behind it and across it: each pixel as an
        /// exact ray finds it.
        #[test]
        fn the_image_is_that_of_exact_rays(
            middle in prop::array::uniform3(-0.4f64..1.2), normal in prop::array::uniform3(-1.0f64..1.0),
            side in 0.08f64..0.4, waves in prop::array::uniform4(-1.0f64..1.0), resolution in prop::sample::select(vec![8usize, 16, 32]),
        ) {
            let normal = Vector3::from(normal);
            prop_assume!(normal.norm() > 0.2);
            let normal = normal.normalize();
            let first = normal.cross(&if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }).normalize();
            let second = normal.cross(&first);
            let n = 7u32;
            let points: Vec<[f64; 3]> = (0..n * n).map(|i| {
                let [u, v] = [f64::from(i % n) - 3.0, f64::from(i / n) - 3.0].map(|c| c * side);
                let wave = 0.1 * (4.0 * waves[0] * u + 4.0 * waves[1] * v + waves[2]).sin();
                (Vector3::from(middle) + first * u + second * v + normal * wave).into()
            }).collect();
            let node = |r: u32, c: u32| r * n + c;
            let squares = (0..n - 1).flat_map(|r| (0..n - 1).map(move |c| (r, c)));
            let triangles = squares.flat_map(|(r, c)| {
                let [a, b, d, e] = [node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1)];
                [[a, b, e], [a, e, d]]
            }).collect();
            let mesh = Mesh::new(&pose(), &points, triangles);
            let (suction, seen) = render(&mesh, resolution);
            let expected = exact(&mesh, resolution as i128);
            prop_assert_eq!(seen.refused, 0);
            let mut found = vec![None; resolution * resolution];
            for spot in suction.pixels_seen() {
                found[spot.at[1] as usize * resolution + spot.at[0] as usize] = Some((spot.triangle, i128::from(spot.depth)));
            }
            for (pixel, (found, expected)) in found.iter().zip(&expected).enumerate() {
                // Of two layers at one depth the first that was drawn stays, in both.
                prop_assert_eq!(found, expected, "pixel {}", pixel);
            }
            let mut plain = PortCamera::new(resolution, &mesh.triangles, points.len()).unwrap().without_simd();
            plain.render(&pose().inverse(), &VIEW, &mesh.surface());
            prop_assert!(plain.pixels_seen().eq(suction.pixels_seen()));
        }
    }
}
