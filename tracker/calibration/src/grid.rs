//! Which found point is which of a regular grid: grown from a seed, neighbour by neighbour, each
//! predicted from those already placed, so that perspective and distortion do not matter.

use nalgebra::Vector2;
use std::collections::{HashMap, VecDeque};

/// A neighbour may lie so far from where it is expected, as a share of the step there.
const GATE: f64 = 0.3;
/// The same for the first steps, where only a direction is known.
const FIRST_ANGLE_RAD: f64 = 0.35;
/// Seeds tried before a picture is given up.
const SEEDS: usize = 60;

/// A point that may belong to the grid, with the directions of its grid lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// px.
    pub at: Vector2<f64>,
    /// Unit vectors along the two lines, sign free.
    pub lines: [Vector2<f64>; 2],
}

/// Indices of the points of a `columns`×`rows` grid, row by row, in one of its orientations.
///
/// # Errors
/// With the size of the largest grid that was found. A grid in which they would fit in several
/// places is another one.
pub fn find(nodes: &[Node], columns: usize, rows: usize) -> Result<Vec<usize>, usize> {
    let mut largest = 0;
    for seed in 0..nodes.len().min(SEEDS) {
        let grown = grow(nodes, seed);
        largest = largest.max(grown.len());
        let mut windows = windows_of(&grown, columns, rows);
        match (windows.pop(), windows.len()) {
            (Some(only), 0) => return Ok(only),
            (Some(_), _) => break,
            (None, _) => {}
        }
    }
    Err(largest)
}

type Cell = (i32, i32);

/// All nodes connected with the seed, by cell.
fn grow(nodes: &[Node], seed: usize) -> HashMap<Cell, usize> {
    let mut cells = HashMap::from([((0, 0), seed)]);
    let mut taken = vec![false; nodes.len()];
    taken[seed] = true;
    let mut queue = VecDeque::from([(0, 0)]);
    while let Some(cell) = queue.pop_front() {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let to = (cell.0 + dx, cell.1 + dy);
            if cells.contains_key(&to) {
                continue;
            }
            if let Some(found) = neighbour(nodes, &cells, &taken, cell, (dx, dy)) {
                taken[found] = true;
                cells.insert(to, found);
                queue.push_back(to);
            }
        }
    }
    cells
}

/// The node one step from a cell.
fn neighbour(
    nodes: &[Node],
    cells: &HashMap<Cell, usize>,
    taken: &[bool],
    cell: Cell,
    direction: Cell,
) -> Option<usize> {
    let (dx, dy) = direction;
    let at = |c: i32, r: i32| cells.get(&(c, r)).map(|&n| nodes[n].at);
    let here = at(cell.0, cell.1)?;
    let behind = at(cell.0 - dx, cell.1 - dy).map(|b| here - b);
    let beside = [1, -1].into_iter().find_map(|s| {
        let (c, r) = (cell.0 + s * dy, cell.1 + s * dx);
        Some(at(c + dx, r + dy)? - at(c, r)?)
    });
    // The mean of both where there are both: their errors by perspective differ in sign.
    let step = match (behind, beside) {
        (Some(a), Some(b)) => Some((a + b) / 2.0),
        (a, b) => a.or(b),
    };
    let free = || nodes.iter().enumerate().filter(|(i, _)| !taken[*i]);
    match step {
        Some(step) => {
            let wanted = here + step;
            let nearest =
                free().min_by(|a, b| (a.1.at - wanted).norm().total_cmp(&(b.1.at - wanted).norm()))?;
            ((nearest.1.at - wanted).norm() < GATE * step.norm()).then_some(nearest.0)
        }
        None => {
            // Only the seed's own directions are known: the nearest node along the line.
            let line = nodes[*cells.get(&cell)?].lines[usize::from(dx == 0)];
            let forward = line * f64::from(dx + dy);
            let ahead = free().filter(|(_, n)| forward.angle(&(n.at - here)) < FIRST_ANGLE_RAD);
            ahead.min_by(|a, b| (a.1.at - here).norm().total_cmp(&(b.1.at - here).norm())).map(|(i, _)| i)
        }
    }
}

/// The full `columns`×`rows` windows of the grown cells, upright or lying.
fn windows_of(cells: &HashMap<Cell, usize>, columns: usize, rows: usize) -> Vec<Vec<usize>> {
    if cells.len() < columns * rows {
        return Vec::new();
    }
    let upright = windows(cells, columns, rows);
    let turned: HashMap<Cell, usize> = cells.iter().map(|(&(x, y), &n)| ((y, x), n)).collect();
    // A square grid lies as it stands.
    let lying = if columns == rows { Vec::new() } else { windows(&turned, columns, rows) };
    [upright, lying].concat()
}

fn windows(cells: &HashMap<Cell, usize>, columns: usize, rows: usize) -> Vec<Vec<usize>> {
    let (w, h) = (columns as i32, rows as i32);
    let full = |&(x, y): &Cell| (0..w * h).map(|i| cells.get(&(x + i % w, y + i / w)).copied()).collect();
    cells.keys().filter_map(full).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A grid in perspective, its nodes in an order made from `key`, with clutter between.
    fn seen(
        columns: usize,
        rows: usize,
        tilt: [f64; 2],
        roll: f64,
        key: usize,
    ) -> Vec<(Node, Option<usize>)> {
        let image = |x: f64, y: f64| {
            let (x, y) = (x - columns as f64 / 2.0, y - rows as f64 / 2.0);
            let depth = 1.0 + tilt[0] * x + tilt[1] * y;
            let p = Vector2::new(x, y) * (30.0 / depth);
            Vector2::new(300.0, 200.0) + nalgebra::Rotation2::new(roll) * p
        };
        let node = |x: f64, y: f64| {
            let along = |dx: f64, dy: f64| (image(x + dx, y + dy) - image(x - dx, y - dy)).normalize();
            Node { at: image(x, y), lines: [along(0.5, 0.0), along(0.0, 0.5)] }
        };
        let own = (0..columns * rows).map(|i| (node((i % columns) as f64, (i / columns) as f64), Some(i)));
        let clutter = (0..6).map(|i| (node(f64::from(i) + 0.5, 1.5), None));
        let mut all: Vec<_> = own.chain(clutter).collect();
        let n = all.len();
        (0..n).for_each(|i| all.swap(i, (i * 7919 + key) % n));
        all
    }

    proptest! {
        #[test]
        fn a_grid_is_found_from_any_seed(
            tilt in prop::array::uniform2(-0.04..0.04f64), roll in -3.0..3.0f64, key in 0usize..1000,
        ) {
            let (columns, rows) = (7, 5);
            let all = seen(columns, rows, tilt, roll, key);
            let nodes: Vec<Node> = all.iter().map(|n| n.0).collect();
            let found = find(&nodes, columns, rows).unwrap();
            let cell = |i: usize| {
                let of = all[found[i]].1.expect("clutter is left out");
                [of % columns, of / columns].map(|v| v as i32)
            };
            // One of the orientations: steps along a row and a column are the same everywhere.
            let minus = |a: [i32; 2], b: [i32; 2]| [a[0] - b[0], a[1] - b[1]];
            let (right, down) = (minus(cell(1), cell(0)), minus(cell(columns), cell(0)));
            prop_assert_eq!((right[0].abs(), right[1], down[0], down[1].abs()), (1, 0, 0, 1));
            for i in 0..columns * rows {
                let (c, r) = ((i % columns) as i32, (i / columns) as i32);
                let expected = [0, 1].map(|k| cell(0)[k] + c * right[k] + r * down[k]);
                prop_assert_eq!(cell(i), expected);
            }
        }
    }

    #[test]
    fn an_incomplete_grid_tells_how_much_there_was() {
        let mut all = seen(7, 5, [0.0, 0.0], 0.3, 1);
        all.retain(|n| n.1 != Some(17) && n.1.is_some());
        let nodes: Vec<Node> = all.iter().map(|n| n.0).collect();
        assert_eq!(find(&nodes, 7, 5), Err(34));
        assert_eq!(find(&[], 7, 5), Err(0));
    }

    #[test]
    fn a_larger_grid_is_not_guessed_at() {
        let nodes: Vec<Node> =
            seen(7, 5, [0.0, 0.0], 0.0, 1).iter().filter(|n| n.1.is_some()).map(|n| n.0).collect();
        assert_eq!(find(&nodes, 6, 5), Err(35));
    }
}
