//! Trees of bounding spheres (Hubbard 1995; Quinlan 1994): over the membrane refitted every frame,
//! over the instrument static, with the exact test behind them.

use crate::peers::Method;
use crate::setting::{Frame, Setting};
use crate::trees::{Below, intersecting};
use validation::exact::tritri::Corner;

/// Added to every radius: larger than any rounding of `f32` in it, in grid steps.
const SLACK: f32 = 1.0;

#[derive(Debug, Clone, Copy)]
struct Sphere {
    at: [f32; 3],
    radius: f32,
}

/// Nodes with children before parents; the root is the last.
struct Tree {
    below: Vec<Below>,
    sphere: Vec<Sphere>,
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum::<f32>().sqrt()
}

fn around(corners: [Corner; 3]) -> Sphere {
    let corners = corners.map(|c| c.map(|c| c as f32));
    let at = std::array::from_fn(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0);
    let radius = corners.iter().map(|c| distance(*c, at)).fold(0.0, f32::max) + SLACK;
    Sphere { at, radius }
}

fn around_two(a: Sphere, b: Sphere) -> Sphere {
    let apart = distance(a.at, b.at);
    if apart + b.radius <= a.radius {
        return a;
    }
    if apart + a.radius <= b.radius {
        return b;
    }
    let radius = 0.5 * (apart + a.radius + b.radius);
    let share = (radius - a.radius) / apart;
    Sphere { at: std::array::from_fn(|k| a.at[k] + (b.at[k] - a.at[k]) * share), radius: radius + SLACK }
}

impl Tree {
    fn new(corners: impl Fn(u32) -> [Corner; 3], count: u32) -> Self {
        let mut tree = Tree { below: Vec::new(), sphere: Vec::new() };
        let spheres: Vec<Sphere> = (0..count).map(|t| around(corners(t))).collect();
        tree.add(&mut (0..count).collect::<Vec<_>>(), &spheres);
        tree
    }

    /// Halves along the longest side; returns the node.
    fn add(&mut self, members: &mut [u32], spheres: &[Sphere]) -> u32 {
        let (below, sphere) = if let [t] = *members {
            (Below::Triangle(t), spheres[t as usize])
        } else {
            let along = |k: usize| members.iter().map(move |&t| spheres[t as usize].at[k]);
            let extent = |k: usize| along(k).fold(f32::MIN, f32::max) - along(k).fold(f32::MAX, f32::min);
            let axis = (0..3).max_by(|&a, &b| extent(a).total_cmp(&extent(b))).unwrap_or(0);
            let half = members.len() / 2;
            members.select_nth_unstable_by(half, |&a, &b| {
                spheres[a as usize].at[axis].total_cmp(&spheres[b as usize].at[axis])
            });
            let (left, right) = members.split_at_mut(half);
            let (left, right) = (self.add(left, spheres), self.add(right, spheres));
            let [a, b] = [left, right].map(|n| self.sphere[n as usize]);
            (Below::Nodes(left, right), around_two(a, b))
        };
        self.below.push(below);
        self.sphere.push(sphere);
        self.below.len() as u32 - 1
    }

    fn refit(&mut self, corners: impl Fn(u32) -> [Corner; 3]) {
        for i in 0..self.below.len() {
            self.sphere[i] = match self.below[i] {
                Below::Triangle(t) => around(corners(t)),
                Below::Nodes(a, b) => around_two(self.sphere[a as usize], self.sphere[b as usize]),
            };
        }
    }
}

/// Both trees.
pub struct SphereTrees {
    membrane: Tree,
    instrument: Tree,
    corners: Vec<Corner>,
    stack: Vec<(u32, u32)>,
    pairs: Vec<(u32, u32)>,
}

impl SphereTrees {
    /// Builds both trees.
    pub fn new(setting: &Setting) -> Self {
        let mut corners = Vec::new();
        setting.frame().on_grid(&mut corners);
        let count = setting.triangles.len() as u32;
        let membrane = Tree::new(|t| setting.triangles[t as usize].map(|v| corners[v as usize]), count);
        let tool = setting.mesh.triangles();
        let instrument = Tree::new(|t| tool[t as usize].0.corners, tool.len() as u32);
        SphereTrees { membrane, instrument, corners, stack: Vec::new(), pairs: Vec::new() }
    }
}

impl Method for SphereTrees {
    fn name(&self) -> &'static str {
        "spheres"
    }
    fn update(&mut self, frame: &Frame) {
        frame.on_grid(&mut self.corners);
        let corners = &self.corners;
        self.membrane.refit(|t| frame.surface.triangles[t as usize].map(|v| corners[v as usize]));
    }
    fn query(&mut self, frame: &Frame) -> usize {
        let SphereTrees { membrane, instrument, corners, stack, pairs } = self;
        pairs.clear();
        let of = |m: usize, i: usize| (membrane.sphere[m], instrument.sphere[i]);
        let meets = |m, i| {
            let (a, b) = of(m, i);
            distance(a.at, b.at) <= a.radius + b.radius
        };
        let is_larger = |m, i| {
            let (a, b) = of(m, i);
            a.radius > b.radius
        };
        let nodes: [&[Below]; 2] = [&membrane.below, &instrument.below];
        intersecting(frame, corners, nodes, stack, meets, is_larger, pairs);
        pairs.len()
    }
    fn pairs(&self) -> Vec<(u32, u32)> {
        self.pairs.clone()
    }
}
