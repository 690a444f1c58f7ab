//! The other truth for ZCOLL: rays along the view direction through the pixel centres, met with
//! triangles in exact rational arithmetic (128 bits), written without the product's rasteriser.
//! Also makes the random scenes. Shared by the test and by the example that counts more of them.

use collision::instrument_image::Volume;
use collision::tool_mesh::{PLAIN, ToolMesh};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use protocol::handles::Tool;
use protocol::random::Random;
use std::collections::BTreeMap;

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
    /// A random scene: heights of waves over a jittered grid **in the instrument's frame**, which
    /// makes it π-convex, and then a random pose that takes both to the eye frame.
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

    /// Triangles with corners at the extremes of the number format, seen in the eye frame itself;
    /// all of them lie across the image.
    pub fn extreme(random: &mut Random, resolution: usize) -> Self {
        let mut scene = Scene::random(random, &[resolution]);
        scene.instrument_from_eye = Isometry3::identity();
        let volume = scene.volume;
        let pixel_mm = 2.0 * volume.half_mm / volume.resolution as f64;
        // Just inside 2,048 pixels from the image's edge and 16 depths from the near plane; f32
        // rounds by 1e-4 of a pixel.
        let across = |steps: f64| steps * 2047.9 * pixel_mm - volume.half_mm;
        let deep = |steps: f64| steps * 15.999 * volume.depth_mm + volume.near_mm;
        scene.position_mm = Default::default();
        for _ in 0..72 {
            let at = [1.0, 1.0, -1.0, -1.0, 0.0, random.between(-1.0, 1.0)];
            let [x, y] = [random.one_of(&at), random.one_of(&at)];
            let near = random.between(-0.1, 0.1);
            let z = random.one_of(&[1.0, -1.0, 0.01, 0.02, near]);
            for (axis, value) in scene.position_mm.iter_mut().zip([across(x), across(y), deep(z)]) {
                axis.push(value as f32);
            }
        }
        scene.triangles = (0..24).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        scene.alive = vec![1; 24];
        scene
    }

    /// Makes some corners what no corner should be: not a number, infinite, far away, on top of
    /// each other.
    pub fn spoil(&mut self, random: &mut Random) {
        let nodes = self.position_mm[0].len() as f64;
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -3e4, 1e-40, 0.0, f32::MAX];
        for _ in 0..6 {
            let [node, from, to] = [(); 3].map(|()| random.between(0.0, nodes) as usize);
            self.position_mm[random.between(0.0, 3.0) as usize][node] = random.one_of(&bad);
            self.position_mm.iter_mut().for_each(|p| p[to] = p[from]);
        }
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
        i128::from((f64::from(value * scale + offset + limit + 0.5)).floor() as i64) - limit as i128
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

/// A triangle's depth at a pixel centre, if its ray meets it. A ray through an edge is decided as
/// if it were displaced by (ε, ε²): to the right first, then down.
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

/// All that a look should report.
#[allow(dead_code)] // The example compares vectors only.
#[derive(Debug, Default, PartialEq)]
pub struct Truth {
    /// Vectors.
    pub collisions: Collisions,
    /// Pixels of the instrument that see the membrane more than once.
    pub folded: u32,
    /// Triangles with a corner beyond the format, or that is no number, and not all beyond one
    /// plane of the instrument's box.
    pub refused: u32,
    /// Triangles without area, and not all beyond one plane of the instrument's box.
    pub flat: u32,
}

/// What rays find: for every pixel the nearest membrane in the volume and the nearest instrument,
/// and a collision where the instrument is nearer.
pub fn collisions(scene: &Scene) -> Collisions {
    truth(scene).collisions
}

/// The same, with what is counted.
pub fn truth(scene: &Scene) -> Truth {
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
    compare(scene, End::Handle, &instrument).collisions
}

/// The membrane's corners in steps as the camera at an end sees them, and whether a coordinate is
/// no number.
fn place(scene: &Scene, end: End) -> Vec<(Steps, [bool; 3])> {
    let turn: Matrix3<f32> =
        scene.instrument_from_eye.rotation.to_rotation_matrix().matrix().map(|c| c as f32);
    let tip: Vector3<f32> = scene.instrument_from_eye.inverse().translation.vector.map(|c| c as f32);
    let nodes = 0..scene.position_mm[0].len();
    nodes
        .map(|i| {
            let d: [f32; 3] = std::array::from_fn(|k| scene.position_mm[k][i] - tip[k]);
            let along = |k: usize| turn[(k, 0)] * d[0] + turn[(k, 1)] * d[1] + turn[(k, 2)] * d[2];
            let at = [along(0), along(1), along(2)];
            (steps(scene, end, at), at.map(f32::is_nan))
        })
        .collect()
}

/// Limits of the format, steps.
const LIMITS: Steps = [1 << 19, 1 << 19, 1 << 20];

/// The box around the instrument's pixels and the volume's depth, steps. `None` without instrument.
fn box_of(instrument: &[Option<i128>], resolution: usize) -> Option<[Steps; 2]> {
    let pixels = || instrument.iter().enumerate().filter(|(_, d)| d.is_some()).map(|(pixel, _)| pixel);
    let [columns, rows]: [Vec<usize>; 2] =
        [pixels().map(|p| p % resolution).collect(), pixels().map(|p| p / resolution).collect()];
    let low = |v: &[usize]| v.iter().min().map(|p| *p as i128 * 256);
    let high = |v: &[usize]| v.iter().max().map(|p| (*p as i128 + 1) * 256);
    Some([[low(&columns)?, low(&rows)?, 0], [high(&columns)?, high(&rows)?, 65536]])
}

/// The membrane as the camera at an end sees it, compared with the instrument's depths.
fn compare(scene: &Scene, end: End, instrument: &[Option<i128>]) -> Truth {
    let (resolution, deep) = (scene.volume.resolution, 65536);
    let mut truth = Truth::default();
    let Some([low, high]) = box_of(instrument, resolution) else { return truth };
    let placed = place(scene, end);
    let mut membrane = vec![None; resolution * resolution];
    let mut layers = vec![0; resolution * resolution];
    for (t, nodes) in scene.triangles.iter().enumerate().filter(|(t, _)| scene.alive[*t] != 0) {
        let corners = nodes.map(|n| placed[n as usize]);
        // What is no number lies beyond no plane.
        let all = |beyond: &dyn Fn(i128, usize) -> bool, k: usize| {
            corners.iter().all(|(p, nan)| !nan[k] && beyond(p[k], k))
        };
        if (0..3).any(|k| all(&|p, k| p < low[k], k) || all(&|p, k| p > high[k], k)) {
            continue;
        }
        let fits = |(p, nan): &(Steps, [bool; 3])| (0..3).all(|k| !nan[k] && p[k].abs() < LIMITS[k]);
        if !corners.iter().all(fits) {
            truth.refused += 1;
            continue;
        }
        let [a, b, c] = corners.map(|(p, _)| p);
        truth.flat += u32::from((b[0] - a[0]) * (c[1] - a[1]) == (b[1] - a[1]) * (c[0] - a[0]));
        meet([a, b, c], resolution, |pixel, depth| {
            let nearest: &mut Option<(i128, usize)> = &mut membrane[pixel];
            if (0..=deep).contains(&depth) {
                layers[pixel] += 1;
                if nearest.is_none_or(|old| depth < old.0) {
                    *nearest = Some((depth, t));
                }
            }
        });
    }
    let both = membrane.iter().zip(instrument).enumerate();
    let passed = both.filter_map(|(pixel, pair)| match pair {
        (Some((z_m, t)), Some(z_i)) if z_i < z_m => Some((pixel as u32, (*t as u32, (z_m - z_i) as i32))),
        _ => None,
    });
    truth.collisions = passed.collect();
    truth.folded = layers.iter().zip(instrument).map(|(n, i)| u32::from(*n > 1 && i.is_some())).sum();
    truth
}
