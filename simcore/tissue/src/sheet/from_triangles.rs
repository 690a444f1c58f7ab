//! Makes a sheet of any manifold triangle mesh, or says which element forbids it.
//!
//! Structural springs are the edges; a bending spring joins the two vertices opposite each interior
//! edge. Nodes are renumbered for locality ([`super::cuthill_mckee`]); [`SheetMesh::order`]
//! keeps their original numbers.

use super::cuthill_mckee::cuthill_mckee;
use super::mesh::{Bend, NONE, SheetMesh};
use nalgebra::Vector3;
use scene::{MeshScene, Pinned};

/// Shortest edge and smallest triangle height that still has a direction in single precision, mm: 1
/// nm.
const SMALLEST_MM: f64 = 1e-6;

/// Why a mesh cannot be a sheet. Nodes and triangles are numbered as the caller numbers them.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum MeshError {
    #[error("the mesh has no triangles")]
    Empty,
    #[error("{found} nodes or edges; indices have 32 bits and the largest means \"none\"")]
    TooLarge { found: usize },
    #[error("node {node}: expected finite coordinates, found {found:?}")]
    NotFinite { node: usize, found: [f32; 3] },
    #[error("node {node} belongs to no triangle")]
    LooseNode { node: usize },
    #[error("triangle {triangle} names node {node}; there are {nodes} nodes")]
    NoSuchNode { triangle: usize, node: u32, nodes: usize },
    #[error("pinned node {node}: there are {nodes} nodes")]
    NoSuchPin { node: u32, nodes: usize },
    #[error("triangle {triangle} names node {node} twice")]
    RepeatedNode { triangle: usize, node: u32 },
    #[error("triangle {triangle} is degenerate: its area is {area_mm2:e} mm²")]
    Degenerate { triangle: usize, area_mm2: f64 },
    #[error("triangles {first} and {second} have the same nodes")]
    Duplicate { first: usize, second: usize },
    #[error(
        "edge between nodes {nodes:?}: expected at most two triangles, found {first}, {second} and {third}"
    )]
    NonManifoldEdge { nodes: [u32; 2], first: usize, second: usize, third: usize },
    #[error(
        "edge between nodes {nodes:?}: triangles {first} and {second} are wound in opposite senses; \
         neighbours must both be counter-clockwise"
    )]
    Winding { nodes: [u32; 2], first: usize, second: usize },
    #[error(
        "spring between nodes {nodes:?} has length {length_mm:e} mm; at least {SMALLEST_MM:e} mm is needed"
    )]
    ZeroLength { nodes: [u32; 2], length_mm: f64 },
    #[error("{what} of spring {spring}: expected a finite number of at least 0, found {found}")]
    Factor { what: &'static str, spring: usize, found: f32 },
    #[error("{what}: expected a number for each of {expected} springs, found {found}")]
    Factors { what: &'static str, expected: usize, found: usize },
}

/// An edge with its triangles, and for each the vertex opposite.
struct Edge {
    nodes: [u32; 2],
    triangles: [u32; 2],
    opposite: [u32; 2],
}

impl SheetMesh {
    /// A sheet of springs on any manifold mesh of consistently wound triangles. `pinned` nodes are
    /// held where they are. Positions are in the eye frame, mm. The sheet numbers nodes, and sorts
    /// triangles, in an order of its own: the caller's node `i` is node [`SheetMesh::order`]`[i]`.
    ///
    /// # Errors
    /// With the element that forbids it.
    pub fn from_triangles(
        positions_mm: &[[f32; 3]],
        triangles: &[[u32; 3]],
        pinned: &[u32],
    ) -> Result<SheetMesh, MeshError> {
        check_nodes(positions_mm, triangles, pinned)?;
        check_areas(positions_mm, triangles)?;
        let edges: Vec<[u32; 2]> = edges_of(triangles)?.iter().map(|e| e.nodes).collect();
        let named = cuthill_mckee(positions_mm.len(), &edges);
        let mut order = vec![0; named.len()];
        named.iter().enumerate().for_each(|(new, &old)| order[old as usize] = new as u32);
        let sheet = SheetMesh::renumbered(positions_mm, triangles, pinned, order)?;
        sheet.check_lengths(&named)?;
        Ok(sheet)
    }

    /// The sheet of a scene's own mesh, turned so that its front looks into the eye, held by its
    /// edge or by nothing.
    pub(super) fn of_mesh(mesh: &MeshScene) -> Result<SheetMesh, MeshError> {
        let positions = &mesh.positions_mm;
        check_nodes(positions, &mesh.triangles, &[])?;
        check_areas(positions, &mesh.triangles)?;
        let edges = edges_of(&mesh.triangles)?;
        let inwards = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| Vector3::from(positions[n as usize]).map(f64::from));
            -(b - a).cross(&(c - a)).dot(&(a + b + c))
        };
        let mut triangles = mesh.triangles.clone();
        if triangles.iter().map(inwards).sum::<f64>() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let outer = edges.iter().filter(|e| e.triangles[1] == NONE && mesh.pinned == Pinned::Edge);
        let pinned: Vec<u32> = outer.flat_map(|e| e.nodes).collect();
        SheetMesh::from_triangles(positions, &triangles, &pinned)
    }

    fn renumbered(
        positions_mm: &[[f32; 3]],
        triangles: &[[u32; 3]],
        pinned: &[u32],
        order: Vec<u32>,
    ) -> Result<SheetMesh, MeshError> {
        let mut start_mm = std::array::from_fn(|_| vec![0.0; order.len()]);
        for (p, &node) in positions_mm.iter().zip(&order) {
            (0..3).for_each(|axis| start_mm[axis][node as usize] = p[axis]);
        }
        let mut turned: Vec<[u32; 3]> =
            triangles.iter().map(|t| lowest_first(t.map(|n| order[n as usize]))).collect();
        turned.sort_unstable();
        let edges = edges_of(&turned)?;
        let mut sheet = SheetMesh { start_mm, triangles: turned, order, ..SheetMesh::default() };
        sheet.springs = edges.iter().map(|e| e.nodes).collect();
        sheet.structural = edges.len();
        sheet.spring_triangles = edges.iter().map(|e| e.triangles).collect();
        sheet.triangle_springs = springs_of(&edges, sheet.triangles.len());
        for edge in edges.iter().filter(|e| e.triangles[1] != NONE) {
            let [p, q] = edge.opposite;
            // Two triangles over the same three nodes were refused, but a closed mesh of four nodes
            // has opposite vertices that an edge joins already; a second spring there does no harm.
            sheet.springs.push([p.min(q), p.max(q)]);
            sheet.bends.push(Bend::Hinge(edge.triangles));
        }
        sheet.rim = pinned.iter().map(|&n| sheet.order[n as usize]).collect();
        sheet.rim.sort_unstable();
        sheet.rim.dedup();
        sheet.index();
        Ok(sheet)
    }

    fn check_lengths(&self, named: &[u32]) -> Result<(), MeshError> {
        for &ends in &self.springs {
            let [a, b] = ends.map(|n| self.at(n).map(f64::from));
            let length_mm = (a - b).norm();
            if length_mm < SMALLEST_MM {
                return Err(MeshError::ZeroLength { nodes: ends.map(|n| named[n as usize]), length_mm });
            }
        }
        Ok(())
    }

    /// Stiffness and damping of each spring as factors on those of the tissue (1 where nothing is
    /// said): structural springs first, then bending springs, in the order of
    /// [`SheetMesh::springs`].
    ///
    /// # Errors
    /// If a list has another length, or a factor is negative or not finite.
    pub fn with_factors(mut self, stiffness: &[f32], damping: &[f32]) -> Result<SheetMesh, MeshError> {
        let (expected, lists) = (self.springs.len(), [("stiffness", stiffness), ("damping", damping)]);
        for (what, list) in lists {
            if list.len() != expected {
                return Err(MeshError::Factors { what, expected, found: list.len() });
            }
            if let Some(spring) = list.iter().position(|&f| !(f.is_finite() && f >= 0.0)) {
                return Err(MeshError::Factor { what, spring, found: list[spring] });
            }
        }
        self.stiffness_factor = stiffness.to_vec();
        self.damping_factor = damping.to_vec();
        Ok(self)
    }
}

fn check_nodes(positions_mm: &[[f32; 3]], triangles: &[[u32; 3]], pinned: &[u32]) -> Result<(), MeshError> {
    let nodes = positions_mm.len();
    // An edge index is at most three times a triangle's, and bending springs at most double that.
    let most = nodes.max(triangles.len().saturating_mul(6));
    if most >= NONE as usize {
        return Err(MeshError::TooLarge { found: most });
    }
    if triangles.is_empty() {
        return Err(MeshError::Empty);
    }
    if let Some(node) = positions_mm.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(MeshError::NotFinite { node, found: positions_mm[node] });
    }
    let mut used = vec![false; nodes];
    for (triangle, names) in triangles.iter().enumerate() {
        if let Some(&node) = names.iter().find(|&&n| n as usize >= nodes) {
            return Err(MeshError::NoSuchNode { triangle, node, nodes });
        }
        let [a, b, c] = *names;
        if a == b || b == c || c == a {
            return Err(MeshError::RepeatedNode { triangle, node: if a == b { a } else { c } });
        }
        names.iter().for_each(|&n| used[n as usize] = true);
    }
    if let Some(node) = used.iter().position(|u| !u) {
        return Err(MeshError::LooseNode { node });
    }
    match pinned.iter().find(|&&n| n as usize >= nodes) {
        Some(&node) => Err(MeshError::NoSuchPin { node, nodes }),
        None => Ok(()),
    }
}

/// Edges of no length are named before triangles of no height, because they are the cause.
fn check_areas(positions_mm: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<(), MeshError> {
    for (triangle, names) in triangles.iter().enumerate() {
        let p = names.map(|n| Vector3::from(positions_mm[n as usize]).map(f64::from));
        let sides = [0, 1, 2].map(|i| (p[(i + 1) % 3] - p[i]).norm());
        if let Some(i) = sides.iter().position(|&s| s < SMALLEST_MM) {
            return Err(MeshError::ZeroLength { nodes: [names[i], names[(i + 1) % 3]], length_mm: sides[i] });
        }
        let area_mm2 = 0.5 * (p[1] - p[0]).cross(&(p[2] - p[0])).norm();
        let longest = sides.iter().fold(0.0, |m: f64, &s| m.max(s));
        if 2.0 * area_mm2 < SMALLEST_MM * longest {
            return Err(MeshError::Degenerate { triangle, area_mm2 });
        }
    }
    Ok(())
}

/// Edges in order of their nodes, lower node first.
fn edges_of(triangles: &[[u32; 3]]) -> Result<Vec<Edge>, MeshError> {
    // Per half-edge: ends in order, triangle, opposite vertex, whether it runs from the lower node
    // to the higher.
    let mut halves: Vec<([u32; 2], u32, u32, bool)> = Vec::with_capacity(3 * triangles.len());
    for (t, &[a, b, c]) in triangles.iter().enumerate() {
        for (from, to, opposite) in [(a, b, c), (b, c, a), (c, a, b)] {
            halves.push(([from.min(to), from.max(to)], t as u32, opposite, from < to));
        }
    }
    halves.sort_unstable();
    let mut edges = Vec::with_capacity(halves.len() / 2 + 1);
    for shared in halves.chunk_by(|a, b| a.0 == b.0) {
        let (nodes, first, opposite, sense) = shared[0];
        let triangle = |i: usize| shared[i].1 as usize;
        let mut edge = Edge { nodes, triangles: [first, NONE], opposite: [opposite, NONE] };
        if let Some(&(_, second, other, second_sense)) = shared.get(1) {
            if other == opposite {
                return Err(MeshError::Duplicate { first: triangle(0), second: triangle(1) });
            }
            if shared.len() > 2 {
                let [first, second, third] = [triangle(0), triangle(1), triangle(2)];
                return Err(MeshError::NonManifoldEdge { nodes, first, second, third });
            }
            if second_sense == sense {
                return Err(MeshError::Winding { nodes, first: triangle(0), second: triangle(1) });
            }
            (edge.triangles[1], edge.opposite[1]) = (second, other);
        }
        edges.push(edge);
    }
    Ok(edges)
}

fn springs_of(edges: &[Edge], triangles: usize) -> Vec<[u32; 3]> {
    let mut springs = vec![[NONE; 3]; triangles];
    for (s, edge) in edges.iter().enumerate() {
        for &t in edge.triangles.iter().filter(|&&t| t != NONE) {
            let free =
                springs[t as usize].iter_mut().find(|s| **s == NONE).expect("a triangle has three edges");
            *free = s as u32;
        }
    }
    springs
}

/// Turns a triangle so that its lowest node comes first; its sense stays.
fn lowest_first(mut triangle: [u32; 3]) -> [u32; 3] {
    let lowest = (0..3).min_by_key(|&i| triangle[i]).unwrap_or(0);
    triangle.rotate_left(lowest);
    triangle
}

#[cfg(test)]
mod tests {
    use super::super::tearing::check_mesh;
    use super::*;

    /// Two triangles over a unit square.
    const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    const HALVES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    fn refusal(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> String {
        SheetMesh::from_triangles(positions, triangles, &[]).unwrap_err().to_string()
    }

    #[test]
    fn a_square_has_five_edges_one_hinge_and_the_callers_names() {
        let sheet = SheetMesh::from_triangles(&SQUARE, &HALVES, &[1]).unwrap();
        assert_eq!((sheet.structural, sheet.springs.len(), sheet.triangles.len()), (5, 6, 2));
        for (old, p) in SQUARE.iter().enumerate() {
            assert_eq!(sheet.at(sheet.order[old]), Vector3::from(*p));
        }
        assert_eq!(sheet.rim, [sheet.order[1]]);
        let mut hinge = [sheet.order[1], sheet.order[3]];
        hinge.sort_unstable();
        assert_eq!(sheet.springs[5], hinge);
        assert!((sheet.rest_mm[5] - 2f32.sqrt()).abs() < 1e-6);
        check_mesh(&sheet, &sheet.start()).unwrap();
    }

    #[test]
    fn triangles_keep_their_sense() {
        let sheet = SheetMesh::from_triangles(&SQUARE, &HALVES, &[]).unwrap();
        for t in &sheet.triangles {
            let [a, b, c] = t.map(|n| sheet.at(n));
            assert!((b - a).cross(&(c - a)).z > 0.0);
        }
    }

    #[test]
    fn bad_meshes_are_refused_with_the_element_named() {
        let with = |extra: [f32; 3]| [&SQUARE[..], &[extra]].concat();
        assert!(refusal(&SQUARE, &[]).contains("no triangles"));
        assert!(refusal(&SQUARE, &[[0, 1, 2], [0, 2, 7]]).contains("triangle 1 names node 7; there are 4"));
        assert!(refusal(&SQUARE, &[[0, 1, 2], [0, 3, 3]]).contains("triangle 1 names node 3 twice"));
        assert!(refusal(&SQUARE, &[[0, 1, 2]]).contains("node 3 belongs to no triangle"));
        assert!(refusal(&with([f32::NAN, 0.0, 0.0]), &HALVES).contains("node 4: expected finite"));
        assert!(refusal(&SQUARE, &[[0, 1, 2], [0, 2, 3], [2, 0, 1]]).contains("triangles 0 and 2"));
        assert!(refusal(&SQUARE, &[[0, 1, 2], [0, 2, 3], [1, 0, 2]]).contains("same nodes"));
        let book = [[0, 1, 2], [0, 2, 3], [0, 2, 4]];
        let text = refusal(&with([0.5, 0.5, 1.0]), &book);
        assert!(text.contains("[0, 2]") && text.contains("0, 1 and 2"), "{text}");
        assert!(refusal(&SQUARE, &[[0, 1, 2], [0, 3, 2]]).contains("opposite senses"));
        let flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        assert!(refusal(&flat, &[[0, 1, 2]]).contains("triangle 0 is degenerate"));
        let point = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        assert!(refusal(&point, &[[0, 1, 2]]).contains("between nodes [0, 1] has length"));
        let pin = SheetMesh::from_triangles(&SQUARE, &HALVES, &[9]).unwrap_err().to_string();
        assert!(pin.contains("pinned node 9"), "{pin}");
    }

    #[test]
    fn folded_onto_itself_a_bending_spring_would_have_no_length() {
        let folded = [SQUARE[0], SQUARE[1], SQUARE[2], SQUARE[1]];
        assert!(refusal(&folded, &HALVES).contains("between nodes ["));
    }

    #[test]
    fn factors_must_be_numbers_that_are_not_negative() {
        let sheet = || SheetMesh::from_triangles(&SQUARE, &HALVES, &[]).unwrap();
        let (ones, mut bad) = (vec![1.0; 6], vec![1.0; 6]);
        assert!(sheet().with_factors(&ones, &ones).is_ok());
        assert!(
            sheet().with_factors(&ones[1..], &ones).unwrap_err().to_string().contains("6 springs, found 5")
        );
        bad[4] = -2.0;
        let text = sheet().with_factors(&bad, &ones).unwrap_err().to_string();
        assert!(text.contains("stiffness of spring 4") && text.contains("-2"), "{text}");
        bad[4] = f32::NAN;
        assert!(sheet().with_factors(&ones, &bad).unwrap_err().to_string().contains("damping of spring 4"));
    }
}
