//! Meshes for the tests of this crate.

use crate::surface::Surface;
use nalgebra::Point3;

/// A mesh that owns its arrays.
#[derive(Clone)]
pub struct TestMesh {
    /// x, y and z of the vertices, mm.
    pub position_mm: [Vec<f32>; 3],
    /// Vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// 1 for a living triangle.
    pub alive: Vec<u8>,
}

impl TestMesh {
    /// A grid of `squares` around the z axis, `side_mm` each; `height` gives z at x and y, mm.
    pub fn grid(squares: [u32; 2], side_mm: f32, height: impl Fn(f32, f32) -> f32) -> Self {
        let [columns, rows] = squares.map(|n| n + 1);
        let at = |i: u32, squares: u32| (i as f32 - squares as f32 / 2.0) * side_mm;
        let nodes =
            || (0..columns * rows).map(|i| (at(i % columns, squares[0]), at(i / columns, squares[1])));
        let corners = (0..columns * rows).filter(|i| i % columns < squares[0] && i / columns < squares[1]);
        let halves = |i: u32| [[i, i + 1, i + columns + 1], [i, i + columns + 1, i + columns]];
        let triangles: Vec<[u32; 3]> = corners.flat_map(halves).collect();
        let z = nodes().map(|(x, y)| height(x, y)).collect();
        TestMesh {
            position_mm: [nodes().map(|p| p.0).collect(), nodes().map(|p| p.1).collect(), z],
            alive: vec![1; triangles.len()],
            triangles,
        }
    }

    /// A cap of 6 mm by 4.8 mm of a sphere of 11 mm around the origin, its middle at z = −11 mm:
    /// 1,000 triangles.
    pub fn cap() -> Self {
        Self::grid([25, 20], 0.24, |x, y| -(121.0 - x * x - y * y).sqrt())
    }

    /// Vertices.
    pub fn nodes(&self) -> usize {
        self.position_mm[0].len()
    }

    /// Position of a vertex, mm.
    pub fn position(&self, node: usize) -> Point3<f64> {
        Point3::from([0, 1, 2].map(|axis| f64::from(self.position_mm[axis][node])))
    }

    /// The mesh as the queries take it.
    pub fn surface(&self) -> Surface<'_> {
        let position_mm = self.position_mm.each_ref().map(Vec::as_slice);
        Surface { position_mm, triangles: &self.triangles, alive: &self.alive }
    }
}
