//! The tissue mesh of a scene block, made ready for the GPU: bound nodes moved with the latched
//! instruments, normals from the triangles, edges of the membrane marked, and of each node the place
//! in the fundus map where it lay at the start, so that what is drawn on the tissue moves with it.
//!
//! Retina is rounded off on the way (`rim`), and the layers of a folded membrane are put in order.
//!
//! What comes in is checked: a triangle with a node that does not exist or is not a finite point
//! is left out and counted.

mod rim;

use crate::layout::{TissueHome, TissueVertex};
use glam::{Mat4, Vec3};
use protocol::limits::INSTRUMENTS;
use protocol::scene::{
    FAR_FROM_EDGE_MM, NODE_BOUND, SceneHome, SceneNode, SceneTriangle, TISSUE_GONE, TISSUE_LYING,
    TISSUE_MEMBRANE,
};
use rim::Rim;

/// Farthest that a node may be from the eye's centre, mm; farther ones are broken numbers.
const FARTHEST_MM: f32 = 1e3;
/// Triangles of the membrane whose depths differ by less are drawn in the mesh's order, mm: layers of a
/// fold lie farther apart, and a driver shades shared corners of neighbours once.
const LAYER_MM: f32 = 0.1;

/// Membrane and lifted retina as they are drawn.
#[derive(Debug, Default)]
pub struct Tissue {
    nodes: Vec<SceneNode>,
    /// Those of the membrane first, then those of the retina, then those that are gone.
    triangles: Vec<[u32; 3]>,
    /// Of the retina as they came.
    loose: Vec<[u32; 3]>,
    lying: Vec<[u32; 3]>,
    rim: Rim,
    /// Triangles of the membrane, and how deep they lie in [`LAYER_MM`].
    stack: Vec<(i32, [u32; 3])>,
    restacked: bool,
    membrane: usize,
    retina: usize,
    homes: Vec<TissueHome>,
    vertices: Vec<TissueVertex>,
    edges: Vec<(u32, u32)>,
    is_edge: Vec<bool>,
    topology: Option<u64>,
    /// Triangles left out of the present scene.
    pub refused: u64,
}

impl Tissue {
    /// With room for `nodes` and `triangles`; nothing is allocated later.
    pub fn with_capacity(nodes: usize, triangles: usize) -> Self {
        Self {
            nodes: Vec::with_capacity(nodes),
            triangles: Vec::with_capacity(2 * triangles),
            homes: Vec::with_capacity(2 * nodes),
            vertices: Vec::with_capacity(2 * nodes),
            edges: Vec::with_capacity(3 * triangles),
            stack: Vec::with_capacity(triangles),
            is_edge: Vec::with_capacity(nodes),
            ..Self::default()
        }
    }

    /// Takes a scene's arrays in; true if the triangles have changed.
    pub fn take(
        &mut self,
        nodes: &[SceneNode],
        triangles: &[SceneTriangle],
        homes: &[SceneHome],
        topology: u64,
    ) -> bool {
        self.nodes.clear();
        self.nodes.extend_from_slice(nodes);
        let count = self.nodes.len() as u32;
        let changed = self.topology != Some(topology) || self.is_edge.len() != self.nodes.len();
        if changed {
            self.topology = Some(topology);
            self.triangles.clear();
            self.homes.clear();
            self.homes.extend(self.nodes.iter().map(|n| TissueHome::of(n.position_mm, FAR_FROM_EDGE_MM)));
            for home in homes.iter().filter(|h| h.node < count) {
                self.homes[home.node as usize] = TissueHome::of(home.position_mm, home.from_edge_mm);
            }
            let fits = |t: &&SceneTriangle| t.nodes.iter().all(|&n| n < count);
            let kind = |t: &SceneTriangle| match t.tissue {
                TISSUE_MEMBRANE => 0,
                TISSUE_GONE => 2,
                TISSUE_LYING => 3,
                _ => 1,
            };
            let of = |which: u32| triangles.iter().filter(move |t| kind(t) == which);
            self.triangles.extend(of(0).filter(fits).map(|t| t.nodes));
            self.membrane = self.triangles.len();
            self.loose.clear();
            self.loose.extend(of(1).filter(fits).map(|t| t.nodes));
            self.lying.clear();
            self.lying.extend(of(3).filter(fits).map(|t| t.nodes));
            self.rim.divide(count as usize, &self.loose, &self.lying, &mut self.triangles);
            self.rim.place_homes(&mut self.homes);
            self.retina = self.triangles.len() - self.membrane;
            self.triangles.extend(of(2).filter(fits).map(|t| t.nodes));
            self.refused = triangles.iter().filter(|t| !fits(t)).count() as u64;
            self.mark_edges();
        }
        changed
    }

    /// Numbers of membrane triangles, which come first, and of retina triangles, which follow; the
    /// rest are gone.
    pub fn counts(&self) -> [usize; 2] {
        [self.membrane, self.retina]
    }

    /// Triangles to draw.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Home of each vertex; they change with the triangles only.
    pub fn homes(&self) -> &[TissueHome] {
        &self.homes
    }

    /// An edge that belongs to one triangle only is an edge of the sheet.
    fn mark_edges(&mut self) {
        self.edges.clear();
        for t in &self.triangles[..self.membrane] {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                self.edges.push((a.min(b), a.max(b)));
            }
        }
        self.edges.sort_unstable();
        self.is_edge.clear();
        self.is_edge.resize(self.nodes.len(), false);
        for same in self.edges.chunk_by(|a, b| a == b) {
            if let [(a, b)] = same {
                self.is_edge[*a as usize] = true;
                self.is_edge[*b as usize] = true;
            }
        }
    }

    /// Vertices in the eye frame; bound nodes follow their instrument, no deeper than the choroid,
    /// which is `radius_mm` from the eye's centre.
    pub fn vertices(&mut self, eye_from_instrument: &[Mat4; INSTRUMENTS], radius_mm: f32) -> &[TissueVertex] {
        self.vertices.clear();
        for (i, node) in self.nodes.iter().enumerate() {
            let edge = f32::from(u8::from(self.is_edge[i]));
            let dye = f32::from(node.dye) / f32::from(u16::MAX);
            self.vertices.push(TissueVertex {
                position: in_eye(node, eye_from_instrument, radius_mm).to_array(),
                normal: [0.0; 3],
                more: [edge, dye],
            });
        }
        let held = |node: usize| u32::from(self.nodes[node].flag) >= NODE_BOUND;
        self.rim.place(&mut self.vertices, held);
        self.add_normals();
        self.stack_membrane();
        &self.vertices
    }

    /// Whether the vertices taken last changed the order of the triangles.
    pub fn is_restacked(&self) -> bool {
        self.restacked
    }

    /// Puts the membrane's triangles in order from the choroid up, as they are drawn: each lets through
    /// what lies behind it, so where the membrane is folded over the lower layer has to be there first.
    fn stack_membrane(&mut self) {
        let depth = |n: u32| Vec3::from(self.vertices[n as usize].position).length();
        self.stack.clear();
        let membrane = &mut self.triangles[..self.membrane];
        let layer = |t: &[u32; 3]| (t.map(depth).iter().sum::<f32>() / (3.0 * LAYER_MM)) as i32;
        self.stack.extend(membrane.iter().map(|t| (layer(t), *t)));
        self.restacked = !self.stack.is_sorted_by(|a, b| a.0 >= b.0);
        if self.restacked {
            // Within a layer as the mesh has them, whose nodes are near each other.
            self.stack.sort_unstable_by_key(|&(layer, t)| (std::cmp::Reverse(layer), t));
            membrane.iter_mut().zip(&self.stack).for_each(|(t, (_, sorted))| *t = *sorted);
        }
    }

    fn add_normals(&mut self) {
        for t in &self.triangles[..self.membrane + self.retina] {
            let [a, b, c] = t.map(|n| Vec3::from(self.vertices[n as usize].position));
            // Not normalised: large triangles count more.
            let normal = (b - a).cross(c - a);
            for &n in t {
                let sum = Vec3::from(self.vertices[n as usize].normal) + normal;
                self.vertices[n as usize].normal = sum.to_array();
            }
        }
        for v in &mut self.vertices {
            v.normal = Vec3::from(v.normal).normalize_or(Vec3::Z).to_array();
        }
    }
}

/// Position in the eye frame; broken numbers are put out of sight, far behind the camera. The choroid
/// stops what an instrument holds here as it does in the simulation.
fn in_eye(node: &SceneNode, eye_from_instrument: &[Mat4; INSTRUMENTS], radius_mm: f32) -> Vec3 {
    let p = Vec3::from(node.position_mm);
    let bound =
        u32::from(node.flag).checked_sub(NODE_BOUND).and_then(|i| eye_from_instrument.get(i as usize));
    let p = bound.map_or(p, |m| m.transform_point3(p).clamp_length_max(radius_mm));
    if p.is_finite() && p.length_squared() < FARTHEST_MM * FARTHEST_MM {
        p
    } else {
        Vec3::new(0.0, 0.0, -FARTHEST_MM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fundus_map;
    use protocol::scene::NODE_FREE;

    const RADIUS_MM: f32 = 11.5;

    fn node(position_mm: [f32; 3], flag: u32) -> SceneNode {
        SceneNode { position_mm, flag: flag as u16, dye: 0 }
    }

    fn square() -> (Vec<SceneNode>, Vec<SceneTriangle>) {
        // A fan about a middle node: the middle is no edge.
        let nodes = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
            .map(|[x, y]| node([x, y, -11.0], NODE_FREE));
        let triangles = (0..4).map(|i| SceneTriangle { nodes: [0, 1 + i, 1 + (i + 1) % 4], tissue: 0 });
        (nodes.to_vec(), triangles.collect())
    }

    #[test]
    fn normals_look_into_the_eye_and_edges_are_found() {
        let (nodes, triangles) = square();
        let mut tissue = Tissue::default();
        assert!(tissue.take(&nodes, &triangles, &[], 1));
        assert!(!tissue.take(&nodes, &triangles, &[], 1), "same topology");
        tissue.nodes[2].dye = u16::MAX;
        let v = tissue.vertices(&[Mat4::IDENTITY; 2], RADIUS_MM);
        assert!(v.iter().all(|v| (v.normal[2] - 1.0).abs() < 1e-6));
        assert_eq!(v.iter().map(|v| v.more[1]).collect::<Vec<_>>(), [0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(v.iter().map(|v| v.more[0]).collect::<Vec<_>>(), [0.0, 1.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_folded_membrane_is_drawn_from_the_choroid_up() {
        let at = |[x, y, z]: [f32; 3]| node([x, y, z], NODE_FREE);
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let layer = |z: f32| corners.map(|[x, y]| at([x, y, z]));
        // The flap comes before what it lies over, and after it.
        let mut nodes = [layer(-10.0), layer(-11.0), layer(-10.5)].concat();
        let triangles = [[0, 1, 2], [3, 4, 5], [6, 7, 8]].map(|nodes| SceneTriangle { nodes, tissue: 0 });
        let mut tissue = Tissue::default();
        let mut drawn = |nodes: &[SceneNode]| {
            tissue.take(nodes, &triangles, &[], 1);
            tissue.vertices(&[Mat4::IDENTITY; 2], RADIUS_MM);
            let order: Vec<u32> = tissue.triangles().iter().map(|t| t[0] / 3).collect();
            (order, tissue.is_restacked())
        };
        assert_eq!(drawn(&nodes), (vec![1, 2, 0], true));
        assert_eq!(drawn(&nodes), (vec![1, 2, 0], false), "as it was");
        nodes[6..].iter_mut().for_each(|n| n.position_mm[2] = -9.0);
        assert_eq!(drawn(&nodes), (vec![1, 0, 2], true));
    }

    #[test]
    fn bound_nodes_follow_their_instrument() {
        let (mut nodes, triangles) = square();
        nodes[0] = node([0.1, 0.0, 0.0], NODE_BOUND + 1);
        let mut tissue = Tissue::default();
        tissue.take(&nodes, &triangles, &[], 1);
        let moved = Mat4::from_translation(Vec3::new(0.0, 2.0, -9.0));
        let v = tissue.vertices(&[Mat4::IDENTITY, moved], RADIUS_MM);
        assert_eq!(v[0].position, [0.1, 2.0, -9.0]);
    }

    #[test]
    fn what_is_held_is_not_drawn_through_the_wall() {
        let (mut nodes, triangles) = square();
        nodes[0] = node([0.0, 0.0, -1.0], NODE_BOUND);
        let mut tissue = Tissue::default();
        tissue.take(&nodes, &triangles, &[], 1);
        let deep = Mat4::from_translation(Vec3::new(0.0, 0.0, -11.44));
        assert_eq!(tissue.vertices(&[deep, Mat4::IDENTITY], RADIUS_MM)[0].position, [0.0, 0.0, -RADIUS_MM]);
    }

    #[test]
    fn tissue_keeps_its_place_in_the_map_when_it_moves_and_what_is_gone_comes_last() {
        let (mut nodes, mut triangles) = square();
        (triangles[1].tissue, triangles[3].tissue) = (2, 1);
        let home = SceneHome { position_mm: [1.0, -2.0, -11.0], node: 4, from_edge_mm: 0.5 };
        let beyond = SceneHome { node: 99, ..home };
        let mut tissue = Tissue::default();
        tissue.take(&nodes, &triangles, &[home, beyond], 1);
        assert_eq!(tissue.counts(), [2, 1]);
        assert_eq!(tissue.triangles()[2..], [triangles[3].nodes, triangles[1].nodes]);
        let there = TissueHome { in_map: fundus_map::coordinates(home.position_mm), from_edge_mm: 0.5 };
        assert_eq!(tissue.homes()[4], there);
        nodes[4].position_mm = [3.0, 1.0, -9.0];
        tissue.take(&nodes, &triangles, &[home], 2);
        assert_eq!((tissue.homes()[4], tissue.homes().len()), (there, nodes.len()));
    }

    #[test]
    fn broken_input_is_left_out() {
        let (mut nodes, mut triangles) = square();
        nodes[2].position_mm[0] = f32::NAN;
        triangles.push(SceneTriangle { nodes: [0, 1, 99], tissue: 0 });
        let mut tissue = Tissue::default();
        tissue.take(&nodes, &triangles, &[], 1);
        assert_eq!((tissue.triangles().len(), tissue.refused), (4, 1));
        let finite = |v: &TissueVertex| v.position.iter().chain(&v.normal).all(|c| c.is_finite());
        assert!(tissue.vertices(&[Mat4::IDENTITY; 2], RADIUS_MM).iter().all(finite));
        // Fewer nodes under the same topology number must not leave dangling indices.
        assert!(tissue.take(&nodes[..3], &triangles, &[], 1));
        assert!(tissue.triangles().iter().flatten().all(|&n| n < 3));
    }
}
