//! The sheet: nodes joined by structural springs (the edges of its triangles) and bending springs.
//! Scenes have a regular one (`grid`), any other manifold mesh will do ([`super::from_triangles`]).

use super::simd::rsqrt;
use crate::constants::{MAX_HELD, TINY_LENGTH2_MM2};
use crate::sheet::state::{NODE_PINNED, SheetState};
use nalgebra::Vector3;
use protocol::scene::NODE_FREE;

/// No triangle on that side.
pub const NONE: u32 = u32::MAX;

/// What a bending spring stiffens; it goes when one of the two goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bend {
    /// Two structural springs in line: it joins their far ends.
    Line([u32; 2]),
    /// Two triangles with a common edge: it joins the vertices opposite that edge.
    Hinge([u32; 2]),
}

impl Bend {
    /// True while both are there.
    pub fn is_whole(self, state: &SheetState) -> bool {
        match self {
            Bend::Line(springs) => springs.iter().all(|&s| state.spring_alive[s as usize] != 0),
            Bend::Hinge(triangles) => triangles.iter().all(|&t| state.triangle_alive[t as usize] != 0),
        }
    }
}

/// Connections and rest lengths.
#[derive(Debug, Clone, Default)]
pub struct SheetMesh {
    /// Ends of each spring: first the structural ones, then the bending ones.
    pub springs: Vec<[u32; 2]>,
    /// Rest length of each spring, mm.
    pub rest_mm: Vec<f32>,
    /// How many springs are structural.
    pub structural: usize,
    /// For each bending spring, what it stiffens.
    pub bends: Vec<Bend>,
    /// Nodes of each triangle, counter-clockwise seen from the inside of the eye.
    pub triangles: Vec<[u32; 3]>,
    /// Structural springs of each triangle.
    pub triangle_springs: Vec<[u32; 3]>,
    /// Triangles of each structural spring ([`NONE`] where there is no second one).
    pub spring_triangles: Vec<[u32; 2]>,
    /// Where the triangles of a node begin in `node_triangles`; one more entry than nodes.
    pub node_start: Vec<u32>,
    /// Triangles around each node.
    pub node_triangles: Vec<u32>,
    /// Nodes of the rim: pinned at the start.
    pub rim: Vec<u32>,
    /// Factor of each spring on the tissue's stiffness; empty where all are 1.
    pub stiffness_factor: Vec<f32>,
    /// Factor of each spring on the tissue's damping; empty where all are 1.
    pub damping_factor: Vec<f32>,
    /// The sheet's number of each node of the mesh that it was made of.
    pub order: Vec<u32>,
    /// Where the nodes are at the start, eye frame, mm.
    pub(super) start_mm: [Vec<f32>; 3],
}

impl SheetMesh {
    /// The sheet at rest: rim pinned to the retina, the rest free.
    pub fn start(&self) -> SheetState {
        let nodes = self.start_mm[0].len();
        let mut flag = vec![NODE_FREE; nodes];
        for &node in &self.rim {
            flag[node as usize] = NODE_PINNED;
        }
        SheetState {
            position_mm: self.start_mm.clone(),
            velocity_mm_s: std::array::from_fn(|_| vec![0.0; nodes]),
            flag,
            spring_alive: vec![1; self.structural],
            triangle_alive: vec![1; self.triangles.len()],
            held: std::array::from_fn(|_| Vec::with_capacity(MAX_HELD)),
            ..SheetState::default()
        }
    }

    /// Nodes.
    pub fn nodes(&self) -> usize {
        self.start_mm[0].len()
    }

    /// Triangles around a node.
    pub fn triangles_of(&self, node: usize) -> &[u32] {
        &self.node_triangles[self.node_start[node] as usize..self.node_start[node + 1] as usize]
    }

    /// Where a node is at the start, eye frame, mm.
    pub fn start_position(&self, node: usize) -> Vector3<f32> {
        self.at(node as u32)
    }

    /// Edges of the whole sheet: springs that belong to one triangle only.
    pub fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        let one = |[a, b]: [u32; 2]| a != NONE && b == NONE;
        self.springs.iter().zip(&self.spring_triangles).filter(move |(_, t)| one(**t)).map(|(s, _)| *s)
    }

    pub(super) fn at(&self, node: u32) -> Vector3<f32> {
        let [x, y, z] = &self.start_mm;
        Vector3::new(x[node as usize], y[node as usize], z[node as usize])
    }

    /// As the solver computes lengths, so that a sheet at rest pulls with nothing at all.
    fn distance(&self, [a, b]: [u32; 2]) -> f32 {
        let d = self.at(b) - self.at(a);
        let length2 = d.x * d.x + d.y * d.y + d.z * d.z + TINY_LENGTH2_MM2;
        length2 * rsqrt(length2)
    }

    /// Derives what follows from nodes, springs and triangles: rest lengths, triangles around
    /// springs and nodes.
    pub(super) fn index(&mut self) {
        self.rest_mm = self.springs.iter().map(|&s| self.distance(s)).collect();
        self.spring_triangles = vec![[NONE; 2]; self.structural];
        for (t, springs) in self.triangle_springs.iter().enumerate() {
            for &s in springs {
                let sides = &mut self.spring_triangles[s as usize];
                sides[usize::from(sides[0] != NONE)] = t as u32;
            }
        }
        let mut around = vec![Vec::new(); self.nodes()];
        for (t, nodes) in self.triangles.iter().enumerate() {
            nodes.iter().for_each(|&n| around[n as usize].push(t as u32));
        }
        self.node_start = vec![0];
        for triangles in around {
            self.node_triangles.extend(triangles);
            self.node_start.push(self.node_triangles.len() as u32);
        }
    }
}
