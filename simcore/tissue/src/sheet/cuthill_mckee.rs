//! Orders the nodes of a mesh so that neighbours lie near each other in memory (Cuthill and McKee
//! 1969): breadth first from a node at the far end of the mesh, neighbours with fewer connections
//! first.

/// Neighbours of every node, as a list with starts.
struct Adjacency {
    start: Vec<u32>,
    nodes: Vec<u32>,
}

impl Adjacency {
    fn new(nodes: usize, edges: &[[u32; 2]]) -> Self {
        let mut start = vec![0u32; nodes + 1];
        edges.as_flattened().iter().for_each(|&n| start[n as usize + 1] += 1);
        (0..nodes).for_each(|n| start[n + 1] += start[n]);
        let mut fill = start.clone();
        let mut neighbours = vec![0; 2 * edges.len()];
        for &[a, b] in edges {
            for (from, to) in [(a, b), (b, a)] {
                neighbours[fill[from as usize] as usize] = to;
                fill[from as usize] += 1;
            }
        }
        Adjacency { start, nodes: neighbours }
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.nodes[self.start[node as usize] as usize..self.start[node as usize + 1] as usize]
    }

    /// Appends to `order` what is reachable from `seed` and not yet seen, breadth first; `seen[n]
    /// == mark` is seen.
    fn walk(&self, seed: u32, mark: u32, seen: &mut [u32], order: &mut Vec<u32>) {
        let mut next = order.len();
        order.push(seed);
        seen[seed as usize] = mark;
        while next < order.len() {
            let first = order.len();
            for &neighbour in self.of(order[next]) {
                if seen[neighbour as usize] != mark {
                    seen[neighbour as usize] = mark;
                    order.push(neighbour);
                }
            }
            // Ties by number, so that the order depends on the mesh alone.
            order[first..].sort_unstable_by_key(|&n| (self.of(n).len(), n));
            next += 1;
        }
    }
}

/// Nodes in their new order. Every component of the mesh is walked from the node that a first walk
/// reached last.
pub fn cuthill_mckee(nodes: usize, edges: &[[u32; 2]]) -> Vec<u32> {
    let adjacency = Adjacency::new(nodes, edges);
    let (mut seen, mut order, mut trial) = (vec![0u32; nodes], Vec::with_capacity(nodes), Vec::new());
    for node in 0..nodes as u32 {
        if seen[node as usize] != 0 {
            continue;
        }
        trial.clear();
        adjacency.walk(node, 1, &mut seen, &mut trial);
        let far = *trial.last().expect("the walk begins with its seed");
        adjacency.walk(far, 2, &mut seen, &mut order);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_shuffled_chain_comes_back_in_order() {
        let names = [4u32, 0, 3, 1, 5, 2];
        let edges: Vec<[u32; 2]> = names.windows(2).map(|w| [w[0], w[1]]).collect();
        let order = cuthill_mckee(6, &edges);
        assert!(order == names || order.iter().rev().eq(names.iter()), "{order:?}");
    }

    proptest! {
        #[test]
        fn any_graph_keeps_every_node_once(edges in prop::collection::vec([0u32..40, 0u32..40], 0..120)) {
            let mut order = cuthill_mckee(40, &edges);
            order.sort_unstable();
            prop_assert_eq!(order, (0..40).collect::<Vec<_>>());
        }
    }
}
