//! Rounds off retina that comes off. The simulation's mesh is 0.65 mm wide: the rim of a bleb would be
//! a polygon of such sides. Drawn is what one step of Loop's subdivision makes of it: nodes are
//! smoothed by their neighbours everywhere, triangles are divided where the rim runs through them.
//!
//! The retina that lies beside it takes part, with the height 0. So what is drawn depends on heights
//! alone, not on which nodes are off: one that is released moves little, since it is released at the
//! height 0; by 0.06 mm at most, where a triangle is divided no longer. Directions from the eye's
//! centre and heights are smoothed apart, or the sphere would shrink to the chords of the mesh.

use crate::layout::{TissueHome, TissueVertex};
use glam::{Vec2, Vec3};

/// Share of a node that its neighbours have in its place, all together (Loop 1987, as Warren has it).
const OF_NEIGHBOURS: f32 = 3.0 / 8.0;
/// Shares of an edge's end and of a corner opposite in the place of its middle.
const OF_END: f32 = 3.0 / 8.0;
const OF_OPPOSITE: f32 = 1.0 / 8.0;

/// Loose triangles up to which all of them are divided. Of more only those at the rim are: a whole
/// retina would have four times as many.
const ALL_UP_TO: usize = 600;

/// An edge, its ends in order, and what lies opposite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    ends: [u32; 2],
    opposite: u32,
}

/// The middle of an edge, a vertex of its own.
#[derive(Debug, Clone, Copy)]
struct Middle {
    ends: [u32; 2],
    opposite: [u32; 2],
}

/// What is divided, and how each vertex follows from the nodes. Changes with the triangles only.
#[derive(Debug, Default)]
pub struct Rim {
    sides: Vec<Side>,
    /// Nodes that are smoothed: the range of their neighbours.
    smoothed: Vec<(u32, [usize; 2])>,
    neighbours: Vec<u32>,
    middles: Vec<Middle>,
    /// By node: on the border of what was sent, a corner of loose and of lying retina.
    border: Vec<bool>,
    loose: Vec<bool>,
    lying: Vec<bool>,
    places: Vec<Vec3>,
}

impl Rim {
    /// Takes triangles of loose retina and of lying retina beside it, between `nodes` nodes; puts what
    /// is to be drawn into `out`. The vertices after the nodes are middles of edges.
    pub fn divide(&mut self, nodes: usize, loose: &[[u32; 3]], lying: &[[u32; 3]], out: &mut Vec<[u32; 3]>) {
        self.mark(nodes, loose, lying);
        self.list_sides(loose.iter().chain(lying));
        self.list_middles(nodes, loose.len() <= ALL_UP_TO && !lying.is_empty());
        self.list_neighbours(nodes);
        let base = nodes as u32;
        for t in loose {
            pieces(t, self.middles_of(t, base), |piece| out.push(piece));
        }
        for t in lying {
            pieces(t, self.middles_of(t, base), |piece| {
                if piece.iter().any(|&v| self.may_rise(v, base)) {
                    out.push(piece);
                }
            });
        }
    }

    fn mark(&mut self, nodes: usize, loose: &[[u32; 3]], lying: &[[u32; 3]]) {
        for (marks, triangles) in [(&mut self.loose, loose), (&mut self.lying, lying)] {
            marks.clear();
            marks.resize(nodes, false);
            triangles.iter().flatten().for_each(|&n| marks[n as usize] = true);
        }
    }

    fn list_sides<'a>(&mut self, triangles: impl Iterator<Item = &'a [u32; 3]>) {
        self.sides.clear();
        for &[a, b, c] in triangles {
            for [a, b, opposite] in [[a, b, c], [b, c, a], [c, a, b]] {
                self.sides.push(Side { ends: [a.min(b), a.max(b)], opposite });
            }
        }
        self.sides.sort_unstable();
    }

    /// The rim runs through nodes at which loose and lying retina meet.
    fn is_rim(&self, node: u32) -> bool {
        self.loose[node as usize] && self.lying[node as usize]
    }

    fn list_middles(&mut self, nodes: usize, all: bool) {
        self.middles.clear();
        self.border.clear();
        self.border.resize(nodes, false);
        for same in self.sides.chunk_by(|a, b| a.ends == b.ends) {
            let (ends, inner) = (same[0].ends, same.len() == 2);
            if !inner {
                ends.iter().for_each(|&n| self.border[n as usize] = true);
            }
            let near_rim = |s: &Side| s.ends.iter().chain([&s.opposite]).any(|&n| self.is_rim(n));
            if all || same.iter().any(near_rim) {
                // On the border the middle lies half way.
                let opposite = if inner { [same[0].opposite, same[1].opposite] } else { ends };
                self.middles.push(Middle { ends, opposite });
            }
        }
    }

    fn list_neighbours(&mut self, nodes: usize) {
        self.smoothed.clear();
        self.neighbours.clear();
        let mut pairs: Vec<[u32; 2]> = Vec::with_capacity(2 * self.sides.len());
        for same in self.sides.chunk_by(|a, b| a.ends == b.ends) {
            let [a, b] = same[0].ends;
            pairs.extend([[a, b], [b, a]]);
        }
        pairs.sort_unstable();
        for same in pairs.chunk_by(|a, b| a[0] == b[0]) {
            let node = same[0][0];
            if (node as usize) < nodes && !self.border[node as usize] {
                let first = self.neighbours.len();
                self.neighbours.extend(same.iter().map(|p| p[1]));
                self.smoothed.push((node, [first, self.neighbours.len()]));
            }
        }
    }

    /// Vertices in the middle of the sides of `t`, counted from `base`, where they are divided.
    fn middles_of(&self, t: &[u32; 3], base: u32) -> [Option<u32>; 3] {
        [0, 1, 2].map(|i| {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            let ends = [a.min(b), a.max(b)];
            self.middles.binary_search_by(|m| m.ends.cmp(&ends)).ok().map(|m| base + m as u32)
        })
    }

    /// Whether a vertex depends on a node that can leave the choroid: one that touches loose retina
    /// only.
    fn may_rise(&self, vertex: u32, base: u32) -> bool {
        let rises = |&n: &u32| self.loose[n as usize] && !self.lying[n as usize];
        if let Some(m) = vertex.checked_sub(base) {
            let Middle { ends, opposite } = self.middles[m as usize];
            return ends.iter().chain(&opposite).any(rises);
        }
        let found = self.smoothed.binary_search_by_key(&vertex, |s| s.0);
        let around =
            found.map_or(&[][..], |i| &self.neighbours[self.smoothed[i].1[0]..self.smoothed[i].1[1]]);
        rises(&vertex) || around.iter().any(rises)
    }

    /// Puts smoothed nodes into the place of nodes and adds the middles. Nodes for which `held` is true
    /// stay where they are.
    pub fn place(&mut self, vertices: &mut Vec<TissueVertex>, held: impl Fn(usize) -> bool) {
        self.places.clear();
        self.places.extend(vertices.iter().map(|v| Vec3::from(v.position)));
        for &(node, [from, to]) in &self.smoothed {
            if !held(node as usize) {
                let at = |n: u32| self.places[n as usize];
                let share = OF_NEIGHBOURS / (to - from) as f32;
                let around = self.neighbours[from..to].iter().map(|&n| (at(n), share));
                let own = (at(node), 1.0 - OF_NEIGHBOURS);
                vertices[node as usize].position = mean(around.chain([own])).to_array();
            }
        }
        for m in &self.middles {
            let at = |n: u32| self.places[n as usize];
            let position = mean(m.shares().map(|(n, share)| (at(n), share)).into_iter()).to_array();
            vertices.push(TissueVertex { position, normal: [0.0; 3], more: [0.0; 2] });
        }
    }

    /// The same of the nodes' homes, so that the picture stays where it is.
    pub fn place_homes(&self, homes: &mut Vec<TissueHome>) {
        let at: Vec<Vec2> = homes.iter().map(|h| Vec2::from(h.in_map)).collect();
        for &(node, [from, to]) in &self.smoothed {
            let share = OF_NEIGHBOURS / (to - from) as f32;
            let around: Vec2 = self.neighbours[from..to].iter().map(|&n| at[n as usize] * share).sum();
            homes[node as usize].in_map = (at[node as usize] * (1.0 - OF_NEIGHBOURS) + around).to_array();
        }
        for m in &self.middles {
            let in_map: Vec2 = m.shares().iter().map(|&(n, share)| at[n as usize] * share).sum();
            homes.push(TissueHome { in_map: in_map.to_array(), ..homes[m.ends[0] as usize] });
        }
    }
}

impl Middle {
    fn shares(&self) -> [(u32, f32); 4] {
        let ([a, b], [c, d]) = (self.ends, self.opposite);
        [(a, OF_END), (b, OF_END), (c, OF_OPPOSITE), (d, OF_OPPOSITE)]
    }
}

/// Mean direction from the eye's centre at the mean distance.
fn mean(parts: impl Iterator<Item = (Vec3, f32)>) -> Vec3 {
    let (sum, distance) =
        parts.fold((Vec3::ZERO, 0.0), |(p, r), (q, share)| (p + share * q, r + share * q.length()));
    sum.normalize_or_zero() * distance
}

/// The pieces of `t` whose sides are divided where they have a middle.
fn pieces(t: &[u32; 3], middles: [Option<u32>; 3], mut put: impl FnMut([u32; 3])) {
    let ([a, b, c], [ab, bc, ca]) = (*t, middles);
    // Turned so that those with a middle come first.
    let turned = match [ab, bc, ca].map(|m| m.is_some()) {
        [false, true, _] => [b, c, a],
        [true, false, true] | [false, false, true] => [c, a, b],
        _ => [a, b, c],
    };
    let along = |from: u32| {
        if from == a {
            ab
        } else if from == b {
            bc
        } else {
            ca
        }
    };
    let ([a, b, c], along) = (turned, turned.map(along));
    let few: &[[u32; 3]] = match along {
        [Some(ab), Some(bc), Some(ca)] => &[[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]],
        [Some(ab), Some(bc), None] => &[[ab, b, bc], [a, ab, bc], [a, bc, c]],
        [Some(ab), ..] => &[[a, ab, c], [ab, b, c]],
        _ => &[[a, b, c]],
    };
    few.iter().for_each(|&piece| put(piece));
}

#[cfg(test)]
mod tests;
