//! What is measured: a wavy sheet that changes every frame, and a forceps pushed through it.

use collision::surface::{self, Surface};
use collision::tool_mesh::{FINE, ToolMesh};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use protocol::handles::Tool;
use validation::exact::tritri::Corner;
use validation::exact::{StaticMesh, on_grid};

/// Squares of a sheet, two triangles each.
#[derive(Debug, Clone, Copy)]
pub struct Squares(pub usize, pub usize);

impl Squares {
    /// Triangles.
    pub fn triangles(self) -> usize {
        2 * self.0 * self.1
    }
}

/// About 1k, 3k, 10k, 100k and 1M triangles.
pub const SIZES: [Squares; 5] =
    [Squares(22, 23), Squares(38, 40), Squares(70, 72), Squares(223, 225), Squares(707, 708)];
/// Side of a square, mm: triangles are as large in every sheet, so that about as many collide.
const SIDE_MM: f32 = 0.08;
/// Jaw opening, rad; it stays, so that the instrument's image does.
const JAW_RAD: f64 = 0.25;
/// Shaft of a 20-gauge instrument, mm.
const RADIUS_MM: f64 = 0.25;
/// Length of the instrument that can collide, mm.
const LENGTH_MM: f64 = 1.5;

/// A slanting pose, eye frame to instrument frame, with the tip so far beyond the sheet, mm.
pub fn pose(beyond_mm: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
    Isometry3::from_parts(Translation3::new(0.03, -0.02, -beyond_mm), turn).inverse()
}

/// A sheet, an instrument, a pose.
pub struct Setting {
    position_mm: [Vec<f32>; 3],
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    alive: Vec<u8>,
    /// Eye frame to instrument frame.
    pub instrument_from_eye: Isometry3<f64>,
    /// The forceps on the grid of the exact tests.
    pub mesh: StaticMesh,
}

/// One frame of a setting.
pub struct Frame<'a> {
    /// The sheet now.
    pub surface: Surface<'a>,
    /// The instrument's pose.
    pub instrument_from_eye: Isometry3<f64>,
    /// The instrument.
    pub mesh: &'a StaticMesh,
}

impl Frame<'_> {
    /// All vertices in the instrument's frame, on the grid of the exact tests: what every peer
    /// works with.
    pub fn on_grid(&self, out: &mut Vec<Corner>) {
        let map = surface::Frame::new(&self.instrument_from_eye);
        let [x, y, z] = self.surface.position_mm;
        let points = x.iter().zip(y).zip(z);
        out.clear();
        out.extend(points.map(|((x, y), z)| on_grid(self.mesh, &map, [*x, *y, *z])));
    }
}

impl Setting {
    /// A sheet of squares around the origin.
    pub fn new(Squares(nx, ny): Squares) -> Self {
        let node = |r: usize, c: usize| (r * (nx + 1) + c) as u32;
        let squares = (0..ny).flat_map(|r| (0..nx).map(move |c| (r, c)));
        let triangles: Vec<[u32; 3]> = squares
            .flat_map(|(r, c)| {
                let [a, b, d, e] = [node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1)];
                [[a, b, e], [a, e, d]]
            })
            .collect();
        let nodes = (0..=ny).flat_map(|r| (0..=nx).map(move |c| (r, c)));
        let at = |i: usize, n: usize| (i as f32 - n as f32 * 0.5) * SIDE_MM;
        let (x, y): (Vec<f32>, Vec<f32>) = nodes.map(|(r, c)| (at(c, nx), at(r, ny))).unzip();
        let facets = ToolMesh::with_detail(Tool::Forceps, RADIUS_MM, LENGTH_MM, FINE).facets(JAW_RAD);
        Setting {
            position_mm: [x.clone(), y, vec![0.0; x.len()]],
            alive: vec![1; triangles.len()],
            triangles,
            instrument_from_eye: pose(0.8),
            mesh: StaticMesh::new(&facets).expect("a forceps is a mesh"),
        }
    }

    /// The shape of the forceps for the image, with the opening at which it is drawn.
    pub fn tool() -> (ToolMesh, f64) {
        (ToolMesh::with_detail(Tool::Forceps, RADIUS_MM, LENGTH_MM, FINE), JAW_RAD)
    }

    /// Vertices.
    pub fn nodes(&self) -> usize {
        self.position_mm[0].len()
    }

    /// Gives every vertex its height in frame `number`: waves that travel.
    pub fn displace(&mut self, number: usize) {
        let phase = number as f32 * 0.7;
        let [x, y, z] = &mut self.position_mm;
        for ((x, y), z) in x.iter().zip(y.iter()).zip(z) {
            *z = 0.06 * ((2.1 * x + phase).sin() + (1.7 * y - phase).cos());
        }
    }

    /// The frame as it stands.
    pub fn frame(&self) -> Frame<'_> {
        let position_mm = self.position_mm.each_ref().map(Vec::as_slice);
        Frame {
            surface: Surface { position_mm, triangles: &self.triangles, alive: &self.alive },
            instrument_from_eye: self.instrument_from_eye,
            mesh: &self.mesh,
        }
    }
}
