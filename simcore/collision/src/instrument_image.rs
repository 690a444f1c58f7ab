//! The collision volume of an instrument, and the instrument's own depth image in it. That image
//! depends only on the jaw opening: it is drawn once for each opening, in steps of
//! [`JAW_STEP_RAD`].

use super::quantize::FixedFormat;
use super::raster::{self, DEPTH_STEPS, MAX_RESOLUTION, MIN_RESOLUTION, Rect, SUBPIXELS, XY_LIMIT, Z_LIMIT};
use super::surface::CollisionError;
use super::tool_mesh::{Facet, ToolMesh};
use protocol::handles::Tool;
use scene::ContactScene;

/// Share of the collision volume's depth that lies beyond the tip; the rest lies towards the
/// handle.
const VOLUME_BEYOND_TIP: f64 = 1.0 / 6.0;
/// Steps of jaw opening for which an instrument image is drawn, rad.
const JAW_STEP_RAD: f64 = 0.01;
const _: () = assert!(VOLUME_BEYOND_TIP > 0.0 && VOLUME_BEYOND_TIP < 1.0);

/// No instrument at this pixel.
pub const NOTHING: i32 = i32::MAX;

/// The collision volume of an instrument, in its frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Volume {
    /// Half width along x and y, mm.
    pub half_mm: f64,
    /// Near plane, mm (negative: beyond the tip).
    pub near_mm: f64,
    /// From the near plane to the far plane, mm.
    pub depth_mm: f64,
    /// Pixels along x and along y.
    pub resolution: usize,
}

impl Volume {
    /// The volume of a scene.
    pub fn new(contact: &ContactScene) -> Self {
        let [half_mm, depth_mm] = contact.volume_mm;
        let near_mm = -depth_mm * VOLUME_BEYOND_TIP;
        Volume { half_mm, near_mm, depth_mm, resolution: contact.resolution as usize }
    }

    /// Farthest point of the volume from the tip, mm.
    pub fn reach_mm(&self) -> f64 {
        let far = (self.near_mm + self.depth_mm).max(-self.near_mm);
        libm::sqrt(2.0 * self.half_mm * self.half_mm + far * far)
    }

    /// Refuses a volume without extent and an image of a size that the format does not hold.
    pub fn check(&self) -> Result<(), CollisionError> {
        let &Volume { half_mm, near_mm, depth_mm, resolution } = self;
        let sides = half_mm > 0.0 && depth_mm > 0.0 && near_mm.abs() <= depth_mm;
        if !sides || !half_mm.is_finite() || !depth_mm.is_finite() {
            return Err(CollisionError::NoVolume { half_mm, depth_mm });
        }
        if !(MIN_RESOLUTION..=MAX_RESOLUTION).contains(&resolution) {
            return Err(CollisionError::Resolution { resolution });
        }
        Ok(())
    }

    /// Corners, in the instrument's frame and mm, of the box that a rectangle of the image sees,
    /// widened by so many pixels to every side, and along z by as many 1/256 of the depth.
    pub fn box_around(&self, rect: Rect, margin: f32) -> [[f32; 3]; 2] {
        let [FixedFormat { scale: xy, offset: middle }, FixedFormat { scale: z, offset: near }] =
            self.format();
        let step = SUBPIXELS as f32;
        let wide = |pixel: i32, by: f32| ((pixel as f32 + by) * step - middle) / xy;
        let deep = |steps: i32, by: f32| (steps as f32 + by * step - near) / z;
        let low = [wide(rect.min[0], -margin), wide(rect.min[1], -margin), deep(0, -margin)];
        let high = [wide(rect.max[0], margin), wide(rect.max[1], margin), deep(DEPTH_STEPS, margin)];
        [low, high]
    }

    /// Scale and offset to fixed point along z for the camera at the handle: from the far plane
    /// towards the tip.
    pub fn format_back(&self) -> FixedFormat {
        let z = f64::from(DEPTH_STEPS) / self.depth_mm;
        FixedFormat { scale: -z as f32, offset: ((self.near_mm + self.depth_mm) * z) as f32 }
    }

    /// To fixed point along x (and y), then along z.
    pub fn format(&self) -> [FixedFormat; 2] {
        let width = (self.resolution as i32 * SUBPIXELS) as f64;
        let xy = width / (2.0 * self.half_mm);
        let z = f64::from(DEPTH_STEPS) / self.depth_mm;
        let format = |scale: f64, offset: f64| FixedFormat { scale: scale as f32, offset: offset as f32 };
        [format(xy, width * 0.5), format(z, -self.near_mm * z)]
    }

    /// A number of depth steps in mm.
    pub fn depth_steps_mm(&self, steps: i32) -> f64 {
        f64::from(steps) * self.depth_mm / f64::from(DEPTH_STEPS)
    }
}

/// What a look compares the membrane with: an instrument seen from one end.
#[derive(Debug, Clone, Copy)]
pub struct Side<'a> {
    /// Depth of each pixel in depth steps, or [`NOTHING`]; row by row.
    pub depth: &'a [i32],
    /// Pixels that may hold instrument.
    pub rect: Rect,
    /// Seen from the handle, with depth growing towards the tip.
    pub reversed: bool,
}

/// Depth image of an instrument for one opening of its jaws.
#[derive(Debug)]
pub struct InstrumentImage {
    mesh: ToolMesh,
    tool: u32,
    /// Radius of the shaft, and of a needle in this hand, mm.
    radius_mm: [f64; 2],
    /// Opening in [`JAW_STEP_RAD`], −1 before the first.
    opening: i64,
    /// Depth of each pixel in depth steps, or [`NOTHING`]; row by row.
    pub depth: Vec<i32>,
    /// Pixels that may hold instrument.
    pub rect: Rect,
    /// Depths below the far plane of what reaches beside the shaft, seen from the handle.
    back_depth: Vec<i32>,
    /// Pixels that may hold such.
    back_rect: Rect,
}

impl InstrumentImage {
    /// An image yet to be drawn.
    pub fn new(tool: Tool, radius_mm: f64, volume: &Volume) -> Self {
        Self::with_needle(tool, [radius_mm; 2], volume)
    }

    /// The same, with the radius of the shaft and that of a needle.
    pub fn with_needle(tool: Tool, radius_mm: [f64; 2], volume: &Volume) -> Self {
        let pixels = volume.resolution * volume.resolution;
        let mesh = ToolMesh::new(tool, radius_mm[usize::from(tool == Tool::Needle)], volume.depth_mm);
        let depth = vec![NOTHING; pixels];
        InstrumentImage {
            mesh,
            tool: tool as u32,
            radius_mm,
            opening: -1,
            back_depth: depth.clone(),
            back_rect: Rect::EMPTY,
            depth,
            rect: Rect::EMPTY,
        }
    }

    /// The instrument as the camera beyond the tip sees it.
    pub fn ahead(&self) -> Side<'_> {
        Side { depth: &self.depth, rect: self.rect, reversed: false }
    }

    /// What of the instrument can lift tissue, as a camera at the handle sees it: hook and jaws.
    /// Where they reach out of the volume there is shaft behind them, and nothing that could lie on
    /// it. Empty for an instrument that is all shaft.
    pub fn back(&self) -> Side<'_> {
        Side { depth: &self.back_depth, rect: self.back_rect, reversed: true }
    }

    /// An image of a shape of one's own, for a bench or a test.
    pub fn of_mesh(mesh: ToolMesh, volume: &Volume) -> Self {
        InstrumentImage { mesh, ..Self::new(Tool::Forceps, 0.0, volume) }
    }

    /// Takes another tool into the hand; it allocates, but only at a change of tools.
    pub fn set_tool(&mut self, tool: Tool, volume: &Volume) {
        if self.tool != tool as u32 {
            *self = Self::with_needle(tool, self.radius_mm, volume);
        }
    }

    /// Draws the image again if the opening differs from the one drawn.
    pub fn prepare(&mut self, jaw_rad: f64, volume: &Volume) {
        let has_jaws = !self.mesh.jaw.is_empty();
        let opening = if has_jaws { (jaw_rad / JAW_STEP_RAD + 0.5) as i64 } else { 0 };
        if opening == self.opening {
            return;
        }
        self.opening = opening;
        self.depth.fill(NOTHING);
        self.rect = Rect::EMPTY;
        let jaw_rad = opening as f64 * JAW_STEP_RAD;
        let mut ahead = Pen { volume, z: volume.format()[1], depth: &mut self.depth, rect: &mut self.rect };
        self.mesh.for_each(jaw_rad, |facet| ahead.draw(facet, 0));
        self.back_depth.fill(NOTHING);
        self.back_rect = Rect::EMPTY;
        let (depth, rect) = (&mut self.back_depth, &mut self.back_rect);
        let mut back = Pen { volume, z: volume.format_back(), depth, rect };
        self.mesh.for_each_aside(jaw_rad, |facet| back.draw(facet, -1));
        self.back_depth.iter_mut().filter(|d| **d < 0).for_each(|d| *d = NOTHING);
    }
}

/// Draws facets into a depth image, the nearest wins.
struct Pen<'a> {
    volume: &'a Volume,
    z: FixedFormat,
    depth: &'a mut [i32],
    rect: &'a mut Rect,
}

impl Pen<'_> {
    /// `nearest` stands for whatever lies before the near plane.
    fn draw(&mut self, facet: Facet, nearest: i32) {
        let (whole, width) = (Rect::whole(self.volume.resolution), self.volume.resolution);
        let [xy, _] = self.volume.format();
        let vertices = facet.map(|p| {
            let [x, y, d] = p.map(|c| c as f32);
            [xy.to_fixed(x, XY_LIMIT - 1), xy.to_fixed(y, XY_LIMIT - 1), self.z.to_fixed(d, Z_LIMIT - 1)]
        });
        raster::triangle(vertices, whole, |x, y, d| {
            let d = d.steps();
            if d <= DEPTH_STEPS {
                let pixel = &mut self.depth[y as usize * width + x as usize];
                *pixel = (*pixel).min(d.max(nearest));
                self.rect.include(x, y);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::handles::{HOOK_LENGTH_MM, HOOK_THICKNESS_MM};
    use scene::SceneFile;

    #[test]
    fn jaws_widen_the_image_and_only_their_change_draws_it() {
        let volume = Volume::new(&SceneFile::load("peel").unwrap().contact);
        let mut image = InstrumentImage::new(Tool::Forceps, 0.25, &volume);
        image.prepare(0.0, &volume);
        let closed = image.rect;
        image.prepare(0.6, &volume);
        assert!(image.rect.max[0] - image.rect.min[0] > closed.max[0] - closed.min[0]);
        image.depth[0] = 7;
        image.prepare(0.601, &volume);
        assert_eq!(image.depth[0], 7, "kept for the same opening");
        image.prepare(0.7, &volume);
        assert_eq!(image.depth[0], NOTHING);
    }

    #[test]
    fn depth_of_the_image_is_that_of_the_shape() {
        let volume = Volume::new(&SceneFile::load("peel").unwrap().contact);
        let mut image = InstrumentImage::new(Tool::LightPipe, 0.25, &volume);
        image.prepare(0.0, &volume);
        // The flat end of the pipe lies at z = 0, a sixth of the depth behind the near plane.
        let middle = image.depth[16 * 32 + 16];
        assert!((volume.depth_steps_mm(middle) - 0.25).abs() < 1e-4, "{middle}");
        assert_eq!(image.depth[0], NOTHING);
    }

    #[test]
    fn only_what_reaches_beside_the_shaft_lifts() {
        let volume = Volume::new(&SceneFile::load("peel").unwrap().contact);
        for (tool, lifts) in [(Tool::Pick, true), (Tool::LightPipe, false), (Tool::Vitrector, false)] {
            let mut image = InstrumentImage::new(tool, 0.25, &volume);
            image.prepare(0.0, &volume);
            assert_eq!(!image.back().rect.is_empty(), lifts, "{tool:?}");
        }
        // The top of the hook near its end, seen from the far plane 1.25 mm over the tip.
        let mut image = InstrumentImage::new(Tool::Pick, 0.25, &volume);
        image.prepare(0.0, &volume);
        let (row, column) = (16, 16 + (0.5 / 1.5 * 32.0) as usize);
        let x = (column as f64 + 0.5) / 32.0 * 1.5 - 0.75;
        let top = HOOK_THICKNESS_MM * (1.0 - 0.5 * x / HOOK_LENGTH_MM);
        let seen = 1.25 - volume.depth_steps_mm(image.back().depth[row * 32 + column]);
        assert!((seen - top).abs() < 1e-4, "{seen} {top}");
        let under = volume.depth_steps_mm(image.depth[row * 32 + column]) - 0.25;
        assert!(under.abs() < 1e-4, "its under side lies at the tip's height: {under}");
    }
}
