//! The methods and what they have in common.

use crate::grid::HashedGrid;
use crate::obb::ObbTrees;
use crate::parry::{ParryBvh, ParryManifolds};
use crate::queries::{Back, Port, YesNo};
use crate::setting::{Frame, Setting};
use crate::spheres::SphereTrees;
use collision::instrument_image::{InstrumentImage, Volume};
use collision::zcoll::Zcoll;
use validation::exact::PairQuery;
use validation::exact::tritri::{Corner, Triangle};

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

/// Makes a method for a setting, where this machine has it.
pub type Make = fn(&Setting) -> Option<Box<dyn Method>>;

/// The methods in the order of the table; brute force only where it ends.
pub fn methods(triangles: usize) -> Vec<Make> {
    let mut all: Vec<Make> = vec![
        |s| Some(Box::new(Image::new(s))),
        adapter,
        |s| Some(Box::new(YesNo::new(s))),
        |s| Some(Box::new(Back::new(s))),
        |s| Some(Box::new(Port::new(s))),
        |s| Some(Box::new(Ours::new(s))),
        |s| Some(Box::new(ParryBvh::new(s))),
        |s| Some(Box::new(ParryManifolds::new(s))),
        |s| Some(Box::new(ObbTrees::new(s))),
        |s| Some(Box::new(HashedGrid::new(s))),
        |s| Some(Box::new(SphereTrees::new(s))),
    ];
    if triangles < 50_000 {
        all.push(|_| Some(Box::new(Brute::default())));
    }
    all
}

/// The membrane's triangles on the grid; `None` without area or beyond the grid.
#[inline]
pub fn triangle(frame: &Frame, corners: &[Corner], t: usize) -> Option<Triangle> {
    let corners = frame.surface.triangles[t].map(|v| corners[v as usize]);
    let on_grid = |c: &i32| c.abs() < validation::exact::tritri::LIMIT;
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
        self.zcoll.query(&self.image, &frame.instrument_from_eye, &frame.surface);
        self.zcoll.triangles().count()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}

/// ZCOLL on an adapter.
#[cfg(feature = "gpu")]
struct OnAdapter {
    image: Image,
    about: &'static str,
}

#[cfg(feature = "gpu")]
fn adapter(setting: &Setting) -> Option<Box<dyn Method>> {
    use collision::gpu::{GpuDevice, GpuZcoll};
    use std::sync::OnceLock;
    static DEVICE: OnceLock<Option<(GpuDevice, &'static str)>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| match GpuDevice::open() {
        Ok(device) => {
            let about = format!("as zcoll-cpu; {}", device.name());
            Some((device, about.leak()))
        }
        Err(error) => {
            eprintln!("zcoll-gpu left out: {error}");
            None
        }
    });
    let (device, about) = device.clone()?;
    let mut image = Image::new(setting);
    let gpu = GpuZcoll::new(device, *image.zcoll.volume(), &setting.triangles, setting.nodes());
    match gpu {
        Ok(gpu) => image.zcoll.set_gpu(Some(gpu)),
        Err(error) => {
            eprintln!("zcoll-gpu left out: {error}");
            return None;
        }
    };
    Some(Box::new(OnAdapter { image, about }))
}

#[cfg(not(feature = "gpu"))]
fn adapter(_: &Setting) -> Option<Box<dyn Method>> {
    eprintln!("zcoll-gpu left out: built without the feature gpu");
    None
}

#[cfg(feature = "gpu")]
impl Method for OnAdapter {
    fn name(&self) -> &'static str {
        "zcoll-gpu"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        self.about
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        let found = self.image.query(frame);
        assert!(self.image.zcoll.is_on_gpu(), "the adapter failed");
        found
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}

/// The product's exact pair query.
struct Ours(PairQuery);

impl Ours {
    fn new(setting: &Setting) -> Self {
        Ours(PairQuery::new(&setting.triangles, setting.nodes()).expect("a sheet"))
    }
}

impl Method for Ours {
    fn name(&self) -> &'static str {
        "exact"
    }
    fn update(&mut self, _: &Frame) {}
    fn query(&mut self, frame: &Frame) -> usize {
        self.0.query(frame.mesh, &frame.instrument_from_eye, &frame.surface).pairs as usize
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
            let met = frame.mesh.triangles().iter().filter(|(other, _)| mine.intersects(other));
            self.pairs.extend(met.map(|(_, number)| (t as u32, *number)));
        }
        self.pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}
