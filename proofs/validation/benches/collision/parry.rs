//! parry3d: its tree refitted every frame with the exact test behind it, and its contact manifolds.

use crate::peers::{Method, triangle};
use crate::setting::{Frame, Setting};
use parry3d::bounding_volume::Aabb;
use parry3d::math::{Pose, Vector};
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::{
    ContactManifold, ContactManifoldsWorkspace, DefaultQueryDispatcher, PersistentQueryDispatcher,
};
use parry3d::shape::TriMesh;
use validation::exact::tritri::{Corner, Triangle};

fn boxed([low, high]: [Corner; 2]) -> Aabb {
    // Whole numbers below 2²⁴: exact in f32.
    let v = |c: Corner| Vector::new(c[0] as f32, c[1] as f32, c[2] as f32);
    Aabb::new(v(low), v(high))
}

fn around(corners: [Corner; 3]) -> Aabb {
    let [a, b, c] = corners;
    let of = |pick: fn(i32, i32) -> i32| std::array::from_fn(|k| pick(pick(a[k], b[k]), c[k]));
    boxed([of(Ord::min), of(Ord::max)])
}

/// A tree over the membrane, built once, its boxes renewed every frame; a static tree over the
/// instrument.
pub struct ParryBvh {
    membrane: Bvh,
    instrument: Bvh,
    corners: Vec<Corner>,
    pairs: Vec<(u32, u32)>,
}

impl ParryBvh {
    /// Builds both trees.
    pub fn new(setting: &Setting) -> Self {
        let mut corners = Vec::new();
        let frame = setting.frame();
        frame.on_grid(&mut corners);
        let leaves: Vec<Aabb> =
            setting.triangles.iter().map(|t| around(t.map(|v| corners[v as usize]))).collect();
        let tool: Vec<Aabb> = setting.mesh.triangles().iter().map(|(t, _)| boxed(t.bounds())).collect();
        ParryBvh {
            membrane: Bvh::from_leaves(BvhBuildStrategy::Binned, &leaves),
            instrument: Bvh::from_leaves(BvhBuildStrategy::Binned, &tool),
            corners,
            pairs: Vec::new(),
        }
    }
}

impl Method for ParryBvh {
    fn name(&self) -> &'static str {
        "parry-bvh"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.corners);
        for (t, corners) in frame.surface.triangles.iter().enumerate() {
            let leaf = around(corners.map(|v| self.corners[v as usize]));
            let _ = self.membrane.insert_or_update_partially(leaf, t as u32, 0.0);
        }
        self.membrane.refit_without_opt();
    }
    fn query(&mut self, frame: &Frame) -> usize {
        self.pairs.clear();
        let tool = frame.mesh.triangles();
        let mut last: (u32, Option<Triangle>) = (u32::MAX, None);
        for (t, i) in self.membrane.leaf_pairs(&self.instrument, |a, b| a.intersects(b)) {
            if t != last.0 {
                last = (t, triangle(frame, &self.corners, t as usize));
            }
            let (other, number) = &tool[i as usize];
            if last.1.is_some_and(|mine| mine.intersects(other)) {
                self.pairs.push((t, *number));
            }
        }
        self.pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}

/// Contact manifolds between two meshes, which parry3d computes in `f32`.
pub struct ParryManifolds {
    membrane: TriMesh,
    instrument: TriMesh,
    corners: Vec<Corner>,
    vertices: Vec<Vector>,
    manifolds: Vec<ContactManifold<(), ()>>,
    workspace: Option<ContactManifoldsWorkspace>,
}

/// Corners in mm.
fn millimetres(corners: &[Corner], scale: f32, out: &mut Vec<Vector>) {
    out.clear();
    out.extend(corners.iter().map(|c| Vector::new(c[0] as f32, c[1] as f32, c[2] as f32) / scale));
}

impl ParryManifolds {
    /// Builds both meshes.
    pub fn new(setting: &Setting) -> Self {
        let (mut corners, mut vertices) = (Vec::new(), Vec::new());
        setting.frame().on_grid(&mut corners);
        millimetres(&corners, setting.mesh.scale(), &mut vertices);
        let membrane = TriMesh::new(vertices.clone(), setting.triangles.clone()).expect("a sheet");
        let tool: Vec<Corner> = setting.mesh.triangles().iter().flat_map(|(t, _)| t.corners).collect();
        let indices = (0..tool.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mut tool_vertices = Vec::new();
        millimetres(&tool, setting.mesh.scale(), &mut tool_vertices);
        let instrument = TriMesh::new(tool_vertices, indices).expect("a forceps");
        ParryManifolds { membrane, instrument, corners, vertices, manifolds: Vec::new(), workspace: None }
    }
}

impl Method for ParryManifolds {
    fn name(&self) -> &'static str {
        "parry-manifolds"
    }
    fn exact(&self) -> bool {
        false
    }
    fn returns(&self) -> &'static str {
        "pairs, points, normals"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.corners);
        millimetres(&self.corners, frame.mesh.scale(), &mut self.vertices);
        self.membrane.set_vertices(&self.vertices);
    }
    fn query(&mut self, _: &Frame) -> usize {
        let (membrane, instrument) = (&self.membrane, &self.instrument);
        let (manifolds, workspace) = (&mut self.manifolds, &mut self.workspace);
        DefaultQueryDispatcher
            .contact_manifolds(&Pose::IDENTITY, membrane, instrument, 0.0, manifolds, workspace)
            .expect("meshes are supported");
        self.manifolds.iter().filter(|m| !m.points.is_empty()).count()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        Vec::new()
    }
}
