//! Which nodes are loose together: the blebs, their triangles, and the front where they end.
//!
//! Everything here follows from flags and living triangles alone, and is rebuilt when those
//! change; nothing of it is state. A gap that was torn into a bleb is still spanned by its dead
//! triangles for the sake of the volume, as if by a film.

use super::figures::{MAX_BLEBS, OPEN_MM2};
use super::state::RetinaState;
use crate::sheet::mesh::{NONE, SheetMesh};
use crate::sheet::state::NODE_PINNED;
use nalgebra::Vector3;
use std::ops::Range;

/// A node of the choroid's edge of a bleb: it holds, and a neighbour is loose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontNode {
    /// The node.
    pub node: u32,
    /// Its bleb.
    pub bleb: u8,
    /// Length of rim that it holds, mm.
    pub rim_mm: f64,
}

/// A living spring from a front node to a loose one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pull {
    /// The spring.
    pub spring: u32,
    /// Place of the front node in [`Blebs::front`].
    pub front: u32,
    /// The loose node.
    pub loose: u32,
}

/// The blebs of a state.
#[derive(Debug, Default)]
pub struct Blebs {
    /// Bleb of each node + 1, 0 for none.
    pub label: Vec<u8>,
    /// Loose nodes, bleb by bleb.
    nodes: Vec<u32>,
    node_start: Vec<u32>,
    /// Triangles with a loose node, dead ones too, bleb by bleb.
    triangles: Vec<u32>,
    triangle_start: Vec<u32>,
    /// The front, bleb by bleb.
    pub front: Vec<FrontNode>,
    /// What pulls at it.
    pub pulls: Vec<Pull>,
    /// Places in [`Self::front`] of front nodes that are joined along the rim.
    pub rims: Vec<[u32; 2]>,
    /// Area of dead triangles of each bleb as they lay at the start, mm².
    pub torn_mm2: Vec<f64>,
    /// Blebs whose gaps are so large that fluid passes freely. What is under one is measured under
    /// its living triangles alone.
    pub open: Vec<bool>,
    /// Area of each bleb as it lay at the start, mm².
    pub area_mm2: Vec<f64>,
    taken_triangle: Vec<bool>,
    taken_spring: Vec<bool>,
    slot: Vec<u32>,
}

impl Blebs {
    /// Lists with room for every node of `sheet`.
    pub fn new(sheet: &SheetMesh) -> Self {
        let (nodes, triangles, springs) = (sheet.nodes(), sheet.triangles.len(), sheet.structural);
        Blebs {
            label: vec![0; nodes],
            nodes: Vec::with_capacity(nodes),
            node_start: Vec::with_capacity(MAX_BLEBS + 1),
            triangles: Vec::with_capacity(triangles),
            triangle_start: Vec::with_capacity(MAX_BLEBS + 1),
            // A front node may hold several blebs, each by another spring.
            front: Vec::with_capacity(springs),
            pulls: Vec::with_capacity(springs),
            rims: Vec::with_capacity(2 * springs),
            torn_mm2: Vec::with_capacity(MAX_BLEBS),
            open: Vec::with_capacity(MAX_BLEBS),
            area_mm2: Vec::with_capacity(MAX_BLEBS),
            taken_triangle: vec![false; triangles],
            taken_spring: vec![false; springs],
            slot: vec![NONE; nodes],
        }
    }

    /// Blebs there are.
    pub fn count(&self) -> usize {
        self.node_start.len().saturating_sub(1)
    }

    /// Loose nodes of a bleb.
    pub fn nodes_of(&self, bleb: usize) -> &[u32] {
        &self.nodes[range(&self.node_start, bleb)]
    }

    /// Triangles of a bleb, those torn out of it too.
    pub fn triangles_of(&self, bleb: usize) -> &[u32] {
        &self.triangles[range(&self.triangle_start, bleb)]
    }

    /// Loose nodes of all blebs.
    pub fn loose(&self) -> &[u32] {
        &self.nodes
    }

    /// Finds the pieces of a state. `home_mm2` has the area of each triangle as it lay at the
    /// start.
    pub fn find(&mut self, sheet: &SheetMesh, state: &RetinaState, home_mm2: &[f32]) {
        self.clear();
        for node in 0..sheet.nodes() {
            if state.is_loose(node) && self.label[node] == 0 {
                if self.node_start.len() < MAX_BLEBS {
                    self.begin();
                }
                self.flood(sheet, state, node as u32);
            }
        }
        if self.node_start.last().is_some_and(|&s| (s as usize) < self.nodes.len()) {
            self.begin();
        }
        for bleb in 0..self.count() {
            self.take_triangles(sheet, bleb);
            self.find_front(sheet, state, bleb);
            let (mut torn, mut area) = (0.0, 0.0);
            for &t in self.triangles_of(bleb) {
                area += f64::from(home_mm2[t as usize]);
                let dead = state.sheet.triangle_alive[t as usize] == 0;
                torn += if dead { f64::from(home_mm2[t as usize]) } else { 0.0 };
            }
            self.torn_mm2.push(torn);
            self.open.push(torn > OPEN_MM2);
            self.area_mm2.push(area);
        }
    }

    fn clear(&mut self) {
        self.label.fill(0);
        self.taken_triangle.fill(false);
        self.taken_spring.fill(false);
        self.slot.fill(NONE);
        self.front.clear();
        self.pulls.clear();
        self.rims.clear();
        for list in [&mut self.nodes, &mut self.node_start, &mut self.triangles, &mut self.triangle_start] {
            list.clear();
        }
        self.torn_mm2.clear();
        self.open.clear();
        self.area_mm2.clear();
    }

    /// The nodes found from here on are a new bleb; called once more after the last.
    fn begin(&mut self) {
        self.node_start.push(self.nodes.len() as u32);
    }

    /// Labels every loose node that hangs together with `first`.
    fn flood(&mut self, sheet: &SheetMesh, state: &RetinaState, first: u32) {
        let label = self.node_start.len() as u8;
        let mut next = self.nodes.len();
        (self.label[first as usize], _) = (label, self.nodes.push(first));
        while next < self.nodes.len() {
            let node = self.nodes[next] as usize;
            next += 1;
            for &t in sheet.triangles_of(node) {
                for n in sheet.triangles[t as usize] {
                    if self.label[n as usize] == 0 && state.is_loose(n as usize) {
                        self.label[n as usize] = label;
                        self.nodes.push(n);
                    }
                }
            }
        }
    }

    fn take_triangles(&mut self, sheet: &SheetMesh, bleb: usize) {
        if bleb == 0 {
            self.triangle_start.push(0);
        }
        for i in range(&self.node_start, bleb) {
            for &t in sheet.triangles_of(self.nodes[i] as usize) {
                if !self.taken_triangle[t as usize] {
                    self.taken_triangle[t as usize] = true;
                    self.triangles.push(t);
                }
            }
        }
        self.triangle_start.push(self.triangles.len() as u32);
    }

    fn find_front(&mut self, sheet: &SheetMesh, state: &RetinaState, bleb: usize) {
        let (begin, label) = (self.front.len(), bleb as u8 + 1);
        let holds = |n: u32| state.sheet.flag[n as usize] == NODE_PINNED;
        for i in range(&self.triangle_start, bleb) {
            let t = self.triangles[i] as usize;
            if state.sheet.triangle_alive[t] == 0 {
                continue;
            }
            for &s in &sheet.triangle_springs[t] {
                let [a, b] = sheet.springs[s as usize];
                match (holds(a), holds(b)) {
                    (true, true) => {
                        let length = state.sheet.position(a as usize) - state.sheet.position(b as usize);
                        let half = 0.5 * f64::from(length.norm());
                        let slots = [a, b].map(|n| self.slot(n, bleb as u8));
                        slots.iter().for_each(|&slot| self.front[slot].rim_mm += half);
                        self.rims.push(slots.map(|slot| slot as u32));
                    }
                    (true, false) => self.add_pull(s, a, b, label),
                    (false, true) => self.add_pull(s, b, a, label),
                    (false, false) => {}
                }
            }
        }
        for front in &self.front[begin..] {
            self.slot[front.node as usize] = NONE;
        }
    }

    fn slot(&mut self, node: u32, bleb: u8) -> usize {
        if self.slot[node as usize] == NONE {
            self.slot[node as usize] = self.front.len() as u32;
            self.front.push(FrontNode { node, bleb, rim_mm: 0.0 });
        }
        self.slot[node as usize] as usize
    }

    fn add_pull(&mut self, spring: u32, holding: u32, loose: u32, label: u8) {
        if !self.taken_spring[spring as usize] && self.label[loose as usize] == label {
            self.taken_spring[spring as usize] = true;
            let front = self.slot(holding, label - 1) as u32;
            self.pulls.push(Pull { spring, front, loose });
        }
    }
}

fn range(starts: &[u32], bleb: usize) -> Range<usize> {
    starts[bleb] as usize..starts[bleb + 1] as usize
}

/// Area of each triangle as it lies at the start, mm².
pub fn home_areas(sheet: &SheetMesh, home_mm: &[Vector3<f32>]) -> Vec<f32> {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|n| home_mm[n as usize]);
        0.5 * (b - a).cross(&(c - a)).norm()
    };
    sheet.triangles.iter().map(area).collect()
}
