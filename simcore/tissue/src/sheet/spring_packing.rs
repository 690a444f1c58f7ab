//! Packs the springs of a sheet for the kernel ([`super::simd::kernel`]).
//!
//! Each spring belongs to one of its ends, its owner, so that no node owns more than `slots`
//! springs. A planar mesh has at most three edges a node, hence three slots; the owners are found
//! by giving each spring to the end with fewer, and then turning springs along shortest ways from
//! nodes with too many to nodes with room. So a block of sixteen nodes is `slots` full vectors of
//! springs whose near ends lie side by side.

use super::simd::aligned::Aligned;
use super::simd::kernel::{COLLECT, Gather, PULL, SPREAD, TRIPLE, Tables};
use super::simd::{ABSENT, NODE, WIDE, lane_index};

/// The packed springs and where each of them went.
#[derive(Debug)]
pub struct SpringPacking {
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

/// A force on its way: from lane `source` of spring block `from` to a lane of a node block.
#[derive(Clone, Copy)]
struct Arrival {
    from: u32,
    source: u8,
    lane: u8,
}

/// Takes as many forces as two blocks of springs can bring at once, one for each node; `from` has
/// the numbers of these blocks.
fn take_most(arrivals: &mut Vec<Arrival>) -> Gather {
    let mut blocks: Vec<(u32, u16)> = Vec::new();
    for arrival in &*arrivals {
        let lane = 1 << arrival.lane;
        match blocks.iter_mut().find(|(from, _)| *from == arrival.from) {
            Some((_, lanes)) => *lanes |= lane,
            None => blocks.push((arrival.from, lane)),
        }
    }
    let mut best = (0, [0; 2]);
    for (i, &(a, lanes)) in blocks.iter().enumerate() {
        for &(b, more) in &blocks[i..] {
            let count = (lanes | more).count_ones();
            if count > best.0 {
                best = (count, [a, b]);
            }
        }
    }
    let from = best.1;
    let mut index = [ABSENT; WIDE];
    arrivals.retain(|arrival| {
        let block = from.iter().position(|&f| f == arrival.from);
        let taken = &mut index[usize::from(arrival.lane)];
        let Some(block) = block.filter(|_| *taken == ABSENT) else { return true };
        *taken = (block * WIDE) as u8 + arrival.source;
        false
    });
    Gather { from, index }
}

impl SpringPacking {
    /// Packs springs between `nodes` nodes; both ends of each must be below that. Stiffness and
    /// damping are 0 until they are set.
    pub fn new(nodes: usize, springs: &[[u32; 2]]) -> Self {
        let mut owners =
            Owners { springs, own: vec![Vec::new(); nodes], seen: vec![(0, 0); nodes], searches: 0 };
        for (s, &[a, b]) in springs.iter().enumerate() {
            let owner = if owners.own[b as usize].len() < owners.own[a as usize].len() { b } else { a };
            owners.own[owner as usize].push(s as u32);
        }
        let slots = owners.settle();
        let (mut packing, far) = Self::assign_slots(&mut owners, nodes, slots);
        packing.link(&far);
        packing.make_rings(&far);
        packing.receive(&far);
        packing.tables.check();
        packing
    }

    /// Gives every spring its slot. A node's own springs are in the order of their far ends, so
    /// that neighbours' springs in a slot lead the same way and arrive together. Returns the far
    /// end of each slot's spring.
    fn assign_slots(owners: &mut Owners, nodes: usize, slots: usize) -> (Self, Vec<Option<usize>>) {
        let n = nodes.div_ceil(WIDE) * slots * WIDE;
        let list = |value| Aligned::new(n, value);
        let mut tables = Tables {
            nodes,
            slots,
            rest: list(0.0),
            stiffness: list(0.0),
            damping: list(0.0),
            limit: list(f32::INFINITY),
            pull: list(0.0),
            ..Tables::default()
        };
        let (mut slot_of, mut far) = (vec![0; owners.springs.len()], vec![None; n]);
        for node in 0..nodes {
            let mut own: Vec<[u32; 2]> =
                owners.own[node].iter().map(|&s| [owners.other_end(s, node as u32), s]).collect();
            own.sort_unstable();
            let (block, lane) = (node / WIDE, node % WIDE);
            for (slot, [end, spring]) in own.into_iter().enumerate() {
                let at = (block * slots + slot) * WIDE + lane;
                (slot_of[spring as usize], far[at]) = (at as u32, Some(end as usize));
                let (here, there) = (block, end as usize / WIDE);
                let [ahead, behind] = &mut tables.reach;
                *ahead = (*ahead).max(there.saturating_sub(here));
                *behind = (*behind).max(here.saturating_sub(there));
            }
        }
        (SpringPacking { tables, slot_of }, far)
    }

    /// Which blocks have springs in common, and everything to be done for all.
    fn link(&mut self, far: &[Option<usize>]) {
        let tables = &mut self.tables;
        let of_slot = |at: usize| (at / WIDE / tables.slots) as u32;
        let ends =
            far.iter().enumerate().filter_map(|(at, end)| Some([of_slot(at), ((*end)? / WIDE) as u32]));
        tables.links = ends.collect();
        tables.links.sort_unstable();
        tables.links.dedup();
        tables.work = vec![SPREAD | PULL | COLLECT; tables.nodes.div_ceil(WIDE)];
    }

    /// Work space, and where in it the far ends are. An empty slot is a spring of no stiffness from
    /// the node to itself.
    fn make_rings(&mut self, far: &[Option<usize>]) {
        let tables = &mut self.tables;
        let (ring, slots) = (tables.ring(), tables.slots);
        tables.node = Aligned::new(ring * WIDE * NODE, 0.0);
        tables.own = Aligned::new(ring * TRIPLE, 0.0);
        tables.force = Aligned::new(ring * slots * TRIPLE, 0.0);
        let itself = |at: usize| at / WIDE / slots * WIDE + at % WIDE;
        let in_ring = |node: usize| node / WIDE % ring * WIDE + lane_index(node) % WIDE;
        let ends = far.iter().enumerate().map(|(at, far)| in_ring(far.unwrap_or(itself(at))) * NODE);
        tables.far = ends.map(|at| at as u32).collect();
    }

    /// How every block of nodes fetches the forces of the springs that end in it.
    fn receive(&mut self, far: &[Option<usize>]) {
        let tables = &mut self.tables;
        let (ring, slots) = (tables.ring() as u32, tables.slots as u32);
        let mut arriving = vec![Vec::new(); tables.nodes.div_ceil(WIDE)];
        for (at, far) in far.iter().enumerate() {
            if let Some(end) = far {
                let (from, source, lane) = ((at / WIDE) as u32, (at % WIDE) as u8, (end % WIDE) as u8);
                arriving[end / WIDE].push(Arrival { from, source, lane });
            }
        }
        let place = |from: u32| (from / slots % ring * slots + from % slots) * TRIPLE as u32;
        tables.gather_start.push(0);
        for mut arrivals in arriving {
            while !arrivals.is_empty() {
                let Gather { from, index } = take_most(&mut arrivals);
                tables.gathers.push(Gather { from: from.map(place), index });
            }
            tables.gather_start.push(tables.gathers.len() as u32);
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

    /// Owner of each spring, from its slot, and the node that picks its force up; every force is
    /// picked up once.
    fn ends(packing: &SpringPacking) -> Vec<[u32; 2]> {
        let tables = &packing.tables;
        let (slots, ring) = (tables.slots, tables.ring());
        let mut picked: Vec<(usize, usize, u32)> = Vec::new();
        for block in 0..tables.gather_start.len() - 1 {
            let gathers = tables.gather_start[block] as usize..tables.gather_start[block + 1] as usize;
            for pick in &tables.gathers[gathers] {
                for (lane, &index) in pick.index.iter().enumerate().filter(|(_, i)| **i != ABSENT) {
                    let from = pick.from[usize::from(index) / WIDE] as usize / TRIPLE;
                    picked.push((from, usize::from(index) % WIDE, (block * WIDE + lane) as u32));
                }
            }
        }
        assert_eq!(picked.len(), packing.slot_of.len());
        let ends = packing.slot_of.iter().map(|&at| {
            let (from, lane) = (at as usize / WIDE, at as usize % WIDE);
            let (block, slot) = (from / slots, from % slots);
            // A place in the ring is used by every ring-th block: of those, the one that reaches
            // the node.
            let owner = (block * WIDE + lane) as u32;
            let far = tables.far[at as usize] as usize / NODE;
            let same_ring = |n: u32| n as usize / WIDE % ring * WIDE + lane_index(n as usize) % WIDE == far;
            let found: Vec<u32> = picked
                .iter()
                .filter(|&&(f, l, n)| f == block % ring * slots + slot && l == lane && same_ring(n))
                .map(|p| p.2)
                .filter(|&n| {
                    let there = n as usize / WIDE;
                    let [ahead, behind] = tables.reach;
                    there <= block + ahead && block <= there + behind
                })
                .collect();
            assert_eq!(found.len(), 1);
            [owner, found[0]]
        });
        ends.collect()
    }

    proptest! {
        #[test]
        fn every_spring_of_a_planar_mesh_finds_a_place_in_three_slots(side in 2u32..20, seed: u64) {
            let springs = grid(side, seed);
            let nodes = ((side + 1) * (side + 1)) as usize;
            let packing = SpringPacking::new(nodes, &springs);
            let slots = packing.tables.slots;
            prop_assert!((1..=3).contains(&slots), "{slots}");
            let mut used = packing.slot_of.clone();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), springs.len());
            for (&[a, b], found) in springs.iter().zip(ends(&packing)) {
                prop_assert!(found == [a, b] || found == [b, a], "{:?} {:?}", found, [a, b]);
            }
        }

        #[test]
        fn any_graph_can_be_packed(springs in prop::collection::vec((0u32..30, 0u32..30), 0..200)) {
            let springs: Vec<[u32; 2]> = springs.into_iter().map(|(a, b)| [a, b]).collect();
            let packing = SpringPacking::new(30, &springs);
            prop_assert_eq!(packing.slot_of.len(), springs.len());
            for (&[a, b], found) in springs.iter().zip(ends(&packing)) {
                prop_assert!(found == [a, b] || found == [b, a], "{:?} {:?}", found, [a, b]);
            }
        }
    }
}
