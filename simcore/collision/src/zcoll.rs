//! ZCOLL: image-based collision of an instrument with the membrane (paper, section 3.3).
//!
//! An orthographic camera is fixed to the instrument. It sits on the shaft's axis beyond the tip
//! and looks back along the instrument's +z; x and y of the image are those of the instrument,
//! depth grows towards the handle. The volume is a box of half width h, from the near plane (a
//! sixth of its depth beyond the tip) to the far plane. Two images: the depth z_I of the
//! instrument, which depends only on the jaw opening and is therefore kept until that changes; and
//! depth z_M and triangle ID of the membrane. A pixel that has both and z_I < z_M is a collision:
//! the instrument has passed the membrane there by d = (z_I − z_M)·ẑ, a vector away from the
//! handle.
//!
//! Node displacement is the paper's Eq. 1: over the set D_i of all vectors of the triangles around
//! node i, length max |d| and direction that of the sum. All vectors of one view point along −ẑ, so
//! that direction is −ẑ and the length of each node is all that is computed here.
//!
//! An instrument that came round an edge is under the membrane. Then the camera is reversed
//! ([`Zcoll::query_reversed`]): it sits at the handle, looks along −z and sees what reaches beside
//! the shaft (hook, jaws); vectors point along +ẑ and lift.
//!
//! The membrane must meet each line of view at most once inside the volume (π-convex); pixels that
//! see a second layer are counted. Instrument depth is clamped at the near plane; membrane outside
//! the volume is not drawn. Only pixels that have instrument are drawn, because others never
//! collide. Images are drawn in integers ([`super::raster`]), so that any other back end can give
//! the same answer to the bit.

mod adapter;
mod canvas;
mod vertices;

#[cfg(feature = "gpu")]
use super::gpu::GpuZcoll;
use super::instrument_image::{InstrumentImage, NOTHING, Side, Volume};
use super::quantize::{QuantizedVertex, Quantizer};
use super::raster::{DEPTH_STEPS, SUBPIXELS, XY_LIMIT, Z_LIMIT};
use super::surface::{CollisionError, Cull, Frame, Surface};
use canvas::Canvas;
use nalgebra::Isometry3;

/// What a look found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Contacts {
    /// Colliding pixels.
    pub pixels: u32,
    /// Deepest collision, depth steps.
    pub deepest: i32,
    /// Pixels that saw the membrane more than once.
    pub folded: u32,
    /// Triangles too large for the image's number format, or with a corner that is not a number.
    pub refused: u32,
    /// Triangles in the volume without area in the image: degenerate, or seen from their edge.
    pub flat: u32,
}

/// A colliding pixel: one deformation vector of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelContact {
    /// Row · resolution + column.
    pub pixel: u32,
    /// The triangle seen there.
    pub triangle: u32,
    /// Length of the vector, depth steps; it points along −ẑ of the instrument.
    pub depth: i32,
}

/// A part of a look, as in the paper's Table 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The membrane was drawn: its depth and its triangles' numbers.
    Drawn,
    /// Depths were compared: pixels, triangles and their deformation vectors.
    Compared,
    /// Nodes have their displacements.
    Retrieved,
}

/// Pixels around the instrument by which the first cull is wider than the exact one.
const CULL_MARGIN: f32 = 2.0;

/// Images and lists of a look; one serves all instruments.
#[derive(Debug)]
pub struct Zcoll {
    volume: Volume,
    cull: Cull,
    canvas: Canvas,
    hits: Vec<PixelContact>,
    triangle_depth: Vec<i32>,
    node_depth: Vec<i32>,
    triangles: Vec<u32>,
    nodes: Vec<u32>,
    vertex_hits: Vec<(u32, i32)>,
    /// Looks in place of all this, where there is one.
    #[cfg(feature = "gpu")]
    gpu: Option<Box<GpuZcoll>>,
    /// Pose of the last look, and whether it was one from the handle.
    looked: (Isometry3<f64>, bool),
}

impl Zcoll {
    /// Images of a volume, lists for a membrane of these triangles between so many nodes.
    pub fn new(volume: Volume, triangles: &[[u32; 3]], nodes: usize) -> Result<Self, CollisionError> {
        volume.check()?;
        let pixels = volume.resolution * volume.resolution;
        Ok(Zcoll {
            volume,
            cull: Cull::new(triangles, nodes)?,
            canvas: Canvas {
                resolution: volume.resolution,
                vertex: vec![QuantizedVertex::default(); nodes],
                depth: vec![NOTHING; pixels],
                id: vec![0; pixels],
                second: vec![0; pixels],
            },
            hits: Vec::with_capacity(pixels),
            triangle_depth: vec![0; triangles.len()],
            node_depth: vec![0; nodes],
            triangles: Vec::with_capacity(pixels.min(triangles.len())),
            nodes: Vec::with_capacity(nodes.min(3 * pixels)),
            vertex_hits: Vec::with_capacity(nodes),
            #[cfg(feature = "gpu")]
            gpu: None,
            looked: (Isometry3::identity(), false),
        })
    }

    /// Uses the base instruction set only: for the proof that every path gives the same bits.
    pub fn without_simd(mut self) -> Self {
        self.cull = self.cull.without_simd();
        self
    }

    /// The volume.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// Looks where the instrument has passed the membrane. Afterwards [`Self::displaced`] lists the
    /// nodes, [`Self::hits`] the deformation vectors and [`Self::triangles`] the triangles.
    pub fn query(
        &mut self,
        image: &InstrumentImage,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Contacts {
        self.query_side(&image.ahead(), instrument_from_eye, surface, &mut |_| {})
    }

    /// As [`Self::query`]; calls `ended` at the end of each part, so that a caller can time them. On an adapter the
    /// parts are not apart, and nothing is called.
    pub fn query_in_parts(
        &mut self,
        image: &InstrumentImage,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
        ended: &mut impl FnMut(Part),
    ) -> Contacts {
        self.query_side(&image.ahead(), instrument_from_eye, surface, ended)
    }

    /// The same from the handle: where hook or jaws of an instrument **under** the membrane have
    /// come up through it. Depth grows towards the tip, and all vectors point along +ẑ: they lift.
    pub fn query_reversed(
        &mut self,
        image: &InstrumentImage,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Contacts {
        self.query_side(&image.back(), instrument_from_eye, surface, &mut |_| {})
    }

    fn query_side(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
        ended: &mut impl FnMut(Part),
    ) -> Contacts {
        self.clear();
        self.looked = (*instrument_from_eye, side.reversed);
        let mut found = Contacts::default();
        if side.rect.is_empty() {
            return found;
        }
        #[cfg(feature = "gpu")]
        if let Some(found) = self.query_gpu(side, instrument_from_eye, surface) {
            return found;
        }
        self.draw_membrane(side, instrument_from_eye, surface, &mut found);
        ended(Part::Drawn);
        self.compare(side, &mut found);
        ended(Part::Compared);
        self.spread_to_nodes(surface.triangles);
        ended(Part::Retrieved);
        found
    }

    /// Whether the instrument has passed the membrane anywhere, and nothing else.
    pub fn touches(
        &mut self,
        image: &InstrumentImage,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> bool {
        self.clear();
        if image.rect.is_empty() {
            return false;
        }
        #[cfg(feature = "gpu")]
        if let Some(touches) = self.ask_gpu(|gpu| gpu.touches(&image.ahead(), instrument_from_eye, surface)) {
            return touches;
        }
        let side = image.ahead();
        self.draw_membrane(&side, instrument_from_eye, surface, &mut Contacts::default());
        self.canvas.rows(&side).any(|(_, z_m, z_i)| z_m.iter().zip(z_i).any(|(m, i)| *m != NOTHING && i < m))
    }

    /// Nodes to be moved along −ẑ of the instrument, each with its depth in depth steps (Eq. 1).
    pub fn displaced(&self) -> impl Iterator<Item = (usize, i32)> + '_ {
        self.nodes.iter().map(|&n| (n as usize, self.node_depth[n as usize]))
    }

    /// The deformation vectors of the last look, by pixel.
    pub fn hits(&self) -> &[PixelContact] {
        &self.hits
    }

    /// Colliding triangles of the last look, each with the longest of its vectors in depth steps.
    pub fn triangles(&self) -> impl Iterator<Item = (usize, i32)> + '_ {
        self.triangles.iter().map(|&t| (t as usize, self.triangle_depth[t as usize]))
    }

    /// Clears what the last look wrote, and only that.
    fn clear(&mut self) {
        self.hits.clear();
        self.triangles.drain(..).for_each(|t| self.triangle_depth[t as usize] = 0);
        self.nodes.drain(..).for_each(|n| self.node_depth[n as usize] = 0);
    }

    fn draw_membrane(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
        found: &mut Contacts,
    ) {
        self.canvas.clear(side.rect);
        let frame = Frame::new(instrument_from_eye);
        let [low, high] = self.volume.box_around(side.rect, CULL_MARGIN);
        self.cull.classify(surface, &frame, low, high);
        let placing = placing(frame, &self.volume, side);
        let simd = self.cull.simd();
        self.cull.for_each_survivor(
            surface.triangles.len(),
            &mut (&mut self.canvas, found),
            |(canvas, _), block| placing.block(simd, surface, block, &mut canvas.vertex),
            |(canvas, found), from, to| canvas.draw(side, surface, from..to, found),
        );
    }

    /// Colliding pixels give their triangles the deepest of their vectors.
    fn compare(&mut self, side: &Side, found: &mut Contacts) {
        for (first, z_m, z_i) in self.canvas.rows(side) {
            for (i, (&z_m, &z_i)) in z_m.iter().zip(z_i).enumerate() {
                if z_m == NOTHING || z_i >= z_m {
                    continue;
                }
                let pixel = first + i;
                let (depth, triangle) = (z_m - z_i, self.canvas.id[pixel]);
                self.hits.push(PixelContact { pixel: pixel as u32, triangle, depth });
                found.deepest = found.deepest.max(depth);
                let deepest = &mut self.triangle_depth[triangle as usize];
                if *deepest == 0 {
                    self.triangles.push(triangle);
                }
                *deepest = (*deepest).max(depth);
            }
        }
        found.pixels = self.hits.len() as u32;
    }

    /// Eq. 1: each node takes the largest vector of the triangles around it.
    fn spread_to_nodes(&mut self, triangles: &[[u32; 3]]) {
        for &t in &self.triangles {
            for &node in &triangles[t as usize] {
                let depth = &mut self.node_depth[node as usize];
                if *depth == 0 {
                    self.nodes.push(node);
                }
                *depth = (*depth).max(self.triangle_depth[t as usize]);
            }
        }
    }
}

/// How a look maps the eye to the image.
fn placing(frame: Frame, volume: &Volume, side: &Side) -> Quantizer {
    let [low, high] = [side.rect.min, side.rect.max].map(|p| p.map(|p| p * SUBPIXELS));
    let [xy, ahead] = volume.format();
    let z = if side.reversed { volume.format_back() } else { ahead };
    Quantizer {
        frame,
        format: [xy, xy, z],
        limit: [XY_LIMIT, XY_LIMIT, Z_LIMIT],
        low: [low[0], low[1], 0],
        high: [high[0], high[1], DEPTH_STEPS],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_mesh::TestMesh;
    use nalgebra::{Point3, Translation3, UnitQuaternion};
    use protocol::handles::Tool;
    use scene::SceneFile;

    struct Setting {
        mesh: TestMesh,
        zcoll: Zcoll,
        light: InstrumentImage,
    }

    fn setting() -> Setting {
        let scene = SceneFile::load("peel").unwrap();
        let mesh = TestMesh::cap();
        let volume = Volume::new(&scene.contact);
        Setting {
            zcoll: Zcoll::new(volume, &mesh.triangles, mesh.nodes()).unwrap(),
            light: InstrumentImage::new(Tool::LightPipe, 0.25, &volume),
            mesh,
        }
    }

    /// `eye_from_instrument` with the handle straight up and the tip over the middle of the sheet.
    fn upright(z_mm: f64) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(0.03, 0.02, z_mm), UnitQuaternion::identity())
    }

    fn look(s: &mut Setting, eye_from_instrument: &Isometry3<f64>) -> Contacts {
        s.light.prepare(0.0, s.zcoll.volume());
        s.zcoll.query(&s.light, &eye_from_instrument.inverse(), &s.mesh.surface())
    }

    #[test]
    fn a_tip_over_the_membrane_does_not_collide() {
        let mut s = setting();
        assert_eq!(look(&mut s, &upright(-10.9)), Contacts::default());
        assert_eq!(s.zcoll.displaced().count(), 0);
    }

    #[test]
    fn depth_is_how_far_the_tip_has_passed() {
        let mut s = setting();
        let top = (0..s.mesh.nodes()).map(|i| s.mesh.position(i).z).filter(|z| *z > -11.01).count();
        assert!(top > 0, "the middle of the sheet is 11 mm deep");
        let found = look(&mut s, &upright(-11.1));
        let deepest = s.zcoll.volume.depth_steps_mm(found.deepest);
        assert!((deepest - 0.1).abs() < 0.01, "{deepest}");
        assert_eq!((found.folded, found.refused), (0, 0));
        // The flat end of the shaft has an area of π·0.25² mm²; a pixel is 1.5/32 mm wide.
        let expected = std::f64::consts::PI * 0.0625 / (1.5f64 / 32.0).powi(2);
        assert!((f64::from(found.pixels) - expected).abs() < 12.0, "{} {expected}", found.pixels);
    }

    #[test]
    fn displacement_brings_the_membrane_clear_of_the_tip() {
        let mut s = setting();
        let pose = upright(-11.1);
        look(&mut s, &pose);
        let moves: Vec<_> = s.zcoll.displaced().collect();
        for (node, steps) in moves {
            let depth = s.zcoll.volume.depth_steps_mm(steps) as f32;
            s.mesh.position_mm[2][node] -= depth;
        }
        let again = look(&mut s, &pose);
        assert!(again.deepest <= 2, "rounding only: {}", again.deepest);
    }

    /// The paper's own test of the method: compare with exact geometry, sample by sample.
    #[test]
    fn hits_agree_with_exact_rays() {
        let mut s = setting();
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
        let pose = Isometry3::from_parts(Translation3::new(0.4, -0.3, -11.15), turn);
        let found = look(&mut s, &pose);
        let nodes: Vec<Point3<f64>> =
            (0..s.mesh.nodes()).map(|i| pose.inverse() * s.mesh.position(i)).collect();
        let pixel_mm = 1.5 / 32.0;
        let mut hits = 0u32;
        for (row, column) in (0..32).flat_map(|r| (0..32).map(move |c| (r, c))) {
            let x = (f64::from(column) + 0.5) * pixel_mm - 0.75;
            let y = (f64::from(row) + 0.5) * pixel_mm - 0.75;
            // A 16-sided prism of radius 0.25 around z, its end at z = 0.
            let side = |i: i32| (f64::from(i) + 0.5) / 16.0 * std::f64::consts::TAU;
            let apothem = 0.25 * (std::f64::consts::PI / 16.0).cos();
            let inside = (0..16).all(|i| x * side(i).cos() + y * side(i).sin() <= apothem);
            let passed = s.mesh.triangles.iter().any(|t| {
                let [a, b, c] = t.map(|n| nodes[n as usize]);
                let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
                let w1 = ((x - a.x) * (c.y - a.y) - (y - a.y) * (c.x - a.x)) / area;
                let w2 = ((b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x)) / area;
                let z = a.z + w1 * (b.z - a.z) + w2 * (c.z - a.z);
                w1 >= 0.0 && w2 >= 0.0 && w1 + w2 <= 1.0 && z > 0.0 && z < 1.25
            });
            hits += u32::from(inside && passed);
        }
        assert!(hits > 40, "the test must see something: {hits}");
        assert!(found.pixels.abs_diff(hits) <= 3, "{} {hits}", found.pixels);
    }

    #[test]
    fn the_order_of_triangles_does_not_matter() {
        let mut s = setting();
        let pose = upright(-11.1);
        let first = look(&mut s, &pose);
        let mut nodes: Vec<_> = s.zcoll.displaced().collect();
        nodes.sort_unstable();
        s.mesh.triangles.reverse();
        s.zcoll = Zcoll::new(*s.zcoll.volume(), &s.mesh.triangles, s.mesh.nodes()).unwrap();
        assert_eq!(look(&mut s, &pose), first);
        let mut again: Vec<_> = s.zcoll.displaced().collect();
        again.sort_unstable();
        assert_eq!(nodes, again);
    }

    #[test]
    fn a_fold_is_counted() {
        let mut s = setting();
        // Fold one half of the sheet over the other, a little above it.
        for i in 0..s.mesh.nodes() {
            if s.mesh.position_mm[0][i] > 0.3 {
                s.mesh.position_mm[0][i] = 0.6 - s.mesh.position_mm[0][i];
                s.mesh.position_mm[2][i] += 0.15;
            }
        }
        assert!(look(&mut s, &upright(-11.1)).folded > 0);
    }

    /// Hook down, a pick is under two layers; the camera at the handle sees both.
    #[test]
    fn a_fold_is_counted_from_the_handle_too() {
        let mut s = setting();
        let mut pick = InstrumentImage::new(Tool::Pick, 0.25, s.zcoll.volume());
        pick.prepare(0.0, s.zcoll.volume());
        let (pose, half) = (upright(-11.1).inverse(), s.zcoll.volume.half_mm);
        let single = s.zcoll.query_reversed(&pick, &pose, &s.mesh.surface());
        assert!(single.pixels > 0 && single.folded == 0, "{single:?}");
        // The half beyond the middle of the hook over the other half, a little higher.
        let middle = 0.33f32;
        for n in 0..s.mesh.nodes() {
            if s.mesh.position_mm[0][n] > middle {
                s.mesh.position_mm[0][n] = 2.0 * middle - s.mesh.position_mm[0][n];
                s.mesh.position_mm[2][n] += 0.05;
            }
        }
        let found = s.zcoll.query_reversed(&pick, &pose, &s.mesh.surface());
        // Pixels of the hook before the fold, by their centres; the fold may run through a column
        // of them.
        let width = 2.0 * half / s.zcoll.volume.resolution as f64;
        let seen = |column: usize| (column as f64 + 0.5) * width - half + 0.03 < f64::from(middle) - width;
        let resolution = s.zcoll.volume.resolution;
        let hooks = pick.back().depth.iter().enumerate().filter(|(_, z)| **z != NOTHING);
        let under_both = hooks.filter(|(pixel, _)| seen(pixel % resolution)).count();
        assert!(
            under_both > 5 && found.folded as usize >= under_both,
            "{found:?}, {under_both} pixels under both"
        );
    }
}
