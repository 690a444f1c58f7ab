//! Which corners of a chessboard hang together, also where only parts of the board are seen.
//!
//! Two corners are neighbours where an edge leads from one to the other: bright on one side and dark on the other along
//! all of its length, the sides as both corners have them. Corners of the bits in a marker have no such edges to the
//! board's corners, since every marker lies in a white square with a white rim. Each link says in which quarter its
//! corners see each other, so that a part of the board has cells, and its white squares are known, whatever is hidden.

use crate::corners::Corner;
use crate::grey_image::GreyImage;
use nalgebra::Vector2;
use std::collections::{BTreeMap, VecDeque};

/// A neighbour lies within this angle of the line that leads to it, rad.
const ALONG_RAD: f64 = 0.3;
/// Nearest corners along a line that are tried.
const TRIED: usize = 6;
/// Shares of an edge at which its sides are compared.
const SAMPLES: [f64; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];
/// How far from the edge: a share of the squares' white rim, within bounds, px.
const BESIDE: (f64, f64, f64) = (0.5, 1.0, 4.0);
/// Least difference of the sides: grey levels, and a share of the greatest along the edge.
const LEAST_STEP: (f32, f32) = (4.0, 0.2);

/// A column and a row.
pub type Cell = (i32, i32);

/// Where a corner is in its part of a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placed {
    /// Index of the corner.
    pub corner: usize,
    /// Which of its half lines leads to the next column, 0 to 3, see [`half_line`]; even where the square between the
    /// next column and the next row is white.
    pub turn: usize,
}

/// Corners that hang together, by cell.
pub type Part = BTreeMap<Cell, Placed>;

/// The half lines on which squares meet at a corner, in the order in which one turns from x to y: what follows the
/// first and the third is white, what follows the others black.
pub fn half_line(corner: &Corner, k: usize) -> Vector2<f64> {
    let [first, second] = corner.lines;
    let second = if first.perp(&second) > 0.0 { second } else { -second };
    [first, second, -first, -second][k % 4]
}

/// The half line of a corner that leads along `way`, if one does.
pub fn towards(corner: &Corner, way: &Vector2<f64>) -> Option<usize> {
    (0..4).find(|&k| half_line(corner, k).angle(way) < ALONG_RAD)
}

/// All parts of boards, the largest first. `rim` is the width of the white rim around markers, as a share of a square.
pub fn parts(smooth: &GreyImage, corners: &[Corner], rim: f64) -> Vec<Part> {
    let links: Vec<[Option<(usize, usize)>; 4]> =
        (0..corners.len()).map(|i| [0, 1, 2, 3].map(|k| linked(smooth, corners, rim, i, k))).collect();
    let mutual = |i: usize, k: usize| {
        let (j, m) = links[i][k]?;
        (links[j][m] == Some((i, k))).then_some((j, m))
    };
    let mut taken = vec![false; corners.len()];
    let mut found = Vec::new();
    for seed in 0..corners.len() {
        if !taken[seed] {
            found.push(grown(seed, &mutual, &mut taken));
        }
    }
    found.sort_by_key(|part: &Part| std::cmp::Reverse(part.len()));
    found
}

/// The nearest corner to which an edge leads along a half line, and the half line that leads back.
fn linked(smooth: &GreyImage, corners: &[Corner], rim: f64, i: usize, k: usize) -> Option<(usize, usize)> {
    let (here, line) = (corners[i].at, half_line(&corners[i], k));
    let ahead = |(j, other): (usize, &Corner)| {
        let way = other.at - here;
        let forward = way.dot(&line);
        let near = j != i && forward > 0.0 && way.perp(&line).abs() < ALONG_RAD.tan() * forward;
        near.then_some((way.norm(), j))
    };
    let mut ahead: Vec<(f64, usize)> = corners.iter().enumerate().filter_map(ahead).collect();
    ahead.sort_by(|a, b| a.0.total_cmp(&b.0));
    ahead.into_iter().take(TRIED).find_map(|(_, j)| {
        let back = towards(&corners[j], &(here - corners[j].at))?;
        // What is white on the right of an edge is on the left on the way back.
        ((back + k) % 2 == 1 && is_edge(smooth, here, corners[j].at, k.is_multiple_of(2), rim))
            .then_some((j, back))
    })
}

/// True if one side is brighter than the other all the way: that to which one turns from x to y, if `bright_after`.
fn is_edge(smooth: &GreyImage, from: Vector2<f64>, to: Vector2<f64>, bright_after: bool, rim: f64) -> bool {
    let way = to - from;
    let across = Vector2::new(-way.y, way.x).normalize();
    let beside = across * (BESIDE.0 * rim * way.norm()).clamp(BESIDE.1, BESIDE.2);
    let sign = if bright_after { 1.0 } else { -1.0 };
    let step = |t: f64| {
        let at = from + way * t;
        sign * (smooth.between(at + beside) - smooth.between(at - beside))
    };
    let steps = SAMPLES.map(step);
    let greatest = steps.iter().copied().fold(0.0, f32::max);
    steps.iter().all(|s| *s > LEAST_STEP.0 && *s >= LEAST_STEP.1 * greatest)
}

/// All corners connected with a seed. A corner or a cell that two ways give differently stays as the first has it.
fn grown(seed: usize, link: &dyn Fn(usize, usize) -> Option<(usize, usize)>, taken: &mut [bool]) -> Part {
    let mut part = Part::from([((0, 0), Placed { corner: seed, turn: 0 })]);
    taken[seed] = true;
    let mut queue = VecDeque::from([(0, 0)]);
    while let Some(cell) = queue.pop_front() {
        let Placed { corner, turn } = part[&cell];
        for (d, step) in [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().enumerate() {
            let to = (cell.0 + step.0, cell.1 + step.1);
            let Some((next, back)) = link(corner, (turn + d) % 4) else { continue };
            if taken[next] || part.contains_key(&to) {
                continue;
            }
            taken[next] = true;
            // `back` leads to where this corner lies: half a turn from `d`.
            part.insert(to, Placed { corner: next, turn: (back + 4 + 2 - d) % 4 });
            queue.push_back(to);
        }
    }
    part
}
