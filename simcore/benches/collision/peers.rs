//! The methods and what they have in common.

use crate::grid::HashedGrid;
use crate::parry::{ParryBvh, ParryManifolds};
use crate::setting::{Frame, Setting};
use crate::spheres::SphereTrees;
use simcore::collision::exact::Exact;
use simcore::collision::instrument_image::{InstrumentImage, Volume};
use simcore::collision::tritri::{Corner, Triangle};
use simcore::collision::zcoll::Zcoll;

/// A way to find collisions.
pub trait Method {
    /// Its name in the output.
    fn name(&self) -> &'static str;
    /// True if it finds all pairs and only those.
    fn exact(&self) -> bool {
        true
    }
    /// What a caller gets.
    fn returns(&self) -> &'static str {
        "pairs"
    }
    /// After the membrane changed.
    fn update(&mut self, frame: &Frame);
    /// Looks; how many triangles, pairs or manifolds it found.
    fn query(&mut self, frame: &Frame) -> usize;
    /// Pairs of the last query.
    fn pairs(&self) -> Vec<(u32, u32)>;
}

/// Makes a method for a setting.
pub type Make = fn(&Setting) -> Box<dyn Method>;

/// The methods in the order of the table; brute force only where it ends.
pub fn methods(triangles: usize) -> Vec<Make> {
    let mut all: Vec<Make> = vec![
        |s| Box::new(Image::new(s)),
        |s| Box::new(Ours::new(s)),
        |s| Box::new(ParryBvh::new(s)),
        |s| Box::new(ParryManifolds::new(s)),
        |s| Box::new(HashedGrid::new(s)),
        |s| Box::new(SphereTrees::new(s)),
    ];
    if triangles < 50_000 {
        all.push(|_| Box::new(Brute::default()));
    }
    all
}

/// The membrane's triangles on the grid; `None` without area or beyond the grid.
#[inline]
pub fn triangle(frame: &Frame, corners: &[Corner], t: usize) -> Option<Triangle> {
    let corners = frame.surface.triangles[t].map(|v| corners[v as usize]);
    let on_grid = |c: &i32| c.abs() < simcore::collision::tritri::LIMIT;
    if corners.as_flattened().iter().all(on_grid) { Triangle::new(corners) } else { None }
}

/// ZCOLL at 32 × 32 with deformation vectors and node displacements.
struct Image {
    zcoll: Zcoll,
    image: InstrumentImage,
}

impl Image {
    fn new(setting: &Setting) -> Self {
        let volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution: 32 };
        let (mesh, jaw_rad) = Setting::tool();
        let mut image = InstrumentImage::of_mesh(mesh, &volume);
        image.prepare(jaw_rad, &volume);
        let zcoll = Zcoll::new(volume, &setting.triangles, setting.nodes()).expect("a sheet");
        Image { zcoll, image }
    }
}

impl Method for Image {
    fn name(&self) -> &'static str {
        "zcoll-cpu"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        "triangles, vectors, node displacements"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        self.zcoll.look(&self.image, &frame.instrument_from_eye, &frame.surface);
        self.zcoll.triangles().count()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}

/// The product's exact pair query.
struct Ours(Exact);

impl Ours {
    fn new(setting: &Setting) -> Self {
        Ours(Exact::new(&setting.triangles, setting.nodes()).expect("a sheet"))
    }
}

impl Method for Ours {
    fn name(&self) -> &'static str {
        "exact"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        self.0.find(frame.mesh, &frame.instrument_from_eye, &frame.surface).pairs as usize
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.0.pairs().iter().map(|p| (p.membrane, p.instrument)).collect()
    }
}

/// Every triangle with every triangle.
#[derive(Default)]
struct Brute {
    corners: Vec<Corner>,
    pairs: Vec<(u32, u32)>,
}

impl Method for Brute {
    fn name(&self) -> &'static str {
        "brute"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.corners);
    }
    fn query(&mut self, frame: &Frame) -> usize {
        self.pairs.clear();
        for t in 0..frame.surface.triangles.len() {
            let Some(mine) = triangle(frame, &self.corners, t) else { continue };
            let met = frame.mesh.triangles().iter().filter(|(other, _)| mine.meets(other));
            self.pairs.extend(met.map(|(_, number)| (t as u32, *number)));
        }
        self.pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}
