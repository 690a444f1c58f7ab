//! Which corner of the board each corner of a part is, by the markers in it; and corners beside them that no part holds.
//!
//! Every marker says alone how its part lies on the board. A part is named where at least two say the same and few
//! contradict; what then does not lie where its neighbours have it is left out.

use super::CharucoBoard;
use super::lattice::{Cell, Part, half_line, towards};
use super::markers::Marker;
use crate::corners::Corner;
use crate::linear::homography;
use nalgebra::{Matrix3, Vector2};
use std::collections::{BTreeMap, BTreeSet};

/// Markers that must agree.
const AGREEING: usize = 2;
/// They must be more than so many times those that agree on anything else.
const MAJORITY: usize = 2;
/// Corners nearest on the board, and fewest of them, from which one is predicted.
const NEAREST: (usize, usize) = (12, 6);
/// Distance on the board from which one may be predicted, squares.
const REACH: f64 = 2.3;
/// A named corner lies at most so far from where the others have it: so many times the median of all, but not less than
/// px, and not more than a share of a square (or px).
const ASIDE: (f64, f64, f64) = (5.0, 0.75, 0.06);
/// The same for a corner that is added, as a share of a square.
const ADDED: f64 = 0.12;
/// Rounds in which corners are added next to those that were.
const ROUNDS: usize = 6;

/// Corners of the board (column, row) by what was found.
pub type Named = BTreeMap<Cell, usize>;

/// How a part lies on the board: quarter turns, and where its cell (0, 0) is. Board = turned cell + offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Lie {
    turns: usize,
    offset: Cell,
}

/// A step of a part as a step on a board on which its markers appear turned clockwise.
fn turned((x, y): Cell, turns: usize) -> Cell {
    match turns {
        0 => (x, y),
        1 => (y, -x),
        2 => (-x, -y),
        _ => (-y, x),
    }
}

impl Lie {
    /// As a marker in its square says.
    fn of(board: &CharucoBoard, marker: &Marker) -> Option<Self> {
        let (x, y) = board.square_of(marker.read.id)?;
        let turns = marker.read.turns;
        // The middles of squares turn, so twice as many steps make whole numbers.
        let (c, r) = marker.cell;
        let (u, v) = turned((2 * c + 1, 2 * r + 1), turns);
        Some(Lie { turns, offset: ((2 * x + 1 - u) / 2, (2 * y + 1 - v) / 2) })
    }

    /// The inner corner of the board at a cell's corner.
    fn corner(self, cell: Cell) -> Cell {
        let (x, y) = turned(cell, self.turns);
        (x + self.offset.0 - 1, y + self.offset.1 - 1)
    }
}

/// The corners of a part, if its markers say which.
pub fn named(board: &CharucoBoard, part: &Part, markers: &[Marker]) -> Named {
    let mut votes: BTreeMap<Lie, usize> = BTreeMap::new();
    let lies: Vec<Option<Lie>> = markers.iter().map(|m| Lie::of(board, m)).collect();
    lies.iter().flatten().for_each(|lie| *votes.entry(*lie).or_default() += 1);
    let mut counted: Vec<(usize, Lie)> = votes.into_iter().map(|(lie, n)| (n, lie)).collect();
    counted.sort_by(|a, b| b.cmp(a));
    let Some(&(most, lie)) = counted.first() else { return Named::new() };
    let next = counted.get(1).map_or(0, |c| c.0);
    if most < AGREEING || most <= MAJORITY * next {
        return Named::new();
    }
    // What a marker says against it, its corners do not outlive.
    let against = markers.iter().zip(&lies).filter(|(m, l)| **l != Some(lie) && m.read.errors == 0);
    let against: BTreeSet<Cell> = against
        .flat_map(|(m, _)| [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| (m.cell.0 + x, m.cell.1 + y)))
        .collect();
    let corners = part.iter().filter(|(cell, _)| !against.contains(cell));
    let on_board = corners.map(|(cell, placed)| (lie.corner(*cell), placed.corner));
    on_board.filter(|(corner, _)| board.has(*corner)).collect()
}

/// All parts of the board as one; a corner that two parts claim is nobody's.
pub fn united(parts: impl Iterator<Item = Named>) -> Named {
    let (mut all, mut twice) = (Named::new(), BTreeSet::new());
    for (corner, found) in parts.flatten() {
        if all.insert(corner, found).is_some() {
            twice.insert(corner);
        }
    }
    all.retain(|corner, _| !twice.contains(corner));
    all
}

/// Picture from the board (in squares) about a corner, by the corners nearest to it but itself.
pub fn about(places: &BTreeMap<Cell, Vector2<f64>>, corner: Cell) -> Option<Matrix3<f64>> {
    let apart = |c: &Cell| f64::from(c.0 - corner.0).hypot(f64::from(c.1 - corner.1));
    let mut others: Vec<(f64, Cell)> =
        places.keys().filter(|c| **c != corner).map(|c| (apart(c), *c)).collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0));
    others.truncate(NEAREST.0);
    if others.len() < NEAREST.1 || others[0].0 > REACH {
        return None;
    }
    let pair = |&(_, c): &(f64, Cell)| {
        (Vector2::new(f64::from(c.0 - corner.0), f64::from(c.1 - corner.1)), places[&c])
    };
    homography(&others.iter().map(pair).collect::<Vec<_>>()).ok()
}

/// Where a homography of [`about`] has its corner, and the steps to the next column and row there.
fn steps(h: &Matrix3<f64>) -> Option<(Vector2<f64>, [Vector2<f64>; 2])> {
    let at = |x: f64, y: f64| {
        let q = h * Vector2::new(x, y).push(1.0);
        let q = q.xy() / q.z;
        q.iter().all(|v| v.is_finite()).then_some(q)
    };
    let middle = at(0.0, 0.0)?;
    Some((middle, [(at(0.5, 0.0)? - at(-0.5, 0.0)?), (at(0.0, 0.5)? - at(0.0, -0.5)?)]))
}

/// The shorter step, px.
fn square_px(steps: &[Vector2<f64>; 2]) -> f64 {
    steps[0].norm().min(steps[1].norm())
}

/// Drops corners that do not lie where their neighbours have them, the worst first.
pub fn consistent(places: &mut BTreeMap<Cell, Vector2<f64>>) {
    loop {
        let off = |(corner, place): (&Cell, &Vector2<f64>)| {
            let (at, steps) = steps(&about(places, *corner)?)?;
            Some(((at - place).norm(), square_px(&steps), *corner))
        };
        let all: Vec<(f64, f64, Cell)> = places.iter().filter_map(off).collect();
        let usual = ASIDE.0 * crate::median(all.iter().map(|a| a.0)).unwrap_or(0.0);
        let share = |&(off, square, corner): &(f64, f64, Cell)| {
            (off / usual.min(ASIDE.2 * square).max(ASIDE.1), corner)
        };
        let worst = all.iter().map(share).max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((off, corner)) if off > 1.0 => places.remove(&corner),
            _ => return,
        };
    }
}

/// Adds corners that lie where the named ones have them, with their lines and colours as they must be.
pub fn completed(board: &CharucoBoard, corners: &[Corner], named: &mut Named) {
    for _ in 0..ROUNDS {
        let places = named.iter().map(|(cell, i)| (*cell, corners[*i].at)).collect();
        let used: BTreeSet<usize> = named.values().copied().collect();
        let missing = board.corners().filter(|c| !named.contains_key(c));
        let added: Vec<(Cell, usize)> = missing
            .filter_map(|cell| {
                let (at, steps) = steps(&about(&places, cell)?)?;
                let near = |i: &usize| (corners[*i].at - at).norm();
                let free = (0..corners.len()).filter(|i| !used.contains(i));
                let nearest = free.min_by(|a, b| near(a).total_cmp(&near(b)))?;
                let fits = near(&nearest) < ADDED * square_px(&steps);
                (fits && lies_as(board, &corners[nearest], cell, &steps)).then_some((cell, nearest))
            })
            .collect();
        if added.is_empty() {
            return;
        }
        // A corner that two places want is nobody's.
        let once = |i: usize| added.iter().filter(|a| a.1 == i).count() == 1;
        let before = named.len();
        named.extend(added.iter().filter(|a| once(a.1)).copied());
        if named.len() == before {
            return;
        }
    }
}

/// True if a corner's lines lead to its neighbours, and its squares have the board's colours.
fn lies_as(board: &CharucoBoard, corner: &Corner, cell: Cell, steps: &[Vector2<f64>; 2]) -> bool {
    let Some(k) = towards(corner, &steps[0]) else { return false };
    let next = half_line(corner, k + 1).dot(&steps[1]) > 0.0;
    // The square after this corner's column and row.
    next && k.is_multiple_of(2) == board.is_white((cell.0 + 1, cell.1 + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::charuco::dictionary::Read;
    use proptest::prelude::*;

    proptest! {
        /// Parts that are turned and shifted lie where they are, as any of their markers says.
        #[test]
        fn a_marker_says_how_its_part_lies(turns in 0usize..4, shift in (-9i32..9, -9i32..9), id in 0usize..17) {
            let board = CharucoBoard::parse("7x5").unwrap();
            let lie = Lie { turns, offset: shift };
            let (x, y) = board.square_of(id).unwrap();
            // The part's square whose middle falls on the middle of the board's.
            let cells = (-30..30).flat_map(|c| (-30..30).map(move |r| (c, r)));
            let twice = |(c, r): Cell| turned((2 * c + 1, 2 * r + 1), turns);
            let cell = cells.into_iter().find(|c| {
                let (u, v) = twice(*c);
                (u + 2 * shift.0, v + 2 * shift.1) == (2 * x + 1, 2 * y + 1)
            });
            let marker = Marker { cell: cell.unwrap(), read: Read { id, turns, errors: 0 } };
            prop_assert_eq!(Lie::of(&board, &marker), Some(lie));
        }
    }

    #[test]
    fn one_marker_names_nothing_and_contradiction_neither() {
        let board = CharucoBoard::parse("7x5").unwrap();
        let part: Part = (0..3)
            .flat_map(|r| (0..3).map(move |c| (c, r)))
            .enumerate()
            .map(|(corner, cell)| (cell, crate::charuco::lattice::Placed { corner, turn: 0 }))
            .collect();
        let marker = |cell, id| Marker { cell, read: Read { id, turns: 0, errors: 0 } };
        // Markers 3 and 4 are in squares (0, 1) and (2, 1); 8 in (3, 2).
        assert!(named(&board, &part, &[marker((0, 0), 3)]).is_empty());
        let both = named(&board, &part, &[marker((0, 0), 4), marker((1, 1), 8)]);
        assert_eq!(both.get(&(1, 0)), Some(&0), "{both:?}");
        assert_eq!(both.len(), 9);
        let split = [marker((0, 0), 4), marker((1, 1), 8), marker((0, 0), 5), marker((1, 1), 9)];
        assert!(named(&board, &part, &split).is_empty());
        // A single marker that says otherwise takes its corners with it.
        let apart = [marker((0, 0), 4), marker((1, 1), 8), marker((2, 0), 5), marker((0, 2), 0)];
        let left = named(&board, &part, &apart);
        assert!(!left.contains_key(&(1, 2)) && left.contains_key(&(1, 0)), "{left:?}");
    }
}
