//! The meshes of the bench: squares cut into triangles, regular and not.

use protocol::random::Random;
use scene::SceneFile;
use tissue::sheet::material::Material;
use tissue::sheet::mesh::SheetMesh;

/// Squares along a side; 3 n² + 2 n edges, so 616, 1,496, 4,641 and 150,976.
pub const SIDES: [u32; 4] = [14, 22, 39, 224];

/// Shuffles a list (Fisher and Yates).
pub fn shuffle<T>(random: &mut Random, list: &mut [T]) {
    for i in (1..list.len()).rev() {
        list.swap(i, random.below(i + 1));
    }
}

/// −0.5 to 0.5.
fn centred(random: &mut Random) -> f32 {
    random.between(-0.5, 0.5) as f32
}

/// Nodes and triangles before they become a sheet.
pub struct Mesh {
    pub positions_mm: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub rim: Vec<u32>,
}

impl Mesh {
    /// Squares of 0.2 mm near the retina of the shipped scene, each with the same diagonal.
    pub fn regular(side: u32) -> Self {
        let node = |r: u32, c: u32| r * (side + 1) + c;
        let mut mesh = Mesh { positions_mm: Vec::new(), triangles: Vec::new(), rim: Vec::new() };
        let cell = 0.2f32.min(12.0 / side as f32);
        for (r, c) in (0..=side).flat_map(|r| (0..=side).map(move |c| (r, c))) {
            let flat = |n: u32| (n as f32 - side as f32 / 2.0) * cell;
            mesh.positions_mm.push([flat(c), flat(r), -7.0]);
            if r == 0 || c == 0 || r == side || c == side {
                mesh.rim.push(node(r, c));
            }
            if r < side && c < side {
                let [a, b, d, e] = [node(r, c), node(r, c + 1), node(r + 1, c), node(r + 1, c + 1)];
                mesh.triangles.extend([[a, b, e], [a, e, d]]);
            }
        }
        mesh
    }

    /// The same number of edges, but nodes jittered, a third of the diagonals turned at random and
    /// then as many edges between any two triangles flipped where that keeps the mesh simple, and
    /// everything in shuffled order.
    pub fn irregular(side: u32) -> Self {
        let mut mesh = Self::regular(side);
        let mut random = Random::from_seed(17);
        let cell = 0.2f32.min(12.0 / side as f32);
        for p in &mut mesh.positions_mm {
            *p = [p[0] + 0.3 * cell * centred(&mut random), p[1] + 0.3 * cell * centred(&mut random), p[2]];
        }
        mesh.flip_edges(&mut random);
        mesh.shuffle(&mut random);
        mesh
    }

    /// Flips edges of random neighbouring triangles whose four corners form a convex quadrilateral.
    fn flip_edges(&mut self, random: &mut Random) {
        use std::collections::HashMap;
        let mut beside: HashMap<[u32; 2], usize> = HashMap::new();
        let halves = |t: [u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        for (t, &nodes) in self.triangles.iter().enumerate() {
            halves(nodes).into_iter().for_each(|h| _ = beside.insert(h, t));
        }
        for _ in 0..self.triangles.len() {
            let first = random.below(self.triangles.len());
            let [a, b, c] = {
                let [p, q, r] = self.triangles[first];
                [[p, q, r], [q, r, p], [r, p, q]][random.below(3)]
            };
            let Some(&second) = beside.get(&[b, a]) else { continue };
            let d = self.triangles[second].into_iter().find(|n| *n != a && *n != b).expect("a third corner");
            let joined = beside.contains_key(&[c, d]) || beside.contains_key(&[d, c]);
            if joined || !self.is_fat([c, a, d]) || !self.is_fat([d, b, c]) {
                continue;
            }
            for t in [self.triangles[first], self.triangles[second]] {
                halves(t).into_iter().for_each(|h| _ = beside.remove(&h));
            }
            for (t, nodes) in [(first, [c, a, d]), (second, [d, b, c])] {
                self.triangles[t] = nodes;
                halves(nodes).into_iter().for_each(|h| _ = beside.insert(h, t));
            }
        }
    }

    /// True for a counter-clockwise triangle whose area is no sliver's.
    fn is_fat(&self, t: [u32; 3]) -> bool {
        let [a, b, c] = t.map(|n| self.positions_mm[n as usize]);
        let (p, q) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let longest = (p[0] * p[0] + p[1] * p[1]).max(q[0] * q[0] + q[1] * q[1]);
        p[0] * q[1] - p[1] * q[0] > 0.2 * longest
    }

    fn shuffle(&mut self, random: &mut Random) {
        let mut names: Vec<u32> = (0..self.positions_mm.len() as u32).collect();
        shuffle(random, &mut names);
        let old = self.positions_mm.clone();
        names.iter().zip(old).for_each(|(&n, p)| self.positions_mm[n as usize] = p);
        self.triangles.iter_mut().flatten().chain(&mut self.rim).for_each(|n| *n = names[*n as usize]);
        shuffle(random, &mut self.triangles);
    }

    /// The sheet, its rim pinned.
    pub fn sheet(&self) -> SheetMesh {
        SheetMesh::from_triangles(&self.positions_mm, &self.triangles, &self.rim).expect("a manifold mesh")
    }
}

/// The shipped tissue: damped springs, limits and both rules of tearing; its bending springs only
/// where asked for.
pub fn tissue(bending: bool) -> Material {
    let mut scene = SceneFile::load("peel").expect("the shipped scene");
    let membrane = scene.membrane.as_mut().expect("it has a membrane");
    if !bending {
        membrane.bending_un_per_mm = 0.0;
    }
    Material::new(&scene)
}
