//! The sheet of a scene: nodes in rows on the retina, its middle lifted, joined by structural
//! springs (along rows, columns and one diagonal of each square) and bending springs over two
//! squares.

use super::from_triangles::MeshError;
use super::mesh::{Bend, SheetMesh};
use nalgebra::Vector3;
use scene::{MembraneScene, SceneFile};

/// Rows and columns of the sheet.
#[derive(Clone, Copy)]
struct Grid {
    nx: u32,
    ny: u32,
    /// The last column hangs free.
    loose: bool,
}

impl Grid {
    fn node(self, r: u32, c: u32) -> u32 {
        r * (self.nx + 1) + c
    }
    fn nodes(self) -> u32 {
        (self.nx + 1) * (self.ny + 1)
    }
    fn along_row(self, r: u32, c: u32) -> u32 {
        r * self.nx + c
    }
    fn along_column(self, r: u32, c: u32) -> u32 {
        (self.ny + 1) * self.nx + self.node(r, c)
    }
    fn diagonal(self, r: u32, c: u32) -> u32 {
        (self.ny + 1) * self.nx + self.node(self.ny, 0) + r * self.nx + c
    }
    fn is_rim(self, r: u32, c: u32) -> bool {
        r == 0 || c == 0 || r == self.ny || (c == self.nx && !self.loose)
    }
}

impl SheetMesh {
    /// The sheet of a scene; without nodes where the scene has no membrane. A mesh of the scene's
    /// own may be refused.
    ///
    /// # Errors
    /// If the scene's own mesh cannot be a sheet.
    pub fn new(scene: &SceneFile) -> Result<Self, MeshError> {
        let Some(membrane) = &scene.membrane else { return Ok(Self::default()) };
        match &membrane.mesh {
            Some(mesh) => Self::of_mesh(mesh),
            None => Ok(Self::of_squares(membrane, scene.eye.retina_radius_mm)),
        }
    }

    fn of_squares(m: &MembraneScene, radius_mm: f64) -> Self {
        let [nx, ny] = m.squares;
        let grid = Grid { nx, ny, loose: m.loose_edge };
        let start_mm = start_positions(m, radius_mm, grid);
        let mut sheet = SheetMesh { start_mm, order: (0..grid.nodes()).collect(), ..SheetMesh::default() };
        sheet.add_structural(grid);
        sheet.add_bending(grid);
        sheet.add_triangles(grid);
        let inside = |&(r, c): &(u32, u32)| grid.is_rim(r, c);
        let all = (0..=ny).flat_map(|r| (0..=nx).map(move |c| (r, c)));
        sheet.rim = all.filter(inside).map(|(r, c)| grid.node(r, c)).collect();
        sheet.index();
        sheet
    }

    fn add_run(&mut self, a: u32, b: u32, len: u32) {
        self.springs.extend((0..len).map(|j| [a + j, b + j]));
    }

    fn add_structural(&mut self, g: Grid) {
        for r in 0..=g.ny {
            self.add_run(g.node(r, 0), g.node(r, 1), g.nx);
        }
        self.add_run(g.node(0, 0), g.node(1, 0), g.node(g.ny, 0));
        for r in 0..g.ny {
            self.add_run(g.node(r, 0), g.node(r + 1, 1), g.nx);
        }
        self.structural = self.springs.len();
    }

    fn add_bending(&mut self, g: Grid) {
        for r in 0..=g.ny {
            self.add_run(g.node(r, 0), g.node(r, 2), g.nx - 1);
            self.bends.extend((0..g.nx - 1).map(|c| Bend::Line([g.along_row(r, c), g.along_row(r, c + 1)])));
        }
        self.add_run(g.node(0, 0), g.node(2, 0), g.node(g.ny - 1, 0));
        for r in 0..g.ny - 1 {
            let line = |c| Bend::Line([g.along_column(r, c), g.along_column(r + 1, c)]);
            self.bends.extend((0..=g.nx).map(line));
        }
    }

    fn add_triangles(&mut self, g: Grid) {
        for (r, c) in (0..g.ny).flat_map(|r| (0..g.nx).map(move |c| (r, c))) {
            let (a, b) = (g.node(r, c), g.node(r, c + 1));
            let (d, e) = (g.node(r + 1, c), g.node(r + 1, c + 1));
            self.triangles.extend([[a, b, e], [a, e, d]]);
            let diagonal = g.diagonal(r, c);
            self.triangle_springs.extend([
                [g.along_row(r, c), g.along_column(r, c + 1), diagonal],
                [diagonal, g.along_row(r + 1, c), g.along_column(r, c)],
            ]);
        }
        // Seen from the inside, the normal of a counter-clockwise triangle points to the centre.
        let [a, b, c] = self.triangles[0].map(|n| self.at(n));
        if (b - a).cross(&(c - a)).dot(&a) > 0.0 {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
}

/// Nodes by rows: distances from the middle are kept along the retina (azimuthal equidistant), and
/// the height over the retina is `lift`·(1 − u²)(1 − v²) with u and v from −1 to 1 over the sheet;
/// with a loose edge u runs from −1 to 0, so that the sheet is highest there.
fn start_positions(m: &MembraneScene, radius: f64, g: Grid) -> [Vec<f32>; 3] {
    let towards = Vector3::from(m.towards_in_eye).normalize();
    // Any direction that is not parallel to `towards` gives the first axis of the sheet.
    let seed = if towards.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let e1 = (seed - towards * towards.dot(&seed)).normalize();
    let e2 = towards.cross(&e1);
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    for (r, c) in (0..=g.ny).flat_map(|r| (0..=g.nx).map(move |c| (r, c))) {
        let u = 2.0 * f64::from(c) / f64::from(g.nx) - 1.0;
        let v = 2.0 * f64::from(r) / f64::from(g.ny) - 1.0;
        let flat = e1 * (u * m.size_mm[0] * 0.5) + e2 * (v * m.size_mm[1] * 0.5);
        let way = flat.norm();
        let sideways = if way > 0.0 { flat / way } else { Vector3::zeros() };
        let angle = way / radius;
        let direction = towards * libm::cos(angle) + sideways * libm::sin(angle);
        let rise = if g.loose { (u - 1.0) * 0.5 } else { u };
        let height = if g.is_rim(r, c) { 0.0 } else { m.lift_mm * (1.0 - rise * rise) * (1.0 - v * v) };
        let p = direction * (radius - height);
        (0..3).for_each(|axis| out[axis].push(p[axis] as f32));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet() -> SheetMesh {
        SheetMesh::new(&SceneFile::load("peel").unwrap()).unwrap()
    }

    #[test]
    fn shipped_sheet_has_the_size_of_the_papers_table_4() {
        let s = sheet();
        assert_eq!((s.triangles.len(), s.structural, s.nodes()), (1000, 1545, 546));
        assert_eq!(s.springs.len() - s.structural, s.bends.len());
    }

    #[test]
    fn a_loose_edge_is_no_rim_and_the_highest() {
        let mut scene = SceneFile::load("peel").unwrap();
        scene.membrane.as_mut().unwrap().loose_edge = true;
        let (whole, loose) = (sheet(), SheetMesh::new(&scene).unwrap());
        assert_eq!(whole.rim.len() - loose.rim.len(), 19, "20 squares along the edge, without the corners");
        let height = |n: u32| 11.5 - loose.at(n).norm();
        let highest = (0..loose.nodes() as u32).max_by(|&a, &b| height(a).total_cmp(&height(b))).unwrap();
        assert_eq!(highest % 26, 25, "in the last column");
        assert!((height(highest) - 0.5).abs() < 1e-3);
    }

    #[test]
    fn springs_of_a_triangle_join_its_nodes() {
        let s = sheet();
        for (nodes, springs) in s.triangles.iter().zip(&s.triangle_springs) {
            for &spring in springs {
                assert!(s.springs[spring as usize].iter().all(|n| nodes.contains(n)));
            }
        }
        for (bend, line) in s.springs[s.structural..].iter().zip(&s.bends) {
            let &Bend::Line([a, b]) = line else { panic!("the sheet of a scene bends along lines") };
            let ([p, q], [r, t]) = (s.springs[a as usize], s.springs[b as usize]);
            assert_eq!((q, [p, t]), (r, *bend), "a bending spring spans two structural ones in line");
        }
    }

    #[test]
    fn triangles_face_the_inside_and_nodes_stay_before_the_retina() {
        let s = sheet();
        for t in &s.triangles {
            let [a, b, c] = t.map(|n| s.at(n));
            assert!((b - a).cross(&(c - a)).dot(&a) < 0.0);
        }
        assert!((0..s.nodes() as u32).all(|n| s.at(n).norm() < 11.5 + 1e-5));
        assert!(s.rim.iter().all(|&n| (s.at(n).norm() - 11.5).abs() < 1e-5));
    }
}
