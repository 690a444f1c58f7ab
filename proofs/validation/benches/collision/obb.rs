//! Trees of oriented boxes (Gottschalk, Lin, Manocha, "OBBTree: a hierarchical structure for rapid interference
//! detection", 1996): the membrane's is rebuilt every frame, as RAPID's must be when the mesh deforms, and the
//! instrument's once, with the exact test behind them. Stands for RAPID in the paper's Table 2.

use crate::peers::Method;
use crate::setting::{Frame, Setting};
use crate::trees::{Below, intersecting};
use nalgebra::{Matrix3, Vector3};
use validation::exact::tritri::Corner;

/// Added to every half side, in grid steps: more than the rounding of `f32` in the tests.
const SLACK: f32 = 2.0;
/// Added to the cosines between axes, so that parallel edges do not divide boxes that touch.
const PARALLEL: f32 = 1e-5;

/// A box: centre, axes as columns, half sides along them.
#[derive(Debug, Clone, Copy)]
struct Oriented {
    centre: Vector3<f32>,
    axes: Matrix3<f32>,
    half: Vector3<f32>,
}

/// Nodes with children before parents; the root is the last.
#[derive(Default)]
struct Tree {
    below: Vec<Below>,
    boxes: Vec<Oriented>,
    members: Vec<u32>,
}

/// Corners of a triangle.
type Corners = [Vector3<f32>; 3];

/// Area, centroid, and the second moment about the origin times the area, of a triangle (section 4 of the paper).
fn moments([p, q, r]: &Corners) -> (f32, Vector3<f32>, Matrix3<f32>) {
    let area = 0.5 * (q - p).cross(&(r - p)).norm();
    let centroid = (p + q + r) / 3.0;
    let own = p * p.transpose() + q * q.transpose() + r * r.transpose();
    (area, centroid, (centroid * centroid.transpose() * 9.0 + own) * (area / 12.0))
}

impl Oriented {
    /// Around triangles, with axes along the principal directions of their surface; and its centroid.
    fn around(corners: &[Corners], members: &[u32]) -> (Self, Vector3<f32>) {
        let (mut area, mut mean, mut second) = (0.0f32, Vector3::zeros(), Matrix3::zeros());
        for &t in members {
            let (own, centroid, moment) = moments(&corners[t as usize]);
            area += own;
            mean += centroid * own;
            second += moment;
        }
        let mean = if area > 0.0 { mean / area } else { corners[members[0] as usize][0] };
        let covariance = second / area.max(f32::MIN_POSITIVE) - mean * mean.transpose();
        let axes = covariance.symmetric_eigen().eigenvectors;
        let (mut low, mut high) = (Vector3::repeat(f32::MAX), Vector3::repeat(f32::MIN));
        for point in members.iter().flat_map(|&t| &corners[t as usize]) {
            let along = axes.tr_mul(point);
            (low, high) = (low.inf(&along), high.sup(&along));
        }
        let half = (high - low) * 0.5 + Vector3::repeat(SLACK);
        (Oriented { centre: axes * ((low + high) * 0.5), axes, half }, mean)
    }

    /// False where one of the 15 axes divides the boxes.
    fn meets(&self, other: &Oriented) -> bool {
        let turn = self.axes.tr_mul(&other.axes);
        let wide = turn.map(|c| c.abs() + PARALLEL);
        let off = self.axes.tr_mul(&(other.centre - self.centre));
        let (a, b) = (&self.half, &other.half);
        let by_own = (0..3).any(|i| off[i].abs() > a[i] + wide.row(i).transpose().dot(b));
        let by_other = |j: usize| off.dot(&turn.column(j)).abs() > b[j] + wide.column(j).dot(a);
        let by_edges = |i: usize, j: usize| {
            let ([k, l], [m, n]) = ([(i + 1) % 3, (i + 2) % 3], [(j + 1) % 3, (j + 2) % 3]);
            let own = a[k] * wide[(l, j)] + a[l] * wide[(k, j)];
            let its = b[m] * wide[(i, n)] + b[n] * wide[(i, m)];
            (off[l] * turn[(k, j)] - off[k] * turn[(l, j)]).abs() > own + its
        };
        !(by_own || (0..3).any(by_other) || (0..3).any(|i| (0..3).any(|j| by_edges(i, j))))
    }

    fn size(&self) -> f32 {
        self.half.max()
    }
}

impl Tree {
    /// Rebuilds it in the same memory.
    fn build(&mut self, corners: &[Corners]) {
        self.below.clear();
        self.boxes.clear();
        let mut members = std::mem::take(&mut self.members);
        members.clear();
        members.extend(0..corners.len() as u32);
        self.add(&mut members, corners);
        self.members = members;
    }

    /// Divides at the centroid along the longest side that divides, as RAPID does; returns the node.
    fn add(&mut self, members: &mut [u32], corners: &[Corners]) -> u32 {
        let (around, mean) = Oriented::around(corners, members);
        let below = if let [t] = *members {
            Below::Triangle(t)
        } else {
            let at = divide(members, corners, &around, &mean);
            let (left, right) = members.split_at_mut(at);
            Below::Nodes(self.add(left, corners), self.add(right, corners))
        };
        self.below.push(below);
        self.boxes.push(around);
        self.below.len() as u32 - 1
    }
}

/// Puts the members on one side of the centroid first; how many they are. Halves them where no side divides.
fn divide(members: &mut [u32], corners: &[Corners], around: &Oriented, mean: &Vector3<f32>) -> usize {
    let mut sides = [0, 1, 2];
    sides.sort_by(|&a, &b| around.half[b].total_cmp(&around.half[a]));
    for side in sides {
        let axis = around.axes.column(side);
        let limit = axis.dot(mean);
        let mut first = 0;
        for i in 0..members.len() {
            let [p, q, r] = &corners[members[i] as usize];
            if axis.dot(&(p + q + r)) < 3.0 * limit {
                members.swap(i, first);
                first += 1;
            }
        }
        if first > 0 && first < members.len() {
            return first;
        }
    }
    members.len() / 2
}

/// Both trees.
pub struct ObbTrees {
    membrane: Tree,
    instrument: Tree,
    on_grid: Vec<Corner>,
    corners: Vec<Corners>,
    stack: Vec<(u32, u32)>,
    pairs: Vec<(u32, u32)>,
}

fn float(corners: [Corner; 3]) -> Corners {
    corners.map(|c| Vector3::from(c.map(|v| v as f32)))
}

impl ObbTrees {
    /// Builds the instrument's.
    pub fn new(setting: &Setting) -> Self {
        let tool: Vec<Corners> = setting.mesh.triangles().iter().map(|(t, _)| float(t.corners)).collect();
        let mut instrument = Tree::default();
        instrument.build(&tool);
        let membrane = Tree::default();
        ObbTrees { membrane, instrument, on_grid: vec![], corners: vec![], stack: vec![], pairs: vec![] }
    }
}

impl Method for ObbTrees {
    fn name(&self) -> &'static str {
        "obb-rebuilt"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.on_grid);
        self.corners.clear();
        let of = |t: &[u32; 3]| float(t.map(|v| self.on_grid[v as usize]));
        self.corners.extend(frame.surface.triangles.iter().map(of));
        self.membrane.build(&self.corners);
    }
    fn query(&mut self, frame: &Frame) -> usize {
        let ObbTrees { membrane, instrument, on_grid, stack, pairs, .. } = self;
        pairs.clear();
        let meets = |m: usize, i: usize| membrane.boxes[m].meets(&instrument.boxes[i]);
        let is_larger = |m: usize, i: usize| membrane.boxes[m].size() > instrument.boxes[i].size();
        let nodes: [&[Below]; 2] = [&membrane.below, &instrument.below];
        intersecting(frame, on_grid, nodes, stack, meets, is_larger, pairs);
        pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}
