//! The markers in the white squares of a part of a board.

use super::dictionary::{Dictionary, Read};
use super::lattice::{Cell, Part};
use crate::corners::Corner;
use crate::grey_image::GreyImage;
use crate::linear::homography;
use nalgebra::{Matrix3, Vector2};
use std::collections::BTreeSet;

/// Bits of the black border that may look white, as a share of them.
const BORDER_ERRORS: f64 = 0.2;
/// Least difference of black and white, grey levels.
const LEAST_CONTRAST: f32 = 12.0;
/// A square's corners that were not found are predicted from corners so many cells away, of which so many are needed.
const PREDICTED: (i32, usize) = (2, 4);
/// Where a bit is looked at, as shares of its side beside its middle.
const WITHIN_BIT: [f64; 3] = [-0.2, 0.0, 0.2];

/// A marker in a square of a part: the square between a cell's corner and those of the next column and row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// The square.
    pub cell: Cell,
    /// What was read.
    pub read: Read,
}

/// All markers that can be read in a part; `size` is the markers' side as a share of the squares'.
pub fn read(
    picture: &GreyImage,
    corners: &[Corner],
    part: &Part,
    dictionary: &Dictionary,
    size: f64,
) -> Vec<Marker> {
    let around = |&(c, r): &Cell| [(c, r), (c - 1, r), (c, r - 1), (c - 1, r - 1)];
    let squares: BTreeSet<Cell> = part.keys().flat_map(around).collect();
    let marker = |cell: Cell| {
        let quad = quad(corners, part, cell)?;
        let read = bits(picture, &quad, dictionary, size).and_then(|bits| dictionary.read(bits))?;
        Some(Marker { cell, read })
    };
    squares.into_iter().filter(|cell| is_white(part, *cell)).filter_map(marker).collect()
}

/// True if a square is white, by any of its corners.
fn is_white(part: &Part, (c, r): Cell) -> bool {
    let mut of = [(c, r), (c + 1, r), (c, r + 1), (c + 1, r + 1)].into_iter();
    // The colours of squares alternate, and with them the corners' turns.
    let white = |cell: Cell| part.get(&cell).map(|p| (p.turn as i32 + cell.0 + cell.1 + c + r) % 2 == 0);
    of.find_map(white).unwrap_or(false)
}

/// Picture from the square (0 to 1 along columns and rows).
fn quad(corners: &[Corner], part: &Part, (c, r): Cell) -> Option<Matrix3<f64>> {
    let own: Vec<_> = [(0, 0), (1, 0), (0, 1), (1, 1)]
        .into_iter()
        .filter_map(|(x, y)| {
            let at = corners[part.get(&(c + x, r + y))?.corner].at;
            Some((Vector2::new(f64::from(x), f64::from(y)), at))
        })
        .collect();
    if own.len() == 4 {
        return homography(&own).ok();
    }
    let near = (c - PREDICTED.0..=c + 1 + PREDICTED.0)
        .flat_map(|x| (r - PREDICTED.0..=r + 1 + PREDICTED.0).map(move |y| (x, y)));
    let near: Vec<_> = near
        .filter_map(|(x, y)| {
            let at = corners[part.get(&(x, y))?.corner].at;
            Some((Vector2::new(f64::from(x - c), f64::from(y - r)), at))
        })
        .collect();
    (near.len() >= PREDICTED.1).then(|| homography(&near).ok())?
}

/// Brightness of a place in a square.
fn at(picture: &GreyImage, quad: &Matrix3<f64>, p: Vector2<f64>) -> Option<f32> {
    let q = quad * p.push(1.0);
    let q = q.xy() / q.z;
    (q.iter().all(|v| v.is_finite()) && picture.holds(q, 0.0)).then(|| picture.between(q))
}

fn middle(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// The bits in a square, if a black border surrounds them and white surrounds the border.
fn bits(picture: &GreyImage, quad: &Matrix3<f64>, dictionary: &Dictionary, size: f64) -> Option<u64> {
    let n = dictionary.side + 2;
    let rim = (1.0 - size) / 2.0;
    let value = |column: usize, row: usize| {
        let place = |i: usize, u: f64| rim + (i as f64 + 0.5 + u) / n as f64 * size;
        let spots = WITHIN_BIT.iter().flat_map(|u| WITHIN_BIT.map(|v| (*u, v)));
        let spots = spots.map(|(u, v)| at(picture, quad, Vector2::new(place(column, u), place(row, v))));
        Some(spots.collect::<Option<Vec<f32>>>()?.iter().sum::<f32>() / 9.0)
    };
    let values = (0..n * n).map(|i| value(i % n, i / n)).collect::<Option<Vec<f32>>>()?;
    let is_border = |i: usize| i.is_multiple_of(n) || i / n == 0 || i % n == n - 1 || i / n == n - 1;
    let border: Vec<f32> = (0..n * n).filter(|&i| is_border(i)).map(|i| values[i]).collect();
    let around = (1..8).flat_map(|i| {
        let t = f64::from(i) / 8.0;
        [(t, rim / 2.0), (t, 1.0 - rim / 2.0), (rim / 2.0, t), (1.0 - rim / 2.0, t)]
    });
    let white = middle(around.filter_map(|(x, y)| at(picture, quad, Vector2::new(x, y))).collect());
    let black = middle(border.clone());
    if white - black < LEAST_CONTRAST {
        return None;
    }
    let limit = (white + black) / 2.0;
    let wrong = border.iter().filter(|v| **v > limit).count();
    let inner = (0..n * n).filter(|&i| !is_border(i));
    (wrong as f64 <= BORDER_ERRORS * border.len() as f64)
        .then(|| inner.fold(0, |out, i| out << 1 | u64::from(values[i] > limit)))
}
