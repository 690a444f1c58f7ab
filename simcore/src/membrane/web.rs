//! Packs the springs of a sheet for the kernel ([`super::lanes::kernel`]).
//!
//! Each spring belongs to one of its ends, its owner, so that no node owns more than `slots` springs. A planar mesh has at most
//! three edges a node, hence three slots; the owners are found by giving each spring to the end with
//! fewer, and then turning springs along shortest ways from nodes with too many to nodes with room. So a block
//! of sixteen nodes is `slots` full vectors of springs whose near ends lie side by side.

use super::lanes::kernel::Tables;
use super::lanes::{NODE, QUAD, WIDE, place};

/// The packed springs and where each of them went.
#[derive(Debug)]
pub struct Web {
    /// What the kernel works on.
    pub tables: Tables,
    /// Slot of each spring in the tables.
    pub slot_of: Vec<u32>,
}

/// Nodes looked at in the search for room before a slot more is given to all.
const SEARCH: usize = 4096;

/// Which springs each node owns.
struct Owners<'a> {
    springs: &'a [[u32; 2]],
    own: Vec<Vec<u32>>,
    /// Mark of the last search that saw a node, and the spring by which it came.
    seen: Vec<(u32, u32)>,
    searches: u32,
}

impl Owners<'_> {
    /// The most that a node owns, made as small as the search can.
    fn settle(&mut self) -> usize {
        let mut slots = self.springs.len().div_ceil(self.own.len().max(1)).max(1);
        for node in 0..self.own.len() as u32 {
            while self.own[node as usize].len() > slots {
                if !self.make_room(node, slots) {
                    slots += 1;
                }
            }
        }
        slots
    }

    /// Hands one spring of `node` on, over as few nodes as possible.
    fn make_room(&mut self, node: u32, slots: usize) -> bool {
        self.searches += 1;
        let (mark, mut queue, mut next) = (self.searches, vec![node], 0);
        self.seen[node as usize] = (mark, u32::MAX);
        while next < queue.len().min(SEARCH) {
            let at = queue[next];
            next += 1;
            if self.own[at as usize].len() < slots {
                self.hand_back(at);
                return true;
            }
            for &spring in &self.own[at as usize] {
                let other = self.other_end(spring, at);
                if self.seen[other as usize].0 != mark {
                    self.seen[other as usize] = (mark, spring);
                    queue.push(other);
                }
            }
        }
        false
    }

    /// Turns the springs on the way by which the search came to `node`.
    fn hand_back(&mut self, mut node: u32) {
        while let (_, spring) = self.seen[node as usize]
            && spring != u32::MAX
        {
            let from = self.other_end(spring, node);
            self.own[from as usize].retain(|&s| s != spring);
            self.own[node as usize].push(spring);
            node = from;
        }
    }

    fn other_end(&self, spring: u32, node: u32) -> u32 {
        let [a, b] = self.springs[spring as usize];
        if a == node { b } else { a }
    }
}

impl Web {
    /// Packs springs between `nodes` nodes; both ends of each must be below that. Stiffness and damping are 0 until they are set.
    pub fn new(nodes: usize, springs: &[[u32; 2]]) -> Self {
        let mut owners =
            Owners { springs, own: vec![Vec::new(); nodes], seen: vec![(0, 0); nodes], searches: 0 };
        for (s, &[a, b]) in springs.iter().enumerate() {
            let owner = if owners.own[b as usize].len() < owners.own[a as usize].len() { b } else { a };
            owners.own[owner as usize].push(s as u32);
        }
        let slots = owners.settle();
        let (mut web, arriving) = Self::place(&mut owners, nodes, slots);
        web.receive(arriving);
        web.tables.check();
        web
    }

    /// Gives every spring its slot; returns for each node the springs that end there.
    fn place(owners: &mut Owners, nodes: usize, slots: usize) -> (Self, Vec<Vec<u32>>) {
        let blocks = nodes.div_ceil(WIDE);
        let n = blocks * slots * WIDE;
        let mut tables = Tables {
            nodes,
            slots,
            far: vec![0; n],
            rest: vec![0.0; n],
            stiffness: vec![0.0; n],
            damping: vec![0.0; n],
            limit: vec![f32::INFINITY; n],
            pull: vec![0.0; n],
            node: vec![0.0; blocks * WIDE * NODE],
            own: std::array::from_fn(|_| vec![0.0; blocks * WIDE]),
            quads: vec![0.0; (n + 1) * QUAD],
            ..Tables::default()
        };
        let mut slot_of = vec![0; owners.springs.len()];
        let mut arriving = vec![Vec::new(); nodes];
        for node in 0..nodes {
            owners.own[node].sort_unstable();
            let (block, lane) = (node / WIDE, node % WIDE);
            for slot in 0..slots {
                let at = (block * slots + slot) * WIDE + lane;
                // An empty slot is a spring of no stiffness from the node to itself.
                let far = owners.own[node].get(slot).map_or(node as u32, |&s| {
                    let far = owners.other_end(s, node as u32);
                    slot_of[s as usize] = at as u32;
                    arriving[far as usize].push(at as u32);
                    far
                });
                tables.far[at] = (place(far as usize) * NODE) as u32;
            }
        }
        (Web { tables, slot_of }, arriving)
    }

    fn receive(&mut self, arriving: Vec<Vec<u32>>) {
        let tables = &mut self.tables;
        let nothing = (tables.quads.len() - QUAD) as u32;
        tables.row_start.push(0);
        for block in arriving.chunks(WIDE) {
            let rows = block.iter().map(Vec::len).max().unwrap_or(0);
            for row in 0..rows {
                for lane in 0..WIDE {
                    let spring = block.get(lane).and_then(|list| list.get(row));
                    tables.incoming.push(spring.map_or(nothing, |&s| (place(s as usize) * QUAD) as u32));
                }
            }
            tables.row_start.push((tables.incoming.len() / WIDE) as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Springs of a grid of squares with one diagonal each, as often turned as `seed` says.
    fn grid(side: u32, mut seed: u64) -> Vec<[u32; 2]> {
        let node = |r: u32, c: u32| r * (side + 1) + c;
        let mut springs = Vec::new();
        for (r, c) in (0..=side).flat_map(|r| (0..=side).map(move |c| (r, c))) {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            springs.extend((c < side).then(|| [node(r, c), node(r, c + 1)]));
            springs.extend((r < side).then(|| [node(r, c), node(r + 1, c)]));
            if r < side && c < side {
                let turned = seed >> 63 == 1;
                springs.push(if turned {
                    [node(r, c + 1), node(r + 1, c)]
                } else {
                    [node(r, c), node(r + 1, c + 1)]
                });
            }
        }
        springs
    }

    proptest! {
        #[test]
        fn every_spring_of_a_planar_mesh_finds_a_place_in_three_slots(side in 2u32..20, seed: u64) {
            let springs = grid(side, seed);
            let nodes = ((side + 1) * (side + 1)) as usize;
            let web = Web::new(nodes, &springs);
            let slots = web.tables.slots;
            prop_assert!((1..=3).contains(&slots), "{slots}");
            let mut used = web.slot_of.clone();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), springs.len());
            for (spring, &slot) in springs.iter().zip(&web.slot_of) {
                let owner = slot as usize / (slots * WIDE) * WIDE + slot as usize % WIDE;
                let far = web.tables.far[slot as usize] as usize / NODE;
                let far = (0..nodes).find(|&n| place(n) == far).unwrap();
                let ends = [owner.min(far) as u32, owner.max(far) as u32];
                prop_assert_eq!(ends, [spring[0].min(spring[1]), spring[0].max(spring[1])]);
            }
            let mut arrived: Vec<u32> = web.tables.incoming.clone();
            arrived.retain(|&q| q as usize != web.tables.quads.len() - QUAD);
            prop_assert_eq!(arrived.len(), springs.len());
        }

        #[test]
        fn any_graph_can_be_packed(springs in prop::collection::vec((0u32..30, 0u32..30), 0..200)) {
            let springs: Vec<[u32; 2]> = springs.into_iter().map(|(a, b)| [a, b]).collect();
            let web = Web::new(30, &springs);
            prop_assert_eq!(web.slot_of.len(), springs.len());
        }
    }
}
