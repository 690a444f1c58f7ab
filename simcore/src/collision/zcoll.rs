//! ZCOLL: image-based collision of an instrument with the membrane (paper, section 3.3).
//!
//! An orthographic camera is fixed to the instrument. It sits on the shaft's axis beyond the tip and looks
//! back along the instrument's +z; x and y of the image are those of the instrument, depth grows
//! towards the handle. The volume is a box of half width h, from the near plane (a sixth of its depth
//! beyond the tip) to the far plane. Two images: the depth z_I of the instrument, which depends only on
//! the jaw opening and is therefore kept until that changes; and depth z_M and triangle ID of the membrane. A pixel
//! that has both and z_I < z_M is a collision: the instrument has passed the membrane there by
//! d = (z_I − z_M)·ẑ, a vector away from the handle.
//!
//! Node displacement is the paper's Eq. 1: over the set D_i of all vectors of the triangles around node
//! i, length max |d| and direction that of the sum. All vectors of one view point along −ẑ, so that
//! direction is −ẑ and the length of each node is all that is computed here.
//!
//! The membrane must meet each line of view at most once inside the volume (π-convex); pixels that see
//! a second layer are counted. Instrument depth is clamped at the near plane; membrane outside the volume
//! is not drawn. Only pixels that have instrument are drawn, because others never collide. Images are drawn in
//! integers ([`super::raster`]), so that any other back end can give the same answer to the bit.

use super::instrument_image::{InstrumentImage, NOTHING, Volume, to_fixed};
use super::raster::{self, DEPTH_STEPS, Fixed, Rect, SUBPIXELS, XY_LIMIT, Z_LIMIT};
use crate::membrane::sheet::Sheet;
use crate::state::MembraneState;
use nalgebra::{Isometry3, Matrix3, Vector3};
use protocol::scene::NODE_DEAD;

/// What a look found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Found {
    /// Colliding pixels.
    pub pixels: u32,
    /// Deepest collision, depth steps.
    pub deepest: i32,
    /// Pixels that saw the membrane more than once.
    pub folded: u32,
    /// Triangles too large for the image's number format.
    pub refused: u32,
}

/// Which planes of the volume a vertex lies beyond.
mod outside {
    pub const LEFT: u8 = 1;
    pub const RIGHT: u8 = 2;
    pub const ABOVE: u8 = 4;
    pub const BELOW: u8 = 8;
    pub const NEAR: u8 = 16;
    pub const FAR: u8 = 32;
    /// Beyond the number format.
    pub const FORMAT: u8 = 64;
    pub const PLANES: u8 = LEFT | RIGHT | ABOVE | BELOW | NEAR | FAR;
}

/// Images and lists of a look; one serves all instruments.
#[derive(Debug)]
pub struct Zcoll {
    volume: Volume,
    vertex: [Vec<i32>; 3],
    outcode: Vec<u8>,
    depth: Vec<i32>,
    id: Vec<u32>,
    second: Vec<u8>,
    triangle_depth: Vec<i32>,
    node_depth: Vec<i32>,
    triangles: Vec<u32>,
    nodes: Vec<u32>,
}

impl Zcoll {
    /// Images of a volume, lists for a sheet.
    pub fn new(volume: Volume, sheet: &Sheet) -> Self {
        let (pixels, nodes) = (volume.resolution * volume.resolution, sheet.nodes());
        Zcoll {
            volume,
            vertex: std::array::from_fn(|_| vec![0; nodes]),
            outcode: vec![0; nodes],
            depth: vec![NOTHING; pixels],
            id: vec![0; pixels],
            second: vec![0; pixels],
            triangle_depth: vec![0; sheet.triangles.len()],
            node_depth: vec![0; nodes],
            triangles: Vec::with_capacity(pixels.min(sheet.triangles.len())),
            nodes: Vec::with_capacity(nodes),
        }
    }

    /// The volume.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// Looks where the instrument has passed the membrane. Afterwards [`Self::displaced`] lists the nodes.
    pub fn look(
        &mut self,
        image: &InstrumentImage,
        instrument_from_eye: &Isometry3<f64>,
        sheet: &Sheet,
        membrane: &MembraneState,
    ) -> Found {
        self.forget();
        let mut found = Found::default();
        if image.rect.is_empty() {
            return found;
        }
        self.project(instrument_from_eye, membrane, image.rect);
        self.draw_membrane(image, sheet, membrane, &mut found);
        self.compare(image, &mut found);
        self.spread_to_nodes(sheet);
        found
    }

    /// Nodes to be moved along −ẑ of the instrument, each with its way in depth steps (Eq. 1).
    pub fn displaced(&self) -> impl Iterator<Item = (usize, i32)> + '_ {
        self.nodes.iter().map(|&n| (n as usize, self.node_depth[n as usize]))
    }

    /// Clears what the last look wrote, and only that.
    fn forget(&mut self) {
        self.triangles.drain(..).for_each(|t| self.triangle_depth[t as usize] = 0);
        self.nodes.drain(..).for_each(|n| self.node_depth[n as usize] = 0);
    }

    /// Nodes into the instrument's frame and fixed point, with the planes they lie beyond.
    fn project(&mut self, instrument_from_eye: &Isometry3<f64>, membrane: &MembraneState, rect: Rect) {
        let turn: Matrix3<f32> = instrument_from_eye.rotation.to_rotation_matrix().matrix().map(|c| c as f32);
        // Relative to the tip first: the difference of two positions near it is exact in f32.
        let tip: Vector3<f32> = (instrument_from_eye.inverse().translation.vector).map(|c| c as f32);
        let n = self.outcode.len();
        let [x, y, z] = membrane.position_mm.each_ref().map(|v| &v[..n]);
        let format = self.volume.format();
        for axis in 0..3 {
            let (m0, m1, m2) = (turn[(axis, 0)], turn[(axis, 1)], turn[(axis, 2)]);
            let (scale, limit) = if axis < 2 { (format[0], XY_LIMIT) } else { (format[1], Z_LIMIT) };
            let out = &mut self.vertex[axis][..n];
            for i in 0..n {
                let value = m0 * (x[i] - tip.x) + m1 * (y[i] - tip.y) + m2 * (z[i] - tip.z);
                out[i] = to_fixed(value, scale, limit);
            }
        }
        let [vx, vy, vz] = self.vertex.each_ref().map(|v| &v[..n]);
        let low = rect.min.map(|p| p * SUBPIXELS);
        let high = rect.max.map(|p| p * SUBPIXELS);
        for i in 0..n {
            let bit = |beyond: bool, plane: u8| if beyond { plane } else { 0 };
            let out = [vx[i].abs(), vy[i].abs()].iter().any(|&c| c >= XY_LIMIT) || vz[i].abs() >= Z_LIMIT;
            self.outcode[i] = bit(vx[i] < low[0], outside::LEFT)
                | bit(vx[i] > high[0], outside::RIGHT)
                | bit(vy[i] < low[1], outside::ABOVE)
                | bit(vy[i] > high[1], outside::BELOW)
                | bit(vz[i] < 0, outside::NEAR)
                | bit(vz[i] > DEPTH_STEPS, outside::FAR)
                | bit(out, outside::FORMAT);
        }
    }

    fn draw_membrane(
        &mut self,
        image: &InstrumentImage,
        sheet: &Sheet,
        membrane: &MembraneState,
        found: &mut Found,
    ) {
        let (rect, width) = (image.rect, self.volume.resolution);
        for row in rect.min[1] as usize..rect.max[1] as usize {
            let pixels = row * width + rect.min[0] as usize..row * width + rect.max[0] as usize;
            self.depth[pixels.clone()].fill(NOTHING);
            self.second[pixels].fill(0);
        }
        for (t, nodes) in sheet.triangles.iter().enumerate() {
            let codes = nodes.map(|n| self.outcode[n as usize]);
            if codes[0] & codes[1] & codes[2] & outside::PLANES != 0 || membrane.triangle_alive[t] == 0 {
                continue;
            }
            if (codes[0] | codes[1] | codes[2]) & outside::FORMAT != 0 {
                found.refused += 1;
                continue;
            }
            let vertices = nodes.map(|n| self.fixed(n as usize));
            let (depth, id, second) = (&mut self.depth, &mut self.id, &mut self.second);
            raster::triangle(vertices, rect, |x, y, z| {
                let pixel = y as usize * width + x as usize;
                if image.depth[pixel] == NOTHING || !(0..=DEPTH_STEPS).contains(&z) {
                    return;
                }
                if depth[pixel] != NOTHING && second[pixel] == 0 {
                    second[pixel] = 1;
                    found.folded += 1;
                }
                if z < depth[pixel] {
                    (depth[pixel], id[pixel]) = (z, t as u32);
                }
            });
        }
    }

    fn fixed(&self, node: usize) -> Fixed {
        [self.vertex[0][node], self.vertex[1][node], self.vertex[2][node]]
    }

    /// Colliding pixels give their triangles the deepest of their vectors.
    fn compare(&mut self, image: &InstrumentImage, found: &mut Found) {
        let (rect, width) = (image.rect, self.volume.resolution);
        for row in rect.min[1] as usize..rect.max[1] as usize {
            for pixel in row * width + rect.min[0] as usize..row * width + rect.max[0] as usize {
                let (z_i, z_m) = (image.depth[pixel], self.depth[pixel]);
                if z_m == NOTHING || z_i >= z_m {
                    continue;
                }
                let (way, t) = (z_m - z_i, self.id[pixel]);
                found.pixels += 1;
                found.deepest = found.deepest.max(way);
                let deepest = &mut self.triangle_depth[t as usize];
                if *deepest == 0 {
                    self.triangles.push(t);
                }
                *deepest = (*deepest).max(way);
            }
        }
    }

    /// Eq. 1: each node takes the largest vector of the triangles around it.
    fn spread_to_nodes(&mut self, sheet: &Sheet) {
        for &t in &self.triangles {
            for &node in &sheet.triangles[t as usize] {
                let way = &mut self.node_depth[node as usize];
                if *way == 0 {
                    self.nodes.push(node);
                }
                *way = (*way).max(self.triangle_depth[t as usize]);
            }
        }
    }
}

/// True if the box around the living nodes comes within `reach_mm` of `tip_in_eye`, axis by axis.
pub fn near_membrane(membrane: &MembraneState, tip_in_eye: &Vector3<f64>, reach_mm: f64) -> bool {
    (0..3).all(|axis| {
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for (&p, &flag) in membrane.position_mm[axis].iter().zip(&membrane.flag) {
            let dead = flag == NODE_DEAD;
            low = if !dead && p < low { p } else { low };
            high = if !dead && p > high { p } else { high };
        }
        f64::from(low) < tip_in_eye[axis] + reach_mm && f64::from(high) > tip_in_eye[axis] - reach_mm
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Translation3, UnitQuaternion};
    use protocol::handles::Tool;
    use protocol::scene_file::SceneFile;

    struct Setting {
        sheet: Sheet,
        membrane: MembraneState,
        zcoll: Zcoll,
        light: InstrumentImage,
    }

    fn setting() -> Setting {
        let scene = SceneFile::load("peel").unwrap();
        let sheet = Sheet::new(&scene);
        let volume = Volume::new(&scene.contact);
        Setting {
            membrane: sheet.start(),
            zcoll: Zcoll::new(volume, &sheet),
            light: InstrumentImage::new(Tool::LightPipe, 0.25, &volume),
            sheet,
        }
    }

    /// `eye_from_instrument` with the handle straight up and the tip over the middle of the sheet.
    fn upright(z_mm: f64) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(0.03, 0.02, z_mm), UnitQuaternion::identity())
    }

    fn look(s: &mut Setting, eye_from_instrument: &Isometry3<f64>) -> Found {
        s.light.prepare(0.0, s.zcoll.volume());
        s.zcoll.look(&s.light, &eye_from_instrument.inverse(), &s.sheet, &s.membrane)
    }

    #[test]
    fn a_tip_over_the_membrane_does_not_collide() {
        let mut s = setting();
        assert_eq!(look(&mut s, &upright(-10.9)), Found::default());
        assert_eq!(s.zcoll.displaced().count(), 0);
    }

    #[test]
    fn depth_is_how_far_the_tip_has_passed() {
        let mut s = setting();
        let top = (0..s.sheet.nodes()).map(|i| s.membrane.position(i).z).filter(|z| *z > -11.01).count();
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
            let way = s.zcoll.volume.depth_steps_mm(steps) as f32;
            s.membrane.position_mm[2][node] -= way;
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
        let nodes: Vec<Point3<f64>> = (0..s.sheet.nodes())
            .map(|i| pose.inverse() * Point3::from(s.membrane.position(i).map(f64::from)))
            .collect();
        let pixel_mm = 1.5 / 32.0;
        let mut hits = 0u32;
        for (row, column) in (0..32).flat_map(|r| (0..32).map(move |c| (r, c))) {
            let x = (f64::from(column) + 0.5) * pixel_mm - 0.75;
            let y = (f64::from(row) + 0.5) * pixel_mm - 0.75;
            // A 16-sided prism of radius 0.25 around z, its end at z = 0.
            let side = |i: i32| (f64::from(i) + 0.5) / 16.0 * std::f64::consts::TAU;
            let apothem = 0.25 * (std::f64::consts::PI / 16.0).cos();
            let inside = (0..16).all(|i| x * side(i).cos() + y * side(i).sin() <= apothem);
            let passed = s.sheet.triangles.iter().any(|t| {
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
        s.sheet.triangles.reverse();
        assert_eq!(look(&mut s, &pose), first);
        let mut again: Vec<_> = s.zcoll.displaced().collect();
        again.sort_unstable();
        assert_eq!(nodes, again);
    }

    #[test]
    fn a_fold_is_counted() {
        let mut s = setting();
        // Fold one half of the sheet over the other, a little above it.
        for i in 0..s.sheet.nodes() {
            if s.membrane.position_mm[0][i] > 0.3 {
                s.membrane.position_mm[0][i] = 0.6 - s.membrane.position_mm[0][i];
                s.membrane.position_mm[2][i] += 0.15;
            }
        }
        assert!(look(&mut s, &upright(-11.1)).folded > 0);
    }

    #[test]
    fn membrane_far_away_is_not_near() {
        let s = setting();
        assert!(near_membrane(&s.membrane, &Vector3::new(0.0, 0.0, -10.0), 1.6));
        assert!(!near_membrane(&s.membrane, &Vector3::new(0.0, 0.0, -5.0), 1.6));
    }
}
