//! The other truth for ZCOLL: rays along the view direction through the pixel centres, met with triangles in exact rational
//! arithmetic (128 bits), written without the product's rasteriser. Also makes the random scenes. Shared by the test and
//! by the example that counts more of them.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use protocol::handles::Tool;
use simcore::collision::instrument_image::Volume;
use simcore::collision::tool_mesh::{PLAIN, ToolMesh};
use std::collections::BTreeMap;

/// SplitMix64 (Steele, Lea and Flood 2014): a stream of random numbers from a seed.
pub struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Evenly between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// One of several.
    pub fn one_of<T: Copy>(&mut self, of: &[T]) -> T {
        of[(self.next() % of.len() as u64) as usize]
    }
}

/// A membrane that each line of view meets at most once, and an instrument in it.
pub struct Scene {
    /// Vertices, eye frame, mm.
    pub position_mm: [Vec<f32>; 3],
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
    /// 0 where torn out.
    pub alive: Vec<u8>,
    /// Pose of the instrument.
    pub instrument_from_eye: Isometry3<f64>,
    /// Volume and resolution.
    pub volume: Volume,
    /// Shape.
    pub tool: Tool,
    /// Opening, rad; a multiple of the step in which images are drawn.
    pub jaw_rad: f64,
}

/// Shaft radius of the scenes, mm.
pub const RADIUS_MM: f64 = 0.25;

impl Scene {
    /// A random scene: heights of waves over a jittered grid **in the instrument's frame**, which makes it π-convex, and then a
    /// random pose that takes both to the eye frame.
    pub fn random(random: &mut Random, resolutions: &[usize]) -> Self {
        let side = random.between(0.04, 0.25);
        let n = ((1.8 / side) as usize).clamp(4, 40);
        let mut r = |low: f64, high: f64| random.between(low, high);
        let middle = [r(-0.3, 0.3), r(-0.3, 0.3), r(-0.1, 0.7)];
        let slope = [r(-0.8, 0.8), r(-0.8, 0.8)];
        let waves: Vec<[f64; 4]> =
            (0..3).map(|_| [r(0.0, 0.12), r(-5.0, 5.0), r(-5.0, 5.0), r(0.0, 6.3)]).collect();
        let angles = [r(-3.1, 3.1), r(-1.5, 1.5), r(-3.1, 3.1)];
        let turn = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        let tip = Translation3::new(r(-12.0, 12.0), r(-12.0, 12.0), r(-12.0, 12.0));
        let eye_from_instrument = Isometry3::from_parts(tip, turn);
        let mut position_mm: [Vec<f32>; 3] = Default::default();
        for (row, column) in (0..=n).flat_map(|row| (0..=n).map(move |column| (row, column))) {
            let at = |i: usize| (i as f64 - n as f64 * 0.5) * side;
            let x = middle[0] + at(column) + r(-0.25, 0.25) * side;
            let y = middle[1] + at(row) + r(-0.25, 0.25) * side;
            let wave = |[a, u, v, phase]: &[f64; 4]| a * (u * x + v * y + phase).sin();
            let z = middle[2] + slope[0] * x + slope[1] * y + waves.iter().map(wave).sum::<f64>();
            let p = eye_from_instrument * Point3::new(x, y, z);
            (0..3).for_each(|k| position_mm[k].push(p[k] as f32));
        }
        let node = |row: usize, column: usize| (row * (n + 1) + column) as u32;
        let squares = (0..n).flat_map(|row| (0..n).map(move |column| (row, column)));
        let triangles: Vec<[u32; 3]> = squares
            .flat_map(|(r, c)| {
                let [a, b, d, e] = [node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1)];
                [[a, b, e], [a, e, d]]
            })
            .collect();
        let alive = triangles.iter().map(|_| u8::from(r(0.0, 1.0) > 0.02)).collect();
        let jaw_rad = 0.01 * r(0.0, 60.0).floor();
        let tool = random.one_of(&[Tool::Forceps, Tool::Forceps, Tool::LightPipe]);
        let resolution = random.one_of(resolutions);
        let volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution };
        let instrument_from_eye = eye_from_instrument.inverse();
        Scene { position_mm, triangles, alive, instrument_from_eye, volume, tool, jaw_rad }
    }

    /// The instrument's triangles, in its frame.
    pub fn facets(&self) -> Vec<[[f64; 3]; 3]> {
        ToolMesh::with_detail(self.tool, RADIUS_MM, self.volume.depth_mm, PLAIN).facets(self.jaw_rad)
    }
}

/// Whole steps: 1/256 pixel, 1/256 pixel, 1/65536 of the depth.
type Steps = [i128; 3];

/// Which end of the instrument the camera is at.
#[derive(Clone, Copy, PartialEq)]
enum End {
    Tip,
    Handle,
}

/// The documented rounding: value · scale + offset in `f32`, then halves up after adding the limit.
fn steps(scene: &Scene, end: End, [x, y, z]: [f32; 3]) -> Steps {
    let v = &scene.volume;
    let across = (v.resolution as f64 * 256.0 / (2.0 * v.half_mm)) as f32;
    let middle = (v.resolution as f64 * 128.0) as f32;
    let deep = 65536.0 / v.depth_mm;
    let round = |value: f32, scale: f32, offset: f32, limit: f32| {
        i128::from((f64::from(value * scale + offset + limit + 0.5)).floor() as i64 - limit as i64)
    };
    [
        round(x, across, middle, 524_288.0),
        round(y, across, middle, 524_288.0),
        match end {
            End::Tip => round(z, deep as f32, (-v.near_mm * deep) as f32, 1_048_576.0),
            End::Handle => round(z, -deep as f32, ((v.near_mm + v.depth_mm) * deep) as f32, 1_048_576.0),
        },
    ]
}

/// A triangle's depth at a pixel centre, if its ray meets it. A ray through an edge is decided as if it were displaced by
/// (ε, ε²): to the right first, then down.
fn depth_at([a, mut b, mut c]: [Steps; 3], column: i128, row: i128) -> Option<i128> {
    let (x, y) = (column * 256 + 128, row * 256 + 128);
    let area = |p: Steps, q: Steps, x: i128, y: i128| (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]);
    let mut whole = area(a, b, c[0], c[1]);
    if whole == 0 {
        return None;
    }
    if whole < 0 {
        (b, c, whole) = (c, b, -whole);
    }
    let mut sum = 0;
    for (p, q, opposite) in [(b, c, a), (c, a, b), (a, b, c)] {
        let e = area(p, q, x, y);
        // Derivatives along x and y decide where the value does not.
        let side = [e, p[1] - q[1], q[0] - p[0]].into_iter().find(|s| *s != 0).unwrap_or(0);
        if side < 0 {
            return None;
        }
        sum += e * opposite[2];
    }
    Some(sum.div_euclid(whole))
}

/// Calls `met(pixel, depth)` for every ray that meets the triangle.
fn meet(corners: [Steps; 3], resolution: usize, mut met: impl FnMut(usize, i128)) {
    let pixels = |k: usize| {
        let (low, high) = (corners.iter().map(|c| c[k]).min(), corners.iter().map(|c| c[k]).max());
        let within = |p: i128| p.clamp(0, resolution as i128) as usize;
        within(low.unwrap_or(0).div_euclid(256) - 1)..within(high.unwrap_or(0).div_euclid(256) + 2)
    };
    for row in pixels(1) {
        for column in pixels(0) {
            if let Some(depth) = depth_at(corners, column as i128, row as i128) {
                met(row * resolution + column, depth);
            }
        }
    }
}

/// Colliding pixels: triangle seen there and length of its vector, steps.
pub type Collisions = BTreeMap<u32, (u32, i32)>;

/// What rays find: for every pixel the nearest membrane in the volume and the nearest instrument, and a collision where the
/// instrument is nearer.
pub fn collisions(scene: &Scene) -> Collisions {
    let (resolution, deep) = (scene.volume.resolution, 65536);
    let mut instrument = vec![None; resolution * resolution];
    for facet in scene.facets() {
        let corners = facet.map(|p| steps(scene, End::Tip, p.map(|c| c as f32)));
        meet(corners, resolution, |pixel, depth| {
            if depth <= deep {
                let depth = depth.max(0);
                let nearest: &mut Option<i128> = &mut instrument[pixel];
                *nearest = Some(nearest.map_or(depth, |old| old.min(depth)));
            }
        });
    }
    compare(scene, End::Tip, &instrument)
}

/// The same from the handle: hook and jaws alone, and only where they end inside the volume.
pub fn collisions_back(scene: &Scene) -> Collisions {
    let (resolution, deep) = (scene.volume.resolution, 65536);
    let mut nearest = vec![None; resolution * resolution];
    let mesh = ToolMesh::with_detail(scene.tool, RADIUS_MM, scene.volume.depth_mm, PLAIN);
    mesh.for_each_aside(scene.jaw_rad, |facet| {
        let corners = facet.map(|p| steps(scene, End::Handle, p.map(|c| c as f32)));
        meet(corners, resolution, |pixel, depth| {
            if depth <= deep {
                nearest[pixel] = Some(nearest[pixel].map_or(depth, |old: i128| old.min(depth)));
            }
        });
    });
    let instrument: Vec<_> = nearest.into_iter().map(|d| d.filter(|d| *d >= 0)).collect();
    compare(scene, End::Handle, &instrument)
}

/// The membrane as the camera at an end sees it, compared with the instrument's depths.
fn compare(scene: &Scene, end: End, instrument: &[Option<i128>]) -> Collisions {
    let (resolution, deep) = (scene.volume.resolution, 65536);
    let turn: Matrix3<f32> =
        scene.instrument_from_eye.rotation.to_rotation_matrix().matrix().map(|c| c as f32);
    let tip: Vector3<f32> = scene.instrument_from_eye.inverse().translation.vector.map(|c| c as f32);
    let placed: Vec<Steps> = (0..scene.position_mm[0].len())
        .map(|i| {
            let d: [f32; 3] = std::array::from_fn(|k| scene.position_mm[k][i] - tip[k]);
            let along = |k: usize| turn[(k, 0)] * d[0] + turn[(k, 1)] * d[1] + turn[(k, 2)] * d[2];
            steps(scene, end, [along(0), along(1), along(2)])
        })
        .collect();
    let mut membrane = vec![None; resolution * resolution];
    for (t, nodes) in scene.triangles.iter().enumerate().filter(|(t, _)| scene.alive[*t] != 0) {
        meet(nodes.map(|n| placed[n as usize]), resolution, |pixel, depth| {
            let nearest: &mut Option<(i128, usize)> = &mut membrane[pixel];
            if (0..=deep).contains(&depth) && nearest.is_none_or(|old| depth < old.0) {
                *nearest = Some((depth, t));
            }
        });
    }
    let both = membrane.iter().zip(instrument).enumerate();
    both.filter_map(|(pixel, pair)| match pair {
        (Some((z_m, t)), Some(z_i)) if z_i < z_m => Some((pixel as u32, (*t as u32, (z_m - z_i) as i32))),
        _ => None,
    })
    .collect()
}
